"""A local browser page for drawing an aperture and viewing its transforms and fields.

:mod:`~polywigner.explorer.state` and :mod:`~polywigner.explorer.views` need no browser.
"""

from __future__ import annotations

import socket
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from polywigner import read_aperture
from polywigner.errors import ArgumentError, require
from polywigner.explorer.state import UNITS, State, rings_of

if TYPE_CHECKING:
    from bokeh.server.server import Server
    from tornado.httputil import HTTPMessageDelegate, HTTPServerRequest
    from tornado.web import Application

__all__ = ["State", "serve", "start_state"]

_ADDRESS = "127.0.0.1"
_NAMES = (_ADDRESS, "localhost")


def start_state(
    path: str | None, wave: str | None = None, unit: str = "mm", **reading: Any
) -> State:
    """Return the initial state of the page: the outlines of an aperture file, or a chevron.

    The page uses the unit of the file, or mm if the page does not offer that unit. ``wave`` is a
    frequency or a wavelength with its unit, by default 94 GHz, and ``reading`` contains further
    arguments of :func:`read_aperture`.
    """
    unit_of_page = {"um": "µm"}.get(unit, unit)
    state = State(unit=unit_of_page if unit_of_page in UNITS else "mm", wave=wave or State.wave)
    if path is None:
        return state
    return replace(state, rings=rings_of(read_aperture(path, unit, **reading), state.per_metre))


def serve(state: State, port: int, browser: bool) -> None:
    """Serve the page until Ctrl-C; the port 0 selects a free port."""
    server = _new_server(state, port)
    print(f"http://{_ADDRESS}:{server.port}/ shows the explorer; Ctrl-C stops it.", flush=True)
    if browser:
        server.io_loop.add_callback(server.show, "/")
    server.start()
    with suppress(KeyboardInterrupt):
        server.io_loop.start()


def _new_server(state: State, port: int) -> Server:
    """Return a server for the page that has not been started."""
    pn = require("panel", "explorer", "serves the page")

    from polywigner.explorer.page import TITLE, Explorer

    prepared: list[Explorer] = []
    try:
        if port == 0:
            with socket.create_server((_ADDRESS, 0)) as free:
                port = free.getsockname()[1]
        server: Server = pn.serve(
            lambda: (prepared.pop() if prepared else Explorer(state)).page(), address=_ADDRESS,
            port=port, show=False, start=False, title=TITLE, verbose=False,
            websocket_origin=[f"{name}:{port}" for name in _NAMES],
        )  # fmt: skip
    except OSError as error:
        raise ArgumentError(
            f"cannot serve the page at port {port} ({error}); pass --port 0 for a free port"
        ) from None
    _refuse_foreign_hosts(server._tornado, port)
    # Prepare the first session while the browser starts.
    server.io_loop.call_later(0.1, lambda: prepared.append(Explorer(state)))
    return server


def _refuse_foreign_hosts(application: Application, port: int) -> None:
    """Respond with status 403 to requests with a foreign Host header.

    The origin check alone would accept pages of a site whose name resolves to 127.0.0.1.
    """
    from tornado.web import ErrorHandler

    find, hosts = application.find_handler, {f"{name}:{port}" for name in _NAMES}

    def find_local(request: HTTPServerRequest, **options: Any) -> HTTPMessageDelegate:
        """Return the handler of a request; a foreign host gets status 403."""
        if request.host.lower() in hosts:
            return find(request, **options)
        return application.get_handler_delegate(request, ErrorHandler, {"status_code": 403})

    application.find_handler = find_local
