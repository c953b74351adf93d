"""Numbers that a data sheet gives of a radiation pattern: gain, EIRP, beamwidths, sidelobes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry.arguments import checked_number, warn_caller
from polywigner.propagation.patterns import (
    Cut,
    CutKind,
    angle_between,
    circles_through_beam,
    cuts_in,
)
from polywigner.propagation.places import unit_vectors

if TYPE_CHECKING:
    import xarray


_HALF = 10 * math.log10(2.0)
# Stands for minus infinity, in dBi: parabolas are laid through levels.
_DARK = -400.0
# Steeper than this, in dB from a sample to the next, levels are no parabola: a null is near.
_STEEP = 10.0
# A cut so far below the beam, in dB, holds nothing but rounding.
_NOTHING = 150.0
# Ratios of polarisations beyond are rounding, in dB.
_LINEAR = 200
# A beam so far above all cuts, in dB, is not on them: more than a data sheet's last digit.
_MISSED = 0.1
# With fewer samples within half power, a beamwidth is off by percents.
_LEAST_SAMPLES = 6
# A beam along the normal, to the rounding of degrees.
_SAME_ANGLE = 1e-9
# A beam is off the direction to which it is steered by more than this, in rad: 0.01 degrees.
_SQUINT = 1.7e-4
_NUMBERS = (
    "radiated_power", "aperture_power", "peak_directivity", "peak_theta", "peak_phi",
)  # fmt: skip

Levels = NDArray[np.float64]


_NAN_PAIR = (math.nan, math.nan)


@dataclass(frozen=True)
class CutMetrics:
    """The main beam and the sidelobes along one cut, both sides of its peak.

    Angles are theta on a meridian, negative on the other side of the normal. On a great circle
    through the beam they are angles from the beam.

    >>> import polywigner as pw
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, [-0.1, 0.0, 0.1], 0.0)
    >>> pw.beam_metrics(pattern).cuts[0].phi
    0.0
    """

    phi: float
    """Azimuth in rad of the meridian at theta > 0, or of the tangent of a great circle."""
    theta: float
    """Angle of the cut's peak in rad."""
    directivity: float
    """Directivity of the cut's peak in dBi; minus infinity where the cut has no radiation."""
    half_power_beamwidth: float
    """In rad, between the directions of half the cut's peak; NaN where the cut ends before."""
    sidelobe_levels: tuple[float, float]
    """First maxima beyond half power towards smaller and larger angles, in dB of the cut's peak."""
    sidelobe_angles: tuple[float, float]
    """Their angles, in rad."""
    first_nulls: tuple[float, float] = _NAN_PAIR
    """Angles of the first minima beyond half power, in rad; NaN where the cut ends before."""
    peak_sidelobe_level: float = math.nan
    """Largest level beyond the first nulls, in dB of the cut's peak; NaN without a first null."""
    peak_sidelobe_angle: float = math.nan
    """Its angle, in rad."""
    kind: CutKind = "theta"
    """"theta" for a meridian. Great circles through the beam are its "meridian" and the circle
    "across", or go along "x" and "y" for a beam next to the normal."""


