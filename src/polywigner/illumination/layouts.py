"""Positions of the elements of arrays, in metres.

Coordinates of lattices are whole multiples of half (of triangular ones: a quarter of) the pitch,
each rounded once, so that a lattice can be told from its coordinates. All layouts are centred at
the origin.
"""

from __future__ import annotations

import math
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_count, checked_length, checked_number, shape_of
from polywigner.geometry.numbers import real_numbers

__all__ = [
    "MOST_ELEMENTS",
    "checked_positions",
    "grid_positions",
    "ring_positions",
    "thinned",
    "triangular_positions",
]

MOST_ELEMENTS = 2**20
"""Most elements of one layout: 16 MiB of positions."""

Positions = NDArray[np.float64]


def grid_positions(nx: int, ny: int, pitch_x: float, pitch_y: float | None = None) -> Positions:
    """A rectangular lattice: (nx ny, 2), y running fastest.

    `grid_positions(nx, ny, ...).reshape(nx, ny, 2)[i, j]` is at
    ((i - (nx - 1)/2) pitch_x, (j - (ny - 1)/2) pitch_y). Slits take the x of one row,
    `grid_positions(n, 1, pitch)[:, 0]`.

    Parameters
    ----------
    nx, ny
        Elements along x and y.
    pitch_x, pitch_y
        Distances in metres; pitch_y None: the same.

    Raises
    ------
    ArgumentError for counts below 1, more than 2^20 elements, and pitches that are not above zero.
    """
    columns, rows = _counts(nx, ny)
    across = checked_length(pitch_x, "pitch_x")
    up = across if pitch_y is None else checked_length(pitch_y, "pitch_y")
    along_x, along_y = _steps(columns) * (across / 2), _steps(rows) * (up / 2)
    return _pairs(*np.meshgrid(along_x, along_y, indexing="ij"))


def triangular_positions(
    nx: int, ny: int, pitch_x: float, pitch_y: float | None = None
) -> Positions:
    """A triangular lattice: ny rows of nx elements, every other one shifted by half a pitch.

    (nx ny, 2), y running fastest. Even rows are a quarter of pitch_x to the left of where
    :func:`grid_positions` has them, odd rows a quarter to the right.

    Parameters
    ----------
    nx, ny
        Elements of a row, and rows.
    pitch_x, pitch_y
        Distance in a row, and between rows, in metres. pitch_y None: sqrt(3)/2 pitch_x, which
        makes the triangles equilateral.

    Raises
    ------
    ArgumentError for counts below 1, more than 2^20 elements, and pitches that are not above zero.
    """
    columns, rows = _counts(nx, ny)
    across = checked_length(pitch_x, "pitch_x")
    up = across * math.sqrt(0.75) if pitch_y is None else checked_length(pitch_y, "pitch_y")
    side = 2 * (np.arange(rows) % 2) - 1 if rows > 1 else np.zeros(1, np.int64)
    along_x = (2 * _steps(columns)[:, None] + side) * (across / 4)
    along_y = _steps(rows) * (up / 2)
    return _pairs(along_x, np.broadcast_to(along_y, along_x.shape))


def ring_positions(radii: ArrayLike, counts: ArrayLike) -> Positions:
    """Concentric rings: counts[k] elements at equal angles on the circle of radius radii[k].

    (sum of counts, 2), ring after ring, each counter-clockwise from the x axis. A radius of 0 with
    a count of 1 is an element at the centre.

    Raises
    ------
    ArgumentError for radii below zero, counts below 1, several elements at the centre, another
    number of counts than of radii, and more than 2^20 elements.
    """
    sizes = [checked_length(r, "each of the radii", zero=True) for r in _listed(radii)]
    numbers = [checked_count(n, "each of the counts", 1, MOST_ELEMENTS) for n in _listed(counts)]
    if len(sizes) != len(numbers) or not sizes:
        raise ArgumentError(
            f"expected as many radii as counts, got {len(sizes)} radii and {len(numbers)} counts"
        )
    _check_number(sum(numbers))
    if any(size == 0 and number > 1 for size, number in zip(sizes, numbers, strict=True)):
        raise ArgumentError("expected one element at radius 0, got several; give a count of 1")
    turns = [2 * np.pi * np.arange(n) / n for n in numbers]
    rings = [r * np.stack([np.cos(t), np.sin(t)], 1) for r, t in zip(sizes, turns, strict=True)]
    return np.concatenate(rings) + 0.0


@overload
def thinned(
    positions: ArrayLike,
    fill: float,
    seed: int,
    taper: ArrayLike | None = None,
    return_index: Literal[False] = False,
) -> Positions: ...


