"""Rays as a dataset of positions, directions and weights in watts, and the irradiance of rays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import (
    checked_count,
    checked_flag,
    checked_number,
    checked_row,
    checked_vectors,
    rigid_pose,
    shape_of,
)

if TYPE_CHECKING:
    import xarray


Values = NDArray[np.float64]

# Units and long names of the variables of a dataset of rays.
_VARIABLES = {
    "position": ("m", "point on the ray"),
    "direction": ("1", "unit vector along the ray"),
    "weight": ("W", "power of the ray, signed"),
}
# Tolerance of the length of unit vectors, because ray tracers may use single precision.
_UNIT = 1e-4


def bundle(
    position: Values,
    direction: Values,
    weight: Values,
    batch: NDArray[Any] | None,
    attrs: dict[str, Any],
) -> xarray.Dataset:
    """Return the dataset of n rays; ``batch`` (n,) is the number of each ray's independent set."""
    import xarray

    dataset = xarray.Dataset(coords={"component": list("xyz")}, attrs=attrs)
    for (name, (units, meaning)), values in zip(
        _VARIABLES.items(), (position, direction, weight), strict=True
    ):
        about = {"units": units, "long_name": meaning}
        dataset[name] = ("ray", "component")[: values.ndim], values, about
    if batch is not None:
        about = {"long_name": "independent set of quasi-random numbers"}
        dataset.coords["batch"] = "ray", np.asarray(batch, np.int32), about
    return dataset


def traced(
    rays: xarray.Dataset, position: ArrayLike, direction: ArrayLike, weight: ArrayLike | None = None
) -> xarray.Dataset:
    """Return rays with new positions, directions and powers from a ray tracer.

    Pass the result to :func:`rebuild`. The order of the rays must not change. Set the position of a
    lost ray to NaN, or its weight to zero.

    Parameters
    ----------
    rays : xarray.Dataset
        The n rays before tracing, from :func:`polywigner.sample_rays` or
        :func:`polywigner.rays.load`.
    position : array_like, shape (n, 3)
        A point on each ray behind the optics, in m.
    direction : array_like, shape (n, 3)
        Unit vectors along the rays.
    weight : array_like, shape (n,), optional
        Powers in W, if the optics absorb power. By default powers do not change.

    Returns
    -------
    xarray.Dataset
        Rays as returned by :func:`polywigner.sample_rays`.

    Raises
    ------
    ArgumentError
        If ``rays`` is not a dataset of rays, or an array has the wrong shape.

    Examples
    --------
    >>> import numpy as np
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 100)
    >>> mirror = rays.direction.values * [1.0, 1.0, -1.0]  # at the plane z = 0.1 m
    >>> reach = (0.1 - rays.position.values[:, 2:]) / rays.direction.values[:, 2:]
    >>> back = pw.rays.traced(rays, rays.position + reach * rays.direction, mirror)
    >>> bool((back.direction[:, 2] < 0).all())
    True
    """
    _, _, weights, batch = checked_bundle(rays)
    columns = _columns(len(weights), position, direction, weights if weight is None else weight)
    return bundle(*columns, batch, {**rays.attrs, "count": count_of(rays)})


def checked_bundle(rays: Any) -> tuple[Values, Values, Values, NDArray[Any] | None]:
    """Return positions, directions, weights and batches of a dataset of rays.

    The values of lost rays are NaN. Raises ArgumentError for other objects, and for directions that
    are not unit vectors.
    """
    import xarray

    if not isinstance(rays, xarray.Dataset) or not set(_VARIABLES) <= set(rays.variables):
        raise ArgumentError(
            "expected rays as a dataset with position, direction and weight, got "
            f"{type(rays).__name__}; create it with sample_rays or rays.load"
        )
    axes, variables = ("ray", "component"), [rays[name] for name in _VARIABLES]
    try:
        arrays = [variable.transpose(*axes[: variable.ndim]).values for variable in variables]
    except ValueError as error:
        raise ArgumentError(
            "the dataset of rays must have position and direction over ray and component, and "
            f"weight over ray, got other axes: {error}"
        ) from None
    batch = rays["batch"].values if "batch" in rays.coords else None
    return *_columns(len(arrays[2]), *arrays), batch


def count_of(rays: xarray.Dataset) -> int:
    """Return the number of rays that were drawn; the dataset may contain only some of them."""
    count = rays.attrs.get("count", 0)
    return max(int(count) if isinstance(count, (int, np.integer)) else 0, rays.sizes["ray"])


