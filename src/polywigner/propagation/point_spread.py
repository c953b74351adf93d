"""Point spread functions of lenses and their pupils, with and without aberrations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.execution import Differentiable, Engine, checked_engine
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import Points
from polywigner.optics import FirstOrder
from polywigner.propagation.aberrated_fields import spectrum_jets
from polywigner.propagation.collins import checked_points_behind, field_behind
from polywigner.radiometry.directions import checked_radiator
from polywigner.source import Array
from polywigner.transforms import pupil
from polywigner.transforms.aberrated_pupils import (
    TOLERANCE,
    AberratedPupil,
    checked_aberration,
    checked_tolerance,
)
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.pupil_gradients import (
    PupilNumbers,
    quotient,
    squared_modulus,
)
from polywigner.transforms.xarray_arguments import takes_xarray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@takes_xarray("points", units="m-2", long_name="point spread function")
def psf(
    source: Aperture | Array | Differentiable,
    points: Points,
    wavelength: ArrayLike,
    focal_length: float | None = None,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    numerical_aperture: float | None = None,
    aberration: Aberration | None = None,
    weights: ArrayLike | None = None,
    tolerance: float = TOLERANCE,
    engine: Engine = "auto",
) -> Floats:
    """Return the point spread function of a lens whose pupil is the source.

    The point spread function is the irradiance in the focal plane due to a star on the axis,
    divided by the power of the star in the pupil. Its integral over the plane is 1, and its Fourier
    transform is :func:`otf`. For several wavelengths it is the weighted mean, which a broadband
    detector measures. For other first-order systems use :func:`irradiance` with ``through``.

    Parameters
    ----------
    source : Aperture or Array
        Field in the pupil, in the plane z = 0. The optical axis passes through the origin.
    points : array_like, shape (..., 2)
        Points in the image in m.
    wavelength : float or array_like, shape (k,)
        Wavelength in m, or wavelengths of a polychromatic source.
    focal_length : float, optional
        Focal length, or distance of the image from the pupil, in m. This or ``numerical_aperture``.
    defocus : float, default 0
        Wavefront aberration W20 at ``pupil_radius``, in waves of the mean wavelength; the
        aberration in m is the same at all wavelengths.
    pupil_radius : float, optional
        See :func:`otf`.
    numerical_aperture : float, optional
        Sine of the marginal ray's angle in the image, from the ``pupil_radius`` a: by Abbe's sine
        condition the focal length is a/numerical_aperture. For a disc give its radius.
    aberration : Aberration, optional
        Path length in m, the same at all wavelengths, in addition to the defocus. The field is a
        sum over nodes in the pupil (docs/imaging.md, (IM3)).
    weights : array_like, shape (k,), optional
        Weights of the wavelengths, zero or more; equal by default.
    tolerance : float, default 1e-10
        Allowed error of the field of aberrated pupils over the field of the source in phase,
        estimated by a second rule; at least 1e-13.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`fourier`; aberrated pupils use NumPy.

    Returns
    -------
    ndarray of float64, shape (...)
        Values in 1/m^2, at least 0. An ``xarray.DataArray`` of points gives a DataArray. A Dr.Jit
        ``Float`` (n,) with derivatives for a :func:`differentiable` pupil, and for an aberration
        with Dr.Jit coefficients.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    IlluminationError
        If the fields of an Array cancel everywhere.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine is not available.

    Warns
    -----
    PolywignerWarning
        If the estimated error of an aberrated pupil exceeds the tolerance.

    Examples
    --------
    >>> import polywigner as pw
    >>> pupil = pw.shapes.square(10e-3)
    >>> peak = pw.psf(pupil, (0.0, 0.0), 0.5e-6, 0.1)  # area/(lambda f)^2
    >>> round(float(peak * (0.5e-6 * 0.1) ** 2 / 1e-4), 12)
    1.0
    """
    checked_engine(engine)
    plain, numbers = PupilNumbers.of(source, aberration)
    checked_radiator(plain)
    lengths, fractions = pupil.checked_band(wavelength, weights)
    allowed = checked_tolerance(tolerance)
    radius = pupil.checked_pupil_radius(plain, pupil_radius)
    distance = pupil.image_distance(focal_length, numerical_aperture, radius)
    # The phase exp(2 pi i w |x|^2/a^2) is that of a lens of power -2 w lambda/a^2, which is the
    # same for all wavelengths.
    bend = 2.0 * pupil.checked_waves(defocus) * float(fractions @ lengths) / radius / radius
    system = FirstOrder.fourier(distance)
    if bend:
        system = system @ FirstOrder([[1.0, 0.0], [bend, 1.0]])
    image_points = checked_points_behind(points)
    aberrated: AberratedPupil | None = None
    total: Any = 0.0
    for fraction, length in zip(fractions.tolist(), lengths.tolist(), strict=True):
        part = plain.at_wavelength(length)
        if aberration is None and not numbers.arrays:
            field, _ = field_behind(part, points, length, system, None, {}, engine)
            jets = field.reshape(-1, 1)
        else:
            scale = checked_aberration(aberration, length, has_gradients=True) * distance
            aberrated = AberratedPupil.of(part, aberration, length, bend / (2.0 * length))
            nu = image_points.reshape(-1, 2) / scale
            jets = spectrum_jets(aberrated, nu, numbers, allowed) / scale
        total = total + fraction * squared_modulus(jets)
    energy = pupil.energy_jets(plain, aberrated, numbers, allowed)
    return numbers.result(quotient(total, energy), image_points.shape[:-1], is_complex=False)
