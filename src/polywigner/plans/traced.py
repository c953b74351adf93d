"""Choices for Dr.Jit arrays and for Mitsuba, whose calls are traced into a caller's kernels.

No `Request` is counted there: a kernel is traced before anybody knows how often it will run.
"""

from __future__ import annotations

from polywigner.plans.costs import LIMITS

__all__ = [
    "compiles_outline",
    "exposes_numbers",
    "is_recorded",
    "shifts_samples",
    "sorts_samples",
    "unrolls_cuts",
    "unrolls_steps",
    "unrolls_terms",
]


def compiles_outline(samples: int) -> bool:
    """Whether an outline with derivatives is better code of a kernel than data for it."""
    return samples >= LIMITS["least samples for an outline as code"]


def is_recorded(samples: int) -> bool:
    """Whether a kernel for so few samples is recorded once, and launched without tracing it."""
    return samples <= LIMITS["most samples of a recording"]


def unrolls_terms(terms: int) -> bool:
    """Whether a sum of so many short terms is code, and not a loop over a table."""
    return terms <= LIMITS["most terms as code"]


def unrolls_cuts(cuts: int) -> bool:
    """Whether a sum of whole transforms, of so many cuts in all, is code."""
    return cuts <= LIMITS["most cuts of a sum as code"]


def unrolls_steps(steps: int) -> bool:
    """Whether a recursion of so many steps is code."""
    return steps <= LIMITS["most steps as code"]


def sorts_samples(samples: int) -> bool:
    """Whether so many Dr.Jit samples are sorted by cell."""
    return samples >= LIMITS["least samples sorted by cell"]


def exposes_numbers(cuts: int) -> bool:
    """Whether a scene's source has its vertices and weights as parameters with derivatives."""
    return cuts <= LIMITS["most cuts with derivatives in a scene"]


def shifts_samples(elements: int) -> bool:
    """Whether samples of a row of a lattice stand for several midpoints of elements."""
    return elements >= LIMITS["least elements of a row for shifted samples"]
