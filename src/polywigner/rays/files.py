"""Ray files: NumPy, CSV, NetCDF and source files of OpticStudio."""

from __future__ import annotations

import json
import os
import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError, MissingExtraError
from polywigner.geometry.arguments import checked_choice, checked_flag, checked_path, warn_caller
from polywigner.geometry.io.limits import check_regular
from polywigner.interruption import atomic_path
from polywigner.propagation.stores import required, write_netcdf
from polywigner.rays.bundles import bundle, checked_bundle, count_of

if TYPE_CHECKING:
    import xarray

Values = NDArray[np.float64]

LengthUnit = Literal["m", "in", "cm", "ft", "mm"]
METRES = {"m": 1.0, "in": 0.0254, "cm": 0.01, "ft": 0.3048, "mm": 0.001}
"""Units of length, in the order of their numbers in DimensionUnits."""

_COLUMNS = ["x", "y", "z", "l", "m", "n", "weight"]
_IDENTIFIERS = 1010, 8675309  # the second in files of old versions
_HEADER = np.dtype(
    [("Identifier", "<i4"), ("NbrRays", "<u4"), ("Description", "S100")]
    + [(name, "<f4") for name in ("SourceFlux", "RaySetFlux", "Wavelength")]
    + [(f"{angle}{end}", "<f4") for angle in ("Inclination", "Azimuth") for end in ("Beg", "End")]
    + [("DimensionUnits", "<i4"), ("Loc", "<f4", 3), ("Rot", "<f4", 3), ("Scale", "<f4", 3)]
    + [("unused", "<f4", 4), ("ray_format_type", "<i4"), ("flux_type", "<i4")]
    + [("reserved", "<i4", 2)]
)
# Numbers per ray by ray_format_type.
_NUMBERS = {0: 7, 2: 8}
_MICROMETRE = 1e-6
# Sign, suffix of the file name and description of the parts of a split file.
_SIGNED = 1, "", "signed"
_SPLIT = (1, "_positive", "positive part"), (-1, "_negative", "negative part, to be subtracted")
# Description of files by polywigner, which contains the sign and the number of rays drawn.
_OURS = re.compile(r"polywigner rays of (\d+): (signed|positive|negative)")
# Longest part of a library's message that is quoted.
_LONGEST = 200


def save(
    rays: xarray.Dataset,
    path: str | os.PathLike[str],
    *,
    split: bool = False,
    unit: LengthUnit = "mm",
) -> tuple[Path, ...]:
    """Write rays to a file in the format of its suffix.

    ======  ======================================================================================
    suffix  content
    ======  ======================================================================================
    .npz    NumPy arrays: position (n, 3) in m, direction (n, 3), weight (n,) in W, batch if there
            is one, and attrs, a text in JSON
    .csv    a first line of ``#`` and the attributes in JSON; then columns x, y, z (m), l, m, n,
            weight (W), and batch if there is one, with 17 digits
    .nc     NetCDF 4: the dataset
    .dat    binary source file of OpticStudio: a header of 208 bytes, then x, y, z, l, m, n and
            power of each ray in single precision, without batches
    ======  ======================================================================================

    Programs expect positive powers in a ``.dat`` file, and may clip, ignore or reject negative
    powers: a warning reports their fraction. ``split`` writes two files with positive powers,
    NAME_positive and NAME_negative: trace each, and subtract the second irradiance from the first.

    Parameters
    ----------
    rays : from :func:`polywigner.sample_rays`, :func:`load` or :func:`traced`.
    path : the file; an existing file is replaced.
    split : whether positive and negative rays of a ``.dat`` go to separate files.
    unit : unit of length in a ``.dat`` file.

    Returns
    -------
    The paths written.

    Raises
    ------
    ArgumentError : other objects than rays, another suffix, a path that cannot be written.
        MissingExtraError : no xarray (``.nc``: no h5netcdf).

    >>> import pathlib, tempfile
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 100)
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> [path.name for path in pw.rays.save(rays, folder / "square.dat", split=True)]
    ['square_positive.dat', 'square_negative.dat']
    >>> pw.rays.save(rays, folder / "square.npz")[0].stat().st_size > 0
    True
    """
    checked_choice(unit, "unit", METRES)
    target, is_split = checked_path(path), checked_flag(split, "split")
    suffix = _suffix_of(target)
    if is_split and suffix != ".dat":
        raise ArgumentError(f"expected split with .dat, got {suffix}, which has signed powers")
    position, direction, weight, batch = checked_bundle(rays)
    columns = np.column_stack([position, direction, weight])
    if suffix == ".dat" and not is_split:
        _warn_of_negative(weight)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".dat":
            parts = _SPLIT if is_split else (_SIGNED,)
            return tuple(_write_dat(rays, columns, target, unit, *part) for part in parts)
        with atomic_path(target) as scratch:
            if suffix == ".nc":
                write_netcdf(rays, scratch)
            elif suffix == ".npz":
                arrays: dict[str, Any] = {} if batch is None else {"batch": batch}
                arrays |= {"position": position, "direction": direction, "weight": weight}
                with scratch.open("wb") as file:
                    np.savez(file, **arrays, attrs=np.array(_text_of(rays.attrs)))
            else:
                names, digits = _COLUMNS, ["%.17g"] * 7
                if batch is not None:
                    columns = np.column_stack([columns, batch])
                    names, digits = [*names, "batch"], [*digits, "%d"]
                head = f"# {_text_of(rays.attrs)}\n{','.join(names)}"
                how = {"header": head, "comments": "", "encoding": "utf-8"}
                np.savetxt(scratch, columns, digits, ",", **how)
    except OSError as error:
        raise ArgumentError(
            f"expected to write {path}, got {error.strerror or error}; choose another path"
        ) from error
    return (target,)


