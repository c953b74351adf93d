"""Readers and writers of radiation patterns in file formats of simulators and planning tools."""

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
    check_most,
    checked_choice,
    checked_length,
    checked_path,
    warn_caller,
    write_lines,
)
from polywigner.geometry.io.limits import bytes_of, checked_suffix, text_of
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
    numbers_of,
)
from polywigner.propagation.patterns import (
    checked_pattern,
    cuts_of,
    decibels,
    described,
    jones_of,
    vector_dataset,
)
from polywigner.propagation.point_grids import angle_axes
from polywigner.propagation.vector_fields import axial_ratios
from polywigner.quantities import SPEED_OF_LIGHT, parse_frequency
from polywigner.source.polarisation import checked_polarisation

if TYPE_CHECKING:
    import xarray

# Relative difference up to which a frequency in a file matches the requested frequency.
_SAME_FREQUENCY = 1e-3
# Largest difference [dB] between the stated and the integrated directivity. Missing directions and
# coarse steps cause smaller differences.
_CONTRADICTION = 1.0
# Largest relative difference between repeated fields, such as at phi = 0 and 360 degrees.
_SAME_FIELD = 1e-3
# Smallest number of meridians for the integral of the radiated power.
_LEAST_MERIDIANS = 8


def read_pattern(path: str | os.PathLike[str], frequency: float | None = None) -> xarray.Dataset:
    """Read a radiation pattern from a file of a simulator or a planning tool.

    ======  =====================================================================================
    suffix  content
    ======  =====================================================================================
    .csv    Reports of HFSS: columns Theta, Phi and rETheta, rEPhi as re and im, or as mag and
            ang_deg; levels such as dB(GainTheta) with phases; Freq.
    .txt    Far-field table of CST: Abs and Phase of Theta and Phi.
    .ffd    Far-field data of HFSS, with one or several frequencies.
    .ffe    Far fields of FEKO, with one or several frequencies.
    .cut    Spherical cuts of GRASP: ICOMP 1, 2 or 3, polar or conical.
    .msi    MSI Planet, also .pln: gain and attenuations in two planes, without fields.
    ======  =====================================================================================

    Headers specify the units. Fields are in V (rE) or V/m (E at 1 m). Powers are in W/sr, W, or
    W/m2 (at 1 m). Units of fields and powers may have prefixes or be in dB, such as dBuV/m and
    dBm/m2. Gain and directivity are ratios or in dBi or dBd, and angles are in deg or rad. Other
    units raise an error. Columns that repeat the magnitude of the field, such as Abs(Dir.) and
    GainTotal, must agree with the field components to 0.1 dB.

    Parameters
    ----------
    path : path
        Path of the file, whose suffix specifies the format. Angles must be evenly spaced: theta
        from 0 to 90 or to 180 degrees and phi around the full circle, or theta from -180 to 180
        degrees. A .cut file may contain only a few cuts. If a file has no directions behind the
        plane, the backward radiation is zero.
    frequency : float, optional
        Frequency in Hz to select from a file with several frequencies, or the frequency of a file
        that does not contain its frequency (.csv, .txt, .cut).

    Returns
    -------
    xarray.Dataset
        The same variables as :func:`radiation_pattern` returns for a polarised source, in the time
        convention exp(-i omega t), with theta of 0 or more. The beam is the largest sample. The
        radiated power follows from the directivity in the file, or is the integral of the field
        over all directions; it is near 1 W for files in dBi and for .cut files. The aperture power
        is NaN. Frequency and wavelength are NaN if the file does not contain a frequency.

        For .msi and .pln files, ``directivity`` is the gain over theta from -180 to 180 degrees at
        phi = 0 (horizontal) and 90 degrees (vertical). These datasets contain no ``field``, and
        their radiated power is NaN.

    Raises
    ------
    FileFormatError
        If the file is missing, larger than 64 MiB, of another format, or damaged; if a unit is not
        supported, columns contradict each other, angles do not cover the front, or fields are not
        finite or all zero; or if the file contains several frequencies and ``frequency`` is not
        specified or not among them.
    ArgumentError
        If the path or the frequency is invalid.

    Warns
    -----
    PolywignerWarning
        If the directivity in the file differs by more than 0.1 dB from the directivity that follows
        from the integral over its directions. In this case, the directivity in the file is used. A
        difference above 1 dB is an error, unless directions are missing. A warning is also issued
        if a gain exceeds the directivity, and if GAIN in an .msi file has no unit, so that dBd is
        assumed.

    Examples
    --------
    >>> import numpy as np, polywigner as pw
    >>> import pathlib, tempfile
    >>> angles = np.radians(np.arange(0, 91, 5)), np.radians(np.arange(0, 360, 10))
    >>> horn = pw.radiation_pattern(pw.shapes.square(4e-3), 3.9e-3, *angles, polarisation="x")
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "horn.ffd"
    >>> pw.write_pattern(horn, path)
    >>> pattern = pw.read_pattern(path)
    >>> bool(abs(pattern["directivity"] - horn["directivity"])[:18].max() < 1e-6)
    True
    """
    if frequency is not None:
        meaning = "a frequency in Hz above zero"
        frequency = checked_length(frequency, "frequency", meaning=meaning)
    return _read(path, frequency, _SAME_FREQUENCY)


