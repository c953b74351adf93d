"""The page of one visitor: widgets, figures and the state behind them."""

from __future__ import annotations

import asyncio
import gc
import io
import logging
import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, partial
from html import escape
from pathlib import Path
from typing import Any

import panel as pn
from bokeh.events import DocumentReady, DoubleTap, MouseLeave, MouseMove, PanEnd, PanStart, Tap
from bokeh.models import (
    CellEditor,
    ColumnDataSource,
    CustomJS,
    DataTable,
    NumberEditor,
    Row,
    TableColumn,
)
from tornado.ioloop import IOLoop

from polywigner.errors import ArgumentError, PolywignerError
from polywigner.explorer import exports, outlines, views
from polywigner.explorer.figures import Figures
from polywigner.explorer.scheduler import Scheduler
from polywigner.explorer.shown import in_unit
from polywigner.explorer.snippets import SNIPPETS, snippet
from polywigner.explorer.state import (
    CATALOGUE,
    UNITS,
    History,
    Point,
    State,
    from_query,
    needed,
    to_query,
)
from polywigner.explorer.uploads import LARGEST_UPLOAD, SUFFIXES, Uploads, check_upload

WEB = Path(__file__).parent / "web"
"""The template, the script and the styles of the page."""
VIEWS = {
    "fourier": "F(ν)", "wigner_nu": "W over ν", "wigner_x": "W over x", "otf": "OTF, defocus",
    "far": "far field", "near": "near field",
}  # fmt: skip
"""Views that can be hidden, and are then not computed."""
STEPS: tuple[tuple[str, str, str], ...] = (
    (
        "aperture",
        "An opening, lit by a plane wave",
        "The full shape is an aperture: an antenna patch, a pupil, a hole in a screen. Drag one of "
        "its corners. Double-click near an edge for a new corner; click a corner and press "
        "Backspace to take it away.",
    ),
    (
        "fourier",
        "Far away: which directions it radiates to",
        "This is the Fourier transform F(ν) of the aperture, in dB: what you would see far away. A "
        "direction is a spatial frequency ν; the dotted circle is the horizon, beyond it waves "
        "die out within a wavelength. Make the aperture narrower: the pattern grows wider.",
    ),
    (
        "wigner_nu",
        "From one place: W over directions",
        "The Wigner function W(x, ν) says how much light leaves the place x towards ν. Click into "
        "the aperture to choose x (the cross). It is the Fourier transform of the lag slice, "
        "all pairs of points that have x as their middle. Blue is negative: light that only "
        "interferes.",
    ),
    (
        "wigner_x",
        "To one direction: W over places",
        "The same function, now for one direction ν and every place x. Click into F(ν) to choose "
        "ν. Light seems to come also from places beside a concave aperture: W lives on its "
        "automean, the light shape. Summed over all places it is |F(ν)|².",
    ),
    (
        "rays_near",
        "Near field: rays with negative light",
        "W travels along straight rays, so their sum is a near field: here by Wigner rays, beside "
        "it by Kirchhoff's exact integral, then the difference in dB. Move the plane with the "
        'slider among the views: nearer than a few wavelengths rays fail. "Take away" has '
        "the pictures, the numbers and the Python code to take away.",
    ),
)
"""The tour: name of the figure, heading and text of each step."""
KEYS = {
    "aperture": "N and P choose a vertex and arrows move it, with Shift ten steps; Insert adds "
    "one after it, Delete takes it away, Escape lets it go: then arrows move the position x. "
    "While an outline is drawn, the space bar puts a corner at the position.",
    "fourier": "Arrows move the spatial frequency, with Shift ten steps.",
    "wigner_nu": "Arrows move the spatial frequency, with Shift ten steps.",
    "wigner_x": "Arrows move the position x, with Shift ten steps.",
}
"""The figures that take keys, and what they do; the others are pictures."""
_DRAWING = (
    "Click the corners one after the other (or go there by arrows, and press the space bar); "
    "click the first one again, or press Enter, to close the outline. Esc gives up."
)
_NONE_CHOSEN = "Select a vertex first: click it, or its row in the table."
_FAULT = "This could not be done; it is a fault of polywigner."

_TOLD = ("kind", "status", "message", "values", "note", "tour", "point")
_TEXTS = ("unit", "wave", "taper", "array", "window", "steering")  # each edit can be undone
_LOOKS = ("snap", "reach", "coherence", "defocus", "distance", "part", "order")
_SLIDERS = ("coherence", "defocus", "distance")
_LABELS = {
    "x": "x ({0})", "y": "y ({0})", "nu_x": "ν_x (1/{0})", "nu_y": "ν_y (1/{0})",
    "coherence": "Coherent over ({0}; 0: all; of W)", "distance": "Near field at z ({0})",
    "snap": "Snap to ({0})",
}  # fmt: skip
_ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
_FASTER = 10  # steps, with Shift
_ACROSS = 100  # steps across a figure, where no raster is set
_TOGETHER = 1.0  # seconds: moves of one vertex that follow so soon are one step of undo
_NEAR_VERTEX = 0.02  # of the window: a click there means the vertex
_GATHERED = 0.03  # seconds that a result waits for others

