"""Acts of visitors, as edits of the state."""

from __future__ import annotations

import base64
import binascii
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from bokeh.events import DocumentReady, DoubleTap, MouseLeave, MouseMove, PanEnd, PanStart, Tap
from bokeh.models import CustomJS

from polywigner.explorer import editing, views, windows
from polywigner.explorer.page import script
from polywigner.explorer.page.actions import (
    Keyboard,
    connect_downloads,
    connect_drawing,
    connect_tour,
    corner,
    finish,
    near,
    placed,
    tolerance,
    tolerance_of,
)
from polywigner.explorer.page.guards import guarded, on_change, on_click, on_event
from polywigner.explorer.page.show import ORDERS, PARTS
from polywigner.explorer.sources import LARGEST_UPLOAD, check_size
from polywigner.explorer.state import CATALOGUE

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session


_REST = 1.0  # seconds


def connect(session: Session) -> None:
    """All callbacks of one visitor's page."""
    _connect_outline(session)
    _connect_fields(session)
    _connect_points(session)
    connect_downloads(session)
    connect_tour(session)


def _connect_outline(session: Session) -> None:
    controls, drawn = session.controls, session.figures.aperture
    known = {"vertices": drawn.vertices, "outline": drawn.outline, "signals": session.signals}
    drawn.vertices.js_on_change("data", CustomJS(args=known, code=script.REBUILD))
    drawn.figure.js_on_event("pan", CustomJS(args=known, code=script.DRAG))
    drag = {"on": False, "started": False, "until": 0.0}

    def dragging(on: bool) -> None:
        # where a hand comes to rest may arrive after its end: it is the same step of undo
        drag.update(on=on, started=drag["started"] and not on, until=time.monotonic() + _REST)
        if not on and session.state.snap > 0:
            session.edit(step=False, rings=editing.snapped(session.state.rings, session.state.snap))

    def edited(data: Any) -> None:
        columns = zip(data["number"], data["xs"], data["ys"], strict=True)
        left = {k: tuple(zip(map(float, xs), map(float, ys), strict=True)) for k, xs, ys in columns}
        rings, farewell = editing.without_lost(session.state.rings, left)
        rings = editing.rounded_where_new(rings, session.state.rings, tolerance_of(session))
        if rings == session.state.rings:
            session.signals.data = {"busy": [0]}
            return
        moved = [*map(len, rings)] == [*map(len, session.state.rings)]
        same = moved and (drag["on"] or time.monotonic() < drag["until"])
        step = not (drag["started"] and same)
        drag["started"] = bool(drag["on"] or not step)
        session.edit(step=step, edges=bool(farewell), rings=rings)
        session.add(farewell)

    on_event(session, drawn.figure, PanStart, lambda _: dragging(True))
    on_event(session, drawn.figure, PanEnd, lambda _: dragging(False))
    on_change(session, drawn.outline, "data", edited)
    connect_drawing(session)
    on_click(session, controls.undo, lambda: session.go(session.history.undone()))
    on_click(session, controls.redo, lambda: session.go(session.history.redone()))
    on_click(session, controls.delete, lambda: _delete(session))
    on_click(session, controls.insert, lambda: _insert(session))
    typed = guarded(session, partial(_from_table, session))
    # a cell: Bokeh is still at it, and must not find other data
    on_change(session, controls.rows, "data", lambda _: session.doc.add_next_tick_callback(typed))
    known = {"table": controls.table, "rows": controls.rows}
    controls.rows.js_on_change("data", CustomJS(args=known, code=script.REPAINT))
    on_change(session, controls.shape, "value", lambda name: _start_from(session, name))
    arrived = guarded(session, partial(_upload, session))
    # the name of a file comes after its content
    on_change(
        session, controls.upload, "value", lambda _: session.doc.add_next_tick_callback(arrived)
    )
    refused = session.refused
    on_change(session, refused, "data", lambda data: check_size(data["name"][0], data["size"][0]))
    known = {"upload": controls.upload, "refused": refused, "largest": LARGEST_UPLOAD}
    session.doc.js_on_event(DocumentReady, CustomJS(args=known, code=script.UPLOAD))
    keyboard = Keyboard(session)
    on_change(session, session.keys, "data", partial(_pressed, session, keyboard))
    on_change(session, controls.rows.selected, "indices", partial(_row_selected, session))
    texts = [controls.busy, controls.message, controls.values, controls.note]
    session.doc.js_on_event(DocumentReady, CustomJS(args={"texts": texts}, code=script.TEXTS))
    said = {"busy": controls.busy, "message": controls.message}
    session.doc.js_on_event("connection_lost", CustomJS(args=said, code=script.LOST))


def _selected(session: Session) -> int | None:
    """The row of the vertex that is selected, in the figure or in the table."""
    chosen = session.figures.aperture.chosen
    if chosen is None:
        session.say("Select a vertex first: click it, or its row in the table.")
    return chosen


def _delete(session: Session) -> None:
    row = _selected(session)
    if row is not None:
        session.delete(row)


def _insert(session: Session) -> None:
    row = _selected(session)
    if row is not None:
        session.edit(rings=editing.with_vertex_after(session.state.rings, row))


