"""Arrays with units of each view of a state, without the page.

Every array is in SI units, with the second coordinate along its first axis, and every value comes
from one call of the public API, which :mod:`~polywigner.explorer.snippets` writes down.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.execution import Engine
from polywigner.explorer import windows
from polywigner.explorer.sources import light_of, source_of
from polywigner.explorer.state import State, needed
from polywigner.figures.levels import difference_db
from polywigner.geometry import Aperture
from polywigner.illumination.support import mutual_support
from polywigner.numerics.peaks import climbed, largest

Values = NDArray[Any]
Rings = list[NDArray[np.float64]]

SAMPLES = 256
"""Along each axis of a picture."""
ENGINE: Engine = "numpy"
"""Engine of the transforms: as nothing is compiled, a new outline costs no more than an old one."""
NEAR_TOLERANCE = 1e-2
"""Tolerance of sums of Wigner rays: 0.04 dB."""
MOST_NEAR_EDGES = 36
"""Most edges of a source with rays in the near field: a ring of 48 takes 20 s for 256 points."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Values over a square window; arrays (n, n) with y along the first axis."""

    name: str
    centre: tuple[float, float]
    """Centre of the window, in the unit of the axes."""
    half: float
    """Its half width: the outermost samples lie there."""
    axis_unit: str
    """"m" or "1/m"."""
    arrays: Mapping[str, Values]
    unit: str
    """Unit of the arrays; "" for none."""
    note: str = ""
    """A note for the visitor about these values."""
    peak: float = 0.0
    """The largest |F|^2 in the window, between samples too; 0 for other quantities."""

    @property
    def samples(self) -> int:
        """Along each axis."""
        return len(next(iter(self.arrays.values())))


@dataclass(frozen=True, eq=False)
class Outlines:
    """Rings (n, 2) in m, not closed: of the source, of the region that W lives on, of lags."""

    source: list[Rings]
    support: list[Rings]
    lags: list[Rings]
    area: float
    """Area of the elements, in m^2."""


@dataclass(frozen=True, eq=False)
class Cuts:
    """Directivity in two planes through the normal, of a polarised source its co-polar part."""

    theta: NDArray[np.float64]
    """(n,) from the normal, in rad."""
    directivity: NDArray[np.float64]
    """(n, 2) in dBi."""
    largest: float
    """On these cuts, in dBi."""
    phi: tuple[float, float]
    """Azimuths of the planes, in rad."""
    cross: NDArray[np.float64] | None = None
    """Cross-polar part (n, 2) in dBi, of a polarised source."""
    axial_ratio: float = math.nan
    """In dB in the direction of the beam, of a polarised source."""

    @property
    def lines(self) -> list[tuple[str, NDArray[np.float64]]]:
        """Names and levels in dBi of all that is drawn: both planes, then the cross-polar parts."""
        names = [f"φ = {np.degrees(phi):.4g}°" for phi in self.phi]
        found = list(zip(names, self.directivity.T, strict=True))
        if self.cross is not None:
            found += [(f"{n}, cross", c) for n, c in zip(names, self.cross.T, strict=True)]
        return found


def outlines(state: State) -> Outlines:
    """The outline of the source, the support of W, and the lag slice at the chosen position.

    Raises
    ------
    PolywignerError for what is no polygon or cannot be fed so, here as in all views.
    """
    source = source_of(state)
    outline = source if isinstance(source, Aperture) else source.support
    return Outlines(
        _rings(outline.polygons),
        _rings(mutual_support(source).polygons),
        lag_rings(state),
        outline.area,
    )


def lag_rings(state: State) -> list[Rings]:
    """The lag slice 2(G - x) & 2(x - G) at the chosen position: polygons of rings in m."""
    source = source_of(state)
    outline = source if isinstance(source, Aperture) else source.support
    return _rings(pw.lag_slice(outline, _position(state)))


def _rings(shape: Any) -> list[Rings]:
    polygons = [p for p in getattr(shape, "geoms", [shape]) if p.geom_type == "Polygon"]
    return [
        [np.asarray(ring.coords)[:-1] for ring in (p.exterior, *p.interiors)]
        for p in polygons
        if not p.is_empty
    ]


def _position(state: State) -> tuple[float, float]:
    return state.metres(state.x[0]), state.metres(state.x[1])


def _frequency(state: State) -> tuple[float, float]:
    return state.nu[0] * state.per_metre, state.nu[1] * state.per_metre


def fourier(state: State, samples: int = SAMPLES) -> Picture:
    """F(nu) of the source, complex, in m^2."""
    half = windows.frequency_half(state)
    source, grid = source_of(state), windows.square(half, samples)
    values = pw.fourier(source, grid, engine=ENGINE)

    def power(nu: Values) -> tuple[Values, Values]:
        inside = np.clip(nu, -half, half)
        return inside, np.abs(pw.fourier(source, inside, engine=ENGINE)) ** 2

    step = np.full(2, 2 * half / (samples - 1))
    width = np.ptp(np.reshape(source.bounds, (2, 2)), axis=0)
    near, _ = largest(grid.reshape(-1, 2), np.abs(values.ravel()) ** 2, step, width)
    peak = float(climbed(power, near, step, width)[1][0])
    return Picture("fourier", (0.0, 0.0), half, "1/m", {"F": values}, "m²", peak=peak)


def wigner_at_position(state: State, samples: int = SAMPLES) -> Picture:
    """W(x, nu) over nu at the chosen position, in m^2."""
    half = windows.frequency_half(state)
    grid = windows.square(half, samples)
    values = pw.wigner(light_of(state), _position(state), grid, engine=ENGINE)
    return Picture("wigner_nu", (0.0, 0.0), half, "1/m", {"W": values}, "m²")