def read_nearest_pattern(path: str | os.PathLike[str], frequency: float) -> xarray.Dataset:
    """Read the pattern of a file at the frequency closest to ``frequency`` in Hz, at any distance.

    A file without a frequency is read as a pattern at ``frequency``.
    """
    return _read(path, frequency, math.inf)


def _read(
    path: str | os.PathLike[str], frequency: float | None, tolerance: float
) -> xarray.Dataset:
    """Read a pattern at ``frequency`` in Hz, within a relative ``tolerance``.

    A ``frequency`` of None selects the only frequency of the file. Raises FileFormatError for
    invalid files.
    """
    file = checked_path(path)
    try:
        suffix = checked_suffix(file, (*LOADERS, ".msi", ".pln"))
        lines = text_of(bytes_of(file)).splitlines()
        check_most(len(lines), MOST_DIRECTIONS + 10, "lines", "export coarser steps")
        if suffix not in LOADERS:
            return _msi_pattern(lines)
        return _pattern_of(_at_frequency(list(LOADERS[suffix](lines)), frequency, tolerance))
    except PolywignerError as error:
        raise FileFormatError(f"{file}: {error}") from None


def _at_frequency(
    tables: list[FarFieldTable], frequency: float | None, tolerance: float
) -> FarFieldTable:
    """Return the far field nearest to a frequency in Hz, or for None the only far field.

    A table without a frequency is returned with this frequency. Raises FileFormatError if the
    relative difference exceeds ``tolerance``.
    """
    if not tables:
        raise FileFormatError("the file contains no far field")
    known = np.array([table.frequency for table in tables])
    if len(tables) == 1 and (frequency is None or math.isnan(known[0])):
        return tables[0] if frequency is None else replace(tables[0], frequency=frequency)
    listed = ", ".join(f"{value:g}" for value in known[:6]) + ", ..." * (len(known) > 6)
    if np.isnan(known).any() or len(np.unique(known)) < len(known):
        raise FileFormatError(
            "the file contains several far fields for the same frequency; keep one of them"
        )
    if frequency is None:
        raise FileFormatError(
            f"the file contains {len(known)} frequencies; pass frequency= as one of {listed} Hz"
        )
    nearest = int(np.abs(known - frequency).argmin())
    if not abs(known[nearest] / frequency - 1) <= tolerance:
        raise FileFormatError(
            f"the file contains no far field at the requested frequency of {frequency:g} Hz; "
            f"its frequencies are {listed} Hz"
        )
    return tables[nearest]


def _pattern_of(table: FarFieldTable) -> xarray.Dataset:
    """Return a far field from a file as the pattern of a polarised source, with exp(-i omega t).

    Raises FileFormatError for repeated, missing or contradictory directions.
    """
    fields = table.fields.conj() / math.sqrt(2 * FREE_SPACE)
    flat = _folded(table.theta, table.phi, fields)
    axes = np.unique(flat[0]), np.unique(flat[1])
    few = len(axes[1]) < _LEAST_MERIDIANS or not covers_front(*map(np.radians, axes))
    if table.has_unit_power and few:
        theta, phi, (polar, azimuthal) = _gridded(table.theta.round(6), table.phi.round(6), fields)
        if not fields.any():
            raise FileFormatError(
                "the far field is zero in all directions; export the far field again"
            )
        power = 1.0
    else:
        theta, phi, (polar, azimuthal) = _gridded(*flat)
        power = _radiated_power(table, ElementPattern(theta, phi, (polar, azimuthal)).power(0.0))
    levels = decibels(np.square(np.abs(polar)) + np.square(np.abs(azimuthal)), power)
    along = polar_components(polar, azimuthal, -phi)
    peak = np.unravel_index(levels.argmax(), levels.shape)
    about = _attributes(theta, phi, levels, table.frequency, power)
    jones = jones_of((along[0][peak], along[1][peak]))
    return vector_dataset(angle_axes(theta=theta, phi=phi), levels, along, jones, about)


