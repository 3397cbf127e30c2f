"""A viser server that says nothing on the terminal and listens on this computer only."""

from __future__ import annotations

import contextlib
import io
import warnings

import viser


def open_server() -> viser.ViserServer:
    """A running server on loopback, on a port that is free; give it back with `close_server`."""
    # A client that has just gone is written to once more before anybody can know: viser drops it and warns.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)
    with contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host="127.0.0.1", port=0, verbose=False)


def close_server(server: viser.ViserServer) -> None:
    """Stop a server."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()
