"""Choices where no plan of a whole call is made: in renderings, on Dr.Jit arrays, for arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial

from polywigner.plans.costs import COSTS, LIMITS


def _allows(limit: str, count: float) -> bool:
    """Whether a count keeps to a limit, which is called ``"most ..."`` or ``"least ..."``."""
    return count <= LIMITS[limit] if limit.startswith("most") else count >= LIMITS[limit]


# Whether W and A of so many elements are sums over a lattice's midpoints or steps; of so many equal
# ones anywhere, over lists of pairs.
sums_over_lattice = partial(_allows, "least elements of a lattice")
sums_over_places = partial(_allows, "least elements in lists of pairs")
# Whether samples of a row of so many elements stand for several of its midpoints.
shifts_samples = partial(_allows, "least elements of a row for shifted samples")
# Whether the array factor of so many sites is found by rows and columns.
has_own_factor = partial(_allows, "least sites of an array factor by rows")
# Whether these are code of a compiled kernel, and not a loop: so many short terms of a sum; cuts of
# all transforms of a sum; steps of a recursion; pairs of waves in a kernel that looks up edges.
unrolls_terms = partial(_allows, "most terms as code")
unrolls_cuts = partial(_allows, "most cuts of a sum as code")
unrolls_steps = partial(_allows, "most steps as code")
waves_fit_code = partial(_allows, "most pairs of waves as code")
# Whether a scene's source of so many cuts has vertices and weights as parameters with derivatives.
exposes_numbers = partial(_allows, "most cuts with derivatives in a scene")


def loops_over_edges(cuts: int) -> bool:
    """Whether a compiled kernel is better a loop over a table of edges than code for each."""
    return not _allows("most cuts as code", cuts)


def tabulates_products(weights: int, factors: int | None) -> bool:
    """Whether sums of products of so many weights are looked up in a table.

    ``factors`` : amplitudes in all of the row and the column that the weights are a product of;
    None where they are none.
    """
    if factors is not None and _allows("most amplitudes of factors", factors):
        return False
    return _allows("least weights in a table", weights)


forced_cut: ContextVar[str | None] = ContextVar("forced_cut", default=None)
"""Cut of edges to take whatever it costs; None where plans are free."""


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


def sums_over_points(counts: Sequence[int], panels: int) -> bool:
    """Whether a sum over a grid of points that radiate takes less time than over panels of edges.

    The points of its shorter side are code.
    """
    seconds = math.prod(counts) * COSTS["point that radiates"].seconds
    is_short = min(counts) <= LIMITS["most points as code"]
    return is_short and seconds <= panels * COSTS["panel of an edge"].seconds
