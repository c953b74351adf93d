"""Numerical integrals over pupils with aberrations.

The integrands are smooth within each element, or within the intersection of two elements. These
polygons are divided into trapezoids or triangles, on which Gauss rules converge spectrally. The
error estimate is the difference between two rules with different numbers of nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import NoneType
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import (
    checked_number,
    checked_type,
    checked_wavelength,
    warn_caller,
)
from polywigner.geometry.convex import trapezoids
from polywigner.geometry.hidden_parts import polygonal
from polywigner.geometry.parts import shifted
from polywigner.numerics import Complex, blocks_by_size, sums_by_index
from polywigner.numerics.nodes import (
    LARGEST,
    Cells,
    Floats,
    Indices,
    cell_rules,
    cells_of,
    counts_for_cycles,
    rule_over_cells,
    triangles_of,
)
from polywigner.source.normal_form import SourceElement, normal_form, polygons_of
from polywigner.transforms.aberrations import Aberration

TOLERANCE = 1e-10
"""Default tolerance of integrals over aberrated pupils, as a fraction of the largest value."""

# Numbers of nodes along a side to try in turn, in addition to the nodes for a linear phase.
_EXTRA = (1, 3, 6, 10, 16, 24, 34)
# Largest number of nodes in a quadrature rule, and number of nodes per block (some tens of
# megabytes).
_MOST, _BLOCK = 1 << 26, 1 << 17


def _bilinear_weights(count_u: int, count_v: int) -> Floats:
    """Return weights (n, 4) of the corners of a cell at a grid of count_u x count_v points.

    The corners (u, v) are (0, 0), (1, 0), (0, 1) and (1, 1).
    """
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, count_u), np.linspace(0, 1, count_v)))
    return np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)


# Points at which the phase gradient is sampled in a cell. Trapezoids need more points, because they
# may extend across the entire pupil.
_IN_TRIANGLE, _IN_TRAPEZOID = _bilinear_weights(4, 3), _bilinear_weights(5, 9)
# Number of additional nodes above which a rule also has more nodes per phase cycle, because the
# phase may be steeper between the sample points.
_STEEP = 4


class Converged(NamedTuple):
    """Values of an integral, their largest estimated error, and the number of additional nodes."""

    values: Complex
    error: float
    extra: int


def converged(evaluate: Callable[[int], Complex], allowed: float, what: str) -> Converged:
    """Return an integral, refined until its values change by at most ``allowed``.

    ``evaluate`` returns the values for a number of additional nodes. ``what`` is the name of the
    integral in a warning. If no number of nodes suffices, a warning is issued and the last values
    are returned.
    """
    previous = evaluate(_EXTRA[0])
    for extra in _EXTRA[1:]:
        values = evaluate(extra)
        error = float(np.abs(values - previous).max(initial=0.0))
        if not error > allowed:
            return Converged(values, error, extra)
        previous = values
    warn_caller(
        f"the estimated error of {what} is {error / allowed:.2g} times the tolerance, because the "
        "path length has kinks or changes rapidly; use a smooth function, or a larger tolerance"
    )
    return Converged(values, error, extra)


@dataclass(frozen=True, eq=False)
class AberratedPupil:
    """The field of a pupil with aberration and defocus, at one wavelength.

    The field of the source is multiplied by exp(2 pi i (W/lambda + bend |x|^2)), where W is the
    path length of the aberration.
    """

    elements: tuple[SourceElement, ...]
    aberration: Aberration | None
    wavelength: float
    bend: float
    """Defocus in waves divided by the square of the pupil's radius, in 1/m^2."""
    curvature: Floats
    """Curvature matrix Q of a curved wave, shape (2, 2), in 1/m^2."""
    centre: Floats
    """Point at which the curved wave touches the plane, shape (2,), in m."""

    @classmethod
    def of(
        cls, source: Any, aberration: Aberration | None, wavelength: float, bend: float
    ) -> AberratedPupil:
        """Return the pupil of a coherent source with an aberration and a defocus.

        The defocus is the phase exp(2 pi i bend |x|^2), with ``bend`` in 1/m^2. Raises
        ArgumentError for slits.
        """
        form = normal_form(source)
        if form.dimension != 2:
            raise ArgumentError(
                "expected an Aperture or an Array of apertures as an aberrated pupil, got slits"
            )
        elements = form.in_plane.elements
        return cls(elements, aberration, wavelength, bend, form.curvature, form.centre)

    @cached_property
    def weights(self) -> Complex:
        """Complex weight of each element."""
        return np.array([element.weight for element in self.elements], np.complex128)

    @cached_property
    def polygons(self) -> NDArray[Any]:
        """Polygon of each element."""
        return polygons_of(self.elements)

    @cached_property
    def content(self) -> float:
        """Upper bound on the integral of |u| over the pupil, where u is the weighted field."""
        return float((np.abs(self.weights) * self.amplitudes) @ shapely.area(self.polygons))

    @cached_property
    def energy_bound(self) -> float:
        """Upper bound on the integral of |u|^2 over the pupil, where u is the weighted field."""
        return float((np.abs(self.weights) * self.amplitudes) ** 2 @ shapely.area(self.polygons))

    @cached_property
    def amplitudes(self) -> Floats:
        """Upper bound on |u| on each element, without the weight of the element."""
        return np.array([float(np.abs(e.amplitudes).sum()) for e in self.elements])

    def cycles(self, x: Floats) -> Floats:
        """Return the phase of the aberration, the defocus and the curved wave, in cycles.

        The points have the shape (..., 2), in m.
        """
        total: Any = self.bend * np.square(x).sum(axis=-1)
        if self.curvature.any():
            away = x - self.centre
            total = total + 0.5 * ((away @ self.curvature) * away).sum(axis=-1)
        if self.aberration is not None:
            total = total + self.aberration(x[..., 0], x[..., 1]) / self.wavelength
        return np.asarray(total)

    def slopes(self, x: Floats) -> Floats:
        """Return the gradient (..., 2) of :meth:`cycles` at points, in cycles per metre."""
        total = 2.0 * self.bend * x + (x - self.centre) @ self.curvature
        if self.aberration is not None:
            total = total + self.aberration.slopes(x[..., 0], x[..., 1]) / self.wavelength
        return np.asarray(total)

    def waves(self, numbers: Indices, x: Floats) -> Complex:
        """Return the plane waves of elements at points (n, 2), without weights and aberration.

        ``numbers`` contains the index of the element of each point.
        """
        values = np.ones(len(x), np.complex128)
        for k, element in enumerate(self.elements):
            if not element.has_unit_field:
                some = numbers == k
                values[some] = element.waves_at(x[some])
        return values

    def field(self, number: int, x: Floats) -> Complex:
        """Return the aberrated field of an element at points (..., 2), without its weight."""
        flat = x.reshape(-1, 2)
        waves = self.waves(np.full(len(flat), number), flat).reshape(x.shape[:-1])
        return np.asarray(waves * np.exp(2j * np.pi * self.cycles(x)))

    @cached_property
    def _cells(self) -> list[tuple[Cells, Floats]]:
        """Trapezoids (n, 4, 2) that form each element, and phase gradients at points inside.

        The gradients (n, points, 2) are in cycles per metre.
        """
        cells = [trapezoids(element.rings).corners for element in self.elements]
        return [(corners, self.slopes(_IN_TRAPEZOID @ corners)) for corners in cells]

    def rules(
        self, number: int, band: tuple[Floats, Floats], extra: int, error: float
    ) -> list[tuple[Floats, Floats]]:
        """Return the nodes and weights of quadrature rules on an element of the pupil.

        The nodes have the shape (n, m, 2), and all nodes of a row have the same x. The field is
        multiplied by waves exp(-2 pi i nu.x), and ``band`` contains the lowest and the highest
        frequency nu along each axis. ``extra``: number of additional nodes along each side of a
        cell. ``error`` is relative to the integral of the modulus.
        """
        kappa = self.elements[number].frequencies
        low, high = kappa.min(axis=0) - band[1], kappa.max(axis=0) - band[0]
        cells, slopes = self._cells[number]
        counts = _node_counts(cells, slopes + (low + high) / 2, (high - low) / 2, extra, error)
        return [
            (nodes.reshape(-1, *nodes.shape[2:]), weights.reshape(-1, weights.shape[2]))
            for _, nodes, weights in cell_rules(cells, counts)
        ]


