"""The server of the page: one address, a session for each visitor, a clean end."""

from __future__ import annotations

import errno
import gc
import ipaddress
import signal
import threading
from collections.abc import Callable, Sequence
from typing import Any

from polywigner.errors import ArgumentError, MissingExtraError, install_command
from polywigner.explorer.logs import keep_short
from polywigner.explorer.state import State

__all__ = ["check_installed", "new_server", "serve"]

PORT = 5006
_IDLE_MS = 15_000  # a session whose page has gone is kept so long, for a page that is reloaded
_LARGEST_MESSAGE = 32 << 20  # what is beyond the limit of uploads, but not by much, gets an answer

_LARGEST_HEADER = 256 << 10  # a websocket is asked for with the link twice: itself, and in a token


def check_installed() -> None:
    """Raises MissingExtraError without the libraries of the page."""
    try:
        import bokeh.server.server  # noqa: F401
    except ImportError:
        raise MissingExtraError(
            f"expected Bokeh, which serves the page, got none; run {install_command('explorer')}"
        ) from None


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
    from bokeh.application import Application
    from bokeh.application.handlers.function import FunctionHandler
    from bokeh.server.server import Server

    from polywigner.explorer.guard import guard, served_hosts
    from polywigner.explorer.page import open_page
    from polywigner.explorer.scheduler import Scheduler

    keep_short()
    if not 0 <= port < 65536:
        raise ArgumentError(f"expected a port from 0 to 65535, got {port}")
    if not address.strip():  # sockets would listen at all addresses
        raise ArgumentError(
            "expected an address to listen at, got none; leave --address out for this machine "
            "alone, or say 0.0.0.0 for all its addresses"
        )
    served_hosts(address, port, allow_host)  # its error, before anything is opened
    scheduler = Scheduler()
    application = Application(FunctionHandler(lambda doc: open_page(doc, state, scheduler)))
    try:
        server = Server(
            {"/": application},
            port=port,
            address=address,
            unused_session_lifetime_milliseconds=_IDLE_MS,
            check_unused_sessions_milliseconds=_IDLE_MS // 3,
            websocket_max_message_size=_LARGEST_MESSAGE,
            http_server_kwargs={"max_header_size": _LARGEST_HEADER},
        )
    except (OSError, ValueError) as error:
        scheduler.stop()
        raise ArgumentError(_refusal(error, address, port)) from None
    server._tornado._websocket_origins.add("*")  # the guard looks at origins
    hosts = served_hosts(address, server.port, allow_host)
    guard(server._tornado, hosts, server.port, lambda: server.get_sessions("/"))
    server.polywigner_scheduler = scheduler
    return server


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
    server.start()
    if browser:
        server.io_loop.add_callback(lambda: threading.Thread(target=_open, args=(url,)).start())
    done = _until_stopped(server)
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
        done = bool(server.polywigner_scheduler.stop())
        server.stop()
    return done
