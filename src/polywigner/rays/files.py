"""Rays written to files, whole or not at all, and read back."""

from __future__ import annotations

import json
import os
import re
import warnings
from contextlib import ExitStack
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

METRES = {"m": 1.0, "in": 0.0254, "cm": 0.01, "ft": 0.3048, "mm": 0.001}
"""Units of length, in the order of their numbers in DimensionUnits."""

_IDENTIFIERS = 1010, 8675309  # the second in files of old versions
_HEADER = np.dtype(
    [("Identifier", "<i4"), ("NbrRays", "<u4"), ("Description", "S100")]
    + [(name, "<f4") for name in ("SourceFlux", "RaySetFlux", "Wavelength")]
    + [(f"{angle}{end}", "<f4") for angle in ("Inclination", "Azimuth") for end in ("Beg", "End")]
    + [("DimensionUnits", "<i4"), ("Loc", "<f4", 3), ("Rot", "<f4", 3), ("Scale", "<f4", 3)]
    + [("unused", "<f4", 4), ("ray_format_type", "<i4"), ("flux_type", "<i4")]
    + [("reserved", "<i4", 2)]
)
_NUMBERS = {0: 7, 2: 8}
# Rays at a time.
_BLOCK = 1 << 20
_MICROMETRE = 1e-6
# Our own description, from which the sign of a part and how many rays were drawn are read back.
_PART_NAMES = {1: "signed", +2: "positive part", -2: "negative part, to be subtracted"}
_OURS = re.compile(r"polywigner rays of (\d+): (signed|positive|negative)")


SUFFIXES = (".npz", ".csv", ".nc", ".dat")
"""Suffixes of the formats."""

LengthUnit = Literal["m", "in", "cm", "ft", "mm"]
_COLUMNS = ("x", "y", "z", "l", "m", "n", "weight")
_PARTS = {"_positive": 2, "_negative": -2}
_MOST_COUNTED = 1 << 53
# Of a library's message, which may quote the file.
_LONGEST = 200