def _node_counts(
    cells: Cells, slopes: Floats, half_band: Floats, extra: int, error: float
) -> Indices:
    """Return the numbers of nodes along both directions of each cell.

    ``slopes`` [cycles/m] has the shape (n, samples, 2). ``half_band`` (2,) is the largest deviation
    of the frequencies from ``slopes``. Raises ArgumentError if too many nodes are needed.
    """
    sides = cells[:, (1, 3, 2, 3)] - cells[:, (0, 2, 0, 1)]
    cycles = np.abs(slopes @ sides.transpose(0, 2, 1)).max(axis=1) + np.abs(sides) @ half_band
    along = np.stack([cycles[:, :2].max(axis=1), cycles[:, 2:].max(axis=1)], axis=1)
    steeper = 1.0 + max(extra - _STEEP, 0) / 12.0
    counts = counts_for_cycles(steeper * along, error) + extra
    if counts.prod(axis=1).sum() > _MOST or counts.max(initial=0) > LARGEST:
        raise ArgumentError(
            f"the aberrated pupil has up to {along.max():.1e} cycles of phase along a side of "
            f"its trapezoids or triangles and would require more than {_MOST:.1e} quadrature "
            "nodes; check that the coefficients are in metres, or use points closer to the "
            "axis"
        )
    return counts


