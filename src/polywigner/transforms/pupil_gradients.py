"""Derivatives of transfer and point spread functions with respect to parameters of the pupil.

The parameters are vertices, weights of elements, and aberration coefficients. Derivatives with
respect to vertices are integrals along edges, equation (G1). For a coefficient, the integrand is
multiplied by 2 pi i/lambda times the term of the coefficient. Values and derivatives are the
columns of an array of shape (n, 1 + m), called a jet. If edges of two copies coincide, the
derivative is the mean of both one-sided derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution import Differentiable
from polywigner.numerics import Complex
from polywigner.numerics.nodes import Floats, Indices, counts_for_cycles, unit_rule
from polywigner.transforms.aberrated_pupils import (
    AberratedPupil,
    Slices,
    by_lag,
    converged,
    slice_integrals,
    slices_of,
)
from polywigner.transforms.aberrations import Aberration

Jets = NDArray[np.complex128]
"""Values in column 0, and their derivatives with respect to the parameters in the other columns."""
Parts = tuple[Indices, Floats, Floats]
"""Parts of edges: index of the edge, and fractions of the edge at the start and the end of the
part."""

# Number of additional nodes for derivatives, and number of lags per block.
_EXTRA, _LAGS = 6, 128
# Distance, relative to the size of the pupil, below which edges are treated as coincident.
_NEAR = 1e-9


class Derivatives(Protocol):
    """Derivatives of integrals over a pupil, with one row for each integral."""

    def vertices(self) -> Complex:
        """Return the derivatives with respect to the vertices, shape (n, vertices, 2)."""
        ...

    def weights(self) -> tuple[Complex, Complex]:
        """Return the derivatives with respect to the weights and to their complex conjugates.

        Both arrays have the shape (n, k).
        """
        ...

    def coefficients(self) -> Complex:
        """Return the derivatives with respect to the aberration coefficients, shape (n, k)."""
        ...


@dataclass(frozen=True, eq=False)
class PupilNumbers:
    """Dr.Jit arrays of a pupil and of its aberration. Constant numbers are None."""

    vertices: Any = None
    """Vertices as an ``Array2f``."""
    weights: Any = None
    """Weights as a ``Complex2f``."""
    coefficients: Any = None
    """Aberration coefficients as a ``Float``."""

    @classmethod
    def of(cls, source: Any, aberration: Any) -> tuple[Any, PupilNumbers]:
        """Return a source whose Dr.Jit arrays are replaced by plain numbers, and the Dr.Jit arrays.

        The Dr.Jit arrays include the coefficients of ``aberration``, which is not changed.
        """
        coefficients = aberration.traced if isinstance(aberration, Aberration) else None
        if isinstance(source, Differentiable):
            return source.source, cls(source.vertices, source.weights, coefficients)
        return source, cls(coefficients=coefficients)

    @cached_property
    def arrays(self) -> list[Any]:
        """Dr.Jit floats in the order of the columns of a jet, without constants.

        The order is x and y of the vertices, real and imaginary part of the weights, and
        coefficients.
        """
        pairs = [pair for pair in (self.vertices, self.weights) if pair is not None]
        arrays = [pair[k] for pair in pairs for k in (0, 1)]
        return arrays if self.coefficients is None else [*arrays, self.coefficients]

    def joined(self, values: Complex, derivatives: Derivatives) -> Jets:
        """Return the jet that consists of values and their derivatives."""
        columns = [values[:, None]]
        if self.vertices is not None:
            by_vertices = derivatives.vertices()
            columns += [by_vertices[..., 0], by_vertices[..., 1]]
        if self.weights is not None:
            by_weight, by_conjugate = derivatives.weights()
            columns += [by_weight + by_conjugate, 1j * (by_weight - by_conjugate)]
        if self.coefficients is not None:
            columns.append(derivatives.coefficients())
        return np.concatenate(columns, axis=1)

    def result(self, jets: Jets, shape: tuple[int, ...], is_complex: bool) -> Any:
        """Return the values of jets as a NumPy array of ``shape``, or as flat Dr.Jit arrays.

        The result is a Dr.Jit array, with derivatives, if the pupil contains Dr.Jit arrays.
        """
        if not self.arrays:
            values = jets[:, 0].reshape(shape)
            return (values if is_complex else values.real.copy())[()]
        columns = [
            execution.with_jacobian(part[:, 0].copy(), part[:, 1:], self.arrays)
            for part in ([jets.real, jets.imag] if is_complex else [jets.real])
        ]
        if not is_complex:
            return columns[0]
        return execution.sibling(type(columns[0]), "Complex2f")(*columns)


def quotient(jets: Jets, divisor: Jets) -> Jets:
    """Return the quotient of two jets as a jet."""
    value = jets[:, :1] / divisor[:, :1]
    return np.concatenate([value, (jets[:, 1:] - value * divisor[:, 1:]) / divisor[:, :1]], axis=1)


def modulus(jets: Jets) -> Jets:
    """Return the modulus of a jet as a jet. At a value of 0 the derivative is set to 0."""
    size = np.abs(jets[:, :1])
    phase = np.divide(jets[:, :1].conj(), size, where=size > 0, out=np.zeros_like(jets[:, :1]))
    slopes = (phase * jets[:, 1:]).real
    return np.concatenate([size, slopes], axis=1).astype(np.complex128)


def squared_modulus(jets: Jets) -> Jets:
    """Return the squared modulus of a jet as a jet."""
    products = (jets[:, :1].conj() * jets).real
    products[:, 1:] *= 2.0
    return np.asarray(products, np.complex128)


@dataclass(frozen=True, eq=False)
class Edges:
    """The edges of an element of a pupil."""

    begin: Floats
    vector: Floats
    ends: Indices
    """Indices of the first and the second vertex of each edge within the element, shape (n, 2)."""
    vertices: slice
    """Range of the element's vertices among the vertices of the pupil."""

    @property
    def normals(self) -> Floats:
        """Outward normal of each edge, multiplied by the length of the edge."""
        return np.stack([self.vector[:, 1], -self.vector[:, 0]], axis=-1)

    def rule(
        self,
        parts: Parts,
        slopes: Callable[[Floats], Floats],
        half_band: Floats,
        error: float,
        extra: int,
    ) -> tuple[Floats, Floats]:
        """Return the nodes and weights of quadrature rules on parts of edges, shape (k, m, 2) each.

        Each node has two weights: the weight of the rule times 1 - t and times t, where t is the
        position of the node as a fraction of the edge. The sum of all weights of a part is its
        length as a fraction of the edge. ``slopes`` returns gradients of the phase at points, and
        ``half_band`` is the largest deviation of frequencies from these gradients, in cycles per
        metre.
        """
        edge, low, high = parts
        begin, vector, length = self.begin[edge], self.vector[edge], high - low
        samples = begin + np.stack([low, 0.5 * (low + high), high])[..., None] * vector
        cycles = np.abs((slopes(samples) * vector).sum(axis=-1)).max(axis=0)
        cycles = (cycles + np.abs(vector) @ half_band) * length
        nodes, weights = unit_rule(int(counts_for_cycles(cycles.max(), error)) + extra)
        t = low[:, None] + length[:, None] * nodes
        fractions = np.stack([1.0 - t, t], axis=-1)
        x = begin[:, None] + t[..., None] * vector[:, None]
        return x, fractions * np.outer(length, weights)[..., None]

    def at_vertices(self, edge: Indices, terms: Complex) -> Complex:
        """Return, for each vertex, the sum of the terms of adjacent edges times the edge normals.

        ``terms``, shape (..., k, 2), contains two values for each index in ``edge``, for the first
        and the second vertex of the edge. The result has the shape (..., vertices, 2).
        """
        total = np.zeros((len(self.begin), 2, *terms.shape[:-2]), np.complex128)
        moments = terms[..., None] * self.normals[edge][:, None]
        np.add.at(total, self.ends[edge], np.moveaxis(moments, (-3, -2, -1), (0, 1, 2)))
        return np.moveaxis(total, (0, 1), (-2, -1))


