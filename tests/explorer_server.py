"""A running server of the explorer's page, and requests as browsers and others send them."""

from __future__ import annotations

import asyncio
import importlib.util
import json
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


def need_panel(leave_out: Callable[[str], NoReturn]) -> None:
    """Leave a test out where the library of the page is missing."""
    if importlib.util.find_spec("panel") is None:
        leave_out('Panel. `pip install ".[explorer]"` brings it.')


class Answer(NamedTuple):
    """What came back."""

    status: int
    headers: HTTPMessage
    text: str


@contextmanager
def running(address: str, *allow_host: str) -> Iterator[str]:
    """The address of a server of the page that listens there."""
    from polywigner.explorer.server import new_server

    started = threading.Event()
    server: list[Any] = []

    def run() -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        server.append(new_server(State(), port=0, address=address, allow_host=allow_host))
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


def ask(
    url: str, path: str = "/", headers: Mapping[str, str] | None = None, visitor: str = "127.0.0.1"
) -> Answer:
    """The answer to a GET of a visitor at this address of the machine.

    A Host among the headers takes the place of the true one.
    """
    parts = urlsplit(url)
    connection = HTTPConnection(
        str(parts.hostname), parts.port, timeout=SECONDS, source_address=(visitor, 0)
    )
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


def frames(kind: str, content: Any, **header: Any) -> list[str]:
    """A message of Bokeh's protocol."""
    told = {"msgid": "1", "msgtype": kind, **header}
    return [json.dumps(told), "{}", json.dumps(content)]


class Visit:
    """A page without a browser: its websocket, and its models as the server tells them."""

    def __init__(self, url: str, path: str = "/", visitor: str = "127.0.0.1") -> None:
        self.url = url
        self.token = ask(url, path, visitor=visitor).text.split('"token":"')[1].split('"')[0]
        self.models: dict[str, dict[str, Any]] = {}

    async def connect(self, token: str = "") -> Any:
        """Open the websocket, with another token than the page's own where one is given."""
        from tornado.httpclient import HTTPRequest
        from tornado.websocket import websocket_connect

        place = urlsplit(self.url).netloc
        request = HTTPRequest(f"ws://{place}/ws", headers={"Origin": f"http://{place}"})
        made = websocket_connect(request, subprotocols=["bokeh", token or self.token])
        self.socket: Any = await made
        return self.socket

    async def send(self, kind: str, content: Any) -> None:
        for frame in frames(kind, content):
            await self.socket.write_message(frame)

    async def receive(self) -> tuple[str, dict[str, Any]] | None:
        """Kind and content of the next message; None at the end, also of half a message."""
        found: list[Any] = []
        while len(found) < 3 + 2 * (json.loads(found[0]).get("num_buffers", 0) if found else 0):
            found.append(await asyncio.wait_for(self.socket.read_message(), SECONDS))
            if found[-1] is None:
                return None
        content = json.loads(found[2])
        self._learn(content)
        return str(json.loads(found[0])["msgtype"]), content

    def _learn(self, content: Any) -> None:
        """Keep the models of a message, and what has become of them."""
        if isinstance(content, list):
            for part in content:
                self._learn(part)
        elif isinstance(content, dict):
            if content.get("type") == "object" and "id" in content:
                self.models.setdefault(content["id"], {}).update(content.get("attributes", {}))
            if content.get("kind") in ("ModelChanged", "ColumnDataChanged"):
                attribute, new = (
                    content.get("attr", "data"),
                    content.get("new", content.get("data")),
                )
                self.models.setdefault(content["model"]["id"], {})[attribute] = new
            for part in content.values():
                self._learn(part)

    async def pull(self) -> None:
        """Connect, and get all models."""
        await self.connect()
        assert await self.receive()  # the server's word that it listens
        await self.send("PULL-DOC-REQ", {})
        answer = await self.receive()
        while answer is not None and answer[0] != "PULL-DOC-REPLY":
            answer = await self.receive()

    def _found(self, name: str) -> str:
        for key, model in self.models.items():
            if model.get("name") == name or name in model.get("tags", ()):
                return key
        raise AssertionError(f"the page has no {name}")

    def get(self, name: str, attribute: str) -> Any:
        return self.models[self._found(name)].get(attribute)

    async def set(self, name: str, attribute: str, value: Any) -> None:
        """Change a property of a widget, as a browser does."""
        model = {"id": self._found(name)}
        event = {"kind": "ModelChanged", "model": model, "attr": attribute, "new": value}
        await self.send("PATCH-DOC", {"events": [event]})

    def told(self) -> dict[str, Any]:
        """Texts that the page shows now."""
        data = self.get("told", "data")
        entries = data["entries"] if isinstance(data, dict) and "entries" in data else data.items()
        return {name: value[0] for name, value in entries}

    async def until(self, holds: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
        """Wait for texts that fulfil a condition."""
        while not holds(self.told()):
            assert await self.receive() is not None, self.told()
        return self.told()
