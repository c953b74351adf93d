"""Data-sheet numbers of a radiation pattern: gain, EIRP, beamwidths, nulls and sidelobes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_length, checked_number, warn_caller
from polywigner.numerics import Floats
from polywigner.propagation.patterns import (
    Cut,
    CutKind,
    angle_between,
    circles_through_beam,
    cuts_in,
)
from polywigner.propagation.point_grids import unit_vectors

if TYPE_CHECKING:
    import xarray


# Level difference [dB] between the peak and half of its power.
_HALF = 10 * math.log10(2.0)
# Finite stand-in for minus infinity [dBi].
_DARK = -400.0
# Largest level difference [dB] between samples for which a parabola is fitted. The fit is
# inaccurate near nulls.
_STEEP = 10.0
# If the peak of a cut is below the beam by more than this level difference [dB], the cut contains
# only rounding errors.
_NOTHING = 150.0
# Polarisation ratio [dB] above which the weaker component is a rounding error.
_LINEAR = 200
# If the peak of every cut is below the beam by more than this level difference [dB], a warning
# reports that all cuts miss the beam.
_MISSED = 0.1
# Number of samples per half-power beamwidth below which the error of the beamwidth is a few
# percent.
_LEAST_SAMPLES = 6
# Angle [rad] below which the beam counts as normal to the aperture.
_SAME_ANGLE = 1e-9
# Smallest squint that is reported [rad], equal to 0.01 degrees.
_SQUINT = 1.7e-4
_NUMBERS = (
    "radiated_power", "aperture_power", "peak_directivity", "peak_theta", "peak_phi",
)  # fmt: skip

_NAN_PAIR = (math.nan, math.nan)


@dataclass(frozen=True)
class CutMetrics:
    """Main beam and sidelobes along a cut, on both sides of the peak of the cut.

    Angles on a meridian are values of theta, which are negative at the opposite azimuth. Angles on
    a great circle through the beam are measured from the beam.

    Examples
    --------
    >>> import polywigner as pw
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, [-0.1, 0.0, 0.1], 0.0)
    >>> pw.beam_metrics(pattern).cuts[0].phi
    0.0
    """

    phi: float
    """Azimuth in rad of the meridian at theta > 0, or of the great circle's tangent at the beam."""
    theta: float
    """Angle of the cut's peak in rad."""
    directivity: float
    """Directivity of the cut's peak in dBi; minus infinity if the cut has no radiation."""
    half_power_beamwidth: float
    """Angle in rad between the half-power directions; NaN if one lies beyond the cut."""
    sidelobe_levels: tuple[float, float]
    """Levels in dB of the first sidelobe on each side, relative to the peak of the cut.

    The first sidelobe is the first maximum beyond the half-power direction. The side of smaller
    angles comes first.
    """
    sidelobe_angles: tuple[float, float]
    """Angles in rad of the first sidelobe on each side."""
    first_nulls: tuple[float, float] = _NAN_PAIR
    """Angles in rad of the first minimum beyond the half-power direction on each side.

    An angle is NaN if the minimum lies beyond the end of the cut.
    """
    peak_sidelobe_level: float = math.nan
    """Largest level in dB beyond the first nulls, relative to the peak of the cut; NaN if there is
    no null."""
    peak_sidelobe_angle: float = math.nan
    """Angle in rad of the highest sidelobe."""
    kind: CutKind = "theta"
    """"theta" for a meridian; "meridian" and "across" for great circles through the beam, or "x"
    and "y" if the beam is near the normal."""


