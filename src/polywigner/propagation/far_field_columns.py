"""Columns of far-field tables: their quantities, their units, and their values in SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

FREE_SPACE = 376.730313412
"""Impedance Z0 of free space in ohm: |rE|^2/(2 Z0) of the peak value rE is in W/sr."""

FLOOR = -300.0
"""Level in dB that represents minus infinity."""

DIPOLE_GAIN = 2.15
"""Gain in dBi of the half-wave dipole to which dBd refers."""

_LARGEST_LEVEL = 1000.0
_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
_PHYSICAL = re.compile(r"([numµμkM]?)([VWvw])(/m|/m2|/sr)?")
_LINEAR = ("1", "-", "lin", "linear")
_ANGLES = dict.fromkeys(("deg", "degree", "degrees", "°"), 1.0)
_ANGLES |= dict.fromkeys(("rad", "radian", "radians"), 180 / math.pi)
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "thz": 1e12}

Kind = Literal["angle", "frequency", "field", "intensity", "ratio"]


class Unit(NamedTuple):
    """A unit of a column."""

    kind: Kind
    """Fields are rE (or E at 1 m); intensities W/sr (or W/m^2 at 1 m); ratios are to isotropic."""
    scale: float
    """One unit, or 0 dB, in degrees, Hz, V, W/sr or 1."""
    is_db: bool = False


DEGREES, VOLT, LINEAR = Unit("angle", 1.0), Unit("field", 1.0), Unit("ratio", 1.0)
DECIBEL = Unit("ratio", 1.0, True)


def unit_of(text: str) -> Unit | None:
    """Return the unit that a text in brackets names; None for a unit that is not supported."""
    name = re.sub(r"\s|\.$", "", text).replace("²", "2").replace("^", "")
    if name.lower() in _ANGLES:
        return Unit("angle", _ANGLES[name.lower()])
    if name.lower() in _HERTZ:
        return Unit("frequency", _HERTZ[name.lower()])
    if name.lower() in _LINEAR:
        return LINEAR
    is_db = name[:2].lower() == "db"
    if is_db:
        name = re.sub(r"^\((.*)\)$", r"\1", name[2:])
        if name in ("", "i", "d"):
            return Unit("ratio", 10 ** (DIPOLE_GAIN / 10) if name == "d" else 1.0, True)
        name = re.sub(r"^m(?=$|/)", "mW", name)  # dBm
    match = _PHYSICAL.fullmatch(name)
    if match is None:
        return None
    prefix, base, per = match.groups()
    is_field = base in "Vv"
    if per not in ((None, "/m") if is_field else (None, "/m2", "/sr")):
        return None
    return Unit("field" if is_field else "intensity", _PREFIXES[prefix], is_db)


Quantity = Literal[
    "theta", "phi", "frequency", "field", "intensity", "directivity", "gain", "unknown"
]
Part = Literal["value", "real", "imaginary", "complex", "size", "phase"]

# Kinds of units that a quantity may have.
_KINDS: dict[str, tuple[Kind, ...]] = {
    "theta": ("angle",),
    "phi": ("angle",),
    "frequency": ("frequency",),
    "field": ("field",),
    "intensity": ("intensity",),
    "directivity": ("ratio",),
    "gain": ("ratio",),
    "unknown": ("field", "intensity", "ratio"),
}
_DEFAULTS = {
    "theta": DEGREES, "phi": DEGREES, "frequency": Unit("frequency", 1.0), "field": VOLT,
    "directivity": LINEAR, "gain": LINEAR,
}  # fmt: skip


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
            if values.max() > _LARGEST_LEVEL:
                raise FileFormatError(
                    f"expected levels up to {_LARGEST_LEVEL:g} dB in column {self.title}, got "
                    f"{values.max():g}"
                )
            sizes = np.where(values <= FLOOR, 0.0, 10 ** (values / (20 if squared else 10)))
        elif values.min() < 0:
            raise FileFormatError(
                f"expected values of zero or more in column {self.title}, got {values.min():g}; "
                "give its unit, such as [dBi], in its header"
            )
        else:
            sizes = values
        sizes = sizes * self.unit.scale
        if squared:
            return np.square(sizes) / (2 * FREE_SPACE)
        return sizes / (4 * math.pi) if self.unit.kind == "ratio" else sizes


def column(
    title: str, unit: str | None, quantity: Quantity, component: str, part: Part, *,
    default: Unit | None = None,
) -> Column:  # fmt: skip
    """Return a column with its unit checked; FileFormatError for one that does not fit.

    ``unit`` is the text in brackets; a blank text stands for ``default``, or else for the
    usual unit of the quantity.
    """
    label = repr(title)[1:-1][:40]
    if unit is None or not unit.strip():
        found = default or (DEGREES if part == "phase" else _DEFAULTS.get(quantity))
        if found is None:
            raise FileFormatError(f"expected a unit in the header of column {label}, got none")
        return Column(label, quantity, component, part, found)
    known = unit_of(unit)
    kinds: tuple[Kind, ...] = ("angle",) if part == "phase" else _KINDS[quantity]
    if known is None or known.kind not in kinds or (known.is_db and part != "size"):
        advice = ", or ".join(_ADVICE[kind] for kind in kinds)
        raise FileFormatError(
            f"the unit {unit.strip()[:20]!r} of column {label} is not supported; export {advice}"
        )
    return Column(label, quantity, component, part, known)


_ADVICE: dict[Kind, str] = {
    "angle": "angles in deg or rad",
    "frequency": "frequencies in Hz",
    "field": "fields in V, V/m or dBV/m",
    "intensity": "power in W/m2 or dBW/m2",
    "ratio": "directivities in dBi or linear",
}

# ---- names of columns ---------------------------------------------------------------------------

_QUANTITIES: dict[str, Quantity] = {
    "re": "field", "e": "field", "v": "field", "epattern": "field",
    "p": "intensity", "s": "intensity", "pabs": "intensity", "u": "intensity",
    "dir": "directivity", "directivity": "directivity",
    "gain": "gain", "grlz": "gain", "rlzg": "gain", "realizedgain": "gain", "realisedgain": "gain",
    "ieeegain": "gain", "gainieee": "gain", "rlzdgain": "gain",
}  # fmt: skip
_PARTS: dict[str, Part] = {
    "": "size", "re": "real", "im": "imaginary", "mag": "size", "abs": "size", "db": "size",
    "db10": "size", "db20": "size", "phase": "phase", "arg": "phase", "ang": "phase",
    "ang_deg": "phase", "ang_rad": "phase", "cang_deg": "phase", "cang_rad": "phase",
}  # fmt: skip
_OF_COMPONENT = re.compile(
    r"(?:(?P<part>[a-z_0-9]+)\()?(?P<quantity>[a-z]+?)(?P<component>theta|phi|total)\)?"
)
_OF_RATIO = re.compile(r"(?P<quantity>[a-z]+)\((?P<component>theta|phi|total)\)")
_OF_CST = re.compile(r"(?P<part>abs|phase)\((?P<name>[a-z0-9]*)\)")


def simulator_column(title: str, unit: str | None) -> Column | None:
    """Return the column of a report of HFSS or of a far field of FEKO; None for an unknown name."""
    name = re.sub(r"[\s\"]", "", title).lower()
    if name in ("theta", "phi", "freq", "frequency"):
        quantity: Any = "frequency" if name.startswith("freq") else name
        return column(title, unit, quantity, "", "value")
    match = _OF_RATIO.fullmatch(name)  # FEKO writes Gain(Total) in dB
    if match is not None and _QUANTITIES.get(match["quantity"]) in ("directivity", "gain"):
        quantity = _QUANTITIES[match["quantity"]]
        return column(title, unit, quantity, match["component"], "size", default=DECIBEL)
    match = _OF_COMPONENT.fullmatch(name)
    if match is None:
        return None
    function = match["part"] or ""
    part, of = _PARTS.get(function), _QUANTITIES.get(match["quantity"])
    if part is None or of is None:
        return None
    if part == "phase":
        default = Unit("angle", 180 / math.pi) if function.endswith("rad") else DEGREES
        return column(title, unit, of, match["component"], "phase", default=default)
    if function.startswith("db"):
        if function == ("db10" if of == "field" else "db20"):
            return None
        decibel = Unit("field", 1.0, True) if of == "field" else DECIBEL
        made = column(title, unit, of, match["component"], "size", default=decibel)
        if not made.unit.is_db:
            raise FileFormatError(
                f"expected a level in dB in column {made.title}, got the unit {str(unit)[:20]!r}"
            )
        return made
    if not function and of == "field" and match["component"] != "total":
        part = "complex"
    return column(title, unit, of, match["component"], part)


def cst_columns(header: str) -> list[Column | None]:
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
    found: list[Column | None] = []
    for (title, unit), name, match in zip(titles, names, matches, strict=True):
        if name in ("theta", "phi"):
            found.append(column(title, unit, name, "", "value"))  # type: ignore[arg-type]
        elif match and match["name"] in ("theta", "phi"):
            part: Part = "size" if match["part"] == "abs" else "phase"
            found.append(column(title, unit, quantity, match["name"], part))
        elif match and match["part"] == "abs" and match["name"] == total:
            found.append(column(title, unit, quantity, "total", "size"))
        else:
            found.append(None)
    return found


# ---- fields -------------------------------------------------------------------------------------

_SIZES: tuple[Quantity, ...] = ("field", "intensity", "directivity", "gain", "unknown")
# Samples further below the largest intensity are not compared, since tables round them.
_COMPARED = 1e-2
# Difference in dB that the rounding of a table explains.
_SAME_LEVEL = 0.1


def check_once(columns: Sequence[Column | None]) -> None:
    """Raise FileFormatError for two columns of the same quantity."""
    known = [column for column in columns if column is not None]
    for k, column in enumerate(known):
        if any(other[1:4] == column[1:4] for other in known[:k]):
            raise FileFormatError(
                f"expected each column once, got {column.title} several times; export one "
                "frequency, and one column for each quantity"
            )


def fields_of(
    columns: Sequence[Column | None], values: NDArray[np.generic]
) -> tuple[Complex, list[tuple[Column, Floats]]]:
    """Return E_theta and E_phi (2, n) in V, and the columns of sizes that repeat them, in W/sr.

    FileFormatError if a repeated column disagrees with the fields by more than rounding does.

    Parameters
    ----------
    columns : (k,) of the table.
    values : (n, k) real or complex numbers of the table.
    """
    fields, used = [], set()
    for name in ("theta", "phi"):
        field, of = _component(name, columns, values)
        fields.append(field)
        used |= of
    found = np.array(fields)
    repeated = [
        (column, column.intensity(values[:, k].real))
        for k, column in enumerate(columns)
        if column is not None and column.part == "size" and k not in used
    ]
    sources = {columns[k].quantity for k in used if columns[k].part != "phase"}  # type: ignore[union-attr]
    _compare(found, repeated, sources)
    return found, repeated


def _component(
    name: str, columns: Sequence[Column | None], values: NDArray[Any]
) -> tuple[Complex, set[int]]:
    """The field (n,) in V along theta or phi, and the numbers of its columns."""
    found = {
        (column.quantity, column.part): k
        for k, column in enumerate(columns)
        if column is not None and column.component == name
    }

    def scaled(part: Part) -> Any:
        k = found["field", part]
        column = columns[k]
        assert column is not None
        return column.unit.scale * values[:, k]

    if {("field", "real"), ("field", "imaginary")} <= found.keys():
        pair = found["field", "real"], found["field", "imaginary"]
        return scaled("real").real + 1j * scaled("imaginary").real, set(pair)
    if ("field", "complex") in found:
        if not np.iscomplexobj(values) or not values.imag.any():
            raise FileFormatError(
                f"expected complex numbers of E_{name}, got real ones, which have no phase; export "
                "re and im, or mag and ang_deg"
            )
        return scaled("complex"), {found["field", "complex"]}
    sizes = [found[quantity, "size"] for quantity in _SIZES if (quantity, "size") in found]
    phases = [k for (_, part), k in found.items() if part == "phase"]
    if not sizes or not phases:
        raise FileFormatError(
            f"expected columns for E_{name}, re and im or size and phase, got "
            f"{'a size' if sizes else 'a phase' if phases else 'none'}; export the components "
            "along theta and phi with their phases"
        )
    size, phase = columns[sizes[0]], columns[phases[0]]
    assert size is not None
    assert phase is not None
    absolute = np.sqrt(2 * FREE_SPACE * size.intensity(values[:, sizes[0]].real))
    turned = np.radians(phase.unit.scale * values[:, phases[0]].real)
    return absolute * np.exp(1j * turned), {sizes[0], phases[0]}


def _compare(
    fields: Complex, repeated: list[tuple[Column, Floats]], sources: set[Quantity]
) -> None:
    """Raise FileFormatError for a column that disagrees with the fields.

    Columns of the fields' own quantity agree with them. Others differ from them by one factor, such
    as the radiated power.
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
        strongest = int(expected[compared].argmax())
        reference = 0.0 if sources == {column.quantity} else excess[strongest]
        worst = int(np.abs(excess - reference).argmax())
        if not abs(excess[worst] - reference) <= _SAME_LEVEL:
            raise FileFormatError(
                f"column {column.title} differs from the field components by "
                f"{excess[worst] - reference:.2f} dB; check the units in the header, and that all "
                "columns are of one export"
            )
