"""Numbers that a data sheet gives of a radiation pattern: gain, EIRP, beamwidths, sidelobes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry.arguments import checked_number, warn_caller
from polywigner.propagation.patterns import (
    angle_between,
    checked_pattern,
    cuts_of,
    front_of,
)

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

Levels = NDArray[np.float64]


@dataclass(frozen=True)
class CutMetrics:
    """The main beam and the first sidelobes along one meridian, both sides of the normal.

    >>> import polywigner as pw
    >>> pattern = pw.radiation_pattern(pw.shapes.square(10e-3), 3.2e-3, [-0.1, 0.0, 0.1], 0.0)
    >>> pw.beam_metrics(pattern).cuts[0].phi
    0.0
    """

    phi: float
    """The meridian of theta > 0, in rad."""
    theta: float
    """Angle of the cut's peak in rad; negative on the other side of the normal."""
    directivity: float
    """Directivity of the cut's peak in dBi; minus infinity where the cut has no radiation."""
    half_power_beamwidth: float
    """In rad, between the directions of half the cut's peak; NaN where the cut ends before."""
    sidelobe_levels: tuple[float, float]
    """First maxima beyond half power towards smaller and larger theta, in dB of the cut's peak."""
    sidelobe_angles: tuple[float, float]
    """Their theta, in rad."""


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
    """In W, through the hemisphere in front."""
    eirp: float | None
    """Radiated power times directivity in W; None without a power."""
    front_share: float
    """Radiated power over int |u|^2; NaN for a pattern of a file, or of elements with one."""
    cuts: tuple[CutMetrics, ...]
    """One for each meridian of the pattern."""
    axial_ratio: float | None = None
    """Axial ratio of the beam in dB, infinite for a linear one; None for a scalar pattern."""
    cross_polar_discrimination: float | None = None
    """Co- over cross-polar part of the beam in dB; None for a scalar pattern."""

    def __str__(self) -> str:
        rows = [("directivity", f"{self.directivity:.2f} dBi"), ("gain", f"{self.gain:.2f} dBi")]
        of_field = ", of the field as it is" if self.eirp is None else ""
        if self.eirp is not None:
            level = 10 * math.log10(self.eirp) + 30 if self.eirp > 0 else -math.inf
            rows.append(("EIRP", f"{level:.2f} dBm ({self.eirp:.4g} W)"))
        rows += [
            ("radiated power", f"{self.radiated_power:.4g} W{of_field}"),
            ("beam direction", f"theta {_degrees(self.theta)}, phi {_degrees(self.phi)}"),
        ]
        if not math.isnan(self.front_share):
            rows.insert(-1, ("front share", f"{100 * self.front_share:.1f} % of int |u|^2"))
        rows += [
            (name, f"{level:.2f} dB" if level < _LINEAR else f"over {_LINEAR} dB")
            for name, level in (
                ("axial ratio", self.axial_ratio),
                ("co/cross ratio", self.cross_polar_discrimination),
            )
            if level is not None
        ]
        for cut in self.principal_cuts:
            lobes = ", ".join(
                f"{level:.1f} dB at {math.degrees(angle):.1f}°"
                for level, angle in zip(cut.sidelobe_levels, cut.sidelobe_angles, strict=True)
                if not math.isnan(level)
            )
            width = cut.half_power_beamwidth
            shown = "not in range" if math.isnan(width) else _degrees(width)
            name = f"cut phi {_degrees(cut.phi)}"
            if cut.directivity == -math.inf:
                rows.append((name, "nothing is radiated"))
                continue
            rows.append((name, f"peak {cut.directivity:.2f} dBi, half-power width {shown}"))
            rows.append(("", f"sidelobes {lobes or 'not in range'}"))
        return "\n".join(f"{name:18}{value}".rstrip() for name, value in rows)

    @property
    def principal_cuts(self) -> tuple[CutMetrics, ...]:
        """The cuts next to the x axis, to the y axis and to the beam, each once."""
        wanted = (0.0, math.pi / 2, *((self.phi,) if abs(self.theta) > _SAME_ANGLE else ()))
        return tuple(dict.fromkeys(_nearest_cut(self, angle) for angle in wanted))


def _nearest_cut(metrics: BeamMetrics, phi: float) -> CutMetrics:
    return min(metrics.cuts, key=lambda cut: angle_between(cut.phi, phi))


