"""Guard of the server: who is answered, in which order, and how much a visitor may take.

A page of another site can have its own name resolved to 127.0.0.1 (DNS rebinding). Its requests
then reach this server, and the browser takes both for one site; but their Host is that name.
Bokeh's list of origins looks at websockets alone and knows no addresses of 0.0.0.0, so the rules
here look at all requests.
"""

from __future__ import annotations

import asyncio
import re
import socket
import time
from collections import Counter, OrderedDict, deque
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from typing import Any

from bokeh.util.token import check_token_signature, get_session_id, get_token_payload
from panel.io.server import DocHandler, WSHandler
from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.routing import Matcher, PathMatches, Rule
from tornado.web import ErrorHandler, OutputTransform, RequestHandler

from polywigner.errors import ArgumentError

LARGEST_MESSAGE = 4 << 20
"""Bytes of one message of a browser: the largest file, as text, twice over."""
MOST_PAGES = 100
"""Pages that are open at once; one address has at most half of them."""
MOST_UNCONNECTED = 24
"""Pages that are kept for browsers that have not connected yet."""
_MOST_WAITING = 4  # pages of one address that wait to be made: nobody looks at more
_MOST_CONNECTIONS = 256
_UNREAD_MS = 20_000  # a peer that takes nothing for so long has gone
_MOST_DEBT = 0.5  # seconds of work that a page may have ahead of what it is due
_LONGEST_REST = 2.0  # seconds; what a message waited for counts as well
_SHARE = 0.5  # of the time, for one page's messages
_HTTP_PORT = 80  # browsers leave it out
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_EVERYWHERE = ("0.0.0.0", "::")
_HOST = re.compile(r"([\w-]+(\.[\w-]+)*|\[[0-9a-f:.]+\])(:\d{1,5})?")
_FOREIGN = (
    "polywigner explore does not answer to this name. Open the address that the terminal printed, "
    "or allow the name by --allow-host.\n"
)
_CROWDED = (
    "polywigner explore has too many pages open, or too many of yours wait to be made. Reload this "
    "page in 20 seconds.\n"
)
# Of what Bokeh takes from browsers, this page sends none: whole documents, more models, rows
# without end.
_MESSAGES = ("PATCH-DOC", "PULL-DOC-REQ", "SERVER-INFO-REQ")
_NOT_SENT = ("RootAdded", "RootRemoved", "ColumnsStreamed")


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


def guard(server: Any, address: str, allowed: Iterable[str]) -> None:
    """Put the rules of this module in front of Panel's server."""
    application, port = server._tornado, server.port
    hosts = served_hosts(address, port, allowed)
    (context,) = application.applications.values()
    known = {"application_context": context, "bokeh_websocket_path": "/ws"}
    application.default_router.rules[:0] = [
        Rule(_Foreign(hosts, port), _Refusal),
        Rule(PathMatches(r"/?"), _Page, {**known, "visits": Visits(server)}),
        Rule(PathMatches(r"/ws"), _Socket, known),
        # these make documents too, for pages of other sites
        Rule(PathMatches(r"/(autoload\.js|metadata)"), ErrorHandler, {"status_code": 404}),
    ]
    application.add_transform(_Headers)
    connections = Connections(server._http.handle_stream, most_connections())
    server._http.handle_stream = connections.handle


class _Foreign(Matcher):
    """Requests for other hosts, or from pages of other sites."""

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


class _Refusal(RequestHandler):
    def prepare(self) -> None:
        _refuse(self, 403, _FOREIGN)


def _refuse(handler: RequestHandler, status: int, text: str) -> None:
    handler.set_status(status)
    handler.set_header("Content-Type", "text/plain; charset=utf-8")
    handler.finish(text)


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


class Turns:
    """Pages are made one after the other, of each visitor in turn; after each, others are answered
    for as long as it took: a page takes half a second in which the server does nothing else."""

    def __init__(self) -> None:
        self.busy = False
        self.waiting: OrderedDict[str, deque[asyncio.Future[bool]]] = OrderedDict()

    @asynccontextmanager
    async def turn(self, visitor: str) -> AsyncIterator[bool]:
        """Wait for this visitor's turn; False where newer requests took its place."""
        if self.busy:
            queue = self.waiting.setdefault(visitor, deque())
            place: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
            queue.append(place)
            if len(queue) > _MOST_WAITING:
                queue.popleft().set_result(False)
            if not await place:
                yield False
                return
        self.busy = True
        start = time.monotonic()
        try:
            yield True
        finally:
            asyncio.get_running_loop().call_later(time.monotonic() - start, self._next)

    def _next(self) -> None:
        self.busy = bool(self.waiting)
        if self.waiting:
            visitor, queue = self.waiting.popitem(last=False)
            queue.popleft().set_result(True)
            if queue:
                self.waiting[visitor] = queue  # at the end: the others' turn


