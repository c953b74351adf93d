"""Radiation patterns in files of simulators and planning tools: read and written."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from polywigner.errors import ArgumentError, FileFormatError, PolywignerError
from polywigner.geometry.arguments import (
    checked_choice,
    checked_length,
    checked_path,
    warn_caller,
    write_lines,
)
from polywigner.geometry.io.limits import bytes_of, check_most, text_of
from polywigner.propagation.beams import checked_efficiency
from polywigner.propagation.element_patterns import (
    ElementPattern,
    covers_front,
    linear_components,
    polar_components,
)
from polywigner.propagation.far_field_tables import (
    DIPOLE_GAIN,
    FLOOR,
    FREE_SPACE,
    LOADERS,
    MOST_DIRECTIONS,
    SAME_LEVEL,
    Complex,
    FarFieldTable,
    Floats,
    frequency_of,
    numbers_of,
)
from polywigner.propagation.patterns import (
    checked_pattern,
    cuts_of,
    described,
    jones_of,
    vector_dataset,
)
from polywigner.propagation.places import angle_axes
from polywigner.propagation.vector_fields import axial_ratios
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source.polarisation import checked_polarisation

if TYPE_CHECKING:
    import xarray

# ---- reading ------------------------------------------------------------------------------------

# Relative difference between a requested frequency and the frequency of a file.
_SAME_FREQUENCY = 1e-3
# Difference in dB between the directivity in a file and the integral over its directions that
# missing directions or coarse steps hardly explain.
_CONTRADICTION = 1.0
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
    if frequency is not None:
        meaning = "a frequency in Hz above zero"
        frequency = checked_length(frequency, "frequency", meaning=meaning)
    return _read(path, frequency, _SAME_FREQUENCY)


def read_nearest_pattern(path: str | os.PathLike[str], frequency: float) -> xarray.Dataset:
    """Read the pattern of a file at its frequency nearest to one in Hz."""
    return _read(path, frequency, math.inf)


def _read(
    path: str | os.PathLike[str], frequency: float | None, tolerance: float
) -> xarray.Dataset:
    file = checked_path(path)
    suffix = file.suffix.lower()
    try:
        if suffix not in (known := [*LOADERS, ".msi", ".pln"]):
            raise FileFormatError(
                f"expected a pattern file with the suffix {', '.join(known)}, got "
                f"{suffix or 'none'!r}"
            )
        lines = text_of(bytes_of(file)).splitlines()
        check_most(len(lines), MOST_DIRECTIONS + 10, "lines", "export coarser steps")
        if suffix not in LOADERS:
            return _planning_cuts(lines)
        return _dataset(_selected(list(LOADERS[suffix](lines)), frequency, tolerance))
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
        return tables[0] if frequency is None else replace(tables[0], frequency=frequency)
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
    if len(np.unique(np.stack([table.theta, table.phi]).round(6), axis=1).T) < len(table.theta):
        raise FileFormatError("expected each direction once, got some several times")
    fields = table.fields.conj() / math.sqrt(2 * FREE_SPACE)
    flat = _folded(table.theta, table.phi, fields)
    axes = np.unique(flat[0]), np.unique(flat[1])
    few = len(axes[1]) < _LEAST_MERIDIANS or not covers_front(*map(np.radians, axes))
    if table.has_unit_power and few:
        theta, phi, (polar, azimuthal) = _gridded(table.theta.round(6), table.phi.round(6), fields)
        if not fields.any():
            raise FileFormatError("expected a far field other than zero, got zeros only")
        power = 1.0
    else:
        theta, phi, (polar, azimuthal) = _gridded(*flat)
        integral = ElementPattern(theta, phi, (polar, azimuthal)).power(0.0)
        power = _radiated_power(table, integral)
    with np.errstate(divide="ignore"):
        squares = np.square(np.abs(polar)) + np.square(np.abs(azimuthal))
        levels = 10 * np.log10(4 * math.pi / power * squares)
    sine, cosine = np.sin(phi), np.cos(phi)
    along = polar * cosine - azimuthal * sine, polar * sine + azimuthal * cosine
    peak = np.unravel_index(levels.argmax(), levels.shape)
    about = _about(theta, phi, levels, table.frequency, power)
    jones = jones_of((along[0][peak], along[1][peak]))
    return vector_dataset(angle_axes(theta, phi), levels, along, jones, about)


def _about(
    theta: Floats, phi: Floats, levels: Floats, frequency: float, power: float
) -> dict[str, float]:
    """The attributes of a pattern whose beam is its largest sample."""
    row, column = np.unravel_index(levels.argmax(), levels.shape)
    return {
        "wavelength": SPEED_OF_LIGHT / frequency,
        "frequency": frequency,
        "radiated_power": power,
        "aperture_power": math.nan,
        **dict.fromkeys(("largest_directivity", "peak_directivity"), float(levels.max())),
        "peak_theta": float(abs(theta[row])),
        "peak_phi": float((phi[column] + math.pi * (theta[row] < 0)) % (2 * math.pi)),
    }


def _folded(theta: Floats, phi: Floats, fields: Complex) -> tuple[Floats, Floats, Complex]:
    """Directions with theta moved into 0 to 180 and phi into 0 up to below 360 degrees.

    The unit vectors change their signs from (-theta, phi) to (theta, phi + 180). At the poles they
    do so from phi to phi + 180, where rows are added for the other half of the turn.
    """
    theta = theta.round(6) % 360
    beyond = theta > 180
    theta = np.where(beyond, 360 - theta, theta).round(6)
    phi, fields = phi + 180 * beyond, np.where(beyond, -1, 1) * fields
    if beyond.any():
        poles = (theta == 0) | (theta == 180)
        theta, phi = np.append(theta, theta[poles]), np.append(phi, phi[poles] + 180)
        fields = np.concatenate([fields, -fields[:, poles]], axis=1)
    return theta, (phi % 360).round(6) % 360, fields


def _gridded(theta: Floats, phi: Floats, fields: Complex) -> tuple[Floats, Floats, Complex]:
    """Theta (n,) and phi (m,) in rad, and both components (2, n, m)."""
    rows, row = np.unique(theta, return_inverse=True)
    turns, column = np.unique(phi, return_inverse=True)
    check_most(len(rows) * len(turns), MOST_DIRECTIONS, "directions", "export a grid of angles")
    grid = np.full((2, len(rows), len(turns)), np.nan, np.complex128)
    grid[:, row, column] = fields
    if np.isnan(grid).any():
        raise FileFormatError(
            f"expected each of {len(rows)} angles theta and {len(turns)} angles phi with each "
            f"other once, got {len(theta)} directions"
        )
    if np.abs(grid[:, row, column] - fields).max() > _SAME_FIELD * np.abs(fields).max():
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
    totals = {c.quantity: (c, float(v[peak])) for c, v in table.repeated if c.component == "total"}
    is_sphere = table.theta.max() > 180 - 1e-6
    power = strongest / totals["directivity"][1] if "directivity" in totals else integral
    if table.has_unit_power and not is_sphere:
        power = 1.0
    level, stated = (10 * math.log10(4 * math.pi * strongest / one) for one in (integral, power))
    contradiction = (
        f"the file has a directivity of {stated:.2f} dBi, but the integral over its directions "
        f"gives {level:.2f} dBi"
    )
    # missing directions make the integral's level larger, not smaller
    if (abs(level - stated) if is_sphere else stated - level) > _CONTRADICTION:
        raise FileFormatError(
            f"{contradiction}; check the units in the header, or export finer steps"
        )
    if abs(level - stated) > SAME_LEVEL:
        warn_caller(
            f"{contradiction}: directions are missing, or steps are too coarse; the former is used"
        )
    column, gain = totals.get("gain", (None, 0.0))
    if column is not None and 4 * math.pi * gain > 10 ** ((stated + SAME_LEVEL) / 10):
        warn_caller(
            f"column {column.title} has a gain of {10 * math.log10(4 * math.pi * gain):.2f} dBi, "
            f"which exceeds the directivity of {stated:.2f} dBi: directions are missing, steps are "
            "too coarse, or its unit is another"
        )
    return power


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


# ---- writing ------------------------------------------------------------------------------------

Polarisation = Literal["x", "y"]
Lines = Iterator[str]

# Largest attenuation in dB below the peak, as planning tools have it.
_MOST_ATTENUATION = 99.9
# Axial ratio in dB that stands for infinity, as of a linear polarisation.
_AXIAL_RATIO = 40.0


@dataclass(frozen=True)
class _Pattern:
    """The values written: angles in degrees, levels in dBi, fields in V, Hz and W."""

    theta: Floats
    phi: Floats
    directivity: Floats
    components: tuple[Complex, Complex]
    """E_theta and E_phi (n, m), with their phases."""
    about: dict[str, float]

    def rows(self, *columns: Floats) -> Iterator[tuple[float, ...]]:
        """Phi, theta and values (n, m) of each direction; theta runs fastest."""
        phi, theta = np.meshgrid(self.phi, self.theta, indexing="ij")
        table = [phi, theta, *(column.T for column in columns)]
        return zip(*(values.ravel().tolist() for values in table), strict=True)


def write_pattern(
    pattern: xarray.Dataset,
    path: str | os.PathLike[str],
    *,
    polarisation: Polarisation | None = None,
    efficiency: float = 1.0,
) -> None:
    """Write a :func:`radiation_pattern` to a file of angles, directivity and field components.

    =======  =====================================================================================
    suffix   what
    =======  =====================================================================================
    .csv     ``Phi [deg],Theta [deg],dB(DirTotal),re(rETheta) [V],...`` as HFSS exports reports:
             for spreadsheets, MATLAB (readmatrix and patternCustom), pandas. Theta runs fastest.
    .txt     the far-field table of CST Studio Suite's ASCII export, two lines of header and eight
             columns, that scripts and simulators (OSKAR among them) read. Theta runs fastest.
    .ffd     far-field data of HFSS: for its far-field links, and PyAEDT. Evenly spaced angles,
             0 <= theta <= 180 degrees.
    .cut     TICRA's GRASP: a polar cut for each phi, E_theta and E_phi with a radiated power of 4
             pi, so that squares are directivities. Evenly spaced theta.
    .msi     MSI Planet, also .pln: attenuations every degree in the horizontal and the vertical
    .pln     plane, for an aperture whose y axis points up; 99.9 dB behind. Cuts phi = 0 and 90
             degrees with theta from -90 to 90 degrees, or their halves.
    =======  =====================================================================================

    A scalar field becomes the co-polar component by Ludwig's third definition, E_theta = E
    cos(phi), E_phi = -E sin(phi) for an aperture polarised along x, E sin(phi) and E cos(phi) along
    y. Phases are conjugates, exp(+j omega t - j k r). rE is in V, with |rE|^2/(2 Z0) in W/sr.
    Directions without radiation have -300 dBi.

    Parameters
    ----------
    pattern : of :func:`radiation_pattern`, or a part of it; files have angles in ascending order.
    path : the suffix chooses the format. The file appears whole or not at all.
    polarisation : of a scalar pattern "x" or "y" (None: "y"), the direction of the electric field
        on the aperture; None for a pattern that has a polarisation.
    efficiency : radiated over accepted power, for the gain that .msi and .pln files name.

    Raises
    ------
    FileFormatError for another suffix; ArgumentError for anything but a pattern, another
    polarisation, angles that the format does not take, and a place that cannot be written to.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, [0.0, 0.1], [0.0])
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "square.csv"
    >>> pw.write_pattern(pattern, path)
    >>> path.read_text().splitlines()[0].split(",")[:3]
    ['Phi [deg]', 'Theta [deg]', 'dB(DirTotal)']
    """
    file = checked_path(path)
    writers = {
        ".csv": _csv, ".txt": _cst, ".ffd": _ffd, ".cut": _grasp, ".msi": _msi, ".pln": _msi,
    }  # fmt: skip
    if file.suffix.lower() not in writers:
        raise FileFormatError(
            f"{file}: expected a pattern file with the suffix {', '.join(writers)}, got "
            f"{file.suffix or 'none'!r}"
        )
    lines = writers[file.suffix.lower()](_checked(pattern, polarisation, efficiency))
    write_lines(file, lines)


def _checked(pattern: Any, polarisation: Any, efficiency: float) -> _Pattern:
    checked_pattern(pattern)
    if "field" not in pattern:
        raise ArgumentError(
            "expected a pattern with directivity and field over theta and phi, got one without a "
            "field; use what polywigner.radiation_pattern returned"
        )
    if "cross_field" not in pattern:
        name = "y" if polarisation is None else polarisation
        jones = checked_polarisation(checked_choice(name, "polarisation", ("x", "y")))
        pattern = pattern.assign(cross_field=0 * pattern["field"])
        pattern = pattern.assign_attrs(polarisation=jones.view(np.float64))
    elif polarisation is not None:
        raise ArgumentError(
            f"expected no polarisation for a pattern that has its own, got {polarisation!r}; leave "
            "it out"
        )
    theta, phi, x, y, _ = linear_components(pattern, "pattern")
    levels, about = checked_pattern(pattern.sortby(["theta", "phi"]))[2:]
    scale = math.sqrt(2 * FREE_SPACE)
    a, b = (scale * part.conj() for part in polar_components(x, y, phi))
    about["gain"] = about["peak_directivity"] + 10 * math.log10(checked_efficiency(efficiency))
    return _Pattern(np.degrees(theta), np.degrees(phi), np.maximum(levels, FLOOR), (a, b), about)


def _csv(pattern: _Pattern) -> Lines:
    names = [f"{part}(rE{name}) [V]" for name in ("Theta", "Phi") for part in ("re", "im")]
    yield ",".join(["Phi [deg]", "Theta [deg]", "dB(DirTotal)", *names])
    parts = [part for each in pattern.components for part in (each.real, each.imag)]
    for row in pattern.rows(pattern.directivity, *parts):
        yield ",".join(f"{value:.9g}" for value in row)


def _cst(pattern: _Pattern) -> Lines:
    heading = (
        "Theta [deg.]  Phi   [deg.]  Abs(Dir.)[dBi   ]   Abs(Theta)[dBi   ]  Phase(Theta)[deg.]  "
        "Abs(Phi  )[dBi   ]  Phase(Phi  )[deg.]  Ax.Ratio[dB    ]"
    )
    yield heading
    yield "-" * len(heading)
    squares = [np.square(np.abs(component)) for component in pattern.components]
    with np.errstate(divide="ignore", invalid="ignore"):
        levels = [pattern.directivity + 10 * np.log10(part / sum(squares)) for part in squares]
    levels = [np.maximum(np.nan_to_num(level, nan=FLOOR), FLOOR) for level in levels]
    phases = [np.degrees(np.angle(component)) % 360 for component in pattern.components]
    ratios = np.minimum(np.nan_to_num(axial_ratios(pattern.components), nan=np.inf), _AXIAL_RATIO)
    columns = [pattern.directivity, levels[0], phases[0], levels[1], phases[1], ratios]
    for phi, theta, *values in pattern.rows(*columns):
        yield " ".join(f"{value:14.6f}" for value in (theta, phi, *values))


def _ffd(pattern: _Pattern) -> Lines:
    if pattern.theta.min() < 0:
        raise ArgumentError(
            f"expected theta from 0 to 180 degrees for an .ffd file, got {pattern.theta.min():g}; "
            "use phi over the whole turn"
        )
    for name, angles in (("theta", pattern.theta), ("phi", pattern.phi)):
        _step(name, angles, ".ffd")
        yield f"{angles[0]:.9g} {angles[-1]:.9g} {len(angles)}"
    yield "Frequencies 1"
    yield f"Frequency {pattern.about['frequency']:.12g}"
    yield from _pairs(*(component.ravel() for component in pattern.components))


def _grasp(pattern: _Pattern) -> Lines:
    step = _step("theta", pattern.theta, ".cut")
    # rE in V, 4 pi |rE|^2/(2 Z0)/P is the directivity
    scale = math.sqrt(4 * math.pi / (2 * FREE_SPACE * pattern.about["radiated_power"]))
    for j, phi in enumerate(pattern.phi):
        yield f"polywigner, {pattern.about['frequency']:.12g} Hz, phi = {phi:.9g} deg"
        yield f"{pattern.theta[0]:.9g} {step:.9g} {len(pattern.theta)} {phi:.9g} 1 1 2"
        yield from _pairs(*(scale * component[:, j] for component in pattern.components))


def _pairs(first: Complex, second: Complex) -> Lines:
    for a, b in zip(first, second, strict=True):
        yield f"{a.real:.9e} {a.imag:.9e} {b.real:.9e} {b.imag:.9e}"


def _msi(pattern: _Pattern) -> Lines:
    peak = pattern.about["peak_directivity"]
    yield "NAME polywigner"
    yield "MAKE polywigner"
    yield f"FREQUENCY {pattern.about['frequency'] / 1e6:.9g}"
    yield f"GAIN {pattern.about['gain']:.3f} dBi"
    yield "TILT ELECTRICAL"
    yield "COMMENT far field of an aperture, y axis up"
    # Seen from behind, with y up, x points to the left: angles run to the right and downwards.
    for name, phi in (("HORIZONTAL", 0.0), ("VERTICAL", 90.0)):
        theta, levels = _full_cut(pattern, phi)
        yield f"{name} 360"
        for degrees in range(360):
            angle = -float(degrees if degrees <= 180 else degrees - 360)
            behind = abs(angle) > 90
            level = FLOOR if behind else float(np.interp(angle, theta, levels))
            yield f"{degrees} {min(peak - level, _MOST_ATTENUATION):.3f}"


def _full_cut(pattern: _Pattern, phi: float) -> tuple[Floats, Floats]:
    """Theta in degrees from -90 or less to 90 or more, and levels in dBi, of a meridian."""
    meridians = cuts_of(np.radians(pattern.theta), np.radians(pattern.phi), pattern.directivity)
    for angle, theta, levels in meridians:
        turn = (math.degrees(angle) - phi) % 360.0
        same, opposite = min(turn, 360.0 - turn) < 1e-6, abs(turn - 180.0) < 1e-6
        reach = np.degrees(theta)
        if (same or opposite) and reach.min() <= -90 + 1e-6 and reach.max() >= 90 - 1e-6:
            return (reach, levels) if same else (-reach[::-1], levels[::-1])
    raise ArgumentError(
        f"expected a cut at phi = {phi:g} degrees with theta from -90 to 90 degrees for an .msi "
        f"file, got phi = {', '.join(f'{a:g}' for a in pattern.phi[:8])} and theta from "
        f"{pattern.theta.min():g} to {pattern.theta.max():g} degrees; add them to radiation_pattern"
    )


def _step(name: str, angles: Floats, suffix: str) -> float:
    """The step of angles in degrees; ArgumentError where they are not evenly spaced."""
    steps = np.diff(angles)
    if steps.size and np.ptp(steps) > 1e-6 * abs(angles[-1] - angles[0]):
        raise ArgumentError(
            f"expected evenly spaced {name} for a {suffix} file, got steps from {steps.min():g} "
            f"to {steps.max():g} degrees"
        )
    return float((angles[-1] - angles[0]) / max(1, steps.size))