@dataclass(frozen=True)
class BeamMetrics:
    """The main beam of a pattern; ``str()`` is a table.

    >>> import polywigner as pw
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, [-0.1, 0.0, 0.1], 0.0)
    >>> round(pw.beam_metrics(pattern).directivity, 1)
    21.3
    """

    theta: float
    """Angle of the beam, the direction of largest directivity, from the normal in rad."""
    phi: float
    """Angle of the beam from the x axis in rad; 0 for a beam along the normal."""
    directivity: float
    """Directivity of the beam in dBi: 4 pi |E|^2 over the radiated power."""
    gain: float
    """In dBi: the directivity times the efficiency."""
    radiated_power: float
    """In W, through the hemisphere in front; NaN for a pattern without a field."""
    eirp: float | None
    """Radiated power times directivity in W; None without a power."""
    front_share: float
    """Radiated power over int |u|^2; NaN for a pattern of a file, or of elements with one."""
    cuts: tuple[CutMetrics, ...]
    """One for each meridian of the pattern, or for each great circle of :func:`beam_cuts`."""
    axial_ratio: float | None = None
    """Axial ratio of the beam in dB, infinite for a linear one; None for a scalar pattern."""
    cross_polar_discrimination: float | None = None
    """Co- over cross-polar part of the beam in dB; None for a scalar pattern."""
    beam_cuts: tuple[CutMetrics, ...] = ()
    """Two orthogonal great circles through the beam; none if the pattern has too few angles."""
    steering: tuple[float, float] | None = None
    """Theta and phi in rad to which the source is steered; None if not known."""

    def __str__(self) -> str:
        rows = [("directivity", f"{self.directivity:.2f} dBi"), ("gain", f"{self.gain:.2f} dBi")]
        of_field = ", of the field as it is" if self.eirp is None else ""
        if self.eirp is not None:
            level = 10 * math.log10(self.eirp) + 30 if self.eirp > 0 else -math.inf
            rows.append(("EIRP", f"{level:.2f} dBm ({self.eirp:.4g} W)"))
        if not math.isnan(self.radiated_power):
            rows.append(("radiated power", f"{self.radiated_power:.4g} W{of_field}"))
        if not math.isnan(self.front_share):
            rows.append(("front share", f"{100 * self.front_share:.1f} % of int |u|^2"))
        rows.append(("beam direction", _direction(self.theta, self.phi)))
        if self.steering is not None:
            squint = _apart((self.theta, self.phi), self.steering)
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
        """The cuts next to the x axis, to the y axis and to the beam, each once."""
        wanted = (0.0, math.pi / 2, *((self.phi,) if abs(self.theta) > _SAME_ANGLE else ()))
        nearest = (min(self.cuts, key=lambda cut: angle_between(cut.phi, phi)) for phi in wanted)
        return tuple(dict.fromkeys(nearest))

    @property
    def table_cuts(self) -> tuple[CutMetrics, ...]:
        """The cuts of the table: great circles through the beam, or else the principal ones."""
        return self.beam_cuts or self.principal_cuts


def _cut_rows(cut: CutMetrics) -> list[tuple[str, str]]:
    """The rows of a cut in the table."""
    name = "cut across it" if cut.kind == "across" else f"cut phi {_degrees(cut.phi)}"
    if cut.directivity == -math.inf:
        return [(name, "nothing is radiated")]

    def listed(angles: tuple[float, float], levels: tuple[float, float] | None = None) -> str:
        texts = [f"{math.degrees(angle):.1f}°" for angle in angles]
        if levels is not None:
            texts = [f"{level:.1f} dB at {t}" for level, t in zip(levels, texts, strict=True)]
        return ", ".join(t for t, a in zip(texts, angles, strict=True) if not math.isnan(a))

    width = cut.half_power_beamwidth
    shown = "not in range" if math.isnan(width) else _degrees(width)
    lobes = listed(cut.sidelobe_angles, cut.sidelobe_levels)
    rows = [
        (name, f"peak {cut.directivity:.2f} dBi, half-power width {shown}"),
        ("", f"first nulls {listed(cut.first_nulls) or 'not in range'}"),
        ("", f"first sidelobes {lobes or 'not in range'}"),
    ]
    if not math.isnan(cut.peak_sidelobe_level):
        angle = math.degrees(cut.peak_sidelobe_angle)
        rows.append(("", f"peak sidelobe {cut.peak_sidelobe_level:.1f} dB at {angle:.1f}°"))
    return rows


