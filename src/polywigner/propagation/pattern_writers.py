"""Radiation patterns written to files of antenna and planning tools."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.arguments import checked_choice, checked_path, write_lines
from polywigner.propagation.beams import checked_efficiency
from polywigner.propagation.far_field_tables import FLOOR, FREE_SPACE
from polywigner.propagation.patterns import checked_pattern, cuts_of
from polywigner.propagation.vector_fields import axial_ratios, of_co_and_cross
from polywigner.source.polarisation import checked_polarisation

if TYPE_CHECKING:
    import xarray


Polarisation = Literal["x", "y"]

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
    if "cross_field" not in pattern:
        name = "y" if polarisation is None else polarisation
        return checked_polarisation(checked_choice(name, "polarisation", ("x", "y")))
    if polarisation is not None:
        raise ArgumentError(
            f"expected no polarisation for a pattern that has its own, got {polarisation!r}; leave "
            "it out"
        )
    return np.asarray(pattern.attrs["polarisation"]).view(np.complex128)


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
    scale, sine, cosine = math.sqrt(2 * FREE_SPACE), np.sin(phi), np.cos(phi)
    return _Pattern(
        np.degrees(theta),
        np.degrees(phi),
        np.maximum(directivity, FLOOR),
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
    levels = [np.maximum(np.nan_to_num(level, nan=FLOOR), FLOOR) for level in levels]
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
    scale = math.sqrt(4 * math.pi / (2 * FREE_SPACE * pattern.radiated_power))
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
            level = FLOOR if behind else float(np.interp(angle, theta, levels))
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
