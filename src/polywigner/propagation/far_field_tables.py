"""Far fields in tables with named columns: reports of HFSS, and far fields of CST and FEKO."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.io.limits import LARGEST_NUMBER, token
from polywigner.quantities import parse_frequency

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

FREE_SPACE = 376.730313412
"""Impedance Z0 of free space in ohm: |rE|^2/(2 Z0) of the peak value rE is in W/sr."""

FLOOR = -300.0
"""Level in dB that represents minus infinity."""

DIPOLE_GAIN = 2.15
"""Gain in dBi of the half-wave dipole to which dBd refers."""


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


# ---- units --------------------------------------------------------------------------------------

Kind = Literal["angle", "frequency", "field", "intensity", "ratio"]


class Unit(NamedTuple):
    """A unit of a column."""

    kind: Kind
    """Fields are rE (or E at 1 m); intensities W/sr (or W/m^2 at 1 m); ratios are to isotropic."""
    scale: float = 1.0
    """One unit, or 0 dB, in degrees, Hz, V, W/sr or 1."""
    is_db: bool = False


_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
_PHYSICAL = re.compile(r"([numµμkM]?)([VWvw])(/m|/m2|/sr)?")
_NAMED = {
    **dict.fromkeys(("deg", "degree", "degrees", "°"), Unit("angle")),
    **dict.fromkeys(("rad", "radian", "radians"), Unit("angle", 180 / math.pi)),
    **dict.fromkeys(("1", "-", "lin", "linear"), Unit("ratio")),
    **dict.fromkeys(("db", "dbi", "db(i)"), Unit("ratio", 1.0, True)),
    **dict.fromkeys(("dbd", "db(d)"), Unit("ratio", 10 ** (DIPOLE_GAIN / 10), True)),
    "hz": Unit("frequency"),
    "khz": Unit("frequency", 1e3),
    "mhz": Unit("frequency", 1e6),
    "ghz": Unit("frequency", 1e9),
    "thz": Unit("frequency", 1e12),
}


def unit_of(text: str) -> Unit | None:
    """Return the unit that a text in brackets names; None for a unit that is not supported."""
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
    prefix, base, per = match.groups()
    is_field = base in "Vv"
    if per not in ((None, "/m") if is_field else (None, "/m2", "/sr")):
        return None
    return Unit("field" if is_field else "intensity", _PREFIXES[prefix], is_db)


# ---- columns ------------------------------------------------------------------------------------

Quantity = Literal[
    "theta", "phi", "frequency", "field", "intensity", "directivity", "gain", "unknown"
]
Part = Literal["value", "real", "imaginary", "complex", "size", "phase"]

_ADVICE: dict[Kind, str] = {
    "angle": "angles in deg or rad",
    "frequency": "frequencies in Hz",
    "field": "fields in V, V/m or dBV/m",
    "intensity": "power in W/m2 or dBW/m2",
    "ratio": "directivities in dBi or linear",
}
# Kinds of units that a quantity may have, and the unit of a header without one.
_UNITS: dict[Quantity, tuple[tuple[Kind, ...], Unit | None]] = {
    "theta": (("angle",), Unit("angle")),
    "phi": (("angle",), Unit("angle")),
    "frequency": (("frequency",), Unit("frequency")),
    "field": (("field",), Unit("field")),
    "intensity": (("intensity",), None),
    "directivity": (("ratio",), Unit("ratio")),
    "gain": (("ratio",), Unit("ratio")),
    "unknown": (("field", "intensity", "ratio"), None),
}


class Column(NamedTuple):
    """Content of a column of a table."""

    title: str
    quantity: Quantity
    component: str
    """"theta", "phi" or "total" of a far field, else empty."""
    part: Part
    unit: Unit

    def intensity(self, values: Floats) -> Floats:
        """Return the radiant intensity in W/sr of sizes; ratios are taken for 1 W radiated."""
        squared = self.unit.kind == "field"
        if self.unit.is_db:
            values = np.where(values <= FLOOR, 0.0, 10 ** (values / (20 if squared else 10)))
        elif values.min() < 0:
            raise FileFormatError(
                f"expected values of zero or more in column {self.title}, got {values.min():g}; "
                "give its unit, such as [dBi], in its header"
            )
        sizes = values * self.unit.scale
        if squared:
            return np.square(sizes) / (2 * FREE_SPACE)
        return sizes / (4 * math.pi) if self.unit.kind == "ratio" else sizes


def _column(
    title: str,
    unit: str | None,
    quantity: Quantity,
    component: str = "",
    part: Part = "value",
    default: Unit | None = None,
) -> Column:
    """Return a column with its unit checked; FileFormatError for one that does not fit.

    ``unit`` is the text in brackets; a blank text stands for ``default``, or else for the usual
    unit of the quantity. If ``default`` is in dB, so must be the unit.
    """
    label = repr(title)[1:-1][:40]
    kinds, usual = (("angle",), Unit("angle")) if part == "phase" else _UNITS[quantity]
    if unit is None or not unit.strip():
        known = default or usual
        if known is None:
            raise FileFormatError(f"expected a unit in the header of column {label}, got none")
        return Column(label, quantity, component, part, known)
    known = unit_of(unit)
    needs_db = default is not None and default.is_db
    if (
        known is None
        or known.kind not in kinds
        or (known.is_db and part != "size")
        or (needs_db and not known.is_db)
    ):
        advice = ", or ".join(_ADVICE[kind] for kind in kinds)
        raise FileFormatError(
            f"the unit {unit.strip()[:20]!r} of column {label} is not supported; export {advice}"
        )
    return Column(label, quantity, component, part, known)


_AXES: dict[str, Quantity] = {
    "theta": "theta", "phi": "phi", "freq": "frequency", "frequency": "frequency",
}  # fmt: skip
_QUANTITIES: dict[str, Quantity] = {
    **dict.fromkeys(("re", "e", "v", "epattern"), "field"),
    **dict.fromkeys(("p", "s", "pabs", "u"), "intensity"),
    **dict.fromkeys(("dir", "directivity"), "directivity"),
    **dict.fromkeys(("gain", "grlz", "rlzg", "realizedgain", "realisedgain"), "gain"),
    **dict.fromkeys(("ieeegain", "gainieee", "rlzdgain"), "gain"),
}
_PARTS: dict[str, Part] = {
    "re": "real",
    "im": "imaginary",
    **dict.fromkeys(("", "mag", "abs", "db", "db10", "db20"), "size"),
    **dict.fromkeys(("phase", "arg", "ang"), "phase"),
    **dict.fromkeys(("ang_deg", "ang_rad", "cang_deg", "cang_rad"), "phase"),
}
# mag(rETheta) of HFSS, Re(Etheta) and Gain(Total) of FEKO
_OF_COMPONENT = re.compile(
    r"(?:(?P<part>[a-z_0-9]+)\()?(?P<quantity>[a-z]+?)(?P<is_feko>\()?"
    r"(?P<component>theta|phi|total)\)?"
)
_OF_CST = re.compile(r"(?P<part>abs|phase)\((?P<name>[a-z0-9]*)\)")


def _simulator_column(title: str, unit: str | None) -> Column | None:
    """Return the column of a report of HFSS or of a far field of FEKO; None for an unknown name."""
    name = re.sub(r"[\s\"]", "", title).lower()
    if name in _AXES:
        return _column(title, unit, _AXES[name])
    match = _OF_COMPONENT.fullmatch(name)
    if match is None:
        return None
    function, component = match["part"] or "", match["component"]
    part, quantity = _PARTS.get(function), _QUANTITIES.get(match["quantity"])
    is_field = quantity == "field"
    is_ratio = quantity in ("directivity", "gain")
    if part is None or quantity is None or (match["is_feko"] and not is_ratio):
        return None
    if function == ("db10" if is_field else "db20"):
        return None
    default = None
    if part == "phase":
        default = Unit("angle", 180 / math.pi) if function.endswith("rad") else Unit("angle")
    elif function.startswith("db") or match["is_feko"]:  # FEKO writes Gain(Total) in dB
        default = Unit("field" if is_field else "ratio", 1.0, True)
    elif not function and is_field and component != "total":
        part = "complex"
    return _column(title, unit, quantity, component, part, default)


def _cst_columns(header: str) -> list[Column | None]:
    """Return the columns of a far-field table of CST; None for unknown names.

    The column Abs(Dir.), Abs(Gain), Abs(E) and the like names the quantity of Abs(Theta) and
    Abs(Phi) as well.
    """
    titles = [(name.strip(), unit) for name, unit in re.findall(r"([^\[\]]+)\[([^\]]*)\]", header)]
    titles += [(name, None) for name in header.rpartition("]")[2].split()]
    names = [re.sub(r"[\s.]", "", name).lower() for name, _ in titles]
    matches = [_OF_CST.fullmatch(name) for name in names]
    sizes = [m["name"] for m in matches if m and m["part"] == "abs"]
    total = next((name for name in sizes if name not in ("theta", "phi")), "")
    quantity = _QUANTITIES.get(total, "unknown")
    columns: list[Column | None] = []
    for (title, unit), name, match in zip(titles, names, matches, strict=True):
        if name in ("theta", "phi"):
            columns.append(_column(title, unit, _AXES[name]))
        elif match and match["name"] in ("theta", "phi"):
            part: Part = "size" if match["part"] == "abs" else "phase"
            columns.append(_column(title, unit, quantity, match["name"], part))
        elif match and match["part"] == "abs" and match["name"] == total:
            columns.append(_column(title, unit, quantity, "total", "size"))
        else:
            columns.append(None)
    return columns


def _check_header(columns: Sequence[Column | None]) -> None:
    """Raise FileFormatError for two columns of the same quantity, and a header without angles."""
    contents = [column[1:4] for column in columns if column is not None]
    for column in columns:
        if column is not None and contents.count(column[1:4]) > 1:
            raise FileFormatError(
                f"expected one column of each quantity, got {column.title} and another one; export "
                "one frequency, and one of gain, realised gain and directivity"
            )
    if not {("theta", "", "value"), ("phi", "", "value")} <= set(contents):
        raise FileFormatError(
            "expected the columns Theta and Phi in the header, and both field components with "
            "their phases, got others"
        )


# ---- values -------------------------------------------------------------------------------------

# Samples further below the largest intensity are not compared, since tables round them.
_COMPARED = 1e-2
# Difference in dB that the rounding of a table explains.
_SAME_LEVEL = 0.1
# GRASP leaves out the E of exponents with three digits.
_SHORT_EXPONENT = re.compile(r"(?<=\d)([+-]\d{3})$")

Known = Sequence[tuple[Column, NDArray[Any]]]
"""Columns with their numbers (n,)."""


def numbers_of(lines: Sequence[str], first: int, columns: int) -> Floats:
    """Return the real numbers (n, columns) of lines; ``first``: number of the first line."""
    return np.asarray(_cells_of([line.split() for line in lines], first, columns).real)


def _number(cell: str) -> complex:
    text = cell.replace(" ", "").replace("i", "j")
    try:
        return complex(text)
    except ValueError:
        return complex(_SHORT_EXPONENT.sub(r"e\1", text))


def _cells_of(rows: Sequence[Sequence[str]], first: int, columns: int) -> Complex:
    """Numbers (n, columns) of rows of cells; blank rows are left out."""
    values: list[list[complex]] = []
    for number, cells in enumerate(rows, start=first):
        if not any(cell.strip() for cell in cells):
            continue
        try:
            values.append([_number(cell) for cell in cells])
        except ValueError:
            values.append([])
        if len(values[-1]) != columns:
            raise FileFormatError(
                f"expected {columns} numbers, got {token(' '.join(cells).strip())} in line {number}"
            )
    if not values:
        raise FileFormatError("expected a line for each direction, got none")
    table = np.array(values)
    if not (np.abs(table) <= LARGEST_NUMBER).all():  # also for a NaN
        raise FileFormatError(f"expected finite numbers up to {LARGEST_NUMBER:g}, got others")
    return table


def frequency_of(text: str) -> float:
    """Return a frequency in Hz from a number, or from a number with its unit."""
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


def _tables_of(
    columns: Sequence[Column | None], values: Complex, frequency: float = math.nan
) -> Iterator[FarFieldTable]:
    """The tables of columns with angles, one for each frequency in a column of frequencies."""
    known = [(c, values[:, k]) for k, c in enumerate(columns) if c is not None]
    axes = {c.quantity: c.unit.scale * v.real for c, v in known if c.part == "value"}
    frequencies = axes.get("frequency", np.full(len(values), frequency))
    for one in np.unique(frequencies):
        rows = slice(None) if np.isnan(one) else frequencies == one
        fields, repeated = _fields_of([(column, numbers[rows]) for column, numbers in known])
        yield FarFieldTable(axes["theta"][rows], axes["phi"][rows], fields, float(one), repeated)


def _fields_of(known: Known) -> tuple[Complex, list[tuple[Column, Floats]]]:
    """E_theta and E_phi (2, n) in V, and the columns of sizes that repeat them, in W/sr.

    FileFormatError if a repeated column disagrees with the fields by more than rounding does.
    """
    parts = [_component(name, known) for name in ("theta", "phi")]
    fields, used = np.array([part for part, _ in parts]), [c for _, cs in parts for c in cs]
    repeated = [(c, c.intensity(v.real)) for c, v in known if c.part == "size" and c not in used]
    _compare(fields, repeated, {column.quantity for column in used if column.part != "phase"})
    return fields, repeated


def _component(name: str, known: Known) -> tuple[Complex, list[Column]]:
    """The field (n,) in V along theta or phi, and its columns."""
    parts = {(c.quantity, c.part): (c, v) for c, v in known if c.component == name}
    if ("field", "real") in parts and ("field", "imaginary") in parts:
        (x, real), (y, imaginary) = parts["field", "real"], parts["field", "imaginary"]
        pair = x.unit.scale * real.real + 1j * y.unit.scale * imaginary.real
        return np.asarray(pair, np.complex128), [x, y]
    if ("field", "complex") in parts:
        column, values = parts["field", "complex"]
        if not values.imag.any():
            raise FileFormatError(
                f"expected complex numbers of E_{name}, got real ones, which have no phase; export "
                "re and im, or mag and ang_deg"
            )
        return np.asarray(column.unit.scale * values, np.complex128), [column]
    sizes, phases = ([p for p in parts.values() if p[0].part == k] for k in ("size", "phase"))
    if not sizes or not phases:
        raise FileFormatError(
            f"expected columns for E_{name}, re and im or size and phase, got "
            f"{'a size' if sizes else 'a phase' if phases else 'none'}; export the components "
            "along theta and phi with their phases"
        )
    # a field, an intensity, a directivity or a gain, in this order
    size, values = min(sizes, key=lambda pair: list(_UNITS).index(pair[0].quantity))
    phase, angles = phases[0]
    absolute = np.sqrt(2 * FREE_SPACE * size.intensity(values.real))
    return absolute * np.exp(1j * np.radians(phase.unit.scale * angles.real)), [size, phase]


def _compare(
    fields: Complex, repeated: list[tuple[Column, Floats]], sources: set[Quantity]
) -> None:
    """Raise FileFormatError for a column that disagrees with the fields.

    Columns of the quantity of the fields agree with them. Others differ from them by one factor,
    such as the radiated power.
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
        if not abs(worst) <= _SAME_LEVEL:
            raise FileFormatError(
                f"column {column.title} differs from the field components by {worst:.2f} dB; check "
                "the units in the header, and that all columns are of one export"
            )


