"""The one page that is served: viser's client, a single file, with our script and style inside."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import viser

from echelon.errors import InputError

SCRIPTS = (
    "known.js",
    "overlay.js",
    "talking.js",
    "showing.js",
    "riding.js",
    "looking.js",
    "keys.js",
    "directing.js",
    "wiring.js",
)
"""Our script's files, in the order in which they stand in the page: one function holds them all."""


def build_page() -> bytes:
    """The page as UTF-8.

    viser's client is one self-contained file. Our style and script go before the end of its head, so that they run
    before the client does and their listeners hear keys first.

    Raises:
        InputError: The installed viser brings no client of the expected form.
    """
    path = Path(viser.__file__).parent / "client" / "build" / "index.html"
    try:
        client = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{path}: viser's client cannot be read ({error.strerror}); install viser from a wheel"
        ) from None
    if "</head>" not in client:
        raise InputError(f"{path}: viser's client has no head to put ours in; viser 1.1 is known to have")
    return with_ours(client).encode()


def with_ours(client: str) -> str:
    """A page with our style and script at the end of its head."""
    head, end, rest = client.partition("</head>")
    folder = resources.files("echelon.play.web") / "page"
    style = (folder / "play.css").read_text(encoding="utf-8")
    files = ((folder / name).read_text(encoding="utf-8") for name in SCRIPTS)
    script = '(() => {\n"use strict";\n' + "\n".join(files) + "})();\n"
    head = head.replace("<title>Viser</title>", "<title>Echelon</title>")
    ours = f'<style id="echelon-style">\n{style}</style>\n<script id="echelon-script">\n{script}</script>\n'
    return f"{head}{ours}{end}{rest}"


def page_headers(host: str) -> dict[str, str]:
    """Headers of the page, for a client that addressed us as ``host`` (well formed, with its port).

    The policy is as narrow as viser's client allows: it unpacks itself into inline scripts and styles, compiles
    WebAssembly whose glue evaluates strings, runs workers from blobs and reads pictures from data. It may connect to
    nothing but us, so that a link with a foreign ``?websocket=`` leads nowhere, and no other page may frame it.
    """
    policy = {
        "default-src": "'none'",
        "script-src": "'unsafe-inline' 'unsafe-eval' blob:",
        "style-src": "'unsafe-inline'",
        "worker-src": "blob:",
        "connect-src": f"ws://{host} wss://{host} data: blob:",
        "img-src": "data: blob:",
        "font-src": "data:",
        "media-src": "data: blob:",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
    }
    return {
        "Content-Type": "text/html; charset=utf-8",
        "Content-Security-Policy": "; ".join(f"{name} {value}" for name, value in policy.items()),
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
        "Cache-Control": "no-store",
    }
