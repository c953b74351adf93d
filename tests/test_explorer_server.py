"""The explorer's server goes on answering, whatever clients and files do to it."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn
from urllib.parse import urlsplit

import pytest

from explorer_server import (
    OK,
    SECONDS,
    UNAVAILABLE,
    UPGRADE,
    Visit,
    ask,
    frames,
    need_panel,
    running,
)
from polywigner.errors import FileFormatError, PolywignerError
from polywigner.explorer.server import RateLimitFilter, keep_short
from polywigner.explorer.uploads import Uploads

SQUARE = b"POLYGON((0 0, 3 0, 3 2, 0 2, 0 0))"
SCRIPT = "/static/js/bokeh.min.js"
QUICK_LOADS = 25  # of one visitor, more than the 24 pages that are kept for browsers to connect
PROMISED_S = 2.0  # docs/promises.md: what one visitor does keeps others waiting so long at most
ENDED_S = 40.0  # docs/explorer.md: half a request ends after 15 s, a page that is silent after 30 s


@pytest.fixture(scope="module")
def address(leave_out: Callable[[str], NoReturn]) -> Iterator[str]:
    need_panel(leave_out)
    with running("127.0.0.1") as url:
        ask(url)  # the first page imports what others find there
        yield url


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where files are put meanwhile, and nothing of others."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("limit", [{"seconds": 0.05}, {"memory": 32 << 20}])
def test_a_file_that_takes_too_much_is_given_up_and_nothing_of_it_stays(
    limit: dict[str, Any], folder: Path
) -> None:
    uploads = Uploads(**limit)
    with pytest.raises(FileFormatError, match=r"a\.wkt: expected a file that is read within"):
        asyncio.run(uploads.rings("a.wkt", SQUARE, "mm"))
    assert not uploads.processes and not [*folder.iterdir()]


def test_a_visitor_who_leaves_or_sends_another_file_ends_what_was_read(folder: Path) -> None:
    came: list[Any] = []

    async def visit() -> None:
        uploads = Uploads()
        with pytest.raises(PolywignerError, match="expected GeoJSON"):
            uploads.submit("first", "a.exe", b"MZ", "mm", print)
        await asyncio.sleep(0)
        assert not uploads.processes  # of a file that is none of the page's
        uploads.submit("first", "a.wkt", SQUARE, "mm", came.append)
        uploads.submit("second", "old.wkt", SQUARE, "mm", lambda _: came.append("old"))
        while not uploads.processes:  # others are answered meanwhile
            await asyncio.sleep(0.01)
        process = next(iter(uploads.processes))
        uploads.forget("first")
        uploads.submit("second", "new.wkt", b"POINT(0 0)", "mm", came.append)
        while len(came) < 2:
            await asyncio.sleep(0.01)
        await process.wait()
        assert process.returncode != 0 and not uploads.processes

    asyncio.run(asyncio.wait_for(visit(), SECONDS))
    lost, bad = map(str, came)
    assert "the connection was lost" in lost and "new.wkt: expected" in bad
    assert not [*folder.iterdir()]


def test_quick_loads_of_one_visitor_do_not_keep_another_out(address: str) -> None:
    """Two addresses of this machine are two visitors."""
    start = time.monotonic()
    assert ask(address, visitor="127.0.0.3").status == OK
    page = time.monotonic() - start  # on this machine, with what else it does
    with ThreadPoolExecutor(QUICK_LOADS) as pool:
        loads = [pool.submit(ask, address, visitor="127.0.0.1") for _ in range(QUICK_LOADS)]
        time.sleep(page / 2)
        start = time.monotonic()
        other = Visit(address, visitor="127.0.0.2")
        waited = time.monotonic() - start
        statuses = [load.result().status for load in loads]
    # one page, the pause after it and one of another turn come before, and then the page itself
    assert waited < max(PROMISED_S, 6 * page)
    assert OK in statuses and set(statuses) == {OK, UNAVAILABLE}

    async def visit() -> None:
        await other.pull()
        await other.until(lambda told: told["kind"] == "ready")

    asyncio.run(visit())


class Waiting:
    """A page as the server has it."""

    def __init__(self, visitor: str, connection_count: int = 0) -> None:
        self.visitor, self.connection_count = visitor, connection_count
        self.expiration_requested = False

    def request_expiration(self) -> None:
        self.expiration_requested = True


def test_pages_that_nobody_opens_make_room_and_those_of_another_visitor_stay() -> None:
    from polywigner.explorer.guard import Visits

    other, opened = Waiting("b"), Waiting("a", connection_count=1)
    pages = [other, opened, *(Waiting("a") for _ in range(QUICK_LOADS))]
    server: Any = SimpleNamespace(get_sessions=lambda path: pages)
    Visits(server).make_room()
    gone = [k for k, page in enumerate(pages) if page.expiration_requested]
    assert gone == [2, 3]  # the oldest of the visitor with most of them


@pytest.mark.parametrize(
    ("own", "others", "full"), [(49, 0, False), (50, 0, True), (0, 99, False), (0, 100, True)]
)
def test_pages_are_limited_in_number_and_those_of_one_visitor_more_so(
    own: int, others: int, full: bool
) -> None:
    from polywigner.explorer.guard import Visits

    pages = [Waiting("a", 1)] * own + [Waiting("b", 1)] * others
    server: Any = SimpleNamespace(get_sessions=lambda path: pages)
    assert Visits(server).is_full("a") == full


def test_visitors_take_turns_and_the_newest_requests_of_one_count() -> None:
    from polywigner.explorer.guard import Turns

    made: list[str] = []

    async def ask_for(turns: Any, name: str) -> None:
        async with turns.turn(name[0]) as granted:
            made.append(name if granted else f"not {name}")

    async def visit() -> None:
        turns = Turns()
        names = ["a0", "a1", "a2", "a3", "a4", "a5", "b0", "b1"]
        await asyncio.gather(*(ask_for(turns, name) for name in names))

    asyncio.run(visit())
    assert made == ["a0", "not a1", "a2", "b0", "a3", "b1", "a4", "a5"]


@pytest.fixture(scope="module")
def page(address: str) -> Visit:
    """A page that has been made, whose browser has gone a moment ago."""
    found = Visit(address, "/?wave=77%20GHz")
    assert found.token

    async def visit() -> None:
        await found.pull()
        found.socket.close()

    asyncio.run(visit())
    assert found.get("wave", "value") == "77 GHz"  # as its link says
    return found


@pytest.mark.parametrize("damage", ["none", "e30", "e30.e30", "cut", "bomb", "unsigned"])
def test_a_token_of_another_server_opens_no_page(address: str, damage: str, page: Visit) -> None:
    from bokeh.util.token import generate_jwt_token, generate_session_id

    made = {"unsigned": {}, "bomb": {"arguments": "0" * 2**20}}  # a megabyte when it is unpacked
    token = damage if damage != "cut" else page.token[:-1]
    if damage in made:
        session = generate_session_id()
        token = generate_jwt_token(session, signed=False, extra_payload=made[damage])

    async def visit() -> Any:
        return await asyncio.wait_for((await page.connect(token)).read_message(), SECONDS)

    assert asyncio.run(visit()) is None


def patch(*events: Any) -> list[str]:
    return frames("PATCH-DOC", {"events": list(events)})


NOWHERE = {"kind": "ModelChanged", "model": {"id": "p9"}, "attr": "value", "new": 1}
ROOT = {"kind": "RootAdded", "model": {"type": "object", "name": "Div", "id": "p9"}}
ROWS = {"kind": "ColumnsStreamed", "model": {"id": "p9"}, "data": {"x": [1]}, "rollover": None}
PARTS = frames("PATCH-DOC", {"events": []}, num_buffers=1000)
BAD: dict[str, list[Any]] = {
    "bytes": [os.urandom(100)],
    "text": ["\x00" * 100] * 3,
    "no header": ["{}", "{}", "{}"],
    "lists": ["[]", "[]", "[]"],
    "deep": ['{"a":' * 1000] * 3,
    "no events": frames("PATCH-DOC", {}),
    "events of nothing": patch(None, 1, "a"),
    "another kind": frames("ACK", {}),
    "unknown kind": frames("NONE", {}),
    "no model": patch(NOWHERE) * 5,
    "whole document": frames("PUSH-DOC", {"doc": {"roots": []}}),
    "more models": patch(ROOT),
    "more rows": patch(ROWS),
    "too long": ["0" * ((4 << 20) + 1)],
    "too long in parts": [*PARTS, *(['{"id": "1"}', bytes(1 << 20)] * 5)],
}


@pytest.mark.parametrize("name", BAD)
def test_messages_that_are_none_of_the_pages_end_it_and_are_a_line_at_most(
    address: str, name: str, page: Visit, caplog: pytest.LogCaptureFixture
) -> None:
    from tornado.websocket import WebSocketClosedError

    keep_short()

    async def attack() -> bool:
        await page.connect()
        assert (await page.receive() or [""])[0] == "ACK"
        with suppress(WebSocketClosedError):
            for frame in BAD[name]:
                await page.socket.write_message(frame, binary=isinstance(frame, bytes))
            await page.send("SERVER-INFO-REQ", {})  # what comes before has been read then
        answer = await page.receive()
        while answer is not None and answer[0] != "SERVER-INFO-REPLY":
            answer = await page.receive()
        page.socket.close()
        return answer is None

    with caplog.at_level(logging.WARNING):
        ended = asyncio.run(attack())
    assert ended or name == "no model"  # which Bokeh answers
    assert len(caplog.records) <= 1 and "Traceback" not in caplog.text
    assert ask(address, SCRIPT).status == OK


def test_a_fault_that_repeats_is_told_once_and_then_counted() -> None:
    logger = logging.Logger("bokeh.any")
    written: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: written.append(record.getMessage())  # type: ignore[method-assign]
    logger.addHandler(handler)
    limit = RateLimitFilter(seconds=60.0)
    logger.addFilter(limit)
    for k in range(1000):
        logger.error("damaged message %r", "x" * 10_000 + str(k))
    assert len(written) == 1 and len(written[0]) < 300
    limit.seconds = 0.0
    logger.error("damaged message %r", "x")
    logger.error("another")
    assert len(written) == 3


def test_clients_that_ask_for_nothing_keep_nobody_out_but_open_pages_stay() -> None:
    from polywigner.explorer.guard import Connections

    class Stream:
        """A connection as Tornado has it."""

        def __init__(self, is_page: bool = False) -> None:
            self.socket, self.is_page = socket.socket(), is_page

        def closed(self) -> bool:
            return self.socket.fileno() < 0

        def close(self) -> None:
            self.socket.close()

    served: list[Any] = []
    door = Connections(lambda stream, _: served.append(stream), 3)
    page, idle, second, third, fourth = Stream(True), Stream(), Stream(), Stream(), Stream()
    for stream in (page, idle, second, third):
        door.handle(stream, None)
    assert idle.closed() and not any(made.closed() for made in (page, second, third))
    second.is_page = third.is_page = True
    door.handle(fourth, None)
    assert fourth.closed() and served == [page, idle, second, third]
    page.close()
    door.handle(fifth := Stream(), None)
    assert served[-1] is fifth and not fifth.closed()
    for stream in (second, third, fifth):
        stream.close()


@pytest.mark.slow  # it waits for half a minute
def test_half_a_request_and_a_silent_page_come_to_an_end(address: str) -> None:
    place = urlsplit(address)
    token = Visit(address).token
    upgrade = {**UPGRADE, "Sec-WebSocket-Protocol": f"bokeh, {token}", "Host": place.netloc}
    head = "".join(f"{name}: {value}\r\n" for name, value in upgrade.items())
    requests = {
        "nothing": "",
        "half of its headers": "GET / HTTP/1.1\r\nHost: ",
        "half a body": f"POST / HTTP/1.1\r\nHost: {place.netloc}\r\nContent-Length: 9\r\n\r\n1",
        "no pong": f"GET /ws HTTP/1.1\r\n{head}\r\n",
    }
    for kind, text in requests.items():
        with closing(socket.create_connection((place.hostname, place.port))) as client:
            until = time.monotonic() + ENDED_S
            client.sendall(text.encode())
            while True:
                client.settimeout(max(0.1, until - time.monotonic()))
                try:
                    if client.recv(1 << 16) == b"":
                        break
                except ConnectionResetError:
                    break
                except TimeoutError:
                    pytest.fail(f"a client that sends {kind} was kept")


def columns(**data: Any) -> dict[str, Any]:
    """Data of a source as browsers send them."""
    return {"type": "map", "entries": [[name, values] for name, values in data.items()]}


class Visitor(Visit):
    """A visitor who presses keys and reads the table."""

    async def press(self, key: str, says: str, figure: str = "aperture", shift: int = 0) -> None:
        """Press a key, and wait until the page says this."""
        pressed = {"kind": ["key"], "key": [key], "figure": [figure], "shift": [bool(shift)]}
        await self.set("heard", "data", columns(**pressed, time=[time.time()]))
        await self.until(lambda told: says in told["message"])

    async def ready(self) -> dict[str, Any]:
        await asyncio.sleep(0.2)  # what was sent is being done
        return await self.until(lambda told: told["kind"] != "computing")

    def rows(self) -> list[tuple[float, ...]]:
        data = self.get("rows", "data")
        known = dict(data.get("entries") or data.items())
        return list(zip(known["ring"], known["x"], known["y"], strict=True))


def visited(url: str, act: Callable[[Visitor], Any], path: str = "/") -> None:
    """Let a visitor act on a page that is ready."""

    async def visit() -> None:
        page = Visitor(url, path)
        await page.pull()
        await page.ready()
        await act(page)
        page.socket.close()

    asyncio.run(visit())


def test_keys_choose_move_add_and_delete_vertices_and_positions(address: str) -> None:
    async def act(page: Visitor) -> None:
        await page.press("n", "Vertex 1 of 4: (-5, -5) mm")
        await page.press("ArrowUp", "Vertex 1 of 4: (-5, -4.9) mm")
        await page.press("ArrowRight", "Vertex 1 of 4: (-4, -4.9) mm", shift=1)
        await page.press("Insert", "Vertex 2 of 5: (0.5, -4.95) mm")
        await page.press("p", "Vertex 1 of 5")
        await page.press("p", "Vertex 5 of 5")
        await page.press("Delete", "Vertex 1 of 4")
        await page.press("Escape", "")
        await page.press("ArrowLeft", "x = (-0.1, 0) mm")
        await page.press("ArrowDown", "ν = (0, -0.005) 1/mm", "fourier")
        await page.press("undo", "")
        await page.ready()
        assert page.rows()[:2] == [(1, -4, -4.9), (1, 0.5, -4.95)]

    visited(address, act)


def test_what_is_typed_is_computed_or_refused_with_a_sentence(address: str) -> None:
    async def act(page: Visitor) -> None:
        await page.set("rows", "data", columns(ring=[1] * 3, x=[0, 4, 0], y=[0, 0, 4]))
        assert "8 mm²" in (await page.until(lambda told: "<td>8 mm²" in told["values"]))["values"]
        await page.set("unit", "value", "cm")
        await page.until(lambda told: "<td>8 cm²" in told["values"])
        assert page.get("x", "title") == "x (cm)"
        await page.set("wave", "value", "<b>ten</b>")
        told = await page.until(lambda told: told["message"])
        assert "expected a frequency" in told["message"] and "<b>" not in told["message"]
        assert page.get("wave", "value") == "94 GHz"
        await page.set("coherence", "value", 30.0)
        await page.until(lambda told: told["kind"] == "computing")
        await page.ready()
        assert page.get("coherence", "end") == 30.0
        await page.set("rows", "data", columns(ring=[1] * 4, x=[0, 4, 0, 4], y=[0, 0, 4, 4]))
        told = await page.until(lambda told: "earlier" in told["status"])
        assert "crosses itself" in told["message"] and "lags" in told["stale"]

    visited(address, act)


@pytest.mark.parametrize(
    ("length", "step"), [(0.14, 0.1), (0.2, 0.2), (4.999, 2.0), (50.0, 50.0), (7e-9, 5e-9)]
)
def test_steps_of_keys_are_round(length: float, step: float, address: str) -> None:
    from polywigner.explorer.page import moved, round_step

    assert round_step(length) == pytest.approx(step, rel=1e-12)
    assert moved((0.3, -0.1), "ArrowDown", 0.1) == (0.3, -0.2)
