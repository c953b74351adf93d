"""Random positions in the automean, for Monte Carlo sums of the Wigner function over position."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, NumpyOperations
from polywigner.geometry import Aperture, Slits, automean
from polywigner.geometry.arguments import (
    checked_choice,
    checked_count,
    checked_generator,
    real_numbers,
)
from polywigner.geometry.convex import point_in_trapezoid, trapezoids
from polywigner.kernels import kernel_for
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.transforms.checked_calls import PhaseSpaceSource
from polywigner.transforms.phase_space import position_marginal
from polywigner.transforms.wavefronts import flat_source

Weights = Literal["uniform", "marginal"]

Values = NDArray[np.float64]
Element = Aperture | Slits


def sample_automean(
    source: PhaseSpaceSource,
    samples: int | ArrayLike,
    weights: Weights = "uniform",
    *,
    seed: int | np.random.Generator | None = None,
    engine: Engine = "auto",
) -> tuple[Values, Values]:
    """Draw positions from the automean, the support of W(., nu), with their probability density.

    The mean of ``W(x, nu)/density`` over the positions estimates ``int W dx = |F(nu)|^2`` without
    bias. Two densities, both exact, are available:

    - ``"uniform"``: 1/area of the automean. Vertical lines cut the automean into trapezoids, and
      the unit square is mapped onto them with equal areas. Neighbours mostly stay neighbours, so
      stratified and quasi-random points keep their properties.
    - ``"marginal"``: ``R_x(x)/content^2``, with R_x of :func:`position_marginal`. The means
      ``(a + b)/2`` of two independent uniform points of the source have this density, so nothing is
      rejected or tabulated. W/density is bounded by ``content^2`` and constant at nu = 0, with far
      less noise near the main lobe. Arrays use R_x of the array with the moduli of its weights.
      Under an illumination the sum of the moduli of its amplitudes replaces the field.

    Source: docs/projections.md, (P14) and (P15).

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        d = 2, or 1 for slits; only the flat source of a Wavefront matters.
    samples : int or array_like
        Number of samples, or numbers in [0, 1) to map: (n, d) for ``"uniform"``, (n, 2 d) for
        ``"marginal"``, where the first d numbers give a and the others b.
    weights : {"uniform", "marginal"}
        The density.
    seed : int or numpy.random.Generator, optional
        Seed of the random numbers.
    engine : str, optional
        See :func:`fourier`; computes R_x.

    Returns
    -------
    positions : float ndarray (n, d)
        In m.
    density : float ndarray (n,)
        In 1/m^d.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, shape or range.
    GeometryError
        For an Array with elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> positions, density = pw.sample_automean(pw.shapes.square(1.0), 100, seed=1)
    >>> positions.shape, round(float(density.sum()), 6)
    ((100, 2), 100.0)
    """
    flat: Any = flat_source(source)  # a curved wave has the same support and modulus
    dimension = kernel_for("wigner", flat).dimension
    checked_choice(weights, "weights", get_args(Weights))
    if weights == "uniform":
        numbers = _numbers(samples, dimension, seed)
        points, content = _uniform_map([(_support(flat), 1.0)])(numbers)
        return points, np.full(len(points), 1.0 / content)
    numbers = _numbers(samples, 2 * dimension, seed)
    bound = in_phase(flat)
    mapped = _uniform_map(_elements(bound))
    (first, content), (second, _) = mapped(numbers[:, :dimension]), mapped(numbers[:, dimension:])
    points = first / 2 + second / 2
    return points, position_marginal(bound, points, engine=engine) / content**2


def in_phase(source: Aperture | Slits | Array) -> Aperture | Slits | Array:
    """Return the source with a constant field in phase on each element, a bound on its field."""
    if not isinstance(source, Array):
        return source.with_illumination(None)
    elements = normal_form(source).in_plane.elements
    bounds = [abs(e.weight) * np.abs(e.amplitudes).sum() for e in elements]
    return Array([element.outline for element in elements], bounds)


# Largest number of samples.
_MOST_SAMPLES = 1 << 28


def _numbers(samples: Any, columns: int, seed: Any) -> Values:
    """Return the given or random numbers (n, columns) in [0, 1)."""
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
    inside = (array >= 0.0) & (array < 1.0)  # False for NaN
    if not inside.all():
        raise ArgumentError(f"{expected}, got {array[~inside][0]}")
    return array


def _elements(source: Any) -> list[tuple[Element, float]]:
    """Return slits or apertures, and the modulus of the field on each."""
    moduli: list[float] = abs(source.weights).tolist() if isinstance(source, Array) else [1.0]
    return [pair for pair in zip(source.elements_in_plane, moduli, strict=True) if pair[1] > 0]


def _support(source: Any) -> Element:
    """Return the automean."""
    if isinstance(source, Array) and source.dimension > 1:
        return automean(source.support)
    if isinstance(source, Aperture):
        return automean(source)
    ends = np.concatenate([e.intervals for e in source.elements_in_plane]) / 2
    return Slits(_merged((ends[:, None] + ends).reshape(-1, 2)))


def _merged(intervals: Values) -> Values:
    """Return the union of intervals (m, 2)."""
    # Separately sorted begins and ends bound the same union, with a gap if a begin exceeds all ends
    # before it.
    begins, ends = np.sort(intervals, axis=0).T
    gaps = np.flatnonzero(begins[1:] > ends[:-1])
    return np.column_stack([begins[np.append(0, gaps + 1)], ends[np.append(gaps, -1)]])


Map = Callable[[Values], tuple[Values, float]]


def _uniform_map(elements: Sequence[tuple[Element, float]]) -> Map:
    """Return the map of numbers (n, d) to positions (n, d) with densities proportional to moduli.

    The map also returns the sum of contents times moduli.
    """
    tables = [_cells(element) for element, _ in elements]
    moduli = np.repeat([modulus for _, modulus in elements], [len(t[0]) for t in tables])
    areas, origin, *columns = (np.concatenate(parts) for parts in zip(*tables, strict=True))
    content = sum(modulus * _content(element) for element, modulus in elements)
    ops = NumpyOperations()

    def mapped(numbers: Values) -> tuple[Values, float]:
        index, u = _choice(moduli * areas, numbers[:, 0])
        row = [column[index] for column in columns]
        if numbers.shape[1] == 1:
            inner = [row[0] + u * row[1]]
        else:
            inner = list(point_in_trapezoid(ops, row, u, numbers[:, 1]))
        return np.column_stack(inner) + origin[index], content

    return mapped


def _cells(element: Element) -> tuple[Values, ...]:
    """Return contents, origins and columns of an element's intervals or trapezoids."""
    if isinstance(element, Slits):
        begins, widths = element.intervals[:, 0], np.diff(element.intervals)[:, 0]
        return widths, np.zeros((len(begins), 1)), begins, widths
    # Relative to the centre: heights would lose digits far from the origin.
    cells = trapezoids([ring - element.centre for ring in element.rings])
    return cells.areas, np.tile(element.centre, (len(cells.areas), 1)), *cells


def _content(element: Element) -> float:
    return element.length if isinstance(element, Slits) else element.area


def _choice(contents: Values, numbers: Values) -> tuple[NDArray[np.intp], Values]:
    """Return the index of the part that each number in [0, 1) selects, and its position there."""
    ends = np.cumsum(contents)
    at = numbers * ends[-1]
    index = np.minimum(np.searchsorted(ends, at, side="right"), len(contents) - 1)
    return index, np.clip((at - (ends[index] - contents[index])) / contents[index], 0.0, 1.0)