def _columns(count: int, *values: Any) -> tuple[Values, Values, Values]:
    """Return checked positions, directions and weights of ``count`` rays."""
    columns = []
    for name, value, shape in zip(_VARIABLES, values, [(count, 3)] * 2 + [(count,)], strict=True):
        columns.append(checked_vectors(value, f"expected {name} of shape {shape}", ()))
        if columns[-1].shape != shape:
            raise ArgumentError(f"expected {name} of shape {shape}, got {columns[-1].shape}")
    position, direction, weight = columns
    with np.errstate(over="ignore"):
        # This comparison is False for lost rays, which contain NaN.
        wrong = np.abs(np.linalg.norm(direction, axis=1) - 1) > _UNIT
    if wrong.any():
        raise ArgumentError(
            f"direction must contain unit vectors, got {direction[wrong][0].tolist()}; divide "
            "each vector by its length"
        )
    return position, direction, weight


# Largest number of pixels along an axis.
_MOST_ALONG_AXIS = 1 << 14
# Largest total number of pixels, and largest product of the numbers of pixels and batches (1 GB).
_MOST_PIXELS, _MOST_SUMS = 1 << 22, 1 << 26
# Number of rays per block, which takes some 100 MB.
_BLOCK = 1 << 20
# Rays that start behind the plane still count if their distance from the plane is below this
# fraction of the largest coordinate, because positions on the plane are rounded.
_ON_PLANE = 1e-9


def rebuild(
    rays: xarray.Dataset,
    plane: float | ArrayLike,
    bounds: ArrayLike,
    shape: tuple[int, int],
    *,
    virtual: bool = False,
) -> xarray.Dataset:
    """Return the irradiance of rays on a plane: the sum of weights in a pixel, over its area.

    The irradiance is an unbiased estimate of |U|^2 by Wigner rays, times the cosine between ray and
    plane normal, as a mean over each pixel (docs/signed_rays.md, (Y2)). Rays continue in straight
    lines to the plane.

    Parameters
    ----------
    rays : xarray.Dataset
        From :func:`polywigner.sample_rays`, :func:`polywigner.rays.load` or :func:`traced`.
    plane : float or array_like, shape (4, 4)
        Plane: its z in m if it is parallel to x and y, otherwise its pose.
    bounds : array_like, shape (4,)
        Bounds (xmin, ymin, xmax, ymax) of all pixels in m, in the frame of the plane.
    shape : (int, int)
        Numbers of pixels along x and y.
    virtual : bool, default False
        Whether to include rays that meet the plane only if they are extended backwards, as in a
        virtual image.

    Returns
    -------
    xarray.Dataset
        ``irradiance`` (y, x) and its ``standard_error`` (y, x) in W/m^2, over the y and x of pixel
        centres in m. Rows are along x, the first at the bottom (``origin="lower"``). The error of
        independent rays is computed from their weights. The error of quasi-random rays is the
        scatter of 16 batches, accurate to a fifth. Attributes are ``power`` and its standard error
        ``power_error`` of all pixels in W; ``lost``, the number of lost rays; and ``missed``, the
        number of rays that do not meet the pixels.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If a pose is not rigid.

    Examples
    --------
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 4096)
    >>> image = pw.rays.rebuild(rays, 0.1, (-0.03, -0.02, 0.03, 0.02), (6, 4))
    >>> image.irradiance.dims, image.irradiance.shape
    (('y', 'x'), (4, 6))
    """
    import xarray

    position, direction, weight, batch = checked_bundle(rays)
    pose = _pose(plane)
    checked_flag(virtual, "virtual")
    edges = _edges(bounds, shape)
    size = len(edges[1]) - 1, len(edges[0]) - 1
    pixels = math.prod(size)
    # The numbers of batches may have gaps, because the rays may be a selection of the rays that
    # were drawn.
    known, number = np.unique([0] if batch is None else batch, return_inverse=True)
    batches = max(1, len(known))
    if batches * pixels > _MOST_SUMS:
        raise ArgumentError(
            f"expected at most {_MOST_SUMS} pixels times batches, got {pixels} pixels and "
            f"{batches} batches of rays; use fewer pixels"
        )
    # The last entry of each array is the sum over all pixels.
    sums, squares = np.zeros((batches, pixels + 1)), np.zeros(pixels + 1)
    lost = missed = 0
    for start in range(0, len(weight), _BLOCK):
        block = slice(start, start + _BLOCK)
        columns = np.column_stack([position[block], direction[block], weight[block]])
        is_lost = ~np.isfinite(columns).all(axis=1)
        x, y = _pixel_coordinates(position[block], direction[block], pose, edges, virtual).T
        is_inside = ~is_lost & (x >= 0) & (x < size[1]) & (y >= 0) & (y < size[0])
        lost += int(is_lost.sum())
        missed += int((~is_lost & ~is_inside).sum())
        pixel = y[is_inside].astype(np.intp) * size[1] + x[is_inside].astype(np.intp)
        power = weight[block][is_inside]
        group = 0 if batch is None else number[block][is_inside]
        block_sums = np.bincount(group * squares.size + pixel, power, sums.size)
        sums += block_sums.reshape(sums.shape)
        if batches == 1:
            squares += np.bincount(pixel, power**2, squares.size)
    sums[:, -1] = sums[:, :-1].sum(axis=1)
    squares[-1] = squares[:-1].sum()
    total, error = _errors(sums, squares, count_of(rays))
    area = math.prod(float(axis[-1] - axis[0]) for axis in edges) / pixels
    variables = {
        "irradiance": (total, "irradiance, mean over a pixel"),
        "standard_error": (error, "standard error of the irradiance"),
    }
    images = {
        name: (
            ("y", "x"),
            (values[:-1] / area).reshape(size),
            {"units": "W m-2", "long_name": text},
        )
        for name, (values, text) in variables.items()
    }
    coords = {
        name: ((name,), (axis[1:] + axis[:-1]) / 2, {"units": "m"})
        for name, axis in zip("xy", edges, strict=True)
    }
    about = {"power": total[-1], "power_error": error[-1], "lost": lost, "missed": missed}
    return xarray.Dataset(images, coords, {**rays.attrs, **about})


