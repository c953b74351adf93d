"""Far fields over directions, for each boundary condition; their power; the image of a point."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution import Engine, Precision
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import (
    Points,
    checked_choice,
    checked_length,
    checked_row,
    checked_wavelength,
    takes_frequency,
    warn_of_lens,
)
from polywigner.optics import FirstOrder
from polywigner.propagation.collins import field_behind
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_radiator,
    directions_and_weights,
    largest_lag,
    power_by_lags,
)
from polywigner.radiometry.flux import radiant_intensity
from polywigner.source import Array
from polywigner.source.obliquities import (
    DEFAULT,
    OBLIQUITIES,
    ObliquityName,
    times_direction_cosine,
)
from polywigner.transforms import fourier, pupil
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import flat_of, is_partly_coherent
from polywigner.transforms.xarray_arguments import takes_xarray

# Rounding leaves 1e-13 of the energy; a directivity relative to less than this has no digits.
_DARK = 1e-12


def far_field(
    source: Any,
    directions: NDArray[np.float64],
    wavelength: float,
    obliquity: str,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[Any]:
    """lim r exp(-i k r) U(r s) (...), complex, at unit vectors s (..., 3): docs/patterns.md, (RP1).

    In m times the unit of u; zero where z < 0.
    """
    nu, cosine = directions[..., :2] / wavelength, directions[..., 2]
    front = np.maximum(cosine, 0.0)

    def spectrum(turned: bool) -> Any:
        try:
            field = times_direction_cosine(source, wavelength) if turned else source
        except IlluminationError:  # all waves graze the plane: their cosines are zero
            return 0.0
        return fourier(field, nu, precision=precision, engine=engine)

    condition = OBLIQUITIES[obliquity]
    if not condition.is_boundary_condition:
        total = np.sqrt(front) * spectrum(False)
    else:
        total = condition.field * front * spectrum(False) if condition.field else 0.0
        total = (
            total + condition.slope * spectrum(True) if condition.needs_normal_derivative else total
        )
    values = np.where(cosine < 0, 0.0, total / (1j * wavelength))
    return values.astype(np.complex64 if precision == "single" else np.complex128)


@takes_frequency
def radiated_power(
    source: PlaneSource | Wavefront,
    wavelength: float,
    obliquity: ObliquityName = DEFAULT,
) -> float:
    """Power that leaves through the far hemisphere, P = int |E|^2 dOmega (docs/patterns.md, (RP2)).

    With ``obliquity="paper"`` it is :func:`power`. It differs from int |u|^2 by what is evanescent
    and by the boundary condition: small patches radiate a seventh.

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    wavelength : in m.
    obliquity : as of :func:`radiation_pattern`.

    Returns
    -------
    In W, to 1e-12 of int |u|^2. Cost: F in some 15 (diameter/wavelength)^2 + 1000 directions.
    Beyond 600 wavelengths by lags as :func:`power`, to 1e-8, or 1e-5 for obliquities that take
    slopes.

    Raises
    ------
    ArgumentError for arguments of the wrong type or range; IlluminationError for a source that
    radiates nothing; GeometryError for an Array whose elements do not lie in the plane z = 0.

    >>> import polywigner as pw
    >>> patch = pw.shapes.rectangle(1.2e-3, 0.9e-3)  # |u|^2 = 1 W/m^2 on 1.08 mm^2
    >>> round(pw.radiated_power(patch, 3.9e-3) / patch.area, 3)
    0.135
    """
    name = checked_choice(obliquity, "obliquity", OBLIQUITIES)
    radiator, length = checked_radiator(source, partly=True), checked_wavelength(wavelength)
    check_slopes(radiator, name)
    OBLIQUITIES[name].warn_of_fit(flat_of(radiator), length)
    return powers_of(radiator, length, name)[0]


def check_slopes(source: PlaneSource | Wavefront, name: str) -> None:
    """Raise ArgumentError for an obliquity that takes the slopes of a curved wave, or of tilts."""
    if isinstance(source, Wavefront) and OBLIQUITIES[name].needs_normal_derivative:
        raise ArgumentError(
            f'expected obliquity {DEFAULT!r} or "paper" for a curved wave or partly '
            f"coherent light, got {name!r}, whose factor differs from place to place and from tilt "
            "to tilt; amplitude has it near by, of coherent light"
        )


def powers_of(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: str
) -> tuple[float, float]:
    """The radiated power and int |u|^2, in W."""
    power = power_by_lags(source, wavelength, obliquity)
    if power is None:
        blocks = directions_and_weights(largest_lag(source), wavelength)
        power = float(sum(w @ _intensity(source, s, wavelength, obliquity) for s, w in blocks))
    return checked_powers(power, energy_of(source), wavelength)


def checked_powers(power: float, energy: float, wavelength: float) -> tuple[float, float]:
    """The radiated power and int |u|^2; IlluminationError for a source that radiates nothing."""
    if not power > _DARK * max(0.0, energy):
        raise IlluminationError(
            f"expected a source that radiates at a wavelength of {wavelength:g} m, got one whose "
            f"far field carries {power:.3g} W; check the unit of the wavelength, and whether waves "
            "graze the aperture or cancel"
        )
    return power, energy


def _intensity(
    source: PlaneSource | Wavefront, directions: NDArray[np.float64], wavelength: float, name: str
) -> NDArray[np.float64]:
    """Radiant intensity (n,) in W/sr at unit vectors (n, 3) of the front."""
    if not is_partly_coherent(source):
        return np.square(np.abs(far_field(source, directions, wavelength, name)))
    # the intensity has the factor cos, the default condition its square
    factor = 1.0 if name == "paper" else directions[:, 2]
    return np.asarray(radiant_intensity(source, directions, wavelength) * factor)


@takes_xarray("points", units="m-2", long_name="point spread function")
def psf(
    source: Aperture | Array,
    points: Points,
    wavelength: ArrayLike,
    focal_length: float,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    weights: ArrayLike | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Point spread function of a lens with a pupil of this shape, in or out of focus.

    The irradiance behind a lens, in its focal plane, of a star on the axis, as a share of its power
    for each m^2: its integral over the plane is 1, its Fourier transform is :func:`otf`. Any other
    first-order system: :func:`irradiance` with ``through``. Of several wavelengths it is the mean,
    as of a detector that sees them all.

    Parameters
    ----------
    source : Aperture, or an Array of apertures in the plane z = 0, with the field in the pupil; the
        axis passes through the origin.
    points : (..., 2) in the image in m.
    wavelength : in m, or (k,) of a polychromatic source.
    focal_length : in m, or the distance of the image from the pupil.
    defocus : the wavefront aberration W20 at ``pupil_radius``, in waves of the mean wavelength; the
        aberration in m is that of all wavelengths.
    pupil_radius : see :func:`otf`.
    weights : (k,) of the wavelengths, zero or more; None: all the same.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) float64, at least 0, in 1/m^2.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; IlluminationError for an Array
    whose fields cancel everywhere; GeometryError for one in other planes; EngineError without the
    engine.

    >>> import polywigner as pw
    >>> pupil = pw.shapes.square(10e-3)
    >>> peak = pw.psf(pupil, (0.0, 0.0), 0.5e-6, 0.1)  # area/(lambda f)^2
    >>> round(float(peak * (0.5e-6 * 0.1) ** 2 / 1e-4), 12)
    1.0
    """
    checked_radiator(source)
    lengths = checked_row(wavelength, "expected a wavelength in m or (k,) of them")
    for length in lengths.tolist():
        checked_length(length, "wavelength")
    distance = checked_length(focal_length, "focal_length")
    warn_of_lens(source, float(lengths.max()), distance)
    system = FirstOrder.fourier(distance)
    share = pupil.shares_of(weights, lengths.size)
    radius = pupil.checked_pupil_radius(source, pupil_radius)
    # exp(2 pi i w |x|^2/a^2) is a lens of power -2 w lambda/a^2, the same for all wavelengths
    bend = 2.0 * pupil.checked_waves(defocus) * float(share @ lengths) / radius / radius
    if bend:
        system = system @ FirstOrder([[1.0, 0.0], [bend, 1.0]])
    total: Any = 0.0
    for part, length in zip(share.tolist(), lengths.tolist(), strict=True):
        total = total + part * field_behind(
            source.at_wavelength(length), points, length, system, None, {},
            squared=True, precision=precision, engine=engine,
        )  # fmt: skip
    return total / pupil.checked_energy(source)
