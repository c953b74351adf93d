"""The explorer's server goes on answering, whatever clients and files do to it."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from inspect import signature
from pathlib import Path
from tempfile import gettempdir
from typing import Any, NoReturn
from urllib.parse import urlsplit

import pytest

from explorer_server import OK, SECONDS, UPGRADE, ask, need_bokeh, running
from polywigner.errors import FileFormatError, PolywignerError
from polywigner.explorer.readings import Readings
from polywigner.explorer.server import Rarely, keep_short, new_server

SQUARE = b"POLYGON((0 0, 3 0, 3 2, 0 2, 0 0))"
SCRIPT = "/static/js/bokeh.min.js"
MORE_THAN_WAIT = 30  # pages; of 24 that are made, a server without connections to them refuses more


@pytest.fixture(scope="module", autouse=True)
def bokeh(leave_out: Callable[[str], NoReturn]) -> None:
    """These tests are left out without the library of the page."""
    need_bokeh(leave_out)


@pytest.fixture(scope="module")
def address(bokeh: None) -> Iterator[str]:
    with running("127.0.0.1") as url:
        yield url


def left_over() -> set[Path]:
    return set(Path(gettempdir()).glob("polywigner-*"))


def test_while_a_file_is_read_others_are_answered() -> None:
    done: list[str] = []

    async def read(readings: Readings) -> None:
        await readings.rings("a.wkt", SQUARE, "mm")
        done.append("file")

    async def answer() -> None:
        await asyncio.sleep(0)
        done.append("another visitor")

    async def both() -> None:
        await asyncio.gather(read(Readings()), answer())

    asyncio.run(both())
    assert done == ["another visitor", "file"]


@pytest.mark.parametrize("limit", [{"seconds": 0.05}, {"memory": 32 << 20}])
def test_a_file_that_takes_too_much_is_given_up_and_nothing_of_it_stays(
    limit: dict[str, Any],
) -> None:
    before = left_over()
    readings = Readings(**limit)
    with pytest.raises(FileFormatError, match=r"a\.wkt: expected a file that is read within"):
        asyncio.run(readings.rings("a.wkt", SQUARE, "mm"))
    assert not readings.processes and left_over() <= before


def test_a_visitor_who_leaves_or_sends_another_file_ends_what_was_read() -> None:
    before = left_over()
    came: list[Any] = []

    async def visit() -> None:
        readings = Readings()
        readings.submit("first", "a.wkt", SQUARE, "mm", lambda _: came.append("first"))
        readings.submit("second", "old.wkt", SQUARE, "mm", lambda _: came.append("old"))
        while not readings.processes:
            await asyncio.sleep(0.01)
        process = next(iter(readings.processes))
        readings.forget("first")
        readings.submit("second", "new.wkt", b"POINT(0 0)", "mm", came.append)
        while not came:
            await asyncio.sleep(0.01)
        await process.wait()
        while readings.processes:
            await asyncio.sleep(0.01)
        assert process.returncode != 0

    asyncio.run(asyncio.wait_for(visit(), SECONDS))
    (bad,) = map(str, came)
    assert "new.wkt: expected" in bad
    assert left_over() <= before


def test_files_that_are_no_files_of_the_page_start_no_process() -> None:
    async def submit() -> None:
        readings = Readings()
        with pytest.raises(PolywignerError, match="expected GeoJSON"):
            readings.submit("visitor", "a.exe", b"MZ", "mm", print)
        await asyncio.sleep(0)
        assert not readings.processes

    asyncio.run(submit())


def test_pages_that_are_asked_for_and_not_opened_cost_nothing(address: str) -> None:
    assert {ask(address).status for _ in range(MORE_THAN_WAIT)} == {OK}


def token_of(url: str, path: str = "/") -> str:
    text = ask(url, path).text
    return text.split('"token":"')[1].split('"')[0]


async def websocket(url: str, token: str) -> Any:
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    place = urlsplit(url).netloc
    request = HTTPRequest(f"ws://{place}/ws", headers={"Origin": f"http://{place}"})
    return await websocket_connect(request, subprotocols=["bokeh", token])


async def received(socket: Any) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Header and content of the next message; None at the end, also of half a message."""

    async def texts() -> list[Any]:
        found: list[Any] = []
        expected = 3
        while len(found) < expected:
            found.append(await socket.read_message())
            if found[-1] is None:
                break
            if len(found) == 1:
                expected += 2 * json.loads(found[0]).get("num_buffers", 0)
        return found

    found = await asyncio.wait_for(texts(), SECONDS)
    return None if None in found else (json.loads(found[0]), json.loads(found[2]))