# ---- formats ------------------------------------------------------------------------------------

_HFSS_NAME = re.compile(r"(?P<title>[^\[]*?)\s*(?:\[(?P<unit>[^\]]*)\])?\s*(?:-\s*(?P<at>.*))?")


def hfss_report(lines: list[str]) -> Iterator[FarFieldTable]:
    """Return the far fields of a report of HFSS (.csv): one row for each direction."""
    matches = [_HFSS_NAME.fullmatch(cell.strip()) for cell in next(csv.reader(lines[:1]))]
    columns = [match and _simulator_column(match["title"], match["unit"]) for match in matches]
    _check_header(columns)
    frequencies = set(re.findall(r"Freq='([^']*)'", lines[0]))
    frequency = frequency_of(frequencies.pop()) if len(frequencies) == 1 else math.nan
    values = _cells_of(list(csv.reader(lines[1:])), 2, len(columns))
    yield from _tables_of(columns, values, frequency)


def cst_table(lines: list[str]) -> Iterator[FarFieldTable]:
    """Return the far field of a table of CST (.txt): a header, a rule, a row per direction."""
    columns = _cst_columns(lines[0])
    _check_header(columns)
    first = 2 if len(lines) > 1 and set(lines[1].strip()) <= {"-"} else 1
    rows = [line.split() for line in lines[first:]]
    yield from _tables_of(columns, _cells_of(rows, first + 1, len(columns)))


