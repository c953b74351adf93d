"""Acts of visitors, as edits of the state."""

from __future__ import annotations

import base64
import binascii
import logging
import math
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from bokeh.events import DoubleTap, MouseLeave, MouseMove, PanEnd, PanStart, Tap

from polywigner.errors import PolywignerError
from polywigner.explorer import exports, outlines, views
from polywigner.explorer.page.browser import WITH_KEYS
from polywigner.explorer.page.controls import MOVED, ORDERS, PARTS, TYPED, VIEWS
from polywigner.explorer.snippets import snippet
from polywigner.explorer.state import CATALOGUE, Point, State

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session

_REST = 1.0  # seconds
_NEAR_VERTEX = 0.02  # of the window: a click there means the vertex
_ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
_FASTER = 10  # steps, with Shift
_STEPS = 100  # across a figure, where no raster is set
_TOGETHER = 1.0  # seconds: moves of one vertex that follow so soon are one step of undo
_KINDS = {
    "png": "image/png", "svg": "image/svg+xml", "npz": "application/octet-stream",
    "py": "text/x-python", "geojson": "application/geo+json",
}  # fmt: skip


def connect(session: Session) -> None:
    """All callbacks of one visitor's page."""
    _connect_outline(session)
    _connect_drawing(session)
    _connect_vertices(session)
    _connect_files(session)
    _connect_points(session)
    _connect_fields(session)
    _connect_downloads(session)
    _connect_tour(session)


# --- Callbacks that answer faults with messages, and do not answer themselves


def guarded(session: Session, work: Callable[..., None]) -> Callable[..., None]:
    """Work that is left out while widgets are filled, and whose errors become messages."""

    def run(*arguments: Any) -> None:
        if session.filling:
            return
        try:
            work(*arguments)
        except PolywignerError as error:
            session.say(str(error))
        except Exception:  # no traceback reaches the page
            logging.getLogger("polywigner.explorer").exception("a request failed")
            session.say("This could not be done; it is a fault of polywigner.")

    return run


def _on_change(session: Session, widget: Any, name: str, work: Callable[[Any], None]) -> None:
    """Call work with the new value of a widget's property."""
    # Bokeh looks at the number of parameters: exactly three, by name
    safe = guarded(session, work)
    widget.on_change(name, lambda attr, old, new: safe(new))


def _on_click(session: Session, button: Any, work: Callable[[], None]) -> None:
    safe = guarded(session, work)
    button.on_click(lambda: safe())


def _on_event(session: Session, figure: Any, event: Any, work: Callable[[Any], None]) -> None:
    safe = guarded(session, work)
    figure.on_event(event, lambda happened: safe(happened))


# --- The outline


def _connect_outline(session: Session) -> None:
    drawn = session.figures.aperture
    drag = {"on": False, "started": False, "until": 0.0}

    def dragging(on: bool) -> None:
        # where a hand comes to rest may arrive after its end: it is the same step of undo
        drag.update(on=on, started=drag["started"] and not on, until=time.monotonic() + _REST)
        if not on and session.state.snap > 0:
            rings = outlines.snapped(session.state.rings, session.state.snap)
            session.edit(step=False, rings=rings)

    def edited(data: Any) -> None:
        columns = zip(data["number"], data["xs"], data["ys"], strict=True)
        left = {k: tuple(zip(map(float, xs), map(float, ys), strict=True)) for k, xs, ys in columns}
        before = session.state.rings
        rings, farewell = outlines.without_lost(before, left)
        rings = outlines.rounded_where_new(rings, before, _reach(drawn.figure) / 20)
        if rings == before:
            session.signals.data = {"busy": [0]}
            return
        moved = [*map(len, rings)] == [*map(len, before)]
        same = moved and (drag["on"] or time.monotonic() < drag["until"])
        step = not (drag["started"] and same)
        drag["started"] = bool(drag["on"] or not step)
        session.edit(step=step, edges=bool(farewell), rings=rings)
        session.add(farewell)

    _on_event(session, drawn.figure, PanStart, lambda _: dragging(True))
    _on_event(session, drawn.figure, PanEnd, lambda _: dragging(False))
    _on_change(session, drawn.outline, "data", edited)


def _connect_drawing(session: Session) -> None:
    controls = session.controls

    def toggled(active: bool) -> None:
        session.pending.clear()
        session.figures.aperture.pending.data = {"x": [], "y": []}
        controls.finish.disabled = not active
        controls.draw.button_type = "primary" if active else "default"
        session.say(
            "Click the corners one after the other (or go there by arrows, and press the space "
            "bar); click the first one again, or press Enter, to close the outline. Esc gives up."
            if active
            else "",
            hint=True,
        )

    _on_change(session, controls.draw, "active", toggled)
    _on_click(session, controls.finish, lambda: _finish(session))


