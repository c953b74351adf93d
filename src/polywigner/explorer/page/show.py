"""From states and results to widgets and figures."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from bokeh.events import DocumentReady
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, CustomJS, InlineStyleSheet

from polywigner.errors import PolywignerError
from polywigner.explorer import windows
from polywigner.explorer.editing import rows_of_rings
from polywigner.explorer.page import script, theme
from polywigner.explorer.page.controls import VIEWS, Controls
from polywigner.explorer.page.drawings import ApertureFigure, LagFigure, PolarFigure
from polywigner.explorer.page.pictures import ImageFigure, replaced
from polywigner.explorer.results import Result
from polywigner.explorer.shown import in_unit, shown
from polywigner.explorer.snippets import snippet
from polywigner.explorer.state import History, State


def _styled(text: str) -> list[Any]:
    return [InlineStyleSheet(css=text)]


def arranged(head: Any, side: Any, figures: list[Any], point: Any) -> Any:
    """The page: a line of messages above controls and figures."""
    point.stylesheets = _styled(theme.POINT)
    grid = row(*figures, point, stylesheets=_styled(theme.GRID), name="figures")
    main = column(grid, stylesheets=_styled(theme.MAIN), name="main")
    for name, text in (("busy", theme.BUSY), ("message", theme.MESSAGE)):
        for made in head.select({"name": name}):
            made.stylesheets = _styled(text)
    head.stylesheets, side.stylesheets = _styled(theme.HEAD), _styled(theme.SIDE)
    return column(head, side, main, stylesheets=_styled(theme.PAGE), name="page")


def connect_layout(doc: Any, page: Any, figures: list[Any], drawer: Any, groups: list[Any]) -> None:
    """Figures as large as the window lets them be, and controls as many as it has room for."""
    known = {
        "page": page, "main": page.children[2], "figures": figures, "drawer": drawer,
        "groups": [group.heading for group in groups], "narrow": theme.NARROW,
        "heights": [group.height for group in groups],
    }  # fmt: skip
    doc.js_on_event(DocumentReady, CustomJS(args=known, code=script.ARRANGE))
    doc.js_on_event(DocumentReady, CustomJS(args={"figure": figures[0]}, code=script.QUICK_PAINT))
    doc.js_on_event(DocumentReady, CustomJS(args={"figures": figures}, code=theme.PAINT))


@contextmanager
def together(doc: Any) -> Iterator[None]:
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
        _send(doc)


def _send(doc: Any) -> None:
    session: Any = getattr(doc.session_context, "session", None)
    try:
        # of Bokeh's own, for which there is no public name
        events, writes = doc.callbacks._held_events, session._pending_writes
        connections = [(c.protocol, c._socket) for c in session._subscribed_connections]
    except AttributeError:  # another version, or no session yet
        doc.unhold()
        return
    if writes is None or not all(getattr(e, "setter", session) is None for e in events):
        doc.unhold()  # also of what is no change of a model, or comes from the browser
        return
    doc.callbacks._held_events = []
    doc.unhold()
    for protocol, socket in connections if events else ():
        writes.append(socket.send_message(protocol.create("PATCH-DOC", events)))


_NEAR = ("rays_near", "exact_near", "difference_near")


def _figures(views: Collection[str]) -> list[str]:
    """Names of the figures of views."""
    return [f for view in views for f in (_NEAR if view == "near" else (view,))]


class Status:
    """The line above the figures, and the figures that are pale as they are of an older state."""

    def __init__(self, line: Any) -> None:
        self.line = line
        self.stale = ColumnDataSource({"figure": []}, name="stale")
        self.request = 0  # the number of the newest

    def show_on(self, doc: Any, figures: Sequence[Any]) -> None:
        """Let the page count seconds, and make older pictures pale."""
        counted = CustomJS(args={"busy": self.line}, code=script.ELAPSED)
        doc.js_on_event(DocumentReady, counted)
        pale = CustomJS(args={"figures": [*figures], "stale": self.stale}, code=script.STALE)
        self.stale.js_on_change("data", pale)
        doc.js_on_event(DocumentReady, pale)

    def _say(self, kind: str, text: str, stale: Collection[str]) -> None:
        # the page itself counts the seconds of what is "computing"
        self.line.text = (
            f'<span class="{kind}" data-request="{self.request}"><span role="status">{text}</span> '
            '<span class="elapsed" aria-hidden="true"></span></span>'
        )
        figures = _figures(stale)
        if self.stale.data["figure"] != figures:
            self.stale.data = {"figure": figures}

    def computing(
        self, asked: Sequence[str], todo: Sequence[tuple[str, int]], stale: Collection[str]
    ) -> None:
        """Show which of the requested views are being computed.

        Parameters
        ----------
        asked : names of views.
        todo : what is still to be computed: names and samples along an axis, the first one now.
        stale : the views of which nothing has come yet.
        """
        pictures = [name for name in asked if name in VIEWS]
        done = len(set(pictures) - {name for name, _ in todo})
        text = "computing …"
        if todo and pictures:
            name, samples = todo[0]
            size = f", {samples} × {samples}" if samples else ""
            what = VIEWS.get(name, "values")
            text = f"computing {what}{size}: {done} of {len(pictures)} pictures done"
        self._say("computing", text, stale)

    def ready(self, views: Collection[str], trouble: bool, blank: bool) -> None:
        """Say that nothing more comes, and whether pictures are of the outline on show."""
        if blank:
            self._say("outdated", "nothing drawn", ())
        elif trouble:
            self._say("outdated", "pictures of an earlier state", [*views, "lags"])
        else:
            self._say("ready", "ready", ())


PARTS = ("level", "real", "phase")
ORDERS = (1, 3)
_PARTS_NEAR = ("rays", "exact", "difference")


def fill(controls: Controls, history: History) -> None:
    """The widgets as the state has them."""
    state = history.present
    texts = ("unit", "wave", "taper", "array", "window", "steering", "polarisation")
    for name in (*texts, "snap", "reach"):
        getattr(controls, name).value = getattr(state, name)
    controls.x.value, controls.y.value = state.x
    controls.nu_x.value, controls.nu_y.value = state.nu
    controls.x.title, controls.y.title = (f"{name} ({state.unit})" for name in "xy")
    controls.nu_x.title, controls.nu_y.title = (f"{n} (1/{state.unit})" for n in ("ν_x", "ν_y"))
    controls.part.active = PARTS.index(state.part)
    controls.order.active = ORDERS.index(state.order)
    _slide(controls.coherence, state.coherence)
    controls.coherence.title = f"Coherent over ({state.unit}; 0: all; of W)"
    _slide(controls.defocus, state.defocus)
    _slide(controls.distance, state.distance)
    controls.distance.title = f"Near field at z ({state.unit})"
    controls.snap.title = f"Snap to ({state.unit})"
    rows = rows_of_rings(state.rings)
    columns = list(zip(*rows, strict=True)) if rows else [(), (), ()]
    controls.rows.data = dict(zip(("ring", "x", "y"), map(list, columns), strict=True))
    controls.undo.disabled, controls.redo.disabled = not history.past, not history.future
    controls.table.columns[1].title = f"x ({state.unit})"
    controls.table.columns[2].title = f"y ({state.unit})"


def _slide(slider: Any, value: float) -> None:
    """A slider at a value, and as wide as that needs."""
    slider.update(start=min(slider.start, value), end=max(slider.end, value), value=value)


def show_code(controls: Controls, state: State) -> None:
    """The snippet of the view that is chosen to be taken away."""
    try:
        controls.code.value = snippet(state, controls.take.value)
    except PolywignerError as error:
        controls.code.value = f"# {error}\n"


class Figures:
    """All figures of one visitor."""

    def __init__(self) -> None:
        self.aperture, self.lags, self.polar = ApertureFigure(), LagFigure(), PolarFigure()
        self.images = {
            "fourier": ImageFigure("fourier", "F(ν)", "ν"),
            "wigner_nu": ImageFigure("wigner_nu", "W over ν", "ν"),
            "wigner_x": ImageFigure("wigner_x", "W over x", "x"),
            "otf": ImageFigure("otf", "OTF", "ξ"),
            **{f"{key}_near": ImageFigure(f"{key}_near", key, "x") for key in _PARTS_NEAR},
        }
        self.set_visible(())
        made = {name: image.figure for name, image in self.images.items()}
        self.all = [
            self.aperture.figure, made["fourier"], made["wigner_nu"],
            made["wigner_x"], made["otf"], self.polar.figure, self.lags.figure,
            *(made[f"{key}_near"] for key in _PARTS_NEAR),
        ]  # fmt: skip

    def of(self, name: str) -> list[Any]:
        """The Bokeh figures of a view."""
        if name == "near":
            return [self.images[f"{key}_near"].figure for key in _PARTS_NEAR]
        return [self.polar.figure if name == "far" else self.images[name].figure]

    def clear(self, name: str, controls: Controls) -> None:
        """Empty the views that cannot be computed for this source."""
        if name == "values":
            controls.values.text = ""
        elif name == "far":
            self.polar.clear()
        else:
            controls.note.text = "" if name == "near" else controls.note.text
            for key in [f"{key}_near" for key in _PARTS_NEAR] if name == "near" else [name]:
                self.images[key].clear()

    def clear_all(self, controls: Controls) -> None:
        """Nothing is drawn: no pictures, no values."""
        self.lags.clear()
        for name in (*VIEWS, "values"):
            self.clear(name, controls)

    def reset(self) -> None:
        """All figures as they are before anybody zooms."""
        self.aperture.reset()
        self.polar.reset()
        for image in self.images.values():
            image.reset()

    def by_name(self, name: str) -> Any:
        """A Bokeh figure by its own name."""
        drawn: dict[str, Any] = {
            "aperture": self.aperture, "lags": self.lags, "far": self.polar, **self.images,
        }  # fmt: skip
        return drawn[name].figure

    def set_visible(self, names: tuple[str, ...]) -> None:
        """Show these views and hide the others."""
        for view in VIEWS:
            for made in self.of(view):
                made.visible = view in names

    def frame(self, state: State) -> None:
        """The window of the aperture, around all outlines and the source."""
        points = np.array([p for ring in state.rings for p in ring] or [(-5.0, -5.0), (5.0, 5.0)])
        if state.array:
            try:
                x, y, half = (v * state.per_metre for v in windows.position_window(state))
                points = np.array([(x - half, y - half), (x + half, y + half)])
            except PolywignerError:
                pass  # the source's error is told where it is computed
        low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        self.aperture.frame(tuple(low), tuple(high), state.unit)

    def mark(self, state: State) -> None:
        """The crosses at the chosen point."""
        replaced(self.aperture.cross, {"x": [state.x[0]], "y": [state.x[1]]})
        self.images["wigner_x"].mark(state.x)
        for name in ("fourier", "wigner_nu"):
            self.images[name].mark(state.nu)

    def show(self, state: State, result: Result, controls: Controls) -> None:
        """One result."""
        if result.name == "source":
            self.aperture.show_outlines(result.value, state)
            self.lags.show(result.value.lags, state, windows.lag_half(state), state.x)
        elif result.name == "values":
            controls.values.text = _table_of(result.value, state)
        elif result.name == "far":
            self.polar.show(result.value)
        elif result.name == "near":
            controls.note.text = result.value.note
            for key in _PARTS_NEAR:
                what = shown(result.value, key, unit=state.unit)
                self.images[f"{key}_near"].update(result.value, what, state, None)
        else:
            picture = result.value
            key = next(iter(picture.arrays))
            cross = {"fourier": state.nu, "wigner_nu": state.nu, "wigner_x": state.x}
            what = shown(picture, key, state.part, state.unit)
            self.images[result.name].update(picture, what, state, cross.get(result.name))


def _table_of(values: dict[str, tuple[complex, str]], state: State) -> str:
    rows = ""
    for name, (value, quantity) in values.items():
        factor, unit = in_unit(quantity, state.unit)
        rows += f"<tr><td>{name}</td><td>{_number(value * factor)} {unit}</td></tr>"
    return f'<table aria-live="polite">{rows}</table>'


def _number(value: complex) -> str:
    """Text of a number with twelve digits, enough to compare with another computation."""
    if value.imag == 0:
        return f"{value.real:.12g}"
    return f"{value.real:.12g} {'+' if value.imag >= 0 else '−'} {abs(value.imag):.12g} i"