def feko_far_field(lines: list[str]) -> Iterator[FarFieldTable]:
    """Return the far fields of a file of FEKO (.ffe): headers with #, then a row per direction."""
    columns: list[Column | None] = []
    rows: list[list[str]] = []
    frequency, first = math.nan, 0
    for number, line in enumerate([*lines, "#"], start=1):
        key, _, value = line.partition(":")
        key, value = key.strip().lower(), value.strip()
        if line.startswith("#") and rows:
            yield from _tables_of(columns, _cells_of(rows, first, len(columns)), frequency)
            rows = []
        if key == "#frequency":
            frequency = frequency_of(value)
        elif key == "#coordinate system" and value.lower() != "spherical":
            raise FileFormatError(f"expected spherical coordinates, got {token(value)}")
        elif key == "#result type" and value.lower() == "rcs":
            raise FileFormatError("expected the far field of an antenna, got cross sections (RCS)")
        elif line.startswith("#") and '"' in line:
            names = re.findall(r'"([^"]*)"\s*(?:\[([^\]]*)\])?', line)
            columns = [_simulator_column(name, unit) for name, unit in names]
        elif line.strip() and not line.startswith(("#", "**")):
            if not columns:
                raise FileFormatError(
                    f"expected the names of the columns in a line with # before line {number}, got "
                    "none"
                )
            if not rows:
                first = number
                _check_header(columns)
            rows.append(line.split())