def _attributes(
    theta: Floats, phi: Floats, levels: Floats, frequency: float, power: float
) -> dict[str, float]:
    """Return the attributes of a pattern with levels (n, m) in dBi, including its beam.

    Angles are in rad, the frequency is in Hz and the radiated power in W.
    """
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
    """Convert directions in degrees to theta from 0 to 180 and phi from 0 to below 360.

    The components (2, n) along theta and phi change sign if theta is folded. Directions at the
    poles are repeated at phi + 180.
    """
    # The unit vectors along theta and phi change sign between (-theta, phi) and (theta, phi + 180).
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
    """Return theta (n,) and phi (m,) in rad, and field components (2, n, m) on their grid.

    The arguments are angles (k,) in degrees and field components (2, k). Raises FileFormatError if
    a direction of the grid is missing, or has two different fields.
    """
    polar, row = np.unique(theta, return_inverse=True)
    azimuth, column = np.unique(phi, return_inverse=True)
    shape = len(polar), len(azimuth)
    check_most(math.prod(shape), MOST_DIRECTIONS, "directions", "export a grid of angles")
    grid = np.full((2, *shape), np.nan, np.complex128)
    grid[:, row, column] = fields
    if np.isnan(grid).any():
        raise FileFormatError(
            f"expected all directions of a grid of {shape[0]} theta angles and {shape[1]} phi "
            f"angles, got {len(theta)} directions; export a complete grid"
        )
    if np.abs(grid[:, row, column] - fields).max() > _SAME_FIELD * np.abs(fields).max():
        raise FileFormatError(
            "the file contains different fields for the same direction; compare the rows at phi "
            "= 0 and 360 degrees, and at theta and -theta"
        )
    return np.radians(polar), np.radians(azimuth), grid


def _radiated_power(table: FarFieldTable, integral: float) -> float:
    """Return the radiated power in W from the directivity in a file, or by default ``integral``."""
    squares = np.square(np.abs(table.fields)).sum(axis=0)
    peak = int(squares.argmax())
    strongest = float(squares[peak]) / (2 * FREE_SPACE)
    totals = {c.quantity: (c, float(v[peak])) for c, v in table.repeated if c.component == "total"}
    is_sphere = table.theta.max() > 180 - 1e-6
    power = strongest / totals["directivity"][1] if "directivity" in totals else integral
    if table.has_unit_power and not is_sphere:
        power = 1.0
    level, stated = (10 * math.log10(4 * math.pi * strongest / p) for p in (integral, power))
    contradiction = (
        f"the file contains a directivity of {stated:.2f} dBi, but the integral over its "
        f"directions gives {level:.2f} dBi"
    )
    # Missing directions can only increase the integrated directivity.
    if (abs(level - stated) if is_sphere else stated - level) > _CONTRADICTION:
        raise FileFormatError(
            f"{contradiction}; check the units in the header, or export finer steps"
        )
    if abs(level - stated) > SAME_LEVEL:
        warn_caller(
            f"{contradiction}, so directions are missing or the steps are too coarse; the "
            "directivity in the file is used"
        )
    column, gain = totals.get("gain", (None, 0.0))
    if column is not None and 4 * math.pi * gain > 10 ** ((stated + SAME_LEVEL) / 10):
        warn_caller(
            f"the gain of {10 * math.log10(4 * math.pi * gain):.2f} dBi in column {column.title} "
            f"exceeds the directivity of {stated:.2f} dBi: directions are missing, the steps are "
            "too coarse, or the unit is wrong"
        )
    return power


_GAIN = re.compile(r"([-+]?\d+\.?\d*(?:e[-+]?\d+)?)\s*(dBi|dBd)?", re.IGNORECASE)