@dataclass(frozen=True, eq=False)
class Slices:
    """Intersections of elements of two copies of a pupil, shifted by -xi/2 and xi/2."""

    lags: Floats
    row: Indices
    """Index of the lag of each intersection."""
    first: Indices
    """Index of the element that contains x + xi/2, in the copy shifted by -xi/2."""
    second: Indices
    """Index of the element that contains x - xi/2, in the copy shifted by xi/2."""
    weights: Complex
    """Weight of the first element times the conjugate of the weight of the second."""
    polygons: NDArray[Any]


def slices_of(pupil: AberratedPupil, lags: Floats) -> Slices:
    """Return the regions in which both x + xi/2 and x - xi/2 lie in the pupil, for each lag xi.

    ``lags`` (n, 2) are in m.
    """
    boxes = shapely.bounds(pupil.polygons)
    low, high = boxes[:, :2], boxes[:, 2:]
    half = lags[:, None, None] / 2
    apart = ((high[:, None] - half) <= (low + half)) | ((high + half) <= (low[:, None] - half))
    row, first, second = np.nonzero(~apart.any(axis=-1))
    ahead = shifted(pupil.polygons[first], -lags[row] / 2)
    behind = shifted(pupil.polygons[second], lags[row] / 2)
    weights = pupil.weights[first] * pupil.weights[second].conj()
    return Slices(lags, row, first, second, weights, shapely.intersection(ahead, behind))


