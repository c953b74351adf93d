"""Derivatives of transfer and spread functions in vertices, weights and aberration coefficients.

The rules on triangles give the values. An integral over a polygon changes by the integrand along
its moving boundary, (G1), which is a Gauss rule on the parts of edges in the slice. A coefficient
of the path length multiplies the integrand by 2 pi i/lambda times its term. Values and derivatives
are the columns of one array (n, 1 + m), a jet, so that sums over wavelengths are sums of jets.
Where edges of both copies coincide, the derivative is the mean of both one-sided derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution import Differentiable
from polywigner.numerics.nodes import unit_rule
from polywigner.numerics.triangles import Floats, Indices, counts_for
from polywigner.transforms.aberrated_pupils import (
    AberratedPupil,
    Slices,
    autocorrelations,
    slice_integrals,
    slices_of,
)
from polywigner.transforms.aberrations import Aberration

Complex = NDArray[np.complex128]
Jets = NDArray[np.complex128]
"""Values in column 0, and derivatives in the numbers of a pupil."""

# Additional nodes of the rules for derivatives, and lags that are computed together.
_EXTRA, _LAGS = 6, 64
# Distance from an edge within which both copies share a boundary, over the pupil's size.
_NEAR = 1e-9


@dataclass(frozen=True, eq=False)
class PupilNumbers:
    """The Dr.Jit numbers of a pupil and of its aberration; None for constants."""

    vertices: Any
    """``Array2f``."""
    weights: Any
    """``Complex2f``."""
    coefficients: Any
    """``Float``."""

    @classmethod
    def of(cls, source: Any, aberration: Any) -> tuple[Any, PupilNumbers | None]:
        """Return the plain source, and the numbers, or None without Dr.Jit arrays."""
        coefficients = aberration.traced if isinstance(aberration, Aberration) else None
        if isinstance(source, Differentiable):
            return source.source, cls(source.vertices, source.weights, coefficients)
        return source, None if coefficients is None else cls(None, None, coefficients)

    @cached_property
    def arrays(self) -> list[Any]:
        """The Dr.Jit floats in the order of the columns."""
        pairs = [pair for pair in (self.vertices, self.weights) if pair is not None]
        arrays = [pair[k] for pair in pairs for k in (0, 1)]
        return arrays if self.coefficients is None else [*arrays, self.coefficients]

    def joined(self, values: Complex, pupil: AberratedPupil, parts: Parts) -> Jets:
        """Return the jet of values (n,) with the derivatives that have numbers."""
        columns = [values[:, None]]
        if self.vertices is not None:
            columns += [parts.vertices(pupil)[..., k] for k in (0, 1)]
        if self.weights is not None:
            by_weight, by_conjugate = parts.weights(pupil)
            columns += [by_weight + by_conjugate, 1j * (by_weight - by_conjugate)]
        if self.coefficients is not None:
            columns.append(parts.coefficients(pupil))
        return np.concatenate(columns, axis=1)

    def result(self, jets: Jets, is_complex: bool) -> Any:
        """Return a jet as a ``Complex2f`` or ``Float`` with derivatives."""
        columns = [
            execution.with_jacobian(part[:, 0].copy(), part[:, 1:], self.arrays)
            for part in ([jets.real, jets.imag] if is_complex else [jets.real])
        ]
        if not is_complex:
            return columns[0]
        return execution.sibling(type(columns[0]), "Complex2f")(*columns)


class Parts:
    """Derivatives of an integral in the numbers of a pupil."""

    def vertices(self, pupil: AberratedPupil) -> Complex:
        """Return the derivatives (n, vertices, 2)."""
        raise NotImplementedError

    def weights(self, pupil: AberratedPupil) -> tuple[Complex, Complex]:
        """Return the derivatives (n, elements) in the weights and in their conjugates."""
        raise NotImplementedError

    def coefficients(self, pupil: AberratedPupil) -> Complex:
        """Return the derivatives (n, terms)."""
        raise NotImplementedError


def quotient(jets: Jets, divisor: Jets) -> Jets:
    """Return the jet of a quotient."""
    value = jets[:, :1] / divisor[:, :1]
    return np.concatenate([value, (jets[:, 1:] - value * divisor[:, 1:]) / divisor[:, :1]], axis=1)


def modulus(jets: Jets) -> Jets:
    """Return the jet of |V|; the derivative of zero is zero."""
    size = np.abs(jets[:, :1])
    phase = np.divide(jets[:, :1].conj(), size, where=size > 0, out=np.zeros_like(jets[:, :1]))
    slopes = (phase * jets[:, 1:]).real
    return np.concatenate([size, slopes], axis=1).astype(np.complex128)


def squared_modulus(jets: Jets) -> Jets:
    """Return the jet of |V|^2."""
    products = (jets[:, :1].conj() * jets).real
    products[:, 1:] *= 2.0
    return np.asarray(products, np.complex128)


# ---- edges ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Edges:
    """The edges of an element with the numbers of their vertices in the pupil."""

    begin: Floats
    vector: Floats
    first: Indices
    second: Indices

    @property
    def normal(self) -> Floats:
        """Outward normals (n, 2) times the lengths."""
        return np.stack([self.vector[:, 1], -self.vector[:, 0]], axis=-1)


def edges_of(pupil: AberratedPupil) -> list[Edges]:
    """Return the edges of each element."""
    result, start = [], 0
    for element in pupil.elements:
        begin = np.concatenate(element.rings)
        end = np.concatenate([np.roll(ring, -1, axis=0) for ring in element.rings])
        first = np.arange(start, start + len(begin))
        sizes = np.cumsum([len(ring) for ring in element.rings])
        second = np.concatenate([np.roll(part, -1) for part in np.split(first, sizes[:-1])])
        result.append(Edges(begin, end - begin, first, second))
        start += len(begin)
    return result


def nodes_on(low: Floats, high: Floats, count: int) -> tuple[Floats, Floats]:
    """Return nodes t (n, count) on intervals and weights (n, count)."""
    nodes, weights = unit_rule(count)
    length = (high - low)[:, None]
    return low[:, None] + length * nodes, length * weights


# ---- autocorrelations ----------------------------------------------------------------------------


def autocorrelation_jets(
    pupil: AberratedPupil, lags: Floats, numbers: PupilNumbers, tolerance: float
) -> Jets:
    """Return jets (n, 1 + m) of int u(x + xi/2) u*(x - xi/2) dx at lags (n, 2)."""
    values, _ = autocorrelations(pupil, lags, tolerance)
    blocks = [slice(k, k + _LAGS) for k in range(0, len(lags), _LAGS)]
    return np.concatenate(
        [
            numbers.joined(values[some], pupil, _OfSlices(slices_of(pupil, lags[some]), tolerance))
            for some in blocks
        ]
    )


@dataclass(frozen=True, eq=False)
class _OfSlices(Parts):
    regions: Slices
    error: float

    def vertices(self, pupil: AberratedPupil) -> Complex:
        edges, regions = edges_of(pupil), self.regions
        count = sum(len(part.begin) for part in edges)
        total = np.zeros((len(regions.lags), count, 2), np.complex128)
        for row, i, j in zip(regions.row, regions.first, regions.second, strict=True):
            lag = regions.lags[row]
            weight = pupil.weights[i] * pupil.weights[j].conj()
            size = float(np.abs(pupil.polygons[i].bounds).max())
            # edges of the copy ahead, whose partners are behind by the lag, and the reverse
            ahead = _along_edges(pupil, i, j, edges[i], edges[j], -lag, size, self.error)
            behind = _along_edges(pupil, j, i, edges[j], edges[i], lag, size, self.error).conj()
            for moving, terms in ((edges[i], ahead), (edges[j], behind)):
                total[row, moving.first] += weight * terms[:, 0]
                total[row, moving.second] += weight * terms[:, 1]
        return total

    def weights(self, pupil: AberratedPupil) -> tuple[Complex, Complex]:
        regions, shape = self.regions, (len(self.regions.lags), len(pupil.elements))
        integrals = slice_integrals(pupil, regions, _EXTRA, self.error)
        both = np.zeros((2, *shape), np.complex128)
        first, second = regions.first, regions.second
        np.add.at(both[0], (regions.row, first), integrals * pupil.weights[second].conj())
        np.add.at(both[1], (regions.row, second), integrals * pupil.weights[first])
        return both[0], both[1]

    def coefficients(self, pupil: AberratedPupil) -> Complex:
        regions, path = self.regions, pupil.aberration
        assert path is not None

        def by(ahead: Floats, behind: Floats) -> Floats:
            return path.modes(*ahead.T) - path.modes(*behind.T)

        integrals = slice_integrals(pupil, regions, _EXTRA, self.error, by)
        weights = pupil.weights[regions.first] * pupil.weights[regions.second].conj()
        total = np.zeros((len(regions.lags), len(integrals)), np.complex128)
        np.add.at(total, regions.row, (weights * integrals).T)
        return total * (2j * np.pi / pupil.wavelength)


def _along_edges(
    pupil: AberratedPupil, one: int, other: int, edges: Edges, others: Edges, shift: Floats,
    size: float, error: float,
) -> Complex:  # fmt: skip
    """Return int N (1 - t, t) u_one(p) u_other*(p + shift) dt along edges (n, 2, 2).

    Only where p + shift lies in the other element. For the conjugate product the result is
    conjugated.
    """
    edge, low, high, inside = _pieces(edges, others, shift, pupil.polygons[other], _NEAR * size)
    if not len(edge):
        return np.zeros((len(edges.begin), 2, 2), np.complex128)
    vector = edges.vector[edge]
    ends = edges.begin[edge] + np.stack([low, 0.5 * (low + high), high])[..., None] * vector
    slope = pupil.slopes(ends) - pupil.slopes(ends + shift)
    kappa = np.ptp(np.concatenate([e.frequencies for e in pupil.elements]), axis=0)
    cycles = np.abs((slope * vector).sum(axis=-1)).max(axis=0) + np.abs(vector) @ kappa
    count = int(counts_for((cycles * (high - low)).max(), error)) + _EXTRA
    t, weights = nodes_on(low, high, count)
    p = edges.begin[edge, None] + t[..., None] * vector[:, None]
    phase = pupil.cycles(p) - pupil.cycles(p + shift)
    flat = p.reshape(-1, 2)
    waves = pupil.waves(one, flat) * pupil.waves(other, flat + shift).conj()
    values = (inside[:, None] * weights) * np.exp(2j * np.pi * phase) * waves.reshape(t.shape)
    both = np.stack([(values * (1 - t)).sum(axis=1), (values * t).sum(axis=1)], axis=1)
    total = np.zeros((len(edges.begin), 2), np.complex128)
    np.add.at(total, edge, both)
    return total[..., None] * edges.normal[:, None, :]


def _pieces(
    edges: Edges, others: Edges, shift: Floats, polygon: Any, near: float
) -> tuple[Indices, Floats, Floats, Floats]:
    """Return parts of edges that lie in a polygon after a shift: edge, t from, t to, fraction.

    The fraction is 1 inside, and 1/2 along a common boundary.
    """
    begin, vector = edges.begin + shift, edges.vector
    away = others.begin - begin[:, None]
    cross = vector[:, None, 0] * others.vector[:, 1] - vector[:, None, 1] * others.vector[:, 0]
    along = away[..., 0] * others.vector[:, 1] - away[..., 1] * others.vector[:, 0]
    across = away[..., 0] * vector[:, None, 1] - away[..., 1] * vector[:, None, 0]
    length = np.linalg.norm(vector, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t, s = along / cross, across / cross
    meets = (t > 0) & (t < 1) & (s > -_NEAR) & (s < 1 + _NEAR)
    # corners of the other polygon on the edge, where both run along each other
    at = (away * vector[:, None]).sum(axis=-1) / length[:, None] ** 2
    touches = (at > 0) & (at < 1) & (np.abs(across) < near * length[:, None])
    found = [np.nonzero(meets), np.nonzero(touches)]
    every = np.arange(len(vector))
    edge = np.concatenate([every, every, found[0][0], found[1][0]])
    cut = np.concatenate([0.0 * every, 0.0 * every + 1, t[found[0]], at[found[1]]])
    order = np.lexsort((cut, edge))
    edge, cut = edge[order], cut[order]
    is_part = (edge[1:] == edge[:-1]) & (cut[1:] > cut[:-1])
    edge, low, high = edge[:-1][is_part], cut[:-1][is_part], cut[1:][is_part]
    middle = begin[edge] + 0.5 * (low + high)[:, None] * vector[edge]
    step = near * edges.normal[edge] / length[edge, None]
    sides = [shapely.contains_xy(polygon, *(middle + k * step).T) for k in (-1, 1)]
    inside = 0.5 * (sides[0] + 1.0 * sides[1])
    used = inside > 0
    return edge[used], low[used], high[used], inside[used]