def _from_table(session: Session) -> None:
    data = session.controls.rows.data
    rows = list(zip(data["ring"], map(float, data["x"]), map(float, data["y"]), strict=True))
    session.edit(rings=editing.rings_of_rows(rows))


def _start_from(session: Session, name: str) -> None:
    if name:
        shape = CATALOGUE.get(name)
        rings = editing.rings_of_aperture(shape()) if shape else ()
        session.edit(rings=rings, x=(0.0, 0.0))
        session.controls.shape.value = ""  # so that it can be chosen again
        session.controls.draw.active = shape is None


def _upload(session: Session) -> None:
    value, name = session.controls.upload.value, str(session.controls.upload.filename)
    if not value:
        return
    session.controls.upload.clear()  # so that the same file can be sent again
    try:
        content = base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        session.say(f"{name}: the file did not arrive whole; send it again")
        return
    session.read(name, content)


def _pressed(session: Session, keyboard: Keyboard, data: Any) -> None:
    key, figure, shift = data["key"][0], data["figure"][0], bool(data["shift"][0])
    drawing = session.controls.draw.active
    if key == "finish":
        finish(session)
    elif drawing and key == "Escape":
        session.controls.draw.active = False
    elif drawing and key == " " and figure == "aperture":
        corner(session, session.state.x)
    else:
        keyboard.pressed(key, figure, shift)


def _row_selected(session: Session, rows: list[int]) -> None:
    """A row of the table is a vertex of the figure."""
    if rows:
        session.figures.aperture.choose(rows[0])


def _tapped(session: Session, event: Any) -> None:
    """A click into the aperture: a corner of a new outline, a vertex, or a position."""
    point = (float(event.x), float(event.y))
    if session.controls.draw.active:
        corner(session, editing.rounded(point, tolerance_of(session)))
    elif not any(near(session, point, v) for ring in session.state.rings for v in ring):
        session.edit(step=False, edges=False, x=editing.rounded(point, tolerance_of(session)))


def _connect_points(session: Session) -> None:
    controls, figures = session.controls, session.figures
    on_event(session, figures.aperture.figure, Tap, lambda event: _tapped(session, event))
    on_event(session, figures.aperture.figure, DoubleTap, lambda event: _doubled(session, event))
    on_event(session, figures.aperture.figure, MouseMove, lambda event: _hovered(session, event))
    on_event(
        session, figures.aperture.figure, MouseLeave, lambda _: _lags(session, session.state.x)
    )

    def choose(name: str, event: Any) -> None:
        figure = figures.by_name(event_figures[name])
        point = editing.rounded((float(event.x), float(event.y)), tolerance(figure) / 20)
        session.edit(step=False, edges=False, **{"x" if name == "wigner_x" else "nu": point})

    event_figures = {name: name for name in ("fourier", "wigner_nu", "wigner_x")}
    for name in event_figures:
        on_event(session, figures.by_name(name), Tap, partial(choose, name))

    def typed(_: Any) -> None:
        values = [w.value for w in (controls.x, controls.y, controls.nu_x, controls.nu_y)]
        if None not in values:
            session.edit(step=False, edges=False, x=tuple(values[:2]), nu=tuple(values[2:]))

    for widget in (controls.x, controls.y, controls.nu_x, controls.nu_y):
        on_change(session, widget, "value", typed)


def _doubled(session: Session, event: Any) -> None:
    if not session.controls.draw.active:
        point = placed(session, editing.rounded((event.x, event.y), tolerance_of(session)))
        if not any(near(session, point, v) for ring in session.state.rings for v in ring):
            session.edit(rings=editing.with_vertex_near(session.state.rings, point))


def _hovered(session: Session, event: Any) -> None:
    """The lag slice follows the pointer; a tenth of a millisecond, so without the scheduler."""
    if event.x is not None and event.y is not None and not session.controls.draw.active:
        _lags(session, (float(event.x), float(event.y)))


def _lags(session: Session, point: tuple[float, float]) -> None:
    if session.trouble:
        return  # the outline is none at present
    state = session.state.moved(x=point)
    session.figures.lags.show(views.lag_rings(state), state, windows.lag_half(state), point)


def _connect_fields(session: Session) -> None:
    controls = session.controls

    def entered(name: str, value: Any) -> None:
        session.edit(**{name: value})

    def looked(name: str, value: Any) -> None:
        session.edit(step=False, edges=False, **{name: value or 0.0})

    for name in ("unit", "wave", "taper", "array", "window", "steering", "polarisation"):
        on_change(session, getattr(controls, name), "value", partial(entered, name))
    for name in ("snap", "reach", "coherence", "defocus", "distance"):
        on_change(session, getattr(controls, name), "value", partial(looked, name))
    on_change(session, controls.part, "active",
               lambda k: session.edit(step=False, edges=False, part=PARTS[k]))  # fmt: skip
    on_change(session, controls.order, "active",
               lambda k: session.edit(step=False, edges=False, order=ORDERS[k]))  # fmt: skip

    def chosen(_: Any) -> None:
        session.figures.set_visible(session.visible)
        session.request()

    on_click(session, controls.whole, session.figures.reset)
    session.figures.set_visible(session.visible)
    on_change(session, controls.views, "active", chosen)
