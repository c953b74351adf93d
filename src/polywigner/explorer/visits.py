"""From a request to a page: a light answer at once, a document when the browser has connected."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

from bokeh.application.handlers.handler import Handler
from bokeh.document import Document
from bokeh.embed.server import server_html_page_for_session
from bokeh.server.views.ws import WSHandler
from bokeh.util.token import (
    check_token_signature,
    generate_jwt_token,
    generate_session_id,
    get_token_payload,
)
from tornado.routing import PathMatches, Rule
from tornado.web import ErrorHandler, RequestHandler

from polywigner.explorer.page import theme

LARGEST_MESSAGE = 4 << 20
"""Bytes of one message of a browser: the largest file, as text, twice over."""
_NOT_FOUND = 404
_MOST_WAITING = 24
_MOST_DEBT = 0.5  # seconds of work that a page may have ahead of what it is due
_LONGEST_REST = 2.0  # seconds; what a message waited for counts as well
_SHARE = 0.5  # of the time, for one page's messages
# Of what Bokeh takes from browsers, this page sends none: whole documents, more models, rows
# without end.
_MESSAGES = ("PATCH-DOC", "PULL-DOC-REQ", "SERVER-INFO-REQ")
_NOT_SENT = ("RootAdded", "RootRemoved", "ColumnsStreamed")

# The page's own root hides it.
_WAITING = """
{% block contents %}
<style>body:has(> [class*="bk-"]) > .waiting { display: none }</style>
<p class="waiting">polywigner explore makes this page. Reload it if nothing appears within a
minute: too many pages are open then, or the server has stopped.</p>
{{ super() }}
{% endblock %}
"""


class Turns:
    """Pages are made one after the other; after each, others are answered for as long as it took.

    A page takes a third of a second in which the server does nothing else.
    """

    def __init__(self) -> None:
        self.waiting = 0
        self._lock = asyncio.Lock()

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Waits until it is this one's turn."""
        self.waiting += 1
        try:
            await self._lock.acquire()
        finally:
            self.waiting -= 1
        start = time.monotonic()
        try:
            yield
        finally:
            spent = time.monotonic() - start
            asyncio.get_running_loop().call_later(spent, self._lock.release)


def route(application: Any, turns: Turns, left: Callable[[Document], None]) -> None:
    """Answer for pages and their websockets in place of Bokeh, which makes documents for both.

    ``left`` is told the document of a page whose last connection has ended.
    """
    (context,) = application.applications.values()
    known = {"application_context": context, "bokeh_websocket_path": "/ws"}
    application.default_router.rules[:0] = [
        Rule(PathMatches(r"/?"), _Page),
        Rule(PathMatches(r"/ws"), _Socket, {**known, "turns": turns, "left": left}),
        # these make documents too, for pages of other sites
        Rule(PathMatches(r"/(autoload\.js|metadata)"), ErrorHandler, {"status_code": _NOT_FOUND}),
    ]


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
                template=theme.TEMPLATE + _WAITING,
            )
        )


class _Socket(WSHandler):
    """The websocket of a page. One with no token of this server makes nothing."""

    def initialize(self, turns: Turns, left: Callable[[Document], None], **known: Any) -> None:
        super().initialize(**known)
        self.turns, self.left = turns, left
        self.received = 0
        self.debt, self.since = 0.0, time.monotonic()

    def open(self, *_: Any, **__: Any) -> None:
        connection: Any = self.ws_connection
        if self.selected_subprotocol != "bokeh" or not self._is_ours():
            self.close()
            return
        connection.stream.socket.is_page = True
        super().open()

    def _is_ours(self) -> bool:
        known = {"signed": True, "secret_key": self.application.secret_key}
        try:
            return (
                check_token_signature(self._token, **known)
                and time.time() < get_token_payload(self._token)["session_expiry"]
            )
        except Exception:  # whatever it is, it is no token
            return False

    async def _async_open(self, token: str) -> None:
        if self.turns.waiting >= _MOST_WAITING:
            self.close()
            return
        async with self.turns.turn():
            if self.ws_connection is not None:  # still there
                await super()._async_open(token)

    async def on_message(self, fragment: str | bytes) -> None:
        if self.receiver is None or self.handler is None:  # browsers wait for an answer first
            self.close()
            return
        start = time.monotonic()
        await super().on_message(fragment)
        await self._pace(start, time.monotonic())

    async def _pace(self, start: float, end: float) -> None:
        """Read the next message later where a page's messages take more than their share."""
        self.debt = max(0.0, self.debt - _SHARE * (start - self.since)) + (end - start)
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

    def on_close(self) -> None:
        session = None if self.connection is None else self.connection.session
        super().on_close()
        if session is not None and session.connection_count == 0:
            self.left(session.document)
