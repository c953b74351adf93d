"""Random positions in the automean, for Monte Carlo sums of the Wigner function over position."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.engines import Engine, NumpyOperations
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, Slits, automean
from polywigner.geometry.trapezoids import point_in_trapezoid, trapezoids
from polywigner.kernels import kernel_for
from polywigner.transforms.phase_space import position_marginal

__all__ = ["Weights", "sample_automean"]

Weights = Literal["uniform", "marginal"]

Array = NDArray[np.float64]


def sample_automean(
    source: Aperture | Slits,
    samples: int | ArrayLike,
    weights: Weights = "uniform",
    *,
    seed: int | np.random.Generator | None = None,
    engine: Engine = "auto",
) -> tuple[Array, Array]:
    """Positions drawn from the automean, the support of W(., nu), and their probability density.

    The mean of ``W(x, nu)/density`` over the positions estimates ``int W dx = |F(nu)|^2``, without
    bias. Two densities, both exact:

    - ``"uniform"``: 1/area of the automean. The automean is cut into trapezoids by vertical lines;
      the unit square is mapped onto them so that area is preserved and neighbours mostly stay
      neighbours: stratified and quasi-random points stay so.
    - ``"marginal"``: ``R_x(x)/content^2``, with R_x of :func:`position_marginal`. The means
      ``(a + b)/2`` of two independent uniform points of the source follow precisely this density,
      so nothing is rejected or tabulated. Then W/density is ``content^2`` W/R_x, bounded by
      ``content^2``, and constant at nu = 0: far less noisy near the main lobe.

    Source: docs/projections.md, (P14) and (P15).

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), |u| = 1 on it.
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
    ArgumentError for arguments of the wrong type, shape or range; EngineError without the engine.
    """
    if not isinstance(source, Aperture | Slits):
        raise ArgumentError(f"expected an Aperture or Slits, got {type(source).__name__}")
    dimension = kernel_for("position_marginal", source).dimension
    if weights not in get_args(Weights):
        names = " or ".join(f'"{name}"' for name in get_args(Weights))
        raise ArgumentError(f"expected weights to be {names}, got {weights!r}")
    if weights == "uniform":
        numbers = _numbers(samples, dimension, seed)
        points, content = _uniform_map(_support(source))(numbers)
        return points, np.full(len(points), 1.0 / content)
    numbers = _numbers(samples, 2 * dimension, seed)
    place = _uniform_map(source)
    (first, content), (second, _) = place(numbers[:, :dimension]), place(numbers[:, dimension:])
    points = first / 2 + second / 2
    return points, position_marginal(source, points, engine=engine) / content**2


def _numbers(samples: Any, columns: int, seed: Any) -> Array:
    """(n, columns) numbers in [0, 1), those given or random ones."""
    if isinstance(samples, int | np.integer) and not isinstance(samples, bool):
        if samples < 1:
            raise ArgumentError(f"expected at least one sample, got {samples}")
        try:
            return np.random.default_rng(seed).random((int(samples), columns))
        except (TypeError, ValueError):
            raise ArgumentError(
                f"expected seed as a whole number of at least zero or a Generator, got {seed!r}"
            ) from None
    expected = f"expected samples as a count or as numbers of shape (n, {columns}) in [0, 1)"
    try:
        array = np.asarray(samples, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(f"{expected}, got {type(samples).__name__}") from None
    if array.ndim != 2 or array.shape[1] != columns:
        raise ArgumentError(f"{expected}, got shape {array.shape}")
    inside = (array >= 0.0) & (array < 1.0)  # false for what is not a number
    if not inside.all():
        raise ArgumentError(f"{expected}, got {array[~inside][0]}")
    return array


def _support(source: Aperture | Slits) -> Aperture | Slits:
    """The automean, of slits as well: the means of pairs of intervals, merged where they meet."""
    if isinstance(source, Aperture):
        return automean(source)
    ends = source.intervals / 2
    means = np.sort((ends[:, None] + ends).reshape(-1, 2), axis=0)
    # Sorted separately, begins and ends still bound the same union; it has a gap wherever a begin
    # lies beyond all ends before it.
    gaps = np.flatnonzero(means[1:, 0] > means[:-1, 1])
    return Slits(np.column_stack([means[np.append(0, gaps + 1), 0], means[np.append(gaps, -1), 1]]))


Map = Callable[[Array], tuple[Array, float]]


def _uniform_map(source: Aperture | Slits) -> Map:
    """The map of numbers (n, d) onto positions (n, d) that are uniform in a source; its content."""
    if isinstance(source, Slits):
        begins, widths = source.intervals[:, 0], np.diff(source.intervals)[:, 0]

        def on_slits(numbers: Array) -> tuple[Array, float]:
            index, u = _choice(widths, numbers[:, 0])
            return (begins[index] + u * widths[index])[:, None], source.length

        return on_slits
    # Relative to the centre: far from the origin, heights would lose digits.
    cells = trapezoids([ring - source.centre for ring in source.rings])
    ops = NumpyOperations(double=True)

    def in_trapezoids(numbers: Array) -> tuple[Array, float]:
        index, u = _choice(cells.areas, numbers[:, 0])
        row = [column[index] for column in cells.columns]
        place = point_in_trapezoid(ops, row, u, numbers[:, 1])
        return np.column_stack(place) + source.centre, source.area

    return in_trapezoids


def _choice(shares: Array, numbers: Array) -> tuple[NDArray[np.intp], Array]:
    """Which share each number in [0, 1) falls into, and where in it, again in [0, 1]."""
    ends = np.cumsum(shares)
    where = numbers * ends[-1]
    index = np.minimum(np.searchsorted(ends, where, side="right"), len(shares) - 1)
    return index, np.clip((where - (ends[index] - shares[index])) / shares[index], 0.0, 1.0)