@dataclass(frozen=True)
class BeamMetrics:
    """Data-sheet values of the main beam of a pattern; ``str()`` returns a table.

    Examples
    --------
    >>> import polywigner as pw
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, [-0.1, 0.0, 0.1], 0.0)
    >>> round(pw.beam_metrics(pattern).directivity, 1)
    21.3
    """

    theta: float
    """Angle in rad between the normal and the beam, the direction of largest directivity."""
    phi: float
    """Azimuth of the beam from the x axis in rad; 0 for a beam along the normal."""
    directivity: float
    """Directivity of the beam in dBi: 4 pi |E|^2 divided by the radiated power."""
    gain: float
    """Gain in dBi: directivity times efficiency."""
    radiated_power: float
    """Radiated power in W; NaN for a pattern without a field."""
    eirp: float | None
    """Radiated power times directivity in W; None if no power is specified."""
    radiated_fraction: float
    """Radiated power divided by the integral of |u|^2 over the source.

    NaN if the pattern, or the pattern of its elements, was read from a file.
    """
    cuts: tuple[CutMetrics, ...]
    """Metrics of each meridian of the pattern, or of each great circle of :func:`beam_cuts`."""
    axial_ratio: float | None = None
    """Axial ratio in dB along the beam; None for a scalar pattern.

    The ratio is infinite for linear polarisation.
    """
    cross_polar_discrimination: float | None = None
    """Ratio in dB of the co- to the cross-polar field along the beam; None for a scalar pattern."""
    beam_cuts: tuple[CutMetrics, ...] = ()
    """Metrics of two orthogonal great circles through the beam.

    The tuple is empty if the pattern has too few angles.
    """
    steering: tuple[float, float] | None = None
    """Theta and phi in rad to which the source is steered; None if unknown."""

    def __str__(self) -> str:
        rows = [("directivity", f"{self.directivity:.2f} dBi"), ("gain", f"{self.gain:.2f} dBi")]
        condition = ", for |u|^2 in W/m^2" if self.eirp is None else ""
        if self.eirp is not None:
            level = 10 * math.log10(self.eirp) + 30 if self.eirp > 0 else -math.inf
            rows.append(("EIRP", f"{level:.2f} dBm ({self.eirp:.4g} W)"))
        if not math.isnan(self.radiated_power):
            rows.append(("radiated power", f"{self.radiated_power:.4g} W{condition}"))
        if not math.isnan(self.radiated_fraction):
            rows.append(("radiated part", f"{100 * self.radiated_fraction:.1f} % of int |u|^2"))
        rows.append(("beam direction", _direction(self.theta, self.phi)))
        if self.steering is not None:
            angles = np.array([(self.theta, self.phi), self.steering])
            beam, steered = (unit_vectors(*pair[:, None])[0, 0] for pair in angles)
            squint = 2 * math.asin(min(1.0, float(np.linalg.norm(beam - steered)) / 2))
            if squint > _SQUINT:
                rows.append(("steered to", f"{_direction(*self.steering)}: {_degrees(squint)} off"))
        rows += [
            (name, f"{level:.2f} dB" if level < _LINEAR else f"over {_LINEAR} dB")
            for name, level in (
                ("axial ratio", self.axial_ratio),
                ("co/cross ratio", self.cross_polar_discrimination),
            )
            if level is not None
        ]
        for cut in self.table_cuts:
            rows += _cut_rows(cut)
        return "\n".join(f"{name:18}{value}".rstrip() for name, value in rows)

    @property
    def principal_cuts(self) -> tuple[CutMetrics, ...]:
        """Cuts closest to the x axis, to the y axis and to the beam; duplicates are omitted."""
        azimuths = (0.0, math.pi / 2, *((self.phi,) if abs(self.theta) > _SAME_ANGLE else ()))
        nearest = (min(self.cuts, key=lambda cut: angle_between(cut.phi, phi)) for phi in azimuths)
        return tuple(dict.fromkeys(nearest))

    @property
    def table_cuts(self) -> tuple[CutMetrics, ...]:
        """Cuts of the printed table: great circles through the beam, or the principal cuts."""
        return self.beam_cuts or self.principal_cuts


