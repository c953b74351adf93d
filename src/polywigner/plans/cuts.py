"""How edges are cut where no plan of a whole call says so: in renderings and on Dr.Jit arrays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from polywigner.plans.costs import LIMITS

__all__ = ["cut_for", "forced", "forced_cut", "loops_over_edges", "waves_fit_cells"]

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


def cut_for(target: str, cuts: int, cuts_for_cells: int, samples: int = 0) -> str:
    """``"code"``, each edge by itself; ``"rows"``, of a table; or ``"cells"`` that list them.

    ``"all in cells"``: each edge with each side, on lists of one cell, in memory.

    Parameters
    ----------
    target : ``"numpy"``, ``"scalar"``, ``"compiled"``; ``"sorted"``: compiled, with samples in the
        order of the cells; ``"derivatives"``: of a compiled kernel, in points. ``"data"`` and
        ``"code"`` have rows and code only.
    cuts : of all edges by all sides; ``cuts_for_cells``: the same, or 0 where cells cannot be.
    samples : of NumPy, computed at a time; for ``"derivatives"``, all.
    """
    if target in ("data", "code"):
        return "rows" if target == "data" else "code"
    wanted = forced_cut.get()
    if wanted == "data":  # of whole calls only
        wanted = None
    if wanted == "edges":
        cuts_for_cells = 0
    elif wanted is not None:
        possible = cuts_for_cells > 0 or not wanted.endswith("cells")
        return wanted if possible else "rows"
    numpy = target == "numpy"
    least = {
        "numpy": "least cuts in cells, NumPy",
        "scalar": "least cuts in cells, scalar",
        "compiled": "least cuts in cells",
        "derivatives": "least cuts in cells, derivatives",
        "sorted": "least cuts in cells, sorted",
    }[target]
    many = not numpy or samples >= LIMITS["least samples in cells, NumPy"]
    few = target == "derivatives" and samples <= LIMITS["most samples with derivatives as data"]
    if few and 0 < cuts_for_cells <= LIMITS[least]:
        return "all in cells"
    if many and LIMITS[least] < cuts_for_cells <= LIMITS["most cuts in cells"]:
        return "cells"
    if target == "scalar":
        return "code"
    if numpy:
        few = samples <= LIMITS["most samples as rows, NumPy"]
        return "rows" if few and cuts > LIMITS["least cuts as rows, NumPy"] else "code"
    return "rows" if loops_over_edges(cuts) else "code"


def waves_fit_cells(waves: int) -> bool:
    """Whether a kernel that looks edges up in cells may have code for so many pairs of waves."""
    return waves <= LIMITS["most pairs of waves in cells"]


def loops_over_edges(cuts: int) -> bool:
    """Whether a compiled kernel is better a loop over a table of edges than code for each."""
    return cuts > LIMITS["most cuts as code"]
