"""Rays as a dataset, their irradiance, and ray files of Ansys Zemax OpticStudio (.dat)."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, FileFormatError, at_key
from polywigner.geometry.arguments import (
    check_most,
    checked_count,
    checked_flag,
    checked_number,
    checked_path,
    finite_array,
    in_place,
    real_array,
    rigid_pose,
    shape_of,
    warn_caller,
)
from polywigner.geometry.io.limits import check_regular, checked_suffix
from polywigner.numerics import Floats, index_blocks
from polywigner.transforms.xarray_arguments import arrays_of

if TYPE_CHECKING:
    import xarray

# Unit and long name of each variable.
_VARIABLES = {
    "position": ("m", "point on the ray"),
    "direction": ("1", "unit vector along the ray"),
    "weight": ("W", "power of the ray, signed"),
}
# Tolerance on the length of unit vectors, for ray tracers in single precision.
_UNIT = 1e-4


def rays_dataset(
    position: Floats,
    direction: Floats,
    weight: Floats,
    batch: NDArray[Any] | None,
    attrs: dict[str, Any],
) -> xarray.Dataset:
    """Return positions (n, 3) in m, directions (n, 3) and weights (n,) in W of rays as a dataset.

    ``batch`` (n,): index of the set of quasi-random numbers to which each ray belongs, or None for
    independent rays. The sets are independent.
    """
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
    return rays_dataset(*columns, batch, {**rays.attrs, "count": count_of(rays)})


def checked_bundle(rays: Any) -> tuple[Floats, Floats, Floats, NDArray[Any] | None]:
    """Return positions, directions, weights and batches of a dataset of rays.

    The shapes are (n, 3), (n, 3), (n,) and (n,). Batches are None for independent rays. Lost rays
    contain NaN. Raises ArgumentError for other datasets, and for directions that are not unit
    vectors.
    """
    axes = dict(zip(_VARIABLES, ("ray component", "ray component", "ray"), strict=True))
    arrays = arrays_of(rays, axes, "polywigner.sample_rays or polywigner.rays.load")
    batch = rays["batch"].values if "batch" in rays.coords else None
    return *_columns(len(arrays[2]), *arrays), batch


def count_of(rays: xarray.Dataset) -> int:
    """Return the number of rays originally drawn, even if the dataset contains only some rays."""
    count = rays.attrs.get("count", 0)
    return max(int(count) if isinstance(count, (int, np.integer)) else 0, rays.sizes["ray"])


def _columns(count: int, *values: Any) -> tuple[Floats, Floats, Floats]:
    """Check the positions, directions and weights of ``count`` rays, and return them as arrays."""
    columns = []
    for name, value, shape in zip(_VARIABLES, values, [(count, 3)] * 2 + [(count,)], strict=True):
        columns.append(real_array(value, f"expected {name} of shape {shape}", shape))
    position, direction, weight = columns
    with np.errstate(over="ignore"):
        # The comparison is false for lost rays, which contain NaN.
        wrong = np.abs(np.linalg.norm(direction, axis=1) - 1) > _UNIT
    if wrong.any():
        raise ArgumentError(
            f"direction must contain unit vectors, got {direction[wrong][0].tolist()}; divide "
            "each vector by its length"
        )
    return position, direction, weight


_MOST_ALONG_AXIS = 1 << 14
_MOST_PIXELS = 1 << 22
# Number of rays per block; a block takes about 100 MB.
_BLOCK = 1 << 20
# Distance behind the plane that counts as a rounding error, relative to the largest coordinate.
_ON_PLANE = 1e-9


def rebuild(
    rays: xarray.Dataset,
    plane: float | ArrayLike,
    bounds: ArrayLike,
    shape: tuple[int, int],
    *,
    virtual: bool = False,
) -> xarray.Dataset:
    """Return the irradiance of rays on a plane.

    The irradiance of a pixel is the sum of the weights of the rays that meet the pixel, divided by
    its area. Rays continue in straight lines to the plane. For rays from
    :func:`polywigner.sample_rays`, the irradiance is an unbiased estimate of |U|^2 times the cosine
    between the ray and the plane normal, averaged over the pixel (docs/signed_rays.md, (Y2)).

    Parameters
    ----------
    rays : xarray.Dataset
        From :func:`polywigner.sample_rays`, :func:`polywigner.rays.load` or :func:`traced`.
    plane : float or array_like, shape (4, 4)
        Plane, specified by its z in m if it is parallel to the x and y axes, otherwise by the pose
        that maps its frame to the world.
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
        ``irradiance`` and its ``standard_error`` in W/m^2, both with the dimensions (y, x). The
        coordinates are the pixel centres in m. The first row is at the bottom of the image
        (``origin="lower"``). The standard error of independent rays is computed from their weights.
        The standard error of quasi-random rays is computed from the scatter of 16 batches and is
        accurate to about a fifth. Attributes are ``power`` and its standard error ``power_error``
        of all pixels in W; ``lost``, the number of lost rays; and ``missed``, the number of rays
        that do not meet the pixels.

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
    pose = _plane_pose(plane)
    checked_flag(virtual, "virtual")
    edges = _pixel_edges(bounds, shape)
    size = len(edges[1]) - 1, len(edges[0]) - 1
    pixels = math.prod(size)
    # Batch numbers of a selection of rays may have gaps.
    known, number = np.unique([0] if batch is None else batch, return_inverse=True)
    batches = max(1, len(known))
    # The last entry is the sum over all pixels.
    sums, squares = np.zeros((batches, pixels + 1)), np.zeros(pixels + 1)
    lost = missed = 0
    for block in index_blocks(len(weight), _BLOCK):
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
    total, error = _estimates(sums, squares, count_of(rays))
    area = math.prod(float(axis[-1] - axis[0]) for axis in edges) / pixels
    images = {}
    for name, values, meaning in (
        ("irradiance", total, "irradiance, mean over a pixel"),
        ("standard_error", error, "standard error of the irradiance"),
    ):
        about = {"units": "W m-2", "long_name": meaning}
        images[name] = ("y", "x"), (values[:-1] / area).reshape(size), about
    coords = {
        name: ((name,), (axis[1:] + axis[:-1]) / 2, {"units": "m"})
        for name, axis in zip("xy", edges, strict=True)
    }
    totals = {"power": total[-1], "power_error": error[-1], "lost": lost, "missed": missed}
    return xarray.Dataset(images, coords, {**rays.attrs, **totals})