_NARROW = {
    "unit", "snap", "draw", "finish", "insert", "delete", "wave", "steering", "taper", "array",
    "window", "reach", "x", "y", "nu_x", "nu_y", "take_png", "take_svg", "take_npz", "take_py",
    "take_outline_geojson", "take_outline_svg",
}  # fmt: skip
_TWO = ":host { display: grid !important; grid-template-columns: 1fr 1fr; align-items: end; }"
_FLAT = ":host { display: contents !important; }"  # figures lie in the grid of the page itself

Arrived = tuple[views.Result, list[tuple[str, int]]]  # with what is still to be computed after it


@cache
def _file(suffix: str) -> str:
    return (WEB / f"page.{suffix}").read_text(encoding="utf-8")


def open_page(start: State, scheduler: Scheduler, uploads: Uploads) -> Any:
    """The page of one visitor as Panel serves it, with the state of its link if it has one."""
    message = ""
    query = pn.state.location.search if pn.state.location else ""
    try:
        start = from_query(query) if query.strip("?") else start
    except PolywignerError as error:
        message = f"The link could not be restored: {error}"
    try:
        page = Page(start, scheduler, uploads)
        page.say(message)
        page.request()
    except Exception as error:  # Panel would show the traceback
        fault(error)
        return pn.pane.Str(_FAULT)
    return page.template


def fault(error: BaseException) -> None:
    """Log an error of a callback of Panel; errors of visitors are told in the page."""
    if not isinstance(error, PolywignerError):
        logging.getLogger("polywigner.explorer").error("a request failed", exc_info=error)


def _collect() -> Iterator[None]:
    gc.collect()
    yield


def _widgets() -> dict[str, Any]:
    """All widgets of one visitor by their names, which are the tags of their models."""
    w = pn.widgets
    shapes = {"choose a shape …": "", **{name: name for name in (*CATALOGUE, "blank sheet")}}
    names = {label: name for name, label in VIEWS.items()}
    made = {
        "shape": w.Select(label="Start from", options=shapes, value=""),
        "upload": w.FileInput(
            accept=",".join(SUFFIXES), label="or a file (GeoJSON, WKT, CSV, SVG, DXF; 1 MiB)"
        ),
        "unit": w.Select(label="Length unit", options=list(UNITS)),
        "snap": w.FloatInput(start=0),
        "draw": w.Toggle(label="Draw an outline"),
        "finish": w.Button(label="Finish outline", disabled=True),
        "insert": w.Button(label="Insert vertex"),
        "delete": w.Button(label="Delete vertex"),
        "wave": w.TextInput(label="Frequency or wavelength"),
        "steering": w.TextInput(label="Steering θ, φ", placeholder="20 deg, 90 deg"),
        "taper": w.TextInput(label="Taper", placeholder="taylor 30 dB"),
        "array": w.TextInput(label="Array", placeholder="4 x 4, 12 mm"),
        "window": w.TextInput(label="Window of the array", placeholder="taylor 25 dB"),
        "reach": w.FloatInput(label="Largest sin θ (0: auto)", start=0, end=1),
        "views": w.CheckBoxGroup(options=names, value=[*VIEWS][:5], inline=True),
        "part": w.RadioButtonGroup(
            options={"dB": "level", "real part": "real", "phase": "phase"}, label="Part of F"
        ),
        "coherence": w.FloatSlider(start=0, end=20, step=0.25),
        "defocus": w.FloatSlider(label="Defocus W20 (waves)", start=-4, end=4, step=0.05),
        "distance": w.FloatSlider(start=1, end=200, step=1),
        "order": w.RadioButtonGroup(
            options={"leading order": 1, "third order": 3}, label="Order of rays"
        ),
        "take": w.Select(
            label="Take away", options={VIEWS[name]: name for name in SNIPPETS}, value="wigner_nu"
        ),
        "code": w.TextAreaInput(label="Python that computes this view", rows=9, max_length=10**6),
        "undo": w.Button(label="Undo"),
        "redo": w.Button(label="Redo"),
        "whole": w.Button(label="Undo zoom"),
        "tour_back": w.Button(label="Back", visible=False),
        "tour_next": w.Button(label="What am I looking at?"),
        **{name: w.FloatInput() for name in ("x", "y", "nu_x", "nu_y")},
    }
    for name, widget in made.items():
        in_head = name in ("undo", "redo", "whole", "tour_back", "tour_next")
        widget.sizing_mode = None if in_head else "stretch_width"
        widget.margin = (0, 3) if in_head else (2, 4, 3, 4)
        widget.tags = [name]
        widget.stylesheets = ["assets/widgets.css"]
    return made


class _Template(pn.Template):
    """Panel's template, made three times as fast: it looks through all models for each of its
    parts, and writes a description of all parts for each."""

    def __repr__(self) -> str:
        return type(self).__name__

    def server_doc(self, doc: Any = None, *how: Any, **named: Any) -> Any:
        """Fill a document with the page."""
        document = doc or pn.state.curdoc
        document.validate = lambda: None  # nothing that a visitor does changes what it looks at
        with document.models.freeze():
            return super().server_doc(doc, *how, **named)


