"""Transfer functions, Strehl ratio and rms wavefront error of pupils."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, IlluminationError, value_text
from polywigner.execution import Differentiable, Engine, Precision
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.geometry.arguments import (
    checked_length,
    checked_number,
    checked_row,
    checked_wavelength,
    only_given,
)
from polywigner.numerics import Floats
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.transforms.aberrated_pupils import (
    TOLERANCE,
    AberratedPupil,
    checked_aberration,
    checked_tolerance,
    converged,
)
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.checked_calls import PhaseSpaceSource, checked_points
from polywigner.transforms.public_transforms import ambiguity, energy_of, lag_marginal
from polywigner.transforms.pupil_gradients import (
    Jets,
    PupilNumbers,
    autocorrelation_jets,
    modulus,
    quotient,
)
from polywigner.transforms.wavefronts import flat_source, is_partly_coherent
from polywigner.transforms.xarray_arguments import takes_xarray

# Smallest accepted ratio of a pupil's energy to the sum of its elements' energies. If the fields
# cancel, the ratio is about 1e-15. At 1e-13, normalised values have hardly any correct digits.
_DARK = 1e-13


@takes_xarray("xi", units="1", long_name="optical transfer function")
def otf(
    source: PhaseSpaceSource | Differentiable,
    xi: ArrayLike,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    aberration: Aberration | None = None,
    wavelength: float | None = None,
    tolerance: float = TOLERANCE,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[np.complexfloating[Any]]:
    """Compute the optical transfer function (OTF) of a pupil, in or out of focus.

    With a defocus of w waves at the radius a, the OTF is ``A(-2 w xi/a^2, xi)/A(0, 0)``, where A is
    the ambiguity function of the pupil in focus and xi is the lag in the pupil. This formula holds
    because the defocus phases of the two shifted copies of the pupil differ by a linear function of
    x. Source: K.-H. Brenner, A. W. Lohmann, J. Ojeda-Castaneda, Opt. Commun. 44, 323 (1983). With
    an ``aberration``, the OTF is integrated numerically over the position slice, in which the
    integrand is smooth (docs/imaging.md, (IM4)).

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        Field in the pupil, with d = 2, or d = 1 for slits. The optical axis passes through the
        origin. A curved wave with the radius of curvature r is equivalent to a defocus of a^2/(2
        wavelength r) waves.
    xi : array_like, shape (..., d)
        Lags in the pupil in m. A lag is the product of the wavelength, the image distance and the
        spatial frequency in the image.
    defocus : float, default 0
        Wavefront aberration w = W20 at ``pupil_radius``, in waves.
    pupil_radius : float, optional
        Radius a in m. The default is the largest distance of a vertex from the origin. For a disc
        of radius R pass R: ``otf(shapes.disc(R), xi, defocus, R)``. The disc is a polygon with n
        vertices and the area of the disc, so its vertices lie outside radius R. With the default
        radius, the error for one wave of defocus is up to 1.3e-3 for n = 64 and 2e-2 for n = 16.
        With the radius R it is up to 1e-5 and 1.4e-3.
    aberration : Aberration, optional
        Path length in m, in addition to the defocus. Not supported for slits.
    wavelength : float, optional
        Wavelength in m, for the aberration and for pistons and tilts of segments. The wavelength is
        required with an aberration.
    tolerance : float, default 1e-10
        Allowed error for aberrated pupils, at least 1e-13. The error is estimated with a second
        quadrature rule.
    precision, engine : str, optional
        See :func:`fourier`. Aberrated pupils are computed in double precision by NumPy.

    Returns
    -------
    ndarray of complex, shape (...)
        Dimensionless values of the OTF, with a value of 1 at zero lag. DataArrays are supported as
        in :func:`fourier`. For a :func:`differentiable` pupil, and for an aberration with Dr.Jit
        coefficients, the result is a Dr.Jit ``Complex2f`` with derivatives and one entry per lag.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range, or the wavelength of an aberration is
        missing.
    IlluminationError
        For an Array whose fields cancel everywhere, and for partly coherent sources, because their
        images are not linear in the field of the object.
    EngineError
        If the engine is not available.

    Warns
    -----
    PolywignerWarning
        If the estimated error of an aberrated pupil exceeds the tolerance.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> float(pw.otf(square, (0.5, 0.0)).real)
    0.75
    """
    plain, numbers = PupilNumbers.of(source, aberration)
    kernel = kernels.kernel_for("ambiguity", flat_source(_checked_pupil(plain)))
    radius = checked_pupil_radius(plain, pupil_radius)
    waves = checked_waves(defocus)
    if execution.is_drjit(xi):
        raise ArgumentError("expected xi to be a NumPy array, got a Dr.Jit array; use xi.numpy()")
    lags = checked_points("xi", xi, kernel.dimension)
    error = checked_tolerance(tolerance)
    jets = _otf_jets(
        plain, numbers, lags, waves / radius**2, aberration, wavelength, error,
        precision=precision, engine=engine,
    )  # fmt: skip
    return numbers.result(jets, lags.shape[:-1], is_complex=True)


def _otf_jets(
    source: Any, numbers: PupilNumbers, lags: Floats, bend: float, aberration: Aberration | None,
    wavelength: float | None, tolerance: float, **how: Any,
) -> Jets:  # fmt: skip
    """Return the OTF at one wavelength and its derivatives, as jets of shape (n, 1 + m).

    ``bend`` is the defocus in waves divided by the squared pupil radius.
    """
    if wavelength is not None:
        source = source.at_wavelength(wavelength)
    if aberration is None and not numbers.arrays:
        # In focus the OTF is the ratio of two areas, which needs no sines.
        if bend == 0.0:
            values = lag_marginal(source, lags, **how)
        else:
            values = ambiguity(source, -2.0 * bend * lags, lags, **how)
        # The array is divided in place, because page faults of a second array would take longer
        # than the kernel.
        values = np.asarray(values)
        values /= checked_energy(source)
        return np.reshape(values + 0j, (-1, 1))
    length = 1.0
    if aberration is not None:
        length = checked_aberration(aberration, wavelength, has_gradients=True)
    pupil = AberratedPupil.of(source, aberration, length, bend)
    jets = autocorrelation_jets(pupil, lags.reshape(-1, 2), numbers, tolerance)
    return quotient(jets, energy_jets(source, pupil, numbers, tolerance))


def energy_jets(
    source: Any, pupil: AberratedPupil | None, numbers: PupilNumbers, tolerance: float
) -> Jets:
    """Return the integral of |u|^2 over a pupil and its derivatives, shape (1, 1 + m).

    ``pupil``: aberrated pupil; None if there is neither an aberration nor a derivative.
    """
    energy = checked_energy(source)
    if pupil is None or not numbers.arrays:
        return np.full((1, 1), energy, np.complex128)
    return autocorrelation_jets(pupil, np.zeros((1, 2)), numbers, tolerance)


@takes_xarray("frequency", units="1", long_name="modulation transfer function")
def mtf(
    source: PhaseSpaceSource | Differentiable,
    frequency: ArrayLike,
    wavelength: ArrayLike,
    focal_length: float | None = None,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    numerical_aperture: float | None = None,
    aberration: Aberration | None = None,
    weights: ArrayLike | None = None,
    pixel: float | ArrayLike = 0.0,
    tolerance: float = TOLERANCE,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[np.float64]:
    """Compute the modulation transfer function (MTF) of a lens in its focal plane.

    The MTF is the modulus of :func:`otf` at a lag that is the product of wavelength, focal length
    and frequency. For several wavelengths, the result is the modulus of the mean OTF, which a
    detector measures.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        Field in the pupil, see :func:`otf`.
    frequency : array_like, shape (..., d)
        Spatial frequencies in the image in cycles per metre. For 50 cycles per mm pass 50e3.
    wavelength : float or array_like, shape (k,)
        Wavelength in m, or k wavelengths of a polychromatic source.
    focal_length : float, optional
        Focal length, or distance of the image from the pupil, in m. Pass either this or
        ``numerical_aperture``.
    defocus : float, default 0
        Wavefront aberration W20 at ``pupil_radius`` in waves of the mean wavelength. The aberration
        in m is the same at all wavelengths.
    pupil_radius : float, optional
        See :func:`otf`.
    numerical_aperture : float, optional
        Sine of the angle of the marginal ray in the image. The focal length is then ``pupil_radius
        / numerical_aperture`` (Abbe's sine condition). For a disc pass its radius as
        ``pupil_radius``.
    aberration : Aberration, optional
        Path length in m, in addition to the defocus, see :func:`otf`. The path length is the same
        at all wavelengths.
    weights : array_like, shape (k,), optional
        Weights of the wavelengths, at least 0. By default all weights are equal.
    pixel : float or array_like, shape (d,), default 0
        Side p of the pixels of a detector in m. The MTF is multiplied by sin(pi f p)/(pi f p) for
        the frequency f along each axis.
    tolerance : float, default 1e-10
        See :func:`otf`.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of float, shape (...)
        Values of the MTF from 0 to 1, with a value of 1 at zero frequency. For DataArrays see
        :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range. For other errors see :func:`otf`.

    Examples
    --------
    >>> import polywigner as pw
    >>> pupil = pw.shapes.square(10e-3)  # cut-off at 10 mm/(0.5 um 100 mm) = 200 cycles/mm
    >>> round(float(pw.mtf(pupil, (50e3, 0.0), 0.5e-6, 0.1)), 3)
    0.75
    """
    lengths, fractions = checked_band(wavelength, weights)
    plain, numbers = PupilNumbers.of(source, aberration)
    radius = checked_pupil_radius(plain, pupil_radius)
    distance = image_distance(focal_length, numerical_aperture, radius)
    dimension = kernels.kernel_for("ambiguity", flat_source(_checked_pupil(plain))).dimension
    cycles = checked_points("frequency", frequency, dimension)
    sides = checked_row(pixel, "expected pixel to be one or two lengths in m")
    if sides.size not in (1, dimension) or not (np.isfinite(sides) & (sides >= 0)).all():
        raise ArgumentError(
            f"expected pixel to be lengths of zero or more in m, got {value_text(pixel)}"
        )
    error = checked_tolerance(tolerance)
    path = checked_waves(defocus) * float(fractions @ lengths)
    detector = np.sinc(np.asarray(cycles) * sides).prod(axis=-1)
    total: Any = 0.0
    for fraction, length in zip(fractions, lengths.tolist(), strict=True):
        jets = _otf_jets(
            plain, numbers, np.asarray(cycles) * (length * distance), path / length / radius**2,
            aberration, length, error, precision=precision, engine=engine,
        )  # fmt: skip
        total = total + fraction * jets
    jets = modulus(total * detector.reshape(-1, 1))
    return numbers.result(jets, detector.shape, is_complex=False)


def _checked_pupil(source: Any) -> PhaseSpaceSource:
    """Return the source; raise IlluminationError if it is partially coherent."""
    pupil: PhaseSpaceSource = source
    if is_partly_coherent(source):
        raise IlluminationError(
            "expected a fully coherent pupil, got a pupil with a coherence width of "
            f"{source.coherence_width:g} m: imaging in partially coherent light has no "
            "transfer function; use the attribute .coherent of the pupil, or "
            "polywigner.lag_marginal for the degree of coherence"
        )
    return pupil


def checked_band(wavelength: Any, weights: Any) -> tuple[Floats, Floats]:
    """Return the wavelengths in m, and their weights divided by the sum of all weights.

    By default all weights are equal. Raises ArgumentError for invalid wavelengths or weights.
    """
    lengths = checked_row(wavelength, "expected a wavelength in m, or wavelengths of shape (k,)")
    for length in lengths.tolist():
        checked_wavelength(length)
    count = lengths.size
    given = (
        np.ones(count)
        if weights is None
        else checked_row(weights, f"expected weights of shape ({count},)")
    )
    finite = given.shape == (count,) and np.isfinite(given).all() and (given >= 0).all()
    if not finite or not given.any():
        raise ArgumentError(
            f"expected {count} weights of zero or more, one for each wavelength and not all "
            f"zero, got {value_text(weights)}"
        )
    return lengths, np.asarray(given / given.sum())


def checked_waves(defocus: float) -> float:
    """Return the defocus in waves. Raises ArgumentError if it is not a finite number."""
    return checked_number(defocus, "defocus", "a finite defocus in waves")


def checked_pupil_radius(source: PhaseSpaceSource, pupil_radius: Any) -> float:
    """Return the radius of a pupil, by default the largest distance of a vertex from the origin."""
    if pupil_radius is not None:
        return checked_length(pupil_radius, "pupil_radius")
    points: list[Floats] = []
    for element in flat_source(source).elements_in_plane:
        is_slits = isinstance(element, Slits)
        points += [element.intervals.reshape(-1, 1)] if is_slits else element.rings
    return max(float(np.linalg.norm(part, axis=1).max()) for part in points)


def image_distance(focal_length: Any, numerical_aperture: Any, radius: float) -> float:
    """Return the distance of the image from the pupil in m.

    Exactly one of ``focal_length`` and ``numerical_aperture`` must be specified, otherwise
    ArgumentError is raised.
    """
    given = {"focal_length": focal_length, "numerical_aperture": numerical_aperture}
    if only_given(given) == "focal_length":
        return checked_length(focal_length, "focal_length")
    meaning = "above 0 and up to 1 (in a medium, divide it by the refractive index)"
    name = "numerical_aperture"
    return radius / checked_number(numerical_aperture, name, meaning, lambda x: 0.0 < x <= 1.0)


def checked_energy(source: PhaseSpaceSource) -> float:
    """Return the integral of |u|^2 over a source. Raises IlluminationError if fields cancel."""
    source = flat_source(source)
    energy = incoherent = energy_of(source)
    if isinstance(source, Array):
        contents = [checked_energy(element) for element in source.elements_in_plane]
        incoherent = float(abs(source.weights) ** 2 @ contents)
    if energy > _DARK * incoherent and energy > 0.0:
        return energy
    raise IlluminationError(
        "expected a pupil that transmits light, got fields that cancel everywhere"
    )


# Allowed error of the rms wavefront error, relative to the largest path length.
_PRECISE = 1e-12
# Lowest and highest frequency for integrals without waves.
_NO_BAND = np.zeros(2), np.zeros(2)


def strehl(
    source: Aperture | Array,
    wavelength: ArrayLike,
    aberration: Aberration | None = None,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    weights: ArrayLike | None = None,
    tolerance: float = TOLERANCE,
) -> float:
    """Compute the Strehl ratio of a pupil.

    The Strehl ratio is the irradiance of :func:`psf` on the axis, relative to the irradiance for a
    pupil with the same |u| and no phase, where u is the field in the pupil. With the path length W
    of the aberration, the ratio is ``|int u exp(2 pi i W/lambda)|^2/(int |u|)^2``. Pistons and
    tilts of segments are aberrations as well.

    Parameters
    ----------
    source : Aperture or Array
        Field in the pupil. The elements must not overlap.
    wavelength : float or array_like, shape (k,)
        Wavelength in m, or k wavelengths of a polychromatic source.
    aberration : Aberration, optional
        Path length in m.
    defocus : float, default 0
        Wavefront aberration W20 at ``pupil_radius`` in waves of the mean wavelength.
    pupil_radius : float, optional
        See :func:`otf`.
    weights : array_like, shape (k,), optional
        Weights of the wavelengths, at least 0. By default all weights are equal.
    tolerance : float, default 1e-10
        Allowed error, at least 1e-13. The error is estimated with a second quadrature rule.

    Returns
    -------
    float
        Strehl ratio from 0 to 1. For several wavelengths it is the weighted mean of the Strehl
        ratios.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, shape or range.
    IlluminationError
        If the fields of an Array cancel everywhere.

    Examples
    --------
    >>> import polywigner as pw
    >>> pupil = pw.shapes.disc(5e-3)
    >>> coma = pw.zernike({8: 550e-9 / 14}, radius=5e-3)  # Marechal's limit
    >>> round(pw.strehl(pupil, 550e-9, coma), 2)
    0.82
    """
    lengths, fractions = checked_band(wavelength, weights)
    checked_energy(source)
    radius, error = checked_pupil_radius(source, pupil_radius), checked_tolerance(tolerance)
    bend = checked_waves(defocus) * float(fractions @ lengths) / radius**2
    ratios = []
    for length in lengths.tolist():
        checked_aberration(aberration, length)
        part = source.at_wavelength(length)
        pupil = AberratedPupil.of(part, aberration, length, bend / length)
        ratios.append(_strehl_ratio(pupil, error))
    return float(fractions @ ratios)


def _strehl_ratio(pupil: AberratedPupil, tolerance: float) -> float:
    """Return the Strehl ratio of a pupil at one wavelength."""

    def evaluate(extra: int) -> NDArray[np.complex128]:
        """Return the integrals of u and of |u|, for a number of additional nodes."""
        total = np.zeros(2, np.complex128)
        for k, weight in enumerate(pupil.weights):
            for x, weights in pupil.rules(k, _NO_BAND, extra, tolerance):
                field = weight * weights * pupil.field(k, x)
                total += field.sum(), np.abs(field).sum()
        return total

    sums = converged(evaluate, 0.5 * tolerance * pupil.content, "the Strehl ratio").values
    return float(abs(sums[0] / sums[1]) ** 2)


def wavefront_error(source: Aperture | Array, aberration: Aberration | None = None) -> float:
    """Compute the rms deviation of the path length over a pupil from its mean value, in metres.

    The averages over the pupil are weighted with |u|^2, where u is the field in the pupil. Pistons
    and tilts of :func:`segmented_pupil` are included; phases of other illuminations are not.

    Parameters
    ----------
    source : Aperture or Array
        Field in the pupil.
    aberration : Aberration, optional
        Path length in m.

    Returns
    -------
    float
        Standard deviation of the path length in m.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, such as a Wavefront.
    IlluminationError
        If the fields of an Array cancel everywhere.

    Examples
    --------
    >>> import polywigner as pw
    >>> hexagon = pw.shapes.regular_polygon(6, 0.5)
    >>> defocus = pw.zernike({4: 10e-9}, radius=0.5, orthogonal_on=hexagon)
    >>> round(pw.wavefront_error(hexagon, defocus) * 1e9, 9)
    10.0
    """
    checked_aberration(aberration, 1.0)
    if isinstance(source, Wavefront):
        raise ArgumentError(
            "expected an Aperture or an Array, got a Wavefront; pass its path as an aberration"
        )
    checked_energy(source)
    pupil = AberratedPupil.of(source, aberration, 1.0, 0.0)
    paths = normal_form(source).paths

    def moments(extra: int) -> tuple[Floats, Floats]:
        """Return the path lengths at quadrature nodes, and the weights of the nodes times |u|^2."""
        lengths, weights = [], []
        for k, amplitude in enumerate(pupil.weights):
            for x, areas in pupil.rules(k, _NO_BAND, 1 + extra, _PRECISE):
                weights.append((areas * np.abs(amplitude * pupil.field(k, x)) ** 2).ravel())
                length = pupil.cycles(x)
                if paths is not None:
                    length = length + paths.wavelength * (paths.cycles[k] + x @ paths.slopes[k])
                lengths.append(length.ravel())
        return np.concatenate(lengths), np.concatenate(weights)

    def evaluate(extra: int) -> Any:
        """Return the weighted standard deviation of the path length in m."""
        lengths, weights = moments(extra)
        mean = weights @ lengths / weights.sum()
        return np.sqrt(weights @ np.square(lengths - mean) / weights.sum())

    largest = float(np.abs(moments(0)[0]).max()) or 1.0
    return float(converged(evaluate, _PRECISE * largest, "the wavefront error").values)
