"""Radiance and radiant intensity: W and F in SI units."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_precision
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import checked_wavelength, takes_frequency
from polywigner.radiometry.bands import checked_bandwidth, wavelengths_of_band
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_directions,
    checked_positions,
    checked_radiator,
)
from polywigner.radiometry.hemisphere import largest_lag
from polywigner.transforms import fourier, wigner
from polywigner.transforms.wavefronts import flat_of, mean_over_tilts
from polywigner.transforms.xarray_arguments import takes_xarray

__all__ = ["Normalisation", "radiance", "radiant_intensity"]

Normalisation = Literal["si", "paper"]

# Of the mean over a band, as a share of the largest intensity.
_BAND_ERROR = 1e-12


def _radiance_units(arguments: dict[str, Any]) -> str:
    return "m-4 sr-1" if arguments.get("normalisation") == "paper" else "W m-2 sr-1"


@takes_frequency
@takes_xarray("x", "direction", units=_radiance_units, long_name="radiance L(x, s)")
def radiance(
    source: PlaneSource | Wavefront,
    x: ArrayLike,
    direction: ArrayLike,
    wavelength: float,
    normalisation: Normalisation = "si",
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Radiance L(x, s) = W(x, s_par/lambda)/lambda^2 of a source at a place, into a direction.

    Negative in places, as W is: only integrals over position or direction are measurable. Over
    both, with the projected solid angle, it gives the power (docs/radiometry.md, (E1)). Differs
    from the paper, whose W/(4 pi A lambda^2) is ``normalisation="paper"``: the 4 pi is spurious,
    and A makes it a mean over the aperture (docs/corrections.md).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    x : (..., 2) positions in m, outside of the source too: in its automean.
    direction : (..., 3) unit vectors with z >= 0; broadcasts against ``x``.
    wavelength : in m.
    normalisation : "si"; or "paper", without the power |u|^2 A of the source: per m^4 and sr, A
        the area of the aperture, or of the union of an array's elements.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in W/(m^2 sr). Accurate to 1e-12 (single precision: 5e-6) int |u|^2/lambda^2.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

    >>> import polywigner as pw
    >>> round(float(pw.radiance(pw.shapes.square(10e-3), (0, 0), (0, 0, 1), 3.2e-3)), 3)  # W/m^2/sr
    39.063
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    if not isinstance(normalisation, str) or normalisation not in get_args(Normalisation):
        raise ArgumentError(f'expected normalisation to be "si" or "paper", got {normalisation!r}')
    nu = checked_directions(direction)[..., :2] / length
    found = wigner(radiator, checked_positions(x), nu, precision=precision, engine=engine)
    scale = 1.0
    if normalisation == "paper":
        flat = flat_of(radiator)
        area = flat.area if isinstance(flat, Aperture) else flat.support.area
        scale = 1 / (4 * math.pi * area)
    return found * found.dtype.type(scale / length**2)


@takes_frequency
@takes_xarray("direction", units="W sr-1", long_name="radiant intensity")
def radiant_intensity(
    source: PlaneSource | Wavefront,
    direction: ArrayLike,
    wavelength: float,
    *,
    bandwidth: float | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Radiant intensity cos(theta) |F(s_par/lambda)|^2/lambda^2: the radiance over the source.

    Its integral over the hemisphere is :func:`power` (docs/radiometry.md, (E2)).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    direction : (..., 3) unit vectors with z >= 0.
    wavelength : in m.
    bandwidth : in Hz; the mean over light of all frequencies that are at most half of it from that
        of the wavelength (docs/coherence.md, (PC6)). None: light of the one wavelength.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, not negative, in W/sr.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    As :func:`radiance` does.

    >>> import polywigner as pw
    >>> round(float(pw.radiant_intensity(pw.shapes.square(10e-3), (0, 0, 1), 3.2e-3)), 6)  # W/sr
    0.000977
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    directions = checked_directions(direction)
    if bandwidth is not None:
        band = checked_bandwidth(bandwidth, length)
        parts = wavelengths_of_band(length, band, largest_lag(radiator), _BAND_ERROR)
        how: dict[str, Any] = {"precision": precision, "engine": engine}
        return sum(w * radiant_intensity(radiator, directions, one, **how) for one, w in parts)
    compute: Any = partial(_per_frequency, length, precision=precision, engine=engine)
    nu = directions[..., :2] / length
    if isinstance(radiator, Wavefront) and not radiator.is_coherent:
        double = checked_precision(precision) != "single"
        of_coherent = partial(compute, radiator.coherent)
        found = mean_over_tilts(of_coherent, radiator, nu, double=double)
    else:
        found = compute(radiator, nu)
    return (directions[..., 2] * found).astype(found.dtype, copy=False)[()]


def _per_frequency(wavelength: float, source: Any, nu: Any, **how: Any) -> Any:
    """|F|^2/lambda^2."""
    return np.square(np.abs(fourier(source, nu, **how)) / wavelength)
