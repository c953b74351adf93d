"""Guard of the server: requests must name it, and come from no page of another site.

A page of another site can have its own name resolved to 127.0.0.1 (DNS rebinding). Its requests
then reach this server, and the browser takes both for one site; but their Host is that name.
"""

from __future__ import annotations

import errno
import logging
import re
import socket
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any
from weakref import WeakSet

from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Matcher, Rule
from tornado.web import Application, OutputTransform, RequestHandler

from polywigner.errors import ArgumentError

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_EVERYWHERE = ("0.0.0.0", "::")
_HOST = re.compile(r"([\w-]+(\.[\w-]+)*|\[[0-9a-f:.]+\])(:\d{1,5})?")
_HTTP_PORT = 80  # browsers leave it out
_FORBIDDEN, _UNAVAILABLE = 403, 503
_MOST_UNCONNECTED = 24  # more than anybody reloads before the first ones are dropped
_REFUSAL = (
    "polywigner explore does not answer to this name. Open the address that the terminal printed, "
    "or allow the name by --allow-host.\n"
)
_MOST_PAGES = 100
_CROWDED = (
    f"polywigner explore has {_MOST_PAGES} pages open, or {_MOST_UNCONNECTED} that wait or were "
    "left a moment ago. Reload this page in 20 seconds.\n"
)


def served_hosts(address: str, port: int, allowed: Iterable[str] = ()) -> frozenset[str]:
    """Values of the Host header by which the server is known, whichever way it is reached.

    Parameters
    ----------
    address : that the server listens at; of 0.0.0.0 and :: the name of the machine is taken.
    port : that the server listens at.
    allowed : further names, each with a port or without.

    Raises
    ------
    ArgumentError for a name that is none, such as a wildcard.
    """
    names = {*_LOOPBACK, socket.gethostname() if address in _EVERYWHERE else address}
    hosts = {host for name in names for host in _with_port(name, port)}
    for name in allowed:
        if not _HOST.fullmatch(name.lower()):
            raise ArgumentError(
                f"expected a host as in mine.example or mine.example:8080, got {name!r}; "
                "name each host by an --allow-host of its own"
            )
        # a server in front of this one may be asked at its own port 80 or 443, which goes unsaid
        hosts |= {name.lower(), *_with_port(name, port)}
    return frozenset(hosts)


def _with_port(name: str, port: int) -> set[str]:
    name = f"[{name}]" if name.count(":") > 1 and not name.startswith("[") else name
    return {f"{name}:{port}".lower(), *({name.lower()} if port == _HTTP_PORT else ())}


def guard(
    application: Application,
    hosts: frozenset[str],
    port: int,
    pages: Callable[[], tuple[int, Sequence[Any]]],
) -> None:
    """Refuse requests for other hosts or from other pages; add headers to all answers.

    Websockets are asked for by HTTP requests, which are refused alike. ``pages`` tells how many
    wait to be made, and the sessions of those that are; there are only so many.
    """
    foreign = {"status": _FORBIDDEN, "text": _REFUSAL}
    crowded = {"status": _UNAVAILABLE, "text": _CROWDED}
    application.default_router.rules[:0] = [
        Rule(_Foreign(hosts, port), _Refusal, foreign),
        Rule(_Crowded(pages), _Refusal, crowded),
    ]
    application.add_transform(_Headers)


class _Foreign(Matcher):
    def __init__(self, hosts: frozenset[str], port: int) -> None:
        self.hosts, self.port = hosts, port

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        host = request.headers.get("Host", "").lower()
        origin = request.headers.get("Origin")
        known = host in self.hosts or host in _with_port(_address_reached(request), self.port)
        same = origin is None or origin.partition("://")[2].lower() == host
        return None if known and same else {}


def _address_reached(request: HTTPServerRequest) -> str:
    """The address of this machine that the request came to: no name, so nobody can rebind it."""
    connection: Any = request.connection
    return str(connection.stream.socket.getsockname()[0])