def _msi_pattern(lines: list[str]) -> xarray.Dataset:
    """Return the horizontal and the vertical cut of an MSI file as a pattern."""
    words = [line.split() for line in lines]
    values = {word[0].upper(): " ".join(word[1:]) for word in words if word}
    match = _GAIN.fullmatch(values.get("GAIN", ""))
    if match is None:
        raise FileFormatError(f"expected GAIN in dBi or dBd, got {values.get('GAIN', '')[:30]!r}")
    gain = float(match[1]) + (DIPOLE_GAIN if (match[2] or "dBd").lower() == "dbd" else 0.0)
    if match[2] is None:
        warn_caller(
            "the line GAIN has no unit; the default dBd of the format is assumed, which gives "
            f"{gain:.2f} dBi; add dBi or dBd to the line"
        )
    text = values.get("FREQUENCY", "")
    is_band = not text or "-" in text
    has_unit = text.lower().endswith("hz")
    frequency = math.nan if is_band else parse_frequency(text if has_unit else f"{text} MHz")
    cuts = [_msi_cut(name, words, lines) for name in ("HORIZONTAL", "VERTICAL")]
    angles = cuts[0][0]
    if not np.array_equal(angles, cuts[1][0]):
        raise FileFormatError(
            "expected the same angles in the horizontal and the vertical cut, got different angles"
        )
    # The angles in a file increase to the right and downwards, as seen from behind the antenna with
    # y up.
    theta = np.where(angles > 180, 360 - angles, -angles)
    levels = gain - np.stack([attenuation for _, attenuation in cuts], axis=1)
    back = np.flatnonzero(theta == -180)
    theta = np.append(theta, 180.0 + np.zeros(len(back)))
    levels = np.concatenate([levels, levels[back]])
    order = np.argsort(theta)
    theta, levels, phi = np.radians(theta[order]), levels[order], np.array([0.0, math.pi / 2])
    about = _attributes(theta, phi, levels, frequency, math.nan)
    return described(None, angle_axes(theta=theta, phi=phi), {"directivity": levels}, about)


def _msi_cut(name: str, words: list[list[str]], lines: list[str]) -> tuple[Floats, Floats]:
    """Return angles in degrees and attenuations in dB of the "HORIZONTAL" or "VERTICAL" cut.

    The angles ascend from 0 to below 360. Raises FileFormatError for other content.
    """
    at = [k for k, word in enumerate(words) if word[:1] and word[0].upper() == name]
    if len(at) != 1 or not words[at[0]][1:2] or not words[at[0]][1].isdecimal():
        raise FileFormatError(f"expected exactly one line with {name} and the number of angles")
    start, count = at[0], int(words[at[0]][1])
    table = numbers_of(lines[start + 1 : start + 1 + count], start + 2, 2)
    angles, rows = np.unique(table[:, 0] % 360, return_index=True)
    if len(table) != count or count < 4 or np.ptp(np.diff(angles, append=360.0)) > 1e-6:
        raise FileFormatError(
            f"expected {count} lines of evenly spaced angles around the full circle after {name}"
        )
    return angles, table[rows, 1]


Polarisation = Literal["x", "y"]
Lines = Iterator[str]

# Largest attenuation in planning files [dB].
_MOST_ATTENUATION = 99.9
# Finite stand-in for an infinite axial ratio in CST files [dB].
_AXIAL_RATIO = 40.0