def _suffix_of(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise ArgumentError(
            f"expected a file of rays ending with {', '.join(_READERS)}, got {path.name!r}"
        )
    return suffix


def _write_dat(
    rays: Any, columns: Values, path: Path, unit: str, sign: int, suffix: str, text: str
) -> Path:
    """Write rays (n, 7), lengths in m and watts; with a suffix only rays of one sign."""
    if suffix:
        columns = columns[columns[:, 6] * sign > 0]
        path = path.with_stem(path.stem + suffix)
    scale = np.array([1 / METRES[unit]] * 3 + [1.0] * 3 + [sign])
    header = np.zeros((), _HEADER)
    header["Identifier"], header["NbrRays"] = _IDENTIFIERS[0], len(columns)
    header["Description"] = f"polywigner rays of {count_of(rays)}: {text}".encode()
    header["SourceFlux"] = header["RaySetFlux"] = columns[:, 6].sum() * sign
    header["Wavelength"] = float(rays.attrs.get("wavelength", 0.0)) / _MICROMETRE
    header["InclinationEnd"], header["AzimuthEnd"] = 180.0, 360.0
    header["DimensionUnits"] = list(METRES).index(unit)
    header["Scale"] = 1.0
    with atomic_path(path) as scratch, np.errstate(over="ignore"):  # lost rays may overflow
        scratch.write_bytes(header.tobytes() + (columns * scale).astype("<f4").tobytes())
    return path


def _warn_of_negative(weight: Values) -> None:
    below = weight < 0
    if below.any():
        fraction = float(np.abs(weight[below]).sum() / np.nansum(np.abs(weight)))
        warn_caller(
            f"got negative powers in {100 * below.mean():.0f} % of the rays of a .dat file, "
            f"{100 * fraction:.0f} % of all power by modulus, which programs may ignore or refuse; "
            "try a small file, or write positive and negative rays to two files with split=True",
            stacklevel=4,
        )


def load(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Read rays written by :func:`polywigner.rays.save`, or a source file of OpticStudio.

    The negative part of a split ``.dat`` gets negative weights:
    ``xarray.concat([positive, negative], "ray", combine_attrs="override")`` joins both parts.

    Parameters
    ----------
    path : ``.npz``, ``.csv``, ``.nc`` or ``.dat``.

    Returns
    -------
    xarray.Dataset, as returned by :func:`polywigner.sample_rays`.

    Raises
    ------
    ArgumentError : another suffix. FileFormatError : a file that does not exist or contains no
        rays. MissingExtraError : no xarray (``.nc``: no h5netcdf).

    >>> import pathlib, tempfile
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 100, sampling="uniform")
    >>> (path,) = pw.rays.save(rays, pathlib.Path(tempfile.mkdtemp()) / "square.csv")
    >>> pw.rays.load(path).equals(rays)
    True
    """
    file = checked_path(path)
    read = _READERS[_suffix_of(file)]
    try:
        check_regular(file)
        rays = read(file)
        position, direction, weight, _ = checked_bundle(rays)
        is_valid = np.isfinite(position).all(axis=1)  # positions of lost rays are NaN
        if not np.isfinite(np.column_stack([direction, weight])[is_valid]).all():
            raise ValueError("directions or powers that are NaN")
    except MissingExtraError:
        raise
    except FileFormatError as error:
        raise FileFormatError(f"{file.name}: {error}") from None
    except Exception as error:  # NumPy, zipfile and HDF5 raise many kinds for damaged files
        reason = str(error).splitlines()[0][:_LONGEST] if str(error) else type(error).__name__
        raise FileFormatError(
            f"expected rays in {file.name}, got {reason}; write it by rays.save"
        ) from None
    return rays


def _read_npz(file: Path) -> xarray.Dataset:
    with np.load(file, allow_pickle=False) as stored:
        position, direction, weight = (stored[k] for k in ("position", "direction", "weight"))
        attrs = json.loads(str(stored["attrs"]))
        return bundle(position, direction, weight, stored.get("batch"), attrs)


def _read_csv(file: Path) -> xarray.Dataset:
    with file.open(encoding="utf-8") as lines:
        attrs = json.loads(lines.readline().removeprefix("#"))
        names = lines.readline().strip().split(",")
        if names[:7] != _COLUMNS or names[7:] not in ([], ["batch"]):
            raise ValueError(f"columns {','.join(names)!r}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy warns of a file without rays
            table = np.loadtxt(lines, delimiter=",", ndmin=2).reshape(-1, len(names))
    batch = table[:, 7].astype(np.int32) if len(names) > 7 else None
    return bundle(table[:, :3], table[:, 3:6], table[:, 6], batch, attrs)


def _read_netcdf(file: Path) -> xarray.Dataset:
    import xarray

    required("h5netcdf")
    with xarray.open_dataset(file, engine="h5netcdf") as stored:
        return stored.load()


def _read_dat(path: Path) -> xarray.Dataset:
    """Read rays of OpticStudio's files, also from other programs, in watts, of one wavelength."""

    def wrong(got: str) -> FileFormatError:
        return FileFormatError(f"expected a source file of OpticStudio, got {got}; export it again")

    content = path.read_bytes()
    if len(content) < _HEADER.itemsize:
        raise wrong(f"{len(content)} bytes")
    header = np.frombuffer(content, _HEADER, 1)[0]
    if header["Identifier"] not in _IDENTIFIERS:
        raise wrong(f"the identifier {header['Identifier']}")
    columns, units = _NUMBERS.get(int(header["ray_format_type"])), list(METRES.values())
    unit, count = int(header["DimensionUnits"]), int(header["NbrRays"])
    if columns is None or not 0 <= unit < len(units):
        raise wrong(f"format {header['ray_format_type']} in unit {unit}")
    if header["flux_type"] != 0:
        raise wrong("powers in lumens, not in watts")
    size = len(content) - _HEADER.itemsize
    if size != 4 * count * columns:
        raise wrong(f"{size} bytes for {count} rays")
    rays = np.frombuffer(content, "<f4", offset=_HEADER.itemsize).astype(np.float64)
    rays = rays.reshape(count, columns)
    wavelengths = np.unique(rays[:, 7:])
    if len(wavelengths) > 1:
        raise wrong(f"{len(wavelengths)} wavelengths in one file")
    wavelength = float([*wavelengths, header["Wavelength"]][0])
    attrs: dict[str, Any] = {"wavelength": wavelength * _MICROMETRE} if wavelength > 0 else {}
    position, direction, weight = rays[:, :3] * units[unit], rays[:, 3:6], rays[:, 6]
    if not direction.any(axis=1).all():
        raise wrong("directions of no length")
    # in single precision unit vectors have an error of 6e-8
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if ours := _OURS.match(header["Description"].decode("utf-8", "replace")):
        attrs["count"] = int(ours[1])
        weight = -weight if ours[2] == "negative" else weight
    return bundle(position, direction, weight, None, attrs)


_READERS = {".npz": _read_npz, ".csv": _read_csv, ".nc": _read_netcdf, ".dat": _read_dat}


def _text_of(attrs: Any) -> str:
    """Return attributes in JSON; values other than numbers become texts."""

    def plain(value: Any) -> object:
        return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)

    return json.dumps({str(name): value for name, value in attrs.items()}, default=plain)
