"""The server of the page: its address, its log, and a clean end."""

from __future__ import annotations

import errno
import gc
import ipaddress
import logging
import math
import os
import signal
import threading
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from polywigner.errors import ArgumentError, require
from polywigner.explorer.state import State

PORT = 5006
PATIENCE = 15.0
"""Seconds for headers, between two requests, for a browser's answer to a ping, and that a session
is kept whose page has gone, as it may be reloaded."""
_LARGEST_BODY = 1 << 10  # nobody sends one
_LARGEST_HEADER = 256 << 10  # a websocket is asked for with the link twice: itself, and in a token


def check_installed() -> None:
    """Raises MissingExtraError without the libraries of the page."""
    require("bokeh.server.server", "explorer", "serves the page")


def new_server(
    state: State,
    port: int = PORT,
    address: str = "127.0.0.1",
    allow_host: Sequence[str] = (),
    patience: float = PATIENCE,
) -> Any:
    """A Bokeh server of the page, not yet started; ``.port`` says which it has (0: any free one).

    Visitors without a link begin with ``state``. The server answers to the names ``allow_host``
    beside its own, each with a port or without. Raises MissingExtraError without Bokeh,
    ArgumentError for an address or a port that cannot be had, and for a host that is no name.
    """
    check_installed()
    if not 0 <= port < 65536:
        raise ArgumentError(f"expected a port from 0 to 65535, got {port}")
    if not address.strip():  # sockets would listen at all addresses
        raise ArgumentError(
            "expected an address to listen at, got none; leave --address out for this machine "
            "alone, or say 0.0.0.0 for all its addresses"
        )
    from bokeh.application import Application
    from bokeh.document import document
    from bokeh.server.server import BaseServer
    from bokeh.server.tornado import BokehTornado
    from bokeh.util.token import generate_secret_key
    from tornado.ioloop import IOLoop
    from tornado.netutil import bind_sockets

    from polywigner.explorer import visits
    from polywigner.explorer.computing import Scheduler
    from polywigner.explorer.page.session import open_page
    from polywigner.explorer.readings import Readings

    keep_short()
    # Bokeh collects the garbage of the whole process for each page that goes: of fifty that go
    # together, for half a minute. The scheduler does so once for all.
    document.gc = SimpleNamespace(collect=lambda: 0)
    visits.served_hosts(address, port, allow_host)  # its error, before anything is opened
    try:
        sockets = bind_sockets(port, address)
    except (OSError, ValueError) as error:
        raise ArgumentError(_refusal(error, address, port)) from None
    port = sockets[0].getsockname()[1]
    scheduler, readings = Scheduler(), Readings()
    application = BokehTornado(
        Application(visits.Pages(lambda doc: open_page(doc, state, scheduler, readings))),
        extra_websocket_origins=["*"],  # the guard looks at origins
        secret_key=generate_secret_key().encode(),
        sign_sessions=True,
        unused_session_lifetime_milliseconds=round(1e3 * patience),
        check_unused_sessions_milliseconds=round(1e3 * patience / 3),
        websocket_max_message_size_bytes=visits.LARGEST_MESSAGE,
        keep_alive_milliseconds=0,  # Bokeh's pings, for whose answers it does not wait
        websocket_ping_interval=patience,
        websocket_ping_timeout=patience,
    )
    http = visits.LimitedServer(
        application,
        max_header_size=_LARGEST_HEADER,
        max_body_size=_LARGEST_BODY,
        idle_connection_timeout=patience,
        body_timeout=patience / 3,
    )
    http.add_sockets(sockets)
    server: Any = BaseServer(IOLoop.current(), application, http)
    turns = visits.route(application)
    hosts = visits.served_hosts(address, port, allow_host)
    visits.guard(application, hosts, port, lambda: (turns.waiting, server.get_sessions("/")))
    server.polywigner_scheduler, server.polywigner_readings = scheduler, readings
    return server


def _refusal(error: Exception, address: str, port: int) -> str:
    in_use = "in use (by another `polywigner explore`?); choose another with --port (0: any free)"
    return {
        errno.EADDRINUSE: f"expected a free port, got {port}, which is {in_use}",
        errno.EACCES: f"expected a port that you may serve at, got {port}; choose one above 1023",
    }.get(
        getattr(error, "errno", None) or 0,
        f"expected an address of this machine, got {address}; choose another with --address",
    )


def serve(
    state: State,
    port: int = PORT,
    address: str = "127.0.0.1",
    browser: bool = True,
    say: Callable[[str], None] = print,
    allow_host: Sequence[str] = (),
) -> bool:
    """Serve the page until Ctrl-C, or SIGTERM; raises as :func:`new_server`.

    Returns
    -------
    Whether nothing is left behind: a computation may go on for a while in a thread of its own.
    """
    server = new_server(state, port, address, allow_host)
    shown = "127.0.0.1" if address in ("0.0.0.0", "::") else address
    url = f"http://{f'[{shown}]' if ':' in shown else shown}:{server.port}/"
    if not _is_local(address):
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


def _is_local(address: str) -> bool:
    """Whether only this machine can reach a server at the address."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def _open(url: str) -> None:
    with suppress(Exception):  # a machine without a browser has the address all the same
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


_FAULTS = "polywigner.explorer"
# what strangers ask for and do not get
_SILENT = ("tornado.access", "tornado.general", "bokeh.server.views.ws")
_LONGEST = 200  # characters of a line: messages of others are quoted in it
_REPEATED_S = 60.0


class Rarely(logging.Filter):
    """Filter: each line of code logs one line a minute, with the number of messages left out.

    Tracebacks are left out too, unless POLYWIGNER_DEBUG is set.
    """

    def __init__(self, seconds: float = _REPEATED_S) -> None:
        super().__init__()
        self.seconds = seconds
        self.written: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is written."""
        own = record.msg if record.name == _FAULTS else ""
        place = f"{record.pathname}:{record.lineno}:{own}"
        since, left_out = self.written.get(place, (-math.inf, 0))
        if record.created - since < self.seconds:
            self.written[place] = since, left_out + 1
            return False
        self.written[place] = record.created, 0
        error = record.exc_info[1] if record.exc_info else None
        if error is not None and not os.environ.get("POLYWIGNER_DEBUG"):
            what = str(record.msg).split("%", 1)[0].split("\n", 1)[0].strip()
            text = f"{what}: {type(error).__name__} (POLYWIGNER_DEBUG=1 shows more)"
            record.exc_info, record.exc_text = None, None
        else:
            text = record.getMessage()
        text = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} …"
        record.msg = f"{text} (and {left_out} more)" if left_out else text
        record.args = ()
        return True


_RARELY = Rarely()


def keep_short() -> None:
    """Set up the loggers of the server: few lines, and no traceback that nobody asked for."""
    logging.getLogger("bokeh").setLevel(logging.ERROR)
    for name in _SILENT:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    of_bokeh = [name for name in logging.root.manager.loggerDict if name.startswith("bokeh.")]
    for name in {_FAULTS, "tornado.application", "asyncio", *of_bokeh}.difference(_SILENT):
        logging.getLogger(name).addFilter(_RARELY)  # once: Python looks whether it is there