def _cut_rows(cut: CutMetrics) -> list[tuple[str, str]]:
    """Return the rows of the printed table for one cut, as pairs of name and text."""
    name = "cut across it" if cut.kind == "across" else f"cut phi {_degrees(cut.phi)}"
    if cut.directivity == -math.inf:
        return [(name, "nothing is radiated")]

    def listing(angles: tuple[float, float], levels: tuple[float, float] | None = None) -> str:
        """Return angles in degrees as text, with levels if they are specified; omit NaN angles."""
        texts = [f"{math.degrees(angle):.1f}°" for angle in angles]
        if levels is not None:
            texts = [f"{level:.1f} dB at {t}" for level, t in zip(levels, texts, strict=True)]
        return ", ".join(t for t, a in zip(texts, angles, strict=True) if not math.isnan(a))

    width = cut.half_power_beamwidth
    width_text = "not in range" if math.isnan(width) else _degrees(width)
    lobes = listing(cut.sidelobe_angles, cut.sidelobe_levels)
    rows = [
        (name, f"peak {cut.directivity:.2f} dBi, half-power width {width_text}"),
        ("", f"first nulls {listing(cut.first_nulls) or 'not in range'}"),
        ("", f"first sidelobes {lobes or 'not in range'}"),
    ]
    if not math.isnan(cut.peak_sidelobe_level):
        angle = math.degrees(cut.peak_sidelobe_angle)
        rows.append(("", f"peak sidelobe {cut.peak_sidelobe_level:.1f} dB at {angle:.1f}°"))
    return rows


def beam_metrics(
    pattern: xarray.Dataset, *, power: float | None = None, efficiency: float = 1.0
) -> BeamMetrics:
    """Return directivity, gain, EIRP, beam direction, beamwidths, nulls and sidelobes.

    Directivity, gain, EIRP and direction are values at the peak of the pattern, which may lie
    between the cuts. Half-power beamwidths, first nulls and sidelobes are values along the cuts,
    which end at the horizon:

    - ``cuts`` : the meridians of the pattern, or the great circles of :func:`beam_cuts`. If theta
      is never negative, columns at phi and phi + pi are joined into one meridian.
    - ``beam_cuts`` : two great circles through the beam, as functions of the angle from the beam.
      The cuts are exact for a result of :func:`beam_cuts`, and interpolated for a pattern whose phi
      covers the full circle. For a pattern of single meridians the tuple is empty.

    Values between samples are interpolated by parabolas. With ten samples within the half-power
    beamwidth, the relative error of the beamwidth is below 3e-3.

    Parameters
    ----------
    pattern : xarray.Dataset
        Result of :func:`radiation_pattern`, :func:`beam_cuts` or :func:`read_pattern`.
    power : float, optional
        Power in W that the antenna accepts. By default the radiated power is the integral of |E|^2
        over the hemisphere, and ``eirp`` is None.
    efficiency : float, default 1
        Radiated power divided by accepted power, which accounts for losses. The value must be above
        0 and at most 1.

    Returns
    -------
    BeamMetrics
        Metrics of the beam, with angles in rad, levels in dB and powers in W.

    Raises
    ------
    ArgumentError
        If ``pattern`` is not a pattern over theta and phi with at least three theta angles in
        front of the plane, or if ``power`` or ``efficiency`` is out of range.

    Warns
    -----
    PolywignerWarning
        If fewer than six samples lie within the half-power width, or if the beam exceeds all cuts
        by more than 0.1 dB.

    Examples
    --------
    >>> import numpy as np, polywigner as pw
    >>> theta, phi = np.radians(np.arange(-90, 91)), np.radians([0, 90])
    >>> square = pw.shapes.square(10e-3)
    >>> pattern = pw.radiation_pattern(square, 3.2e-3, theta, phi)
    >>> round(float(np.degrees(pw.beam_metrics(pattern).cuts[0].half_power_beamwidth)), 1)
    16.1
    """
    lines = cuts_in(pattern)
    if len(lines[0].angles) < 3:
        raise ArgumentError(
            "beamwidths require at least three theta angles in front of the plane, got "
            f"{len(lines[0].angles)}; use about ten angles within the main beam"
        )
    about = {name: float(pattern.attrs[name]) for name in _NUMBERS}
    fraction, directivity = checked_efficiency(efficiency), about["peak_directivity"]
    radiated = about["radiated_power"]
    if power is not None:
        radiated = fraction * checked_length(power, "power", meaning="a finite number above 0")
    peak = max(float(line.levels.max()) for line in lines)
    circles = cuts = tuple(cut_metrics(line, peak) for line in lines)
    if lines[0].kind == "theta":
        circles = tuple(cut_metrics(line, directivity) for line in circles_through_beam(pattern))
        _warn_of_samples(cuts, lines, about, bool(circles))
    steered = pattern.attrs.get("steered_theta"), pattern.attrs.get("steered_phi")
    return BeamMetrics(
        theta=about["peak_theta"],
        phi=about["peak_phi"],
        directivity=directivity,
        gain=directivity + 10 * math.log10(fraction),
        radiated_power=radiated,
        eirp=None if power is None else radiated * 10 ** (directivity / 10),
        radiated_fraction=about["radiated_power"] / about["aperture_power"],
        cuts=cuts,
        axial_ratio=pattern.attrs.get("peak_axial_ratio"),
        cross_polar_discrimination=pattern.attrs.get("peak_cross_polar_discrimination"),
        beam_cuts=circles,
        steering=None if None in steered else steered,
    )


