"""The heads of HTTP requests: read within bounds, checked for who may ask, and answered.

The server behind this page listens on a loopback address and trusts whoever reaches it. Two kinds of foreign web page
could reach it from the same person's browser, and both show in the head:

* A page of another origin that opens a websocket to us (cross-site websocket hijacking): browsers name the origin of
  the page in ``Origin``, which must be the very host that ``Host`` names.
* A page whose own name was made to resolve to our address after it was loaded (DNS rebinding): its ``Host`` and
  ``Origin`` agree, but the name in them is not one of ours.
"""

from __future__ import annotations

import asyncio
import ipaddress
import re
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus

LARGEST_HEAD = 16_384  # bytes
MOST_HEADERS = 100

_TOKEN = re.compile(r"[-!#$%&'*+.^_`|~0-9A-Za-z]+")
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]{2,45}\]|[0-9A-Za-z._-]{1,253})(?::([0-9]{1,5}))?")
_SAFE_VALUE = re.compile(r"[\t\x20-\x7e\x80-\xff]*")


class Refused(Exception):
    """A request that is answered with a status other than 200 or 101, and why in one line."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status
        self.reason = reason


@dataclass(frozen=True)
class Head:
    """A request's first line and its headers.

    path: Without the query.
    headers: By lower-case name; what came more than once is joined by ", ".
    """

    method: str
    path: str
    headers: Mapping[str, str]

    @property
    def host(self) -> str:
        """Host and port as the client named them, known to be well formed."""
        return self.headers["host"]

    @property
    def wants_websocket(self) -> bool:
        """Whether an upgrade to a websocket is asked for."""
        return self.headers.get("upgrade", "").strip().lower() == "websocket"


async def read_head(reader: asyncio.StreamReader) -> Head:
    """Reads and parses one request head.

    Raises:
        Refused: Not HTTP/1.1, malformed, or too large.
        EOFError: The client left.
    """
    try:
        raw = await reader.readuntil(b"\r\n\r\n")
    except asyncio.LimitOverrunError:
        raise Refused(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "the request is too large") from None
    if len(raw) > LARGEST_HEAD:
        raise Refused(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "the request is too large")
    return parse_head(raw)


def parse_head(raw: bytes) -> Head:
    """Parses a request head, strictly.

    Raises:
        Refused: Anything that is not plain HTTP/1.1 without a body.
    """
    lines = raw.decode("latin-1").split("\r\n")[:-2]
    parts = lines[0].split(" ") if lines else []
    if len(parts) != 3 or parts[2] != "HTTP/1.1" or not parts[1].startswith("/"):
        raise Refused(HTTPStatus.BAD_REQUEST, "this is not an HTTP/1.1 request")
    if len(lines) - 1 > MOST_HEADERS:
        raise Refused(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "the request has too many headers")
    headers: dict[str, str] = {}
    for line in lines[1:]:
        name, colon, value = line.partition(":")
        if not colon or not _TOKEN.fullmatch(name) or not _SAFE_VALUE.fullmatch(value):
            raise Refused(HTTPStatus.BAD_REQUEST, "a header is malformed")
        key, value = name.lower(), value.strip(" \t")
        if key in headers and key in ("host", "origin", "upgrade", "sec-websocket-key"):
            raise Refused(HTTPStatus.BAD_REQUEST, f"{key} stands twice in the request")
        headers[key] = f"{headers[key]}, {value}" if key in headers else value
    if "transfer-encoding" in headers or headers.get("content-length", "0") != "0":
        raise Refused(HTTPStatus.BAD_REQUEST, "a request here has no body")
    if not _HOST.fullmatch(headers.get("host", "")):
        raise Refused(HTTPStatus.BAD_REQUEST, "the Host header is missing or malformed")
    return Head(parts[0], parts[1].partition("?")[0], headers)


# ---- who may ask ---------------------------------------------------------------------------------------------------
class Doorkeeper:
    """Knows the names under which this server may be addressed.

    Args:
        host: The address that the server is bound to.
        names: Further names, for a server behind a proxy or with a name of its own in DNS.

    Bound to a loopback address: ``localhost`` and literal loopback addresses. Otherwise also every literal address (a
    name is what rebinding needs) and the machine's own name. The port is not compared, because it differs through a
    forwarded one.
    """

    def __init__(self, host: str, names: Sequence[str] = ()) -> None:
        self._loopback_only = is_loopback(host)
        self._names = {"localhost", host.lower(), *(name.lower() for name in names)}
        if not self._loopback_only:
            own = socket.gethostname().lower()
            self._names |= {own, f"{own}.local", own.partition(".")[0]}

    def check(self, head: Head) -> None:
        """Lets a request pass.

        Raises:
            Refused: It addresses a foreign name, or comes from the page of another origin.
        """
        if not self._is_ours(head.host):
            raise Refused(HTTPStatus.FORBIDDEN, "this server does not answer to that host name")
        origin = head.headers.get("origin")
        # without an Origin it is no browser that asks, and what is no browser is nobody's page
        if origin is not None and origin.lower() not in (f"http://{head.host.lower()}", f"https://{head.host.lower()}"):
            raise Refused(HTTPStatus.FORBIDDEN, "the page of another origin may not come in here")

    def _is_ours(self, host: str) -> bool:
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = found.group(1).lower().removesuffix(".")
        try:
            address = ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name in self._names
        return address.is_loopback or not self._loopback_only


def is_loopback(host: str) -> bool:
    """Whether a server bound to ``host`` is reached from this machine only."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


# ---- answers -------------------------------------------------------------------------------------------------------
def answer(status: HTTPStatus, headers: Mapping[str, str], body: bytes, *, with_body: bool = True) -> bytes:
    """A whole HTTP response after which the connection is closed; without its body for a HEAD request."""
    every = {"Content-Length": str(len(body)), "Connection": "close", **headers}
    lines = [f"HTTP/1.1 {status.value} {status.phrase}", *(f"{name}: {value}" for name, value in every.items())]
    return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1") + (body if with_body else b"")


def refusal(refused: Refused) -> bytes:
    """The response to a request that is not granted: its reason as plain text."""
    headers = {
        "Content-Type": "text/plain; charset=utf-8",
        "X-Content-Type-Options": "nosniff",
        "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
        "Cache-Control": "no-store",
    }
    if refused.status == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = "GET, HEAD"
    return answer(refused.status, headers, f"{refused.reason}\n".encode())