class _Crowded(Matcher):
    def __init__(self, pages: Callable[[], tuple[int, Sequence[Any]]]) -> None:
        self.pages = pages

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        if request.path.startswith("/static/"):  # what open pages ask for
            return None
        waiting, sessions = self.pages()
        unconnected = waiting + sum(session.connection_count == 0 for session in sessions)
        is_full = unconnected >= _MOST_UNCONNECTED or waiting + len(sessions) >= _MOST_PAGES
        return {} if is_full else None


class _Refusal(RequestHandler):
    def initialize(self, status: int, text: str) -> None:
        self.status, self.text = status, text

    def prepare(self) -> None:
        self.set_status(self.status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(self.text)


class _Headers(OutputTransform):
    """Headers of every answer: no other site may frame it, guess its type, or learn
    its address, which has the outline."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        headers["X-Frame-Options"] = "DENY"
        headers["Content-Security-Policy"] = "frame-ancestors 'none'"
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        return status_code, headers, chunk


_MOST = 256
_SYSTEMS_USUAL = 256  # descriptors of a process, where the system does not say
_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_PAUSE = 1.0  # seconds
_MOMENT = 0.02  # seconds in which a stream finds that its connection has ended
_PART = 8  # the oldest eighth makes room
_UNREAD_MS = 20_000  # a peer that takes nothing for so long has gone


def most_connections() -> int:
    """Half of the descriptors that this process may have: the rest is for files and children."""
    try:
        import resource
    except ImportError:  # not on this system
        return _SYSTEMS_USUAL // 2
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return _MOST if soft == resource.RLIM_INFINITY else max(4, min(_MOST, soft // 2))


class Connection(socket.socket):
    """Connection of one client; the first that is accepted has the number 1."""

    number = 0
    is_ended = False
    is_page = False
    """Whether it is the websocket of an open page, which stays."""


class Listener(socket.socket):
    """A listening socket made of another, with a limited number of connections.

    With ``most`` connections open, the oldest that are no page's make room for new ones: clients
    that connect and ask for nothing keep nobody out. If all are pages', a new one is refused.
    """

    def __init__(
        self, listening: socket.socket, most: int, loop: Callable[[], Any] = IOLoop.current
    ) -> None:
        super().__init__(
            listening.family, listening.type, listening.proto, fileno=listening.detach()
        )
        self.setblocking(False)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux; those that it accepts inherit it
            self.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_MS)
        self.most, self._loop = most, loop
        self._accepted: WeakSet[Connection] = WeakSet()
        self._count = 0

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection. BlockingIOError, which servers expect, while there is no
        room; ConnectionAbortedError for one that is refused."""
        there = [c for c in self._accepted if c.fileno() >= 0]
        others = [c for c in there if not c.is_page]
        if len(there) >= self.most and others:
            self._end_oldest(others)
            self._rest(_MOMENT)
            raise BlockingIOError
        made, address = self._new()
        if len(there) >= self.most:
            made.close()
            raise ConnectionAbortedError
        self._accepted.add(made)
        return made, address

    def _new(self) -> tuple[Connection, Any]:
        try:
            plain, address = super().accept()
        except OSError as error:
            if error.errno not in _EXHAUSTED:
                raise
            logging.getLogger("polywigner.explorer").error(
                "the system has no descriptors left for another connection; new ones wait"
            )
            self._rest(_PAUSE)
            raise BlockingIOError from None
        made = Connection(plain.family, plain.type, plain.proto, fileno=plain.detach())
        made.number = self._count = self._count + 1
        return made, address

    def _end_oldest(self, connections: list[Connection]) -> None:
        kept = sorted((c for c in connections if not c.is_ended), key=lambda c: c.number)
        for oldest in kept[: max(1, self.most // _PART)]:
            oldest.is_ended = True
            with suppress(OSError):  # it may have gone by itself
                oldest.shutdown(socket.SHUT_RDWR)  # its stream finds the end, and closes it

    def _rest(self, seconds: float) -> None:
        """Accept nothing for a while: a socket with clients that wait would be asked at once."""
        loop = self._loop()
        loop.update_handler(self.fileno(), 0)
        loop.call_later(seconds, self._resume)

    def _resume(self) -> None:
        if self.fileno() >= 0:  # not closed meanwhile
            self._loop().update_handler(self.fileno(), IOLoop.READ)