def _warn_of_samples(
    cuts: tuple[CutMetrics, ...], lines: list[Cut], about: dict[str, float], has_circles: bool
) -> None:
    """Warn if angle steps are too coarse for the beamwidth, or if no cut passes through the beam.

    If ``has_circles`` is true, the second warning is omitted.
    """
    best = max(cuts, key=lambda cut: cut.directivity)
    step = max(float(np.diff(line.angles).max()) for line in lines)
    if best.half_power_beamwidth < _LEAST_SAMPLES * step:
        warn_caller(
            f"the angular step of {_degrees(step)} is coarse for a half-power beamwidth of "
            f"{_degrees(best.half_power_beamwidth)}: beamwidths may have errors of some percent; "
            "pass more theta angles to radiation_pattern"
        )
    if about["peak_directivity"] > best.directivity + _MISSED and not has_circles:
        warn_caller(
            f"no cut of the pattern passes through the beam of {about['peak_directivity']:.2f} "
            f"dBi at {_direction(about['peak_theta'], about['peak_phi'])}: the largest "
            f"directivity on the cuts is {best.directivity:.2f} dBi; use beam_cuts, or pass more "
            "phi angles to radiation_pattern"
        )


def cut_metrics(cut: Cut, beam: float) -> CutMetrics:
    """Return the metrics of a cut through a pattern with a maximum of ``beam`` dBi.

    If the peak of the cut is more than 150 dB below the beam, the cut is treated as a cut without
    radiation.
    """
    angles, levels = cut.angles, np.maximum(cut.levels, _DARK)
    peak = int(np.argmax(levels)) if cut.kind == "theta" else _nearest_peak(levels, angles)
    angle, level = _vertex(angles, levels, peak)
    if level < beam - _NOTHING:
        return CutMetrics(
            cut.phi, angle, -math.inf, math.nan, _NAN_PAIR, _NAN_PAIR, kind=cut.kind
        )  # fmt: skip
    low, high = (_flank(angles, levels, peak, step, level) for step in (-1, 1))
    strongest = max((low, high), key=lambda side: side.peak_level)
    return CutMetrics(
        phi=cut.phi,
        theta=angle,
        directivity=level,
        half_power_beamwidth=high.half_power - low.half_power,
        sidelobe_levels=(low.level - level, high.level - level),
        sidelobe_angles=(low.angle, high.angle),
        first_nulls=(low.null, high.null),
        peak_sidelobe_level=(
            strongest.peak_level - level if math.isfinite(strongest.peak_level) else math.nan
        ),
        peak_sidelobe_angle=strongest.peak_angle,
        kind=cut.kind,
    )


def _nearest_peak(levels: Floats, angles: Floats) -> int:
    """Return the index of the maximum that is reached uphill from the angle 0."""
    # The search starts at the angle 0, because the largest sample may lie in the back lobe.
    k = int(np.abs(angles).argmin())
    while True:
        neighbours = range(max(0, k - 1), min(len(levels), k + 2))
        higher = max(neighbours, key=lambda n: levels[n])
        if levels[higher] <= levels[k]:
            return k
        k = higher


