"""Choices for Dr.Jit arrays and for Mitsuba, whose calls are traced into a caller's kernels.

No `Request` is counted there: a kernel is traced before anybody knows how often it will run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from polywigner.plans.costs import COSTS, LIMITS

__all__ = [
    "exposes_numbers",
    "launch_for",
    "shifts_samples",
    "sums_over_points",
    "unrolls_cuts",
    "unrolls_steps",
    "unrolls_terms",
]


def launch_for(samples: int, *, changes: bool, recordable: bool, by_pairs: bool) -> str:
    """The way in which a kernel is launched for so many samples that are Dr.Jit arrays.

    ``"recorded"``: at once, and without tracing
    it again. ``"code"`` and ``"data"``: together with what uses the values; of an outline with
    Dr.Jit's numbers, edges are code of the kernel or data for it.

    Parameters
    ----------
    changes : whether numbers of the source are Dr.Jit arrays.
    recordable : whether a recording is possible, and arguments are evaluated.
    by_pairs : whether edges are looked up in lists of pairs.
    """
    if changes:
        return "code" if samples >= LIMITS["least samples for an outline as code"] else "data"
    if recordable and (by_pairs or samples <= LIMITS["most samples of a recording"]):
        return "recorded"
    return "code"


def unrolls_terms(terms: int) -> bool:
    """Whether a sum of so many short terms is code, and not a loop over a table."""
    return terms <= LIMITS["most terms as code"]


def sums_over_points(counts: Sequence[int], panels: int) -> bool:
    """Whether a sum over a grid of points that radiate takes less time than over panels of edges.

    The points of its shorter side are code.
    """
    seconds = math.prod(counts) * COSTS["point that radiates"].seconds
    is_short = min(counts) <= LIMITS["most points as code"]
    return is_short and seconds <= panels * COSTS["panel of an edge"].seconds


def unrolls_cuts(cuts: int) -> bool:
    """Whether a sum of whole transforms, of so many cuts in all, is code."""
    return cuts <= LIMITS["most cuts of a sum as code"]


def unrolls_steps(steps: int) -> bool:
    """Whether a recursion of so many steps is code."""
    return steps <= LIMITS["most steps as code"]


def exposes_numbers(cuts: int) -> bool:
    """Whether a scene's source has its vertices and weights as parameters with derivatives."""
    return cuts <= LIMITS["most cuts with derivatives in a scene"]


def shifts_samples(elements: int) -> bool:
    """Whether samples of a row of a lattice stand for several midpoints of elements."""
    return elements >= LIMITS["least elements of a row for shifted samples"]
