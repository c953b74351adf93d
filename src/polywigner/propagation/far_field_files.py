"""Far fields in files of simulators and planning tools: the tables of each format."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.io.limits import LARGEST_NUMBER, check_most, token
from polywigner.propagation.far_field_columns import (
    DIPOLE_GAIN,
    FREE_SPACE,
    Column,
    Complex,
    Floats,
    check_once,
    cst_columns,
    fields_of,
    simulator_column,
    unit_of,
)
from polywigner.quantities import parse_frequency

MOST_DIRECTIONS = 2_000_000
"""Directions of a table."""


@dataclass(frozen=True, eq=False)
class FarFieldTable:
    """The far field of one frequency, as its file has it: waves exp(+j omega t - j k r)."""

    theta: Floats
    """(n,) in degrees, from -180 to 180."""
    phi: Floats
    """(n,) in degrees."""
    fields: Complex
    """E_theta and E_phi (2, n): rE in V, peak values."""
    frequency: float = math.nan
    """In Hz; NaN if the file has none."""
    repeated: list[tuple[Column, Floats]] = field(default_factory=list)
    """Columns that repeat the result, as radiant intensities (n,) in W/sr."""
    has_unit_power: bool = False
    """Whether the format normalises the field to a radiated power of 1 W."""


class Attenuations(NamedTuple):
    """The two cuts of a planning tool."""

    angles: Floats
    """(n,) in degrees from 0 up to below 360, ascending."""
    horizontal: Floats
    """(n,) in dB below the gain."""
    vertical: Floats
    gain: float
    """In dBi."""
    frequency: float
    has_unit: bool
    """Whether the gain has a unit; else it is taken in dBd, as the format says."""


def _numbers(lines: Sequence[str], first: int, columns: int) -> Floats:
    """Real numbers (n, columns) of lines, the number of the first one being known."""
    return np.asarray(_table([line.split() for line in lines], first, columns).real)


# GRASP leaves out the E of exponents with three digits.
_SHORT_EXPONENT = re.compile(r"(?<=\d)([+-]\d{3})$")


def _number(cell: str) -> complex:
    text = cell.strip().replace(" ", "")
    try:
        return float(text)
    except ValueError:
        pass
    if text[-1:] in ("i", "j"):
        return complex(text[:-1] + "j")
    return float(_SHORT_EXPONENT.sub(r"e\1", text))


def _table(rows: Sequence[Sequence[str]], first: int, columns: int) -> NDArray[Any]:
    """Numbers (n, columns) of rows of cells; blank rows are left out."""
    found: list[list[complex]] = []
    for number, cells in enumerate(rows, start=first):
        if not any(cell.strip() for cell in cells):
            continue
        try:
            found.append([_number(cell) for cell in cells])
        except ValueError:
            found.append([])
        if len(found[-1]) != columns:
            raise FileFormatError(
                f"expected {columns} numbers, got {token(' '.join(cells).strip())} in line {number}"
            )
    if not found:
        raise FileFormatError("expected a line for each direction, got none")
    table = np.array(found)
    if not (np.abs(table) <= LARGEST_NUMBER).all():  # also for a NaN
        raise FileFormatError(f"expected finite numbers up to {LARGEST_NUMBER:g}, got others")
    return table


def _of_columns(
    columns: Sequence[Column | None], values: NDArray[Any], frequency: float = math.nan
) -> Iterator[FarFieldTable]:
    """The tables of columns with angles, one for each frequency in a column of frequencies."""
    check_once(columns)
    at = {c.quantity: k for k, c in enumerate(columns) if c is not None and c.part == "value"}
    for name in ("theta", "phi"):
        if name not in at:
            raise FileFormatError(
                f"expected a column {name.capitalize()} of angles in the header, got none"
            )
    column = {name: columns[k] for name, k in at.items()}
    numbers = {name: column[name].unit.scale * values[:, k].real for name, k in at.items()}  # type: ignore[union-attr]
    frequencies = numbers.get("frequency", np.full(len(values), frequency))
    for one in np.unique(frequencies):
        rows = slice(None) if np.isnan(one) else frequencies == one
        fields, repeated = fields_of(columns, values[rows])
        yield FarFieldTable(
            numbers["theta"][rows], numbers["phi"][rows], fields, float(one), repeated
        )


_HFSS_NAME = re.compile(r"(?P<title>[^\[]*?)\s*(?:\[(?P<unit>[^\]]*)\])?\s*(?:-\s*(?P<at>.*))?")


def _hfss_report(lines: list[str]) -> Iterator[FarFieldTable]:
    """A report of HFSS (.csv): one row for each direction, units in the header."""
    matches = [_HFSS_NAME.fullmatch(cell.strip()) for cell in next(csv.reader(lines[:1]))]
    columns = [match and simulator_column(match["title"], match["unit"]) for match in matches]
    conditions = {match["at"] for match in matches if match and match["at"]}
    values = re.findall(r"Freq='([^']*)'", " ".join(conditions))
    frequency = _frequency(values[0]) if len(set(values)) == 1 else math.nan
    if all(column is None for column in columns):
        raise FileFormatError(
            "expected the columns Theta, Phi, and re and im of rETheta and rEPhi in line 1, got "
            "others"
        )
    table = _table(list(csv.reader(lines[1:])), 2, len(columns))
    yield from _of_columns(columns, table, frequency)


def _cst_table(lines: list[str]) -> Iterator[FarFieldTable]:
    """The ASCII export of a far field of CST (.txt): a header, a rule, a row per direction."""
    columns = cst_columns(lines[0])
    if all(column is None for column in columns):
        raise FileFormatError(
            "expected the columns Theta, Phi, Abs(Theta), Phase(Theta), Abs(Phi) and Phase(Phi) of "
            "CST in line 1, got others"
        )
    first = 2 if len(lines) > 1 and set(lines[1].strip()) <= {"-"} else 1
    yield from _of_columns(columns, _numbers(lines[first:], first + 1, len(columns)))


def _hfss_far_field(lines: list[str]) -> Iterator[FarFieldTable]:
    """Far-field data of HFSS (.ffd): two axes, then a block for each frequency."""
    axes = []
    for number in (1, 2):
        start, stop, count = _numbers(lines[number - 1 : number], number, 3)[0]
        if not (1 <= count <= MOST_DIRECTIONS and count == int(count)):
            raise FileFormatError(f"expected a number of angles in line {number}, got {count:g}")
        axes.append(np.linspace(start, stop, int(count)))
    check_most(len(axes[0]) * len(axes[1]), MOST_DIRECTIONS, "directions", "export fewer")
    theta, phi = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    words = lines[2].split() if len(lines) > 2 else []
    starts = [k for k, line in enumerate(lines) if line.split()[:1] == ["Frequency"]]
    if words[:1] != ["Frequencies"] or words[1:] != [str(len(starts))] or starts[:1] != [3]:
        raise FileFormatError(
            "expected Frequencies and their number in line 3, and a line Frequency before the "
            "field of each, got others"
        )
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        table = _numbers(lines[start + 1 : stop], start + 2, 4)
        if len(theta) != len(table):
            raise FileFormatError(f"expected {len(theta)} directions, got {len(table)}")
        fields = (table[:, ::2] + 1j * table[:, 1::2]).T
        yield FarFieldTable(theta, phi, fields, _frequency(lines[start].split(maxsplit=1)[-1]))


def _frequency(text: str) -> float:
    """A frequency in Hz, as a number or with its unit."""
    try:
        value = float(text)
    except ValueError:
        try:
            return parse_frequency(text)
        except PolywignerError:
            value = math.nan
    if not 0 < value < math.inf:
        raise FileFormatError(f"expected a frequency above zero, got {token(text.strip())}")
    return value


def _feko_far_field(lines: list[str]) -> Iterator[FarFieldTable]:
    """A far field of FEKO (.ffe): headers of lines with #, then a row for each direction."""
    columns: list[Column | None] = []
    rows: list[list[str]] = []
    frequency, first = math.nan, 0
    for number, line in enumerate([*lines, "#Frequency: 1"], start=1):
        key, _, value = line.partition(":")
        key, value = key.strip().lower(), value.strip()
        if line.startswith("#") and rows:
            yield from _of_columns(columns, _table(rows, first, len(columns)), frequency)
            rows = []
        if key == "#frequency":
            frequency = _frequency(value)
        elif key == "#coordinate system" and value.lower() != "spherical":
            raise FileFormatError(f"expected spherical coordinates, got {token(value)}")
        elif key == "#result type" and value.lower() == "rcs":
            raise FileFormatError("expected the far field of an antenna, got cross sections (RCS)")
        elif line.startswith("#") and '"' in line:
            names = re.findall(r'"([^"]*)"\s*(?:\[([^\]]*)\])?', line)
            columns = [simulator_column(name, unit) for name, unit in names]
        elif line.strip() and not line.startswith(("#", "**")):
            first = first if rows else number
            rows.append(line.split())
            if not columns:
                raise FileFormatError(
                    f"expected the names of the columns in a line with # before line {number}, got "
                    "none"
                )