def frames(kind: str, content: Any, **header: Any) -> list[str]:
    told = {"msgid": "1", "msgtype": kind, **header}
    return [json.dumps(told), "{}", json.dumps(content)]


async def connected(url: str, token: str) -> Any:
    """The websocket of a page that is there, or is made now."""
    made = await websocket(url, token)
    header, _ = await received(made) or ({}, {})
    assert header["msgtype"] == "ACK"
    return made


@pytest.fixture(scope="module")
def page(address: str) -> tuple[str, str]:
    """The token of a page that has been made, and its document."""
    token = token_of(address, "/?wave=77%20GHz")

    async def visit() -> str:
        made = await connected(address, token)
        for frame in frames("PULL-DOC-REQ", {}):
            await made.write_message(frame)
        header, content = await received(made) or ({}, {})
        while header["msgtype"] != "PULL-DOC-REPLY":
            header, content = await received(made) or ({"msgtype": "PULL-DOC-REPLY"}, {})
        made.close()
        return json.dumps(content)

    return token, asyncio.run(visit())


def test_a_page_is_made_of_its_link_when_its_browser_connects(page: tuple[str, str]) -> None:
    assert "77 GHz" in page[1]


def test_an_edit_of_a_browser_comes_back_with_its_numbers(address: str) -> None:
    async def visit() -> str:
        made = await connected(address, token_of(address))
        for frame in frames("PULL-DOC-REQ", {}):
            await made.write_message(frame)
        texts = [""]
        while "<td>80 mm²</td>" not in texts[-1]:
            header, content = await received(made) or ({"msgtype": "the end"}, {})
            texts.append(json.dumps(content, ensure_ascii=False))
            if header["msgtype"] == "PULL-DOC-REPLY":
                (x,) = re.findall(r'"id": "(p\d+)", "attributes": {"name": "x"', texts[-1])
                # W(x, 0) of 10 mm is four times (10 - 8) mm by 10 mm
                change = {"kind": "ModelChanged", "model": {"id": x}, "attr": "value", "new": 4.0}
                for frame in patch(change):
                    await made.write_message(frame)
            assert header["msgtype"] != "the end"
        made.close()
        return texts[-1]

    assert "W(x, 0)" in asyncio.run(asyncio.wait_for(visit(), 3 * SECONDS))


@pytest.mark.parametrize("damage", ["none", "e30", "e30.e30", "", "cut", "bomb"])
def test_a_token_of_another_server_opens_no_page(address: str, damage: str) -> None:
    from bokeh.util.token import generate_jwt_token, generate_session_id

    token = damage
    if damage == "cut":
        token = token_of(address)[:-1]
    if damage == "bomb":  # a megabyte when it is unpacked
        token = generate_jwt_token(
            generate_session_id(), signed=False, extra_payload={"arguments": "0" * 2**20}
        )

    async def visit() -> Any:
        made = await websocket(address, token or "-")
        return await asyncio.wait_for(made.read_message(), SECONDS)

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
def test_messages_that_are_none_of_the_pages_are_a_line_at_most(
    address: str, page: tuple[str, str], name: str, caplog: pytest.LogCaptureFixture
) -> None:
    from tornado.websocket import WebSocketClosedError

    keep_short()

    async def attack() -> None:
        made = await connected(address, page[0])
        with suppress(WebSocketClosedError):
            for frame in BAD[name]:
                await made.write_message(frame, binary=isinstance(frame, bytes))
        for frame in frames("SERVER-INFO-REQ", {}):  # what comes before has been read then
            with suppress(WebSocketClosedError):
                await made.write_message(frame)
        answer = await received(made)
        while answer is not None and answer[0]["msgtype"] != "SERVER-INFO-REPLY":
            answer = await received(made)
        made.close()

    with caplog.at_level(logging.WARNING):
        asyncio.run(attack())
    assert len(caplog.records) <= 1 and "Traceback" not in caplog.text
    assert ask(address, SCRIPT).status == OK


