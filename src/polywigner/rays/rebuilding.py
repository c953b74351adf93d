"""Irradiance from rays: their watts in the pixels of a plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import (
    checked_count,
    checked_number,
    real_numbers,
    rigid_pose,
    shape_of,
)
from polywigner.rays.bundles import MOST_BATCHES, checked_bundle, count_of

if TYPE_CHECKING:
    import xarray


Values = NDArray[np.float64]

# Most pixels along an axis, and in all; most sums, those of 16 batches: 1 GB.
_MOST_PIXELS = 1 << 14
_MOST_IN_ALL = 1 << 22
_MOST_SUMS = 1 << 26
# Rays at a time: some 100 MB.
_BLOCK = 1 << 20
# Rays that end on a plane lie on it to rounding: of their largest coordinate.
_ON_PLANE = 1e-9


def rebuild(
    rays: xarray.Dataset,
    plane: float | ArrayLike,
    bounds: ArrayLike,
    shape: tuple[int, int],
    *,
    virtual: bool = False,
) -> xarray.Dataset:
    """Irradiance on a plane that rays meet: the sum of their weights in each pixel over its area.

    The mean over a pixel, without bias, of the power per area that rays bring: |U|^2 of Wigner rays
    times the cosine between ray and normal of the plane (docs/signed_rays.md, (Y2)). Rays go on in
    straight lines.

    Parameters
    ----------
    rays : from :func:`polywigner.sample_rays`, :func:`load` or :func:`traced`.
    plane : z in m of a plane parallel to x and y; or a (4, 4) pose whose plane z = 0 it is.
    bounds : (xmin, ymin, xmax, ymax) in m of the grid of pixels, in the frame of the plane.
    shape : how many pixels along x and y.
    virtual : whether rays count that would meet the plane going backwards, as those of a virtual
        image do.

    Returns
    -------
    xarray.Dataset with ``irradiance`` (y, x) and its ``standard_error`` (y, x) in W/m^2, over y and
    x of the pixels' middles in m: a picture whose rows are along x, the first at the bottom, as
    ``plt.imshow(found.irradiance, origin="lower")`` shows it. Of independent rays the error follows
    from the squares of their weights, of quasi-random ones from the scatter of 16 batches: it is
    then known to a fifth. Attributes: ``power`` and ``power_error``, the sum in the grid in W;
    ``lost``, how many rays have NaN; ``missed``, how many do not meet the grid.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for a pose that is
    not rigid; MissingExtraError without xarray.

    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 4096)
    >>> found = pw.rays.rebuild(rays, 0.1, (-0.03, -0.02, 0.03, 0.02), (6, 4))
    >>> found.irradiance.dims, found.irradiance.shape
    (('y', 'x'), (4, 6))
    """
    position, direction, weight, batch = checked_bundle(rays)
    pose = _pose(plane)
    if not isinstance(virtual, bool | np.bool_):
        raise ArgumentError(f"expected virtual as True or False, got {virtual!r}")
    edges = _edges(bounds, shape)
    size = len(edges[0]) - 1, len(edges[1]) - 1
    batches, number = _batches(batch, size[0] * size[1])
    sums = np.zeros((batches, size[0] * size[1] + 1))
    squares = np.zeros(size[0] * size[1] + 1)
    lost = missed = 0
    for start in range(0, len(weight), _BLOCK):
        some = slice(start, start + _BLOCK)
        pixel = _pixels(position[some], direction[some], pose, edges, virtual)
        kept = np.isfinite(weight[some]) & (pixel >= -1)
        lost += int((~kept).sum())
        missed += int((pixel[kept] < 0).sum())
        kept &= pixel >= 0
        pixel, carried = pixel[kept], weight[some][kept]
        group = 0 if batch is None else number[batch[some][kept]]
        total = np.bincount(group * squares.size + pixel, carried, sums.size)
        sums += total.reshape(sums.shape)
        if batches == 1:
            squares += np.bincount(pixel, carried**2, squares.size)
    sums[:, -1] = sums[:, :-1].sum(axis=1)
    squares[-1] = squares[:-1].sum()
    found, error = _errors(sums, squares, count_of(rays))
    area = math.prod(float(axis[-1] - axis[0]) for axis in edges) / math.prod(size)
    about = {"power": found[-1], "power_error": error[-1], "lost": lost, "missed": missed}
    return _dataset(edges, found[:-1] / area, error[:-1] / area, {**rays.attrs, **about})


def _batches(batch: NDArray[Any] | None, pixels: int) -> tuple[int, NDArray[np.int64]]:
    """Number of batches, and their new numbers: a selection may have left some out.

    ArgumentError for more sums than fit into memory.
    """
    is_there = np.zeros(MOST_BATCHES, bool)
    is_there[0 if batch is None else batch] = True
    count = max(1, int(is_there.sum()))
    if count * pixels > _MOST_SUMS:
        raise ArgumentError(
            f"expected at most {_MOST_SUMS} pixels of all batches, got {count} batches of {pixels} "
            "pixels; use fewer pixels"
        )
    return count, np.cumsum(is_there) - 1


def _errors(sums: Values, squares: Values, count: int) -> tuple[Values, Values]:
    """Sums over all rays, and the standard deviations of these."""
    total = sums.sum(axis=0)
    batches = len(sums)
    if batches > 1:
        return total, math.sqrt(batches) * np.std(sums, axis=0, ddof=1)
    # rays that miss a pixel give it zero: n variances of one ray
    variance = squares - total**2 / count
    return total, np.sqrt(np.maximum(variance, 0.0) * count / max(1, count - 1))


def _pixels(
    position: Values, direction: Values, pose: Values, edges: tuple[Values, Values], virtual: bool
) -> NDArray[np.intp]:
    """Number of the pixel that each ray meets, -1 for a miss, -2 for a lost ray."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        own = (position - pose[:3, 3]) @ pose[:3, :3]
        along = direction @ pose[:3, :3]
        reach = -own[:, 2] / along[:, 2]
        place = own[:, :2] + reach[:, None] * along[:, :2]
        largest = np.maximum(np.abs(own).max(axis=1), max(map(np.ptp, edges)))
        meets = np.isfinite(place).all(axis=1) & (virtual | (reach >= -_ON_PLANE * largest))
    index = np.zeros(len(position), np.intp)
    for k, axis in reversed([*enumerate(edges)]):  # rows of x
        n = len(axis) - 1
        step = (place[:, k] - axis[0]) / (axis[-1] - axis[0]) * n
        meets &= (step >= 0) & (step < n)
        index = index * n + np.where(meets, step, 0).astype(np.intp)
    is_lost = ~(np.isfinite(position).all(axis=1) & np.isfinite(direction).all(axis=1))
    return np.where(is_lost, -2, np.where(meets, index, -1))


