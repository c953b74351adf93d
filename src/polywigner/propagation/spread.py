"""Apertures as pupils: the light of a point in the image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import Points, checked_length, checked_row, warn_of_lens
from polywigner.illumination import Array
from polywigner.optics import FirstOrder
from polywigner.propagation.irradiances import irradiance
from polywigner.propagation.places import LARGEST
from polywigner.radiometry.directions import checked_radiator
from polywigner.transforms.pupil import (
    checked_energy,
    checked_pupil_radius,
    checked_waves,
    shares_of,
)
from polywigner.transforms.xarray_arguments import takes_xarray


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
    if distance > LARGEST:
        raise ArgumentError(f"expected focal_length of at most {LARGEST:g} m, got {distance:g}")
    warn_of_lens(source, float(lengths.max()), distance)
    system = FirstOrder.fourier(distance)
    share = shares_of(weights, lengths.size)
    radius = checked_pupil_radius(source, pupil_radius)
    # exp(2 pi i w |x|^2/a^2) is a lens of power -2 w lambda/a^2, the same for all wavelengths
    bend = 2.0 * checked_waves(defocus) * float(share @ lengths) / radius / radius
    if not np.isfinite(bend):
        raise ArgumentError(
            f"expected a defocus of fewer waves, got {defocus!r} at a pupil_radius of {radius:g}"
        )
    if bend:
        system = system @ FirstOrder([[1.0, 0.0], [bend, 1.0]])
    how: dict[str, Any] = {"precision": precision, "engine": engine, "through": system}
    total: Any = 0.0
    for part, length in zip(share.tolist(), lengths.tolist(), strict=True):
        total = total + part * irradiance(source, points, length, **how)
    return total / checked_energy(source)
