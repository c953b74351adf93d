"""Fields of point sources and plane waves behind opaque plates and openings."""

from __future__ import annotations

import math
import numbers
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, value_text
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_choice, finite_array
from polywigner.kernels.boundary.edge_waves import spherical_edge
from polywigner.numerics.chirps import waves_of_turns
from polywigner.propagation.boundary import boundary_field, radiator_of
from polywigner.propagation.point_grids import warn_of_missed
from polywigner.source import Illumination
from polywigner.source.obliquities import CONDITIONS

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Position = tuple[float, float, float]

_OPS = execution.NumpyOperations(double=True)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
# Change of the detour along a panel, in cycles, up to which the error estimate by halves is valid.
_TURNS = 2.0
# Panels per block: temporary arrays of a few MB.
_ROWS = 1 << 12
# Largest length of edges in wavelengths, about one panel each; points per block.
_MOST = 1 << 22
_POINTS = 1 << 8


def incident_of_point(source: Position, points: Floats, wavelength: float) -> Complex:
    """exp(ikR)/R at points (n, 3), R the distance from the source (3,)."""
    distance = np.linalg.norm(points - source, axis=1)
    return np.asarray(waves_of_turns(distance / wavelength) / distance)


def waves_through(
    opening: Aperture,
    source: Position,
    points: Floats,
    wavelength: float,
    mirrored: float,
    tolerance: float,
) -> tuple[Complex, Floats]:
    """Field behind an opening over the incident field at points (n, 3), and its error."""
    edges = np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in opening.rings])
    edges = edges / wavelength
    around = float(np.hypot(*(edges[:, 2:] - edges[:, :2]).T).sum())
    if not around <= _MOST:
        raise ArgumentError(
            f"edges of the screen are too long: {around:.3g} wavelengths in all, at most "
            f"{_MOST:.2g}; check the unit of the wavelength, or remove parts far from the path"
        )
    step = max(1, min(_POINTS, int(_MOST / around)))
    ratios, errors = np.zeros(len(points), np.complex128), np.zeros(len(points))
    position, allowed = np.array(source) / wavelength, 2 * math.pi * tolerance
    for some in (slice(low, low + step) for low in range(0, len(points), step)):
        ratios[some], errors[some] = _sums(
            edges, position, points[some] / wavelength, mirrored, allowed
        )
    return ratios / (2 * math.pi), errors / (2 * math.pi)


def _sums(
    edges: Floats, source: Floats, points: Floats, mirrored: float, allowed: float
) -> tuple[Complex, Floats]:
    """Integrals over all edges: panels are halved until the halves agree with the panel."""
    n, total, errors = len(points), np.zeros(len(points), np.complex128), np.zeros(len(points))
    point = np.repeat(np.arange(n), len(edges))
    edge = np.tile(np.arange(len(edges)), n)
    low, high = np.zeros(len(point)), np.ones(len(point))
    panels = partial(_panels, edges, source, points, mirrored)
    previous, _ = panels(point, edge, low, high)
    while len(point):
        centre = 0.5 * (low + high)
        left, swing_left = panels(point, edge, low, centre)
        right, swing_right = panels(point, edge, centre, high)
        change = abs(left + right - previous)
        resolved = np.maximum(swing_left, swing_right) <= _TURNS
        # the allowed error is divided among the panels of an edge
        fraction = np.maximum(high - low, 2.0**-10) / 4.0
        is_point = (centre <= low) | (centre >= high)
        good = (resolved & (change <= allowed * fraction)) | is_point
        np.add.at(total, point[good], (left + right)[good])
        np.add.at(errors, point[good], change[good])
        bad = ~good
        point, edge = np.repeat(point[bad], 2), np.repeat(edge[bad], 2)
        previous = np.stack([left[bad], right[bad]], axis=1).ravel()
        ends = np.stack([low[bad], centre[bad], high[bad]], axis=1)
        low, high = ends[:, :2].ravel(), ends[:, 1:].ravel()
    return total, errors


def _panels(
    edges: Floats, source: Floats, points: Floats, mirrored: float,
    point: NDArray[np.intp], edge: NDArray[np.intp], low: Floats, high: Floats,
) -> tuple[Complex, Floats]:  # fmt: skip
    """Integrals over panels, fractions low to high of edges, and ranges of the detour there."""
    values, swings = np.empty(len(point), np.complex128), np.empty(len(point))
    for start in range(0, len(point), _ROWS):
        some = slice(start, start + _ROWS)
        row, where = edges[edge[some]], points[point[some]]
        span = row[:, 2:] - row[:, :2]
        length = np.hypot(*span.T)
        along = (span.T / length)[:, :, None]
        half = 0.5 * (high[some] - low[some])
        at = (low[some] + half)[:, None] + half[:, None] * _NODES
        node = (row[:, :1] + span[:, :1] * at, row[:, 1:2] + span[:, 1:] * at)
        p = tuple(where[:, k : k + 1] for k in range(3))
        s = (float(source[0]), float(source[1]), float(source[2]))
        real, imag, detour = spherical_edge(_OPS, s, p, node, tuple(along), mirrored)
        values[some] = (real @ _WEIGHTS + 1j * (imag @ _WEIGHTS)) * half * length
        swings[some] = np.ptp(detour, axis=1)
    return values, swings


@final
@dataclass(frozen=True)
class PointSource:
    """A point source: the field amplitude exp(ikR)/R at the distance R.

    Parameters
    ----------
    position : (3,) in m; with z < 0 in front of a :class:`Screen`, which lies in the plane z = 0.
    amplitude : complex, in the unit of the field times m.

    Raises ArgumentError for a position that is not three finite numbers.

    >>> import polywigner as pw
    >>> pw.PointSource((0.0, 0.0, -5.0)).amplitude
    1.0
    """

    position: tuple[float, float, float]
    amplitude: complex = 1.0

    def __init__(self, position: ArrayLike, amplitude: complex = 1.0) -> None:
        object.__setattr__(self, "position", _three(position, "position", "in m"))
        object.__setattr__(self, "amplitude", _checked_amplitude(amplitude))


