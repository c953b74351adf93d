"""How edges are cut where no plan of a whole call says so: in renderings and on Dr.Jit arrays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from polywigner.plans.costs import LIMITS

__all__ = ["cut_for", "forced", "forced_cut", "loops_over_edges", "waves_fit_code"]

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
