"""Arrays with units of each view of a state, without the page, and how they are shown.

Every array is in SI units, with the second coordinate along its first axis, and every value comes
from one call of the public API, which :mod:`~polywigner.explorer.snippets` writes down.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.execution import Engine
from polywigner.explorer.outlines import light_of, source_of
from polywigner.explorer.state import UNITS, Part, State, Unit, needed
from polywigner.figures.levels import difference_db, level_db
from polywigner.figures.style import LEVEL_MAP, PHASE_MAP, SIGNED_MAP
from polywigner.geometry import Aperture
from polywigner.illumination.support import mutual_support
from polywigner.illumination.texts import direction
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

_LOBES = 8.0  # half width of frequency axes in 1/diagonal, as `polywigner transform` has it
_MARGIN = 1.05
_BEAM = 3.0  # half width of the near field's plane: the source's box and three lobes
_ANGLES = 361
_WIDE = 0.5  # sine of the angle from which a beam is seen without spreading it
_UPRIGHT = 1e-9  # of a direction's part in the plane: it has no azimuth


# --- Axes in SI units


def _box(state: State) -> tuple[float, float, float]:
    """The centre of the source's bounds, and half of their longer side, in m."""
    xmin, ymin, xmax, ymax = source_of(state).bounds
    half = max(xmax - xmin, ymax - ymin) / 2
    return float(xmin / 2 + xmax / 2), float(ymin / 2 + ymax / 2), float(half)


def reach_of(state: State) -> float:
    """The largest direction cosine shown: the state's own, or eight lobes of the source."""
    _, _, half = _box(state)
    return state.reach or min(1.0, _LOBES * state.wavelength / (2 * math.sqrt(2) * half))


def frequency_half(state: State) -> float:
    """Half width of the axes of nu, in 1/m."""
    return reach_of(state) / state.wavelength


def position_window(state: State) -> tuple[float, float, float]:
    """Centre and half width of the axes of x, in m: a little more than the bounds."""
    x, y, half = _box(state)
    return x, y, _MARGIN * half


def lag_half(state: State) -> float:
    """Half width of the axes of xi, in m: the largest lag of two points of the source."""
    return _MARGIN * 2 * _box(state)[2]


def plane_half(state: State) -> float:
    """Half width of the plane of the near field, in m."""
    _, _, half = _box(state)
    sine = min(0.7, _BEAM * state.wavelength / (2 * half))
    return half + state.metres(state.distance) * sine / math.sqrt(1 - sine * sine)


def azimuths(state: State) -> tuple[float, float]:
    """Azimuths of the far field's cuts in rad: of the steered beam, or 0, and pi/2 more."""
    first = 0.0
    if state.steering.strip():
        x, y, _ = direction(state.steering)
        first = math.atan2(y, x) if math.hypot(x, y) > _UPRIGHT else 0.0
    return first, first + math.pi / 2


def angles(state: State) -> NDArray[np.float64]:
    """Angles from the normal of the far field's cuts, in rad: all, unless the beam is narrow."""
    reach = reach_of(state)
    largest = math.pi / 2 if reach > _WIDE and not state.reach else math.asin(reach)
    return np.linspace(-largest, largest, _ANGLES)


def square(half: float, samples: int, x: float = 0.0, y: float = 0.0) -> NDArray[np.float64]:
    """(samples, samples, 2): y along the first axis, x along the second."""
    axis = np.linspace(-half, half, samples)
    return np.stack(np.meshgrid(x + axis, y + axis), axis=-1)


# --- Values


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

    def axis_in(self, unit: Unit) -> tuple[float, str]:
        """Factor and name of the axes' unit where the page's unit of length is this one."""
        if self.axis_unit == "1/m":
            return 1 / UNITS[unit], f"1/{unit}"
        return UNITS[unit], unit