def _finish(session: Session) -> None:
    """Close the outline that is being drawn."""
    if not session.controls.draw.active:
        return
    ring = tuple(session.pending)
    session.controls.draw.active = False
    if len(ring) < 3:
        session.say("An outline needs three corners at least.")
        return
    session.edit(rings=(*session.state.rings, ring))


def _reach(figure: Any) -> float:
    """Distance from a vertex in which a click means it; a twentieth is as exact as a hand."""
    return float(_NEAR_VERTEX * abs(figure.x_range.end - figure.x_range.start))


def _place(figure: Any, event: Any) -> Point:
    """The place of an event, as one would type it."""
    return outlines.rounded((float(event.x), float(event.y)), _reach(figure) / 20)


def _are_near(session: Session, a: Point, b: Point) -> bool:
    reach = _reach(session.figures.aperture.figure)
    return abs(a[0] - b[0]) < reach and abs(a[1] - b[1]) < reach


def _is_at_vertex(session: Session, point: Point) -> bool:
    return any(_are_near(session, point, v) for ring in session.state.rings for v in ring)


def _on_raster(session: Session, point: Point) -> Point:
    ((found,),) = outlines.snapped(((point,),), session.state.snap)
    return found


def _corner(session: Session, point: Point) -> None:
    """Another corner of the outline that is being drawn, or its first once more."""
    if len(session.pending) >= 3 and _are_near(session, point, session.pending[0]):
        _finish(session)
        return
    session.pending.append(_on_raster(session, point))
    x, y = zip(*session.pending, strict=True)
    session.figures.aperture.pending.data = {"x": list(x), "y": list(y)}


def _connect_vertices(session: Session) -> None:
    """Buttons, table and keys that change vertices."""
    controls, aperture = session.controls, session.figures.aperture

    def with_chosen(change: Callable[[int], Any]) -> None:
        if aperture.chosen is None:
            session.say("Select a vertex first: click it, or its row in the table.")
        else:
            change(aperture.chosen)

    def insert(row: int) -> None:
        session.edit(rings=outlines.with_vertex_after(session.state.rings, row))

    def from_table() -> None:
        data = controls.rows.data
        rows = list(zip(data["ring"], map(float, data["x"]), map(float, data["y"]), strict=True))
        session.edit(rings=outlines.rings_of_rows(rows))

    def selected(rows: list[int]) -> None:
        """A row of the table is a vertex of the figure."""
        if rows:
            aperture.choose(rows[0])

    _on_click(session, controls.undo, lambda: session.go(session.history.undone()))
    _on_click(session, controls.redo, lambda: session.go(session.history.redone()))
    _on_click(session, controls.delete, lambda: with_chosen(session.delete))
    _on_click(session, controls.insert, lambda: with_chosen(insert))
    typed = guarded(session, from_table)
    # a cell: Bokeh is still at it, and must not find other data
    _on_change(session, controls.rows, "data", lambda _: session.doc.add_next_tick_callback(typed))
    _on_change(session, controls.rows.selected, "indices", selected)
    _on_change(session, session.keys, "data", _Keyboard(session).pressed)


def _connect_files(session: Session) -> None:
    """Outlines to start from."""
    controls = session.controls

    def start_from(name: str) -> None:
        if name:
            shape = CATALOGUE.get(name)
            rings = outlines.rings_of_aperture(shape()) if shape else ()
            session.edit(rings=rings, x=(0.0, 0.0))
            controls.shape.value = ""  # so that it can be chosen again
            controls.draw.active = shape is None

    def upload() -> None:
        value, name = controls.upload.value, str(controls.upload.filename)
        if not value:
            return
        controls.upload.clear()  # so that the same file can be sent again
        try:
            content = base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError):
            session.say(f"{name}: the file did not arrive whole; send it again")
            return
        session.read(name, content)

    def refuse(data: Any) -> None:
        outlines.check_upload(data["name"][0], data["size"][0])  # its error

    _on_change(session, controls.shape, "value", start_from)
    arrived = guarded(session, upload)
    # the name of a file comes after its content
    _on_change(
        session, controls.upload, "value", lambda _: session.doc.add_next_tick_callback(arrived)
    )
    _on_change(session, session.refused, "data", refuse)