class Page:
    """The state of a visitor with its past, its widgets and its figures."""

    def __init__(self, start: State, scheduler: Scheduler, uploads: Uploads) -> None:
        self.doc, self.scheduler, self.uploads = pn.state.curdoc, scheduler, uploads
        self.history = History(start)
        self.widgets, self.figures = _widgets(), Figures()
        self.rows = ColumnDataSource({"ring": [], "x": [], "y": []}, name="rows")
        self.table = self._table()
        self.told = ColumnDataSource(
            {name: [""] for name in _TOLD} | {"request": [0], "stale": [[]]},
            name="told",
        )
        self.heard = ColumnDataSource(
            {"kind": [], "key": [], "figure": [], "shift": []}, name="heard"
        )
        # what no figure or widget refers to is not kept as it is here
        self.figures.aperture.figure.tags = [self.told, self.heard]
        self.downloads: dict[str, Any] = {}
        self.files: dict[str, asyncio.Future[bytes]] = {}
        self.pending: list[Point] = []
        self.filling = False
        self.trouble = self.notice = self.reading = ""
        self.is_outdated = False  # whether the source could not be made, and pictures are older
        self.is_hint = False
        self.wanted = 0  # the number of the newest request
        self.arrived: set[str] = set()  # views of which there is something of this request
        self.shown: dict[str, State] = {}  # what each view shows in full
        self.drag = {"on": False, "started": False, "until": 0.0}
        self.moved = (-1, 0.0)  # the vertex that keys have moved, and when
        self.step, self.before = -1, list[str]()  # of the tour, and the views of before it
        self.closed = False
        self.loop = IOLoop.current()
        self._connect()
        self.fill()
        self._show_views()
        self.template = self._template()
        self.doc.on_session_destroyed(lambda context: self.leave())

    @property
    def state(self) -> State:
        """The state on show."""
        return self.history.present

    # The page as a whole

    def _template(self) -> Any:
        w = self.widgets
        kinds = {"png": "PNG", "svg": "SVG", "npz": ".npz", "py": "Python"}
        files = [self._download(kind, label) for kind, label in kinds.items()]
        shapes = [self._download(f"outline_{kind}", f"Aperture: {label}") for kind, label in
                  (("geojson", "GeoJSON"), ("svg", "SVG"))]  # fmt: skip

        names = {
            "outline": ["shape", "upload", "unit", "snap", "draw", "finish", "insert", "delete"],
            "light": ["wave", "steering", "taper", "array", "window", "reach"],
            "views": ["views", "part", "coherence", "defocus", "distance", "order"],
            "point": ["x", "y", "nu_x", "nu_y"],
        }
        groups = {
            group: self._grid([w[name] for name in some]) for group, some in names.items()
        } | {
            "take": self._grid([w["take"], *files, *shapes, w["code"]]),
            "vertices": pn.pane.Bokeh(self.table, sizing_mode="stretch_width", margin=0),
            "tools": pn.Row(w["undo"], w["redo"], w["whole"], margin=0),
            "tour": pn.Row(w["tour_back"], w["tour_next"], margin=0),
            "figures": pn.pane.Bokeh(
                Row(children=[*self.figures.all.values()], stylesheets=[_FLAT]), margin=0
            ),
        }  # fmt: skip
        template = _Template(_file("html"), location=True, items=groups)
        known = {
            "told": self.told, "heard": self.heard, "table": self.table, "rows": self.rows,
            "figures": [*self.figures.all.values()], "with_keys": KEYS, "largest": LARGEST_UPLOAD,
            "outline": self.figures.aperture.outline, "vertices": self.figures.aperture.vertices,
        }  # fmt: skip
        self.doc.js_on_event(DocumentReady, CustomJS(args=known, code=_file("js")))
        return template

    @staticmethod
    def _grid(widgets: list[Any]) -> Any:
        """Widgets in two columns; those without a neighbour are as wide as both."""
        for widget in widgets:
            if not {*widget.tags} & _NARROW:
                widget.styles = {"grid-column": "1 / 3"}
        return pn.Column(*widgets, stylesheets=[_TWO], sizing_mode="stretch_width", margin=0)

    def _table(self) -> Any:
        numbers = {"editor": NumberEditor(), "width": 100}
        return DataTable(
            source=self.rows, editable=True, height=150, name="table", index_position=None,
            autosize_mode="fit_columns", sortable=False, reorderable=False,
            sizing_mode="stretch_width", margin=(2, 4, 3, 4),
            columns=[
                TableColumn(field="ring", title="outline", editor=CellEditor(), width=60),
                TableColumn(field="x", **numbers), TableColumn(field="y", **numbers),
            ],
        )  # fmt: skip

    def _download(self, kind: str, label: str) -> Any:
        made = pn.widgets.FileDownload(
            callback=partial(self._content, kind), filename=self._filename(kind), label=label,
            tags=[f"take_{kind}"], sizing_mode="stretch_width", margin=(2, 4, 3, 4), icon=None,
            stylesheets=["assets/widgets.css"],
        )  # fmt: skip
        self.downloads[kind] = made
        return made

    def _connect(self) -> None:
        """All callbacks of the page."""
        w, drawn = self.widgets, self.figures.aperture
        for name in _TEXTS:
            self._on_value(name, lambda value, name=name: self.edit(**{name: value}))
        for name in _LOOKS:
            self._on_value(name, lambda value, name=name: self.look(**{name: value or 0}))
        for name in ("x", "y", "nu_x", "nu_y"):
            self._on_value(name, lambda _: self._typed_point())
        for name, act in {
            "shape": self._start_from, "draw": self._toggled, "take": lambda _: self._show_code(),
            "views": lambda _: self._show_views(request=True), "upload": self._uploaded,
        }.items():  # fmt: skip
            self._on_value(name, act)
        for name, press in {
            "finish": self.finish, "whole": self.figures.reset,
            "undo": lambda: self.go(self.history.undone()),
            "redo": lambda: self.go(self.history.redone()),
            "insert": self._insert, "delete": self._delete,
            "tour_next": lambda: self._tour(1), "tour_back": lambda: self._tour(-1),
        }.items():  # fmt: skip
            safe = self._guarded(press)
            w[name].on_click(lambda _, safe=safe: safe())
        self._on_event(drawn.figure, PanStart, lambda _: self._dragging(True))
        self._on_event(drawn.figure, PanEnd, lambda _: self._dragging(False))
        self._on_event(drawn.figure, Tap, self._tapped)
        self._on_event(drawn.figure, DoubleTap, self._doubled)
        self._on_event(drawn.figure, MouseMove, self._hovered)
        self._on_event(drawn.figure, MouseLeave, lambda _: self._lags(self.state.x))
        for name in ("fourier", "wigner_nu", "wigner_x"):
            self._on_event(self.figures.all[name], Tap, partial(self._chosen, name))
        self._on_data(drawn.outline, self._edited)
        # a cell: Bokeh is still at it, and must not find other data
        typed = self._guarded(self._from_table)
        self._on_data(self.rows, lambda _: self.doc.add_next_tick_callback(lambda: typed()))
        self._on_data(self.heard, self._heard)
        row = self._guarded(lambda rows: drawn.choose(rows[0]) if rows else None)
        self.rows.selected.on_change("indices", lambda attr, old, new: row(new))

    def _guarded(self, work: Callable[..., Any]) -> Callable[..., None]:
        """Work that is left out while widgets are filled, and whose errors become messages."""

        def run(*arguments: Any) -> None:
            if self.filling:
                return
            try:
                work(*arguments)
            except PolywignerError as error:
                self.say(str(error))
            except Exception as error:  # no traceback reaches the page
                fault(error)
                self.say(_FAULT)

        return run

    def _on_value(self, name: str, work: Callable[[Any], Any]) -> None:
        safe = self._guarded(work)
        self.widgets[name].param.watch(lambda event: safe(event.new), "value")

    def _on_data(self, source: Any, work: Callable[[Any], Any]) -> None:
        # Bokeh looks at the number of parameters: exactly three, by name
        safe = self._guarded(work)
        source.on_change("data", lambda attr, old, new: safe(new))

    def _on_event(self, figure: Any, event: Any, work: Callable[[Any], Any]) -> None:
        safe = self._guarded(work)
        figure.on_event(event, lambda happened: safe(happened))

    # States

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
        """Another look at the same source, which is no step of undo."""
        self.edit(step=False, edges=False, **changes)

    def go(self, history: History, edges: bool = True) -> None:
        """Another history: an edit, undo or redo."""
        before, self.history = self.state, history
        with self.filled():
            self.say("")
            self.fill(edges)
            if history.present != before:
                self.request()
            else:
                self.tell(kind=self.told.data["kind"][0])

    @contextmanager
    def filled(self) -> Iterator[None]:
        """Changes of widgets and figures that go out together, without their telling them back."""
        before, self.filling = self.filling, True
        try:
            with pn.io.unlocked():
                yield
        finally:
            self.filling = before

    def fill(self, edges: bool = True) -> None:
        """Put the state into widgets and handles."""
        w, state = self.widgets, self.state
        with self.filled():
            for name, label in _LABELS.items():
                w[name].label = label.format(state.unit)
            for name in (*_TEXTS, *_LOOKS):
                value = getattr(state, name)
                if name in _SLIDERS:  # as wide as the value needs
                    w[name].param.update(
                        start=min(w[name].start, value), end=max(w[name].end, value), value=value
                    )
                else:
                    w[name].value = value
            w["x"].value, w["y"].value = state.x
            w["nu_x"].value, w["nu_y"].value = state.nu
            w["undo"].disabled, w["redo"].disabled = not self.history.past, not self.history.future
            rows = outlines.rows_of_rings(state.rings)
            columns = map(list, zip(*rows, strict=True)) if rows else ([], [], [])
            known = (list(self.rows.data[name]) for name in ("ring", "x", "y"))
            if list(zip(*known, strict=True)) != rows:
                self.rows.data = dict(zip(("ring", "x", "y"), columns, strict=True))
            for k, axis in enumerate("xy", 1):
                self.table.columns[k].title = f"{axis} ({state.unit})"
            if not state.rings:
                self.figures.aperture.clear()
            if edges:
                self.figures.aperture.show_edges(state)  # not under a vertex that is being dragged
            self.figures.mark(state)

    def say(self, text: str, hint: bool = False) -> None:
        """Show a notice or a hint, beside the error of the source."""
        self.notice, self.is_hint = text, hint
        lines = [
            (self.reading, True),
            (self.notice, self.is_hint),
            (self.trouble, not self.state.rings),
        ]
        self.tell(message="".join(
            f'<div role="{"status" if hint else "alert"}" class="{"hint" if hint else "alert"}">'
            f"{escape(text)}</div>" for text, hint in lines if text
        ))  # fmt: skip

    def tell(self, **texts: Any) -> None:
        """Tell the page's script; unchanged texts are not sent."""
        data = {**self.told.data, **{name: [text] for name, text in texts.items()}}
        if data != self.told.data or "kind" in texts:
            self.told.data = data

    # Computations

    @property
    def visible(self) -> tuple[str, ...]:
        """The views that are computed."""
        return (*(name for name in VIEWS if name in self.widgets["views"].value), "values")

    def request(self) -> None:
        """Compute the visible views of the state; whatever was being computed is dropped.

        Those that are shown as they would be computed stay.
        """
        self.wanted += 1
        self.arrived = set()
        names = tuple(n for n in self.visible if self.shown.get(n) != needed(self.state, n))
        self._computing(names, (), (*names, "lags"))
        self.scheduler.submit(id(self), partial(self._compute, self.state, names, self.wanted))

    def _compute(self, state: State, names: tuple[str, ...], number: int) -> Iterator[None]:
        """Compute in the scheduler's thread; send results to the page's own, soon ones together.

        Each message costs the browser a frame, of all figures that there are.
        """
        found: list[Arrived] = []
        todo: list[tuple[str, int]] = []
        show = partial(self._show, state, names, found, number)
        for result in views.results(state, names):
            if result is not None:
                if result.name == "source":
                    partly = state.coherence > 0
                    todo = [] if result.error else views.queue(names, views.edges_of(state), partly)
                else:
                    todo = todo[1:]
                found.append((result, todo))
                if len(found) <= 1 and todo:  # otherwise one of them is waited for
                    self._later(show, _GATHERED)
            yield
        self._later(partial(show, is_last=True))

    def _later(self, callback: Callable[..., None], after: float = 0.0) -> None:
        """Call this in the page's own thread, so many seconds from now."""
        if not self.closed:
            self.loop.add_callback(self.loop.call_later, after, self._soon, callback)

    def _soon(self, callback: Callable[..., None]) -> None:
        with suppress(Exception):  # a visitor leaves in this moment: Bokeh takes the page apart
            if not self.closed:
                self.doc.add_next_tick_callback(lambda: callback())

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
            if pn.state.location:
                pn.state.location.search = f"?{to_query(self.state)}"
            todo: list[tuple[str, int]] = []
            while found:
                result, todo = found.pop(0)
                self._show_one(state, result)
                self.arrived.add(result.name)
            if is_last:
                self._ready()
            else:
                self._computing(names, todo, [n for n in names if n not in self.arrived])

    def _show_one(self, state: State, result: views.Result) -> None:
        self.shown.pop(result.name, None)
        if result.name == "source":
            self.trouble, self.is_outdated = result.error, bool(result.error)
            if not state.rings:
                self.shown.clear()
                for name in (*VIEWS, "values", "lags"):
                    self._clear(name)
            elif result.error:
                self.trouble += ". What is shown is the last that could be computed."
            self._show_code()
        elif result.error:
            self.trouble = f"{VIEWS.get(result.name, result.name)}: {result.error}"
            self._clear(result.name)
        if result.error or result.name == "source":
            self.say(self.notice, self.is_hint)
        if not result.error:
            if result.name != "source" and result.is_final(state):
                self.shown[result.name] = needed(state, result.name)
            try:
                self._show_value(state, result)
            except Exception as error:  # no traceback reaches the page
                fault(error)
                self.say(f"{result.name} could not be shown; this is a fault of polywigner")

    def _show_value(self, state: State, result: views.Result) -> None:
        if result.name == "values":
            self.tell(values=_table_of(result.value, state))
            return
        if result.name == "near":
            self.tell(note=escape(result.value.note))
        self.figures.show(state, result.name, result.value)

    def _clear(self, name: str) -> None:
        """Empty a view that cannot be computed for this source."""
        if name in ("values", "near"):
            self.tell(**{{"near": "note"}.get(name, name): ""})
        for made in self.figures.of(name):
            made.clear()

    def _computing(
        self, asked: Collection[str], todo: Collection[tuple[str, int]], stale: Collection[str]
    ) -> None:
        """Show the view that is computed now, and which views are of an older state."""
        pictures = [name for name in asked if name in VIEWS]
        done = len(set(pictures) - {name for name, _ in todo})
        text = "computing …"
        if todo and pictures:
            name, samples = next(iter(todo))
            size = f", {samples} × {samples}" if samples else ""
            what = VIEWS.get(name, "values")
            text = f"computing {what}{size}: {done} of {len(pictures)} pictures done"
        self._status("computing", text, stale)

    def _ready(self) -> None:
        """Say that nothing more comes, and whether pictures are of the outline on show."""
        if not self.state.rings:
            self._status("outdated", "nothing drawn", ())
        elif self.is_outdated:
            self._status("outdated", "pictures of an earlier state", [*self.visible, "lags"])
        else:
            self._status("ready", "ready", ())

    def _status(self, kind: str, text: str, stale: Collection[str]) -> None:
        figures = [made.figure.name for name in stale for made in self.figures.of(name)]
        self.tell(kind=kind, status=text, request=self.wanted, stale=figures)

    def _show_views(self, request: bool = False) -> None:
        for name in VIEWS:
            for made in self.figures.of(name):
                made.figure.visible = name in self.visible
        if request:
            self.request()

    # Outlines

    def _start_from(self, name: str) -> None:
        if not name:
            return
        with self.filled():
            self.widgets["shape"].value = ""  # so that the same shape can be chosen again
        shape = CATALOGUE.get(name)
        rings = outlines.rings_of_aperture(shape()) if shape else ()
        self.edit(rings=rings, x=(0.0, 0.0))
        self.widgets["draw"].value = shape is None

    def _edited(self, data: Any) -> None:
        """Outlines from the browser: a vertex was dragged, or deleted there."""
        columns = zip(data["number"], data["xs"], data["ys"], strict=True)
        left = {k: tuple(zip(map(float, xs), map(float, ys), strict=True)) for k, xs, ys in columns}
        before, drag = self.state.rings, self.drag
        rings, farewell = outlines.without_lost(before, left)
        rings = outlines.rounded_where_new(rings, before, self._digit())
        if rings == before:
            self.tell(kind=self.told.data["kind"][0])
            return
        moved = [*map(len, rings)] == [*map(len, before)]
        same = moved and (drag["on"] or time.monotonic() < drag["until"])
        step = not (drag["started"] and same)
        drag["started"] = bool(drag["on"] or not step)
        self.edit(step=step, edges=bool(farewell), rings=rings)
        if farewell:
            self.say(farewell, hint=True)

    def _dragging(self, on: bool) -> None:
        # where a hand comes to rest may arrive after its end: it is the same step of undo
        started = self.drag["started"] and not on
        self.drag.update(on=on, started=started, until=time.monotonic() + _TOGETHER)
        if not on and self.state.snap > 0:
            self.edit(step=False, rings=outlines.snapped(self.state.rings, self.state.snap))

    def _from_table(self) -> None:
        data = self.rows.data
        rows = list(zip(data["ring"], data["x"], data["y"], strict=True))
        if any(x is None or y is None for _, x, y in rows):
            self.fill()
            return
        self.edit(rings=outlines.rings_of_rows(rows))

    def delete(self, vertex: int) -> str:
        """Take a vertex away, and name all that goes with it."""
        rings, farewell = outlines.without_vertex(self.state.rings, vertex)
        self.edit(rings=rings)
        if farewell:
            self.say(farewell, hint=True)
        return farewell

    def _delete(self) -> None:
        vertex = self.figures.aperture.chosen
        if vertex is None:
            self.say(_NONE_CHOSEN)
        else:
            self.delete(vertex)

    def _insert(self) -> None:
        vertex = self.figures.aperture.chosen
        if vertex is None:
            self.say(_NONE_CHOSEN)
            return
        self.edit(rings=outlines.with_vertex_after(self.state.rings, vertex))
        self.figures.aperture.choose(vertex + 1)

    def _toggled(self, active: bool) -> None:
        self.pending.clear()
        self.figures.aperture.pending.data = {"x": [], "y": []}
        self.widgets["finish"].disabled = not active
        self.widgets["draw"].button_type = "primary" if active else "default"
        self.say(_DRAWING if active else "", hint=True)

    def finish(self) -> None:
        """Close the outline that is being drawn."""
        if not self.widgets["draw"].value:
            return
        ring = tuple(self.pending)
        self.widgets["draw"].value = False
        if len(ring) < 3:
            self.say("An outline needs three corners at least.")
            return
        self.edit(rings=(*self.state.rings, ring))

    def _corner(self, point: Point) -> None:
        """Another corner of the outline that is being drawn, or its first once more."""
        if len(self.pending) >= 3 and self._near(point, self.pending[0]):
            self.finish()
            return
        self.pending.append(self._placed(point))
        x, y = map(list, zip(*self.pending, strict=True))
        self.figures.aperture.pending.data = {"x": x, "y": y}

    # Places in figures

    def _digit(self, figure: str = "aperture") -> float:
        """The length in a figure to which places are rounded: a tenth of a percent of it."""
        window = self.figures.all[figure].x_range
        return _NEAR_VERTEX / 20 * abs(window.end - window.start)

    def _near(self, a: Point, b: Point) -> bool:
        reach = 20 * self._digit()
        return abs(a[0] - b[0]) < reach and abs(a[1] - b[1]) < reach

    def _is_vertex(self, point: Point) -> bool:
        return any(self._near(point, vertex) for ring in self.state.rings for vertex in ring)

    def _placed(self, point: Point) -> Point:
        """On the raster, if there is one."""
        ((found,),) = outlines.snapped(((point,),), self.state.snap)
        return found

    def _tapped(self, event: Any) -> None:
        """A click into the aperture: a corner of a new outline, a vertex, or a position."""
        point = outlines.rounded((float(event.x), float(event.y)), self._digit())
        if self.widgets["draw"].value:
            self._corner(point)
        elif not self._is_vertex(point):
            self.look(x=point)

    def _doubled(self, event: Any) -> None:
        if not self.widgets["draw"].value:
            point = self._placed(outlines.rounded((event.x, event.y), self._digit()))
            if not self._is_vertex(point):
                self.edit(rings=outlines.with_vertex_near(self.state.rings, point))

    def _hovered(self, event: Any) -> None:
        """The lag slice follows the pointer; a tenth of a millisecond, so without the scheduler."""
        if event.x is not None and event.y is not None and not self.widgets["draw"].value:
            self._lags((float(event.x), float(event.y)))

    def _lags(self, point: Point) -> None:
        if not self.trouble:  # otherwise the outline is none at present
            state = self.state.moved(x=point)
            self.figures.lags.show(views.lag_rings(state), state, point)

    def _chosen(self, name: str, event: Any) -> None:
        point = outlines.rounded((float(event.x), float(event.y)), self._digit(name))
        self.look(**{"x" if name == "wigner_x" else "nu": point})

    def _typed_point(self) -> None:
        x, y, nu_x, nu_y = (self.widgets[name].value for name in ("x", "y", "nu_x", "nu_y"))
        if None not in (x, y, nu_x, nu_y):
            self.look(x=(x, y), nu=(nu_x, nu_y))

    # Keys

    def _heard(self, data: Mapping[str, Any]) -> None:
        """A key, or a file that the page did not send."""
        kind, key, figure, shift = (data[name][0] for name in ("kind", "key", "figure", "shift"))
        drawing = self.widgets["draw"].value
        if kind == "refused":
            check_upload(str(key), int(shift))
        elif key in ("undo", "redo"):
            self.go(self.history.undone() if key == "undo" else self.history.redone())
        elif key == "finish":
            self.finish()
        elif drawing and key == "Escape":
            self.widgets["draw"].value = False
        elif drawing and key == " " and figure == "aperture":
            self._corner(self.state.x)
        elif key in _ARROWS and figure in KEYS:
            self._arrow(key, figure, _FASTER if shift else 1)
        elif figure == "aperture" and not drawing:
            self._vertex_key(key)

    def _step(self, figure: str) -> float:
        if self.state.snap > 0 and figure in ("aperture", "wigner_x"):
            return self.state.snap
        window = self.figures.all[figure].x_range
        return round_step(abs(window.end - window.start) / _ACROSS)

    def _arrow(self, key: str, figure: str, times: int) -> None:
        step = times * self._step(figure)
        chosen = self.figures.aperture.chosen if figure == "aperture" else None
        if chosen is not None and not self.widgets["draw"].value:
            self._move(chosen, key, step)
            return
        name = "x" if figure in ("aperture", "wigner_x") else "nu"
        x, y = there = moved(getattr(self.state, name), key, step)
        self.look(**{name: there})
        unit = self.state.unit if name == "x" else f"1/{self.state.unit}"
        self.say(f"{'x' if name == 'x' else 'ν'} = ({x:g}, {y:g}) {unit}", hint=True)

    def _move(self, chosen: int, key: str, step: float) -> None:
        now, (vertex, last) = time.monotonic(), self.moved
        there = moved(self._vertices()[chosen], key, step)
        rings = outlines.with_vertex_at(self.state.rings, chosen, there)
        self.edit(step=vertex != chosen or now - last > _TOGETHER, rings=rings)
        self.moved = (chosen, now)
        self.choose(chosen)

    def _vertex_key(self, key: str) -> None:
        chosen = self.figures.aperture.chosen
        if key in ("n", "N", "p", "P"):
            by = 1 if key in "nN" else -1
            self.choose(((-1 if by > 0 else 0) if chosen is None else chosen) + by)
        elif key == "Escape":
            self.figures.aperture.choose(None)
            self.say("")
        elif key in ("Insert", "Delete") and chosen is not None:
            self.moved = (-1, 0.0)
            if key == "Insert":
                self.edit(rings=outlines.with_vertex_after(self.state.rings, chosen))
                self.choose(chosen + 1)
            elif not self.delete(chosen):
                self.choose(chosen)

    def _vertices(self) -> list[Point]:
        return [(x, y) for _, x, y in outlines.rows_of_rings(self.state.rings)]

    def choose(self, vertex: int) -> None:
        """Select a vertex, counted around, and say where it is."""
        vertices = self._vertices()
        if vertices:
            vertex %= len(vertices)
            self.figures.aperture.choose(vertex)
            x, y = vertices[vertex]
            place = f"({x:g}, {y:g}) {self.state.unit}"
            self.say(f"Vertex {vertex + 1} of {len(vertices)}: {place}", hint=True)

    # Files, and the tour

    def _uploaded(self, content: bytes | None) -> None:
        """Read a file in a process of its own; the page goes on meanwhile, and says so."""
        upload = self.widgets["upload"]
        if not content:
            return
        name, unit = str(upload.filename), self.state.unit
        upload.clear()  # so that the same file can be sent again

        def take(found: Any) -> None:
            self.reading = ""
            if isinstance(found, PolywignerError):
                self.say(str(found))
            else:
                self.edit(rings=found, unit=unit, x=(0.0, 0.0))

        then = self._guarded(take)
        self.uploads.submit(
            id(self), name, content, unit, lambda found: self._later(partial(then, found))
        )
        self.reading = f"Reading {name} …"
        self.say("")

    def _filename(self, kind: str) -> str:
        if kind.startswith("outline_"):
            return f"aperture.{kind.removeprefix('outline_')}"
        return f"{self.widgets['take'].value}.{kind}"

    async def _content(self, kind: str) -> io.BytesIO:
        """A file, made in the scheduler's thread; the newest of a kind wins."""
        state, name = self.state, self.widgets["take"].value
        last, future = self.files.get(kind), asyncio.get_running_loop().create_future()
        self.files[kind] = future
        if last is not None and not last.done():
            last.set_exception(ArgumentError("expected one file at a time, got two"))

        def settle(content: bytes | Exception) -> None:
            if not future.done():
                failed = isinstance(content, Exception)
                (future.set_exception if failed else future.set_result)(content)

        def steps() -> Iterator[None]:
            try:
                content: bytes | Exception = _made(state, name, kind)
            except PolywignerError as error:
                content = error
            self.loop.add_callback(settle, content)
            yield

        self.scheduler.submit((id(self), kind), steps)
        try:
            return io.BytesIO(await future)
        except PolywignerError as error:
            self.say(str(error))
            raise

    def _show_code(self) -> None:
        """The snippet of the view that is chosen to be taken away, and the names of its files."""
        name = self.widgets["take"].value
        for kind, made in self.downloads.items():
            made.filename = self._filename(kind)
        try:
            self.widgets["code"].value = snippet(self.state, name)
        except PolywignerError as error:
            self.widgets["code"].value = f"# {error}\n"

    def _tour(self, by: int) -> None:
        """The next or the last step of the tour; after its end all is as before."""
        w = self.widgets
        if self.step >= 0:
            self._frame(STEPS[self.step][0], "#8a939c", 1)
        step = self.step = self.step + by if self.step + by < len(STEPS) else -1
        w["tour_back"].visible = step > 0
        if step < 0:
            w["views"].value = self.before
            w["tour_next"].label = "What am I looking at?"
            self.tell(tour="", point="")
            return
        figure, heading, text = STEPS[step]
        if step == 0 and by > 0:
            self.before = [*w["views"].value]
        view = figure.removeprefix("rays_")
        if view in VIEWS:  # what is spoken of can be seen
            w["views"].value = [n for n in VIEWS if n in self.before or n == view]
        self._frame(figure, "#ffb000", 4)
        said = f"<b>{step + 1} of {len(STEPS)}: {heading}.</b> {text}"
        self.tell(tour=said, point=figure)
        w["tour_next"].label = "Next" if step + 1 < len(STEPS) else "End of the tour"

    def _frame(self, figure: str, colour: str, width: int) -> None:
        self.figures.all[figure].update(outline_line_color=colour, outline_line_width=width)

    def leave(self) -> None:
        """The visitor has left: nothing is computed any more, and the memory comes back."""
        self.closed = True
        self.scheduler.forget(id(self))
        for kind in self.files:
            self.scheduler.forget((id(self), kind))
        self.uploads.forget(id(self))
        for image in self.figures.images.values():
            image.clear()
        # pages are cycles of references: Python alone would wait for hundreds of them
        self.scheduler.submit("garbage", _collect)


