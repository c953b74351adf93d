"""A running server of the explorer's page, and requests as browsers and others send them."""

from __future__ import annotations

import asyncio
import importlib.util
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from http.client import HTTPConnection, HTTPMessage
from typing import Any, NamedTuple, NoReturn
from urllib.parse import urlsplit

from polywigner.explorer.state import State

SECONDS = 20.0  # for anything to happen on a loaded machine
SWITCHED, OK, NOT_MODIFIED = 101, 200, 304
FORBIDDEN, NOT_FOUND, UNAVAILABLE = 403, 404, 503
UPGRADE = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "bokeh, none",
}  # fmt: skip


def need_bokeh(leave_out: Callable[[str], NoReturn]) -> None:
    """Leave a test out where the library of the page is missing."""
    if importlib.util.find_spec("bokeh") is None:
        leave_out('Bokeh. `pip install ".[explorer]"` brings it.')


class Answer(NamedTuple):
    """What came back."""

    status: int
    headers: HTTPMessage
    text: str


@contextmanager
def running(address: str, *allow_host: str, patience: float = 15.0) -> Iterator[str]:
    """The address of a server of the page that listens there."""
    from polywigner.explorer.server import new_server

    started = threading.Event()
    server: list[Any] = []

    def run() -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        server.append(new_server(State(), 0, address, allow_host, patience))
        server[0].start()
        started.set()
        server[0].io_loop.start()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert started.wait(SECONDS)
    yield f"http://127.0.0.1:{server[0].port}/"
    server[0].io_loop.add_callback(server[0].io_loop.stop)
    thread.join(SECONDS)
    server[0].polywigner_scheduler.stop()


def ask(url: str, path: str = "/", headers: Mapping[str, str] | None = None) -> Answer:
    """The answer to a GET; a Host among the headers takes the place of the true one."""
    parts = urlsplit(url)
    connection = HTTPConnection(str(parts.hostname), parts.port, timeout=SECONDS)
    with closing(connection):
        connection.request("GET", path, headers=dict(headers or {}))
        with connection.getresponse() as response:
            switched = response.status == SWITCHED
            text = "" if switched else response.read().decode("utf-8", "replace")
            return Answer(response.status, response.headers, text)


def handshake(url: str, origin: str, host: str | None = None) -> int:
    """What the server says to a page of this origin that wants its websocket."""
    asked = {"Origin": origin, **({} if host is None else {"Host": host})}
    return ask(url, "/ws", {**UPGRADE, **asked}).status