def _pose(plane: Any) -> Values:
    if shape_of(plane) == "()":
        pose = np.eye(4)
        pose[2, 3] = checked_number(plane, "plane", "its z in m, or a (4, 4) pose")
        return pose
    return rigid_pose(plane)


def _edges(bounds: Any, shape: Any) -> tuple[Values, Values]:
    """The edges of the pixels along x and y."""
    expected = "expected bounds as (xmin, ymin, xmax, ymax) in m"
    try:
        found = real_numbers(bounds)
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if found.shape != (4,) or not np.isfinite(found).all() or not (found[2:] > found[:2]).all():
        raise ArgumentError(f"{expected}, got {np.asarray(bounds).tolist()}")
    if not isinstance(shape, (tuple, list)) or len(shape) != 2:
        raise ArgumentError(f"expected shape as two numbers of pixels, got {shape!r}")
    nx, ny = (checked_count(n, "shape", 1, _MOST_PIXELS) for n in shape)
    if nx * ny > _MOST_IN_ALL:
        raise ArgumentError(f"expected at most {_MOST_IN_ALL} pixels, got {nx} x {ny}")
    return np.linspace(found[0], found[2], nx + 1), np.linspace(found[1], found[3], ny + 1)


def _dataset(
    edges: tuple[Values, Values], irradiance: Values, error: Values, attrs: dict[str, Any]
) -> xarray.Dataset:
    size = len(edges[1]) - 1, len(edges[0]) - 1
    middles = [(axis[1:] + axis[:-1]) / 2 for axis in edges]
    units = {"units": "W m-2"}
    import xarray

    dataset = xarray.Dataset(
        {
            "irradiance": (
                ("y", "x"),
                irradiance.reshape(size),
                {**units, "long_name": "irradiance, the mean over a pixel"},
            ),
            "standard_error": (
                ("y", "x"),
                error.reshape(size),
                {**units, "long_name": "standard error of the irradiance"},
            ),
        },
        coords={
            name: (name, values, {"units": "m"}) for name, values in zip("xy", middles, strict=True)
        },
        attrs=attrs,
    )
    return dataset