def test_a_fault_that_repeats_is_told_once_and_then_counted() -> None:
    logger = logging.Logger("bokeh.any")
    written: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: written.append(record.getMessage())  # type: ignore[method-assign]
    logger.addHandler(handler)
    rarely = Rarely(seconds=60.0)
    logger.addFilter(rarely)
    for k in range(1000):
        logger.error("damaged message %r", "x" * 10_000 + str(k))
    assert len(written) == 1 and len(written[0]) < 300
    rarely.seconds = 0.0
    logger.error("damaged message %r", "x")
    logger.error("another")
    assert len(written) == 3


def test_clients_that_ask_for_nothing_keep_nobody_out_but_open_pages_stay() -> None:
    from tornado.netutil import bind_sockets
    from tornado.web import Application

    from polywigner.explorer.visits import LimitedServer

    async def visit() -> None:
        server = LimitedServer(Application())
        server.most = 3
        accepted: list[Any] = []
        serve = server.handle_stream
        server.handle_stream = lambda stream, of: (accepted.append(stream), serve(stream, of))
        (door,) = bind_sockets(0, "127.0.0.1")
        server.add_socket(door)

        async def client() -> asyncio.StreamReader:
            count = len(accepted)
            reader, writer = await asyncio.open_connection(*door.getsockname())
            kept.append(writer)
            while len(accepted) == count:
                await asyncio.sleep(0.01)
            return reader

        kept: list[Any] = []
        page, idle, second = [await client() for _ in range(3)]
        accepted[0].is_page = True
        newest = await client()
        assert await idle.read() == b""  # the oldest that is no page
        kept[3].write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
        assert (await newest.readline()).startswith(b"HTTP/1.1 404")
        accepted[2].is_page = accepted[3].is_page = True
        assert await (await client()).read() == b""  # no room
        assert not (page.at_eof() or second.at_eof())
        kept[0].close()
        await asyncio.sleep(0.1)
        await client()
        assert not accepted[-1].closed()
        server.stop()

    asyncio.run(asyncio.wait_for(visit(), SECONDS))


def test_half_a_request_and_a_silent_page_come_to_an_end() -> None:
    assert signature(new_server).parameters["patience"].default == 15  # docs/explorer.md
    with running("127.0.0.1", patience=1.0) as quick:
        ended = ends_of_requests(quick)
    assert ended == dict.fromkeys(ended, True)


def ends_of_requests(address: str) -> dict[str, bool]:
    """Whether the server ends what clients begin and leave."""
    place = urlsplit(address)
    protocol = {"Sec-WebSocket-Protocol": f"bokeh, {token_of(address)}", "Host": place.netloc}
    upgrade = {**UPGRADE, **protocol}
    head = "".join(f"{name}: {value}\r\n" for name, value in upgrade.items())
    requests = {
        "nothing": "",
        "half of its headers": "GET / HTTP/1.1\r\nHost: ",
        "half a body": f"POST / HTTP/1.1\r\nHost: {place.netloc}\r\nContent-Length: 9\r\n\r\n1",
        "no pong": f"GET /ws HTTP/1.1\r\n{head}\r\n",
    }

    def is_ended(text: str) -> bool:
        until = time.monotonic() + SECONDS
        with closing(socket.create_connection((place.hostname, place.port))) as client:
            client.sendall(text.encode())
            while True:
                client.settimeout(max(0.1, until - time.monotonic()))
                try:
                    if client.recv(1 << 16) == b"":
                        return True
                except ConnectionResetError:
                    return True
                except TimeoutError:
                    return False

    with ThreadPoolExecutor() as pool:
        return dict(zip(requests, pool.map(is_ended, requests.values()), strict=True))
