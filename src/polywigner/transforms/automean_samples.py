"""Random positions in the automean, for Monte Carlo sums of the Wigner function over position."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations
from polywigner.geometry import Aperture, Slits, automean
from polywigner.geometry.arguments import checked_count, checked_generator, real_numbers
from polywigner.geometry.convex import point_in_trapezoid, trapezoids
from polywigner.kernels import kernel_for
from polywigner.numerics import Floats
from polywigner.source import Array
from polywigner.transforms.checked_calls import PhaseSpaceSource
from polywigner.transforms.wavefronts import flat_source


def sample_automean(
    source: PhaseSpaceSource,
    samples: int | ArrayLike,
    *,
    seed: int | np.random.Generator | None = None,
) -> tuple[Floats, Floats]:
    """Draw uniform positions from the automean, the support of W(., nu), with their density.

    The mean of ``W(x, nu)/density`` over the positions estimates ``int W dx = |F(nu)|^2`` without
    bias. The density is 1/area of the automean. Vertical lines cut the automean into trapezoids,
    and the unit square is mapped onto them with equal areas (docs/projections.md, (P14)).
    Neighbours mostly stay neighbours, so stratified and quasi-random points keep their properties.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        d = 2, or 1 for slits; only the flat source of a Wavefront matters.
    samples : int or array_like, shape (n, d)
        Number of samples, or numbers in [0, 1) to map.
    seed : int or numpy.random.Generator, optional
        Seed of the random numbers.

    Returns
    -------
    positions : ndarray of float, shape (n, d)
        Positions in m.
    density : ndarray of float, shape (n,)
        Probability density in 1/m^d.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If an Array has elements outside the plane z = 0.

    Examples
    --------
    >>> import polywigner as pw
    >>> positions, density = pw.sample_automean(pw.shapes.square(1.0), 100, seed=1)
    >>> positions.shape, round(float(density.sum()), 6)
    ((100, 2), 100.0)
    """
    flat: Any = flat_source(source)  # A curved wave has the same support.
    numbers = _numbers(samples, kernel_for("wigner", flat).dimension, seed)
    support = _support(flat)
    if isinstance(support, Slits):
        begins, ends = support.intervals.T
        part, u = _chosen(ends - begins, numbers[:, 0])
        positions = (begins[part] + u * (ends - begins)[part])[:, None]
        return positions, np.full(len(positions), 1.0 / support.length)
    # Coordinates are relative to the centre, since heights far from the origin would lose digits.
    cells = trapezoids([ring - support.centre for ring in support.rings])
    part, u = _chosen(cells.areas, numbers[:, 0])
    row = [column[part] for column in cells]
    inner = point_in_trapezoid(NumpyOperations(), row, u, numbers[:, 1])
    positions = np.column_stack(inner) + support.centre
    return positions, np.full(len(positions), 1.0 / support.area)


# Largest number of samples. Their positions and densities take 6 GiB.
_MOST_SAMPLES = 1 << 28


def _numbers(samples: Any, columns: int, seed: Any) -> Floats:
    """Return the specified or random numbers (n, columns) in [0, 1)."""
    if isinstance(samples, int | np.integer) and not isinstance(samples, bool):
        count = checked_count(samples, "samples", 1, _MOST_SAMPLES)
        return checked_generator(seed).random((count, columns))
    expected = f"expected samples as a count or as numbers of shape (n, {columns}) in [0, 1)"
    try:
        array = real_numbers(samples)
    except ValueError:
        raise ArgumentError(f"{expected}, got {type(samples).__name__}") from None
    if array.ndim != 2 or array.shape[1] != columns:
        raise ArgumentError(f"{expected}, got shape {array.shape}")
    inside = (array >= 0.0) & (array < 1.0)  # The comparison is False for NaN.
    if not inside.all():
        raise ArgumentError(f"{expected}, got {array[~inside][0]}")
    return array


def _support(source: Any) -> Aperture | Slits:
    """Return the automean."""
    if isinstance(source, Array) and source.dimension > 1:
        return automean(source.support)
    if isinstance(source, Aperture):
        return automean(source)
    ends = np.concatenate([element.intervals for element in source.elements_in_plane]) / 2
    # The midpoints between two slits form an interval. With begins and ends sorted separately, the
    # union of all intervals has a gap between ends[k] and begins[k + 1] if that begin is larger.
    begins, ends = np.sort((ends[:, None] + ends).reshape(-1, 2), axis=0).T
    gaps = np.flatnonzero(begins[1:] > ends[:-1])
    return Slits(np.column_stack([begins[np.append(0, gaps + 1)], ends[np.append(gaps, -1)]]))


def _chosen(sizes: Floats, numbers: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Return the part that each number in [0, 1) selects by size, and the position in the part."""
    ends = np.cumsum(sizes)
    at = numbers * ends[-1]
    index = np.minimum(np.searchsorted(ends, at, side="right"), len(sizes) - 1)
    return index, np.clip((at - (ends[index] - sizes[index])) / sizes[index], 0.0, 1.0)
