"""Session of one visitor: events of the page to states, and results to figures."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from html import escape
from typing import Any
from urllib.parse import urlencode

from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource, CustomJS
from tornado.ioloop import IOLoop

from polywigner.errors import PolywignerError
from polywigner.explorer.computing import Result, Scheduler, queue, results
from polywigner.explorer.outlines import LARGEST_UPLOAD, without_vertex
from polywigner.explorer.page import browser
from polywigner.explorer.page.controls import VIEWS, Controls
from polywigner.explorer.page.events import connect, guarded
from polywigner.explorer.page.figures import Figures, emptied
from polywigner.explorer.readings import Readings
from polywigner.explorer.state import History, State, from_query, needed

Arrived = tuple[Result, list[tuple[str, int]]]  # with what is still to be computed after it

_GATHERED = 0.03  # seconds that a result waits for others


def open_page(doc: Any, start: State, scheduler: Scheduler, readings: Readings) -> Session:
    """The page of one visitor, with the state of its link if it has one."""
    message = ""
    arguments = getattr(doc.session_context.request, "arguments", {})
    if arguments:
        try:
            pairs = [(name, value[-1].decode("utf-8")) for name, value in arguments.items()]
            start = from_query(urlencode([p for p in pairs if not p[0].startswith("bokeh-")]))
        except UnicodeDecodeError:
            message = "The link could not be restored: expected text, got other bytes"
        except PolywignerError as error:
            message = f"The link could not be restored: {error}"
    session = Session(doc, start, scheduler, readings)
    session.say(message)
    session.request()
    return session


class Session:
    """The state of a visitor with its past, its widgets and its figures."""

    def __init__(self, doc: Any, start: State, scheduler: Scheduler, readings: Readings) -> None:
        self.doc, self.scheduler, self.readings = doc, scheduler, readings
        self.history = History(start)
        self.controls, self.figures = Controls(), Figures()
        self.signals = ColumnDataSource({"busy": [0]}, name="signals")
        self.downloads = ColumnDataSource({"name": [], "kind": [], "content": []})
        self.keys = ColumnDataSource({"key": [], "figure": [], "shift": [], "time": []})
        self.pointed = ColumnDataSource({"figure": []})
        self.refused = ColumnDataSource({"name": [], "size": [], "time": []})
        self.pending: list[tuple[float, float]] = []
        self.filling = False
        self.trouble = self.notice = self.reading = ""
        self.is_outdated = False  # whether the source could not be made, and pictures are older
        self.is_hint = False
        self.wanted = 0  # the number of the newest request
        self.shown: dict[str, State] = {}  # what each view shows in full
        self.closed = False
        self.loop = IOLoop.current()
        doc.title = "polywigner explore"
        connect(self)
        self.fill()
        self.page = self.controls.arranged(self.figures.all)
        self._connect_browser()
        doc.add_root(self.page)  # last: a document looks through its models after each change

    @property
    def state(self) -> State:
        """The state on show."""
        return self.history.present

    @property
    def visible(self) -> tuple[str, ...]:
        """The views that are computed."""
        names = list(VIEWS)
        return (*(names[k] for k in self.controls.views.active), "values")

    def _connect_browser(self) -> None:
        """Give the browser its scripts, and the models that they see."""
        controls, aperture = self.controls, self.figures.aperture
        headings = [group.heading for group in controls.groups]
        known: dict[str, Any] = {
            "page": self.page, "side": self.page.children[1], "main": self.page.children[2],
            "figures": self.figures.all, "outline": aperture.outline,
            "vertices": aperture.vertices, "signals": self.signals, "files": self.downloads,
            "keys": self.keys, "pointed": self.pointed, "refused": self.refused,
            "link": controls.link, "stale": controls.stale, "table": controls.table,
            "rows": controls.rows, "upload": controls.upload, "busy": controls.busy,
            "message": controls.message, "drawer": controls.drawer, "headings": headings,
            "heights": [group.height for group in controls.groups], "narrow": browser.NARROW,
            "largest": LARGEST_UPLOAD, "with_keys": browser.WITH_KEYS,
            "texts": [controls.busy, controls.message, controls.values, controls.note],
            "live": [
                (controls.message, "assertive", "Messages"),
                (controls.busy, "polite", "State of the computation"),
                (controls.values, "polite", "Values at the chosen point"),
                (controls.note, "polite", "About the near field"),
                (controls.tour_text, "polite", "Tour"),
            ],
            "sliders": [controls.coherence, controls.defocus, controls.distance],
            "pressed": [
                (controls.part, "aria-pressed", "Part of F"),
                (controls.order, "aria-pressed", "Order of rays"),
                (controls.draw, "aria-pressed", ""),
                *((made, "aria-expanded", "") for made in (controls.drawer, *headings)),
            ],
        }  # fmt: skip
        for code in browser.READY:
            self.doc.js_on_event(DocumentReady, CustomJS(args=known, code=code))
        for model, code in (
            (aperture.vertices, browser.REBUILD),
            (self.downloads, browser.DOWNLOAD),
            (self.pointed, browser.SCROLL),
            (controls.rows, browser.REPAINT),
            (controls.stale, browser.STALE),
        ):
            model.js_on_change("data", CustomJS(args=known, code=code))
        controls.link.js_on_change("value", CustomJS(args=known, code=browser.ADDRESS))
        aperture.figure.js_on_event("pan", CustomJS(args=known, code=browser.DRAG))
        self.doc.js_on_event("connection_lost", CustomJS(args=known, code=browser.LOST))

    def edit(self, step: bool = True, edges: bool = True, **changes: Any) -> None:
        """A new state, computed and shown; one that cannot be is refused with a message.

        step : whether it can be undone by itself; edges : whether the outline in the page is not
        yet as it is in the state.
        """
        try:
            state = self.state.moved(**changes)
        except PolywignerError as error:
            self.say(str(error))
            self.fill()
            return
        self.go(self.history.then(state) if step else self.history.instead(state), edges)

    def look(self, **changes: Any) -> None:
        """Another place, direction or view of the same source: no step of undo."""
        self.edit(step=False, edges=False, **changes)

    def delete(self, vertex: int) -> str:
        """Take a vertex away, and name all that goes with it."""
        rings, farewell = without_vertex(self.state.rings, vertex)
        self.edit(rings=rings)
        self.add(farewell)
        return farewell

    def go(self, history: History, edges: bool = True) -> None:
        """Another history: an edit, undo or redo."""
        before, self.history = self.state, history
        with self.filled():
            self.say("")
            if history.present != before:
                self.request()
            else:
                self.signals.data = {"busy": [0]}
            self.fill(edges)

    @contextmanager
    def filled(self) -> Iterator[None]:
        """Changes of widgets and figures that go out together, without their telling them back."""
        before, self.filling = self.filling, True
        try:
            with _together(self.doc):
                yield
        finally:
            self.filling = before

    def fill(self, edges: bool = True) -> None:
        """Put the state into widgets and handles."""
        with self.filled():
            self.controls.fill(self.history)
            if not self.state.rings:
                self.figures.aperture.clear()
            if edges:  # not under a vertex that is being dragged
                self.figures.aperture.show_edges(self.state)
            self.figures.mark(self.state)

    def say(self, text: str, hint: bool = False) -> None:
        """Show a notice or a hint, beside the error of the source."""
        self.notice, self.is_hint = text, hint
        self._show_message()

    def add(self, text: str) -> None:
        """Add the side effect of an edit to the notice, if it has one."""
        if text:
            self.say(text, hint=True)

    def _show_message(self) -> None:
        lines = [
            (self.reading, True),
            (self.notice, self.is_hint),
            (self.trouble, not self.state.rings),
        ]
        self.controls.message.text = "".join(
            f'<div role="{"status" if hint else "alert"}" class="{"hint" if hint else "alert"}">'
            f"{escape(text)}</div>"
            for text, hint in lines
            if text
        )

    def read(self, name: str, content: bytes) -> None:
        """Read a file in a process of its own; the page goes on meanwhile, and says so."""
        unit = self.state.unit

        def take(found: Any) -> None:
            self.reading = ""
            if isinstance(found, PolywignerError):
                self.say(str(found))
            else:
                self.edit(rings=found, unit=unit, x=(0.0, 0.0))

        then = guarded(self, take)
        self.readings.submit(
            id(self.doc), name, content, unit, lambda found: self._later(partial(then, found))
        )
        self.reading = f"Reading {name} …"
        self.say("")

    def request(self) -> None:
        """Compute the visible views of the state; whatever was being computed is dropped.

        Those that are shown as they would be computed stay.
        """
        self.wanted += 1
        self.arrived: set[str] = set()  # views of which there is something of this request
        names = tuple(n for n in self.visible if self.shown.get(n) != needed(self.state, n))
        self.signals.data = {"busy": [1]}
        self.controls.say_computing(self.wanted, names, (), (*names, "lags"))
        self.scheduler.submit(id(self), partial(self._compute, self.state, names, self.wanted))

    def _compute(self, state: State, names: tuple[str, ...], number: int) -> Iterator[None]:
        """Compute in the scheduler's thread; send results to the page's own, soon ones together.

        Each message costs the browser a frame, of all figures that there are.
        """
        found: list[Arrived] = []
        todo: list[tuple[str, int]] = []
        show = partial(self._show, state, names, found, number)
        for result in results(state, names):
            if result is not None:
                if result.name == "source":
                    todo = [] if result.error else queue(state, names)
                else:
                    todo = todo[1:]
                found.append((result, todo))
                if len(found) <= 1 and todo:  # otherwise one of them is waited for
                    self._later(show, _GATHERED)
            yield
        self._later(partial(show, is_last=True))

    def aside(self, compute: Callable[[], bytes], send: Callable[[bytes], None]) -> None:
        """Compute a file in the scheduler's thread, apart from the views, and send it."""

        def steps() -> Iterator[None]:
            try:
                content = compute()
            except PolywignerError as error:
                self._later(partial(self.say, str(error)))
            else:
                self._later(partial(send, content))
            yield

        self.scheduler.submit((id(self), "file"), steps)

    def _later(self, callback: Any, after: float = 0.0) -> None:
        """Call this in the page's own thread, so many seconds from now."""
        if not self.closed:
            soon = partial(self._soon, callback)
            self.loop.add_callback(self.loop.call_later, after, soon)

    def _soon(self, callback: Any) -> Any:
        if self.closed:
            return None
        with suppress(Exception):  # a visitor leaves in this moment: Bokeh takes the page apart
            session = self.doc.session_context.session
            if session is not None:
                return session.with_document_locked(callback)
            self.doc.add_next_tick_callback(callback)  # the page is still being made
        return None

    def _show(
        self,
        state: State,
        names: tuple[str, ...],
        found: list[Arrived],
        number: int,
        is_last: bool = False,
    ) -> None:
        if number != self.wanted or self.closed or not (found or is_last):
            return
        with self.filled():
            todo: list[tuple[str, int]] = []
            while found:
                result, todo = found.pop(0)
                self._show_one(state, result)
                self.arrived.add(result.name)
            if is_last:
                self.controls.say_done(self.visible, self.is_outdated, not state.rings)
                self.signals.data = {"busy": [0]}
            else:
                stale = [name for name in names if name not in self.arrived]
                self.controls.say_computing(number, names, todo, stale)

    def _show_one(self, state: State, result: Result) -> None:
        name = result.name
        self.shown.pop(name, None)
        if name == "source":
            self.trouble, self.is_outdated = result.error, bool(result.error)
            if not state.rings:
                self.shown.clear()
                self.figures.lags.clear()
                for view in (*VIEWS, "values"):
                    self._clear(view)
            elif result.error:
                self.trouble += ". What is shown is the last that could be computed."
            self._show_message()
            self.controls.show_code(state)
        elif result.error:
            self.trouble = f"{VIEWS.get(name, name)}: {result.error}"
            self._clear(name)
            self._show_message()
        if result.error:
            return
        if name != "source" and result.is_final(state):
            self.shown[name] = needed(state, name)
        try:
            if name == "values":
                self.controls.show_values(result.value, state)
            else:
                self.figures.show(state, name, result.value)
            if name == "near":
                self.controls.note.text = result.value.note
        except Exception:  # no traceback reaches the page
            logging.getLogger("polywigner.explorer").exception("a view could not be shown")
            self.say(f"{name} could not be shown; this is a fault of polywigner")

    def _clear(self, view: str) -> None:
        self.controls.clear(view)
        if view != "values":
            self.figures.clear(view)

    def leave(self) -> None:
        """The visitor has left: nothing is computed any more, and the memory comes back."""
        self.closed = True
        self.scheduler.forget(id(self))
        self.scheduler.forget((id(self), "file"))
        self.readings.forget(id(self.doc))
        for image in self.figures.images.values():
            emptied(image.source)
        # pages are cycles of references: Python alone would wait for hundreds of them
        self.scheduler.submit("garbage", _collect)


def _collect() -> Iterator[None]:
    gc.collect()
    yield


@contextmanager
def _together(doc: Any) -> Iterator[None]:
    """Changes of a document that go to the browser as one message.

    Bokeh sends each change by itself: half a millisecond for the list of all models that it makes
    for each, and a figure painted several times over. Callbacks on what is changed here are not
    called, as while widgets are filled.
    """
    if doc.callbacks.hold_value is not None:  # part of a larger whole
        yield
        return
    doc.hold("combine")
    try:
        yield
    finally:
        with suppress(AttributeError):  # another version, or no session yet
            _send(doc)
        doc.unhold()


def _send(doc: Any) -> None:
    """Send held changes at once, by names of Bokeh's own: there are no public ones."""
    session, events = doc.session_context.session, doc.callbacks._held_events
    sockets = [(c.protocol, c._socket) for c in session._subscribed_connections]
    # not those that are no change of a model, or come from the browser
    is_ours = all(getattr(event, "setter", session) is None for event in events)
    if session._pending_writes is not None and events and is_ours:
        doc.callbacks._held_events = []
        for protocol, socket in sockets:
            session._pending_writes.append(
                socket.send_message(protocol.create("PATCH-DOC", events))
            )