def is_off_planes(metrics: BeamMetrics) -> bool:
    """Whether a cut goes through the beam, and neither of those next to the x and y axes does."""
    principal = [_nearest_cut(metrics, angle).directivity for angle in (0.0, math.pi / 2)]
    best = max(cut.directivity for cut in metrics.cuts)
    return max(principal) < metrics.directivity - _MISSED <= best


def beam_metrics(
    pattern: xarray.Dataset, *, power: float | None = None, efficiency: float = 1.0
) -> BeamMetrics:
    """Directivity, gain, EIRP, beam direction, half-power beamwidths and first sidelobes.

    Directivity, gain, EIRP and direction are those of the beam, wherever it points. Beamwidths and
    sidelobes are those of cuts along meridians: columns of the pattern where theta has both signs,
    else those of phi and phi + pi joined, up to the horizon. Between samples of a cut they follow
    parabolas: beamwidths are right to 3e-3 of themselves for ten samples in them.

    Parameters
    ----------
    pattern : what :func:`radiation_pattern` returned.
    power : accepted by the antenna, in W; None: the radiated power is that of the field as it is,
        and there is no EIRP.
    efficiency : radiated over accepted power, above 0 and up to 1: losses that the field does not
        know.

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
    theta, phi, levels, about = checked_pattern(pattern)
    theta, levels = front_of(theta, levels)
    if len(theta) < 3:
        raise ArgumentError(
            "expected three or more angles theta in front for a beamwidth, got "
            f"{len(theta)}; use some ten within the main beam"
        )
    levels = np.maximum(levels, _DARK)
    share = checked_efficiency(efficiency)
    radiated = about["radiated_power"] if power is None else share * _positive("power", power)
    peak = float(levels.max())
    cuts = tuple(
        _metrics(angle, places, values, peak)
        for angle, places, values in cuts_of(theta, phi, levels)
    )
    best = max(cuts, key=lambda cut: cut.directivity)
    directivity = about["peak_directivity"]
    step = float(np.diff(np.unique(theta)).max(initial=0.0))
    if best.half_power_beamwidth < _LEAST_SAMPLES * step:
        warn_caller(
            f"steps of {_degrees(step)} are coarse for a half-power width of "
            f"{_degrees(best.half_power_beamwidth)}: the numbers may be off by percents; give "
            "radiation_pattern more angles theta"
        )
    if directivity > best.directivity + _MISSED:
        warn_caller(
            f"the cuts of the pattern miss the beam of {directivity:.2f} dBi at theta "
            f"{_degrees(about['peak_theta'])}, phi {_degrees(about['peak_phi'])}: the largest on "
            f"them is {best.directivity:.2f} dBi; give radiation_pattern more angles, that phi "
            "among them"
        )
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
    )


def _metrics(phi: float, theta: Levels, levels: Levels, beam: float) -> CutMetrics:
    peak = int(np.argmax(levels))
    angle, level = _vertex(theta, levels, peak)
    if level < beam - _NOTHING:
        none = math.nan, math.nan
        return CutMetrics(phi, angle, -math.inf, math.nan, none, none)
    sides = [_side(theta, levels, peak, step, level) for step in (-1, 1)]
    return CutMetrics(
        phi=phi,
        theta=angle,
        directivity=level,
        half_power_beamwidth=sides[1][0] - sides[0][0],
        sidelobe_levels=(sides[0][1] - level, sides[1][1] - level),
        sidelobe_angles=(sides[0][2], sides[1][2]),
    )


def _side(
    theta: Levels, levels: Levels, peak: int, step: int, level: float
) -> tuple[float, float, float]:
    """(theta of half power, level and theta of the first sidelobe) on one side of a peak."""
    along, places = levels[peak::step], theta[peak::step]
    below = np.flatnonzero(along < level - _HALF)
    if not below.size:
        return math.nan, math.nan, math.nan
    flank = int(below[0])  # maxima before it are ripples of the beam
    half = _crossing(along, places, flank, level - _HALF)
    rising = np.flatnonzero(np.diff(along[flank:]) > 0)
    if not rising.size:
        return half, math.nan, math.nan
    null = flank + int(rising[0])
    falling = np.flatnonzero(np.diff(along[null:]) < 0)
    if not falling.size:
        return half, math.nan, math.nan
    lobe_angle, lobe = _vertex(places, along, null + int(falling[0]))
    return half, lobe, lobe_angle


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
