"""Readers of far-field files of the simulators HFSS, CST, FEKO and GRASP."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from polywigner.errors import FileFormatError
from polywigner.geometry.arguments import check_most, checked_count
from polywigner.geometry.io.limits import check_coordinates, token
from polywigner.numerics import Complex, Floats
from polywigner.propagation.element_patterns import polar_components
from polywigner.quantities import parse_frequency

FREE_SPACE = 376.730313412
"""Impedance of free space in ohm. A peak value rE in V gives |rE|^2/(2 FREE_SPACE) in W/sr."""

FLOOR = -300.0
"""Finite stand-in for zero power, in dB."""

DIPOLE_GAIN = 2.15
"""Gain in dBi of the half-wave dipole, the reference of dBd."""

MOST_DIRECTIONS = 2_000_000
"""Largest number of directions of a table."""


@dataclass(frozen=True, eq=False)
class FarFieldTable:
    """Far field at one frequency in a list of directions, with phases exp(+j omega t - j k r)."""

    theta: Floats
    """Angles in degrees from -180 to 180, shape (n,)."""
    phi: Floats
    """Angles in degrees, shape (n,)."""
    fields: Complex
    """Peak values of E_theta and E_phi times the distance, in V, shape (2, n)."""
    frequency: float = math.nan
    """Frequency in Hz; NaN if unknown."""
    repeated: list[tuple[Column, Floats]] = field(default_factory=list)
    """Columns that repeat the magnitude of the field, and their intensities in W/sr."""
    has_unit_power: bool = False
    """Whether the file format normalises the radiated power to 1 W."""


Kind = Literal["angle", "frequency", "field", "intensity", "ratio"]


class Unit(NamedTuple):
    """Kind of quantity of a column, and its conversion to degrees, Hz, V or W/sr."""

    kind: Kind
    """A "field" is rE in V, or E in V/m at 1 m. An "intensity" is in W/sr, or in W/m^2 at 1 m. A
    "ratio" is relative to an isotropic source."""
    scale: float = 1.0
    """Value of one unit, or of 0 dB, in degrees, Hz, V or W/sr."""
    is_db: bool = False


_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
_PHYSICAL = re.compile(r"([numµμkM]?)(?:([Vv])(?:/m)?|[Ww](?:/m2|/sr)?)")
_DEGREES, _RADIANS, _RATIO = Unit("angle"), Unit("angle", 180 / math.pi), Unit("ratio")
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "thz": 1e12}
_NAMED = {
    **dict.fromkeys(("deg", "degree", "degrees", "°"), _DEGREES),
    **dict.fromkeys(("rad", "radian", "radians"), _RADIANS),
    **dict.fromkeys(("1", "-", "lin", "linear"), _RATIO),
    **dict.fromkeys(("db", "dbi", "db(i)"), Unit("ratio", 1.0, True)),
    **dict.fromkeys(("dbd", "db(d)"), Unit("ratio", 10 ** (DIPOLE_GAIN / 10), True)),
    **{name: Unit("frequency", scale) for name, scale in _HERTZ.items()},
}
_ADVICE = (
    "angles in deg or rad, fields in V, V/m or dBV/m, power in W/m2 or dBW/m2, directivities in "
    "dBi or linear"
)


def unit_of(text: str) -> Unit | None:
    """Return the unit for a name such as "dBV/m", or None if it is not supported."""
    name = re.sub(r"\s|\.$", "", text).replace("²", "2").replace("^", "")
    if name.lower() in _NAMED:
        return _NAMED[name.lower()]
    is_db = name[:2].lower() == "db"
    if is_db:
        name = re.sub(r"^\((.*)\)$", r"\1", name[2:])
        name = re.sub(r"^m(?=$|/)", "mW", name)  # dBm
    match = _PHYSICAL.fullmatch(name)
    if match is None:
        return None
    return Unit("field" if match[2] else "intensity", _PREFIXES[match[1]], is_db)


# Allowed kinds of unit, and default unit, of each quantity.
_UNITS: dict[str, tuple[tuple[Kind, ...], Unit | None]] = {
    "theta": (("angle",), _DEGREES),
    "phi": (("angle",), _DEGREES),
    "frequency": (("frequency",), Unit("frequency")),
    "field": (("field",), Unit("field")),
    "intensity": (("intensity",), None),
    "directivity": (("ratio",), _RATIO),
    "gain": (("ratio",), _RATIO),
    "unknown": (("field", "intensity", "ratio"), None),
}
_AXES = {"theta": "theta", "phi": "phi", "freq": "frequency", "frequency": "frequency"}
_QUANTITIES = {
    **dict.fromkeys(("re", "e", "v", "epattern"), "field"),
    **dict.fromkeys(("p", "s", "pabs", "u"), "intensity"),
    **dict.fromkeys(("dir", "directivity"), "directivity"),
    **dict.fromkeys(("gain", "grlz", "rlzg", "realizedgain", "realisedgain"), "gain"),
    **dict.fromkeys(("ieeegain", "gainieee", "rlzdgain"), "gain"),
    "unknown": "unknown",
}
_PARTS = {
    "re": "real",
    "im": "imaginary",
    **dict.fromkeys(("", "mag", "abs", "db", "db10", "db20"), "size"),
    **dict.fromkeys(("phase", "arg", "ang", "ang_deg", "cang_deg", "ang_rad", "cang_rad"), "phase"),
}
# This pattern matches names such as mag(rETheta) in HFSS, and Re(Etheta) and Gain(Total) in FEKO.
_NAME = re.compile(
    r"(?:(?P<part>[a-z_0-9]+)\()?(?P<quantity>[a-z]+?)(?P<is_feko>\()?"
    r"(?P<component>theta|phi|total)\)?"
)


class Column(NamedTuple):
    """Content and unit of a column of a far-field file."""

    title: str
    quantity: str
    """Name of the quantity, such as "theta", "field" or "gain"."""
    component: str
    """Component "theta", "phi" or "total" of the field; empty for an axis."""
    part: str
    """Part "real", "imaginary", "size" or "phase" of the component; "value" for an axis."""
    unit: Unit

    def intensity(self, values: Floats) -> Floats:
        """Convert magnitudes in the unit of the column to radiant intensities in W/sr.

        Directivities and gains are converted for 1 W of radiated power. Raises FileFormatError for
        negative values, unless the unit is in dB.
        """
        is_field = self.unit.kind == "field"
        if self.unit.is_db:
            values = np.where(values <= FLOOR, 0.0, 10 ** (values / (20 if is_field else 10)))
        elif values.min() < 0:
            raise FileFormatError(
                f"column {self.title} contains the negative value {values.min():g}, but its unit "
                "is not in dB; add the unit, such as [dBi], to the header of the column"
            )
        sizes = values * self.unit.scale
        if is_field:
            return np.square(sizes) / (2 * FREE_SPACE)
        return sizes / (4 * math.pi) if self.unit.kind == "ratio" else sizes


def _column(title: str, unit: str | None, name: str | None = None) -> Column | None:
    """Return the column for a title and a unit, or None for an unknown title.

    ``name`` is the title in the notation of HFSS. Raises FileFormatError for unsupported units.
    """
    name = re.sub(r"[\s\"]", "", title if name is None else name).lower()
    label = repr(title)[1:-1][:40]
    if name in _AXES:
        axis = _AXES[name]
        return Column(label, axis, "", "value", _checked_unit(label, unit, *_UNITS[axis]))
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    function, component, quantity = match["part"] or "", match["component"], match["quantity"]
    part, quantity = _PARTS.get(function, ""), _QUANTITIES.get(quantity, "")
    is_field, is_ratio = quantity == "field", quantity in ("directivity", "gain")
    if not part or not quantity or (match["is_feko"] and not is_ratio):
        return None
    if function == ("db10" if is_field else "db20"):
        return None
    kinds, default = _UNITS[quantity]
    if part == "phase":
        kinds, default = ("angle",), _RADIANS if function.endswith("rad") else _DEGREES
    elif function.startswith("db") or match["is_feko"]:  # FEKO's Gain(Total) is in dB.
        default = Unit("field" if is_field else "ratio", 1.0, True)
    known = _checked_unit(label, unit, kinds, default, part == "size")
    return Column(label, quantity, component, part, known)


def _checked_unit(
    label: str, text: str | None, kinds: Sequence[Kind], default: Unit | None, db: bool = False
) -> Unit:
    """Return the unit of a column.

    Decibels are allowed if ``db`` is true, and required if ``default`` is in dB. Without a text,
    ``default`` is returned. Raises FileFormatError for other units, and if neither a text nor a
    default is specified.
    """
    if text is None or not text.strip():
        if default is None:
            raise FileFormatError(
                f"column {label} has no unit in its header; add the unit in brackets"
            )
        return default
    unit = unit_of(text)
    needs_db = default is not None and default.is_db
    if unit is None or unit.kind not in kinds or not needs_db <= unit.is_db <= db:
        raise FileFormatError(
            f"the unit {text.strip()[:20]!r} of column {label} is not supported; supported units "
            f"are {_ADVICE}"
        )
    return unit


def _cst_columns(header: str) -> list[Column | None]:
    """Return the columns in the header of a CST table, and None for each unknown column."""
    # The columns Abs(Theta) and Abs(Phi) have the quantity of the total column, such as Abs(Dir.).
    titles: list[tuple[str, str | None]] = re.findall(r"([^\[\]]+)\[([^\]]*)\]", header)
    titles += [(name, None) for name in header.rpartition("]")[2].split()]
    names = [re.sub(r"[\s.]", "", name).lower() for name, _ in titles]
    sizes = re.findall(r"\babs\(([a-z0-9]*)\)", " ".join(names))
    total = next((name for name in sizes if name not in ("theta", "phi")), "")
    quantity = total if total in _QUANTITIES else "unknown"
    names = [re.sub(rf"^abs\({total}\)$", f"abs({quantity}total)", name) for name in names]
    names = [re.sub(r"^(abs|phase)\((theta|phi)\)$", rf"\1({quantity}\2)", name) for name in names]
    return [
        _column(title.strip(), unit, name)
        for (title, unit), name in zip(titles, names, strict=True)
    ]


def _check_columns(columns: Sequence[Column | None]) -> None:
    """Raise FileFormatError for repeated columns, or if theta or phi is missing."""
    contents = [column[1:4] for column in columns if column is not None]
    for column in columns:
        if column is not None and contents.count(column[1:4]) > 1:
            raise FileFormatError(
                f"the header contains two columns for {column.title}; export a single frequency, "
                "and only one of gain, realised gain and directivity"
            )
    if not {("theta", "", "value"), ("phi", "", "value")} <= set(contents):
        raise FileFormatError(
            "expected the columns Theta and Phi in the header, but the header does not contain "
            "both; export both angles, and both field components with their phases"
        )


# Fraction of the maximum below which intensities are not compared, because tables are rounded.
_COMPARED = 1e-2
# Largest level difference [dB] that may be due to the rounding of tables.
SAME_LEVEL = 0.1
# GRASP omits the letter E of exponents with three digits.
_SHORT_EXPONENT = re.compile(r"(?<=\d)([+-]\d{3})$")

Cells = Sequence[tuple[Column, Floats]]


def numbers_of(lines: Sequence[str], first: int, columns: int) -> Floats:
    """Return the numbers in lines of text as an array (n, columns).

    ``first`` is the number of the first line, for error messages. Raises FileFormatError if a line
    does not contain ``columns`` numbers, or if all lines are blank.
    """
    return _number_table([line.split() for line in lines], first, columns)


def _number_table(rows: Sequence[Sequence[str]], first: int, columns: int) -> Floats:
    """Return cells of text as an array of numbers (n, columns); omit rows without text.

    ``first`` is the line number of the first row, for error messages. Raises FileFormatError like
    `numbers_of`.
    """
    values: list[list[float]] = []
    for number, cells in enumerate(rows, start=first):
        if not any(cell.strip() for cell in cells):
            continue
        try:
            values.append([float(_SHORT_EXPONENT.sub(r"e\1", cell.strip())) for cell in cells])
        except ValueError:
            values.append([])
        if len(values[-1]) != columns:
            raise FileFormatError(
                f"expected {columns} numbers in line {number}, got {token(' '.join(cells).strip())}"
            )
    if not values:
        raise FileFormatError(
            "the file contains no directions; expected one line for each direction"
        )
    table = np.array(values)
    check_coordinates(table)
    return table


def _tables_of(
    columns: Sequence[Column | None], values: Floats, frequency: float = math.nan
) -> Iterator[FarFieldTable]:
    """Yield the far field at each frequency in a table of numbers.

    ``frequency`` is the frequency in Hz of a table without a frequency column.
    """
    known = [(c, values[:, k]) for k, c in enumerate(columns) if c is not None]
    axes = {c.quantity: c.unit.scale * v for c, v in known if c.part == "value"}
    frequencies = axes.get("frequency", np.full(len(values), frequency))
    for value in np.unique(frequencies):
        rows = slice(None) if np.isnan(value) else frequencies == value
        cells = [(column, numbers[rows]) for column, numbers in known]
        (a, columns_a), (b, columns_b) = (_field_of(name, cells) for name in ("theta", "phi"))
        fields, used = np.array([a, b]), [*columns_a, *columns_b]
        repeated = [(c, c.intensity(v)) for c, v in cells if c.part == "size" and c not in used]
        _compare(fields, repeated, {column.quantity for column in used if column.part != "phase"})
        yield FarFieldTable(axes["theta"][rows], axes["phi"][rows], fields, float(value), repeated)


def _field_of(name: str, cells: Cells) -> tuple[Complex, list[Column]]:
    """Return E_theta or E_phi times the distance in V, and the columns that determine it.

    ``name`` is "theta" or "phi". Raises FileFormatError if magnitude or phase is missing.
    """
    parts = {(c.quantity, c.part): (c, v) for c, v in cells if c.component == name}
    if ("field", "real") in parts and ("field", "imaginary") in parts:
        (x, real), (y, imaginary) = parts["field", "real"], parts["field", "imaginary"]
        return x.unit.scale * real + 1j * y.unit.scale * imaginary, [x, y]
    sizes, phases = ([p for p in parts.values() if p[0].part == k] for k in ("size", "phase"))
    if not sizes or not phases:
        raise FileFormatError(
            f"expected columns of E_{name} with real and imaginary part, or with magnitude and "
            f"phase, got {'only a magnitude' if sizes else 'only a phase' if phases else 'none'}; "
            "export the components along theta and phi with their phases"
        )
    # The order of preference is field, intensity, directivity, gain.
    size, values = min(sizes, key=lambda pair: list(_UNITS).index(pair[0].quantity))
    phase, angles = phases[0]
    absolute = np.sqrt(2 * FREE_SPACE * size.intensity(values))
    return absolute * np.exp(1j * np.radians(phase.unit.scale * angles)), [size, phase]


def _compare(fields: Complex, repeated: list[tuple[Column, Floats]], sources: set[str]) -> None:
    """Raise FileFormatError if a column of magnitudes contradicts the field components.

    Columns of quantities that are not in ``sources`` may differ by a constant factor, such as the
    radiated power.
    """
    squares = np.square(np.abs(fields)) / (2 * FREE_SPACE)
    total = squares.sum(axis=0)
    for column, sizes in repeated:
        expected = {"theta": squares[0], "phi": squares[1], "total": total}[column.component]
        compared = expected > _COMPARED * total.max()
        if not compared.any():
            continue
        with np.errstate(divide="ignore"):
            excess = 10 * np.log10(sizes[compared] / expected[compared])
        if sources != {column.quantity}:
            excess = excess - excess[expected[compared].argmax()]
        worst = excess[np.abs(excess).argmax()]
        if not abs(worst) <= SAME_LEVEL:
            raise FileFormatError(
                f"column {column.title} differs from the level of the field components by "
                f"{worst:.2f} dB; check the units in the header, and whether all columns are from "
                "the same export"
            )


_HFSS_NAME = re.compile(r"(?P<title>[^\[]*?)\s*(?:\[(?P<unit>[^\]]*)\])?\s*(?:-\s*(?P<at>.*))?")


def _hfss_report(lines: list[str]) -> Iterator[FarFieldTable]:
    """Yield the far fields in a report of HFSS in CSV format, one for each frequency."""
    matches = [_HFSS_NAME.fullmatch(cell.strip()) for cell in next(csv.reader(lines[:1]))]
    columns = [match and _column(match["title"], match["unit"]) for match in matches]
    _check_columns(columns)
    frequencies = set(re.findall(r"Freq='([^']*)'", lines[0]))
    frequency = parse_frequency(frequencies.pop()) if len(frequencies) == 1 else math.nan
    values = _number_table(list(csv.reader(lines[1:])), 2, len(columns))
    yield from _tables_of(columns, values, frequency)


def _cst_table(lines: list[str]) -> Iterator[FarFieldTable]:
    """Yield the far fields in a table of CST, one for each frequency."""
    columns = _cst_columns(lines[0])
    _check_columns(columns)
    first = 2 if len(lines) > 1 and set(lines[1].strip()) <= {"-"} else 1
    yield from _tables_of(columns, numbers_of(lines[first:], first + 1, len(columns)))


def _feko_far_field(lines: list[str]) -> Iterator[FarFieldTable]:
    """Yield the far fields in a file of FEKO."""
    columns: list[Column | None] = []
    settings = {"#coordinate system": "spherical", "#result type": ""}
    numbered = ((n, s) for n, s in enumerate(lines, 1) if s.strip() and not s.startswith("**"))
    for is_header, group in groupby(numbered, lambda pair: pair[1].startswith("#")):
        numbers, block = zip(*group, strict=True)
        if is_header:
            pairs = (line.partition(":") for line in block)
            settings |= {key.strip().lower(): value.strip() for key, _, value in pairs}
            for line in block:
                if '"' in line:
                    names = re.findall(r'"([^"]*)"\s*(?:\[([^\]]*)\])?', line)
                    columns = [_column(name, unit) for name, unit in names]
            continue
        if settings["#coordinate system"].lower() != "spherical":
            got = token(settings["#coordinate system"])
            raise FileFormatError(
                f"expected far fields in spherical coordinates, got the coordinate system {got}"
            )
        if settings["#result type"].lower() == "rcs":
            raise FileFormatError(
                "expected the far field of an antenna, got radar cross sections (RCS); "
                "export the far field"
            )
        if not columns:
            raise FileFormatError(
                "expected a header line that starts with # and contains the column names before "
                f"line {numbers[0]}, got none"
            )
        _check_columns(columns)
        text = settings.get("#frequency")
        frequency = math.nan if text is None else parse_frequency(text)
        cells = numbers_of(block, numbers[0], len(columns))
        yield from _tables_of(columns, cells, frequency)


def _hfss_far_field(lines: list[str]) -> Iterator[FarFieldTable]:
    """Yield the far fields in a far-field file of HFSS, one for each frequency."""
    axes = []
    for number in (1, 2):
        start, stop, count = numbers_of(lines[number - 1 : number], number, 3)[0]
        axes.append(np.linspace(start, stop, _checked_count(count, number)))
    check_most(len(axes[0]) * len(axes[1]), MOST_DIRECTIONS, "directions", "export fewer")
    theta, phi = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    starts = [k for k, line in enumerate(lines) if line.split()[:1] == ["Frequency"]]
    if (lines[2:3] and lines[2].split() != ["Frequencies", str(len(starts))]) or starts[:1] != [3]:
        raise FileFormatError(
            "expected the word Frequencies and the number of frequencies in line 3, and a line "
            "that starts with Frequency before each far field"
        )
    for start, stop in pairwise([*starts, len(lines)]):
        table = numbers_of(lines[start + 1 : stop], start + 2, 4)
        if len(theta) != len(table):
            raise FileFormatError(
                f"expected {len(theta)} directions for each frequency, got {len(table)}"
            )
        frequency = parse_frequency(lines[start].split(maxsplit=1)[-1])
        yield FarFieldTable(theta, phi, _components(table), frequency)


def _components(table: Floats) -> Complex:
    """Return complex fields (2, n) from columns (n, 4): real and imaginary part of each field."""
    return (table[:, ::2] + 1j * table[:, 1::2]).T


def _checked_count(count: float, line: int) -> int:
    """Return a number of angles as an int; raise FileFormatError for other values."""
    number: Any = int(count) if count == int(count) else count
    return checked_count(number, f"the number of angles in line {line}", 1, MOST_DIRECTIONS)


def _grasp_cuts(lines: list[str]) -> Iterator[FarFieldTable]:
    """Yield the far field at each frequency from spherical cuts of GRASP, scaled to 1 W."""
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
                f"line {k + 2}: expected ICOMP 1, 2 or 3, ICUT 1 or 2 and NCOMP 2, got ICOMP "
                f"{kind:g}, ICUT {cut:g} and NCOMP {components:g}; export E_theta and E_phi of a "
                "polar cut in the far field"
            )
        count = _checked_count(number, k + 2)
        table = numbers_of(lines[k + 2 : k + 2 + count], k + 3, 4)
        if len(table) != count:
            raise FileFormatError(
                f"expected {count} directions after line {k + 2}, but the file contains fewer"
            )
        along, across = start + step * np.arange(count), np.full(count, constant)
        theta, phi = (along, across) if cut == 1 else (across, along)
        parts = cuts.setdefault(parse_frequency(named[0]) if named else 0.0, [])
        parts.append((theta, phi, _from_grasp(int(kind), _components(table), np.radians(phi))))
        k += 2 + count
    # GRASP normalises the radiated power to 4 pi W, so |E|^2 is the directivity.
    scale = math.sqrt(2 * FREE_SPACE / (4 * math.pi))
    for frequency, parts in cuts.items():
        theta, phi = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        fields: Complex = np.concatenate([part[2] for part in parts], axis=1)
        fields *= scale
        yield FarFieldTable(theta, phi, fields, frequency or math.nan, [], True)


def _from_grasp(kind: int, pair: Complex, phi: Floats) -> Complex:
    """Convert components (2, n) of a GRASP file to E_theta and E_phi.

    ``kind`` is the number ICOMP in the file: 1 for components along theta and phi, 2 for right- and
    left-handed, 3 for co- and cross-polar components. ``phi`` (n,) is in rad.
    """
    if kind == 1:
        return pair
    co, cross = pair
    if kind == 2:  # (co -+ j cross)/sqrt(2)
        co, cross = (co + cross) / math.sqrt(2), 1j * (cross - co) / math.sqrt(2)
    return np.stack(polar_components(co, cross, phi))


LOADERS: dict[str, Callable[[list[str]], Iterator[FarFieldTable]]] = {
    ".csv": _hfss_report,
    ".txt": _cst_table,
    ".ffd": _hfss_far_field,
    ".ffe": _feko_far_field,
    ".cut": _grasp_cuts,
}
"""Readers by file suffix. Each reader yields one far field per frequency."""
