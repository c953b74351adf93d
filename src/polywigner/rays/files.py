"""Readers and writers of rays in source files of Ansys Zemax OpticStudio (.dat)."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError, at_key
from polywigner.geometry.arguments import checked_flag, checked_path, warn_caller
from polywigner.geometry.io.limits import check_regular
from polywigner.interruption import atomic_path
from polywigner.rays.bundles import bundle, checked_bundle, count_of

if TYPE_CHECKING:
    import xarray

Values = NDArray[np.float64]

# Length of each unit (m, in, cm, ft, mm) in metres, indexed by the header field DimensionUnits.
_METRES = (1.0, 0.0254, 0.01, 0.3048, 0.001)
_MM = 4

_IDENTIFIERS = 1010, 8675309  # identifiers of the current and of older versions of the format
_HEADER = np.dtype(
    [("Identifier", "<i4"), ("NbrRays", "<u4"), ("Description", "S100")]
    + [(name, "<f4") for name in ("SourceFlux", "RaySetFlux", "Wavelength")]
    + [(f"{angle}{end}", "<f4") for angle in ("Inclination", "Azimuth") for end in ("Beg", "End")]
    + [("DimensionUnits", "<i4"), ("Loc", "<f4", 3), ("Rot", "<f4", 3), ("Scale", "<f4", 3)]
    + [("unused", "<f4", 4), ("ray_format_type", "<i4"), ("flux_type", "<i4")]
    + [("reserved", "<i4", 2)]
)
# Number of values per ray, by the header field ray_format_type.
_NUMBERS = {0: 7, 2: 8}
_MICROMETRE = 1e-6
# For each file that is written: sign of its powers, suffix of its name, and description in its
# header.
_SIGNED = 1, "", "signed"
_SPLIT = (1, "_positive", "positive part"), (-1, "_negative", "negative part, to be subtracted")
# Pattern of the description in files written by polywigner: number of rays that were drawn, and
# sign of their powers.
_OURS = re.compile(r"polywigner rays of (\d+): (signed|positive|negative)")


def save(
    rays: xarray.Dataset, path: str | os.PathLike[str], *, split: bool = False
) -> tuple[Path, ...]:
    """Write rays to a binary source file of OpticStudio.

    The file has a header of 208 bytes, then x, y, z (mm), l, m, n and power (W) of each ray in
    single precision. To store rays for polywigner, use :func:`polywigner.write_netcdf` and
    ``xarray.load_dataset``.

    Other programs expect positive powers, and may clip, ignore or reject negative ones; a warning
    reports the fraction of negative powers. With ``split`` two files with positive powers are
    written, NAME_positive.dat and NAME_negative.dat. Trace the rays of both files, and subtract the
    irradiance of the second file from the irradiance of the first one.

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
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        parts = _SPLIT if is_split else (_SIGNED,)
        return tuple(_write_part(rays, columns, target, *part) for part in parts)
    except OSError as error:
        raise ArgumentError(
            f"cannot write {path}: {error.strerror or error}; choose another path"
        ) from error


def _checked_file(path: str | os.PathLike[str]) -> Path:
    file = checked_path(path)
    if file.suffix.lower() != ".dat":
        raise ArgumentError(
            f"the suffix of a ray file must be .dat, got {file.name!r}; to store rays for "
            "polywigner, use polywigner.write_netcdf and xarray.load_dataset"
        )
    return file


def _write_part(
    rays: xarray.Dataset, columns: Values, path: Path, sign: int, suffix: str, description: str
) -> Path:
    """Write rays (n, 7) and return the path; with a suffix, write the rays of one sign only."""
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
    # Coordinates of lost rays may overflow.
    with atomic_path(path) as scratch, np.errstate(over="ignore"):
        scratch.write_bytes(header.tobytes() + columns.astype("<f4").tobytes())
    return path


def _warn_of_negative(weight: Values) -> None:
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
    """Read rays from a file of OpticStudio, written by :func:`polywigner.rays.save` or others.

    Rays from the negative part of a split file have negative weights. Join both parts by
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
        return FileFormatError(
            f"expected {file.name} to be a ray file of OpticStudio, got {got}; export the file again"
        )

    with at_key(file.name):
        check_regular(file)
    content = file.read_bytes()
    if len(content) < _HEADER.itemsize:
        raise wrong(f"a file of {len(content)} bytes")
    header = np.frombuffer(content, _HEADER, 1)[0]
    if header["Identifier"] not in _IDENTIFIERS:
        raise wrong(f"the identifier {header['Identifier']}")
    columns = _NUMBERS.get(int(header["ray_format_type"]))
    unit, count = int(header["DimensionUnits"]), int(header["NbrRays"])
    if columns is None or not 0 <= unit < len(_METRES):
        raise wrong(f"ray format {header['ray_format_type']} with unit of length {unit}")
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
    # The positions of lost rays are NaN.
    is_valid = np.isfinite(position).all(axis=1)
    if not np.isfinite(rays[is_valid, 3:7]).all():
        raise wrong("directions or powers that are NaN")
    if not direction.any(axis=1).all():
        raise wrong("directions of length zero")
    # Unit vectors in single precision have errors of 6e-8.
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if ours := _OURS.match(header["Description"].decode("utf-8", "replace")):
        attrs["count"] = int(ours[1])
        weight = -weight if ours[2] == "negative" else weight
    return bundle(position, direction, weight, None, attrs)
