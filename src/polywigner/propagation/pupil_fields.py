"""Far fields and Fresnel fields of pupils with aberrations, and point spread functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polywigner.execution import Differentiable, Engine, checked_engine
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import Points, check_most
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.optics import FirstOrder
from polywigner.propagation.collins import FrequencyLattice, checked_points_behind, field_behind
from polywigner.radiometry.directions import checked_radiator
from polywigner.source import Array
from polywigner.transforms import pupil
from polywigner.transforms.aberrated_pupils import (
    TOLERANCE,
    AberratedPupil,
    Converged,
    checked_aberration,
    checked_tolerance,
    converged,
)
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.pupil_gradients import (
    PupilNumbers,
    edges_of,
    quotient,
    squared_modulus,
)
from polywigner.transforms.xarray_arguments import takes_xarray

# Largest numbers of pairs (node, point) per block and per call. A block takes some tens of
# megabytes, and about 1e9 pairs take a minute.
_BLOCK, _MOST = 1 << 20, 2e10
# Number of points at which the error is estimated.
_CHECKED = 32


def aberrated_spectrum(
    pupil: AberratedPupil, nu: Floats, tolerance: float, centre: Any = (0.0, 0.0)
) -> Converged:
    """Return the Fourier transform of an aberrated pupil field at frequencies nu (n, 2) in 1/m.

    The integral is ``int u exp(2 pi i W/wavelength - 2 pi i nu.(x - centre)) dx``. The path length
    W includes the defocus and the curvature. ``tolerance`` is relative to the integral of |u|.
    """
    band = band_of(nu)
    some = np.unique(np.linspace(0, max(len(nu) - 1, 0), _CHECKED).astype(int))[: len(nu)]

    def evaluate(extra: int, points: Floats) -> Complex:
        """Return the transform at ``points`` with ``extra`` additional nodes."""
        sums = element_sums(pupil, points, band, extra, tolerance, centre=centre)
        weighted = (weight * row for weight, (row,) in zip(pupil.weights, sums, strict=True))
        return np.asarray(sum(weighted))

    checked = converged(
        lambda extra: evaluate(extra, nu[some]), tolerance * pupil.content, "the pupil's field"
    )
    return checked._replace(values=evaluate(checked.extra, nu))


def band_of(nu: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and highest frequencies along each axis of nu (n, 2)."""
    if not len(nu):
        return np.zeros(2), np.zeros(2)
    return nu.min(axis=0), nu.max(axis=0)


def element_sums(
    pupil: AberratedPupil,
    nu: Floats,
    band: tuple[Floats, Floats],
    extra: int,
    error: float,
    factors: Callable[[Floats, Floats], Floats] | None = None,
    centre: Any = (0.0, 0.0),
) -> Iterator[Complex]:
    """Yield the Fourier transform (k, n) of each unweighted element times k factors.

    The integral is ``int factor u exp(-2 pi i nu.(x - centre)) dx`` for the aberrated field u.
    ``factors(x, y)`` returns the factors (k, ...), by default 1. ``error`` is relative to the
    integral of the modulus.
    """
    lattice = FrequencyLattice(nu)
    for number in range(len(pupil.elements)):
        total: Any = 0.0
        for x, weights in pupil.rules(number, band, extra, error):
            field = (weights * pupil.field(number, x))[None]
            if factors is not None:
                field = field * factors(x[..., 0], x[..., 1])
            total = total + np.array([_lattice_sum(lattice, x - centre, row) for row in field])
        yield total