def _made(state: State, name: str, kind: str) -> bytes:
    """A view, or the outline, as a file of this kind."""
    if kind == "outline_geojson":
        return exports.geojson(state).encode()
    if kind == "outline_svg":
        return exports.svg(state).encode()
    if kind == "py":
        return snippet(state, name).encode()
    if kind == "npz":
        return exports.values_file(state, name)
    return exports.picture_file(state, name, kind)


def round_step(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max((m * power for m in (1, 2, 5) if m * power <= length * (1 + 1e-9)), default=power)


def moved(point: Point, key: str, step: float) -> Point:
    """A point after an arrow, without stray digits."""
    digits = max(0, 3 - math.floor(math.log10(step)))
    x, y = (c + step * d for c, d in zip(point, _ARROWS[key], strict=True))
    return round(x, digits) + 0.0, round(y, digits) + 0.0


def _table_of(values: dict[str, tuple[complex, str]], state: State) -> str:
    rows = ""
    for name, (value, quantity) in values.items():
        factor, unit = in_unit(quantity, state.unit)
        rows += f"<tr><td>{name}</td><td>{_number(value * factor)} {unit}</td></tr>"
    return f"<table>{rows}</table>"


def _number(value: complex) -> str:
    """Text of a number with twelve digits, enough to compare with another computation."""
    if value.imag == 0:
        return f"{value.real:.12g}"
    return f"{value.real:.12g} {'+' if value.imag >= 0 else '−'} {abs(value.imag):.12g} i"
