"""A new outline, corner by corner."""

from __future__ import annotations

import base64
import math
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from bokeh.models import CustomJS

from polywigner.explorer import editing, exports
from polywigner.explorer.page import script
from polywigner.explorer.page.access import WITH_KEYS
from polywigner.explorer.page.controls import VIEWS
from polywigner.explorer.page.guards import on_change, on_click
from polywigner.explorer.page.show import show_code
from polywigner.explorer.snippets import snippet
from polywigner.explorer.state import State

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session


_NEAR_VERTEX = 0.02  # of the window: a click there means the vertex


def connect_drawing(session: Session) -> None:
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

    on_change(session, controls.draw, "active", toggled)
    on_click(session, controls.finish, lambda: finish(session))


def finish(session: Session) -> None:
    """Close the outline that is being drawn."""
    if not session.controls.draw.active:
        return
    ring = tuple(session.pending)
    session.controls.draw.active = False
    if len(ring) < 3:
        session.say("An outline needs three corners at least.")
        return
    session.edit(rings=(*session.state.rings, ring))


def tolerance(figure: Any) -> float:
    return _NEAR_VERTEX * abs(figure.x_range.end - figure.x_range.start)


def near(session: Session, a: tuple[float, float], b: tuple[float, float]) -> bool:
    reach = tolerance(session.figures.aperture.figure)
    return abs(a[0] - b[0]) < reach and abs(a[1] - b[1]) < reach


def placed(session: Session, point: tuple[float, float]) -> tuple[float, float]:
    """On the raster, if there is one."""
    ((found,),) = editing.snapped(((point,),), session.state.snap)
    return found


def corner(session: Session, point: tuple[float, float]) -> None:
    """Another corner of the outline that is being drawn, or its first once more."""
    if len(session.pending) >= 3 and near(session, point, session.pending[0]):
        finish(session)
        return
    session.pending.append(placed(session, point))
    x, y = zip(*session.pending, strict=True)
    session.figures.aperture.pending.data = {"x": list(x), "y": list(y)}


def tolerance_of(session: Session) -> float:
    return tolerance(session.figures.aperture.figure) / 20


if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session


_ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
_FASTER = 10  # steps, with Shift
_STEPS = 100  # across a figure, where no raster is set
_TOGETHER = 1.0  # seconds: moves of one vertex that follow so soon are one step of undo