def _lattice_sum(lattice: FrequencyLattice, nodes: Floats, field: Complex) -> Complex:
    """Return the sums (n,) of ``field exp(-2 pi i nu.x)`` over all nodes, for all frequencies nu.

    ``nodes`` (k, m, 2) in m form k rows with constant x. ``field`` (k, m) contains the quadrature
    weights. Raises ArgumentError for too many products of a node and a frequency.
    """
    # On a grid, all frequencies along x use the same sums over y.
    waves = field.size * (lattice.work if lattice.index is None else len(lattice.axes[1]))
    things = "products of a quadrature node of the aberrated pupil and a point"
    check_most(waves, _MOST, things, "use fewer points, or a grid along x and y")
    if lattice.index is None:
        return lattice.fourier_sum(nodes.reshape(-1, 2), field.ravel())
    x, y = nodes[:, 0, 0], nodes[..., 1]
    total: Any = 0.0
    for some in index_blocks(len(x), _BLOCK // max(1, y.shape[1] * len(lattice.axes[1]))):
        along_y = waves_of_cycles(-y[some, :, None] * lattice.axes[1])
        sums = (field[some, None, :] @ along_y)[:, 0]
        total = total + waves_of_cycles(-np.outer(lattice.axes[0], x[some])) @ sums
    return np.asarray(total[lattice.index])


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Derivatives of an aberrated pupil's Fourier transform at n frequencies."""

    pupil: AberratedPupil
    nu: Floats
    extra: int
    error: float

    def _sums(self, factors: Callable[[Floats, Floats], Floats] | None = None) -> Iterator[Complex]:
        """Yield Fourier transforms of unweighted elements times factors, as in `element_sums`."""
        band = band_of(self.nu)
        return element_sums(self.pupil, self.nu, band, self.extra, self.error, factors)

    def vertices(self) -> Complex:
        """Return the derivatives (n, vertices, 2) of the transform with respect to all vertices."""
        pupil, parts = self.pupil, []
        largest = np.abs(np.stack(band_of(self.nu))).max(axis=0)
        for k, edges in enumerate(edges_of(pupil)):
            every, ones = np.arange(len(edges.begin)), np.ones(len(edges.begin))
            band = largest + np.abs(pupil.elements[k].frequencies).max(axis=0)
            x, weights = edges.rule(
                (every, 0.0 * ones, ones), pupil.slopes, band, self.error, self.extra
            )
            field = pupil.weights[k] * pupil.field(k, x)[..., None] * weights
            waves = np.exp(-2j * np.pi * (x @ self.nu.T)).swapaxes(1, 2)
            parts.append(edges.at_vertices(every, (waves @ field).swapaxes(0, 1)))
        return np.concatenate(parts, axis=1)

    def weights(self) -> tuple[Complex, Complex]:
        """Return the derivatives (n, elements) with respect to weights and to their conjugates.

        The derivatives with respect to the conjugates are zero.
        """
        by_weight = np.stack([row for (row,) in self._sums()], axis=1)
        return by_weight, np.zeros_like(by_weight)

    def coefficients(self) -> Complex:
        """Return the derivatives (n, modes) with respect to the coefficients of the aberration."""
        path = self.pupil.aberration
        assert path is not None
        sums = self._sums(path.modes)
        total = sum(weight * rows.T for weight, rows in zip(self.pupil.weights, sums, strict=True))
        return np.asarray(total) * (2j * np.pi / self.pupil.wavelength)


def aberrated_fresnel_field(
    source: Any, aberration: Aberration, points: Floats, wavelength: float, tolerance: float
) -> tuple[Complex, Floats]:
    """Return the Fresnel field of an aberrated pupil at points (n, 3), and its error, both (n,).

    The field at (X, z) is ``exp(ikz)/(i L z) int u(x) exp(2 pi i W/L + i pi |X - x|^2/(L z)) dx``,
    with the wavelength L and the path length W. The error is absolute; ``tolerance`` is relative to
    the integral of |u|, as in `aberrated_spectrum`.
    """
    field, errors = np.empty(len(points), np.complex128), np.empty(len(points))
    for z in np.unique(points[:, 2]).tolist():
        some = points[:, 2] == z
        scale = wavelength * z
        pupil = AberratedPupil.of(source, aberration, wavelength, 0.5 / scale)
        nu = points[some, :2] / scale
        values, error, _ = aberrated_spectrum(pupil, nu, tolerance)
        cycles = math.fmod(z, wavelength) / wavelength
        cycles = cycles + 0.5 * np.square(points[some, :2]).sum(axis=1) / scale
        field[some] = waves_of_cycles(cycles) * values / (1j * scale)
        errors[some] = error / scale
    return field, errors


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
    divided by the power that the pupil receives from the star. The integral of the point spread
    function over the plane is 1, and its Fourier transform is :func:`otf`. For several wavelengths
    it is the weighted mean of the point spread functions, which a broadband detector measures. For
    other first-order systems use :func:`irradiance` with ``through``.

    Parameters
    ----------
    source : Aperture or Array
        Field in the pupil, in the plane z = 0. The optical axis passes through the origin.
    points : array_like, shape (..., 2)
        Points in the image plane in m.
    wavelength : float or array_like, shape (k,)
        Wavelength in m, or wavelengths of a polychromatic source.
    focal_length : float, optional
        Focal length, or distance of the image from the pupil, in m. Either this or
        ``numerical_aperture`` is required.
    defocus : float, default 0
        Defocus coefficient W20 of the wavefront aberration at ``pupil_radius``, in units of the
        mean wavelength. The aberration in m is the same at all wavelengths.
    pupil_radius : float, optional
        See :func:`otf`.
    numerical_aperture : float, optional
        Sine of the angle of the marginal ray, which starts at ``pupil_radius``, in the image. By
        Abbe's sine condition the focal length is pupil_radius/numerical_aperture. For a disc,
        specify its radius as ``pupil_radius``.
    aberration : Aberration, optional
        Path length in m, the same at all wavelengths, in addition to the defocus. The field is a
        sum over nodes in the pupil (docs/imaging.md, (IM3)).
    weights : array_like, shape (k,), optional
        Weights of the wavelengths, each zero or more. By default all weights are equal.
    tolerance : float, default 1e-10
        Allowed error of the field of an aberrated pupil, as a fraction of the field with all parts
        of the pupil in phase; at least 1e-13. The error is estimated by a second quadrature rule.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`fourier`; aberrated pupils use NumPy.

    Returns
    -------
    ndarray of float64, shape (...)
        Values in 1/m^2, zero or more. If ``points`` is an ``xarray.DataArray``, the result is a
        DataArray. A :func:`differentiable` pupil, or an aberration with Dr.Jit coefficients, gives
        a Dr.Jit ``Float`` with derivatives.

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
    # A lens of power -2 w lambda/a^2 has the phase exp(2 pi i w |x|^2/a^2) at all wavelengths.
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
            values, _, extra = aberrated_spectrum(aberrated, nu, allowed)
            jets = numbers.joined(values, _Derivatives(aberrated, nu, extra, allowed)) / scale
        total = total + fraction * squared_modulus(jets)
    energy = pupil.energy_jets(plain, aberrated, numbers, allowed)
    return numbers.result(quotient(total, energy), image_points.shape[:-1], is_complex=False)