def save(
    rays: xarray.Dataset,
    path: str | os.PathLike[str],
    *,
    split: bool = False,
    unit: LengthUnit = "mm",
) -> tuple[Path, ...]:
    """Write rays to a file, whose suffix says its format.

    ======  ======================================================================================
    suffix  what
    ======  ======================================================================================
    .npz    NumPy: position (n, 3) in m, direction (n, 3), weight (n,) in W, batch if there is one,
            and attrs, a text in JSON
    .csv    a first line of ``#`` and the attributes in JSON; then columns x, y, z (m), l, m, n,
            weight (W), and batch if there is one, with 17 digits
    .nc     NetCDF 4, the dataset as it is
    .dat    OpticStudio's binary source file: a header of 208 bytes, then x, y, z, l, m, n and
            power of each ray in single precision. Batches are not in it.
    ======  ======================================================================================

    Programs expect positive powers in a ``.dat`` file, and may clip, ignore or reject negative
    ones: there is a warning with their share. ``split`` writes two files, NAME_positive and
    NAME_negative, with positive powers both: trace each, and subtract the second picture from the
    first.

    Parameters
    ----------
    rays : from :func:`polywigner.sample_rays`, :func:`load` or :func:`traced`.
    path : the file; one that is there is replaced.
    split : positive and negative rays of a ``.dat`` in files of their own.
    unit : of lengths in a ``.dat`` file.

    Returns
    -------
    The paths written.

    Raises
    ------
    ArgumentError for anything but rays, for another suffix, and for a place that cannot be written
    to; MissingExtraError without xarray (of ``.nc``: h5netcdf).

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
    place, is_split = checked_path(path), checked_flag(split, "split")
    suffix = _suffix_of(place)
    if is_split and suffix != ".dat":
        raise ArgumentError(f"expected split with .dat, got {suffix}, which holds signed powers")
    position, direction, weight, batch = checked_bundle(rays)
    columns = np.column_stack([position, direction, weight])
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".dat":
            if not is_split:
                _warn_of_negative(weight)
            return _write_source_files(rays, columns, place, unit, is_split)
        with atomic_path(place) as scratch:
            if suffix == ".nc":
                write_netcdf(rays, scratch)
            elif suffix == ".npz":
                own: dict[str, Any] = {} if batch is None else {"batch": batch}
                own |= {"position": position, "direction": direction, "weight": weight}
                with scratch.open("wb") as file:
                    np.savez(file, **own, attrs=np.array(_text_of(rays.attrs)))
            else:
                names, digits = list(_COLUMNS), ["%.17g"] * 7
                if batch is not None:
                    columns = np.column_stack([columns, batch])
                    names, digits = [*names, "batch"], [*digits, "%d"]
                head = f"# {_text_of(rays.attrs)}\n{','.join(names)}"
                how = {"header": head, "comments": "", "encoding": "utf-8"}
                np.savetxt(scratch, columns, digits, ",", **how)
    except OSError as error:
        raise ArgumentError(
            f"expected to write {path}, got {error.strerror or error}; choose another place"
        ) from error
    return (place,)


def _suffix_of(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ArgumentError(
            f"expected a file of rays ending with {', '.join(SUFFIXES)}, got {path.name!r}"
        )
    return suffix


def _write_source_files(
    rays: Any, columns: Values, path: Path, unit: str, split: bool
) -> tuple[Path, ...]:
    """Write rays (n, 7), lengths in m and watts, in single precision; split ones have moduli."""
    parts = {path: 1}
    if split:
        parts = {path.with_name(f"{path.stem}{k}{path.suffix}"): n for k, n in _PARTS.items()}
    given = rays.attrs.get("wavelength")
    header = np.zeros((), _HEADER)
    header["Identifier"] = _IDENTIFIERS[0]
    if isinstance(given, (int, float, np.number)):
        header["Wavelength"] = float(given) / _MICROMETRE
    header["InclinationEnd"], header["AzimuthEnd"] = 180.0, 360.0
    header["DimensionUnits"] = list(METRES).index(unit)
    header["Scale"] = 1.0
    with ExitStack() as stack:
        for own, part in parts.items():
            kept = columns if part == 1 else columns[columns[:, 6] * part > 0]
            scale = np.array([1 / METRES[unit]] * 3 + [1.0] * 3 + [-1.0 if part < 0 else 1.0])
            name = f"polywigner rays of {count_of(rays)}: {_PART_NAMES[part]}"
            header["NbrRays"], header["Description"] = len(kept), name.encode()
            header["SourceFlux"] = header["RaySetFlux"] = kept[:, 6].sum() * scale[6]
            with stack.enter_context(atomic_path(own)).open("wb") as file:
                file.write(header.tobytes())
                with np.errstate(over="ignore"):  # infinite: lost
                    for start in range(0, len(kept), _BLOCK):
                        file.write((kept[start : start + _BLOCK] * scale).astype("<f4").tobytes())
    return tuple(parts)


def _warn_of_negative(weight: Any) -> None:
    below = weight < 0
    if below.any():
        share = float(np.abs(weight[below]).sum() / np.nansum(np.abs(weight)))
        warn_caller(
            f"got negative powers in {100 * below.mean():.0f} % of the rays of a .dat file, "
            f"{100 * share:.0f} % of all power by modulus, which programs may ignore or refuse; "
            "try a small file, or write positive and negative rays to two files with split=True",
            stacklevel=4,
        )


def load(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Rays of a file of :func:`polywigner.rays.save`, or of a source file of OpticStudio.

    The negative part of a ``.dat`` that was split comes back with negative weights:
    ``xarray.concat([positive, negative], "ray", combine_attrs="override")`` is the whole.

    Parameters
    ----------
    path : ``.npz``, ``.csv``, ``.nc`` or ``.dat``.

    Returns
    -------
    xarray.Dataset, as of :func:`polywigner.sample_rays`.

    Raises
    ------
    ArgumentError for another suffix; FileFormatError for a file that is missing, or does not hold
    rays; MissingExtraError without xarray (of ``.nc``: h5netcdf).

    >>> import pathlib, tempfile
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 100, sampling="uniform")
    >>> (path,) = pw.rays.save(rays, pathlib.Path(tempfile.mkdtemp()) / "square.csv")
    >>> pw.rays.load(path).equals(rays)
    True
    """
    file = checked_path(path)
    suffix = _suffix_of(file)
    try:
        check_regular(file)
    except FileFormatError as error:
        raise FileFormatError(f"{file}: {error}") from None
    read = {".npz": _read_npz, ".csv": _read_csv, ".nc": _read_netcdf, ".dat": _read_source_file}
    try:
        found = read[suffix](file)
        _check_loaded(found)
    except (FileFormatError, MissingExtraError):
        raise
    except Exception as error:  # NumPy, zipfile and HDF5 raise many kinds for damaged files
        said = str(error).splitlines()[0][:_LONGEST] if str(error) else type(error).__name__
        raise FileFormatError(
            f"expected rays in {file.name}, got {said}; write it by rays.save"
        ) from None
    return found


