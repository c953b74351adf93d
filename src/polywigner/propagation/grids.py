"""Where fields are computed: points along lines, on planes and hemispheres, and in volumes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry.arguments import checked_count, checked_length
from polywigner.propagation.places import (
    angle_axes,
    checked_coordinates,
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
        axes = zip(self.coords.values(), first, shape, strict=True)
        along = np.ix_(*(axis.values[start : start + count] for axis, start, count in axes))
        steps = (a[..., None] * e for a, e in zip(along, self.directions, strict=True))
        return np.asarray(sum(steps, self.origin))


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
    low, high = _corners("box", box, "lowest and the highest")
    if (high < low).any():
        raise ArgumentError(
            f"expected a box from its lowest to its highest corner, got {low.tolist()} and "
            f"{high.tolist()}"
        )
    counts = _counts(shape, 3)
    spans = dict(zip(_AXES, zip(low, high, counts, strict=True), strict=True))
    return _straight_grid(spans, np.zeros(3), np.eye(3))


def plane_grid(where: Any, shape: Any) -> StraightGrid:
    """A plane: a box without thickness along one axis, or three corners of a rectangle."""
    expected = "expected a plane as a box (2, 3) of no thickness, or as three corners (3, 3)"
    corners = _checked(where, expected, 3)
    counts = _counts(shape, 2)
    if corners.shape == (2, 3):
        low, high = corners
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
        raise ArgumentError(f"{expected}, in m, got shape {corners.shape}")
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
    start, end = _corners("line", ends, "first and the last")
    length = float(np.linalg.norm(end - start))
    if length == 0:
        raise ArgumentError(f"expected a line between two points, got {start.tolist()} twice")
    count = checked_count(samples, "samples", 1)
    return _straight_grid({"distance": (0.0, length, count)}, start, (end - start)[None] / length)


def hemisphere_grid(radius: Any, theta: Any, phi: Any, centre: Any) -> Hemisphere:
    """Points at angles theta from the z axis and phi from the x axis about a centre."""
    length = checked_length(radius, "radius")
    middle = _checked(centre, "expected a centre (3,)", 3)
    if middle.ndim != 1:
        raise ArgumentError(f"expected a centre (3,), in metres, got shape {middle.shape}")
    grid = Hemisphere(angle_axes(checked_theta(theta), checked_phi(phi)), middle, length)
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


def _corners(name: str, corners: Any, which: str) -> Values:
    return _checked(corners, f"expected a {name} as two points (2, 3), the {which}", 2, 3)


def _checked(values: Any, expected: str, *shape: int) -> Values:
    array = checked_coordinates(values, expected, *shape)
    if array.ndim > 2 or array.size > 9:
        raise ArgumentError(f"{expected}, in metres, got shape {array.shape}")
    return array


def _counts(shape: Any, dimensions: int) -> Index:
    is_row = isinstance(shape, Sequence) or np.ndim(shape) == 1
    if not is_row or isinstance(shape, (str, bytes)) or len(shape) != dimensions:
        raise ArgumentError(
            f"expected a shape of {dimensions} whole numbers, got {value_text(shape)}"
        )
    return tuple(checked_count(n, "shape", 1) for n in shape)
