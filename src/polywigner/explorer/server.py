"""The server of the page: one address, a session for each visitor, a clean end."""

from __future__ import annotations

import errno
import gc
import ipaddress
import signal
import threading
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from polywigner.errors import (
    ArgumentError,
    require,
)
from polywigner.explorer.logs import keep_short
from polywigner.explorer.state import State

if TYPE_CHECKING:
    from polywigner.explorer.readings import Readings
    from polywigner.explorer.scheduler import Scheduler


PORT = 5006
_IDLE_MS = 15_000  # a session whose page has gone is kept so long, for a page that is reloaded
_HEADERS_S = 15.0  # for headers, and between two requests of a browser
_BODY_S = 5.0
_LARGEST_BODY = 1 << 10  # nobody sends one
_PING_S = 15.0  # a page's browser answers within this time, or the page has gone
_LARGEST_HEADER = 256 << 10  # a websocket is asked for with the link twice: itself, and in a token


def check_installed() -> None:
    """Raises MissingExtraError without the libraries of the page."""
    require("bokeh.server.server", "explorer", "serves the page")


def is_local(address: str) -> bool:
    """Whether only this machine can reach a server at the address."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def new_server(
    state: State, port: int = PORT, address: str = "127.0.0.1", allow_host: Sequence[str] = ()
) -> Any:
    """A Bokeh server of the page, not yet started; ``.port`` says which it has.

    Parameters
    ----------
    state : what visitors begin with who come without a link.
    port : 0 for any that is free.
    address : to listen at.
    allow_host : names, with a port or without, that it answers to beside its own.

    Raises
    ------
    MissingExtraError without Bokeh; ArgumentError for an address or a port that cannot be had, and
    for a host that is no name.
    """
    check_installed()
    if not 0 <= port < 65536:
        raise ArgumentError(f"expected a port from 0 to 65535, got {port}")
    if not address.strip():  # sockets would listen at all addresses
        raise ArgumentError(
            "expected an address to listen at, got none; leave --address out for this machine "
            "alone, or say 0.0.0.0 for all its addresses"
        )
    from bokeh.server.server import BaseServer
    from tornado.httpserver import HTTPServer
    from tornado.ioloop import IOLoop
    from tornado.netutil import bind_sockets

    from polywigner.explorer.guard import Listener, guard, most_connections, served_hosts
    from polywigner.explorer.readings import Readings
    from polywigner.explorer.scheduler import Scheduler
    from polywigner.explorer.visits import Turns, route

    keep_short()
    _leave_garbage_alone()
    served_hosts(address, port, allow_host)  # its error, before anything is opened
    try:
        sockets = bind_sockets(port, address)
    except (OSError, ValueError) as error:
        raise ArgumentError(_refusal(error, address, port)) from None
    port = sockets[0].getsockname()[1]
    scheduler, readings, turns = Scheduler(), Readings(), Turns()
    application = _application(state, scheduler, readings)
    most = most_connections()
    http = HTTPServer(
        application,
        max_header_size=_LARGEST_HEADER,
        max_body_size=_LARGEST_BODY,
        idle_connection_timeout=_HEADERS_S,
        body_timeout=_BODY_S,
    )
    http.add_sockets(Listener(socket, most) for socket in sockets)
    server = BaseServer(IOLoop.current(), application, http)
    route(application, turns, lambda document: readings.forget(id(document)))
    hosts = served_hosts(address, port, allow_host)
    guard(application, hosts, port, lambda: (turns.waiting, server.get_sessions("/")))
    server.polywigner_scheduler, server.polywigner_readings = scheduler, readings
    return server


def _application(state: State, scheduler: Scheduler, readings: Readings) -> Any:
    """Application of Bokeh: sessions and their messages to browsers."""
    from bokeh.application import Application
    from bokeh.server.tornado import BokehTornado
    from bokeh.util.token import generate_secret_key

    from polywigner.explorer.page import open_page
    from polywigner.explorer.visits import LARGEST_MESSAGE, Pages

    return BokehTornado(
        Application(Pages(lambda doc: open_page(doc, state, scheduler, readings))),
        extra_websocket_origins=["*"],  # the guard looks at origins
        secret_key=generate_secret_key().encode(),
        sign_sessions=True,
        unused_session_lifetime_milliseconds=_IDLE_MS,
        check_unused_sessions_milliseconds=_IDLE_MS // 3,
        websocket_max_message_size_bytes=LARGEST_MESSAGE,
        keep_alive_milliseconds=0,  # Bokeh's pings, for whose answers it does not wait
        websocket_ping_interval=_PING_S,
        websocket_ping_timeout=_PING_S,
    )


def _leave_garbage_alone() -> None:
    """Bokeh collects the garbage of the whole process for each page that goes, and pages that go
    together in a row: of fifty, for half a minute. The scheduler does so once for all."""
    from bokeh.document import document

    if hasattr(document, "gc"):
        document.gc = SimpleNamespace(collect=lambda: 0)


def _refusal(error: Exception, address: str, port: int) -> str:
    number = getattr(error, "errno", None)
    if number == errno.EADDRINUSE:
        return (
            f"expected a free port, got {port}, which is in use (by another `polywigner explore`?)"
            "; choose another with --port (0: any that is free)"
        )
    if number == errno.EACCES:
        return f"expected a port that you may serve at, got {port}; choose one above 1023"
    return f"expected an address of this machine, got {address}; choose another with --address"


def serve(
    state: State,
    port: int = PORT,
    address: str = "127.0.0.1",
    browser: bool = True,
    say: Callable[[str], None] = print,
    allow_host: Sequence[str] = (),
) -> bool:
    """Serve the page until Ctrl-C, or SIGTERM.

    Returns
    -------
    Whether nothing is left behind: a computation may go on for a while in a thread of its own.

    Raises
    ------
    As :func:`new_server`.
    """
    server = new_server(state, port, address, allow_host)
    shown = "127.0.0.1" if address in ("0.0.0.0", "::") else address
    url = f"http://{f'[{shown}]' if ':' in shown else shown}:{server.port}/"
    if not is_local(address):
        say(
            f"warning: {address} can be reached from other machines; whoever opens the page "
            "makes this one compute"
        )
    say(f"polywigner explore: {url} (Ctrl-C stops)")
    # Full collections take up to 0.2 s of all that is imported; there is one when a visitor leaves.
    before = gc.get_threshold()
    gc.set_threshold(5000, 20, 1000)
    gc.freeze()
    server.start()
    if browser:
        server.io_loop.add_callback(lambda: threading.Thread(target=_open, args=(url,)).start())
    done = _until_stopped(server)
    gc.unfreeze()
    gc.set_threshold(*before)
    say("polywigner explore: stopped")
    return done


def _open(url: str) -> None:
    import contextlib
    import webbrowser

    with contextlib.suppress(Exception):  # a machine without one has the address all the same
        webbrowser.open(url)


def _until_stopped(server: Any) -> bool:
    loop = server.io_loop
    previous = {
        number: signal.signal(number, lambda *_: loop.add_callback_from_signal(loop.stop))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        loop.start()
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        server.polywigner_readings.stop()
        done = bool(server.polywigner_scheduler.stop())
        server.stop()
    return done
