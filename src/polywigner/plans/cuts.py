"""Choices where no plan of a whole call is made: in renderings, on Dr.Jit arrays, for arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

from polywigner.plans.costs import COSTS, LIMITS


def sums_over_lattice(elements: int) -> bool:
    """Whether W and A of so many elements on a lattice are sums over its midpoints or steps."""
    return elements >= LIMITS["least elements of a lattice"]


def sums_over_places(elements: int) -> bool:
    """Whether W and A of so many equal elements anywhere are sums over lists of pairs."""
    return elements >= LIMITS["least elements in lists of pairs"]


def tabulates_products(weights: int, factors: int | None) -> bool:
    """Whether sums of products of so many weights are looked up in a table.

    ``factors`` : amplitudes in all of the row and the column that the weights are a product of;
    None where they are none.
    """
    if factors is not None and factors <= LIMITS["most amplitudes of factors"]:
        return False
    return weights >= LIMITS["least weights in a table"]


def has_own_factor(sites: int) -> bool:
    """Whether the array factor of so many sites is found by rows and columns."""
    return sites >= LIMITS["least sites of an array factor by rows"]


forced_cut: ContextVar[str | None] = ContextVar("forced_cut", default=None)
"""How edges are to be cut whatever it costs; None where plans are free."""


@contextmanager
def forced(cut: str) -> Iterator[None]:
    """For tests and benchmarks: edges are cut in one way, wherever that is possible.

    ``"edges"`` is code or rows, by their number; the others are those of :func:`cut_for`.
    """
    token = forced_cut.set(cut)
    try:
        yield
    finally:
        forced_cut.reset(token)


def cut_for(target: str, cuts: int, by_pairs: bool, samples: int = 0) -> str:
    """``"code"``, each edge by itself; ``"rows"``, of a table; or lists of ``"pairs"``.

    Parameters
    ----------
    target : ``"numpy"``, ``"scalar"``, ``"compiled"``; ``"derivatives"``: of a compiled kernel, in
        points. ``"data"``: edges that are never code; ``"code"``: that are nothing else.
    cuts : of all edges by all sides; ``by_pairs``: whether lists of pairs are possible.
    samples : of NumPy, computed at a time; for ``"derivatives"``, all.
    """
    if target == "code":
        return "code"
    wanted = forced_cut.get()
    if wanted == "edges":
        by_pairs = False
    elif wanted in ("code", "rows", "pairs"):
        return wanted if by_pairs or wanted != "pairs" else "rows"
    if target == "data":
        return "pairs" if by_pairs else "rows"
    least = LIMITS[f"least cuts by pairs, {target}"]
    if target == "derivatives" and samples <= LIMITS["most samples with derivatives as data"]:
        least = 0
    if by_pairs and cuts > least:
        return "pairs"
    if target == "scalar":
        return "code"
    if target == "numpy":
        few = samples <= LIMITS["most samples as rows, NumPy"]
        return "rows" if few and cuts > LIMITS["least cuts as rows, NumPy"] else "code"
    return "rows" if loops_over_edges(cuts) else "code"


def waves_fit_code(pairs: int) -> bool:
    """Whether a kernel that looks up pairs of edges may have code for so many pairs of waves."""
    return pairs <= LIMITS["most pairs of waves as code"]


def loops_over_edges(cuts: int) -> bool:
    """Whether a compiled kernel is better a loop over a table of edges than code for each."""
    return cuts > LIMITS["most cuts as code"]


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
