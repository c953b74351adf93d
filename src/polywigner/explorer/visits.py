"""From a connection to a page: whom the server answers, and how much of it each visitor may take.

A page of another site can have its own name resolved to 127.0.0.1 (DNS rebinding). Its requests
then reach this server, and the browser takes both for one site; but their Host is that name.
"""

from __future__ import annotations

import asyncio
import re
import socket
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from bokeh.application.handlers.handler import Handler
from bokeh.document import Document
from bokeh.embed.server import server_html_page_for_session
from bokeh.server.views.ws import WSHandler
from bokeh.util.token import generate_jwt_token, generate_session_id
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.iostream import IOStream
from tornado.routing import Matcher, PathMatches, Rule
from tornado.web import Application, ErrorHandler, OutputTransform, RequestHandler

from polywigner.errors import ArgumentError
from polywigner.explorer.page import browser

LARGEST_MESSAGE = 4 << 20
"""Bytes of one message of a browser: the largest file, as text, twice over."""
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_EVERYWHERE = ("0.0.0.0", "::")
_HOST = re.compile(r"([\w-]+(\.[\w-]+)*|\[[0-9a-f:.]+\])(:\d{1,5})?")
_HTTP_PORT = 80  # browsers leave it out
_FORBIDDEN, _NOT_FOUND, _UNAVAILABLE = 403, 404, 503
_MOST_PAGES = 100
_MOST_UNCONNECTED = 24  # more than anybody reloads before the first ones are dropped
_MOST_CONNECTIONS = 256
_UNREAD_MS = 20_000  # a peer that takes nothing for so long has gone
_MOST_DEBT = 0.5  # seconds of work that a page may have ahead of what it is due
_LONGEST_REST = 2.0  # seconds; what a message waited for counts as well
_SHARE = 0.5  # of the time, for one page's messages
# Of what Bokeh takes from browsers, this page sends none: whole documents, more models, rows
# without end.
_MESSAGES = ("PATCH-DOC", "PULL-DOC-REQ", "SERVER-INFO-REQ")
_NOT_SENT = ("RootAdded", "RootRemoved", "ColumnsStreamed")
_REFUSAL = (
    "polywigner explore does not answer to this name. Open the address that the terminal printed, "
    "or allow the name by --allow-host.\n"
)
_CROWDED = (
    f"polywigner explore has {_MOST_PAGES} pages open, or {_MOST_UNCONNECTED} that wait or were "
    "left a moment ago. Reload this page in 20 seconds.\n"
)
# No other site may frame an answer, guess its type, or learn its address, which has the outline.
_SAFE_HEADERS = {
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


def served_hosts(address: str, port: int, allowed: Iterable[str] = ()) -> frozenset[str]:
    """Values of the Host header by which the server is known, whichever way it is reached.

    Of 0.0.0.0 and :: the name of the machine is taken; ``allowed`` are further names, each with a
    port or without. Raises ArgumentError for a name that is none, such as a wildcard.
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
    application.default_router.rules.insert(0, Rule(_Unwanted(hosts, port, pages), _Refusal))
    application.add_transform(_Headers)


class _Unwanted(Matcher):
    """Matches requests that are refused, with status and text of the answer."""

    def __init__(
        self, hosts: frozenset[str], port: int, pages: Callable[[], tuple[int, Sequence[Any]]]
    ) -> None:
        self.hosts, self.port, self.pages = hosts, port, pages

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        if self._is_foreign(request):
            return {"target_kwargs": {"status": _FORBIDDEN, "text": _REFUSAL}}
        if not request.path.startswith("/static/") and self._is_full():  # open pages ask for those
            return {"target_kwargs": {"status": _UNAVAILABLE, "text": _CROWDED}}
        return None

    def _is_foreign(self, request: HTTPServerRequest) -> bool:
        host = request.headers.get("Host", "").lower()
        if host not in self.hosts:
            # the address that the request came to is no name, so nobody can rebind it
            connection: Any = request.connection
            reached = str(connection.stream.socket.getsockname()[0])
            if host not in _with_port(reached, self.port):
                return True
        origin = request.headers.get("Origin")
        return origin is not None and origin.partition("://")[2].lower() != host

    def _is_full(self) -> bool:
        waiting, sessions = self.pages()
        unconnected = waiting + sum(session.connection_count == 0 for session in sessions)
        return unconnected >= _MOST_UNCONNECTED or waiting + len(sessions) >= _MOST_PAGES


class _Refusal(RequestHandler):
    def initialize(self, status: int, text: str) -> None:
        self.status, self.text = status, text

    def prepare(self) -> None:
        self.set_status(self.status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(self.text)


class _Headers(OutputTransform):
    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        headers.update(_SAFE_HEADERS)
        return status_code, headers, chunk


class LimitedServer(HTTPServer):
    """An HTTP server with a limited number of connections.

    The oldest that is no page's makes room for a new one: clients that connect and ask for nothing
    keep nobody out. If all are pages', the new one is closed.
    """

    def initialize(self, *arguments: Any, **options: Any) -> None:
        super().initialize(*arguments, **options)
        self.most = _most_connections()
        self._streams: list[IOStream] = []

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """Serve a new connection."""
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            with suppress(OSError):  # it may have gone already
                stream.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_MS)
        self._streams = [*(s for s in self._streams if not s.closed()), stream]
        if len(self._streams) > self.most:
            next(s for s in self._streams if not hasattr(s, "is_page")).close()
        if not stream.closed():
            super().handle_stream(stream, address)


def _most_connections() -> int:
    """Half of the descriptors that this process may have: the rest is for files and children."""
    try:
        import resource
    except ImportError:  # not on this system
        return _MOST_CONNECTIONS // 2
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = soft == resource.RLIM_INFINITY
    return _MOST_CONNECTIONS if unlimited else max(4, min(_MOST_CONNECTIONS, soft // 2))


class Turns:
    """Pages are made one after the other; after each, others are answered for as long as it took.

    A page takes a third of a second in which the server does nothing else.
    """

    def __init__(self) -> None:
        self.waiting = 0
        self._lock = asyncio.Lock()

    async def __aenter__(self) -> None:
        self.waiting += 1
        try:
            await self._lock.acquire()
        finally:
            self.waiting -= 1
        self._start = time.monotonic()

    async def __aexit__(self, *_: object) -> None:
        spent = time.monotonic() - self._start
        asyncio.get_running_loop().call_later(spent, self._lock.release)


def route(application: Any) -> Turns:
    """Answer for pages and their websockets in place of Bokeh, which makes documents for both."""
    (context,) = application.applications.values()
    turns = Turns()
    known = {"application_context": context, "bokeh_websocket_path": "/ws", "turns": turns}
    application.default_router.rules[:0] = [
        Rule(PathMatches(r"/?"), _Page),
        Rule(PathMatches(r"/ws"), _Socket, known),
        # these make documents too, for pages of other sites
        Rule(PathMatches(r"/(autoload\.js|metadata)"), ErrorHandler, {"status_code": _NOT_FOUND}),
    ]
    return turns


class Pages(Handler):
    """Makes the page of each session, and tells it when its visitor has left for good."""

    def __init__(self, make: Callable[[Document], Any]) -> None:
        super().__init__()
        self.make = make
        self.pages: dict[str, Any] = {}

    def modify_document(self, doc: Document) -> None:
        """Fill the document of a new session."""
        context: Any = doc.session_context
        self.pages[context.id] = self.make(doc)

    async def on_session_destroyed(self, session_context: Any) -> None:
        """As Bokeh calls it; after a document's own callbacks it would collect all garbage."""
        page = self.pages.pop(session_context.id, None)
        if page is not None:
            page.leave()


class _Page(RequestHandler):
    """Light page of scripts and a signed token with the link, from which the document is made."""

    application: Any

    def get(self, *_: Any) -> None:
        app = self.application
        signed = {"secret_key": app.secret_key, "signed": True}
        token = generate_jwt_token(
            generate_session_id(**signed),
            extra_payload={"headers": {}, "cookies": {}, "arguments": self.request.arguments},
            expiration=app.session_token_expiration,
            **signed,
        )
        session: Any = SimpleNamespace(token=token, document=Document())
        self.finish(
            server_html_page_for_session(
                session,
                resources=app.resources(),
                title="polywigner explore",
                template=browser.TEMPLATE,
            )
        )


class _Socket(WSHandler):
    """The websocket of a page, which Bokeh closes without a token of this server."""

    def initialize(self, turns: Turns, **known: Any) -> None:
        super().initialize(**known)
        self.turns = turns
        self.received = 0
        self.debt, self.since = 0.0, time.monotonic()

    async def _async_open(self, token: str) -> None:
        connection: Any = self.ws_connection
        if connection is not None:
            connection.stream.is_page = True
        async with self.turns:
            if self.ws_connection is not None:  # still there
                await super()._async_open(token)

    async def on_message(self, fragment: str | bytes) -> None:
        start = time.monotonic()
        await super().on_message(fragment)
        # the next message is read later where a page's messages take more than their share
        self.debt = max(0.0, self.debt - _SHARE * (start - self.since)) + time.monotonic() - start
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

    def _protocol_error(self, message: str) -> None:
        # at once: Bokeh would quote the message, which may not fit, and wait for an answer
        connection: Any = self.ws_connection
        if connection is not None:
            connection.stream.close()

    _internal_error = _protocol_error