def _grasp_cuts(lines: list[str]) -> Iterator[FarFieldTable]:
    """Spherical cuts of GRASP (.cut): a text, seven numbers and the samples of each cut."""
    cuts: dict[float, list[tuple[Floats, Floats, Complex]]] = {}
    k = 0
    while k < len(lines):
        if not lines[k].strip():
            k += 1
            continue
        named = re.search(r"([\d.]+(?:[eE][-+]?\d+)?)\s*([kMGT]?Hz)\b", lines[k])
        frequency = _frequency(named[0]) if named else math.nan
        start, step, count, constant, kind, cut, components = _numbers(
            lines[k + 1 : k + 2], k + 2, 7
        )[0]
        if (kind, cut, components) not in {(i, c, 2) for i in (1, 2, 3) for c in (1, 2)}:
            raise FileFormatError(
                "expected cuts of two components, ICOMP 1, 2 or 3, ICUT 1 or 2 and NCOMP 2, got "
                f"ICOMP {kind:g}, ICUT {cut:g}, NCOMP {components:g} in line {k + 2}; export "
                "E_theta and E_phi of a polar cut in the far field"
            )
        if not (1 <= count <= MOST_DIRECTIONS and count == int(count)):
            raise FileFormatError(f"expected a number of angles in line {k + 2}, got {count:g}")
        rows = lines[k + 2 : k + 2 + int(count)]
        table = _numbers(rows, k + 3, 4)
        if len(table) != count:
            raise FileFormatError(f"expected {count:g} directions after line {k + 2}, got fewer")
        along, across = start + step * np.arange(count), np.full(int(count), constant)
        theta, phi = (along, across) if cut == 1 else (across, along)
        pair = table[:, ::2].T + 1j * table[:, 1::2].T
        of_frequency = cuts.setdefault(frequency if named else 0.0, [])
        of_frequency.append((theta, phi, _FROM_GRASP[int(kind)](pair, np.radians(phi))))
        k += 2 + int(count)
    # |E|^2 is the directivity: 4 pi W are radiated
    scale = math.sqrt(2 * FREE_SPACE / (4 * math.pi))
    for frequency, parts in cuts.items():
        theta, phi = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        fields = np.asarray(np.concatenate([part[2] for part in parts], axis=1), np.complex128)
        yield FarFieldTable(theta, phi, scale * fields, frequency or math.nan, [], True)