class Visits(Turns):
    """Pages that are made and open, counted by the addresses of their visitors."""

    def __init__(self, server: Any) -> None:
        super().__init__()
        self.server = server

    def is_full(self, visitor: str) -> bool:
        """Whether this visitor can have no further page."""
        pages = self.server.get_sessions("/")
        own = sum(getattr(page, "visitor", "") == visitor for page in pages)
        return len(pages) >= MOST_PAGES or own >= MOST_PAGES // 2

    def make_room(self) -> None:
        """Let the oldest unconnected pages go, of the visitor who has most of them."""
        pages = self.server.get_sessions("/")
        kept = [p for p in pages if not p.connection_count and not p.expiration_requested]
        while len(kept) > MOST_UNCONNECTED:
            ((heaviest, _),) = Counter(page.visitor for page in kept).most_common(1)
            oldest = next(page for page in kept if page.visitor == heaviest)
            oldest.request_expiration()
            kept.remove(oldest)


class _Page(DocHandler):
    """The page, made when it is its visitor's turn."""

    def initialize(self, visits: Visits, **known: Any) -> None:
        super().initialize(**known)
        self.visits = visits

    async def get(self, *arguments: Any, **named: Any) -> None:
        visitor, connection = str(self.request.remote_ip), self.request.connection
        async with self.visits.turn(visitor) as granted:
            if not granted or self.visits.is_full(visitor):
                _refuse(self, 503, _CROWDED)
            elif not connection.stream.closed():  # of a page that is reloaded nobody waits
                await super().get(*arguments, **named)

    async def get_session(self) -> Any:
        session = await super().get_session()
        session.visitor = str(self.request.remote_ip)
        self.visits.make_room()
        return session


class _Socket(WSHandler):
    """The websocket of a page that has been made. It makes none, whatever its token says."""

    received = 0
    debt, since = 0.0, 0.0

    def open(self, *arguments: Any, **named: Any) -> None:
        if self.selected_subprotocol != "bokeh" or not self._is_ours():
            self.close()
            return
        connection: Any = self.ws_connection
        connection.stream.is_page = True
        super().open(*arguments, **named)

    def _is_ours(self) -> bool:
        known = {"signed": True, "secret_key": self.application.secret_key}
        with suppress(Exception):  # whatever it is, it is no token
            return (
                check_token_signature(self._token, **known)
                and time.time() < get_token_payload(self._token)["session_expiry"]
                and self.application_context.get_session(get_session_id(self._token)) is not None
            )
        return False

    async def on_message(self, fragment: str | bytes) -> None:
        if self.receiver is None or self.handler is None:  # browsers wait for an answer first
            self.close()
            return
        start = time.monotonic()
        await super().on_message(fragment)
        # read the next message later where a page's messages take more than their share
        self.debt = max(0.0, self.debt - _SHARE * (start - self.since))
        self.debt += time.monotonic() - start
        self.since = start
        if self.debt > _MOST_DEBT:
            await asyncio.sleep(min(_LONGEST_REST, (self.debt - _MOST_DEBT) / _SHARE))

    async def _receive(self, fragment: str | bytes) -> Any:
        self.received += len(fragment)
        if self.received > LARGEST_MESSAGE:  # parts of one message, which Bokeh would all keep
            self._protocol_error("too long")
            return None
        message = await super()._receive(fragment)
        if message is not None:
            self.received = 0
        return message

    async def _handle(self, message: Any) -> Any:
        if message.msgtype not in _MESSAGES or (
            message.msgtype == "PATCH-DOC"
            and any(event.get("kind") in _NOT_SENT for event in message.content["events"])
        ):
            self._protocol_error("not expected")
            return None
        return await super()._handle(message)

    def _internal_error(self, message: str) -> None:
        self._protocol_error(message)

    def _protocol_error(self, message: str) -> None:
        # at once: Bokeh would quote the message, which may not fit, and wait for an answer
        connection: Any = self.ws_connection
        if connection is not None:
            connection.stream.close()


def most_connections() -> int:
    """Half of the descriptors that this process may have: the rest is for files and children."""
    try:
        import resource
    except ImportError:  # not on this system
        return _MOST_CONNECTIONS // 2
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = soft == resource.RLIM_INFINITY
    return _MOST_CONNECTIONS if unlimited else max(4, min(_MOST_CONNECTIONS, soft // 2))


class Connections:
    """A limited number of connections: clients that ask for nothing keep nobody out.

    With ``most`` connections open, the oldest that is no open page's makes room for a new one. If
    all are pages', a new one is refused.
    """

    def __init__(self, serve: Callable[[Any, Any], Any], most: int) -> None:
        self.serve, self.most = serve, most
        self.streams: list[Any] = []

    def handle(self, stream: Any, address: Any) -> Any:
        """Serve a new connection, as Tornado's ``handle_stream``."""
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            stream.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_MS)
        self.streams = [known for known in self.streams if not known.closed()]
        if len(self.streams) >= self.most:
            idle = (known for known in self.streams if not getattr(known, "is_page", False))
            oldest = next(idle, stream)
            oldest.close()
            if oldest is stream:
                return None
            self.streams.remove(oldest)
        self.streams.append(stream)
        return self.serve(stream, address)