def _estimates(sums: Floats, squares: Floats, count: int) -> tuple[Floats, Floats]:
    """Return the total power of each pixel in W, and its standard error.

    ``sums`` (batches, pixels): sums of weights. A single batch contains independent rays. In this
    case, ``squares`` (pixels,) are the sums of squared weights. ``count``: number of rays that were
    drawn.
    """
    total = sums.sum(axis=0)
    batches = len(sums)
    if batches > 1:
        return total, math.sqrt(batches) * np.std(sums, axis=0, ddof=1)
    # Rays that miss the pixel add zero power.
    variance = squares - total**2 / count
    return total, np.sqrt(np.maximum(variance, 0.0) * count / max(1, count - 1))


def _pixel_coordinates(
    position: Floats, direction: Floats, pose: Floats, edges: tuple[Floats, Floats], virtual: bool
) -> Floats:
    """Return the pixel coordinates (n, 2) where rays meet a plane; NaN for rays that miss it.

    The coordinates along x and y count pixels from the lower bounds and may lie outside the image.
    """
    low, high = np.transpose([(axis[0], axis[-1]) for axis in edges])
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        local = (position - pose[:3, 3]) @ pose[:3, :3]
        along = direction @ pose[:3, :3]
        distance = -local[:, 2] / along[:, 2]
        point = local[:, :2] + distance[:, None] * along[:, :2]
        largest = np.maximum(np.abs(local).max(axis=1), (high - low).max())
        meets = virtual | (distance >= -_ON_PLANE * largest)
        pixels = (point - low) / (high - low) * [len(axis) - 1 for axis in edges]
    return np.where(meets[:, None], pixels, np.nan)


def _plane_pose(plane: Any) -> Floats:
    """Return the pose (4, 4) of a plane that is specified by a pose or by its z in m."""
    if shape_of(plane) == "()":
        pose = np.eye(4)
        pose[2, 3] = checked_number(plane, "plane", "a z coordinate in m, or a (4, 4) pose")
        return pose
    return rigid_pose(plane)


def _pixel_edges(bounds: Any, shape: Any) -> tuple[Floats, Floats]:
    """Return the edges of pixels along x and y in m; raise ArgumentError for other values."""
    expected = "expected bounds to be (xmin, ymin, xmax, ymax) in m"
    row = finite_array(bounds, expected, (4,))
    if not (row[2:] > row[:2]).all():
        raise ArgumentError(f"{expected}, got {np.asarray(bounds).tolist()}")
    if not isinstance(shape, (tuple, list)) or len(shape) != 2:
        raise ArgumentError(f"expected shape to be two integers, (nx, ny) in pixels, got {shape!r}")
    nx, ny = (checked_count(n, "shape", 1, _MOST_ALONG_AXIS) for n in shape)
    check_most(nx * ny, _MOST_PIXELS, "pixels", "use fewer pixels")
    return np.linspace(row[0], row[2], nx + 1), np.linspace(row[1], row[3], ny + 1)