def _round_step(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max((m * power for m in (1, 2, 5) if m * power <= length * (1 + 1e-9)), default=power)


def _moved(point: Point, key: str, step: float) -> Point:
    """A point after an arrow, without stray digits."""
    digits = max(0, 3 - math.floor(math.log10(step)))
    x, y = (c + step * d for c, d in zip(point, _ARROWS[key], strict=True))
    return round(x, digits) + 0.0, round(y, digits) + 0.0


class _Keyboard:
    """The keys of the page of a visitor, and their handlers."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._last = (-1, 0.0)  # the vertex that was moved, and when

    def pressed(self, data: Any) -> None:
        """A key, in a figure that takes keys or anywhere ("")."""
        session, draw = self.session, self.session.controls.draw
        key, figure, shift = data["key"][0], data["figure"][0], bool(data["shift"][0])
        if key == "finish":
            _finish(session)
        elif key == "undo":
            session.go(session.history.undone())
        elif key == "redo":
            session.go(session.history.redone())
        elif key in _ARROWS and figure in WITH_KEYS:
            self._arrow(key, figure, _FASTER if shift else 1)
        elif draw.active and key == "Escape":
            draw.active = False
        elif draw.active and key == " " and figure == "aperture":
            _corner(session, session.state.x)
        elif figure == "aperture" and not draw.active:
            self._vertex(key)

    def _step(self, figure: str) -> float:
        window = self.session.figures.by_name(figure).x_range
        snap = self.session.state.snap
        if snap > 0 and figure in ("aperture", "wigner_x"):
            return snap
        return _round_step(abs(window.end - window.start) / _STEPS)

    def _arrow(self, key: str, figure: str, times: int) -> None:
        session, step = self.session, times * self._step(figure)
        chosen = session.figures.aperture.chosen if figure == "aperture" else None
        if chosen is not None and not session.controls.draw.active:
            self._move(chosen, key, step)
            return
        name = "x" if figure in ("aperture", "wigner_x") else "nu"
        x, y = there = _moved(getattr(session.state, name), key, step)
        session.look(**{name: there})
        unit = session.state.unit if name == "x" else f"1/{session.state.unit}"
        session.say(f"{'x' if name == 'x' else 'ν'} = ({x:g}, {y:g}) {unit}", hint=True)

    def _move(self, chosen: int, key: str, step: float) -> None:
        session, now = self.session, time.monotonic()
        vertex, last = self._last
        point = _moved(self._vertices()[chosen], key, step)
        rings = outlines.with_vertex_at(session.state.rings, chosen, point)
        session.edit(step=vertex != chosen or now - last > _TOGETHER, rings=rings)
        self._last = (chosen, now)
        self._choose(chosen)

    def _vertex(self, key: str) -> None:
        session, count = self.session, len(self._vertices())
        chosen = session.figures.aperture.chosen
        if key in "nNpP" and count:
            by = 1 if key in "nN" else -1
            self._choose(((-1 if by > 0 else 0) if chosen is None else chosen) + by)
        elif key == "Escape":
            session.figures.aperture.choose(None)
            session.say("")
        elif key in ("Insert", "Delete") and chosen is not None:
            self._last = (-1, 0.0)
            if key == "Insert":
                session.edit(rings=outlines.with_vertex_after(session.state.rings, chosen))
                self._choose(chosen + 1)
            elif not session.delete(chosen):
                self._choose(chosen)

    def _vertices(self) -> list[Point]:
        return [point for ring in self.session.state.rings for point in ring]

    def _choose(self, vertex: int) -> None:
        """Select a vertex, counted around, and say where it is."""
        session, vertices = self.session, self._vertices()
        if not vertices:
            return
        vertex %= len(vertices)
        session.figures.aperture.choose(vertex)
        x, y = vertices[vertex]
        text = f"Vertex {vertex + 1} of {len(vertices)}: ({x:g}, {y:g}) {session.state.unit}"
        session.say(text, hint=True)


# --- The chosen point, and fields


def _connect_points(session: Session) -> None:
    controls, figures = session.controls, session.figures
    aperture = figures.aperture.figure

    def tapped(event: Any) -> None:
        """A click into the aperture: a corner of a new outline, a vertex, or a position."""
        point = _place(aperture, event)
        if controls.draw.active:
            _corner(session, point)
        elif not _is_at_vertex(session, point):
            session.look(x=point)

    def doubled(event: Any) -> None:
        if not controls.draw.active:
            point = _on_raster(session, _place(aperture, event))
            if not _is_at_vertex(session, point):
                session.edit(rings=outlines.with_vertex_near(session.state.rings, point))

    def lags_at(point: Point) -> None:
        """The lag slice; a tenth of a millisecond, so without the scheduler."""
        if not session.trouble:  # otherwise the outline is none at present
            state = session.state.moved(x=point)
            figures.lags.show(views.lag_rings(state), state)

    def hovered(event: Any) -> None:
        if event.x is not None and event.y is not None and not controls.draw.active:
            lags_at((event.x, event.y))

    def choose(name: str, event: Any) -> None:
        point = _place(figures.by_name(name), event)
        session.look(**{"x" if name == "wigner_x" else "nu": point})

    def typed(_: Any) -> None:
        values = [widget.value for widget in widgets]
        if None not in values:
            session.look(x=tuple(values[:2]), nu=tuple(values[2:]))

    _on_event(session, aperture, Tap, tapped)
    _on_event(session, aperture, DoubleTap, doubled)
    _on_event(session, aperture, MouseMove, hovered)
    _on_event(session, aperture, MouseLeave, lambda _: lags_at(session.state.x))
    for name in ("fourier", "wigner_nu", "wigner_x"):
        _on_event(session, figures.by_name(name), Tap, partial(choose, name))
    widgets = (controls.x, controls.y, controls.nu_x, controls.nu_y)
    for widget in widgets:
        _on_change(session, widget, "value", typed)


def _connect_fields(session: Session) -> None:
    controls = session.controls

    def entered(name: str, value: Any) -> None:
        session.edit(**{name: value})

    def moved(name: str, value: Any) -> None:
        session.look(**{name: value or 0.0})

    def chosen(_: Any) -> None:
        session.figures.set_visible(session.visible)
        session.request()

    for name in TYPED:
        _on_change(session, controls.field(name), "value", partial(entered, name))
    for name in MOVED:
        _on_change(session, getattr(controls, name), "value", partial(moved, name))
    _on_change(session, controls.part, "active", lambda k: session.look(part=PARTS[k]))
    _on_change(session, controls.order, "active", lambda k: session.look(order=ORDERS[k]))
    _on_click(session, controls.whole, session.figures.reset)
    session.figures.set_visible(session.visible)
    _on_change(session, controls.views, "active", chosen)


# --- Downloads, and the tour


def _taken(state: State, name: str, kind: str) -> bytes:
    """A view as a file of this kind."""
    if kind == "py":
        return snippet(state, name).encode()
    if kind == "npz":
        return exports.values_file(state, name)
    return exports.picture_file(state, name, kind)


def _connect_downloads(session: Session) -> None:
    """The buttons below "Take away"."""
    controls = session.controls

    def send(suffix: str, name: str, content: bytes) -> None:
        session.downloads.data = {
            "name": [f"{name}.{suffix}"],
            "kind": [_KINDS[suffix]],
            "content": [base64.b64encode(content).decode("ascii")],
        }

    def take(kind: str) -> None:
        name, state = controls.take.value, session.state
        session.aside(partial(_taken, state, name, kind), partial(send, kind, name))

    def outline(suffix: str) -> None:
        written = exports.geojson if suffix == "geojson" else exports.svg
        send(suffix, "aperture", written(session.state).encode())

    _on_change(session, controls.take, "value", lambda _: controls.show_code(session.state))
    for buttons, act in ((controls.files, take), (controls.outlines, outline)):
        for kind, button in buttons.items():
            _on_click(session, button, partial(act, kind))


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
"""Name of the figure, heading and text of each step."""


def _connect_tour(session: Session) -> None:
    """The two buttons of the tour."""
    controls, at = session.controls, {"step": -1}
    before: list[int] = []  # the views of before the tour

    def go(by: int) -> None:
        if at["step"] >= 0:
            last = session.figures.by_name(STEPS[at["step"]][0])
            last.update(outline_line_color="#8a939c", outline_line_width=1)
        step = at["step"] = at["step"] + by if at["step"] + by < len(STEPS) else -1
        controls.tour_back.visible = step > 0
        if step < 0:
            controls.views.active = list(before)
            controls.tour_text.update(text="", visible=False)
            controls.tour.label = "What am I looking at?"
            return
        figure, heading, text = STEPS[step]
        if step == 0 and by > 0:
            before[:] = controls.views.active
        view = figure.removeprefix("rays_")
        if view in VIEWS:  # what is spoken of can be seen
            controls.views.active = sorted({*before, list(VIEWS).index(view)})
        session.pointed.data = {"figure": [figure]}
        session.figures.by_name(figure).update(outline_line_color="#ffb000", outline_line_width=4)
        said = f"<b>{step + 1} of {len(STEPS)}: {heading}.</b> {text}"
        controls.tour_text.update(text=said, visible=True)
        controls.tour.label = "Next" if step + 1 < len(STEPS) else "End of the tour"

    _on_click(session, controls.tour, lambda: go(1))
    _on_click(session, controls.tour_back, lambda: go(-1))
