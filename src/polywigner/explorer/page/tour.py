"""A tour of the page in five steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bokeh.models import CustomJS

from polywigner.explorer.page import script
from polywigner.explorer.page.controls import VIEWS
from polywigner.explorer.page.guards import on_click

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session

__all__ = ["STEPS", "connect_tour"]

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
