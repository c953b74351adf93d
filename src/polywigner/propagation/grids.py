"""Where fields are computed: points along lines, on planes and hemispheres, and in volumes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_count, checked_length, real_numbers, shape_of
from polywigner.propagation.places import (
    LARGEST,
    checked_phi,
    checked_points,
    checked_theta,
    unit_vectors,
)
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray


Values = NDArray[np.float64]
Index = tuple[int, ...]

_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class StraightGrid:
    """Points origin + sum of a_k e_k, for every value a_k of each axis k with direction e_k."""

    coords: dict[str, xarray.Variable]
    """Axis -> its values a_k (n_k,) in m, in the order of the dimensions."""
    origin: Values
    """(3,) in m."""
    directions: Values
    """(axes, 3)."""

    def points(self, first: Index, shape: Index) -> Values:
        """(*shape, 3) in m: those from the numbers ``first`` on."""
        found = np.broadcast_to(self.origin, (*shape, 3)).copy()
        for k, (axis, start, count) in enumerate(
            zip(self.coords.values(), first, shape, strict=True)
        ):
            along = axis.values[start : start + count]
            found += np.multiply.outer(along, self.directions[k]).reshape(
                *(count if n == k else 1 for n in range(len(shape))), 3
            )
        return found


@dataclass(frozen=True, eq=False)
class Hemisphere:
    """Points at one distance from a centre, for all angles of two lists."""

    coords: dict[str, xarray.Variable]
    """"theta" and "phi", in rad."""
    centre: Values
    radius: float

    def points(self, first: Index, shape: Index) -> Values:
        """(*shape, 3) in m: those from the numbers ``first`` on."""
        theta, phi = (
            axis.values[start : start + count]
            for axis, start, count in zip(self.coords.values(), first, shape, strict=True)
        )
        return self.centre + self.radius * unit_vectors(theta, phi)


Grid = StraightGrid | Hemisphere


def box_grid(box: Any, shape: Any) -> StraightGrid:
    """A volume: ``shape`` points along x, y and z, both faces of the box included."""
    low, high = _corners("box", box, ("lowest", "highest"))
    if (high < low).any():
        raise ArgumentError(
            f"expected a box from its lowest to its highest corner, got {low.tolist()} and "
            f"{high.tolist()}"
        )
    counts = _counts(shape, 3)
    return _straight_grid(
        {name: (low[k], high[k], counts[k]) for k, name in enumerate(_AXES)}, np.zeros(3), np.eye(3)
    )


def plane_grid(where: Any, shape: Any) -> StraightGrid:
    """A plane: a box without thickness along one axis, or three corners of a rectangle."""
    expected = "expected a plane as a box (2, 3) of no thickness, or as three corners (3, 3)"
    try:
        corners = real_numbers(where)
    except ValueError as error:
        raise ArgumentError(f"{expected}, in m, got {error}") from None
    counts = _counts(shape, 2)
    if corners.shape == (2, 3):
        low, high = _corners("plane", where, ("lowest", "highest"))
        flat = np.flatnonzero(low == high)
        if len(flat) != 1 or (high < low).any():
            raise ArgumentError(
                f"{expected}, got the box {low.tolist()} to {high.tolist()}; make one pair of "
                "coordinates equal, and the others ascending"
            )
        sides = [k for k in range(3) if k != flat[0]]
        spans = {_AXES[k]: (low[k], high[k], n) for k, n in zip(sides, counts, strict=True)}
        origin = np.where(np.arange(3) == flat[0], low, 0.0)
        return _straight_grid(spans, origin, np.eye(3)[sides])
    if corners.shape != (3, 3):
        raise ArgumentError(f"{expected}, in m, got shape {shape_of(where)}")
    _check_size(f"{expected}, in m", corners)
    along = corners[1:] - corners[0]
    lengths = np.linalg.norm(along, axis=1)
    if not lengths.all() or abs(along[0] @ along[1]) > 1e-9 * lengths.prod():
        raise ArgumentError(
            "expected three corners of a rectangle, the first between the others, got sides "
            f"{along[0].tolist()} and {along[1].tolist()}, which are not at right angles"
        )
    spans = {name: (0.0, lengths[k], counts[k]) for k, name in enumerate(("u", "v"))}
    return _straight_grid(spans, corners[0], along / lengths[:, None])


def line_grid(ends: Any, samples: Any) -> StraightGrid:
    """A line, both ends included, by the distance from its first end."""
    start, end = _corners("line", ends, ("first", "last"))
    length = float(np.linalg.norm(end - start))
    if length == 0:
        raise ArgumentError(f"expected a line between two points, got {start.tolist()} twice")
    count = checked_count(samples, "samples", 1)
    return _straight_grid({"distance": (0.0, length, count)}, start, (end - start)[None] / length)


def hemisphere_grid(radius: Any, theta: Any, phi: Any, centre: Any) -> Hemisphere:
    """Points at angles theta from the z axis and phi from the x axis about a centre."""
    length = checked_length(radius, "radius")
    try:
        middle = real_numbers(centre)
    except ValueError as error:
        raise ArgumentError(f"expected a centre (3,) in m, got {error}") from None
    if middle.shape != (3,):
        raise ArgumentError(f"expected a centre (3,) in m, got shape {shape_of(centre)}")
    _check_size("expected a centre and a radius", np.append(middle, length))
    axes = {
        "theta": labelled_array(
            checked_theta(theta), ("theta",), {"units": "rad", "long_name": "angle from z"}
        ),
        "phi": labelled_array(
            checked_phi(phi), ("phi",), {"units": "rad", "long_name": "angle from x"}
        ),
    }
    grid = Hemisphere(axes, middle, length)
    checked_points(grid.points((0, 0), shape_of_grid(grid)))
    return grid


def shape_of_grid(grid: Grid) -> Index:
    """The number of points along each axis."""
    return tuple(axis.shape[0] for axis in grid.coords.values())


def _straight_grid(
    spans: dict[str, tuple[float, float, int]], origin: Values, directions: Values
) -> StraightGrid:
    axes = {
        name: labelled_array(_span(*span), (name,), {"units": "m"}) for name, span in spans.items()
    }
    ends = np.array(np.meshgrid(*([low, high] for low, high, _ in spans.values()))).reshape(
        len(spans), -1
    )
    checked_points(origin + ends.T @ directions)
    return StraightGrid(axes, np.asarray(origin, np.float64), directions)


def _span(low: float, high: float, count: int) -> Values:
    """Both ends, or the middle if it is one value only."""
    return np.linspace(low, high, count) if count > 1 else np.array([low / 2 + high / 2])


def _corners(name: str, corners: Any, which: tuple[str, str]) -> Values:
    expected = f"expected a {name} as two points (2, 3) in m, the {which[0]} and the {which[1]}"
    try:
        array = real_numbers(corners)
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if array.shape != (2, 3):
        raise ArgumentError(f"{expected}, got shape {shape_of(corners)}")
    _check_size(expected, array)
    return array


def _check_size(expected: str, values: Values) -> None:
    if not (np.abs(values) <= LARGEST).all():
        raise ArgumentError(f"{expected}, finite, at most {LARGEST:g} m, got {values.tolist()}")


def _counts(shape: Any, dimensions: int) -> Index:
    is_row = isinstance(shape, Sequence) or np.ndim(shape) == 1
    if not is_row or isinstance(shape, (str, bytes)):
        raise ArgumentError(f"expected a shape of {dimensions} whole numbers, got {shape!r}")
    if len(shape) != dimensions:
        raise ArgumentError(f"expected a shape of {dimensions} whole numbers, got {shape!r}")
    return tuple(checked_count(n, "shape", 1) for n in shape)
