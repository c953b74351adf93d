"""Rays as a dataset, positions, directions and weights in watts, and irradiance from them."""

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
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray


Values = NDArray[np.float64]

# Units and meanings.
_VARIABLES = {
    "position": ("m", "a point of the ray"),
    "direction": ("1", "unit vector along the ray"),
    "weight": ("W", "power of the ray, signed"),
}
# Of directions from ray traces in single precision.
_UNIT = 1e-4
MOST_BATCHES = 1024
"""Independent sets: many more than scatter needs."""


def bundle(
    position: Values,
    direction: Values,
    weight: Values,
    batch: NDArray[Any] | None,
    attrs: dict[str, Any],
) -> xarray.Dataset:
    """The dataset of rays (n, 3), (n, 3), (n,); ``batch``: which independent set each is of."""
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
    rays: xarray.Dataset,
    position: ArrayLike,
    direction: ArrayLike,
    weight: ArrayLike | None = None,
) -> xarray.Dataset:
    """Rays after ray optics of your own: positions, directions and powers.

    They are for :func:`rebuild`. Keep their order; a ray that is lost on the way has NaN for its
    position, or a weight of zero.

    Parameters
    ----------
    rays : those that were traced, from :func:`polywigner.sample_rays` or :func:`load`.
    position : (n, 3) in m, a point of each ray behind the optics.
    direction : (n, 3) unit vectors.
    weight : (n,) in W, where the optics absorb; None: as before.

    Returns
    -------
    xarray.Dataset, as that of :func:`polywigner.sample_rays`.

    Raises ArgumentError for anything but rays, and for arrays of other shapes.

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
    given = position, direction, weights if weight is None else weight
    found = _columns(len(weights), given)
    return bundle(*found, batch, {**rays.attrs, "count": count_of(rays)})


def checked_bundle(rays: Any) -> tuple[Values, Values, Values, NDArray[Any] | None]:
    """Positions, directions, weights and batches of a dataset of rays.

    Rays with a component that is not finite are lost: they may be there. Raises ArgumentError for
    anything but such a dataset, and for directions that are no unit vectors.
    """
    import xarray

    if not isinstance(rays, xarray.Dataset) or not set(_VARIABLES) <= set(rays.variables):
        raise ArgumentError(
            "expected rays as a dataset with position, direction and weight, got "
            f"{type(rays).__name__}; draw them by sample_rays, or read them by rays.load"
        )
    axes, given = ("ray", "component"), [rays[name] for name in _VARIABLES]
    try:
        arrays = [own.transpose(*axes[: own.ndim]).values for own in given]
    except ValueError as error:
        raise ArgumentError(
            f"expected position and direction over ray and component, weight over ray: {error}"
        ) from None
    found = _columns(len(arrays[2]), tuple(arrays))
    return *found, _batch(rays) if "batch" in rays.coords else None


def _batch(rays: Any) -> NDArray[Any]:
    """Numbers of the sets of rays, (n,)."""
    found: NDArray[Any] = rays["batch"].values
    whole = found.dtype.kind in "iu" and found.shape == (rays.sizes["ray"],)
    if not whole or not (found.min(initial=0) >= 0 and found.max(initial=0) < MOST_BATCHES):
        raise ArgumentError(
            f"expected batch as whole numbers from 0 to {MOST_BATCHES - 1}, one for each ray, got "
            f"{found.dtype} of shape {found.shape}"
        )
    return found


def count_of(rays: xarray.Dataset) -> int:
    """Number of rays drawn, including rays that a selection has left out."""
    told = rays.attrs.get("count", 0)
    return max(int(told) if isinstance(told, (int, np.integer)) else 0, rays.sizes["ray"])


def _columns(count: int, values: tuple[Any, ...]) -> tuple[Values, Values, Values]:
    """Positions, directions and weights of so many rays, checked."""
    found = []
    for name, own, shape in zip(_VARIABLES, values, [(count, 3)] * 2 + [(count,)], strict=True):
        found.append(checked_vectors(own, f"expected {name} of shape {shape}", ()))
        if found[-1].shape != shape:
            raise ArgumentError(f"expected {name} of shape {shape}, got {found[-1].shape}")
    with np.errstate(over="ignore"):
        wrong = np.abs(np.linalg.norm(found[1], axis=1) - 1) > _UNIT  # false for lost rays
    if wrong.any():
        raise ArgumentError(
            f"expected direction as unit vectors, got {found[1][wrong][0].tolist()}; divide by "
            "their lengths"
        )
    return found[0], found[1], found[2]


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

    Without bias the mean over a pixel of |U|^2 of Wigner rays times the cosine between ray and
    normal of the plane (docs/signed_rays.md, (Y2)). Rays go on in straight lines.

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
    x of the pixels' middles in m: rows are along x, the first at the bottom (``origin="lower"``).
    Of independent rays the error follows from their weights, of quasi-random ones from the scatter
    of 16 batches, to a fifth. Attributes: ``power`` and ``power_error``, the sum in the grid in W;
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
    checked_flag(virtual, "virtual")
    edges = _edges(bounds, shape)
    pixels = math.prod(len(axis) - 1 for axis in edges)
    # a selection may have left some batches out
    known, number = np.unique([0] if batch is None else batch, return_inverse=True)
    batches = max(1, len(known))
    if batches * pixels > _MOST_SUMS:
        raise ArgumentError(
            f"expected at most {_MOST_SUMS} pixels of all batches, got {batches} batches of "
            f"{pixels} pixels; use fewer pixels"
        )
    # and one place for the sum over all pixels
    sums, squares = np.zeros((batches, pixels + 1)), np.zeros(pixels + 1)
    lost = missed = 0
    for start in range(0, len(weight), _BLOCK):
        some = slice(start, start + _BLOCK)
        pixel = _pixels(position[some], direction[some], pose, edges, virtual)
        kept = np.isfinite(weight[some]) & (pixel >= -1)
        lost += int((~kept).sum())
        missed += int((pixel[kept] < 0).sum())
        kept &= pixel >= 0
        pixel, carried = pixel[kept], weight[some][kept]
        group = 0 if batch is None else number[some][kept]
        total = np.bincount(group * squares.size + pixel, carried, sums.size)
        sums += total.reshape(sums.shape)
        if batches == 1:
            squares += np.bincount(pixel, carried**2, squares.size)
    sums[:, -1] = sums[:, :-1].sum(axis=1)
    squares[-1] = squares[:-1].sum()
    found, error = _errors(sums, squares, count_of(rays))
    area = math.prod(float(axis[-1] - axis[0]) for axis in edges) / pixels
    about = {"power": found[-1], "power_error": error[-1], "lost": lost, "missed": missed}
    values = {
        "irradiance": (found[:-1], "irradiance, the mean over a pixel"),
        "standard_error": (error[:-1], "standard error of the irradiance"),
    }
    size, units = (len(edges[1]) - 1, len(edges[0]) - 1), {"units": "W m-2"}
    return labelled_arrays(
        {
            name: labelled_array(
                (own / area).reshape(size), ("y", "x"), units | {"long_name": text}
            )
            for name, (own, text) in values.items()
        },
        {
            name: labelled_array((axis[1:] + axis[:-1]) / 2, (name,), {"units": "m"})
            for name, axis in zip("xy", edges, strict=True)
        },
        {**rays.attrs, **about},
    )


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
        with np.errstate(invalid="ignore", over="ignore"):  # those beyond do not meet it
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
    found = checked_row(bounds, expected)
    if found.shape != (4,) or not np.isfinite(found).all() or not (found[2:] > found[:2]).all():
        raise ArgumentError(f"{expected}, got {np.asarray(bounds).tolist()}")
    if not isinstance(shape, (tuple, list)) or len(shape) != 2:
        raise ArgumentError(f"expected shape as two numbers of pixels, got {shape!r}")
    nx, ny = (checked_count(n, "shape", 1, _MOST_PIXELS) for n in shape)
    if nx * ny > _MOST_IN_ALL:
        raise ArgumentError(f"expected at most {_MOST_IN_ALL} pixels, got {nx} x {ny}")
    return np.linspace(found[0], found[2], nx + 1), np.linspace(found[1], found[3], ny + 1)
