"""The explorer answers its own page, and no page of another site."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from typing import NamedTuple, NoReturn
from urllib.parse import urlsplit

import pytest

from explorer_server import (
    FORBIDDEN,
    NOT_FOUND,
    NOT_MODIFIED,
    OK,
    SWITCHED,
    UNAVAILABLE,
    UPGRADE,
    ask,
    handshake,
    need_bokeh,
    running,
)
from polywigner.errors import ArgumentError
from polywigner.explorer.server import new_server
from polywigner.explorer.state import State

FOREIGN = ("evil.example:{}", "evil.example", "127.0.0.1:1", "127.0.0.1.evil.example:{}", "*:{}")
UNCONNECTED, PAGES = 24, 100  # that docs/explorer.md promises
SCRIPT = "/static/js/bokeh.min.js"  # takes less time than a page


@pytest.fixture(scope="module", autouse=True)
def bokeh(leave_out: Callable[[str], NoReturn]) -> None:
    """These tests are left out without the library of the page."""
    need_bokeh(leave_out)


@pytest.fixture(scope="module")
def address(bokeh: None) -> Iterator[str]:
    with running("127.0.0.1") as url:
        yield url


@pytest.fixture(scope="module")
def everywhere(bokeh: None) -> Iterator[str]:
    """A server at all addresses of the machine, which answers to two more names."""
    with running("0.0.0.0", "mine.example", "other.example:8443") as url:
        yield url


def port(url: str) -> int:
    return int(urlsplit(url).port or 0)


@pytest.mark.parametrize("name", FOREIGN)
def test_a_request_for_another_host_is_refused_and_learns_nothing(address: str, name: str) -> None:
    host = name.format(port(address))
    for path in (
        "/",
        SCRIPT,
        "/autoload.js?bokeh-autoload-element=1",
        "/nowhere",
    ):
        answer = ask(address, path, {"Host": host})
        assert answer.status == FORBIDDEN, path
        assert "--allow-host" in answer.text and "<" not in answer.text and "{" not in answer.text
    assert handshake(address, f"http://{host}", host) == FORBIDDEN
    assert ask(address, "/ws", {**UPGRADE, "Host": host}).status == FORBIDDEN  # without an origin


@pytest.mark.parametrize("name", ["127.0.0.1:{}", "localhost:{}", "[::1]:{}", "LOCALHOST:{}"])
def test_the_machine_itself_is_answered(address: str, name: str) -> None:
    host = name.format(port(address))
    assert ask(address, SCRIPT, {"Host": host}).status == OK
    assert handshake(address, f"http://{host}", host) == SWITCHED


def test_its_own_page_is_answered(address: str) -> None:
    answer = ask(address)
    assert answer.status == OK and "polywigner explore" in answer.text


def test_pages_of_other_sites_cannot_connect(address: str) -> None:
    assert handshake(address, address.rstrip("/")) == SWITCHED
    for origin in ("http://example.org", "http://localhost:1", "null", "http://["):
        assert handshake(address, origin) == FORBIDDEN
        assert ask(address, "/", {"Origin": origin}).status == FORBIDDEN


def test_nor_where_every_address_of_the_machine_is_served(everywhere: str) -> None:
    assert handshake(everywhere, everywhere.rstrip("/")) == SWITCHED
    assert handshake(everywhere, "http://example.org") == FORBIDDEN
    for name in (*FOREIGN, "0.0.0.0:{}"):
        host = name.format(port(everywhere))
        assert ask(everywhere, "/", {"Host": host}).status == FORBIDDEN
        assert handshake(everywhere, f"http://{host}", host) == FORBIDDEN


def test_there_the_name_of_the_machine_and_allowed_names_are_answered(everywhere: str) -> None:
    own = port(everywhere)
    hosts = (f"{socket.gethostname()}:{own}", f"mine.example:{own}", "other.example:8443")
    for host in hosts:
        assert ask(everywhere, SCRIPT, {"Host": host}).status == OK
        assert handshake(everywhere, f"https://{host}", host) == SWITCHED
    assert ask(everywhere, "/", {"Host": "other.example:8444"}).status == FORBIDDEN


def test_there_the_address_that_the_request_came_to_is_answered(everywhere: str) -> None:
    """127.0.0.2 stands for an address in the network: one of the machine, named nowhere."""
    host = f"127.0.0.2:{port(everywhere)}"
    assert ask(f"http://{host}/", SCRIPT).status == OK
    assert ask(everywhere, "/", {"Host": host}).status == FORBIDDEN


@pytest.mark.parametrize("name", ["*", "", "*.example", "http://mine.example", "mine.example:port"])
def test_a_host_that_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(ArgumentError, match="expected a host"):
        new_server(State(), port=0, allow_host=[name])


HEADERS = {
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


def test_every_answer_says_that_no_other_page_may_frame_it_or_learn_its_address(
    address: str,
) -> None:
    unchanged = {"If-None-Match": ask(address, SCRIPT).headers["ETag"]}
    answers = {
        OK: [ask(address), ask(address, SCRIPT)],
        FORBIDDEN: [ask(address, headers={"Host": "evil.example"})],
        NOT_FOUND: [ask(address, "/nowhere")],
        SWITCHED: [ask(address, "/ws", UPGRADE)],
        NOT_MODIFIED: [ask(address, SCRIPT, unchanged)],
    }
    for status, of_status in answers.items():
        for answer in of_status:
            assert answer.status == status
            assert {name: answer.headers[name] for name in HEADERS} == HEADERS


class Session(NamedTuple):
    """What the guard asks of a session."""

    connection_count: int


@pytest.mark.parametrize(
    ("connected", "unconnected", "waiting", "refused"),
    [
        (0, 0, 0, False),
        (0, UNCONNECTED - 1, 0, False),
        (0, UNCONNECTED, 0, True),
        (0, 1, UNCONNECTED - 1, True),
        (UNCONNECTED, 0, 0, False),
        (PAGES - 1, 0, 0, False),
        (PAGES - 1, 0, 1, True),
    ],
)
def test_pages_are_limited_in_number_and_those_that_nobody_is_at_more_so(
    connected: int, unconnected: int, waiting: int, refused: bool, bokeh: None
) -> None:
    from tornado.httputil import HTTPHeaders, HTTPServerRequest, RequestStartLine
    from tornado.web import Application, RequestHandler

    from polywigner.explorer.visits import guard

    sessions = [Session(1)] * connected + [Session(0)] * unconnected
    application = Application([(".*", RequestHandler)])
    guard(application, frozenset({"mine:1"}), 1, lambda: (waiting, sessions))

    def status(path: str) -> int:
        headers = HTTPHeaders({"Host": "mine:1"})
        line = RequestStartLine("GET", path, "HTTP/1.1")
        request = HTTPServerRequest(start_line=line, headers=headers)
        return int(application.find_handler(request).handler_kwargs.get("status", OK))

    assert status("/") == status("/ws") == (UNAVAILABLE if refused else OK)
    assert status(SCRIPT) == OK
