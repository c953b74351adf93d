"""Radiation patterns: the far field over angles, and its directivity."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.engines import Engine, Precision, checked_engine, checked_precision
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry.arguments import checked_wavelength, shape_of
from polywigner.geometry.numbers import real_numbers
from polywigner.illumination.direction_cosines import times_direction_cosine
from polywigner.radiometry.directions import PlaneSource, checked_source
from polywigner.radiometry.hemisphere import directions_and_weights, largest_lag
from polywigner.transforms import fourier, lag_marginal
from polywigner.transforms.labelled import Labelled, LabelledArray, LabelledArrays, labelled

__all__ = ["FarField", "PatternObliquity", "far_field", "radiation_pattern"]

PatternObliquity = Literal["rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2", "paper"]

SPEED_OF_LIGHT = 299792458.0

# Rounding leaves 1e-13 of the energy; a directivity relative to less than this has no digits.
_DARK = 1e-12

Values = NDArray[Any]


@dataclass(frozen=True)
class FarField:
    """The far field E(s) = lim r exp(-i k r) U(r s) of a source, and the power that it carries."""

    source: PlaneSource
    wavelength: float
    obliquity: str
    power: float
    """int |E|^2 dOmega over the hemisphere, in W."""

    def __call__(
        self, directions: Values, *, precision: Precision = None, engine: Engine = "auto"
    ) -> Values:
        """E (...), complex, at unit vectors (..., 3); zero where z < 0."""
        nu, cosine = directions[..., :2] / self.wavelength, directions[..., 2]
        front = np.maximum(cosine, 0.0)

        def transform(source: PlaneSource) -> Values:
            return np.asarray(fourier(source, nu, precision=precision, engine=engine))

        total = _amplitude(transform, self.source, self.wavelength, self.obliquity, front)
        values = np.where(cosine < 0, 0.0, total / (1j * self.wavelength))
        return values.astype(np.complex64 if precision == "single" else np.complex128)


def far_field(source: PlaneSource, wavelength: float, obliquity: str) -> FarField:
    """The far field of a checked source.

    Raises ArgumentError for an unknown obliquity, IlluminationError for a source that radiates
    nothing.
    """
    if not isinstance(obliquity, str) or obliquity not in get_args(PatternObliquity):
        names = ", ".join(f'"{name}"' for name in get_args(PatternObliquity))
        raise ArgumentError(f"expected obliquity to be one of {names}, got {obliquity!r}")
    unmeasured = FarField(source, wavelength, obliquity, math.nan)
    blocks = directions_and_weights(largest_lag(source), wavelength)
    power = float(sum(w @ np.square(np.abs(unmeasured(s))) for s, w in blocks))
    if not power > _DARK * _size(source):
        raise IlluminationError(
            f"expected a source that radiates at a wavelength of {wavelength:g} m, got one whose "
            f"far field carries {power:.3g} W"
        )
    return FarField(source, wavelength, obliquity, power)


def _size(source: PlaneSource) -> float:
    """int |u|^2 dx, or 0 for a source that is dark."""
    return max(0.0, float(np.real(lag_marginal(source, (0.0, 0.0), engine="numpy"))))


def _amplitude(
    transform: Callable[[PlaneSource], Values],
    source: PlaneSource,
    wavelength: float,
    obliquity: str,
    cosine: Values,
) -> Values:
    """sum over waves of sqrt(g) F: docs/theory.md, (D2), (D3)."""
    if obliquity == "rayleigh-sommerfeld-1":
        return cosine * transform(source)
    if obliquity == "paper":
        return np.sqrt(cosine) * transform(source)
    turned = transform(times_direction_cosine(source, wavelength))
    if obliquity == "rayleigh-sommerfeld-2":
        return turned
    return (cosine * transform(source) + turned) / 2


def radiation_pattern(
    source: PlaneSource,
    wavelength: float,
    theta: Any,
    phi: Any,
    *,
    obliquity: PatternObliquity = "rayleigh-sommerfeld-1",
    precision: Precision = None,
    engine: Engine = "auto",
) -> Labelled:
    """Far field and directivity of a source over angles from its normal.

    E = sum over the field's waves of sqrt(g) F/(i lambda), F from :func:`fourier`, without any
    interpolation; the directivity is 4 pi |E|^2/P, with P the integral of |E|^2 over the hemisphere
    to rounding (docs/patterns.md). |E|^2 is in W/sr for |u|^2 in W/m^2. The field is scalar; what
    polarisation it stands for is told to :func:`write_pattern`. Nothing goes backwards.

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, with any fields.
    wavelength : in m.
    theta : (n,) angles from the normal in rad, from -pi to pi; negative ones, for cuts, lie at the
        opposite phi.
    phi : (m,) angles from the x axis in rad; or one.
    obliquity : g, a boundary condition: cos^2 ("rayleigh-sommerfeld-1"), ((1 + cos)/2)^2
        ("kirchhoff"), 1 ("rayleigh-sommerfeld-2"), or cos ("paper"); for tapers and steering wave
        by wave (docs/theory.md, (D2), (D3)).
    precision, engine : see :func:`fourier`.

    Returns
    -------
    xarray.Dataset if xarray can be imported, else a LabelledArrays as of :func:`projections`, with
    ``directivity`` (n, m) in dBi, minus infinity where nothing is radiated, and ``field`` (n, m),
    complex, in m times the unit of u. Attributes: the wavelength, frequency, obliquity, radiated
    power and largest directivity on these angles. Accurate to 1e-12 of the largest |E|.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; IlluminationError for a source
    that radiates nothing; GeometryError for an Array whose elements do not lie in the plane z = 0;
    EngineError without the engine.
    """
    checked_precision(precision)
    checked_engine(engine)
    far = far_field(checked_source(source), checked_wavelength(wavelength), obliquity)
    polar, azimuth = _angles(theta, "theta", math.pi), _angles(phi, "phi", math.inf)
    values = far(unit_vectors(polar, azimuth), precision=precision, engine=engine)
    with np.errstate(divide="ignore"):
        directivity = 10 * np.log10(4 * math.pi / far.power * np.square(np.abs(values)))
    return labelled(_described(far, polar, azimuth, values, directivity))


def unit_vectors(theta: Values, phi: Values) -> Values:
    """(n, m, 3) of all angles (n,) from the z axis and (m,) from the x axis."""
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    # cos(pi/2) is 6e-17, and the horizon belongs to both sides
    cosine = np.where(np.abs(cosine) < 1e-15, 0.0, cosine)
    parts = np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), cosine)
    return np.stack(parts, axis=-1)


def _angles(values: Any, name: str, largest: float) -> NDArray[np.float64]:
    expected = f"expected {name} as angles (n,) in rad"
    try:
        angles = np.atleast_1d(real_numbers(values))
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if angles.ndim != 1 or not angles.size:
        raise ArgumentError(f"{expected}, got shape {shape_of(values)}")
    if not np.isfinite(angles).all() or np.abs(angles).max() > largest * (1 + 1e-12):
        raise ArgumentError(
            f"{expected}, finite and from -{largest:.4g} to {largest:.4g}, got {values!r}; use "
            "numpy.radians for degrees"
        )
    return angles


def _described(
    far: FarField, theta: Values, phi: Values, values: Values, directivity: Values
) -> LabelledArrays:
    from polywigner import __version__

    dims = ("theta", "phi")
    return LabelledArrays(
        {
            "directivity": LabelledArray(
                directivity, dims, {"units": "dBi", "long_name": "directivity"}
            ),
            "field": LabelledArray(
                values, dims, {"units": "W^0.5 sr^-0.5", "long_name": "far field r exp(-ikr) U"}
            ),
        },
        {
            "theta": LabelledArray(theta, ("theta",), {"units": "rad", "long_name": "from z"}),
            "phi": LabelledArray(phi, ("phi",), {"units": "rad", "long_name": "from x"}),
        },
        {
            "wavelength": far.wavelength,
            "frequency": SPEED_OF_LIGHT / far.wavelength,
            "obliquity": far.obliquity,
            "radiated_power": far.power,
            "largest_directivity": float(directivity.max()),
            "convention": "waves exp(+ikr)/r, time exp(-i omega t)",
            "source": repr(far.source),
            "polywigner_version": __version__,
        },
    )
