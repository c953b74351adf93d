"""A tour of the page in five steps."""

from __future__ import annotations

__all__ = ["STEPS"]

STEPS: tuple[tuple[str, str, str], ...] = (
    (
        "aperture",
        "An opening, lit by a plane wave",
        "The dark shape is an aperture: an antenna patch, a pupil, a hole in a screen. Drag one of "
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
        "W travels along straight rays, so their sum is a near field. Switch on the near field: "
        "left by Wigner rays, beside it Kirchhoff's exact integral, then their difference in dB. "
        "Move the plane: nearer than a few wavelengths rays fail. Take away the picture, the "
        "numbers, or the Python code from the box at the left.",
    ),
)
"""Name of the figure, heading and text of each step."""
