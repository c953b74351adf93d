"""Checks of points, angles, methods and tolerances, and grids of points."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry.arguments import (
    checked_count,
    checked_length,
    checked_number,
    checked_row,
    finite_array,
    warn_caller,
)
from polywigner.numerics import Floats
from polywigner.source.obliquities import BoundaryCondition
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

Index = tuple[int, ...]

_AXES = ("x", "y", "z")


def checked_theta_and_phi(theta: Any, phi: Any) -> tuple[Floats, Floats]:
    """Return theta (n,) from -pi to pi and phi (m,) in rad, or raise ArgumentError."""
    return checked_angles(theta, "theta", math.pi), checked_angles(phi, "phi", math.inf)


_ANGLES = {
    "theta": "angle from z",
    "phi": "angle from x",
    "azimuth": "angle about z from x",
    "elevation": "angle above z = 0",
}


def angle_axes(**angles: Floats) -> dict[str, xarray.Variable]:
    """Return angles (n,) in rad as coordinates of a dataset, by their names in `_ANGLES`."""
    return {
        name: labelled_array(values, (name,), {"units": "rad", "long_name": _ANGLES[name]})
        for name, values in angles.items()
    }


def unit_vectors(theta: Floats, phi: Floats) -> Floats:
    """Return unit vectors (n, m, 3) at angles theta (n,) and phi (m,) in rad."""
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    # The horizon belongs to both the front and the back, so the cosine must be 0 there. In floating
    # point, cos(pi/2) is 6e-17.
    cosine = np.where(np.abs(cosine) < 1e-15, 0.0, cosine)
    parts = np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), cosine)
    return np.stack(parts, axis=-1)


def checked_angles(values: Any, name: str, largest: float) -> Floats:
    """Return angles (n,) in rad; raise ArgumentError if one exceeds ``largest`` in magnitude."""
    expected = f"expected {name} to be angles (n,) in rad"
    angles = checked_row(values, expected)
    if not np.isfinite(angles).all() or np.abs(angles).max() > largest * (1 + 1e-12):
        raise ArgumentError(
            f"{expected}, finite and from -{largest:.4g} to {largest:.4g}, got "
            f"{value_text(values)}; convert degrees with numpy.radians"
        )
    return angles


Method = Literal[BoundaryCondition, "fresnel", "fraunhofer"]

METHODS: tuple[str, ...] = get_args(Method)
"""Names of the methods of :func:`amplitude`."""

DEFAULT_TOLERANCE = 1e-9
"""Default relative error of fields."""

# Smallest tolerance, some tens of times a rounding error.
_LEAST = 1e-13


def checked_coordinates(points: Any, expected: str, components: int) -> Floats:
    """Return finite coordinates (..., components) in m; error messages start with ``expected``."""
    return finite_array(points, f"{expected}, in metres", (..., components))


def checked_points(points: Any) -> Floats:
    """Return points (..., 3) in m with z > 0; raise ArgumentError for other values."""
    expected = (
        "expected points to be real numbers of shape (..., 3), with x, y and z along the last axis"
    )
    array = checked_coordinates(points, expected, 3)
    behind = array[..., 2] <= 0
    if behind.any():
        raise ArgumentError(
            f"expected points in front of the source (z > 0), got {array[behind][0].tolist()}; "
            "sources lie in the plane z = 0 and radiate towards +z"
        )
    return array


def tolerance_from(
    tolerance: float | None,
    default: float = DEFAULT_TOLERANCE,
    least: float = _LEAST,
    where: str = "",
) -> float:
    """Return a tolerance from ``least`` to 0.1, or ``default`` for None.

    Raises ArgumentError for other values. ``where`` is appended to the range in the error message.
    """
    if tolerance is None:
        return default
    meaning = f"a number from {least:g} to 0.1{where}"
    return checked_number(tolerance, "tolerance", meaning, lambda x: least <= x <= 0.1)


def warn_of_missed(errors: Floats, allowed: Floats, what: str) -> None:
    """Warn if estimated errors (n,) are NaN or exceed the allowed errors (n,).

    ``what`` is a plural noun for the values in the message, such as "points".
    """
    missed = ~(errors <= allowed)
    if missed.any():
        worst = float((errors[missed] / allowed[missed]).max())
        warn_caller(
            f"{int(missed.sum())} of {len(errors)} {what} have an estimated error above the "
            f"tolerance, at most {worst:.3g} times the allowed error; pass a larger tolerance"
        )


@dataclass(frozen=True, eq=False)
class Grid:
    """A grid of points, with its axes as coordinates of a dataset."""

    coords: dict[str, xarray.Variable]
    """Axes in m or rad."""
    points_at: Callable[..., Floats]
    """Function of coordinates (n,), (m,), ... that returns points (n, m, ..., 3) in m."""

    @property
    def shape(self) -> Index:
        """Number of points along each axis."""
        return tuple(axis.size for axis in self.coords.values())

    def points(self, first: Index, shape: Index) -> Floats:
        """Return the block of points in m that starts at the index ``first``, shape (*shape, 3)."""
        axes = zip(self.coords.values(), first, shape, strict=True)
        return self.points_at(*(axis.values[start : start + count] for axis, start, count in axes))


def _affine(origin: Floats, directions: Floats, *along: Floats) -> Floats:
    """Return points (n, m, ..., 3) for all combinations of distances along unit vectors (k, 3).

    ``along`` contains k arrays (n,), (m,), ... of distances from the origin.
    """
    steps = (a[..., None] * e for a, e in zip(np.ix_(*along), directions, strict=True))
    return np.asarray(sum(steps, origin))


def _spherical(centre: Floats, radius: float, theta: Floats, phi: Floats) -> Floats:
    """Return points (n, m, 3) on a sphere about ``centre``, at angles in rad."""
    return centre + radius * unit_vectors(theta, phi)


def box_grid(box: Any, shape: Any) -> Grid:
    """Return a grid over x, y and z in a box, including the faces of the box.

    ``box`` (2, 3) contains the lowest and the highest corner in m, with z > 0. ``shape`` contains
    the numbers of points along the three axes.
    """
    low, high = _corners("box", box, "lowest and the highest")
    if (high < low).any():
        raise ArgumentError(
            f"expected the lowest corner of the box, then its highest corner, got {low.tolist()} "
            f"and {high.tolist()}; swap the descending coordinates"
        )
    counts = _counts(shape, 3)
    spans = dict(zip(_AXES, zip(low, high, counts, strict=True), strict=True))
    return _affine_grid(spans, np.zeros(3), np.eye(3))


def plane_grid(where: Any, shape: Any) -> Grid:
    """Return a grid on a rectangle with z > 0 that is specified by a flat box or by three corners.

    For a box (2, 3), the axes are two of x, y and z. All lengths are in m. For corners (3, 3), the
    axes are the distances u and v from the first corner towards the second and the third corner.
    ``shape`` contains the numbers of points along both axes.
    """
    expected = "expected a plane as a box (2, 3) of zero thickness, or as three corners (3, 3)"
    corners = finite_array(where, f"{expected}, in metres", (2, 3), (3, 3))
    counts = _counts(shape, 2)
    if corners.shape == (2, 3):
        low, high = corners
        flat = np.flatnonzero(low == high)
        if len(flat) != 1 or (high < low).any():
            raise ArgumentError(
                f"{expected}, got the box from {low.tolist()} to {high.tolist()}; make exactly "
                "one pair of coordinates equal, and the others ascending"
            )
        sides = [k for k in range(3) if k != flat[0]]
        spans = {_AXES[k]: (low[k], high[k], n) for k, n in zip(sides, counts, strict=True)}
        origin = np.where(np.arange(3) == flat[0], low, 0.0)
        return _affine_grid(spans, origin, np.eye(3)[sides])
    along = corners[1:] - corners[0]
    lengths = np.linalg.norm(along, axis=1)
    if not lengths.all() or abs(along[0] @ along[1]) > 1e-9 * lengths.prod():
        raise ArgumentError(
            "expected three corners of a rectangle, the first adjacent to the other two, got "
            f"sides {along[0].tolist()} and {along[1].tolist()} that are not perpendicular"
        )
    spans = {name: (0.0, lengths[k], counts[k]) for k, name in enumerate(("u", "v"))}
    return _affine_grid(spans, corners[0], along / lengths[:, None])


def line_grid(ends: Any, samples: Any) -> Grid:
    """Return a grid of points along a line, over the distance in m from its first end.

    ``ends`` (2, 3) are in m. ``samples`` is the number of points, including both ends.
    """
    start, end = _corners("line", ends, "first and the last")
    length = float(np.linalg.norm(end - start))
    if length == 0:
        raise ArgumentError(
            f"expected a line between two different points, got {start.tolist()} twice"
        )
    count = checked_count(samples, "samples", 1)
    return _affine_grid({"distance": (0.0, length, count)}, start, (end - start)[None] / length)


def hemisphere_grid(radius: Any, theta: Any, phi: Any, centre: Any) -> Grid:
    """Return a grid on a hemisphere, over theta (n,) and phi (m,) in rad.

    ``radius`` and ``centre`` (3,) are in m. Raises ArgumentError if a point does not have z > 0.
    """
    length = checked_length(radius, "radius")
    origin = finite_array(centre, "expected a centre of shape (3,), in metres", (3,))
    points_at = partial(_spherical, origin, length)
    angles = checked_theta_and_phi(theta, phi)
    grid = Grid(angle_axes(theta=angles[0], phi=angles[1]), points_at)
    checked_points(grid.points((0, 0), grid.shape))
    return grid


def _affine_grid(
    spans: dict[str, tuple[float, float, int]], origin: Floats, directions: Floats
) -> Grid:
    """Return a grid of points from an origin and distances along unit vectors (k, 3).

    ``spans`` contains the first value in m, the last value in m, and the number of points of each
    axis, by name.
    """
    axes = {
        name: labelled_array(_axis(*span), (name,), {"units": "m"}) for name, span in spans.items()
    }
    points_at = partial(_affine, origin, directions)
    checked_points(points_at(*(np.array([low, high]) for low, high, _ in spans.values())))
    return Grid(axes, points_at)


def _axis(low: float, high: float, count: int) -> Floats:
    """Return evenly spaced values, or the midpoint if ``count`` is 1."""
    return np.linspace(low, high, count) if count > 1 else np.array([low / 2 + high / 2])


def _corners(name: str, corners: Any, which: str) -> Floats:
    """Return two points (2, 3) in m.

    Error messages use ``name``, such as "box", and ``which``, such as "lowest and highest corner".
    """
    expected = f"expected a {name} as two points of shape (2, 3), the {which}, in metres"
    return finite_array(corners, expected, (2, 3))


def _counts(shape: Any, dimensions: int) -> Index:
    """Return numbers of points; raise ArgumentError unless each dimension has one number."""
    is_row = isinstance(shape, Sequence) or np.ndim(shape) == 1
    if not is_row or isinstance(shape, (str, bytes)) or len(shape) != dimensions:
        raise ArgumentError(f"expected shape to be {dimensions} integers, got {value_text(shape)}")
    return tuple(checked_count(n, "shape", 1) for n in shape)
