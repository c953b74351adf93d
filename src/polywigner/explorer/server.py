"""A server of the page on this machine alone."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from polywigner.errors import ArgumentError, require
from polywigner.explorer.state import State

ADDRESS = "127.0.0.1"
_NAMES = (ADDRESS, "localhost")


def new_server(state: State, port: int = 0) -> Any:
    """Return a Bokeh server of the page, listening on 127.0.0.1 but not yet serving.

    Raises ArgumentError if the port is in use, MissingExtraError without Panel.
    """
    pn = require("panel", "explorer", "serves the page")

    from polywigner.explorer.page import TITLE, Explorer

    prepared: list[Explorer] = []

    def new_page() -> Any:
        return (prepared.pop() if prepared else Explorer(state)).page()

    try:
        if port == 0:
            with socket.create_server((ADDRESS, 0)) as free:
                port = free.getsockname()[1]
        server = pn.serve(
            new_page, address=ADDRESS, port=port, show=False, start=False, title=TITLE,
            verbose=False, websocket_origin=[f"{name}:{port}" for name in _NAMES],
        )  # fmt: skip
    except OSError as error:
        raise ArgumentError(f"port {port} cannot be used ({error}); try --port 0") from None
    refuse_foreign_hosts(server._tornado, port)
    server.io_loop.call_later(0.1, lambda: prepared.append(Explorer(state)))  # as a browser starts
    return server


def refuse_foreign_hosts(application: Any, port: int) -> None:
    """Answer requests whose Host header is not this server's with 403.

    The origin check alone would accept a page of another site whose name resolves to 127.0.0.1.
    """
    from tornado.web import ErrorHandler

    find, hosts = application.find_handler, {f"{name}:{port}" for name in _NAMES}

    def find_local(request: Any, **options: Any) -> Any:
        if request.host.lower() in hosts:
            return find(request, **options)
        return application.get_handler_delegate(request, ErrorHandler, {"status_code": 403})

    application.find_handler = find_local


def serve(state: State, port: int, browser: bool, say: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C, and open it in a browser."""
    server = new_server(state, port)
    say(f"http://{ADDRESS}:{server.port}/ shows the explorer; Ctrl-C stops it.")
    if browser:
        server.io_loop.add_callback(server.show, "/")
    server.start()
    with suppress(KeyboardInterrupt):
        server.io_loop.start()
