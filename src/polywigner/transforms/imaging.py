"""Images in partially coherent light, computed from the transmission cross coefficient.

A condenser illuminates an object with plane waves, one for each point x of its pupil (Koehler
illumination). A spatial frequency of the object shifts x by a lag xi in the imaging pupil. The
transmission cross coefficient is the integral of S(x) P(x + xi_1) conj P(x + xi_2) over x, equation
(IM1), with the irradiance S in the condenser and the field P in the pupil. The coefficient is the
area, or the Fourier transform, of the intersection of three polygons.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, GeometryError
from polywigner.execution import NumpyOperations
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import (
    check_most,
    checked_array,
    checked_length,
    checked_type,
    checked_wavelength,
    complex_array,
    finite_array,
    takes_frequency,
)
from polywigner.geometry.hidden_parts import edges_around
from polywigner.geometry.parts import shifted
from polywigner.numerics import Complex, Floats, Indices, index_blocks, sums_by_index
from polywigner.numerics.phases import simplex_plane_wave
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.transforms.aberrated_pupils import (
    checked_aberration,
    converged,
    region_integrals,
)
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.checked_calls import broadcast_shape
from polywigner.transforms.public_transforms import fourier
from polywigner.transforms.pupil import checked_energy, checked_pupil_radius, checked_waves

# Largest number of polygon intersections. The computation of that many intersections takes some
# minutes and 2 GB of memory.
_MOST = 1 << 20
# Number of plane-wave values per block, which takes 64 MB.
_BLOCK = 1 << 22
# Number of pairs of diffraction orders per block.
_PAIRS = 1 << 15
# Relative size below which diffraction orders and image contributions are treated as rounding
# errors.
_ROUNDING = 1e-15
# Allowed error of integrals over aberrated pupils, relative to the power of the condenser.
_PRECISE = 1e-9
# Overlap of two elements of a mask, relative to an element's area, below which the overlap is
# treated as a rounding error.
_OVERLAP = 1e-9


class _Term(NamedTuple):
    """A polygon with the plane wave ``weight`` exp(2 pi i kappa.x)."""

    polygon: Any
    weight: complex
    kappa: Floats


def transmission_cross_coefficient(
    pupil: Aperture | Array,
    condenser: Aperture | Array,
    xi_1: ArrayLike,
    xi_2: ArrayLike,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
) -> Complex:
    """Compute the transmission cross coefficient of an imaging system for pairs of lags.

    The coefficient of the lags xi_1 and xi_2 is ``T = int S(x) P(x + xi_1) conj P(x + xi_2) dx /
    int S dx``, where P is the field in the pupil and S is the irradiance in the condenser, imaged
    into the pupil. The coefficient is computed in closed form from intersections of polygons, in or
    out of focus (docs/imaging.md, (IM1)). Source: H. H. Hopkins, Proc. R. Soc. A 217, 408 (1953).

    Parameters
    ----------
    pupil : Aperture or Array
        Apertures in the plane z = 0 with amplitudes and waves, such as pistons and tilts of
        segments. The optical axis passes through the origin.
    condenser : Aperture or Array
        Apertures of the condenser, in the same form as ``pupil``. The elements are incoherent with
        one another.
    xi_1, xi_2 : array_like, shape (..., 2)
        Lags in the pupil in m, which broadcast. A lag is the product of the wavelength, the
        distance and a frequency of the object.
    defocus : float, default 0
        Wavefront aberration W20 at ``pupil_radius`` in waves, as in :func:`otf`.
    pupil_radius : float, optional
        Radius of the pupil in m. The default is the largest distance of a vertex of the pupil from
        the origin.

    Returns
    -------
    ndarray of complex, shape (...)
        Values of T. If both lags are equal, T is the transmitted fraction of the power. If the
        condenser is a point, T is P conj P. If the condenser is much wider than the pupil, T is the
        result of :func:`otf` times the ratio of their areas.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range, or there are too many pairs of lags.
    GeometryError
        If an Array has elements outside the plane z = 0.
    IlluminationError
        If the fields cancel.

    Examples
    --------
    >>> import polywigner as pw
    >>> pupil, condenser = pw.shapes.square(2.0), pw.shapes.square(1.0)
    >>> complex(pw.transmission_cross_coefficient(pupil, condenser, (0.75, 0.0), (-0.75, 0.0)))
    (0.5+0j)
    """
    system = _System.of(pupil, condenser, defocus, pupil_radius)
    both = [_plane_points(name, xi) for name, xi in (("xi_1", xi_1), ("xi_2", xi_2))]
    shape = broadcast_shape(both)
    pairs = [np.broadcast_to(xi, (*shape, 2)).reshape(-1, 2) for xi in both]
    things = "pairs of lags for this pupil and condenser"
    check_most(len(pairs[0]), _MOST // system.size, things, "pass fewer pairs at once")
    lags, number = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    values = system.coefficients(lags, *number.reshape(2, -1))
    return values.reshape(shape)[()]


@takes_frequency
def partially_coherent_image(
    mask: Aperture | Array,
    period: ArrayLike,
    pupil: Aperture | Array,
    condenser: Aperture | Array,
    points: ArrayLike,
    wavelength: float,
    distance: float,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    aberration: Aberration | None = None,
    transmission: complex = 1.0,
    background: complex = 0.0,
) -> Floats:
    """Compute the image of a periodic mask in partly coherent light.

    The amplitudes of the diffraction orders are the closed-form Fourier transform of the mask at
    the frequencies of the lattice. The image is a sum over pairs of orders, each of which is
    multiplied by its :func:`transmission_cross_coefficient` (docs/imaging.md, (IM2)). For a mask
    that is not periodic, choose a period much longer than the resolution.

    Parameters
    ----------
    mask : Aperture or Array
        Apertures that do not overlap. The weights are the transmitted amplitudes.
    period : array_like, shape (2,) or (2, 2)
        Periods along x and y in m, or two vectors of the lattice as rows. The copies of the mask
        must not overlap.
    pupil, condenser, defocus, pupil_radius
        See :func:`transmission_cross_coefficient`. A condenser of half the pupil's size has the
        coherence factor 0.5.
    points : array_like, shape (..., 2)
        Points in the image in m, with the scale and the orientation of the object. The image behind
        the lens is inverted, so its axes have the opposite directions.
    wavelength : float
        Wavelength in m.
    distance : float
        Distance of the object from the pupil, or the focal length on the object side of the pupil,
        in m. The frequency f of the object has the position ``wavelength * distance * f`` in the
        pupil.
    aberration : Aberration, optional
        Path length in m in the pupil, in addition to the defocus. Integrals over the aberrated
        pupil are computed by Gauss rules with an error of 1e-9.
    transmission : complex, default 1
        Amplitude that the elements transmit, which is multiplied by their weights. 0 is opaque.
    background : complex, default 0
        Amplitude that the mask transmits outside its elements. 0 is opaque, 1 is clear, and -0.245
        is a phase-shifting film that transmits 6 % of the power.

    Returns
    -------
    ndarray of float, shape (...)
        Irradiance, at least 0. The value is relative to the irradiance without a mask, with all
        light transmitted by the pupil.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, shape or range, and for too many transmitted orders. The
        limit is about 1,400 orders, and lower with several waves.
    GeometryError
        If elements of the mask overlap each other or the copies of the mask, and for arrays with
        elements outside the plane z = 0.
    IlluminationError
        If the fields cancel.

    Examples
    --------
    >>> import polywigner as pw
    >>> lines = pw.shapes.rectangle(1e-6, 2e-6)  # 1 um wide, every 2 um
    >>> pupil, condenser = pw.shapes.square(10e-3), pw.shapes.square(5e-3)
    >>> light = pw.partially_coherent_image(
    ...     lines, (2e-6, 2e-6), pupil, condenser, [(0, 0), (1e-6, 0)], 0.5e-6, 10e-3
    ... )
    >>> light.round(3)
    array([1.292, 0.019])
    """
    length = checked_wavelength(wavelength)
    system = _System.of(pupil, condenser, defocus, pupil_radius)
    if aberration is not None:
        checked_aberration(aberration, length)
        system = replace(system, aberration=aberration * (1.0 / length))
    scale = length * checked_length(distance, "distance")
    lattice = _checked_lattice(period)
    cell = abs(np.linalg.det(lattice))
    _check_overlaps(mask, lattice)
    orders = _candidate_frequencies(system, lattice, scale)
    amplitudes = _order_amplitudes(mask, orders, cell, transmission, background)
    used = np.abs(amplitudes) > _ROUNDING * np.abs(amplitudes).max(initial=0.0)
    used[used] = _passes(system, scale * orders[used])
    orders, amplitudes = orders[used], amplitudes[used]
    image_points = _plane_points("points", points)
    if not len(orders):
        return np.zeros(image_points.shape[:-1])[()]
    matrix = amplitudes[:, None] * amplitudes.conj() * system.matrix(scale * orders)
    parts, vectors = np.linalg.eigh(matrix)
    some = parts > _ROUNDING * parts[-1]
    modes = vectors[:, some] * np.sqrt(parts[some])
    flat = image_points.reshape(-1, 2)
    image = np.empty(len(flat))
    for block in index_blocks(len(flat), _BLOCK // len(orders)):
        waves = np.exp(2j * np.pi * (flat[block] @ orders.T))
        image[block] = np.square(np.abs(waves @ modes)).sum(axis=1)
    return image.reshape(image_points.shape[:-1])[()]


@dataclass(frozen=True, eq=False)
class _System:
    pupil: list[_Term]
    condenser: list[_Term]
    slope: float
    """Defocus in waves, divided by the square of the pupil radius, in 1/m^2."""
    power: float
    aberration: Aberration | None = None
    """Path length of the aberration in cycles."""

    @classmethod
    def of(cls, pupil: Any, condenser: Any, defocus: Any, pupil_radius: Any) -> _System:
        """Return an imaging system with checked arguments. The defocus is in waves.

        Raises ArgumentError for invalid arguments and for a condenser without power.
        """
        for name, source in (("pupil", pupil), ("condenser", condenser)):
            if not isinstance(source, Aperture | Array) or getattr(source, "dimension", 2) == 1:
                raise ArgumentError(
                    f"expected {name} to be an Aperture, or an Array of apertures, got "
                    f"{type(source).__name__}"
                )
        radius = checked_pupil_radius(pupil, pupil_radius)
        checked_energy(pupil)
        light = [
            _Term(a.polygon, a.weight * b.weight.conjugate(), a.kappa - b.kappa)
            for element in _waves_of_elements(condenser)
            for a in element
            for b in element
        ]
        power = sum(_polygon_transforms([t.polygon], [-t.kappa])[0] * t.weight for t in light).real
        if not power > 0.0:
            raise ArgumentError("expected a condenser that emits light, got weights of zero")
        waves = [term for element in _waves_of_elements(pupil) for term in element]
        return cls(waves, light, checked_waves(defocus) / radius / radius, float(power))

    @property
    def size(self) -> int:
        """Number of intersections of polygons for each pair of lags."""
        return len(self.condenser) * len(self.pupil) ** 2

    def coefficients(self, lags: Floats, first: Indices, second: Indices) -> Complex:
        """Return the transmission cross coefficients (n,) of pairs of lags.

        ``first`` and ``second`` (n,) contain the indices of both lags of a pair in ``lags`` (m, 2).
        """
        total = np.zeros(len(first), np.complex128)
        nu = 2.0 * self.slope * (lags[second] - lags[first])
        for light in self.condenser:
            regions = [_passing_parts(light.polygon, term.polygon, lags) for term in self.pupil]
            for a, one in zip(self.pupil, regions, strict=True):
                for b, other in zip(self.pupil, regions, strict=True):
                    both = shapely.intersection(one[first], other[second])
                    waves = np.exp(2j * np.pi * (lags[first] @ a.kappa - lags[second] @ b.kappa))
                    weight = light.weight * a.weight * b.weight.conjugate()
                    kappa = a.kappa - b.kappa + light.kappa
                    values = self._integrals(both, nu - kappa, lags[first], lags[second])
                    total += weight * waves * values
        chirp = np.exp(2j * np.pi * self.slope * np.square(lags).sum(axis=1))
        return total * chirp[first] * chirp[second].conj() / self.power

    def _integrals(self, polygons: Any, nu: Floats, ahead: Floats, behind: Floats) -> Complex:
        """Return integrals (n,) of exp(-2 pi i nu.x + 2 pi i [W(x + ahead) - W(x + behind)]).

        Each integral extends over one of the n polygons. W is the path length of the aberration in
        cycles, without the defocus.
        """
        path = self.aberration
        if path is None:
            return _polygon_transforms(polygons, nu)

        def slopes(x: Floats, region: Indices) -> Floats:
            """Return the phase gradient of the integrand at points, in cycles per metre."""
            first, second = x + ahead[region, None], x + behind[region, None]
            bend = path.slopes(*np.moveaxis(first, -1, 0)) - path.slopes(
                *np.moveaxis(second, -1, 0)
            )
            return np.asarray(bend - nu[region, None])

        def integrand(x: Floats, region: Indices) -> Complex:
            """Return the values of the integrand at points, shape (1, n)."""
            cycles = path(*(x + ahead[region]).T) - path(*(x + behind[region]).T)
            cycles -= np.einsum("ij,ij->i", nu[region], x)
            return np.exp(2j * np.pi * cycles)[None]

        def evaluate(extra: int) -> Complex:
            """Return the integrals for a number of additional nodes."""
            return region_integrals(polygons, slopes, integrand, np.zeros(2), extra, _PRECISE)[0]

        return converged(evaluate, _PRECISE * self.power, "the image").values

    def matrix(self, lags: Floats) -> Complex:
        """Return the transmission cross coefficients (n, n) of all pairs of n lags."""
        _check_orders(len(lags), self.size)
        first, second = np.triu_indices(len(lags))
        above = np.zeros((len(lags), len(lags)), np.complex128)
        with with_progress("pairs of orders", index_blocks(len(first), _PAIRS)) as remaining:
            for some in remaining:
                pairs = first[some], second[some]
                above[pairs] = self.coefficients(lags, *pairs)
        return above + np.triu(above, 1).conj().T


def _waves_of_elements(source: Aperture | Array) -> list[list[_Term]]:
    """Return a list of plane waves on polygons for each element of a source."""
    elements = []
    for element in normal_form(source).in_plane.elements:
        polygon, weight = element.shape.polygons, element.weight
        waves = zip(element.amplitudes.tolist(), element.frequencies, strict=True)
        elements.append([_Term(polygon, complex(weight * c), kappa) for c, kappa in waves])
    return elements


def _passing_parts(light: Any, pupil: Any, lags: Floats) -> NDArray[Any]:
    """Return the part of a condenser polygon at which x + lag lies in a pupil polygon.

    The result has one part for each lag.
    """
    return shapely.intersection(shifted(np.full(len(lags), pupil, object), -lags), light)


def _polygon_transforms(polygons: Any, frequencies: Any) -> Complex:
    """Return the Fourier transform of each polygon at its own frequency, equation (F2)."""
    nu = np.asarray(frequencies, np.float64)
    shapes = np.asarray(polygons, object)
    of, begin, end = edges_around(shapes)
    # A polygon may be far smaller than its distance from the origin, so triangles start at a corner
    # of its bounding box.
    origin = shapely.bounds(shapes)[of, :2]
    begin, end = begin - origin, end - origin
    phases = [np.einsum("ij,ij->i", nu[of], corner) for corner in (begin, end, origin)]
    cosine, sine = simplex_plane_wave(NumpyOperations(), *phases[:2])
    cross = begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0]
    terms = cross * (cosine - 1j * sine) * np.exp(-2j * np.pi * phases[2])
    return sums_by_index(of, terms, len(nu))


def _candidate_frequencies(system: _System, lattice: Floats, scale: float) -> Floats:
    """Return the frequencies of the diffraction orders that may pass the pupil, in 1/m.

    ``scale``: wavelength times distance in m^2.
    """
    reciprocal = np.linalg.inv(lattice).T
    pupil, light = (
        np.array(shapely.total_bounds([t.polygon for t in terms])).reshape(2, 2)
        for terms in (system.pupil, system.condenser)
    )
    low, high = (pupil[0] - light[1]) / scale, (pupil[1] - light[0]) / scale
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    numbers = corners @ lattice.T
    first, last = np.floor(numbers.min(axis=0)), np.ceil(numbers.max(axis=0))
    count = math.prod((last - first + 1).tolist())
    if count > _MOST:
        _check_orders(count, system.size)
    grid = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)))
    return np.asarray(np.stack([g.ravel() for g in grid], axis=-1) @ reciprocal)


def _passes(system: _System, lags: Floats) -> NDArray[np.bool_]:
    """Return whether light from any point of the condenser passes the pupil, for each lag."""
    passes = np.zeros(len(lags), bool)
    for term in system.condenser:
        for pupil in system.pupil:
            others = np.flatnonzero(~passes)
            common = _passing_parts(term.polygon, pupil.polygon, lags[others])
            passes[others] = shapely.area(common) > 0.0
    return passes


def _check_orders(count: float, size: int) -> None:
    """Raise ArgumentError if the pairs of ``count`` orders need too many intersections."""
    remedy = "use a smaller condenser or pupil, or a shorter period"
    things = "diffraction orders of the mask that pass the pupil"
    check_most(count, int(math.sqrt(2.0 * _MOST / size)), things, remedy)


def _check_overlaps(mask: Aperture | Array, lattice: Floats) -> None:
    """Raise GeometryError if elements of a periodic mask overlap, within or between periods."""
    checked_type(mask, "mask to be an Aperture, or an Array of apertures", Aperture, Array)
    elements = np.array([element.polygons for element in mask.elements_in_plane], object)
    low, high = np.reshape(shapely.total_bounds(elements), (2, 2))
    size = high - low
    corners = np.array([size, size * [1, -1]])
    most = np.ceil(abs(corners @ np.linalg.inv(lattice)).max(axis=0)).astype(int)
    numbers = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in most)), axis=-1).reshape(-1, 2)
    shifts = numbers @ lattice
    shifts = shifts[(abs(shifts) < size).all(axis=1)]
    copies = shifted(np.tile(elements, len(shifts)), np.repeat(shifts, len(elements), axis=0))
    areas = shapely.area(elements)
    overlap = len(shifts) * areas.sum() - shapely.union_all(copies).area
    if overlap > _OVERLAP * areas.min():
        raise GeometryError(
            "elements of the mask overlap each other or overlap periodic copies of the mask; "
            "pass the union of the elements as one Aperture (a | b), or a longer period"
        )


def _order_amplitudes(
    mask: Aperture | Array, orders: Floats, cell: float, transmission: complex, background: complex
) -> Complex:
    """Return the amplitudes (n,) of diffraction orders of a mask with frequencies (n, 2) in 1/m.

    ``cell`` is the area of a period.
    """
    inside, around = (
        complex(complex_array(value, f"expected {name} to be a finite number", ()))
        for name, value in (("transmission", transmission), ("background", background))
    )
    weights = mask.weights if isinstance(mask, Array) else np.ones(1)
    amplitudes = np.zeros(len(orders), np.complex128)
    for element, weight in zip(mask.elements_in_plane, weights.tolist(), strict=True):
        amplitudes += inside * weight * fourier(element, orders)
        if around:
            amplitudes -= around * fourier(element.with_illumination(None), orders)
    amplitudes /= cell
    amplitudes[(orders == 0.0).all(axis=1)] += around
    return amplitudes


def _plane_points(name: str, values: Any) -> Floats:
    """Return finite points or lags of shape (..., 2) in m, or raise ArgumentError."""
    return finite_array(
        values, f"expected {name} to be finite numbers of shape (..., 2) in m", (..., 2)
    )


def _checked_lattice(period: Any) -> Floats:
    """Return the lattice vectors of a mask as rows, shape (2, 2), in m.

    Two numbers are the periods along x and y. Raises ArgumentError if the vectors are parallel.
    """
    sizes = checked_array(period, "period", np.ndim(period) or 1)
    lattice = np.diag(sizes) if sizes.shape == (2,) else sizes
    flat = lattice.shape != (2, 2) or not np.isfinite(lattice).all()
    if flat or not abs(np.linalg.det(lattice)) > 1e-9 * np.square(lattice).sum():
        raise ArgumentError(
            "expected period to be two lengths in m above zero, or two vectors that span the "
            f"plane, got {period!r}"
        )
    return np.asarray(lattice, np.float64)
