"""Radiation patterns read from files of simulators and planning tools."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.arguments import checked_length, checked_path, warn_caller
from polywigner.geometry.io.limits import bytes_of, check_most, text_of
from polywigner.propagation.element_patterns import ElementPattern, covers_front
from polywigner.propagation.far_field_columns import FREE_SPACE, Complex, Floats
from polywigner.propagation.far_field_files import (
    LOADERS,
    MOST_DIRECTIONS,
    Attenuations,
    FarFieldTable,
    attenuations,
)
from polywigner.propagation.patterns import described, jones_of, vector_dataset
from polywigner.propagation.places import angle_axes
from polywigner.quantities import SPEED_OF_LIGHT

if TYPE_CHECKING:
    import xarray

# Relative difference between a requested frequency and the frequency of a file.
_SAME_FREQUENCY = 1e-3
# Differences in dB between the directivity in a file and the integral over its directions: one that
# rounding explains, and one that missing directions or coarse steps hardly explain.
_SAME_LEVEL, _CONTRADICTION = 0.1, 1.0
# Relative difference of fields that a file has for one direction twice, such as phi = 0 and 360.
_SAME_FIELD = 1e-3
# Cuts with fewer meridians are not integrated over directions.
_LEAST_MERIDIANS = 8
_PLANNING = (".msi", ".pln")


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
        if suffix not in LOADERS and suffix not in _PLANNING:
            raise FileFormatError(
                f"expected a pattern file with the suffix {', '.join([*LOADERS, *_PLANNING])}, got "
                f"{suffix or 'none'!r}"
            )
        lines = _lines_of(file)
        if suffix in _PLANNING:
            return _two_cuts(attenuations(lines))
        return _dataset(_selected(list(LOADERS[suffix](lines)), frequency, tolerance))
    except PolywignerError as error:
        raise FileFormatError(f"{file}: {error}") from None


def _lines_of(file: Path) -> list[str]:
    lines = text_of(bytes_of(file)).splitlines()
    check_most(len(lines), MOST_DIRECTIONS + 10, "lines", "export coarser steps")
    return lines


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
    check_most(len(rows) * len(turns), MOST_DIRECTIONS, "directions", "export a grid of angles")
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


def _two_cuts(cuts: Attenuations) -> xarray.Dataset:
    """The gain of a planning tool at phi = 0 and 90 degrees, over theta from -180 to 180."""
    if not cuts.has_unit:
        warn_caller(
            f"GAIN has no unit: it is taken in dBd, as the format specifies, {cuts.gain:.2f} dBi; "
            "add dBi or dBd"
        )
    # The y axis points up. Seen from behind, x points to the left: angles of the file run to the
    # right and downwards.
    theta = np.where(cuts.angles > 180, 360 - cuts.angles, -cuts.angles)
    levels = cuts.gain - np.stack([cuts.horizontal, cuts.vertical], axis=1)
    back = np.flatnonzero(theta == -180)
    theta = np.append(theta, 180.0 + np.zeros(len(back)))
    levels = np.concatenate([levels, levels[back]])
    order = np.argsort(theta)
    theta, levels, phi = np.radians(theta[order]), levels[order], np.array([0.0, math.pi / 2])
    about = _about(theta, phi, levels, cuts.frequency, math.nan)
    return described(None, angle_axes(theta, phi), {"directivity": levels}, about)