# Metres per unit for each value of DimensionUnits: m, in, cm, ft, mm.
_METRES = (1.0, 0.0254, 0.01, 0.3048, 0.001)
_MM = 4

_IDENTIFIERS = 1010, 8675309  # current and older versions of the format
_HEADER = np.dtype(
    [("Identifier", "<i4"), ("NbrRays", "<u4"), ("Description", "S100")]
    + [(name, "<f4") for name in ("SourceFlux", "RaySetFlux", "Wavelength")]
    + [(f"{angle}{end}", "<f4") for angle in ("Inclination", "Azimuth") for end in ("Beg", "End")]
    + [("DimensionUnits", "<i4"), ("Loc", "<f4", 3), ("Rot", "<f4", 3), ("Scale", "<f4", 3)]
    + [("unused", "<f4", 4), ("ray_format_type", "<i4"), ("flux_type", "<i4")]
    + [("reserved", "<i4", 2)]
)
# Number of values per ray for each ray_format_type.
_NUMBERS = {0: 7, 2: 8}
_MICROMETRE = 1e-6
# Sign of the powers, suffix of the file name, and description in the header.
_SIGNED = 1, "", "signed"
_SPLIT = (1, "_positive", "positive part"), (-1, "_negative", "negative part, to be subtracted")
# Pattern of descriptions in headers of polywigner's files: number of drawn rays, and sign of their
# powers.
_OURS = re.compile(r"polywigner rays of (\d+): (signed|positive|negative)")


def save(
    rays: xarray.Dataset, path: str | os.PathLike[str], *, split: bool = False
) -> tuple[Path, ...]:
    """Write rays to a binary source file of OpticStudio.

    The file has a header of 208 bytes, followed by seven single-precision numbers for each ray: the
    position x, y, z in mm, the direction cosines l, m, n and the power in W. To store rays for
    polywigner, use :func:`polywigner.write_netcdf` and ``xarray.load_dataset``.

    Other programs expect positive powers, and may clip, ignore or reject negative ones; a warning
    reports the fraction of negative powers. With ``split`` two files with positive powers are
    written, NAME_positive.dat and NAME_negative.dat. Trace the rays of both files, and subtract the
    irradiance of the negative file from the irradiance of the positive file.

    Parameters
    ----------
    rays : xarray.Dataset
        From :func:`polywigner.sample_rays`, :func:`polywigner.rays.load` or :func:`traced`.
    path : str or path
        Path of the file, with the suffix ``.dat``. An existing file is replaced.
    split : bool, default False
        Whether to write positive and negative rays to separate files.

    Returns
    -------
    tuple of pathlib.Path
        Paths of the written files.

    Raises
    ------
    ArgumentError
        If ``rays`` is not a dataset of rays, or the path has another suffix or cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 100)
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> [path.name for path in pw.rays.save(rays, folder / "square.dat", split=True)]
    ['square_positive.dat', 'square_negative.dat']
    """
    target, is_split = _checked_file(path), checked_flag(split, "split")
    position, direction, weight, _ = checked_bundle(rays)
    if not is_split:
        _warn_of_negative(weight)
    columns = np.column_stack([position / _METRES[_MM], direction, weight])
    parts = _SPLIT if is_split else (_SIGNED,)
    return tuple(_write_part(rays, columns, target, *part) for part in parts)


def _checked_file(path: str | os.PathLike[str]) -> Path:
    """Return an absolute path; raise ArgumentError unless its suffix is .dat."""
    file = checked_path(path)
    remedy = "to store rays, use polywigner.write_netcdf and xarray.load_dataset"
    checked_suffix(file, [".dat"], remedy, ArgumentError)
    return file


