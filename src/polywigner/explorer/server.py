"""The server of the page: one address, a session for each visitor, few lines in the terminal."""

from __future__ import annotations

import errno
import gc
import ipaddress
import logging
import math
import os
import signal
import threading
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

from polywigner.errors import ArgumentError, require
from polywigner.explorer.state import State

PORT = 5006
_UNUSED_MS = 20_000  # a page waits so long for its browser to connect, or to come back
_CHECK_MS = 5_000
_HEADERS_S = 15.0  # for headers, and between two requests of a browser
_BODY_S = 5.0
_LARGEST_BODY = 1 << 10  # nobody sends one
_PING_S = 15.0  # a page's browser answers within this time, or the page has gone
_LARGEST_HEADER = 256 << 10  # a websocket is asked for with the link twice: itself, and in a token

_LOGGER = "polywigner.explorer"
# requests that are damaged, and faults of callbacks: a line each
_ONE_LINE = (_LOGGER, "tornado.application", "asyncio", "panel")
# what strangers ask for and do not get
_SILENT = ("tornado.access", "tornado.general", "bokeh.server.views.ws")
_LONGEST_LINE = 200  # characters: messages of others are quoted in it
_REPEATED_S = 60.0  # seconds in which the same line of code writes once


def check_installed() -> None:
    """Raise MissingExtraError without the library of the page."""
    require("panel", "explorer", "serves the page")


def is_local(address: str) -> bool:
    """Whether only this machine can reach a server at the address."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def new_server(
    state: State, port: int = PORT, address: str = "127.0.0.1", allow_host: Sequence[str] = ()
) -> Any:
    """A server of the page, not yet started; ``.port`` says which it has.

    Parameters
    ----------
    state : what visitors begin with who come without a link.
    port : 0 for any that is free.
    address : to listen at.
    allow_host : names, with a port or without, that it answers to beside its own.

    Raises
    ------
    MissingExtraError without Panel; ArgumentError for an address or a port that cannot be had, and
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
    import panel as pn
    from bokeh.util.token import generate_secret_key
    from panel.io.server import get_server

    from polywigner.explorer.guard import LARGEST_MESSAGE, guard, served_hosts
    from polywigner.explorer.page import WEB, fault, open_page
    from polywigner.explorer.scheduler import Scheduler
    from polywigner.explorer.uploads import Uploads

    pn.config.exception_handler = fault
    keep_short()
    _leave_garbage_alone()
    served_hosts(address, port, allow_host)  # its error, before anything is opened
    scheduler, uploads = Scheduler(), Uploads()
    try:
        server = get_server(
            {"/": lambda: open_page(state, scheduler, uploads)},
            port=port,
            address=address,
            title="polywigner explore",
            static_dirs={"assets": str(WEB)},
            websocket_origin="*",  # the guard looks at origins
            secret_key=generate_secret_key().encode(),
            sign_sessions=True,
            unused_session_lifetime_milliseconds=_UNUSED_MS,
            check_unused_sessions_milliseconds=_CHECK_MS,
            websocket_max_message_size=LARGEST_MESSAGE,
            keep_alive_milliseconds=0,  # Bokeh's pings, for whose answers it does not wait
            websocket_ping_interval=_PING_S,
            websocket_ping_timeout=_PING_S,
            http_server_kwargs={
                "max_header_size": _LARGEST_HEADER,
                "max_body_size": _LARGEST_BODY,
                "idle_connection_timeout": _HEADERS_S,
                "body_timeout": _BODY_S,
            },
        )
    except (OSError, ValueError) as error:
        scheduler.stop()
        raise ArgumentError(_refusal(error, address, port)) from None
    guard(server, address, allow_host)
    server.polywigner_scheduler, server.polywigner_uploads = scheduler, uploads
    return server


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
        server.polywigner_uploads.stop()
        done = bool(server.polywigner_scheduler.stop())
        server.stop()
    return done


def _shortened(record: logging.LogRecord) -> bool:
    """Filter: no traceback that nobody asked for."""
    error = record.exc_info[1] if record.exc_info else None
    if error is not None and not os.environ.get("POLYWIGNER_DEBUG"):
        what = str(record.msg).split("%", 1)[0].split("\n", 1)[0].strip()
        record.msg = f"{what}: {type(error).__name__} (POLYWIGNER_DEBUG=1 shows more)"
        record.args, record.exc_info, record.exc_text = (), None, None
    return True


class RateLimitFilter(logging.Filter):
    """Filter: each line of code logs once a minute, with the number of messages left out."""

    def __init__(self, seconds: float = _REPEATED_S) -> None:
        super().__init__()
        self.seconds = seconds
        self.written: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is written."""
        own = record.msg if record.name == _LOGGER else ""
        place = f"{record.pathname}:{record.lineno}:{own}"
        since, left_out = self.written.get(place, (-math.inf, 0))
        if record.created - since < self.seconds:
            self.written[place] = since, left_out + 1
            return False
        self.written[place] = record.created, 0
        text = record.getMessage()
        text = text if len(text) <= _LONGEST_LINE else f"{text[:_LONGEST_LINE]} …"
        record.msg = f"{text} (and {left_out} more)" if left_out else text
        record.args = ()
        return True


_RATE_LIMIT = RateLimitFilter()


def keep_short() -> None:
    """Set up the loggers of the server."""
    logging.getLogger("bokeh").setLevel(logging.ERROR)
    for name in _SILENT:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    known = [n for n in logging.root.manager.loggerDict if n.startswith(("bokeh.", "panel."))]
    for name in {*_ONE_LINE, *known}.difference(_SILENT):
        logger = logging.getLogger(name)
        if _shortened not in logger.filters:
            logger.addFilter(_shortened)
            logger.addFilter(_RATE_LIMIT)
