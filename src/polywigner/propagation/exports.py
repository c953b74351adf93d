"""Datasets as files for other programs: NetCDF, zarr, VTK image data for ParaView and the like.

All are written part by part, so a store may be larger than memory. Files appear complete or not at
all.
"""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias
from xml.sax.saxutils import quoteattr

import numpy as np

from polywigner.errors import ArgumentError, PolywignerError, value_text
from polywigner.geometry.arguments import checked_path
from polywigner.interruption import atomic_path
from polywigner.propagation.stores import open_store, required

if TYPE_CHECKING:
    import xarray


# Samples read at a time for a VTK file.
_SLAB = 1 << 24
# Coordinates are evenly spaced if no step differs from the mean step by more than this fraction. A
# viewer then errs by far less than a pixel.
_EVEN = 1e-6
_VTK_TYPES = {"float32": "Float32", "float64": "Float64"}

Stored: TypeAlias = "xarray.Dataset | xarray.DataArray | str | os.PathLike[str]"
"""A dataset in memory or lazy, one array, or the path of a store on disk."""


def write_netcdf(dataset: Stored, path: str | os.PathLike[str]) -> None:
    """Write a dataset to a NetCDF 4 file, which MATLAB, Julia, Panoply and xarray read.

    NetCDF has no complex numbers: a complex variable A becomes A_real and A_imag. Needs the extra
    ``datasets``.

    Parameters
    ----------
    dataset : xarray.Dataset, in memory or lazy; or the path of a zarr store.
    path : the file; an existing file is replaced.

    Raises
    ------
    ArgumentError for anything but a dataset, and a path that cannot be written to; StoreError for
    a path without a zarr store; MissingExtraError without h5netcdf.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> table = pw.wigner_table(pw.shapes.square(1.0), [0.0], [0.0], [0.0, 0.5], [0.0])
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "w.nc"
    >>> pw.write_netcdf(table, path)
    >>> path.stat().st_size > 0
    True
    """
    for module in ("h5netcdf", "h5py"):
        required(module)
    found = _real_parts(_opened(dataset))
    with in_place(checked_path(path)) as scratch:
        found.to_netcdf(scratch, engine="h5netcdf")


def write_zarr(dataset: Any, path: str | os.PathLike[str]) -> None:
    """Write a dataset to a zarr store (format 3), a folder, which has complex numbers."""
    required("zarr")
    found = _opened(dataset)
    try:
        with warnings.catch_warnings():
            # zarr warns that other readers may not know the consolidated copy; they need not
            warnings.simplefilter("ignore")
            found.to_zarr(checked_path(path), mode="w-", zarr_format=3)
    except OSError as error:
        raise _not_written(Path(path), error) from error


def write_vti(dataset: Stored, path: str | os.PathLike[str]) -> None:
    """Write a dataset of up to three evenly spaced axes to VTK image data (XML, raw binary).

    ParaView, VisIt, 3D Slicer and PyVista read it. Axes named x, y and z are the axes of the image,
    so planes keep their positions. Other axes become x, y and z in the order of the dataset. A
    complex variable A becomes A_real and A_imag. Needs the extra ``datasets``.

    Parameters
    ----------
    dataset, path : as of :func:`write_netcdf`.

    Raises
    ------
    ArgumentError for anything but a dataset, for more axes, for axes that are not evenly spaced,
    and for a path that cannot be written to; StoreError for a path without a zarr store.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> square, box = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
    >>> found = pw.volume(square, box, (3, 3, 2), 3.2e-3, method="fresnel")
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "field.vti"
    >>> pw.write_vti(found, path)
    >>> path.stat().st_size > 0
    True
    """
    # Our own forty lines: VTK's writer, a package of 600 MB, wants all of an image in memory.
    found = _real_parts(_opened(dataset))
    header = _header(found)
    with in_place(checked_path(path)) as scratch, scratch.open("wb") as file:
        file.write(header.encode())
        for name in found.data_vars:
            _append(file, found[name])
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