def _of_ludwig(pair: Complex, phi: Floats) -> Complex:
    """E_theta and E_phi of co- and cross-polar parts by Ludwig's third definition, co along x."""
    co, cross = pair
    sine, cosine = np.sin(phi), np.cos(phi)
    return np.stack([co * cosine + cross * sine, cross * cosine - co * sine])


def _of_circular(pair: Complex, phi: Floats) -> Complex:
    """E_theta and E_phi of right- and left-hand circular parts, (co -+ j cross)/sqrt(2)."""
    right, left = pair / math.sqrt(2)
    return _of_ludwig(np.stack([right + left, 1j * (left - right)]), phi)


_FROM_GRASP: dict[int, Callable[[Complex, Floats], Complex]] = {
    1: lambda pair, phi: pair,
    2: _of_circular,
    3: _of_ludwig,
}

LOADERS: dict[str, Callable[[list[str]], Iterator[FarFieldTable]]] = {
    ".csv": _hfss_report,
    ".txt": _cst_table,
    ".ffd": _hfss_far_field,
    ".ffe": _feko_far_field,
    ".cut": _grasp_cuts,
}
"""Loaders of files with complex fields, by suffix."""


def attenuations(lines: list[str]) -> Attenuations:
    """Return the cuts of an MSI Planet file (.msi, .pln)."""
    words = [line.split() for line in lines]
    values = {word[0].upper(): word[1:] for word in words if word}
    cuts = []
    for name in ("HORIZONTAL", "VERTICAL"):
        at = [k for k, word in enumerate(words) if word[:1] and word[0].upper() == name]
        if len(at) != 1 or not words[at[0]][1:2] or not words[at[0]][1].isdecimal():
            raise FileFormatError(f"expected one line {name} with a number of angles, got others")
        start, count = at[0], int(words[at[0]][1])
        check_most(count, MOST_DIRECTIONS, "directions", "export fewer")
        table = _numbers(lines[start + 1 : start + 1 + count], start + 2, 2)
        angles, rows = np.unique(table[:, 0] % 360, return_index=True)
        if len(table) != count or count < 4 or np.ptp(np.diff(angles, append=360.0)) > 1e-6:
            raise FileFormatError(
                f"expected {count} evenly spaced angles around the full circle after {name}, got "
                "others"
            )
        cuts.append((angles, table[rows, 1]))
    if not np.array_equal(cuts[0][0], cuts[1][0]):
        raise FileFormatError("expected the same angles in both cuts, got others")
    gain, has_unit = _gain(" ".join(values.get("GAIN", [])))
    frequency = _megahertz(" ".join(values.get("FREQUENCY", [])))
    return Attenuations(*cuts[0], cuts[1][1], gain, frequency, has_unit)


