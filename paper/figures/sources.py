"""Apertures and wavelength of the paper's figures.

The paper specifies the size of the square only. The sizes of the other apertures, a few
wavelengths, show the effects that its captions describe.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.errors import PolywignerWarning
from polywigner.quantities import wavelength_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Quality = Literal["draft", "print"]
QUALITIES: tuple[str, ...] = get_args(Quality)


Value = tuple[NDArray[Any], str]


@dataclass(frozen=True, eq=False)
class Made:
    """The panels of a figure by their letters ("" for a single panel), and arrays by name, each
    with its unit and axes.
    """

    figures: Mapping[str, Figure]
    values: Mapping[str, Value]


def number_samples(quality: Quality, draft: int, final: int) -> int:
    """Return the number of samples along an axis."""
    return draft if quality == "draft" else final


def geojson(shape: Any) -> Value:
    """Return a shapely geometry as an array that contains text with all digits."""
    import shapely

    return np.asarray(shapely.to_geojson(shape)), "GeoJSON, m"


WAVELENGTH = wavelength_of(94e9)
"""3.19 mm, in metres."""

_MM = 1e-3


def square() -> pw.Aperture:
    """Return the transmitter of the paper's comparison: 10 mm x 10 mm, about the origin."""
    return pw.shapes.square(10 * _MM)


def chevrons() -> pw.Aperture:
    """Return two chevrons of 9 mm x 12 mm, 24 mm from tip to tip (examples/two_chevrons)."""
    left = np.array([(-12, 0), (-7, -6), (-3, -6), (-8, 0), (-3, 6), (-7, 6)])
    return pw.Aperture([left * _MM, -left * _MM])


def triangle() -> pw.Aperture:
    """Return a triangle without symmetry, with its centroid at the origin."""
    corners = np.array([(-5.0, -4.0), (6.0, -2.0), (-1.0, 6.0)])
    return pw.Aperture((corners - corners.mean(axis=0)) * _MM)


def triangles() -> pw.Aperture:
    """Return two triangles, of which one is rotated, whose automean has three parts."""
    one = triangle().rings[0] * 0.7
    other = one @ _turned(140.0).T
    return pw.Aperture([np.add(one, (-9 * _MM, 0)), np.add(other, (9 * _MM, 2 * _MM))])


def _turned(degrees: float) -> NDArray[np.float64]:
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([(cosine, -sine), (sine, cosine)])


@functools.cache
def catalogue() -> dict[str, pw.Slits | pw.Aperture]:
    """Return the nine apertures in the paper's appendix by name."""
    shapes = pw.shapes
    # Three unequal baselines in three directions.
    stations = np.array([(-7.0, -4.0), (7.0, -5.0), (-1.0, 7.0)]) * _MM
    return {
        "single slit, 1D": shapes.slit(10 * _MM),
        "double slit, 1D": shapes.slit_pair((4 * _MM, 2 * _MM), (-3 * _MM, 6 * _MM)),
        "rectangle": shapes.rectangle(12 * _MM, 8 * _MM),
        "circle": shapes.disc(5 * _MM),
        "triangle": shapes.triangle(12 * _MM, 10 * _MM),
        "double slit": shapes.double_slit((4 * _MM, 2 * _MM), 10 * _MM, (-3 * _MM, 6 * _MM)),
        "V": shapes.vee(12 * _MM, 12 * _MM, 3 * _MM),
        "U": shapes.u_shape(12 * _MM, 12 * _MM, 3 * _MM),
        "interferometer": shapes.interferometer(stations, 2 * _MM),
    }


RAYS: Mapping[str, Mapping[str, Any]] = {
    "paper": {"obliquity": "paper"},
    "matched": {"obliquity": "kirchhoff"},
}
"""Wigner rays with the paper's obliquity, and with Kirchhoff's."""


def compared(place: Callable[..., Any], rays: tuple[str, ...], *others: str) -> Any:
    """Return fields at a point by some of ``RAYS``, other methods and Kirchhoff's integral."""
    with limits_known():
        result = place(method=(*others, "kirchhoff"), progress=False)
        for name in rays:
            result[name] = place(method="wigner", progress=False, **RAYS[name])["wigner"]
    return result[[*rays, *others, "kirchhoff"]]


@contextmanager
def limits_known() -> Iterator[None]:
    """Suppress warnings of points too close for rays, because figures show this limit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PolywignerWarning)
        yield


def number_panels(figure: Figure, letter: str) -> None:
    """Write (a1), (a2), ... in the upper left corners of the panels of figure (a).

    The number precedes an existing title.
    """
    shown = [
        axes
        for axes in figure.axes
        if axes.get_label() != "<colorbar>" and axes.get_visible() and axes.axison
    ]
    for number, axes in enumerate(shown, start=1):
        beside = axes.get_title(loc="left")
        text = rf"$\mathbf{{({letter}{number})}}$  {beside}".rstrip()
        axes.set_title(text, loc="left", fontsize=8 if beside else 9)
