"""Binary source files of OpticStudio (Zemax), which other optics programs read as well.

208 bytes of header (_HEADER), then for each ray seven or eight floats in single precision, little
endian: x, y, z, l, m, n, power, and in the spectral format the wavelength in micrometres. As the
help of OpticStudio describes them ("Source File: Binary Source File Format", identifier 1010), and
of the header reads NbrRays, DimensionUnits, ray_format_type and flux_type only.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError

__all__ = ["METRES", "read_source_file", "write_source_file"]

Values = NDArray[np.float64]

METRES = {"m": 1.0, "in": 0.0254, "cm": 0.01, "ft": 0.3048, "mm": 0.001}
"""Units of length, in the order of their numbers in DimensionUnits."""

_IDENTIFIERS = 1010, 8675309  # the second in files of old versions
_HEADER = np.dtype(
    [
        ("Identifier", "<i4"),
        ("NbrRays", "<u4"),
        ("Description", "S100"),
        ("SourceFlux", "<f4"),
        ("RaySetFlux", "<f4"),
        ("Wavelength", "<f4"),
        ("InclinationBeg", "<f4"),
        ("InclinationEnd", "<f4"),
        ("AzimuthBeg", "<f4"),
        ("AzimuthEnd", "<f4"),
        ("DimensionUnits", "<i4"),
        ("Loc", "<f4", 3),
        ("Rot", "<f4", 3),
        ("Scale", "<f4", 3),
        ("unused", "<f4", 4),
        ("ray_format_type", "<i4"),
        ("flux_type", "<i4"),
        ("reserved", "<i4", 2),
    ]
)
_COLUMNS = {0: 7, 2: 8}
# Rays at a time.
_BLOCK = 1 << 20
_MICROMETRE = 1e-6
# Our own description, from which the sign of a part and how many rays were drawn are read back.
_PARTS = {1: "signed", +2: "positive part", -2: "negative part, to be subtracted"}
_OURS = re.compile(r"polywigner rays of (\d+): (signed|positive|negative)")


def write_source_file(
    path: Path, columns: Values, wavelength: float, unit: str, count: int, part: int
) -> None:
    """Write rays (n, 7), lengths in m and watts, to a file in single precision.

    ``count`` : how many rays were drawn. ``part`` : 1 for all, 2 for those above zero, -2 for those
    below, of which the file has the moduli.
    """
    if abs(part) > 1:
        columns = columns[columns[:, 6] * part > 0]
    scale = np.array([1 / METRES[unit]] * 3 + [1.0] * 3 + [-1.0 if part < 0 else 1.0])
    header = np.zeros((), _HEADER)
    flux = float(columns[:, 6].sum() * scale[6])
    header["Identifier"], header["NbrRays"] = _IDENTIFIERS[0], len(columns)
    header["Description"] = f"polywigner rays of {count}: {_PARTS[part]}".encode()
    header["SourceFlux"] = header["RaySetFlux"] = flux
    header["Wavelength"] = wavelength / _MICROMETRE
    header["InclinationEnd"], header["AzimuthEnd"] = 180.0, 360.0
    header["DimensionUnits"] = list(METRES).index(unit)
    header["Scale"] = 1.0
    with path.open("wb") as file:
        file.write(header.tobytes())
        with np.errstate(over="ignore"):  # infinite: lost
            for start in range(0, len(columns), _BLOCK):
                file.write((columns[start : start + _BLOCK] * scale).astype("<f4").tobytes())


def read_source_file(path: Path) -> tuple[Values, dict[str, Any]]:
    """Rays (n, 7), lengths in m and watts, and what the header says of them.

    Files of other programs too, in watts and with one wavelength. Raises FileFormatError for
    others, OSError for those that cannot be read.
    """
    with path.open("rb") as file:
        start = file.read(_HEADER.itemsize)
        if len(start) < _HEADER.itemsize:
            raise _wrong(path, f"{len(start)} bytes")
        header = np.frombuffer(start, _HEADER)[0]
        if header["Identifier"] not in _IDENTIFIERS:
            raise _wrong(path, f"the identifier {header['Identifier']}")
        columns = _COLUMNS.get(int(header["ray_format_type"]))
        units = list(METRES.values())
        number = int(header["DimensionUnits"])
        if columns is None or not 0 <= number < len(units):
            raise _wrong(path, f"format {header['ray_format_type']} in unit {number}")
        if header["flux_type"] != 0:
            raise FileFormatError(f"expected {path.name} in watts, got lumens")
        n = int(header["NbrRays"])
        size = path.stat().st_size - _HEADER.itemsize
        if size != 4 * n * columns:
            raise _wrong(path, f"{size} bytes for {n} rays")
        rays = np.fromfile(file, "<f4", n * columns).reshape(n, columns).astype(np.float64)
    wavelength = float(header["Wavelength"])
    if columns > 7:
        different = np.unique(rays[:, 7])
        if len(different) > 1:
            raise FileFormatError(
                f"expected {path.name} with one wavelength, got {len(different)}; export a file "
                "for each"
            )
        wavelength = float(different[0]) if n else wavelength
    rays = rays[:, :7]
    rays[:, :3] *= units[number]
    # single precision: lengths of directions are one to 6e-8 only
    rays[:, 3:6] /= np.linalg.norm(rays[:, 3:6], axis=1, keepdims=True)
    attrs: dict[str, Any] = {"wavelength": wavelength * _MICROMETRE} if wavelength > 0 else {}
    ours = _OURS.match(header["Description"].decode("utf-8", "replace"))
    if ours:
        attrs["count"] = int(ours[1])
        if ours[2] == "negative":
            rays[:, 6] *= -1
    return rays, attrs


def _wrong(path: Path, got: str) -> FileFormatError:
    return FileFormatError(
        f"expected {path.name} as a binary source file of OpticStudio, got {got}; export it anew"
    )