def _check_loaded(found: Any) -> None:
    """Raise ArgumentError or ValueError for numbers that no program writes as rays."""
    position, direction, weight, _ = checked_bundle(found)
    is_there = np.isfinite(position).all(axis=1)  # of a lost ray the position is not
    if not (np.isfinite(direction[is_there]).all() and np.isfinite(weight[is_there]).all()):
        raise ValueError("directions or powers that are no numbers")
    count = found.attrs.get("count", 0)
    if not isinstance(count, (int, np.integer)) or not 0 <= count < _MOST_COUNTED:
        raise ValueError(f"a count of {str(count)[:40]} rays drawn")


def _read_npz(file: Path) -> Any:
    with np.load(file, allow_pickle=False) as stored:
        position, direction, weight = (stored[k] for k in ("position", "direction", "weight"))
        attrs = _attrs(str(stored["attrs"]))
        return bundle(position, direction, weight, stored.get("batch"), attrs)


def _read_csv(file: Path) -> Any:
    with file.open(encoding="utf-8") as lines:
        first, second = lines.readline(), lines.readline()
        names = second.strip().split(",")
        attrs = _attrs(first.removeprefix("#"))
        if tuple(names[:7]) != _COLUMNS or names[7:] not in ([], ["batch"]):
            raise ValueError(f"columns {second[:200].strip()!r}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of no rays at all
            table = np.loadtxt(lines, delimiter=",", ndmin=2)
        table = table if table.size else np.empty((0, len(names)))
    if table.shape[1] != len(names):
        raise ValueError(f"{table.shape[1]} columns")
    batch = table[:, 7].astype(np.int32) if len(names) > 7 else None
    return bundle(table[:, :3], table[:, 3:6], table[:, 6], batch, attrs)


def _read_netcdf(file: Path) -> Any:
    import xarray

    required("h5netcdf")
    with warnings.catch_warnings(), ExitStack() as stack:
        warnings.simplefilter("ignore")  # of dimensions without names
        return stack.enter_context(xarray.open_dataset(file, engine="h5netcdf")).load()


def _read_source_file(path: Path) -> Any:
    """Read rays of OpticStudio's files, of other programs too, in watts and of one wavelength."""

    def wrong(got: str) -> FileFormatError:
        expected = f"expected {path.name} as a binary source file of OpticStudio"
        return FileFormatError(f"{expected}, got {got}; export it anew")

    content = path.read_bytes()
    if len(content) < _HEADER.itemsize:
        raise wrong(f"{len(content)} bytes")
    header = np.frombuffer(content, _HEADER, 1)[0]
    if header["Identifier"] not in _IDENTIFIERS:
        raise wrong(f"the identifier {header['Identifier']}")
    columns, units = _NUMBERS.get(int(header["ray_format_type"])), list(METRES.values())
    number, n = int(header["DimensionUnits"]), int(header["NbrRays"])
    if columns is None or not 0 <= number < len(units):
        raise wrong(f"format {header['ray_format_type']} in unit {number}")
    if header["flux_type"] != 0:
        raise FileFormatError(f"expected {path.name} in watts, got lumens")
    size = len(content) - _HEADER.itemsize
    if size != 4 * n * columns:
        raise wrong(f"{size} bytes for {n} rays")
    with np.errstate(invalid="ignore"):  # of a NaN that asks for it
        rays = np.frombuffer(content, "<f4", offset=_HEADER.itemsize).astype(np.float64)
    rays = rays.reshape(n, columns)
    wavelengths = np.unique(rays[:, 7:])
    if len(wavelengths) > 1:
        raise FileFormatError(
            f"expected {path.name} with one wavelength, got {len(wavelengths)}; export a file for "
            "each"
        )
    wavelength = float([*wavelengths, header["Wavelength"]][0])
    attrs: dict[str, Any] = {"wavelength": wavelength * _MICROMETRE} if wavelength > 0 else {}
    position, direction, weight = rays[:, :3] * units[number], rays[:, 3:6], rays[:, 6]
    if not direction.any(axis=1).all():
        raise wrong("directions of no length")
    # single precision: lengths of directions are one to 6e-8 only
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if ours := _OURS.match(header["Description"].decode("utf-8", "replace")):
        attrs["count"] = int(ours[1])
        weight = -weight if ours[2] == "negative" else weight
    return bundle(position, direction, weight, None, attrs)


def _attrs(text: str) -> dict[str, Any]:
    found = json.loads(text)
    if not isinstance(found, dict):
        raise ValueError("attributes that are no table")
    return found


def _text_of(attrs: Any) -> str:
    """Attributes in JSON: NumPy's numbers as Python's, others as texts."""

    def plain(value: Any) -> Any:
        return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)

    return json.dumps({str(name): value for name, value in attrs.items()}, default=plain)
