"""Radiation patterns read from files of simulators and planning tools."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.arguments import checked_length, checked_path, warn_caller
from polywigner.geometry.io.limits import bytes_of, check_most, text_of
from polywigner.propagation.element_patterns import ElementPattern, covers_front
from polywigner.propagation.far_field_tables import (
    DIPOLE_GAIN,
    FREE_SPACE,
    Complex,
    FarFieldTable,
    Floats,
    cst_table,
    feko_far_field,
    frequency_of,
    hfss_report,
    numbers_of,
)
from polywigner.propagation.patterns import described, jones_of, vector_dataset
from polywigner.propagation.places import angle_axes
from polywigner.quantities import SPEED_OF_LIGHT

if TYPE_CHECKING:
    import xarray

# Directions of a table.
_MOST_DIRECTIONS = 2_000_000

# Relative difference between a requested frequency and the frequency of a file.
_SAME_FREQUENCY = 1e-3
# Differences in dB between the directivity in a file and the integral over its directions: one that
# rounding explains, and one that missing directions or coarse steps hardly explain.
_SAME_LEVEL, _CONTRADICTION = 0.1, 1.0
# Relative difference of fields that a file has for one direction twice, such as phi = 0 and 360.
_SAME_FIELD = 1e-3
# Cuts with fewer meridians are not integrated over directions.
_LEAST_MERIDIANS = 8


def read_pattern(path: str | os.PathLike[str], frequency: float | None = None) -> xarray.Dataset:
    """Read a far field from a file of a simulator, or the cuts of a planning tool.

    ======  =====================================================================================
    suffix  content
    ======  =====================================================================================
    .csv    Reports of HFSS: columns Theta, Phi and rETheta, rEPhi as re and im, as mag and ang_deg,
            or as complex numbers; levels such as dB(GainTheta) with phases; Freq.
    .txt    Far-field table of CST: Abs and Phase of Theta and Phi.
    .ffd    Far-field data of HFSS, with one or several frequencies.
    .ffe    Far fields of FEKO, with one or several frequencies.
    .cut    Spherical cuts of GRASP: ICOMP 1, 2 or 3, polar or conical.
    .msi    MSI Planet, also .pln: gain and attenuations in two planes, without fields.
    ======  =====================================================================================

    Headers specify the units: fields in V or V/m (rE, or E at 1 m), power in W/sr, W or W/m2 (at
    1 m), with prefixes and in dB (dBuV/m, dBm/m2), gain and directivity as numbers, dBi or dBd, and
    angles in deg or rad. Other units are errors. Columns that repeat the result (Abs(Dir.),
    GainTotal) must agree with the components to 0.1 dB.

    Parameters
    ----------
    path : the suffix specifies the format. Angles are evenly spaced, theta from 0 to 90 or to 180
        degrees and phi around the full circle, or theta from -180 to 180 degrees. Cuts of .cut
        files may be fewer. Without directions behind the plane, nothing is radiated backwards.
    frequency : in Hz, of a file with several frequencies. A file without a frequency (.csv, .txt,
        .cut) is taken to be of this one.

    Returns
    -------
    xarray.Dataset
        As :func:`radiation_pattern` returns of a polarised source, with its sign of time; theta is
        0 or more. The beam is the largest sample. The radiated power is the integral of the field
        over all directions, or follows from the directivity in the file. Files in dBi, and .cut
        files, have a radiated power near 1 W. The aperture power is NaN, as are frequency and
        wavelength if the file has none. Files .msi and .pln have the gain in ``directivity`` over
        theta from -180 to 180 degrees at phi = 0 (horizontal) and 90 degrees (vertical), no
        ``field``, and a radiated power of NaN.

    Raises
    ------
    FileFormatError for a file that is missing, over 64 MiB, of another format, or damaged; for
    units that are not supported, columns that contradict each other, angles that do not cover the
    front, fields that are not finite, and zeros only; for several frequencies without
    ``frequency``, and one that the file does not have. ArgumentError for no path.

    Warns
    -----
    PolywignerWarning if the integral over the directions of the file differs by more than 0.1 dB
    from its directivity, which is then returned (above 1 dB it is an error, unless directions are
    missing); if a gain exceeds the directivity; and for a .msi
    file whose GAIN has no unit, which is taken in dBd.

    >>> import numpy as np, polywigner as pw
    >>> import pathlib, tempfile
    >>> angles = np.radians(np.arange(0, 91, 5)), np.radians(np.arange(0, 360, 10))
    >>> horn = pw.radiation_pattern(pw.shapes.square(4e-3), 3.9e-3, *angles, polarisation="x")
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "horn.ffd"
    >>> pw.write_pattern(horn, path)
    >>> found = pw.read_pattern(path)
    >>> bool(abs(found["directivity"] - horn["directivity"])[:18].max() < 1e-6)
    True
    """
    wanted = (
        None
        if frequency is None
        else checked_length(frequency, "frequency", meaning="a frequency in Hz above zero")
    )
    return _read(checked_path(path), wanted, _SAME_FREQUENCY)


def read_nearest_pattern(path: str | os.PathLike[str], frequency: float) -> xarray.Dataset:
    """Read the pattern of a file at its frequency nearest to one in Hz."""
    return _read(checked_path(path), frequency, math.inf)


def _read(file: Path, frequency: float | None, tolerance: float) -> xarray.Dataset:
    suffix = file.suffix.lower()
    try:
        if suffix not in (known := [*_LOADERS, ".msi", ".pln"]):
            raise FileFormatError(
                f"expected a pattern file with the suffix {', '.join(known)}, got "
                f"{suffix or 'none'!r}"
            )
        lines = text_of(bytes_of(file)).splitlines()
        check_most(len(lines), _MOST_DIRECTIONS + 10, "lines", "export coarser steps")
        if suffix not in _LOADERS:
            return _planning_cuts(lines)
        return _dataset(_selected(list(_LOADERS[suffix](lines)), frequency, tolerance))
    except PolywignerError as error:
        raise FileFormatError(f"{file}: {error}") from None


def _selected(
    tables: list[FarFieldTable], frequency: float | None, tolerance: float
) -> FarFieldTable:
    """The table at a frequency, which a file with several needs."""
    if not tables:
        raise FileFormatError("expected a far field, got none")
    known = np.array([table.frequency for table in tables])
    if len(tables) == 1 and (frequency is None or math.isnan(known[0])):
        if frequency is None:
            return tables[0]
        return replace(tables[0], frequency=frequency)
    listed = ", ".join(f"{value:g}" for value in known[:6]) + ", ..." * (len(known) > 6)
    if np.isnan(known).any() or len(np.unique(known)) < len(known):
        raise FileFormatError("expected one far field for each frequency, got several; keep one")
    if frequency is None:
        raise FileFormatError(
            f"expected one frequency, got {len(known)}; give frequency= as one of {listed} Hz"
        )
    nearest = int(np.abs(known - frequency).argmin())
    if not abs(known[nearest] / frequency - 1) <= tolerance:
        raise FileFormatError(f"expected a frequency of {frequency:g} Hz, got {listed} Hz")
    return tables[nearest]


def _dataset(table: FarFieldTable) -> xarray.Dataset:
    """The pattern of a table: over all directions, or of some cuts with a known power."""
    fields = table.fields.conj() / math.sqrt(2 * FREE_SPACE)
    _check_once(table.theta, table.phi)
    flat = _folded(table.theta, table.phi, fields)
    axes = np.unique(flat[0]), np.unique(flat[1])
    few = len(axes[1]) < _LEAST_MERIDIANS or not covers_front(*map(np.radians, axes))
    if table.has_unit_power and few:
        theta, phi, components = _gridded(table.theta.round(6), table.phi.round(6), fields)
        if not np.abs(components).max() > 0:
            raise FileFormatError("expected a far field other than zero, got zeros only")
        power = 1.0
    else:
        theta, phi, components = _gridded(*flat)
        integral = ElementPattern(theta, phi, tuple(components)).power(0.0)
        power = _radiated_power(table, integral)
    polar, azimuthal = components
    squares = np.square(np.abs(components)).sum(axis=0)
    with np.errstate(divide="ignore"):
        levels = 10 * np.log10(4 * math.pi / power * squares)
    sine, cosine = np.sin(phi), np.cos(phi)
    along = polar * cosine - azimuthal * sine, polar * sine + azimuthal * cosine
    peak = np.unravel_index(levels.argmax(), levels.shape)
    about = _about(theta, phi, levels, table.frequency, power)
    jones = jones_of((along[0][peak], along[1][peak]))
    return vector_dataset(angle_axes(theta, phi), levels, along, jones, about)


def _about(
    theta: Floats, phi: Floats, levels: Floats, frequency: float, power: float
) -> dict[str, Any]:
    """The attributes of a pattern whose beam is its largest sample."""
    row, column = np.unravel_index(levels.argmax(), levels.shape)
    on_other_side = theta[row] < 0
    return {
        "wavelength": SPEED_OF_LIGHT / frequency,
        "frequency": frequency,
        "radiated_power": power,
        "aperture_power": math.nan,
        **dict.fromkeys(("largest_directivity", "peak_directivity"), float(levels.max())),
        "peak_theta": float(abs(theta[row])),
        "peak_phi": float((phi[column] + math.pi * on_other_side) % (2 * math.pi)),
    }


def _check_once(theta: Floats, phi: Floats) -> None:
    """Raise FileFormatError for a direction with the same angles in two rows."""
    if len(np.unique(np.column_stack([theta, phi]).round(6), axis=0)) < len(theta):
        raise FileFormatError("expected each direction once, got some several times")


def _folded(theta: Floats, phi: Floats, fields: Complex) -> tuple[Floats, Floats, Complex]:
    """Directions with theta moved into 0 to 180 and phi into 0 up to below 360 degrees.

    The unit vectors change their signs from (-theta, phi) to (theta, phi + 180), and at the poles
    from phi to phi + 180. Rows are added there if the other half of the turn is missing.
    """
    theta = theta.round(6) % 360
    beyond = theta > 180
    theta = np.where(beyond, 360 - theta, theta).round(6)
    phi = ((phi + 180 * beyond) % 360).round(6) % 360
    fields = np.where(beyond, -1, 1) * fields
    if beyond.any():
        poles = np.flatnonzero((theta == 0) | (theta == 180))
        opposite = ((phi[poles] + 180) % 360).round(6) % 360
        known = set(zip(theta[poles].tolist(), phi[poles].tolist(), strict=True))
        pairs = zip(theta[poles].tolist(), opposite.tolist(), strict=True)
        missing = np.array([pair not in known for pair in pairs], bool)
        added = poles[missing]
        theta = np.concatenate([theta, theta[added]])
        phi = np.concatenate([phi, opposite[missing]])
        fields = np.concatenate([fields, -fields[:, added]], axis=1)
    return theta, phi, fields


def _gridded(theta: Floats, phi: Floats, fields: Complex) -> tuple[Floats, Floats, Complex]:
    """Theta (n,) and phi (m,) in rad, and both components (2, n, m)."""
    rows, row = np.unique(theta, return_inverse=True)
    turns, column = np.unique(phi, return_inverse=True)
    check_most(len(rows) * len(turns), _MOST_DIRECTIONS, "directions", "export a grid of angles")
    grid = np.full((2, len(rows), len(turns)), np.nan, np.complex128)
    grid[:, row, column] = fields
    if np.isnan(grid).any():
        raise FileFormatError(
            f"expected each of {len(rows)} angles theta and {len(turns)} angles phi with each "
            f"other once, got {len(theta)} directions"
        )
    apart = np.abs(grid[:, row, column] - fields).max()
    if apart > _SAME_FIELD * np.abs(fields).max():
        raise FileFormatError(
            "expected one field in each direction, got two in some; compare the rows of phi = 0 "
            "and 360 degrees, and of theta and -theta"
        )
    return np.radians(rows), np.radians(turns), grid


def _radiated_power(table: FarFieldTable, integral: float) -> float:
    """The radiated power in W: of the directivity in the file, or the integral of the field."""
    squares = np.square(np.abs(table.fields)).sum(axis=0)
    peak = int(squares.argmax())
    strongest = float(squares[peak]) / (2 * FREE_SPACE)
    power = integral
    for column, sizes in table.repeated:
        if column.component == "total" and column.quantity == "directivity":
            power = strongest / float(sizes[peak])
    if table.has_unit_power and table.theta.max() < 180 - 1e-6:
        power = 1.0
    level, stated = (10 * math.log10(4 * math.pi * strongest / one) for one in (integral, power))
    # missing directions make the integral's level larger, not smaller
    is_sphere = table.theta.max() > 180 - 1e-6
    if (abs(level - stated) if is_sphere else stated - level) > _CONTRADICTION:
        raise FileFormatError(
            f"the file has a directivity of {stated:.2f} dBi, but the integral over its directions "
            f"gives {level:.2f} dBi; check the units in the header, or export finer steps"
        )
    if abs(level - stated) > _SAME_LEVEL:
        warn_caller(
            f"the file has a directivity of {stated:.2f} dBi, but the integral over its directions "
            f"gives {level:.2f} dBi: directions are missing, or steps are too coarse; the former "
            "is used"
        )
    for column, sizes in table.repeated:
        if column.component == "total" and column.quantity == "gain" and sizes[peak] > 0:
            gain = 10 * math.log10(4 * math.pi * float(sizes[peak]))
            if gain > stated + _SAME_LEVEL:
                warn_caller(
                    f"column {column.title} has a gain of {gain:.2f} dBi, which exceeds the "
                    f"directivity of {stated:.2f} dBi: directions are missing, steps are too "
                    "coarse, or its unit is another"
                )
    return power


# ---- formats without a header of columns ---------------------------------------------------------


def _hfss_far_field(lines: list[str]) -> Iterator[FarFieldTable]:
    """Far-field data of HFSS (.ffd): two axes, then a block for each frequency."""
    axes = []
    for number in (1, 2):
        start, stop, count = numbers_of(lines[number - 1 : number], number, 3)[0]
        axes.append(np.linspace(start, stop, _checked_count(count, number)))
    check_most(len(axes[0]) * len(axes[1]), _MOST_DIRECTIONS, "directions", "export fewer")
    theta, phi = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    words = lines[2].split() if len(lines) > 2 else []
    starts = [k for k, line in enumerate(lines) if line.split()[:1] == ["Frequency"]]
    if words != ["Frequencies", str(len(starts))] or starts[:1] != [3]:
        raise FileFormatError(
            "expected Frequencies and their number in line 3, and a line Frequency before the "
            "field of each, got others"
        )
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        table = numbers_of(lines[start + 1 : stop], start + 2, 4)
        if len(theta) != len(table):
            raise FileFormatError(f"expected {len(theta)} directions, got {len(table)}")
        fields = (table[:, ::2] + 1j * table[:, 1::2]).T
        yield FarFieldTable(theta, phi, fields, frequency_of(lines[start].split(maxsplit=1)[-1]))


def _checked_count(count: float, line: int) -> int:
    if not (1 <= count <= _MOST_DIRECTIONS and count == int(count)):
        raise FileFormatError(f"expected a number of angles in line {line}, got {count:g}")
    return int(count)


def _grasp_cuts(lines: list[str]) -> Iterator[FarFieldTable]:
    """Spherical cuts of GRASP (.cut): a text, seven numbers and the samples of each cut."""
    cuts: dict[float, list[tuple[Floats, Floats, Complex]]] = {}
    k = 0
    while k < len(lines):
        if not lines[k].strip():
            k += 1
            continue
        named = re.search(r"([\d.]+(?:[eE][-+]?\d+)?)\s*([kMGT]?Hz)\b", lines[k])
        start, step, number, constant, kind, cut, components = numbers_of(
            lines[k + 1 : k + 2], k + 2, 7
        )[0]
        if kind not in (1, 2, 3) or cut not in (1, 2) or components != 2:
            raise FileFormatError(
                "expected cuts of two components, ICOMP 1, 2 or 3, ICUT 1 or 2 and NCOMP 2, got "
                f"ICOMP {kind:g}, ICUT {cut:g}, NCOMP {components:g} in line {k + 2}; export "
                "E_theta and E_phi of a polar cut in the far field"
            )
        count = _checked_count(number, k + 2)
        table = numbers_of(lines[k + 2 : k + 2 + count], k + 3, 4)
        if len(table) != count:
            raise FileFormatError(f"expected {count} directions after line {k + 2}, got fewer")
        along, across = start + step * np.arange(count), np.full(count, constant)
        theta, phi = (along, across) if cut == 1 else (across, along)
        pair = table[:, ::2].T + 1j * table[:, 1::2].T
        of_frequency = cuts.setdefault(frequency_of(named[0]) if named else 0.0, [])
        of_frequency.append((theta, phi, _from_grasp(int(kind), pair, np.radians(phi))))
        k += 2 + count
    # |E|^2 is the directivity: 4 pi W are radiated
    scale = math.sqrt(2 * FREE_SPACE / (4 * math.pi))
    for frequency, parts in cuts.items():
        theta, phi, fields = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        fields = np.asarray(scale * fields, np.complex128)
        yield FarFieldTable(theta, phi, fields, frequency or math.nan, [], True)


def _from_grasp(kind: int, pair: Complex, phi: Floats) -> Complex:
    """E_theta and E_phi of these (1), of right- and left-hand parts (2), or of co and cross (3)."""
    if kind == 1:
        return pair
    co, cross = pair
    if kind == 2:  # (co -+ j cross)/sqrt(2)
        co, cross = (co + cross) / math.sqrt(2), 1j * (cross - co) / math.sqrt(2)
    # Ludwig's third definition, co along x
    sine, cosine = np.sin(phi), np.cos(phi)
    return np.stack([co * cosine + cross * sine, cross * cosine - co * sine])


_LOADERS: dict[str, Callable[[list[str]], Iterator[FarFieldTable]]] = {
    ".csv": hfss_report,
    ".txt": cst_table,
    ".ffd": _hfss_far_field,
    ".ffe": feko_far_field,
    ".cut": _grasp_cuts,
}

_NUMBER = r"([-+]?\d+\.?\d*(?:e[-+]?\d+)?)"


def _planning_cuts(lines: list[str]) -> xarray.Dataset:
    """The gain in an MSI Planet file (.msi, .pln) at phi = 0 and 90 degrees.

    Theta is from -180 to 180 degrees.
    """
    words = [line.split() for line in lines]
    values = {word[0].upper(): " ".join(word[1:]) for word in words if word}
    match = re.fullmatch(_NUMBER + r"\s*(dBi|dBd)?", values.get("GAIN", ""), re.IGNORECASE)
    if match is None:
        raise FileFormatError(f"expected GAIN in dBi or dBd, got {values.get('GAIN', '')[:30]!r}")
    unit = (match[2] or "dBd").lower()
    gain = float(match[1]) + (DIPOLE_GAIN if unit == "dbd" else 0.0)
    if match[2] is None:
        warn_caller(
            f"GAIN has no unit: it is taken in dBd, as the format specifies, {gain:.2f} dBi; "
            "add dBi or dBd"
        )
    frequency = _megahertz(values.get("FREQUENCY", ""))
    cuts = [_planning_cut(name, words, lines) for name in ("HORIZONTAL", "VERTICAL")]
    angles = cuts[0][0]
    if not np.array_equal(angles, cuts[1][0]):
        raise FileFormatError("expected the same angles in both cuts, got others")
    # The y axis points up. Seen from behind, x points to the left: angles of the file run to the
    # right and downwards.
    theta = np.where(angles > 180, 360 - angles, -angles)
    levels = gain - np.stack([attenuation for _, attenuation in cuts], axis=1)
    back = np.flatnonzero(theta == -180)
    theta = np.append(theta, 180.0 + np.zeros(len(back)))
    levels = np.concatenate([levels, levels[back]])
    order = np.argsort(theta)
    theta, levels, phi = np.radians(theta[order]), levels[order], np.array([0.0, math.pi / 2])
    about = _about(theta, phi, levels, frequency, math.nan)
    return described(None, angle_axes(theta, phi), {"directivity": levels}, about)


def _planning_cut(name: str, words: list[list[str]], lines: list[str]) -> tuple[Floats, Floats]:
    """Angles in degrees (n,), from 0 up to below 360, and attenuations in dB of a cut."""
    at = [k for k, word in enumerate(words) if word[:1] and word[0].upper() == name]
    if len(at) != 1 or not words[at[0]][1:2] or not words[at[0]][1].isdecimal():
        raise FileFormatError(f"expected one line {name} with a number of angles, got others")
    start, count = at[0], int(words[at[0]][1])
    table = numbers_of(lines[start + 1 : start + 1 + count], start + 2, 2)
    angles, rows = np.unique(table[:, 0] % 360, return_index=True)
    if len(table) != count or count < 4 or np.ptp(np.diff(angles, append=360.0)) > 1e-6:
        raise FileFormatError(
            f"expected {count} evenly spaced angles around the full circle after {name}, got others"
        )
    return angles, table[rows, 1]


def _megahertz(text: str) -> float:
    """A frequency in Hz; a number without a unit is in MHz. NaN for none, and for a band."""
    match = re.fullmatch(_NUMBER + r"\s*([kMGT]?Hz)?", text, re.IGNORECASE)
    if match is not None:
        return frequency_of(f"{match[1]} {match[2] or 'MHz'}")
    if text and not re.fullmatch(r"[\d.]+\s*-\s*[\d.]+\s*(MHz)?", text):
        raise FileFormatError(f"expected FREQUENCY in MHz, got {text[:30]!r}")
    return math.nan