@dataclass(frozen=True)
class _Pattern:
    """A pattern with the angles, units and phase convention of pattern files."""

    theta: Floats
    """Angles theta in degrees, shape (n,)."""
    phi: Floats
    """Angles phi in degrees, shape (m,)."""
    directivity: Floats
    """Directivity in dBi, shape (n, m)."""
    components: tuple[Complex, Complex]
    """E_theta and E_phi in V with phases exp(+j omega t - j k r), shapes (n, m)."""
    about: dict[str, float]
    """Numerical attributes of the pattern in Hz, W and dBi."""

    def rows(self, *columns: Floats) -> Iterator[tuple[float, ...]]:
        """Yield phi, theta (degrees) and the values of columns (n, m); theta varies fastest."""
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
    """Write a radiation pattern to a file of angles, directivity and field components.

    =======  =====================================================================================
    suffix   content
    =======  =====================================================================================
    .csv     ``Phi [deg],Theta [deg],dB(DirTotal),re(rETheta) [V],...`` as HFSS exports reports:
             for spreadsheets, MATLAB (readmatrix and patternCustom), pandas. Theta varies fastest.
    .txt     The far-field table of CST Studio Suite's ASCII export, two lines of header and eight
             columns, also read by OSKAR. Theta varies fastest.
    .ffd     Far-field data of HFSS, for its far-field links and PyAEDT. Requires evenly spaced
             angles with theta from 0 to 180 degrees.
    .cut     TICRA's GRASP: a polar cut for each phi. Fields are scaled to a radiated power of 4 pi
             W, so ``|E|^2`` is the directivity. Requires evenly spaced theta.
    .msi     MSI Planet: attenuations every degree in the horizontal and the vertical plane, for an
    .pln     aperture whose y axis points up; 99.9 dB behind it. Requires cuts at phi = 0 and 90
             degrees with theta from -90 to 90 degrees, or the halves of these cuts.
    =======  =====================================================================================

    A scalar field E becomes the co-polar component by Ludwig's third definition. For an aperture
    polarised along x, the components are ``E_theta = E cos(phi)`` and ``E_phi = -E sin(phi)``. For
    an aperture polarised along y, they are ``E_theta = E sin(phi)`` and ``E_phi = E cos(phi)``.
    Files use the phases exp(+j omega t - j k r), so fields are conjugated. The field rE is in V,
    and ``|rE|^2/(2 Z0)`` is the radiant intensity in W/sr, where Z0 is the impedance of free space.
    Directions without radiation have -300 dBi.

    Parameters
    ----------
    pattern : xarray.Dataset
        Result of :func:`radiation_pattern`, or a selection of its angles. Angles are written in
        ascending order.
    path : path
        Path of the file, whose suffix selects the format. The file is written completely or not at
        all.
    polarisation : {"y", "x"}, default "y"
        Direction of the electric field on the aperture of a scalar pattern. The argument is not
        allowed for a polarised pattern.
    efficiency : float, default 1
        Radiated power divided by accepted power, for the gain in .msi and .pln files.

    Raises
    ------
    FileFormatError
        If the suffix is unknown.
    ArgumentError
        If an argument is invalid, the format does not support the angles, or the file cannot be
        written.

    Examples
    --------
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
        ".csv": _csv_lines, ".txt": _cst_lines, ".ffd": _ffd_lines, ".cut": _grasp_lines,
        ".msi": _msi_lines, ".pln": _msi_lines,
    }  # fmt: skip
    write = writers[checked_suffix(file, writers)]
    write_lines(file, write(_file_pattern(pattern, polarisation, efficiency)))


def _file_pattern(pattern: Any, polarisation: Any, efficiency: float) -> _Pattern:
    """Return a pattern in the form of pattern files; raise ArgumentError for invalid arguments."""
    checked_pattern(pattern)
    if "field" not in pattern:
        raise ArgumentError(
            "the pattern has no complex field, which a file requires; use a result of "
            "polywigner.radiation_pattern"
        )
    if "cross_field" not in pattern:
        name = "y" if polarisation is None else polarisation
        jones = checked_polarisation(checked_choice(name, "polarisation", ("x", "y")))
        pattern = pattern.assign(cross_field=0 * pattern["field"])
        pattern = pattern.assign_attrs(polarisation=jones.view(np.float64))
    elif polarisation is not None:
        raise ArgumentError(
            f"polarisation={polarisation!r} is not allowed, since the pattern already has a "
            "polarisation; omit polarisation"
        )
    theta, phi, x, y, _ = linear_components(pattern, "pattern")
    levels, about = checked_pattern(pattern.sortby(["theta", "phi"]))[2:]
    scale = math.sqrt(2 * FREE_SPACE)
    a, b = (scale * part.conj() for part in polar_components(x, y, phi))
    about["gain"] = about["peak_directivity"] + 10 * math.log10(checked_efficiency(efficiency))
    return _Pattern(np.degrees(theta), np.degrees(phi), np.maximum(levels, FLOOR), (a, b), about)


def _csv_lines(pattern: _Pattern) -> Lines:
    """Yield the lines of a report in the format of HFSS."""
    names = [f"{part}(rE{name}) [V]" for name in ("Theta", "Phi") for part in ("re", "im")]
    yield ",".join(["Phi [deg]", "Theta [deg]", "dB(DirTotal)", *names])
    parts = [part for field in pattern.components for part in (field.real, field.imag)]
    for row in pattern.rows(pattern.directivity, *parts):
        yield ",".join(f"{value:.9g}" for value in row)


def _cst_lines(pattern: _Pattern) -> Lines:
    """Yield the lines of a far-field table in the format of CST."""
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


def _ffd_lines(pattern: _Pattern) -> Lines:
    """Yield the lines of far-field data in the format of HFSS."""
    if pattern.theta.min() < 0:
        raise ArgumentError(
            "an .ffd file requires theta from 0 to 180 degrees, got theta = "
            f"{pattern.theta.min():g} degrees; replace negative theta by phi over the full circle"
        )
    for name, angles in (("theta", pattern.theta), ("phi", pattern.phi)):
        _even_step(name, angles, ".ffd")
        yield f"{angles[0]:.9g} {angles[-1]:.9g} {len(angles)}"
    yield "Frequencies 1"
    yield f"Frequency {pattern.about['frequency']:.12g}"
    yield from _field_lines(*(component.ravel() for component in pattern.components))


def _grasp_lines(pattern: _Pattern) -> Lines:
    """Yield the lines of polar cuts in the format of GRASP."""
    step = _even_step("theta", pattern.theta, ".cut")
    # GRASP fields are scaled so that |E|^2 is the directivity 4 pi |rE|^2/(2 Z0)/P.
    scale = math.sqrt(4 * math.pi / (2 * FREE_SPACE * pattern.about["radiated_power"]))
    for j, phi in enumerate(pattern.phi):
        yield f"polywigner, {pattern.about['frequency']:.12g} Hz, phi = {phi:.9g} deg"
        yield f"{pattern.theta[0]:.9g} {step:.9g} {len(pattern.theta)} {phi:.9g} 1 1 2"
        yield from _field_lines(*(scale * component[:, j] for component in pattern.components))


def _field_lines(first: Complex, second: Complex) -> Lines:
    """Yield a line with real and imaginary parts of two field components for each direction."""
    for a, b in zip(first, second, strict=True):
        yield f"{a.real:.9e} {a.imag:.9e} {b.real:.9e} {b.imag:.9e}"


def _msi_lines(pattern: _Pattern) -> Lines:
    """Yield the lines of an MSI file with a horizontal and a vertical cut."""
    peak = pattern.about["peak_directivity"]
    yield "NAME polywigner"
    yield "MAKE polywigner"
    yield f"FREQUENCY {pattern.about['frequency'] / 1e6:.9g}"
    yield f"GAIN {pattern.about['gain']:.3f} dBi"
    yield "TILT ELECTRICAL"
    yield "COMMENT far field of an aperture, y axis up"
    # The angles in a file increase to the right and downwards, as seen from behind the antenna.
    for name, phi in (("HORIZONTAL", 0.0), ("VERTICAL", 90.0)):
        theta, levels = _full_cut(pattern, phi)
        yield f"{name} 360"
        # The angles theta are 0, -1, ..., -179, 180, 179, ..., 1 degrees.
        angles = 180.0 - (np.arange(360) + 180) % 360
        front = np.where(np.abs(angles) > 90, FLOOR, np.interp(angles, theta, levels))
        for degrees, level in enumerate(front):
            yield f"{degrees} {min(peak - level, _MOST_ATTENUATION):.3f}"


def _full_cut(pattern: _Pattern, phi: float) -> tuple[Floats, Floats]:
    """Return theta in degrees, and levels in dBi, of the full meridian at ``phi`` in degrees.

    Raises ArgumentError unless theta extends from -90 to 90 degrees.
    """
    meridians = cuts_of(np.radians(pattern.theta), np.radians(pattern.phi), pattern.directivity)
    for angle, theta, levels in meridians:
        offset = (math.degrees(angle) - phi) % 360.0
        same, opposite = min(offset, 360.0 - offset) < 1e-6, abs(offset - 180.0) < 1e-6
        degrees = np.degrees(theta)
        if (same or opposite) and degrees.min() <= -90 + 1e-6 and degrees.max() >= 90 - 1e-6:
            return (degrees, levels) if same else (-degrees[::-1], levels[::-1])
    raise ArgumentError(
        f"an .msi file requires a cut at phi = {phi:g} degrees with theta from -90 to 90 degrees, "
        f"got phi = {', '.join(f'{a:g}' for a in pattern.phi[:8])} and theta from "
        f"{pattern.theta.min():g} to {pattern.theta.max():g} degrees; add the missing angles to "
        "radiation_pattern"
    )


def _even_step(name: str, angles: Floats, suffix: str) -> float:
    """Return the step of angles in degrees; raise ArgumentError if they are not evenly spaced."""
    steps = np.diff(angles)
    if steps.size and np.ptp(steps) > 1e-6 * abs(angles[-1] - angles[0]):
        raise ArgumentError(
            f"a {suffix} file requires evenly spaced {name}, got steps from {steps.min():g} to "
            f"{steps.max():g} degrees"
        )
    return float((angles[-1] - angles[0]) / max(1, steps.size))
