"""A new outline, corner by corner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from polywigner.explorer import editing
from polywigner.explorer.page.guards import on_change, on_click

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session

__all__ = ["connect_drawing", "corner", "finish", "near", "placed", "tolerance", "tolerance_of"]

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
