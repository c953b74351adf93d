"""Results of measurements, one line for each case and peer, and their JSON.

``SCHEMA`` increases if a field changes its meaning or is removed; fields may be added.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from benchmarks.timing import median_ratio

__all__ = ["SCHEMA", "Figure", "Line", "absent", "as_rates", "as_times", "line_of"]

SCHEMA = 1


@dataclass(frozen=True)
class Figure:
    """Result in the unit of the line."""

    best: float
    median: float
    error: float | None = None
    """The largest value, in units of ``Line.error_unit``; None without a meaningful value."""


@dataclass(frozen=True)
class Line:
    """Our result and the result of a peer, measured in turns."""

    question: str
    case: str
    precision: str
    """single, double, or - where that says nothing."""
    threads: int
    unit: str
    ours: Figure | None
    peer: str
    theirs: Figure | None
    """None where the peer is not there: ``note`` says why."""
    ratio: float | None
    """How many times better we are, by the best of the rounds; the figures' own if not a time."""
    ratio_median: float | None
    """The median over the rounds."""
    error_unit: str = ""
    target: float | None = None
    """Smallest required ratio."""
    enough: float | None = None
    """Our own rate that does as well, whatever the ratio."""
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Return whether the target is reached or our rate is sufficient; None without a target."""
        if self.target is None or self.ratio is None or self.ratio_median is None:
            return None
        rate = min(self.ours.best, self.ours.median) if self.ours else 0.0
        if self.enough is not None and rate >= self.enough:
            return True
        return min(self.ratio, self.ratio_median) >= self.target

    def as_json(self) -> dict[str, Any]:
        return asdict(self) | {"reached": self.reached}

    @classmethod
    def from_json(cls, result: dict[str, Any]) -> Line:
        """Return a line from :meth:`as_json`; raise ValueError or TypeError otherwise."""
        known = {k: result[k] for k in (f.name for f in fields(cls)) if k in result}
        for side in ("ours", "theirs"):
            known[side] = None if known[side] is None else Figure(**known[side])
        line = cls(**known)
        for value in (line.ratio, line.ratio_median):
            if value is not None and not math.isfinite(value):
                raise ValueError(f"expected finite ratios, got {value} in {line.case}")
        return line


def as_times(times: Sequence[float], scale: float, error: float | None = None) -> Figure:
    """Return seconds of the rounds as a result for which smaller is better."""
    return Figure(min(times) * scale, statistics.median(times) * scale, error)


def as_rates(times: Sequence[float], amount: float, error: float | None = None) -> Figure:
    """Return an amount of work over seconds as a result for which larger is better."""
    return Figure(amount / min(times), amount / statistics.median(times), error)


def line_of(
    labels: dict[str, Any],
    peer: str,
    ours: tuple[Figure, Sequence[float], float],
    theirs: tuple[Figure, Sequence[float], float],
    **more: Any,
) -> Line:
    """Return a line from (result, seconds of the rounds, amount of work) of both."""
    (own, own_times, own_amount), (other, other_times, other_amount) = ours, theirs
    amounts = own_amount / other_amount
    best = min(other_times) / min(own_times) * amounts
    median = median_ratio(other_times, own_times) * amounts
    return Line(
        **labels, ours=own, peer=peer, theirs=other, ratio=best, ratio_median=median, **more
    )


def absent(labels: dict[str, Any], peer: str, reason: str, ours: Figure | None = None) -> Line:
    """Return a line for a peer that is not available."""
    return Line(
        **labels, ours=ours, peer=peer, theirs=None, ratio=None, ratio_median=None, note=reason
    )