def _gain(text: str) -> tuple[float, bool]:
    """A gain in dBi, and whether the text has a unit; without one it is in dBd."""
    match = re.fullmatch(r"([-+\d.eE]+)\s*(dBi|dBd)?", text, re.IGNORECASE)
    if match is None:
        raise FileFormatError(f"expected GAIN in dBi or dBd, got {text[:30]!r}")
    unit = (match[2] or "dBd").lower()
    return _real(match[1], "GAIN") + (DIPOLE_GAIN if unit == "dbd" else 0.0), match[2] is not None


def _megahertz(text: str) -> float:
    """A frequency in Hz; a number without a unit is in MHz. NaN for none, and for a band."""
    match = re.fullmatch(r"([\d.eE+]+)\s*([kMGT]?Hz)?", text, re.IGNORECASE)
    if match is None:
        if not text or re.fullmatch(r"[\d.]+\s*-\s*[\d.]+\s*(MHz)?", text):
            return math.nan
        raise FileFormatError(f"expected FREQUENCY in MHz, got {text[:30]!r}")
    unit = unit_of(match[2] or "MHz")
    assert unit is not None
    return _real(match[1], "FREQUENCY") * unit.scale


def _real(text: str, name: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise FileFormatError(f"expected a number after {name}, got {text[:30]!r}") from None