def _write_part(
    rays: xarray.Dataset, columns: Floats, path: Path, sign: int, suffix: str, description: str
) -> Path:
    """Write all rays, or the rays whose power has a given sign, and return the path of the file.

    ``columns`` (n, 7): position in mm, direction, and power in W. An empty suffix writes all rays
    with their signs. Otherwise powers are written without a sign.
    """
    if suffix:
        columns = columns[columns[:, 6] * sign > 0] * ([1.0] * 6 + [sign])
        path = path.with_stem(path.stem + suffix)
    header = np.zeros((), _HEADER)
    header["Identifier"], header["NbrRays"] = _IDENTIFIERS[0], len(columns)
    header["Description"] = f"polywigner rays of {count_of(rays)}: {description}".encode()
    header["SourceFlux"] = header["RaySetFlux"] = columns[:, 6].sum()
    header["Wavelength"] = float(rays.attrs.get("wavelength", 0.0)) / _MICROMETRE
    header["InclinationEnd"], header["AzimuthEnd"] = 180.0, 360.0
    header["DimensionUnits"] = _MM
    header["Scale"] = 1.0
    with in_place(path) as scratch, np.errstate(over="ignore"):
        scratch.write_bytes(header.tobytes() + columns.astype("<f4").tobytes())
    return path


def _warn_of_negative(weight: Floats) -> None:
    """Warn if some powers are negative."""
    below = weight < 0
    if below.any():
        fraction = float(np.abs(weight[below]).sum() / np.nansum(np.abs(weight)))
        warn_caller(
            f"{100 * below.mean():.0f} % of the rays in the .dat file have negative powers, which "
            f"are {100 * fraction:.0f} % of the total absolute power; other programs may ignore "
            "or reject negative powers, so test with a small file, or write positive and "
            "negative rays to two files with split=True",
            stacklevel=4,
        )


def load(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Read rays from a source file of OpticStudio.

    The file may come from :func:`polywigner.rays.save` or another program. Rays from the negative
    file of a split pair have negative weights. Join the two files with
    ``xarray.concat([positive, negative], "ray", combine_attrs="override")``.

    Parameters
    ----------
    path : str or path
        Path of a ``.dat`` file with powers in watts and one wavelength.

    Returns
    -------
    xarray.Dataset
        Rays as returned by :func:`polywigner.sample_rays`.

    Raises
    ------
    ArgumentError
        If the path has another suffix.
    FileFormatError
        If the file does not exist or contains no rays.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 100)
    >>> paths = pw.rays.save(rays, pathlib.Path(tempfile.mkdtemp()) / "square.dat", split=True)
    >>> [bool((pw.rays.load(path).weight > 0).all()) for path in paths]
    [True, False]
    """
    file = _checked_file(path)

    def wrong(got: str) -> FileFormatError:
        """Return the error for a file that is not a valid ray file."""
        return FileFormatError(
            f"expected {file.name} to be a ray file of OpticStudio, got {got}; export it again"
        )

    with at_key(file.name):
        check_regular(file)
    content = file.read_bytes()
    if len(content) < _HEADER.itemsize:
        raise wrong(f"a file of {len(content)} bytes")
    header = np.frombuffer(content, _HEADER, 1)[0]
    columns = _NUMBERS.get(int(header["ray_format_type"]))
    unit, count = int(header["DimensionUnits"]), int(header["NbrRays"])
    if header["Identifier"] not in _IDENTIFIERS or columns is None or not 0 <= unit < len(_METRES):
        raise wrong("another identifier, ray format or unit of length")
    if header["flux_type"] != 0:
        raise wrong("powers in lumens, not in watts")
    size = len(content) - _HEADER.itemsize
    if size != 4 * count * columns:
        raise wrong(f"{size} bytes of data for {count} rays")
    rays = np.frombuffer(content, "<f4", offset=_HEADER.itemsize).astype(np.float64)
    rays = rays.reshape(count, columns)
    wavelengths = np.unique(rays[:, 7:])
    if len(wavelengths) > 1:
        raise wrong(f"{len(wavelengths)} wavelengths in one file")
    wavelength = float([*wavelengths, header["Wavelength"]][0])
    attrs: dict[str, Any] = {"wavelength": wavelength * _MICROMETRE} if wavelength > 0 else {}
    position, direction, weight = rays[:, :3] * _METRES[unit], rays[:, 3:6], rays[:, 6]
    # Lost rays have NaN positions.
    is_valid = np.isfinite(position).all(axis=1)
    if not np.isfinite(rays[is_valid, 3:7]).all():
        raise wrong("directions or powers that are NaN")
    if not direction.any(axis=1).all():
        raise wrong("directions of length zero")
    # Directions are normalised again, because single precision has errors of 6e-8.
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if ours := _OURS.match(header["Description"].decode("utf-8", "replace")):
        attrs["count"] = int(ours[1])
        weight = -weight if ours[2] == "negative" else weight
    return rays_dataset(position, direction, weight, None, attrs)