def edges_of(pupil: AberratedPupil) -> list[Edges]:
    """Return the edges of each element of a pupil."""
    result, start = [], 0
    for element in pupil.elements:
        begin = np.concatenate(element.rings)
        first = np.arange(len(begin))
        sizes = np.cumsum([len(ring) for ring in element.rings])
        second = np.concatenate([np.roll(part, -1) for part in np.split(first, sizes[:-1])])
        vertices = slice(start, start + len(begin))
        ends = np.stack([first, second], axis=1)
        result.append(Edges(begin, begin[second] - begin, ends, vertices))
        start += len(begin)
    return result


def autocorrelation_jets(
    pupil: AberratedPupil, lags: Floats, numbers: PupilNumbers, tolerance: float
) -> Jets:
    """Return the autocorrelation integral of a pupil at lags, with its derivatives, as jets.

    The integral is int u(x + xi/2) u*(x - xi/2) dx, where u is the field and xi the lag. Lags that
    are not finite give NaN. ``tolerance`` is relative to the integral of |u|^2.
    """
    finite = np.isfinite(lags).all(axis=1, keepdims=True)
    lags = np.where(finite, lags, 0.0)
    jets = [
        _jets_of_block(pupil, lags[start : start + _LAGS], numbers, tolerance)
        for start in range(0, max(len(lags), 1), _LAGS)
    ]
    return np.where(finite, np.concatenate(jets), np.nan)