def _errors(sums: Values, squares: Values, count: int) -> tuple[Values, Values]:
    """Return the sums (pixel,) over all rays, and their standard errors.

    ``sums`` (batch, pixel) are sums of weights, and ``squares`` (pixel,) sums of squared weights.
    """
    total = sums.sum(axis=0)
    batches = len(sums)
    if batches > 1:
        return total, math.sqrt(batches) * np.std(sums, axis=0, ddof=1)
    # The expression is n times the variance of the power of a ray. The power is zero for rays that
    # miss the pixel.
    variance = squares - total**2 / count
    return total, np.sqrt(np.maximum(variance, 0.0) * count / max(1, count - 1))


def _pixel_coordinates(
    position: Values, direction: Values, pose: Values, edges: tuple[Values, Values], virtual: bool
) -> Values:
    """Return the points where rays meet a plane, (n, 2) in pixels along x and y, otherwise NaN."""
    low, high = np.transpose([(axis[0], axis[-1]) for axis in edges])
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        local = (position - pose[:3, 3]) @ pose[:3, :3]
        along = direction @ pose[:3, :3]
        reach = -local[:, 2] / along[:, 2]
        point = local[:, :2] + reach[:, None] * along[:, :2]
        largest = np.maximum(np.abs(local).max(axis=1), (high - low).max())
        meets = virtual | (reach >= -_ON_PLANE * largest)
        pixels = (point - low) / (high - low) * [len(axis) - 1 for axis in edges]
    return np.where(meets[:, None], pixels, np.nan)


def _pose(plane: Any) -> Values:
    if shape_of(plane) == "()":
        pose = np.eye(4)
        pose[2, 3] = checked_number(plane, "plane", "its z in m, or a (4, 4) pose")
        return pose
    return rigid_pose(plane)


def _edges(bounds: Any, shape: Any) -> tuple[Values, Values]:
    """Return the edges of the pixels along x and along y."""
    expected = "expected bounds as (xmin, ymin, xmax, ymax) in m"
    row = checked_row(bounds, expected)
    if row.shape != (4,) or not np.isfinite(row).all() or not (row[2:] > row[:2]).all():
        raise ArgumentError(f"{expected}, got {np.asarray(bounds).tolist()}")
    if not isinstance(shape, (tuple, list)) or len(shape) != 2:
        raise ArgumentError(f"expected shape as two integers, (nx, ny) in pixels, got {shape!r}")
    nx, ny = (checked_count(n, "shape", 1, _MOST_ALONG_AXIS) for n in shape)
    if nx * ny > _MOST_PIXELS:
        raise ArgumentError(
            f"expected at most {_MOST_PIXELS} pixels, got {nx} x {ny}; use fewer pixels"
        )
    return np.linspace(row[0], row[2], nx + 1), np.linspace(row[1], row[3], ny + 1)