@overload
def thinned(
    positions: ArrayLike,
    fill: float,
    seed: int,
    taper: ArrayLike | None = None,
    *,
    return_index: Literal[True],
) -> tuple[Positions, NDArray[np.intp]]: ...


def thinned(
    positions: ArrayLike,
    fill: float,
    seed: int,
    taper: ArrayLike | None = None,
    return_index: bool = False,
) -> Positions | tuple[Positions, NDArray[np.intp]]:
    """Positions drawn at random from a full layout: statistical thinning.

    Each element is kept, independently of the others, with a probability p_k proportional to the
    taper, and on average fill times n are. With weights of 1 the mean pattern is then that of the
    tapered full array, plus a floor:

        <|AF|^2> = |sum_k p_k exp(-2 pi i nu.x_k)|^2 + sum_k p_k (1 - p_k)

    M. I. Skolnik, J. W. Sherman, F. C. Ogg, IEEE Trans. Antennas Propag. 12 (1964) 408-417.

    Parameters
    ----------
    positions
        (n, 2) in metres; for slits (n,) or (n, 1); in space (n, 3).
    fill
        The fraction kept on average, above 0 and up to 1, or up to mean/peak of the taper.
    seed
        Of NumPy's default generator: equal seeds draw equal elements.
    taper
        (n,) real weights of the full array, of zero or more; None: all equal.
    return_index
        See below.

    Returns
    -------
    (m, d), in the order given, the very same floats. With `return_index` also their numbers (m,)
    in the full layout, for weights of it: `window_weights(...)[index]`.

    Raises
    ------
    ArgumentError for positions, tapers, fills and seeds out of shape or range, and if no element
    was drawn.
    """
    places = checked_positions(positions, (1, 2, 3))
    share = checked_number(fill, "fill", "a fraction above 0 and up to 1")
    try:
        likely = np.ones(len(places)) if taper is None else real_numbers(taper)
    except ValueError:
        raise ArgumentError(
            f"expected a taper of real numbers, got {type(taper).__name__}; give the moduli of "
            "complex weights"
        ) from None
    if likely.shape != places.shape[:1] or not (likely >= 0).all() or not likely.any():
        raise ArgumentError(
            f"expected a taper of {len(places)} weights of zero or more, got shape {likely.shape}"
            + (" with negative ones, or zeros only" if likely.shape == places.shape[:1] else "")
        )
    most = float(likely.mean() / likely.max())
    if not 0 < share <= most:
        raise ArgumentError(
            f"expected fill above 0 and up to {most:.6g} (mean/peak of the taper), got {fill!r}"
        )
    random = np.random.default_rng(checked_count(seed, "seed", 0))
    kept = random.random(len(places)) < likely * (share / float(likely.mean()))
    if not kept.any():
        raise ArgumentError("expected an element to be drawn, got none; try another seed")
    return (places[kept], np.flatnonzero(kept)) if return_index else places[kept]


def checked_positions(positions: Any, components: tuple[int, ...]) -> Positions:
    """Finite positions (n, d) with a d out of `components`, (n,) standing for (n, 1).

    Raises ArgumentError for anything else.
    """
    try:
        places = real_numbers(positions)
    except ValueError:
        places = np.empty(0)
    if places.ndim == 1 and 1 in components:
        places = places[:, None]
    fits = places.ndim == 2 and places.shape[1] in components and len(places)
    if not fits or not np.isfinite(places).all():
        shapes = " or ".join(f"(n, {c})" for c in components)
        raise ArgumentError(
            f"expected finite positions of shape {shapes}, got {shape_of(positions)}"
        )
    return places


def _listed(values: Any) -> list[Any]:
    return list(values) if np.iterable(values) else [values]


def _counts(nx: Any, ny: Any) -> tuple[int, int]:
    columns, rows = checked_count(nx, "nx", 1), checked_count(ny, "ny", 1)
    _check_number(columns * rows)
    return columns, rows


def _check_number(elements: int) -> None:
    if elements > MOST_ELEMENTS:
        raise ArgumentError(f"expected at most {MOST_ELEMENTS} elements, got {elements}")


def _steps(count: int) -> NDArray[np.int64]:
    """-(n - 1), -(n - 3), ..., n - 1: twice the centred numbers, whole."""
    return 2 * np.arange(count) - (count - 1)


def _pairs(x: NDArray[Any], y: NDArray[Any]) -> Positions:
    return np.stack([x, y], axis=-1).reshape(-1, 2)