@final
@dataclass(frozen=True)
class PlaneWave:
    """A plane wave amplitude exp(ik s.x), s its direction of travel.

    Parameters
    ----------
    direction : (3,), of any length, z > 0: towards the far side of the screen.
    amplitude : complex, in the unit of the field; its phase is the phase at the origin.

    Raises ArgumentError for a direction that is not three finite numbers with z > 0.

    >>> import polywigner as pw
    >>> pw.PlaneWave((0.0, 3.0, 4.0)).direction
    (0.0, 0.6, 0.8)
    """

    direction: tuple[float, float, float]
    amplitude: complex = 1.0

    def __init__(self, direction: ArrayLike, amplitude: complex = 1.0) -> None:
        ahead = _three(direction, "direction", "of any length")
        if not ahead[2] > 0:
            raise ArgumentError(
                f"expected direction with z > 0, through the screen at z = 0, got {ahead}"
            )
        x, y, z = (c / math.hypot(*ahead) for c in ahead)
        object.__setattr__(self, "direction", (x, y, z))
        object.__setattr__(self, "amplitude", _checked_amplitude(amplitude))


@final
@dataclass(frozen=True)
class Screen:
    """An opaque screen in the plane z = 0, illuminated from z < 0, for :func:`amplitude`.

    Behind a plate the field is the incident field minus the field behind an opening of the same
    outline (Babinet). The ``method`` of :func:`amplitude` selects the boundary condition:
    Kirchhoff's screen is black; on the back of the screen, the field is zero for Rayleigh and
    Sommerfeld's first condition, and its normal derivative for their second one.

    Parameters
    ----------
    outline : an Aperture without illumination: the opaque part, or the opening.
    illuminated_by : a :class:`PointSource` or a :class:`PlaneWave`.
    kind : "plate" (default): the outline is opaque and everything else is open; or "opening": the
        outline is open in an infinite screen.

    Raises ArgumentError for other types, for an aperture with an illumination, and for a point
    source with z >= 0.

    >>> import polywigner as pw
    >>> half_plane = pw.Aperture([(0, -500), (700, -500), (700, 500), (0, 500)])
    >>> screen = pw.Screen(half_plane, pw.PointSource((0.0, 0.0, -5.0)))
    >>> grazing = pw.amplitude(screen, (0.0, 0.0, 5.0), 0.1)
    >>> round(float(abs(grazing)) * 10.0, 3)  # half the free field at 10 m
    0.5
    """

    outline: Aperture
    illuminated_by: PointSource | PlaneWave
    kind: Literal["plate", "opening"] = "plate"

    def __post_init__(self) -> None:
        if not isinstance(self.outline, Aperture) or self.outline.illumination is not None:
            raise ArgumentError(
                "expected the outline of a screen as an Aperture without illumination, got "
                f"{self.outline!r:.80}"
            )
        if not isinstance(self.illuminated_by, (PointSource, PlaneWave)):
            raise ArgumentError(
                f"expected illuminated_by as a PointSource or a PlaneWave, "
                f"got {type(self.illuminated_by).__name__}"
            )
        light = self.illuminated_by
        if isinstance(light, PointSource) and not light.position[2] < 0:
            raise ArgumentError(
                "point source of a screen must lie in front of it, at z < 0, got "
                f"{light.position}; the screen lies in the plane z = 0"
            )
        checked_choice(self.kind, "kind", ("plate", "opening"))


def field_of_screen(
    screen: Screen,
    points: NDArray[np.float64],
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
) -> tuple[Complex, NDArray[np.float64]]:
    """The field at points (n, 3), z > 0, and an estimate of its error, both (n,)."""
    if method not in CONDITIONS:
        raise ArgumentError(
            f"expected method to be one of {', '.join(CONDITIONS)} behind a screen, got {method!r}"
        )
    light = screen.illuminated_by
    if isinstance(light, PointSource):
        mirrored = CONDITIONS[method].mirrored
        incident = light.amplitude * incident_of_point(light.position, points, wavelength)
        ratio, error = waves_through(
            screen.outline, light.position, points, wavelength, mirrored, tolerance
        )
        through, errors = incident * ratio, abs(incident) * error
        allowed = np.asarray(2.0 * tolerance * abs(incident))
    else:
        wave = Illumination([1.0], [np.array(light.direction[:2]) / wavelength])
        radiator = radiator_of(screen.outline.with_illumination(wave))
        turns = (points / wavelength) @ np.array(light.direction)
        incident = light.amplitude * waves_of_turns(turns)
        field, *bounds = boundary_field(radiator, points, wavelength, method, tolerance, engine)
        through = light.amplitude * field
        errors, allowed = (abs(light.amplitude) * bound for bound in bounds)
    warn_of_missed(errors, allowed, "points")
    return (incident - through if screen.kind == "plate" else through), errors


def _three(value: Any, name: str, meaning: str) -> tuple[float, float, float]:
    expected = f"expected {name} as three finite numbers {meaning}"
    x, y, z = (finite_array(value, expected, (3,)) + 0.0).tolist()
    return x, y, z


def _checked_amplitude(value: complex) -> complex:
    if not isinstance(value, numbers.Number) or not np.isfinite(complex(value)):
        raise ArgumentError(
            f"expected amplitude as a finite complex number, got {value_text(value)}"
        )
    return value if isinstance(value, float) else complex(value)
