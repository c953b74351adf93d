"""Costs and limits of each step of a computation, in one table.

Seconds are of one quiet core of a processor of 2022; what counts is their ratios. Each entry names
the script in ``benchmarks`` whose output it was read from.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """Seconds a step takes, per unit."""

    seconds: float
    unit: str
    benchmark: str


_REGRET = "default_regret.py"
_CUTS = "wigner_cost.py"
_PAIRS = "call_rates.py"
_RENDER = "render_exact.py"

COSTS: dict[str, Cost] = {
    # NumPy
    "call": Cost(0.5e-3, "call with few samples", _REGRET),
    "term": Cost(0.13e-6, "sample and term of a plain sum", _REGRET),
    "cut": Cost(3e-9, "sample, edge and line", _REGRET),
    "exact cut": Cost(20e-9, "sample, edge and line of a cluster of nearly parallel ones", _REGRET),
    "edge": Cost(35e-9, "sample and edge that is left in a slice", _REGRET),
    "edge with weights": Cost(0.7e-6, "the same in partly coherent light", "coherence.py"),
    "pair in Python": Cost(5e-6, "edge and convex piece, for 12288 samples", _REGRET),
    "line in Python": Cost(45e-6, "line that cuts all edges as rows", _REGRET),
    "box": Cost(20e-9, "place, edge and convex piece whose boxes are compared", _REGRET),
    "listed cut": Cost(0.05e-6, "place, edge and side near it", _REGRET),
    "listed term": Cost(20e-9, "sample and part of its slice", _REGRET),
    "sample by pairs": Cost(4e-6, "sample, whatever the number of edges", _PAIRS),
    "edge by pairs": Cost(0.04e-6, "sample and edge, looked up in lists of pairs", _PAIRS),
    "call on copies": Cost(2e-3, "call of an array with few samples, and copy of edges", _REGRET),
    "copy": Cost(0.8e-6, "sample of an array of copies, and copy of the outline", _REGRET),
    "pair of copies": Cost(0.5e-6, "sample and pair of elements near it", _REGRET),
    "family": Cost(0.2e-3, "family of parallel edges on a grid of frequencies", _REGRET),
    "point of a family": Cost(11e-9, "point of the grid and family", _REGRET),
    # compiled
    "load": Cost(0.05, "process, to import Dr.Jit", "questions/latency.py"),
    "compile": Cost(0.1, "kernel", "questions/latency.py"),
    "compile copies": Cost(0.1, "copy of the edges, in a sum over elements", _REGRET),
    "compile a wave": Cost(30e-3, "wave of the field on an edge", _REGRET),
    "compiled call": Cost(0.5e-3, "call of a compiled kernel", _REGRET),
    "compiled sample": Cost(10e-9, "sample that goes to the engine and back", _CUTS),
    "kernel for all": Cost(50e-3, "kernel that serves all sources, on disk but for once", _PAIRS),
    "compile a clip": Cost(0.5e-3, "edge and side in single precision", _CUTS),
    "compile a clip, double": Cost(1.5e-3, "the same in double precision", _CUTS),
    "compiled clip": Cost(0.25e-9, "sample, edge and side as code", _CUTS),
    "compiled row": Cost(0.5e-9, "sample, edge and side as rows of a table", _CUTS),
    "source as data": Cost(1e-3, "call whose outline comes as data", "outlines_as_data.py"),
    "term as data": Cost(20e-9, "sample and edge of F, where it is data", "outlines_as_data.py"),
    "point that radiates": Cost(1.2e-9, "sample and equivalent source of a grid", _RENDER),
    "panel of an edge": Cost(40e-9, "sample and panel of a boundary integral", _RENDER),
    "compiled term": Cost(9e-9, "sample and term of a plain sum", _REGRET),
    "compiled edge with weights": Cost(
        0.17e-6, "sample and edge of a slice in partly coherent light", "coherence.py"
    ),
    "compiled listed term": Cost(1e-9, "sample and part of its slice", "outer_products.py"),
    "compiled pairs": Cost(70e-9, "sample, whatever the number of edges", _PAIRS),
    "compiled edge by pairs": Cost(1.2e-9, "sample and edge, looked up in lists", _PAIRS),
    "compiled copy": Cost(0.08e-6, "sample of an array of copies", "array_cost.py"),
    "compiled pair of copies": Cost(10e-9, "sample and pair of elements near it", "array_cost.py"),
    "pair of edges": Cost(0.4e-6, "pair of edges, to list where it can meet", _PAIRS),
}

LIMITS: dict[str, float] = {
    # Cuts from which on lists of pairs are faster than code or rows (call_rates.py).
    "least cuts by pairs, compiled": 4500,
    "least cuts by pairs, scalar": 300,
    "least cuts by pairs, derivatives": 400,
    "least cuts by pairs, numpy": 400,
    # Each pair of waves is code, of some 20 ms to compile (array_cost.py).
    "most pairs of waves as code": 16,
    # Code for each edge is two to six times as fast as a loop over them, up to where compiling it
    # takes seconds.
    "most cuts as code": 4500,
    # Calls of a source, or sources, in a loop: from some ten to some thousand, ways that are taken
    # for few calls and for many hardly change.
    "calls that share a set-up": 100,
    # NumPy: of few samples, calls cost more than what they compute.
    "least cuts as rows, NumPy": 64,
    "most samples as rows, NumPy": 256,
    # Terms of A are complex: on NumPy each of its edges takes twice as long as one of W.
    "waves of A on NumPy": 2,
    # Fewer elements of a lattice are summed pair by pair (array_cost.py).
    "least elements of a lattice": 4,
    # Fewer equal elements are cut by one another's pieces (array_cost.py).
    "least elements in lists of pairs": 6,
    # With fewer sites of any weights, a midpoint's pairs are summed one by one (array_cost.py).
    "least weights in a table": 32,
    # Rows and columns of more amplitudes in all are looked up in a table: a sum of half as many
    # terms takes longer, as measured with rows of 128 to 1000 elements (array_cost.py).
    "most amplitudes of factors": 256,
    # Fewer sites are summed one by one: that is as fast, and compiles at once (array_cost.py).
    "least sites of an array factor by rows": 16,
    # Samples at a time of NumPy.
    "chunk": 3 << 12,
    # A compiled kernel cuts as fast as it looks up what was cut: the square.
    "most edges not worth listing": 4,
    "least columns of a compiled list": 256,
    # Traced kernels. An outline as code runs 3 to 4 times as fast as one that is data, and takes
    # 0.2 to 1 s to compile whenever it changes (gradient_cost.py).
    "least samples for an outline as code": 1 << 22,
    # To trace a kernel takes as long as some ten thousand samples of it (questions/latency.py). Of
    # more samples, arrays are better computed with what they are used for, without being stored.
    "most samples of a recording": 1 << 16,
    # Derivatives in points as code for each cut run up to three times as fast, and take 0.1 to 2 s
    # to compile; to trace them takes longer, as long as for so many samples (gradient_cuts.py).
    "most samples with derivatives as data": 1 << 15,
    # A term of the Fourier transform takes some 20 ms to compile (fourier_cost.py).
    "most terms as code": 12,
    # Waves of points compile in some 5 ms each, and run twice as fast as a loop (render_exact.py).
    "most points as code": 64,
    # Terms that are whole transforms: half a second to compile.
    "most cuts of a sum as code": 256,
    # Steps of a recursion, of four terms each: 50 take 1.5 s to compile in four tables, and 1450 a
    # minute; as a loop 0.3 s and 0.7 s, and it runs as fast.
    "most steps as code": 8,
    # Code of every kernel of a render with derivatives, which compiles in 7 ms a cut,
    # measured with 2 to 16 squares: half a minute. 9000 exhaust the compiler.
    "most cuts with derivatives in a scene": 4096,
    # Three samples cost more than the fewer midpoints of a shorter row cancel.
    "least elements of a row for shifted samples": 4,
}