def _jets_of_block(
    pupil: AberratedPupil, lags: Floats, numbers: PupilNumbers, tolerance: float
) -> Jets:
    """Return the autocorrelation integral at a block of finite lags, with derivatives."""
    regions = slices_of(pupil, lags)

    def evaluate(extra: int) -> Complex:
        """Return the integrals at all lags, for a number of additional nodes."""
        return by_lag(regions, slice_integrals(pupil, regions, extra, tolerance))[0]

    values = converged(evaluate, tolerance * pupil.energy_bound, "the OTF").values
    return numbers.joined(values, _AutocorrelationDerivatives(pupil, regions, tolerance))


@dataclass(frozen=True, eq=False)
class _AutocorrelationDerivatives:
    pupil: AberratedPupil
    regions: Slices
    error: float

    def vertices(self) -> Complex:
        """Return the derivatives with respect to the vertices, shape (lags, vertices, 2)."""
        regions, edges = self.regions, edges_of(self.pupil)
        total = np.zeros((len(regions.lags), edges[-1].vertices.stop, 2), np.complex128)
        pairs = zip(regions.row, regions.first, regions.second, regions.weights, strict=True)
        for row, i, j, weight in pairs:
            # If a point has the position p in the copy of the pupil with element ``i``, it has the
            # position p minus the lag in the copy with element ``j``.
            ahead = self._along_edges(edges, i, j, -regions.lags[row])
            behind = self._along_edges(edges, j, i, regions.lags[row]).conj()
            total[row, edges[i].vertices] += weight * ahead
            total[row, edges[j].vertices] += weight * behind
        return total

    def _along_edges(self, edges: list[Edges], one: int, other: int, shift: Floats) -> Complex:
        """Return derivatives (vertices, 2) for the vertices of element ``one`` of one pupil copy.

        The derivatives are integrals of N (1 - t, t) u_one(p) u_other*(p + shift) along the edges,
        over points p for which p + shift lies in element ``other``. N is the normal of an edge, and
        t is the position of p as a fraction of the edge.
        """
        pupil, moving = self.pupil, edges[one]
        near = _NEAR * float(np.abs(pupil.polygons[one].bounds).max())
        parts, inside = _parts_inside(moving, edges[other], shift, pupil.polygons[other], near)
        if not len(inside):
            return np.zeros(moving.begin.shape, np.complex128)
        band = np.ptp(np.concatenate([e.frequencies for e in pupil.elements]), axis=0)
        x, weights = moving.rule(
            parts, lambda p: pupil.slopes(p) - pupil.slopes(p + shift), band, self.error, _EXTRA
        )  # fmt: skip
        values = inside[:, None] * pupil.field(one, x) * pupil.field(other, x + shift).conj()
        return moving.at_vertices(parts[0], np.einsum("km,kme->ke", values, weights))

    def weights(self) -> tuple[Complex, Complex]:
        """Return the derivatives with respect to weights and to their complex conjugates.

        Both arrays have the shape (lags, elements).
        """
        regions, weights = self.regions, self.pupil.weights
        (integrals,) = slice_integrals(self.pupil, regions, _EXTRA, self.error)
        both = np.zeros((2, len(regions.lags), len(weights)), np.complex128)
        first, second = regions.first, regions.second
        np.add.at(both[0], (regions.row, first), integrals * weights[second].conj())
        np.add.at(both[1], (regions.row, second), integrals * weights[first])
        return both[0], both[1]

    def coefficients(self) -> Complex:
        """Return the derivatives with respect to the aberration coefficients, shape (lags, k)."""
        pupil, regions, path = self.pupil, self.regions, self.pupil.aberration
        assert path is not None

        def factors(ahead: Floats, behind: Floats) -> Floats:
            """Return the difference of each aberration term between two points."""
            return path.modes(*ahead.T) - path.modes(*behind.T)

        integrals = slice_integrals(pupil, regions, _EXTRA, self.error, factors)
        return by_lag(regions, integrals).T * (2j * np.pi / pupil.wavelength)


