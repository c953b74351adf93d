"""Opaque screens: the field of a point source or a plane wave behind a plate or an opening."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import real_numbers
from polywigner.illumination import Illumination
from polywigner.illumination.obliquities import CONDITIONS
from polywigner.propagation.boundary import boundary_field
from polywigner.propagation.panels import radiator_of
from polywigner.propagation.places import LARGEST, checked_name, warn_of_missed
from polywigner.propagation.screen_sums import incident_of_point, wave_at, waves_through

__all__ = ["PlaneWave", "PointSource", "Screen", "field_of_screen"]


@final
@dataclass(frozen=True)
class PointSource:
    """A point source: the field amplitude exp(ikR)/R at the distance R.

    Parameters
    ----------
    position : (3,) in m, z < 0: before the screen, which lies in the plane z = 0.
    amplitude : complex, in the unit of the field times m.

    Raises ArgumentError for a position that is not three finite numbers with z < 0.

    >>> import polywigner as pw
    >>> pw.PointSource((0.0, 0.0, -5.0)).amplitude
    1.0
    """

    position: tuple[float, float, float]
    amplitude: complex = 1.0

    def __init__(self, position: ArrayLike, amplitude: complex = 1.0) -> None:
        place = _three(position, "position", "in m")
        if not place[2] < 0:
            raise ArgumentError(
                f"expected position with z < 0, before the screen at z = 0, got {place}"
            )
        if not (-place[2] >= 1 / LARGEST and max(map(abs, place)) <= LARGEST):
            raise ArgumentError(
                f"expected position at lengths from {1 / LARGEST:g} to {LARGEST:g} m, got {place}"
            )
        object.__setattr__(self, "position", place)
        object.__setattr__(self, "amplitude", _checked_amplitude(amplitude))


@final
@dataclass(frozen=True)
class PlaneWave:
    """A plane wave amplitude exp(ik s.x), s its direction of travel.

    Parameters
    ----------
    direction : (3,), of any length, z > 0: towards the far side of the screen.
    amplitude : complex, in the unit of the field; its phase is that at the origin.

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
        largest = max(map(abs, ahead))  # first: lengths beyond floats, and denormal ones
        scaled = [c / largest for c in ahead]
        x, y, z = (c / math.hypot(*scaled) for c in scaled)
        if not z > 0:
            raise ArgumentError(
                f"expected direction with z > 0 beside its other components, got {ahead}"
            )
        object.__setattr__(self, "direction", (x, y, z))
        object.__setattr__(self, "amplitude", _checked_amplitude(amplitude))


@final
@dataclass(frozen=True)
class Screen:
    """An opaque screen in the plane z = 0, lit from z < 0, whose field :func:`amplitude` gives.

    Behind a plate the field is the incident one less that which an opening of its outline lets
    through (Babinet). "Opaque" means what the ``method`` of :func:`amplitude` says: Kirchhoff's
    screen is black; Rayleigh and Sommerfeld's first has the field 0 on its back, the second no
    normal derivative. The differences show at angles far from the boundary of the shadow.

    Parameters
    ----------
    outline : an Aperture without illumination: what is opaque, or what is open.
    lit_by : a :class:`PointSource` or a :class:`PlaneWave`.
    kind : "plate" (default): the outline is opaque and all else open; or "opening": it is open in
        a screen without end.

    Raises ArgumentError for other types, and for an aperture with an illumination.

    >>> import polywigner as pw
    >>> half_plane = pw.Aperture([(0, -500), (700, -500), (700, 500), (0, 500)])
    >>> screen = pw.Screen(half_plane, pw.PointSource((0.0, 0.0, -5.0)))
    >>> grazing = pw.amplitude(screen, (0.0, 0.0, 5.0), 0.1, "kirchhoff")
    >>> round(float(abs(grazing)) * 10.0, 3)  # half the free field at 10 m
    0.5
    """

    outline: Aperture
    lit_by: PointSource | PlaneWave
    kind: Literal["plate", "opening"] = "plate"

    def __post_init__(self) -> None:
        if not isinstance(self.outline, Aperture) or self.outline.illumination is not None:
            got = type(self.outline).__name__
            if isinstance(self.outline, Aperture):
                got = "one with an illumination"
            raise ArgumentError(
                f"expected the outline of a screen as an Aperture without illumination, got {got}"
            )
        if not isinstance(self.lit_by, (PointSource, PlaneWave)):
            raise ArgumentError(
                f"expected lit_by as a PointSource or a PlaneWave, got {type(self.lit_by).__name__}"
            )
        checked_name("kind", self.kind, ("plate", "opening"))


def field_of_screen(
    screen: Screen,
    points: NDArray[np.float64],
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """The field at points (n, 3), z > 0, and an estimate of its error, both (n,)."""
    if method not in CONDITIONS:
        raise ArgumentError(
            f"expected method to be one of {', '.join(CONDITIONS)} behind a screen, got {method!r}"
        )
    light = screen.lit_by
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
        incident = light.amplitude * wave_at(light.direction, points, wavelength)
        found = boundary_field(radiator, points, wavelength, method, tolerance, True, engine)
        through = light.amplitude * found[0]
        errors, allowed = (abs(light.amplitude) * e for e in found[1:])
    warn_of_missed(errors, allowed, "points", stacklevel=4)
    return (incident - through if screen.kind == "plate" else through), errors


def _three(value: Any, name: str, meaning: str) -> tuple[float, float, float]:
    try:
        numbers = real_numbers(value)
    except ValueError:
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ArgumentError(f"expected {name} as three finite numbers {meaning}, got {value!r}")
    x, y, z = (numbers + 0.0).tolist()
    return x, y, z


def _checked_amplitude(value: Any) -> complex:
    try:
        if isinstance(value, (str, bool, np.bool_)):
            raise TypeError
        number = complex(value)
    except (TypeError, ValueError, OverflowError):
        number = complex(math.nan)
    if not (math.isfinite(number.real) and math.isfinite(number.imag)):
        raise ArgumentError(f"expected amplitude as a finite complex number, got {value!r}")
    return value if isinstance(value, float) else number