def beam_metrics(
    pattern: xarray.Dataset, *, power: float | None = None, efficiency: float = 1.0
) -> BeamMetrics:
    """Directivity, gain, EIRP, beam direction, half-power beamwidths, nulls and sidelobes.

    Directivity, gain, EIRP and direction describe the beam, wherever it points. Beamwidths, first
    nulls and sidelobes describe cuts up to the horizon:

    - ``cuts`` : the meridians of the pattern, or the great circles of :func:`beam_cuts`. Columns
      with theta of both signs are meridians; others are joined, phi with phi + pi.
    - ``beam_cuts`` : two great circles through the beam, in angles from it. They are exact in the
      result of :func:`beam_cuts`, and interpolated in a pattern over phi around the full circle. A
      pattern of single meridians has none.

    Between samples of a cut they follow parabolas: beamwidths are right to 3e-3 of themselves for
    ten samples in them.

    Parameters
    ----------
    pattern : what :func:`radiation_pattern`, :func:`beam_cuts` or :func:`read_pattern` returned.
    power : accepted by the antenna, in W; None: the radiated power is the integral of |E|^2, and
        there is no EIRP.
    efficiency : radiated over accepted power, above 0 and up to 1, for losses outside the model.

    Returns
    -------
    :class:`BeamMetrics`; angles in rad, levels in dB, powers in W.

    Raises
    ------
    ArgumentError for anything but a pattern over theta and phi with three angles theta or more in
    front, a power or an efficiency out of range.

    Warns
    -----
    PolywignerWarning where fewer than six samples lie within half power of the beam, and where the
    beam is 0.1 dB or more above all cuts.

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
            "expected three or more angles theta in front for a beamwidth, got "
            f"{len(lines[0].angles)}; use some ten within the main beam"
        )
    about = {name: float(pattern.attrs[name]) for name in _NUMBERS}
    share = checked_efficiency(efficiency)
    radiated = about["radiated_power"] if power is None else share * _positive("power", power)
    peak = max(float(line.levels.max()) for line in lines)
    cuts = tuple(cut_metrics(line, peak) for line in lines)
    is_circles = lines[0].kind != "theta"
    circles = (
        cuts
        if is_circles
        else tuple(
            cut_metrics(line, about["peak_directivity"]) for line in circles_through_beam(pattern)
        )
    )
    if not is_circles:
        _warn_of_samples(cuts, lines, about, bool(circles))
    directivity = about["peak_directivity"]
    steered = pattern.attrs.get("steered_theta"), pattern.attrs.get("steered_phi")
    return BeamMetrics(
        theta=about["peak_theta"],
        phi=about["peak_phi"],
        directivity=directivity,
        gain=directivity + 10 * math.log10(share),
        radiated_power=radiated,
        eirp=None if power is None else radiated * 10 ** (directivity / 10),
        front_share=about["radiated_power"] / about["aperture_power"],
        cuts=cuts,
        axial_ratio=pattern.attrs.get("peak_axial_ratio"),
        cross_polar_discrimination=pattern.attrs.get("peak_cross_polar_discrimination"),
        beam_cuts=circles,
        steering=None if None in steered else steered,
    )


def _warn_of_samples(
    cuts: tuple[CutMetrics, ...], lines: list[Cut], about: dict[str, float], has_circles: bool
) -> None:
    """Warn of meridians that are sampled too coarsely, or miss the beam."""
    best = max(cuts, key=lambda cut: cut.directivity)
    step = max(float(np.diff(line.angles).max()) for line in lines)
    if best.half_power_beamwidth < _LEAST_SAMPLES * step:
        warn_caller(
            f"steps of {_degrees(step)} are coarse for a half-power width of "
            f"{_degrees(best.half_power_beamwidth)}: the numbers may be off by percents; give "
            "radiation_pattern more angles theta"
        )
    if about["peak_directivity"] > best.directivity + _MISSED and not has_circles:
        warn_caller(
            f"the cuts of the pattern miss the beam of {about['peak_directivity']:.2f} dBi at "
            f"{_direction(about['peak_theta'], about['peak_phi'])}: the largest on them is "
            f"{best.directivity:.2f} dBi; use beam_cuts, or give radiation_pattern that phi"
        )


def cut_metrics(cut: Cut, beam: float) -> CutMetrics:
    """Return the numbers of a cut of a pattern whose beam has this level in dBi."""
    angles, levels = cut.angles, np.maximum(cut.levels, _DARK)
    peak = int(np.argmax(levels)) if cut.kind == "theta" else _top(levels, angles)
    angle, level = _vertex(angles, levels, peak)
    if level < beam - _NOTHING:
        return CutMetrics(
            cut.phi, angle, -math.inf, math.nan, _NAN_PAIR, _NAN_PAIR, kind=cut.kind
        )  # fmt: skip
    low, high = (_side(angles, levels, peak, step, level) for step in (-1, 1))
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


def _top(levels: Levels, angles: Levels) -> int:
    """The sample at the top of the beam, which a great circle has next to angle 0.

    A lobe behind the plane may be as high.
    """
    k = int(np.abs(angles).argmin())
    while True:
        around = range(max(0, k - 1), min(len(levels), k + 2))
        higher = max(around, key=lambda n: levels[n])
        if levels[higher] <= levels[k]:
            return k
        k = higher


class _Side(NamedTuple):
    """Angles in rad and levels in dBi on one side of a peak; NaN beyond the end of the cut."""

    half_power: float = math.nan
    null: float = math.nan
    level: float = math.nan
    """Level of the first sidelobe."""
    angle: float = math.nan
    peak_level: float = -math.inf
    """Largest level beyond the first null, up to the horizon; minus infinity without a null."""
    peak_angle: float = math.nan


def _side(angles: Levels, levels: Levels, peak: int, step: int, level: float) -> _Side:
    """One side of a peak."""
    along, places = levels[peak::step], angles[peak::step]
    below = np.flatnonzero(along < level - _HALF)
    if not below.size:
        return _Side()
    flank = int(below[0])  # maxima before it are ripples of the beam
    half = _crossing(along, places, flank, level - _HALF)
    rising = np.flatnonzero(np.diff(along[flank:]) > 0)
    if not rising.size:
        return _Side(half)
    null = flank + int(rising[0])
    # |E|^2 is a parabola next to a null
    beside = along[null - 1 : null + 2].max()
    null_angle, _ = _vertex(places, -(10 ** ((along - beside) / 10)), null)
    strongest = null + int(along[null:].argmax())
    peak_angle, peak_level = _vertex(places, along, strongest)
    falling = np.flatnonzero(np.diff(along[null:]) < 0)
    if not falling.size:
        return _Side(half, null_angle, peak_level=peak_level, peak_angle=peak_angle)
    lobe_angle, lobe = _vertex(places, along, null + int(falling[0]))
    return _Side(half, null_angle, lobe, lobe_angle, peak_level, peak_angle)


def _vertex(places: Levels, levels: Levels, peak: int) -> tuple[float, float]:
    """The top of the parabola through a largest sample and its neighbours."""
    place, level = float(places[peak]), float(levels[peak])
    x, y = places[max(0, peak - 1) : peak + 2] - place, levels[max(0, peak - 1) : peak + 2] - level
    if len(x) < 3 or y.min() < -_STEEP or not (x[0] and x[2]):
        return place, level
    left, right = y[0] / x[0], y[2] / x[2]
    curvature = (right - left) / (x[2] - x[0])
    if not curvature < 0:
        return place, level
    slope = left - curvature * x[0]
    return float(place - slope / (2 * curvature)), float(level - slope**2 / (4 * curvature))


def _crossing(levels: Levels, places: Levels, k: int, wanted: float) -> float:
    """Where falling levels pass a value between samples k - 1 and k: an inverse parabola."""
    some = slice(max(0, k - 2), max(0, k - 2) + 3)
    x, y = places[some], levels[some]
    if len(x) == 3 and y[0] > y[1] > y[2]:
        total = 0.0
        for i in range(3):
            others = [j for j in range(3) if j != i]
            total += x[i] * math.prod((wanted - y[j]) / (y[i] - y[j]) for j in others)
        if min(places[k - 1], places[k]) <= total <= max(places[k - 1], places[k]):
            return float(total)
    return float(np.interp(-wanted, -levels[k - 1 : k + 1], places[k - 1 : k + 1]))


def checked_efficiency(value: Any) -> float:
    """A number above 0 and up to 1; ArgumentError for anything else."""
    share = _positive("efficiency", value)
    if share > 1:
        raise ArgumentError(f"expected an efficiency of at most 1, got {value_text(value)}")
    return share


def _positive(name: str, value: Any) -> float:
    number = checked_number(value, name, "a finite number above 0")
    if not number > 0:
        raise ArgumentError(f"expected {name} as a finite number above 0, got {value_text(value)}")
    return number


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.2f}°"


def _direction(theta: float, phi: float) -> str:
    return f"theta {_degrees(theta)}, phi {_degrees(phi)}"


def _apart(one: tuple[float, float], other: tuple[float, float]) -> float:
    """The angle in rad between two directions, each as theta and phi."""
    first, second = (unit_vectors(*np.array(angles)[:, None])[0, 0] for angles in (one, other))
    return 2 * math.asin(min(1.0, float(np.linalg.norm(first - second)) / 2))
