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
from polywigner.transforms.wavefronts import flat_of

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
    """Positions drawn from the automean, the support of W(., nu), and their probability density.

    The mean of ``W(x, nu)/density`` over the positions estimates ``int W dx = |F(nu)|^2``, without
    bias. Two densities, both exact:

    - ``"uniform"``: 1/area of the automean. The automean is cut into trapezoids by vertical lines;
      the unit square is mapped onto them so that area is preserved and neighbours mostly stay
      neighbours: stratified and quasi-random points stay so.
    - ``"marginal"``: ``R_x(x)/content^2``, with R_x of :func:`position_marginal`. The means
      ``(a + b)/2`` of two independent uniform points of the source follow precisely this density,
      so nothing is rejected or tabulated. Then W/density is ``content^2`` W/R_x, bounded by
      ``content^2``, and constant at nu = 0: far less noisy near the main lobe. Of an Array: R_x of
      the array with the moduli of its weights (its own may be negative), and its content, with
      the same bound. Where there is an illumination, its largest possible modulus, the sum of
      those of its amplitudes, stands for it.

    Source: docs/projections.md, (P14) and (P15).

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), or an Array of either; or one with another wave, of
        which only the flat source matters.
    samples : how many, or the numbers to map, each in [0, 1): (n, d) for ``"uniform"``, (n, 2 d)
        for ``"marginal"`` (the first d numbers make a, the others b).
    weights : the density.
    seed : of the random numbers, or a NumPy Generator; of no effect where ``samples`` are numbers.
    engine : see :func:`fourier`; computes R_x.

    Returns
    -------
    (n, d) positions in m and (n,) their density in 1/m^d, float64.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

    >>> import polywigner as pw
    >>> places, weights = pw.sample_automean(pw.shapes.square(1.0), 100, seed=1)
    >>> places.shape, round(float(weights.sum()), 6)
    ((100, 2), 100.0)
    """
    flat: Any = flat_of(source)  # a curved wave has the same support and modulus
    dimension = kernel_for("wigner", flat).dimension
    checked_choice(weights, "weights", get_args(Weights))
    if weights == "uniform":
        numbers = _numbers(samples, dimension, seed)
        points, content = _uniform_map([(_support(flat), 1.0)])(numbers)
        return points, np.full(len(points), 1.0 / content)
    numbers = _numbers(samples, 2 * dimension, seed)
    bound = in_phase(flat)
    place = _uniform_map(_elements(bound))
    (first, content), (second, _) = place(numbers[:, :dimension]), place(numbers[:, dimension:])
    points = first / 2 + second / 2
    return points, position_marginal(bound, points, engine=engine) / content**2


def in_phase(source: Aperture | Slits | Array) -> Aperture | Slits | Array:
    """Return the source with a constant field in phase on each element, a bound on its field."""
    if not isinstance(source, Array):
        return source.with_illumination(None)
    elements = normal_form(source).in_plane.elements
    bounds = [abs(e.weight) * np.abs(e.amplitudes).sum() for e in elements]
    return Array([element.outline for element in elements], bounds)


# More numbers fill any memory.
_MOST_SAMPLES = 1 << 28


def _numbers(samples: Any, columns: int, seed: Any) -> Values:
    """(n, columns) numbers in [0, 1), those given or random ones."""
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
    inside = (array >= 0.0) & (array < 1.0)  # false for what is not a number
    if not inside.all():
        raise ArgumentError(f"{expected}, got {array[~inside][0]}")
    return array


def _elements(source: Any) -> list[tuple[Element, float]]:
    """Slits or apertures, and the modulus of the field on each."""
    moduli: list[float] = abs(source.weights).tolist() if isinstance(source, Array) else [1.0]
    return [pair for pair in zip(source.elements_in_plane, moduli, strict=True) if pair[1] > 0]


def _support(source: Any) -> Element:
    """The automean, of slits as well."""
    if isinstance(source, Array) and source.dimension > 1:
        return automean(source.support)
    if isinstance(source, Aperture):
        return automean(source)
    ends = np.concatenate([e.intervals for e in source.elements_in_plane]) / 2
    return Slits(_merged((ends[:, None] + ends).reshape(-1, 2)))


def _merged(intervals: Values) -> Values:
    """The union of intervals (m, 2)."""
    # Sorted separately, begins and ends still bound the same union; it has a gap wherever a begin
    # lies beyond all ends before it.
    begins, ends = np.sort(intervals, axis=0).T
    gaps = np.flatnonzero(begins[1:] > ends[:-1])
    return np.column_stack([begins[np.append(0, gaps + 1)], ends[np.append(gaps, -1)]])


Map = Callable[[Values], tuple[Values, float]]


def _uniform_map(elements: Sequence[tuple[Element, float]]) -> Map:
    """The map of numbers (n, d) onto positions (n, d), with densities in proportion to the moduli.

    It returns the sum of contents times moduli as well.
    """
    tables = [_cells(element) for element, _ in elements]
    moduli = np.repeat([modulus for _, modulus in elements], [len(t[0]) for t in tables])
    areas, origin, *columns = (np.concatenate(parts) for parts in zip(*tables, strict=True))
    content = sum(modulus * _content(element) for element, modulus in elements)
    ops = NumpyOperations(double=True)

    def place(numbers: Values) -> tuple[Values, float]:
        index, u = _choice(moduli * areas, numbers[:, 0])
        row = [column[index] for column in columns]
        if numbers.shape[1] == 1:
            inner = [row[0] + u * row[1]]
        else:
            inner = list(point_in_trapezoid(ops, row, u, numbers[:, 1]))
        return np.column_stack(inner) + origin[index], content

    return place


def _cells(element: Element) -> tuple[Values, ...]:
    """Contents, origins and columns of the intervals or trapezoids of an element."""
    if isinstance(element, Slits):
        begins, widths = element.intervals[:, 0], np.diff(element.intervals)[:, 0]
        return widths, np.zeros((len(begins), 1)), begins, widths
    # Relative to the centre: far from the origin, heights would lose digits.
    cells = trapezoids([ring - element.centre for ring in element.rings])
    return cells.areas, np.tile(element.centre, (len(cells.areas), 1)), *cells.columns


def _content(element: Element) -> float:
    return element.length if isinstance(element, Slits) else element.area


def _choice(shares: Values, numbers: Values) -> tuple[NDArray[np.intp], Values]:
    """Index of the share that each number in [0, 1) falls into, and its place there in [0, 1]."""
    ends = np.cumsum(shares)
    where = numbers * ends[-1]
    index = np.minimum(np.searchsorted(ends, where, side="right"), len(shares) - 1)
    return index, np.clip((where - (ends[index] - shares[index])) / shares[index], 0.0, 1.0)