@contextmanager
def in_place(path: Path) -> Iterator[Path]:
    """Yield a scratch file, which replaces the file when the block is done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as scratch:
            yield scratch
    except PolywignerError:
        raise
    except OSError as error:
        raise _not_written(path, error) from error


def _not_written(path: Path, error: OSError) -> ArgumentError:
    return ArgumentError(
        f"expected to write {path}, got {error.strerror or error}; choose another place"
    )


def _opened(dataset: Any) -> Any:
    import xarray

    if isinstance(dataset, xarray.DataArray):
        return dataset.to_dataset(name=dataset.name or "values")
    if isinstance(dataset, xarray.Dataset):
        return dataset
    if isinstance(dataset, (str, os.PathLike)):
        return open_store(dataset)
    raise ArgumentError(
        f"expected an xarray.Dataset or the path of a store, got {value_text(dataset)}"
    )


def _real_parts(dataset: xarray.Dataset) -> xarray.Dataset:
    """Complex variables as two real ones, and attributes as texts and numbers."""
    variables: dict[Hashable, xarray.DataArray] = {}
    for name, array in dataset.data_vars.items():
        parts = {name: array}
        if array.dtype.kind == "c":
            parts = {f"{name}_real": array.real, f"{name}_imag": array.imag}
        variables |= {key: part.assign_attrs(array.attrs) for key, part in parts.items()}
    found = dataset.drop_vars(list(dataset.data_vars)).assign(variables).drop_encoding()
    for each in (found, *(found[name] for name in found.variables)):
        each.attrs = {name: _plain(value) for name, value in each.attrs.items()}
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, (str, int, float, np.ndarray, np.number)) and not isinstance(value, bool):
        return value
    return json.dumps(value)


def _header(dataset: xarray.Dataset) -> str:
    """The file up to its values, over axes x, y and z; an axis that is missing has one sample."""
    shapes = {name: array.dims for name, array in dataset.data_vars.items()}
    dims = next(iter(shapes.values()), ())
    if not 1 <= len(dims) <= 3 or any(other != dims for other in shapes.values()):
        raise ArgumentError(
            f"expected variables over the same one to three axes, got {shapes}; select a part by "
            "dataset.isel, or write NetCDF"
        )
    for name, array in dataset.data_vars.items():
        if array.dtype.name not in _VTK_TYPES:
            raise ArgumentError(f"expected {name} as floats, got {array.dtype}")
    in_space = tuple(sorted(dims)) == dims and set(dims) <= set("xyz")
    axes = tuple("xyz") if in_space else (*dims, None, None)[:3]
    origins, steps, ends = zip(*(_axis(dataset, name) for name in axes), strict=True)
    extent = " ".join(f"0 {end}" for end in ends)
    origin, spacing = (" ".join(map(repr, numbers)) for numbers in (origins, steps))
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        f'<ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}">',
        f'<Piece Extent="{extent}">',
        "<PointData>",
    ]
    offset = 0
    for name, array in dataset.data_vars.items():
        kind = _VTK_TYPES[array.dtype.name]
        lines.append(
            f'<DataArray type="{kind}" Name={quoteattr(str(name))} format="appended" '
            f'offset="{offset}"/>'
        )
        offset += 8 + array.nbytes
    lines += ["</PointData>", "</Piece>", "</ImageData>", '<AppendedData encoding="raw">', "_"]
    return "\n".join(lines)


def _axis(dataset: xarray.Dataset, name: Hashable | None) -> tuple[float, float, int]:
    """First value, step and last index of an axis; values without this axis have one sample."""
    is_known = name in dataset.coords and dataset[name].ndim == 0
    if name not in dataset.dims and not is_known:
        return 0.0, 1.0, 0
    points = np.atleast_1d(np.asarray(dataset[name], np.float64))
    if len(points) == 1:
        return float(points[0]), 1.0, 0
    step = (points[-1] - points[0]) / (len(points) - 1)
    if not step > 0 or np.abs(np.diff(points) - step).max() > _EVEN * step:
        raise ArgumentError(
            f"expected evenly spaced ascending values of {name} for VTK image data, got others; "
            "write NetCDF"
        )
    return float(points[0]), float(step), len(points) - 1


def _append(file: BinaryIO, array: Any) -> None:
    """One variable, x running fastest, from slabs along the last axis."""
    file.write(np.uint64(array.nbytes).astype("<u8").tobytes())
    last = array.dims[-1]
    thickness = max(1, _SLAB // max(1, math.prod(array.shape[:-1])))
    if array.chunks:  # whole chunks, if some fit
        chunk = array.chunks[-1][0]
        thickness = max(thickness // chunk * chunk, min(thickness, chunk))
    for start in range(0, array.sizes[last], thickness):
        values = array.isel({last: slice(start, start + thickness)}).values
        file.write(np.ascontiguousarray(values.T, values.dtype.newbyteorder("<")).data)