def slice_integrals(
    pupil: AberratedPupil,
    regions: Slices,
    extra: int,
    error: float,
    factors: Callable[[Floats, Floats], Floats] | None = None,
) -> Complex:
    """Return integrals of u(x + xi/2) u*(x - xi/2), times optional factors, over the regions.

    The aberrated field u does not contain the weights of the elements. ``factors(x + xi/2, x -
    xi/2)`` returns k factors for each point. The result has the shape (k, regions), where k is 1 if
    there are no factors.
    """
    half = regions.lags[regions.row] / 2
    kappa = np.concatenate([element.frequencies for element in pupil.elements])

    def slopes(x: Floats, region: Indices) -> Floats:
        """Return the phase gradient of the integrand at points in regions, in cycles per metre."""
        lag = half[region, None]
        return pupil.slopes(x + lag) - pupil.slopes(x - lag)

    def integrand(x: Floats, region: Indices) -> Complex:
        """Return the integrand times each factor at points in regions."""
        ahead, behind = x + half[region], x - half[region]
        values = np.exp(2j * np.pi * (pupil.cycles(ahead) - pupil.cycles(behind)))
        values *= pupil.waves(regions.first[region], ahead)
        values *= pupil.waves(regions.second[region], behind).conj()
        return values[None] if factors is None else factors(ahead, behind) * values

    band = np.ptp(kappa, axis=0)
    return region_integrals(regions.polygons, slopes, integrand, band, extra, error)


def region_integrals(
    polygons: NDArray[Any],
    slopes: Callable[[Floats, Indices], Floats],
    integrand: Callable[[Floats, Indices], Complex],
    half_band: Floats,
    extra: int,
    error: float,
) -> Complex:
    """Return the integrals of k functions over n polygons, shape (k, n).

    ``integrand`` returns the values of the k functions at points, and ``slopes`` returns gradients
    of their phase for :func:`_node_counts`. The second argument of both functions is the index of
    the polygon of each point.
    """
    parts, polygon = shapely.get_parts(polygonal(polygons), return_index=True)
    triangles, part = triangles_of(parts)
    owner, cells = polygon[part], cells_of(triangles)
    counts = _node_counts(cells, slopes(_IN_TRIANGLE @ cells, owner), half_band, extra, error)
    # An empty array of points gives the number of functions even if all polygons are empty.
    count = len(integrand(np.zeros((0, 2)), np.zeros(0, np.intp)))
    total: Any = np.zeros((count, len(polygons)), np.complex128)
    for some in blocks_by_size(counts.prod(axis=1), _BLOCK):
        nodes, weights, cell = rule_over_cells(cells[some], counts[some])
        region = owner[some][cell]
        rows = weights * integrand(nodes, region)
        total = total + np.array([sums_by_index(region, row, len(polygons)) for row in rows])
    return np.asarray(total)


def by_lag(regions: Slices, integrals: Complex) -> Complex:
    """Return the sums of integrals times ``regions.weights``, over all regions of the same lag.

    The integrals have the shape (k, regions), and the sums the shape (k, lags).
    """
    rows = regions.weights * integrals
    return np.array([sums_by_index(regions.row, row, len(regions.lags)) for row in rows])


def checked_aberration(aberration: Any, wavelength: Any, *, has_gradients: bool = False) -> float:
    """Return the wavelength in m; raise ArgumentError for invalid wavelengths or aberrations.

    The aberration may be None. ``has_gradients`` specifies whether Dr.Jit coefficients are allowed.
    """
    expected = "aberration to be a polywigner.Aberration"
    advice = "use polywigner.zernike, or Aberration(function)"
    checked_type(aberration, expected, Aberration, NoneType, advice=advice)
    if aberration is not None and aberration.traced is not None and not has_gradients:
        raise ArgumentError(
            "only psf, otf and mtf accept an aberration with Dr.Jit coefficients; use "
            "with_coefficients and NumPy arrays"
        )
    if wavelength is None:
        raise ArgumentError(
            "an aberration is a path length in m and requires a wavelength; pass wavelength=... "
            "as well"
        )
    return checked_wavelength(wavelength)


def checked_tolerance(tolerance: Any) -> float:
    """Return a tolerance from 1e-13 to 0.1; raise ArgumentError for other values."""
    meaning = "a fraction from 1e-13 to 0.1"
    return checked_number(tolerance, "tolerance", meaning, lambda x: 1e-13 <= x <= 0.1)