class _Flank(NamedTuple):
    """One side of a cut through a main beam: angles in rad and levels in dBi."""

    half_power: float = math.nan
    null: float = math.nan
    level: float = math.nan
    """Level of the first sidelobe."""
    angle: float = math.nan
    peak_level: float = -math.inf
    """Level of the highest sidelobe beyond the first null."""
    peak_angle: float = math.nan


def _flank(angles: Floats, levels: Floats, peak: int, step: int, level: float) -> _Flank:
    """Return the half-power angle, null and sidelobes of a cut on one side of its peak.

    ``peak`` and ``level`` are the index and the level of the peak. ``step`` is 1 for the side of
    larger angles, and -1 for the side of smaller angles. Quantities beyond the end of the cut keep
    their defaults.
    """
    levels, angles = levels[peak::step], angles[peak::step]
    below = np.flatnonzero(levels < level - _HALF)
    if not below.size:
        return _Flank()
    flank = int(below[0])  # Maxima above half power are ripples of the beam.
    half = _crossing(levels, angles, flank, level - _HALF)
    rising = np.flatnonzero(np.diff(levels[flank:]) > 0)
    if not rising.size:
        return _Flank(half)
    null = flank + int(rising[0])
    # Near a null, |E|^2 is a parabola, but the level in dB is not.
    scale = levels[null - 1 : null + 2].max()
    null_angle, _ = _vertex(angles, -(10 ** ((levels - scale) / 10)), null)
    peak_angle, peak_level = _vertex(angles, levels, null + int(levels[null:].argmax()))
    falling = np.flatnonzero(np.diff(levels[null:]) < 0)
    if not falling.size:
        return _Flank(half, null_angle, peak_level=peak_level, peak_angle=peak_angle)
    lobe_angle, lobe = _vertex(angles, levels, null + int(falling[0]))
    return _Flank(half, null_angle, lobe, lobe_angle, peak_level, peak_angle)


def _vertex(angles: Floats, levels: Floats, peak: int) -> tuple[float, float]:
    """Return angle and level of the vertex of the parabola through three neighbouring samples.

    At an end of the cut, and next to a level more than 10 dB lower (a null), the sample
    ``peak`` is returned instead.
    """
    angle, level = float(angles[peak]), float(levels[peak])
    near = slice(max(0, peak - 1), peak + 2)
    x, y = angles[near] - angle, levels[near] - level
    if len(np.unique(x)) < 3 or y.min() < -_STEEP:
        return angle, level
    curvature, slope, _ = np.polyfit(x, y, 2).tolist()
    if not curvature < 0:
        return angle, level
    return angle - slope / (2 * curvature), level - slope**2 / (4 * curvature)


def _crossing(levels: Floats, angles: Floats, k: int, level: float) -> float:
    """Return the angle between samples k - 1 and k at which the falling curve reaches ``level``."""
    x, y = (values[max(0, k - 2) :][:3] for values in (angles, levels))
    ends = angles[k - 1 : k + 1]
    if len(x) == 3 and y[0] > y[1] > y[2]:
        angle = float(np.polyfit(y - level, x, 2)[2])
        if ends.min() <= angle <= ends.max():
            return angle
    return float(np.interp(-level, -levels[k - 1 : k + 1], ends))


def checked_efficiency(value: Any) -> float:
    """Return an efficiency above 0 and up to 1; raise ArgumentError for other values."""
    return checked_number(value, "efficiency", "a number above 0 and up to 1", lambda x: 0 < x <= 1)


def _degrees(angle: float) -> str:
    """Return an angle in rad as a text in degrees."""
    return f"{math.degrees(angle):.2f}°"


def _direction(theta: float, phi: float) -> str:
    """Return a direction with angles in rad as a text in degrees."""
    return f"theta {_degrees(theta)}, phi {_degrees(phi)}"
