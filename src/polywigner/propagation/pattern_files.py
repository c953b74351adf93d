"""Radiation patterns as files that antenna people load, and read from them."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError, PolywignerError
from polywigner.geometry.arguments import checked_path, write_lines
from polywigner.geometry.io.limits import (
    LARGEST_NUMBER,
    LONGEST_LINE,
    bytes_of,
    check_most,
    text_of,
    token,
)
from polywigner.illumination.polarisation import checked_polarisation
from polywigner.propagation.beams import checked_efficiency
from polywigner.propagation.element_patterns import ElementPattern
from polywigner.propagation.patterns import checked_pattern, cuts_of, jones_of, vector_dataset
from polywigner.propagation.places import angle_axes
from polywigner.propagation.vector_fields import axial_ratios, of_co_and_cross
from polywigner.quantities import SPEED_OF_LIGHT

if TYPE_CHECKING:
    import xarray


Polarisation = Literal["x", "y"]

# Impedance Z0 of free space in ohm: |E|^2/(2 Z0) of the peak value of E is power per area.
_FREE_SPACE = 376.730313412
# The number that stands for minus infinity, in dBi.
_FLOOR = -300.0
# Largest attenuation in dB below the peak, as planning tools have it.
_MOST_ATTENUATION = 99.9
# Axial ratio in dB that stands for infinity, as of a linear polarisation.
_AXIAL_RATIO = 40.0

Table = NDArray[np.float64]
Lines = Iterator[str]


@dataclass(frozen=True)
class _Pattern:
    """The values written: angles in degrees, levels in dBi, fields in V, Hz and W."""

    theta: Table
    phi: Table
    directivity: Table
    components: tuple[NDArray[np.complex128], NDArray[np.complex128]]
    """E_theta and E_phi (n, m), with their phases."""
    frequency: float
    radiated_power: float
    peak: float
    efficiency: float


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
    if isinstance(pattern, (str, os.PathLike)):
        warnings.warn(
            "write_pattern takes (pattern, path) now; (path, pattern) will end with version 1.0",
            DeprecationWarning,
            stacklevel=2,
        )
        pattern, path = cast(Any, path), cast(Any, pattern)
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


def _jones(pattern: Any, polarisation: Any) -> NDArray[np.complex128]:
    """The Jones vector (2,) of the co-polar part."""
    own = "cross_field" in pattern
    if own and polarisation is not None:
        raise ArgumentError(
            f"expected no polarisation for a pattern that has its own, got {polarisation!r}; leave "
            "it out"
        )
    is_named = isinstance(polarisation, str) and polarisation in ("x", "y")
    if not (own or is_named or polarisation is None):
        raise ArgumentError(
            f'expected polarisation to be "x" or "y" for a scalar pattern, got {polarisation!r}; '
            "give others to radiation_pattern"
        )
    parts = pattern.attrs["polarisation"] if own else checked_polarisation(polarisation or "y")
    return np.asarray(parts).view(np.complex128)


def _checked(pattern: Any, polarisation: Any, efficiency: float) -> _Pattern:
    theta, phi, directivity, about = checked_pattern(pattern)
    ascending = np.ix_(np.argsort(theta, kind="stable"), np.argsort(phi, kind="stable"))
    try:
        co, cross = (
            np.asarray(pattern[name].transpose("theta", "phi").values, np.complex128)[ascending]
            for name in ("field", "cross_field" if "cross_field" in pattern else "field")
        )
    except (TypeError, KeyError, AttributeError, ValueError):
        raise ArgumentError(
            "expected a pattern with directivity and field over theta and phi, got one without a "
            "field; use what polywigner.radiation_pattern returned"
        ) from None
    if "cross_field" not in pattern:
        cross = np.zeros_like(co)
    theta, phi, directivity = np.sort(theta), np.sort(phi), directivity[ascending]
    x, y = of_co_and_cross(co, cross, _jones(pattern, polarisation))
    scale, sine, cosine = math.sqrt(2 * _FREE_SPACE), np.sin(phi), np.cos(phi)
    return _Pattern(
        np.degrees(theta),
        np.degrees(phi),
        np.maximum(directivity, _FLOOR),
        (scale * (x * cosine + y * sine).conj(), scale * (y * cosine - x * sine).conj()),
        about["frequency"],
        about["radiated_power"],
        about["peak_directivity"],
        checked_efficiency(efficiency),
    )


def _csv(pattern: _Pattern) -> Lines:
    names = [f"{part}(rE{name}) [V]" for name in ("Theta", "Phi") for part in ("re", "im")]
    yield ",".join(["Phi [deg]", "Theta [deg]", "dB(DirTotal)", *names])
    for j, phi in enumerate(pattern.phi):
        for i, theta in enumerate(pattern.theta):
            a, b = (component[i, j] for component in pattern.components)
            row = (phi, theta, pattern.directivity[i, j], a.real, a.imag, b.real, b.imag)
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
    levels = [np.maximum(np.nan_to_num(level, nan=_FLOOR), _FLOOR) for level in levels]
    phases = [np.degrees(np.angle(component)) % 360 for component in pattern.components]
    ratios = np.minimum(np.nan_to_num(axial_ratios(pattern.components), nan=np.inf), _AXIAL_RATIO)
    columns = [pattern.directivity, levels[0], phases[0], levels[1], phases[1], ratios]
    for j, phi in enumerate(pattern.phi):
        for i, theta in enumerate(pattern.theta):
            row = [theta, phi, *(column[i, j] for column in columns)]
            yield " ".join(f"{value:14.6f}" for value in row)


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
    yield f"Frequency {pattern.frequency:.12g}"
    for a, b in zip(*(component.ravel() for component in pattern.components), strict=True):
        yield f"{a.real:.9e} {a.imag:.9e} {b.real:.9e} {b.imag:.9e}"


def _grasp(pattern: _Pattern) -> Lines:
    step = _step("theta", pattern.theta, ".cut")
    # rE in V, 4 pi |rE|^2/(2 Z0)/P is the directivity
    scale = math.sqrt(4 * math.pi / (2 * _FREE_SPACE * pattern.radiated_power))
    for j, phi in enumerate(pattern.phi):
        yield f"polywigner, {pattern.frequency:.12g} Hz, phi = {phi:.9g} deg"
        yield f"{pattern.theta[0]:.9g} {step:.9g} {len(pattern.theta)} {phi:.9g} 1 1 2"
        columns = (scale * component[:, j] for component in pattern.components)
        for a, b in zip(*columns, strict=True):
            yield f"{a.real:.9e} {a.imag:.9e} {b.real:.9e} {b.imag:.9e}"


def _msi(pattern: _Pattern) -> Lines:
    peak = pattern.peak
    yield "NAME polywigner"
    yield "MAKE polywigner"
    yield f"FREQUENCY {pattern.frequency / 1e6:.9g}"
    yield f"GAIN {peak + 10 * math.log10(pattern.efficiency):.3f} dBi"
    yield "TILT ELECTRICAL"
    yield "COMMENT far field of an aperture, y axis up"
    # Seen from behind, with y up, x points to the left: angles run to the right and downwards.
    for name, phi in (("HORIZONTAL", 0.0), ("VERTICAL", 90.0)):
        theta, levels = _whole_cut(pattern, phi)
        yield f"{name} 360"
        for degrees in range(360):
            angle = -float(degrees if degrees <= 180 else degrees - 360)
            behind = abs(angle) > 90
            level = _FLOOR if behind else float(np.interp(angle, theta, levels))
            yield f"{degrees} {min(peak - level, _MOST_ATTENUATION):.3f}"


def _whole_cut(pattern: _Pattern, phi: float) -> tuple[Table, Table]:
    """Theta in degrees from -90 or less to 90 or more, and levels in dBi, of a meridian."""
    found = cuts_of(np.radians(pattern.theta), np.radians(pattern.phi), pattern.directivity)
    for angle, theta, levels in found:
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


def _step(name: str, angles: Table, suffix: str) -> float:
    """The step of angles in degrees; ArgumentError where they are not evenly spaced."""
    steps = np.diff(angles)
    if steps.size and np.ptp(steps) > 1e-6 * abs(angles[-1] - angles[0]):
        raise ArgumentError(
            f"expected evenly spaced {name} for a {suffix} file, got steps from {steps.min():g} "
            f"to {steps.max():g} degrees"
        )
    return float((angles[-1] - angles[0]) / max(1, steps.size))


# Directions of a file.
_MOST_DIRECTIONS = 2_000_000
_LARGEST_LEVEL = 1000.0
_Columns = tuple[Table, Table, Table, Table, float]
"""Theta and phi (n,) in degrees, E_theta and E_phi (n,) as in the file, and the frequency in Hz."""


def read_pattern(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Read a far field over the front or the whole sphere from a file of a simulator.

    The formats are those of :func:`write_pattern` with both components and their phases: ``.csv``
    with columns Theta, Phi, re and im of rETheta and rEPhi, as HFSS exports reports; ``.txt``, the
    far-field table of CST, with Abs and Phase of Theta and Phi; ``.ffd`` of HFSS, of one frequency.

    Parameters
    ----------
    path : the suffix tells the format. Angles are evenly spaced, theta from 0 to 90 or to 180
        degrees, phi around the whole turn; theta to 90 where nothing goes backwards.

    Returns
    -------
    xarray.Dataset as :func:`radiation_pattern` returns of a polarised source, with its sign of
    time. The radiated power is the integral of the field over all directions, and the beam the
    largest sample. Of files in dBi fields are those of a radiated power near 1 W. The aperture
    power is NaN, as are frequency and wavelength where the file has none (.csv and .txt).

    Raises
    ------
    FileFormatError for a file that is missing, over 64 MiB, of another format, or damaged, and for
    angles that do not cover the front, fields that are not finite, and zeros only; ArgumentError
    for no path.

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
    file = checked_path(path)
    readers = {".csv": _from_csv, ".txt": _from_cst, ".ffd": _from_ffd}
    try:
        if file.suffix.lower() not in readers:
            raise FileFormatError(
                f"expected a pattern file with the suffix {', '.join(readers)}, got "
                f"{file.suffix or 'none'!r}"
            )
        lines = _lines_of(file)
        return _dataset(*_on_grid(readers[file.suffix.lower()](lines)))
    except PolywignerError as error:
        raise FileFormatError(f"{file}: {error}") from None


def _lines_of(file: Path) -> list[str]:
    lines = text_of(bytes_of(file)).splitlines()
    check_most(len(lines), _MOST_DIRECTIONS + 10, "lines", "export coarser steps")
    for number, line in enumerate(lines, start=1):
        if len(line) > LONGEST_LINE:
            raise FileFormatError(
                f"expected lines of at most {LONGEST_LINE} characters, got more in line {number}"
            )
    return lines


def _numbers(lines: list[str], first: int, columns: int, separator: str | None = None) -> Table:
    """Numbers (n, columns) of lines from one, by its number, on; blank lines are left out."""
    rows = []
    for number, line in enumerate(lines[first - 1 :], start=first):
        fields = line.split(separator)
        if not line.strip():
            continue
        try:
            rows.append([float(field) for field in fields])
        except ValueError:
            rows.append([])
        if len(rows[-1]) != columns:
            raise FileFormatError(
                f"expected {columns} numbers, got {token(line.strip())} in line {number}"
            )
    if not rows:
        raise FileFormatError("expected a line for each direction, got none")
    table = np.array(rows)
    if not (np.abs(table) <= LARGEST_NUMBER).all():  # also for a NaN
        raise FileFormatError(f"expected finite numbers up to {LARGEST_NUMBER:g}, got others")
    return table


def _from_csv(lines: list[str]) -> _Columns:
    names = [name.split("[")[0].strip().strip('"').lower() for name in lines[0].split(",")]
    wanted = ["theta", "phi", "re(retheta)", "im(retheta)", "re(rephi)", "im(rephi)"]
    if not set(wanted) <= set(names):
        missing = [name for name in wanted if name not in names]
        raise FileFormatError(
            f"expected the columns {', '.join(wanted)} in line 1, got none for {missing[0]}"
        )
    table = _numbers(lines, 2, len(names), ",")
    theta, phi, a, b, c, d = (table[:, names.index(name)] for name in wanted)
    return theta, phi, a + 1j * b, c + 1j * d, math.nan


def _from_cst(lines: list[str]) -> _Columns:
    head = lines[0].lower()
    if not all(name in head for name in ("theta", "phi", "abs(theta)", "phase(theta)")):
        raise FileFormatError(
            "expected the columns Theta, Phi, Abs, Abs(Theta), Phase(Theta), Abs(Phi), Phase(Phi) "
            "and Ax.Ratio of CST in line 1, got others"
        )
    table = _numbers(lines, 3, 8)
    parts = []
    for absolute, phase in (table[:, 3:5].T, table[:, 5:7].T):
        # dBi of 1 W: 4 pi |rE|^2/(2 Z0) = D
        size = absolute
        if "db" in head.partition("abs(theta)")[2].partition("phase")[0]:
            if absolute.max() > _LARGEST_LEVEL:
                raise FileFormatError(
                    f"expected levels up to {_LARGEST_LEVEL:g} dB, got {absolute.max():g}"
                )
            size = 10 ** (absolute / 20) * math.sqrt(2 * _FREE_SPACE / (4 * math.pi))
            size = np.where(absolute <= _FLOOR, 0.0, size)
        parts.append(size * np.exp(1j * np.radians(phase)))
    return table[:, 0], table[:, 1], parts[0], parts[1], math.nan


def _from_ffd(lines: list[str]) -> _Columns:
    axes = []
    for number in (1, 2):
        values = _numbers(lines[:number], number, 3)[0]
        count = values[2]
        if not (1 <= count <= _MOST_DIRECTIONS and count == int(count)):
            raise FileFormatError(f"expected a number of angles in line {number}, got {count:g}")
        axes.append(np.linspace(values[0], values[1], int(count)))
    words = [line.split() for line in lines[2:4]]
    if [word[:1] for word in words] != [["Frequencies"], ["Frequency"]] or words[0][1:] != ["1"]:
        raise FileFormatError(
            "expected one frequency, Frequencies 1 and Frequency, in lines 3 and 4, got others; "
            "export one"
        )
    frequency = float(_numbers([" ".join(words[1][1:])], 1, 1)[0, 0])
    if not frequency > 0:
        raise FileFormatError(f"expected a frequency above zero in line 4, got {frequency:g}")
    table = _numbers(lines, 5, 4)
    check_most(len(axes[0]) * len(axes[1]), _MOST_DIRECTIONS, "directions", "export fewer")
    theta, phi = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    if len(theta) != len(table):
        raise FileFormatError(f"expected {len(theta)} directions, got {len(table)}")
    a, b, c, d = table.T
    return theta, phi, a + 1j * b, c + 1j * d, frequency


def _on_grid(columns: _Columns) -> tuple[Table, Table, Any, float]:
    """Theta (n,) and phi (m,) in rad, both components (2, n, m), and the frequency."""
    theta, phi, *components, frequency = columns
    rows, row = np.unique(theta.round(6), return_inverse=True)
    turns, column = np.unique(phi.round(6), return_inverse=True)
    check_most(len(rows) * len(turns), _MOST_DIRECTIONS, "directions", "export a grid of angles")
    seen = np.zeros((len(rows), len(turns)), int)
    np.add.at(seen, (row, column), 1)
    if not (seen == 1).all():
        raise FileFormatError(
            f"expected each of {len(rows)} angles theta and {len(turns)} angles phi with each "
            f"other once, got {len(theta)} directions"
        )
    fields = np.empty((2, len(rows), len(turns)), np.complex128)
    for part, values in zip(fields, components, strict=True):
        part[row, column] = values
    if abs(turns[-1] - turns[0] - 360) < 1e-5:  # the first meridian twice
        turns, fields = turns[:-1], fields[:, :, :-1]
    return np.radians(rows), np.radians(turns), fields.conj(), frequency


def _dataset(theta: Table, phi: Table, fields: Any, frequency: float) -> xarray.Dataset:
    """The pattern of components E_theta and E_phi (2, n, m) in V."""
    polar, azimuthal = fields / math.sqrt(2 * _FREE_SPACE)
    element = ElementPattern(theta, phi, (polar, azimuthal))
    power = element.power(0.0)
    with np.errstate(divide="ignore"):
        squares = np.square(np.abs(polar)) + np.square(np.abs(azimuthal))
        levels = 10 * np.log10(4 * math.pi / power * squares)
    sine, cosine = np.sin(phi), np.cos(phi)
    along = polar * cosine - azimuthal * sine, polar * sine + azimuthal * cosine
    peak = np.unravel_index(levels.argmax(), levels.shape)
    about = {
        "wavelength": SPEED_OF_LIGHT / frequency,
        "frequency": frequency,
        "radiated_power": power,
        "aperture_power": math.nan,
        **dict.fromkeys(("largest_directivity", "peak_directivity"), float(levels.max())),
        "peak_theta": float(theta[peak[0]]),
        "peak_phi": float(phi[peak[1]]),
    }
    axes = angle_axes(theta, phi)
    jones = jones_of((along[0][peak], along[1][peak]))
    return vector_dataset(axes, levels, along, jones, about)
