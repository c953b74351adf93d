"""Sources made of others: sums over their slices, their images, and their parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import transforms
from polywigner.geometry import Aperture, Slits, triangulate
from polywigner.illumination import Array as Elements
from polywigner.testing.cases import Case, waves_of

Array = NDArray[Any]


def _slices(sources: Sequence[Any], to_first: Any, to_second: Any) -> Any:
    """(j, k, intersection of one map of element j and another of k), where there is one."""
    if isinstance(sources[0], Slits):
        first = [to_first(source.intervals) for source in sources]
        second = [np.sort(to_second(source.intervals), axis=1) for source in sources]
        found = ((j, k, _overlaps(a, b)) for j, a in enumerate(first) for k, b in enumerate(second))
    else:
        outlines = np.array([source.polygons for source in sources])
        first, second = (shapely.transform(outlines, to) for to in (to_first, to_second))
        meeting = shapely.STRtree(second).query(first).T.tolist()
        found = ((j, k, _apertures(shapely.intersection(first[j], second[k]))) for j, k in meeting)
    return [(j, k, parts) for j, k, parts in found if parts]


def _apertures(region: Any) -> list[Any]:
    parts = shapely.get_parts(region)
    return [Aperture(p) for p in parts if p.geom_type == "Polygon" and p.area > 0]


def _overlaps(first: Array, second: Array) -> list[Any]:
    low = np.maximum(first[:, None, 0], second[:, 0]).ravel()
    high = np.minimum(first[:, None, 1], second[:, 1]).ravel()
    return [Slits([a, b]) for a, b in zip(low, high, strict=True) if a < b]


def wigner_by_pairs(case: Case, x: Array, nu: Array) -> Any:
    """The sum of w_j w_k* c_m c_n* exp(2 pi i (k_m - k_n).x) F(nu - (k_m + k_n)/2) of slices.

    Those at x (d,): 2(G_j - x) & 2(x - G_k).
    """
    return _summed(
        (parts, factor * _turn((one - other) @ x), nu - (one + other) / 2)
        for j, k, parts in _slices(case.elements, lambda p: 2 * (p - x), lambda p: 2 * (x - p))
        for factor, one, other in _waves_of_pair(case, j, k)
    ).real


def ambiguity_by_pairs(case: Case, upsilon: Array, xi: Array) -> complex:
    """The sum of w_j w_k* c_m c_n* exp(pi i (k_m + k_n).xi) F(upsilon - k_m + k_n) of slices.

    Those at xi (d,): (G_j - xi/2) & (G_k + xi/2).
    """
    return _summed(
        (parts, factor * _turn((one + other) @ xi / 2), upsilon - one + other)
        for j, k, parts in _slices(case.elements, lambda p: p - xi / 2, lambda p: p + xi / 2)
        for factor, one, other in _waves_of_pair(case, j, k)
    )


def _turn(turns: Any) -> complex:
    return complex(np.exp(2j * np.pi * turns))


def _waves_of_pair(case: Case, j: int, k: int) -> Iterator[tuple[complex, Array, Array]]:
    """(w_j w_k* c_m c_n*, k_m, k_n) for the waves of elements j and k."""
    one, other = waves_of(case.elements[j]), waves_of(case.elements[k])
    factor = complex(case.weights[j] * case.weights[k].conjugate())
    for c, kappa in zip(one.amplitudes.tolist(), one.frequencies, strict=True):
        for d, frequency in zip(other.amplitudes.tolist(), other.frequencies, strict=True):
            yield factor * c * d.conjugate(), kappa, frequency


def _summed(terms: Iterable[tuple[list[Any], complex, Array]]) -> complex:
    """The sum of factor times F(q) of parts, over (parts, factor, q)."""
    found: dict[bytes, tuple[Array, list[Any], list[complex]]] = {}
    for parts, factor, q in terms:
        if factor:
            _, pieces, factors = found.setdefault(q.tobytes(), (q, [], []))
            pieces += parts
            factors += [factor] * len(parts)
    return sum(
        (
            complex(transforms.fourier(Elements(pieces, factors), q, engine="numpy"))
            for q, pieces, factors in found.values()
        ),
        0j,
    )


def moved(source: Aperture | Slits, matrix: Array, shift: Array) -> Any:
    """The image under x -> matrix x + shift, its field carried along."""
    image = (
        Slits(source.intervals * matrix[0, 0] + shift[0])
        if isinstance(source, Slits)
        else Aperture(shapely.transform(source.polygons, lambda x: x @ matrix.T + shift))
    )
    if source.illumination is None:
        return image
    return image.with_illumination(waves_of(source).mapped(matrix, shift))


def split_in_three(source: Aperture | Slits) -> tuple[list[Any], list[Any]]:
    """Three pieces that tile the source, and the three unions of two of them; with its field."""
    kind: Any
    kind, pieces = (Slits, _thirds(source)) if isinstance(source, Slits) else _triangles(source)

    def made(piece: Any) -> Any:
        return kind(piece).with_illumination(source.illumination)

    singles = [made(piece) for piece in pieces]
    return singles, [made([*pieces[k], *pieces[k - 1]]) for k in range(3)]


def _thirds(source: Slits) -> list[list[tuple[float, float]]]:
    """The first third of every slit, the second, and the last."""
    pieces: list[list[tuple[float, float]]] = [[], [], []]
    for begin, end in source.intervals.tolist():
        cuts = [begin, begin + (end - begin) / 3, begin + (end - begin) * 2 / 3, end]
        for k in range(3):
            pieces[k].append((cuts[k], cuts[k + 1]))
    return pieces


def _triangles(source: Aperture) -> tuple[Any, list[list[Array]]]:
    """Triangles in three groups from one side to the other."""
    vertices, indices = triangulate(source)
    triangles = vertices[indices]
    if len(triangles) < 3:
        centres = np.broadcast_to(triangles.mean(axis=1, keepdims=True), triangles.shape)
        ahead = np.roll(triangles, -1, axis=1)
        triangles = np.stack([triangles, ahead, centres], axis=2).reshape(-1, 3, 2)
    order = np.argsort(triangles.mean(axis=1) @ (1.0, 0.3))
    return Aperture, [list(triangles[part]) for part in np.array_split(order, 3)]