def round_step(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max((m * power for m in (1, 2, 5) if m * power <= length * (1 + 1e-9)), default=power)


def moved(point: tuple[float, float], key: str, step: float) -> tuple[float, float]:
    """A point after an arrow, without stray digits."""
    digits = max(0, 3 - math.floor(math.log10(step)))
    x, y = (c + step * d for c, d in zip(point, _ARROWS[key], strict=True))
    return round(x, digits) + 0.0, round(y, digits) + 0.0


class Keyboard:
    """The keys of the page of a visitor, and their handlers."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._last = (-1, 0.0)  # the vertex that was moved, and when

    def pressed(self, key: str, figure: str, shift: bool) -> None:
        """A key, in a figure that takes keys or anywhere ("")."""
        session = self.session
        if key == "undo":
            session.go(session.history.undone())
        elif key == "redo":
            session.go(session.history.redone())
        elif key in _ARROWS and figure in WITH_KEYS:
            self._arrow(key, figure, _FASTER if shift else 1)
        elif figure == "aperture" and not session.controls.draw.active:
            self._vertex(key)

    def _step(self, figure: str) -> float:
        window = self.session.figures.by_name(figure).x_range
        snap = self.session.state.snap
        if snap > 0 and figure in ("aperture", "wigner_x"):
            return snap
        return round_step(abs(window.end - window.start) / _STEPS)

    def _arrow(self, key: str, figure: str, times: int) -> None:
        session, step = self.session, times * self._step(figure)
        chosen = session.figures.aperture.chosen if figure == "aperture" else None
        if chosen is not None and not session.controls.draw.active:
            self._move(chosen, key, step)
            return
        name = "x" if figure in ("aperture", "wigner_x") else "nu"
        x, y = there = moved(getattr(session.state, name), key, step)
        session.edit(step=False, edges=False, **{name: there})
        unit = session.state.unit if name == "x" else f"1/{session.state.unit}"
        session.say(f"{'x' if name == 'x' else 'ν'} = ({x:g}, {y:g}) {unit}", hint=True)

    def _move(self, chosen: int, key: str, step: float) -> None:
        session, now = self.session, time.monotonic()
        vertex, last = self._last
        rings = editing.with_vertex_at(
            session.state.rings, chosen, moved(self._vertices()[chosen], key, step)
        )
        session.edit(step=vertex != chosen or now - last > _TOGETHER, rings=rings)
        self._last = (chosen, now)
        self.choose(chosen)

    def _vertex(self, key: str) -> None:
        session, count = self.session, len(self._vertices())
        chosen = session.figures.aperture.chosen
        if key in "nNpP" and count:
            by = 1 if key in "nN" else -1
            self.choose(((-1 if by > 0 else 0) if chosen is None else chosen) + by)
        elif key == "Escape":
            session.figures.aperture.choose(None)
            session.say("")
        elif key in ("Insert", "Delete") and chosen is not None:
            self._last = (-1, 0.0)
            if key == "Insert":
                session.edit(rings=editing.with_vertex_after(session.state.rings, chosen))
                self.choose(chosen + 1)
            elif not session.delete(chosen):
                self.choose(chosen)

    def _vertices(self) -> list[tuple[float, float]]:
        return [(x, y) for _, x, y in editing.rows_of_rings(self.session.state.rings)]

    def choose(self, vertex: int) -> None:
        """Select a vertex, counted around, and say where it is."""
        vertices = self._vertices()
        if not vertices:
            return
        vertex %= len(vertices)
        self.session.figures.aperture.choose(vertex)
        x, y = vertices[vertex]
        self.session.say(
            f"Vertex {vertex + 1} of {len(vertices)}: ({x:g}, {y:g}) {self.session.state.unit}",
            hint=True,
        )


if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session


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


def connect_tour(session: Session) -> None:
    """The two buttons of the tour."""
    controls, at = session.controls, {"step": -1}
    before: list[int] = []  # the views of before the tour

    def go(by: int) -> None:
        if at["step"] >= 0:
            session.figures.by_name(STEPS[at["step"]][0]).outline_line_color = "#8a939c"
            session.figures.by_name(STEPS[at["step"]][0]).outline_line_width = 1
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

    known = {"pointed": session.pointed, "figures": session.figures.all}
    session.pointed.js_on_change("data", CustomJS(args=known, code=script.SCROLL))
    on_click(session, controls.tour, lambda: go(1))
    on_click(session, controls.tour_back, lambda: go(-1))


if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session


_KINDS = {
    "png": "image/png", "svg": "image/svg+xml", "npz": "application/octet-stream",
    "py": "text/x-python", "geojson": "application/geo+json",
}  # fmt: skip


def _taken(state: State, name: str, kind: str) -> bytes:
    """A view as a file of this kind."""
    if kind == "py":
        return snippet(state, name).encode()
    if kind == "npz":
        return exports.values_file(state, name)
    return exports.picture_file(state, name, kind)


def connect_downloads(session: Session) -> None:
    """The buttons below "Take away"."""
    controls = session.controls
    session.downloads.js_on_change(
        "data", CustomJS(args={"files": session.downloads}, code=script.DOWNLOAD)
    )
    # what nothing in the page refers to is not sent to it
    known = {
        "link": controls.link, "files": session.downloads, "keys": session.keys,
        "refused": session.refused, "pointed": session.pointed, "stale": session.status.stale,
    }  # fmt: skip
    controls.link.js_on_change("value", CustomJS(args=known, code=script.ADDRESS))
    on_change(session, controls.take, "value", lambda _: show_code(controls, session.state))

    def send(suffix: str, name: str, content: bytes) -> None:
        session.downloads.data = {
            "name": [f"{name}.{suffix}"],
            "kind": [_KINDS[suffix]],
            "content": [base64.b64encode(content).decode("ascii")],
        }

    def take(kind: str) -> None:
        name, state = controls.take.value, session.state
        session.aside(partial(_taken, state, name, kind), partial(send, kind, name))

    for kind, button in controls.files.items():
        on_click(session, button, partial(take, kind))

    def outline(suffix: str, written: Callable[[Any], str]) -> None:
        send(suffix, "aperture", written(session.state).encode())

    for name, suffix, written in (
        ("geojson", "geojson", exports.geojson),
        ("outline_svg", "svg", exports.svg),
    ):
        on_click(session, controls.outlines[name], partial(outline, suffix, written))