@dataclass(frozen=True, eq=False)
class Outlines:
    """Rings (n, 2) in m, not closed: of the source, of the region that W lives on, of lags."""

    source: list[Rings]
    support: list[Rings]
    lags: list[Rings]


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

    Raises PolywignerError for what is no polygon or cannot be fed so, here as in all views.
    """
    support = mutual_support(source_of(state))
    outline = _outline(state)
    return Outlines(_rings(outline.polygons), _rings(support.polygons), lag_rings(state))


def lag_rings(state: State) -> list[Rings]:
    """The lag slice 2(G - x) & 2(x - G) at the chosen position: polygons of rings in m."""
    return _rings(pw.lag_slice(_outline(state), _position(state)))


def _outline(state: State) -> Any:
    source = source_of(state)
    return source if isinstance(source, Aperture) else source.support


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
    half = frequency_half(state)
    source, grid = source_of(state), square(half, samples)
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
    half = frequency_half(state)
    grid = square(half, samples)
    values = pw.wigner(light_of(state), _position(state), grid, engine=ENGINE)
    return Picture("wigner_nu", (0.0, 0.0), half, "1/m", {"W": values}, "m²")


def wigner_at_frequency(state: State, samples: int = SAMPLES) -> Picture:
    """W(x, nu) over x at the chosen spatial frequency, in m^2."""
    x, y, half = position_window(state)
    grid = square(half, samples, x, y)
    values = pw.wigner(light_of(state), grid, _frequency(state), engine=ENGINE)
    return Picture("wigner_x", (x, y), half, "m", {"W": values}, "m²")


def transfer(state: State, samples: int = SAMPLES) -> Picture:
    """OTF over lags with the chosen defocus, complex, without unit: A(-2 w xi/a^2, xi)/A(0, 0)."""
    half = lag_half(state)
    grid = square(half, samples)
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

    Raises ArgumentError for sources of more than 36 edges, of which sums of rays take minutes.
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
    x, y, _ = position_window(state)
    yield Picture("near", (x, y), plane_half(state), "m", arrays, "W/m²", note)


@lru_cache(maxsize=512)  # 4 MB: a file of a view, and the same view once more, are there at once
def _near_strip(state: State, samples: int, number: int) -> tuple[Values, Values, tuple[str, ...]]:
    x, y, _ = position_window(state)
    plane = square(plane_half(state), samples, x, y)
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
    theta, phi = angles(state), azimuths(state)
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


# --- As the page shows them

Scale = Literal["level", "signed", "phase", "unit", "difference"]

COLOUR_MAPS: Mapping[Scale, str] = {
    "level": LEVEL_MAP, "unit": LEVEL_MAP, "phase": PHASE_MAP, "signed": SIGNED_MAP,
    "difference": SIGNED_MAP,
}  # fmt: skip
"""Names of matplotlib's colour maps."""
FLOOR_DB = -40.0
"""Lowest level of pictures in dB."""
_MOST_DB = 3.0  # of differences, as in the figures of planes

_TITLES = {
    "F": "F(ν)", "W": "W(x, ν)", "OTF": "OTF(ξ)", "rays": "Wigner rays",
    "exact": "Kirchhoff, exact", "difference": "rays minus exact",
}  # fmt: skip


_LENGTHS = {"m²": 2, "W/m²": -2}  # powers of length that units of pictures have
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def in_unit(quantity: str, unit: Unit) -> tuple[float, str]:
    """Factor and name of a unit such as "m²" or "W/m²" in the page's unit of length."""
    return float(UNITS[unit]) ** _LENGTHS.get(quantity, 0), quantity.replace("m²", f"{unit}²")


def power_of_ten(value: float) -> int:
    """The exponent, a multiple of 3, that is taken out of values up to this one, or 0."""
    size = abs(value)
    if size == 0 or 1e-2 <= size < 1e4:
        return 0
    return 3 * math.floor(math.log10(size) / 3)


def written(exponent: int) -> str:
    """A power of ten as text: 10⁻⁶."""
    return "10" + str(exponent).translate(_RAISED)


def _number(value: float) -> str:
    """Three digits or, of thousands, four; and the power of ten if there is one."""
    if 1e3 <= abs(value) < 1e5:
        return f"{float(f'{value:.4g}'):.0f}"
    exponent = power_of_ten(value)
    if exponent == 0:
        return f"{value:.3g}"
    return f"{value / 10.0**exponent:.3g} · {written(exponent)}"


@dataclass(frozen=True, eq=False)
class Shown:
    """Values as they are coloured, and the labels of their colour bar."""

    values: NDArray[np.float64]
    low: float
    high: float
    scale: Scale
    title: str
    bar: str
    peak: float = 1.0
    """The divisor of "signed" values."""


def shown(picture: Picture, key: str, part: Part = "level", unit: Unit = "m") -> Shown:
    """One array of a picture, its peak named in this unit of length.

    F is shown as its level (dB of |F|^2 relative to the peak shown), real part or phase; W as it
    is, the OTF by its modulus, irradiances in dB relative to the exact field's peak, differences
    in dB. Real values are divided by their peak, which the colour bar names.
    """
    values, title = picture.arrays[key], _TITLES[key]
    factor, named = in_unit(picture.unit, unit)
    if key in ("rays", "exact"):
        peak = float(np.max(picture.arrays["exact"]))
        return _levels(values, peak, title, f"dB relative to {_number(peak * factor)} {named}")
    if key == "difference":
        return Shown(values, -_MOST_DB, _MOST_DB, "difference", title, "dB")
    if key == "OTF":
        return Shown(np.abs(values), 0.0, 1.0, "unit", "|OTF(ξ)|", "modulus")
    if key == "F" and part == "level":
        bar = f"dB relative to {_number(picture.peak * factor**2)} {unit}⁴"
        return _levels(np.abs(values) ** 2, picture.peak, "|F(ν)|²", bar)
    if key == "F" and part == "phase":
        return Shown(np.degrees(np.angle(values)), -180, 180, "phase", "phase of F(ν)", "degrees")
    if key == "W":
        title = f"{title} over {'x' if picture.name == 'wigner_x' else 'ν'}"
    title = f"Re {title}" if key == "F" else title
    peak = float(np.max(np.abs(values.real)))
    ratio = values.real / peak if peak > 0 else values.real
    bar = f"relative to {_number(peak * factor)} {named}"
    return Shown(ratio, -1.0, 1.0, "signed", title, bar, peak)


def _levels(power: NDArray[Any], peak: float, title: str, bar: str) -> Shown:
    levels = level_db(power, peak if peak > 0 else None, FLOOR_DB)
    return Shown(levels, FLOOR_DB, 0.0, "level", title, bar)