def _parts_inside(
    edges: Edges, others: Edges, shift: Floats, polygon: Any, near: float
) -> tuple[Parts, Floats]:
    """Return the parts of shifted edges in a polygon, and a factor (k,) for each part.

    The factor is 1 inside the polygon and 1/2 on its boundary. ``others`` are the edges of the
    polygon. ``near``: distance in m within which edges coincide.
    """
    begin, vector = edges.begin + shift, edges.vector
    edge, cut = _edge_cuts(begin, vector, others, near)
    is_part = (edge[1:] == edge[:-1]) & (cut[1:] > cut[:-1])
    edge, low, high = edge[:-1][is_part], cut[:-1][is_part], cut[1:][is_part]
    midpoint = begin[edge] + 0.5 * (low + high)[:, None] * vector[edge]
    length = np.linalg.norm(vector[edge], axis=1)
    step = near * edges.normals[edge] / length[:, None]
    sides = [shapely.contains_xy(polygon, *(midpoint + k * step).T) for k in (-1, 1)]
    inside = 0.5 * (sides[0] + 1.0 * sides[1])
    used = inside > 0
    return (edge[used], low[used], high[used]), inside[used]


def _edge_cuts(begin: Floats, vector: Floats, others: Edges, near: float) -> tuple[Indices, Floats]:
    """Return sorted edge indices and fractions at which edges start, end, or cross other edges."""
    away = others.begin - begin[:, None]
    cross = vector[:, None, 0] * others.vector[:, 1] - vector[:, None, 1] * others.vector[:, 0]
    along = away[..., 0] * others.vector[:, 1] - away[..., 1] * others.vector[:, 0]
    across = away[..., 0] * vector[:, None, 1] - away[..., 1] * vector[:, None, 0]
    length = np.linalg.norm(vector, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t, s = along / cross, across / cross
    meets = (t > 0) & (t < 1) & (s > -_NEAR) & (s < 1 + _NEAR)
    # Coincident edges are also divided at vertices of the other polygon.
    at = (away * vector[:, None]).sum(axis=-1) / length[:, None] ** 2
    touches = (at > 0) & (at < 1) & (np.abs(across) < near * length[:, None])
    every = np.arange(len(vector))
    edge = np.concatenate([every, every, np.nonzero(meets)[0], np.nonzero(touches)[0]])
    cut = np.concatenate([np.zeros(len(every)), np.ones(len(every)), t[meets], at[touches]])
    order = np.lexsort((cut, edge))
    return edge[order], cut[order]