def wigner_at_frequency(state: State, samples: int = SAMPLES) -> Picture:
    """W(x, nu) over x at the chosen spatial frequency, in m^2."""
    x, y, half = windows.position_window(state)
    grid = windows.square(half, samples, x, y)
    values = pw.wigner(light_of(state), grid, _frequency(state), engine=ENGINE)
    return Picture("wigner_x", (x, y), half, "m", {"W": values}, "m²")


def transfer(state: State, samples: int = SAMPLES) -> Picture:
    """OTF over lags with the chosen defocus, complex, without unit: A(-2 w xi/a^2, xi)/A(0, 0)."""
    half = windows.lag_half(state)
    grid = windows.square(half, samples)
    values = pw.otf(source_of(state), grid, state.defocus, engine=ENGINE)
    return Picture("otf", (0.0, 0.0), half, "m", {"OTF": values}, "")


def edges_of(state: State) -> int:
    """Number of edges of the source, over all elements of an array."""
    source = source_of(state)
    return sum(map(len, state.rings)) * (len(source) if isinstance(source, pw.Array) else 1)


def near_strips(state: State, samples: int) -> int:
    """In how many strips of rows the near field is computed: of a tenth to half a second each."""
    return math.ceil(samples / (8 if edges_of(state) <= 8 else 4))


def near_field(state: State, samples: int = 128) -> Picture:
    """Irradiance on the plane at the chosen distance: by Wigner rays, exact, and how they differ.

    "rays" and "exact" (Kirchhoff, both) in the unit of |u|^2; "difference" in dB, nan where the
    exact field is more than 30 dB below its peak.

    Raises
    ------
    ArgumentError for sources of more than 36 edges, of which sums of rays take minutes.
    """
    *_, picture = near_field_in_steps(state, samples)
    assert picture is not None
    return picture


def near_field_in_steps(state: State, samples: int) -> Iterator[Picture | None]:
    """:func:`near_field` in steps: None where there is time for other work, then the picture."""
    edges = edges_of(state)
    if edges > MOST_NEAR_EDGES:
        raise ArgumentError(
            f"expected at most {MOST_NEAR_EDGES} edges of a source whose near field is summed over "
            f"rays, got {edges}; use `polywigner propagate`"
        )
    key, strips = needed(state, "near"), []
    for number in range(near_strips(state, samples)):
        if number > 0:
            yield None
        strips.append(_near_strip(key, samples, number))
    rays, exact = (np.concatenate([strip[k] for strip in strips]) for k in (0, 1))
    arrays = {"rays": rays, "exact": exact, "difference": difference_db(rays, exact)}
    note = "; ".join(sorted({text for _, _, notes in strips for text in notes}))
    x, y, _ = windows.position_window(state)
    yield Picture("near", (x, y), windows.plane_half(state), "m", arrays, "W/m²", note)


@lru_cache(maxsize=512)  # 4 MB: a file of a view, and the same view once more, are there at once
def _near_strip(state: State, samples: int, number: int) -> tuple[Values, Values, tuple[str, ...]]:
    x, y, _ = windows.position_window(state)
    plane = windows.square(windows.plane_half(state), samples, x, y)
    points = np.concatenate(
        [plane, np.full((samples, samples, 1), state.metres(state.distance))], axis=-1
    )
    part = np.array_split(points, near_strips(state, samples))[number]
    source, wavelength = source_of(state), state.wavelength
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PolywignerWarning)
        rays = pw.irradiance(
            source, part, wavelength, obliquity="kirchhoff", order=state.order,
            tolerance=NEAR_TOLERANCE,
        )  # fmt: skip
        exact = pw.irradiance(source, part, wavelength, "kirchhoff")
    notes = (str(w.message) for w in caught if issubclass(w.category, PolywignerWarning))
    return rays, exact, tuple(notes)


def far_field(state: State) -> Cuts:
    """Directivity in two planes through the normal: phi = 0 and 90 degrees, or of a steered
    beam and the one across."""
    theta, phi = windows.angles(state), windows.azimuths(state)
    polarisation = state.polarisation if state.polarisation.strip() else None
    pattern = pw.radiation_pattern(
        source_of(state), state.wavelength, theta, phi, polarisation=polarisation, engine=ENGINE
    )
    directivity = np.asarray(pattern["directivity"].values)
    if polarisation is None:
        return Cuts(theta, directivity, float(directivity.max()), phi)
    power = pattern.attrs["radiated_power"]
    with np.errstate(divide="ignore"):
        co, cross = (
            10 * np.log10(4 * math.pi / power * np.abs(pattern[part].values) ** 2)
            for part in ("field", "cross_field")
        )
    ratio = pattern.attrs["peak_axial_ratio"]
    return Cuts(theta, co, float(directivity.max()), phi, cross, ratio)


def values_at(state: State) -> dict[str, tuple[complex, str]]:
    """Exact values at the chosen position and frequency: name -> (value, unit)."""
    source, light = source_of(state), light_of(state)
    x, nu = _position(state), _frequency(state)
    return {
        "F(ν)": (complex(pw.fourier(source, nu, engine=ENGINE)), "m²"),
        "W(x, ν)": (complex(pw.wigner(light, x, nu, engine=ENGINE)), "m²"),
        "W(x, 0)": (complex(pw.position_marginal(light, x, engine=ENGINE)), "m²"),
        "∫|u|² dx": (complex(pw.lag_marginal(source, (0.0, 0.0), engine=ENGINE)), "m²"),
    }


PICTURES = {
    "fourier": fourier,
    "wigner_nu": wigner_at_position,
    "wigner_x": wigner_at_frequency,
    "otf": transfer,
    "near": near_field,
}
"""By name; each takes a state and the samples along an axis."""
