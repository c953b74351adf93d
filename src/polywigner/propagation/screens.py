"""Fields of point sources and plane waves behind opaque plates and openings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_choice, checked_type, complex_array, finite_array
from polywigner.geometry.rings import edges_of_rings
from polywigner.kernels.boundary.edge_waves import EdgeRule, angle_about, edge_wave
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.propagation.boundary import boundary_field, radiator_of
from polywigner.propagation.point_grids import warn_of_missed
from polywigner.source import Illumination
from polywigner.source.obliquities import CONDITIONS

Position = tuple[float, float, float]

_OPS = NumpyOperations()
_RULE = EdgeRule.of(8.0, 100, 14)
# Error of the quadrature rule, relative to the incident field. The largest error for 40,000 random
# edges was 1e-13.
_ERROR = 2e-13
# Size of the displacement off shadow boundaries, relative to the source distance, and direction of
# the displacement.
_SHIFT, _ASIDE = 1e-14, np.array([0.57, 0.31, 0.76])
# On a line through the source and a corner, the edge waves diverge and their sum loses digits.
# Within _AT_CORNER of such a line, the field is replaced by the mean at two points _BESIDE_CORNER
# away. Both lengths are relative to the source distance.
_AT_CORNER, _BESIDE_CORNER = 1e-10, 1e-9
# Number of pairs (point, edge) per block, which take a few MB.
_PAIRS = 1 << 15


def spherical_field(source: Position | Floats, points: Floats, wavelength: float) -> Complex:
    """Return the spherical wave ``exp(ikR)/R`` (n,) of a point source (3,) at points (n, 3).

    All lengths, including the wavelength, have the same unit.
    """
    distance = np.linalg.norm(points - source, axis=1)
    return np.asarray(waves_of_cycles(distance / wavelength) / distance)


def waves_through(
    opening: Aperture, source: Position, points: Floats, wavelength: float, mirrored: float
) -> tuple[Complex, Floats]:
    """Return the field (n,) of a point source behind an opening, and its error (B9).

    The opening lies at z = 0, and the source, with the field exp(ikR)/R, at z < 0. Lengths are in
    m, and the field is in 1/m. ``mirrored`` is the factor, -1, 0 or 1, of the edge waves of the
    source's mirror image.
    """
    begin, end = (points / wavelength for points in edges_of_rings(opening.rings))
    start, stop = ((*edge.T[..., None], 0.0) for edge in (begin, end))
    position, image = np.array(source) / wavelength, np.array(source) * [1, 1, -1] / wavelength
    at_corner = _on_corner_lines(begin, position, points / wavelength)
    if at_corner.any():
        away = np.linalg.norm(points - source, axis=1)[:, None] * _BESIDE_CORNER * _ASIDE
        away = np.where(at_corner[:, None], away, 0.0)
        sides = [
            waves_through(opening, source, points + sign * away, wavelength, mirrored)
            for sign in (1, -1)
        ]
        return (sides[0][0] + sides[1][0]) / 2, np.maximum(sides[0][1], sides[1][1])
    field, errors = np.empty(len(points), np.complex128), np.empty(len(points))
    for block in index_blocks(len(points), _PAIRS // len(begin)):
        at = points[block] / wavelength
        shift = _SHIFT * np.linalg.norm(at - position, axis=1)[:, None] * _ASIDE
        incident = spherical_field(position, at, 1.0) / wavelength
        path = tuple(position), tuple(at.T), start, stop
        aside = tuple((at + shift).T)
        wave = edge_wave(_OPS, _RULE, *path, aside)
        angle = angle_about(_OPS, path[0], aside, start, stop)
        field[block] = incident * (angle - wave.real - 1j * wave.imag).sum(axis=0) / (2 * math.pi)
        errors[block] = _ERROR * abs(incident)
        if mirrored:
            at = np.where((at == image).all(axis=1)[:, None], at + shift, at)
            reflected = spherical_field(image, at, 1.0) / wavelength
            wave = edge_wave(_OPS, _RULE, tuple(image), tuple(at.T), start, stop)
            waves = (wave.real + 1j * wave.imag).sum(axis=0)
            field[block] += mirrored * reflected * waves / (2 * math.pi)
            errors[block] += _ERROR * abs(mirrored * reflected) * len(begin)
    return field, errors


def _on_corner_lines(corners: Floats, source: Floats, points: Floats) -> NDArray[np.bool_]:
    """Return a mask of points (n, 3) that are close to a line from the source through a corner.

    The corners have the shape (k, 2).
    """
    near = np.zeros(len(points), np.bool_)
    away = points - source
    lengths = np.linalg.norm(away, axis=1)
    for x, y in corners:
        axis = np.array([x, y, 0.0]) - source
        axis /= np.linalg.norm(axis)
        near |= np.linalg.norm(np.cross(away, axis), axis=1) <= _AT_CORNER * lengths
    return near


@final
@dataclass(frozen=True)
class PointSource:
    """A point source with the field ``amplitude exp(ikR)/R`` at the distance R.

    Parameters
    ----------
    position : array_like, shape (3,)
        Position in m. A source that illuminates a :class:`Screen` lies at z < 0.
    amplitude : complex, default 1.0
        Amplitude in the unit of the field times m.

    Raises
    ------
    ArgumentError
        If the position is not three finite numbers, or the amplitude is not finite.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.PointSource((0.0, 0.0, -5.0)).amplitude
    1.0
    """

    position: tuple[float, float, float]
    amplitude: complex = 1.0

    def __init__(self, position: ArrayLike, amplitude: complex = 1.0) -> None:
        object.__setattr__(self, "position", _three_numbers(position, "position", "in m"))
        object.__setattr__(self, "amplitude", _checked_amplitude(amplitude))


@final
@dataclass(frozen=True)
class PlaneWave:
    """A plane wave ``amplitude exp(ik s.x)`` that travels in the direction s.

    Parameters
    ----------
    direction : array_like, shape (3,)
        Direction of travel, of any length, with z > 0: from the front to the back of the screen.
    amplitude : complex, default 1.0
        Amplitude in the unit of the field, with the phase at the origin.

    Raises
    ------
    ArgumentError
        If the direction is not three finite numbers with z > 0, or the amplitude is not finite.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.PlaneWave((0.0, 3.0, 4.0)).direction
    (0.0, 0.6, 0.8)
    """

    direction: tuple[float, float, float]
    amplitude: complex = 1.0

    def __init__(self, direction: ArrayLike, amplitude: complex = 1.0) -> None:
        ahead = _three_numbers(direction, "direction", "of any length")
        if not ahead[2] > 0:
            raise ArgumentError(
                f"direction must have z > 0 (from the front to the back of the screen), got {ahead}"
            )
        x, y, z = (c / math.hypot(*ahead) for c in ahead)
        object.__setattr__(self, "direction", (x, y, z))
        object.__setattr__(self, "amplitude", _checked_amplitude(amplitude))


@final
@dataclass(frozen=True)
class Screen:
    """An opaque screen in the plane z = 0, illuminated from z < 0, for :func:`amplitude`.

    By Babinet's principle, the field behind a plate is the incident field minus the field behind an
    opening of the same outline. The ``method`` of :func:`amplitude` selects the boundary condition
    on the back of the screen. For "kirchhoff" the screen is black. On the back of the screen, the
    field is zero for "rayleigh-sommerfeld-1", and its normal derivative is zero for
    "rayleigh-sommerfeld-2".

    Parameters
    ----------
    outline : Aperture
        Outline of the opaque part, or of the opening, without an illumination.
    illuminated_by : PointSource or PlaneWave
        Incident wave. A point source must lie at z < 0.
    kind : {"plate", "opening"}, default "plate"
        Whether the outline is an opaque "plate" in an open plane, or an "opening" in an infinite
        opaque screen.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, the outline has an illumination, or a point source lies
        at z >= 0.

    Examples
    --------
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
                "expected the outline of a screen as an Aperture without an illumination, got "
                f"{self.outline!r:.80}"
            )
        expected = "illuminated_by to be a PointSource or a PlaneWave"
        light = checked_type(self.illuminated_by, expected, PointSource, PlaneWave)
        if isinstance(light, PointSource) and not light.position[2] < 0:
            raise ArgumentError(
                "the point source must lie in front of the screen, at z < 0, got the position "
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
    """Return the field behind a screen at points (n, 3) with z > 0, and its error, both (n,).

    Raises ArgumentError unless ``method`` is a boundary condition.
    """
    checked_choice(method, "the method behind a screen", CONDITIONS)
    light = screen.illuminated_by
    if isinstance(light, PointSource):
        mirrored = CONDITIONS[method].mirrored
        incident = light.amplitude * spherical_field(light.position, points, wavelength)
        field, errors = waves_through(screen.outline, light.position, points, wavelength, mirrored)
        through, errors = light.amplitude * field, abs(light.amplitude) * errors
    else:
        wave = Illumination([1.0], [np.array(light.direction[:2]) / wavelength])
        radiator = radiator_of(screen.outline.with_illumination(wave))
        cycles = (points / wavelength) @ np.array(light.direction)
        incident = light.amplitude * waves_of_cycles(cycles)
        field, *bounds = boundary_field(radiator, points, wavelength, method, tolerance, engine)
        through = light.amplitude * field
        errors, allowed = (abs(light.amplitude) * bound for bound in bounds)
        warn_of_missed(errors, allowed, "points")
    return (incident - through if screen.kind == "plate" else through), errors


def _three_numbers(value: Any, name: str, meaning: str) -> tuple[float, float, float]:
    """Return three finite floats; raise ArgumentError for other values."""
    expected = f"expected {name} to be three finite numbers {meaning}"
    x, y, z = (finite_array(value, expected, (3,)) + 0.0).tolist()
    return x, y, z


def _checked_amplitude(value: complex) -> complex:
    """Return an amplitude as a float or complex; raise ArgumentError unless it is finite."""
    number = complex(complex_array(value, "expected amplitude to be a finite complex number", ()))
    return value if isinstance(value, float) else number
