"""The choice: every way that a request allows, with its cost, and the cheapest of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class Outline:
    """Counts for a kernel that cuts the edges of one copy by another's."""

    edges: int
    pieces: int
    """Convex pieces."""
    cuts: int
    """Pairs of an edge and a side of a piece, with the waves that count as further sides."""
    lines: int
    """Different lines of the sides."""
    exact: float = 0.0
    """The share of the lines whose cuts need twice the digits: nearly parallel ones."""
    waves: int = 1
    """Waves of the field on a cut edge: each takes as long as a uniform one."""
    copies: int = 1
    """Number of copies of the edges that are cut: 1 for W, 2 for A."""
    is_uniform: bool = True
    """Whether one compiled kernel serves all such sources."""
    allows_lists: bool = True
    """Whether slices can be listed once for many frequencies."""
    weighs_lags: bool = False
    """Whether lags have a weight, as in partly coherent light: an edge's term is a sum of nodes."""


@dataclass(frozen=True)
class Request:
    """A function of a source at some samples."""

    function: str
    samples: int
    outline: Outline | None = None
    """None where nothing is cut: then ``terms`` are summed."""
    terms: int = 1
    """Terms of a plain sum for each sample; of an array, pairs of copies near it."""
    is_array: bool = False
    """Whether the outline belongs to an element with many copies."""
    rows: int = 0
    """Places, where each meets every one of ``columns`` frequencies; 0 where samples are points."""
    columns: int = 0
    families: int | None = None
    """Families of parallel edges, where frequencies are a grid that they can be computed on."""
    double: bool = True
    engine: str = "auto"
    compiles: bool = True
    """Whether kernels can be compiled here."""
    takes_data: bool = False
    """Whether there is a kernel that takes any source of this kind as data."""

    def times(self, count: int) -> Request:
        """Return the request with so many times the samples, or places where these are rows."""
        return replace(self, samples=count * self.samples, columns=count * self.columns)


# The names of ways, as `pw.explain` prints them and docs/performance.md explains them.
GRID = "grid from its axes"
LISTED = "slices listed, on NumPy"
LISTED_COMPILED = "slices listed, compiled"
DATA = "edges as data"

# As far as a plan looks for another way with more samples.
_DOUBLINGS = 32


@dataclass(frozen=True)
class Way:
    """One way to carry out a request, and its cost."""

    name: str
    engine: str
    """``"numpy"``, or ``"llvm"`` for any compiled engine."""
    shared: float
    """Seconds once for all sources: loading, kernels that serve all."""
    setup: float
    """Seconds once for a source: tables, compiling."""
    run: float
    """Seconds for each call."""
    cut: str | None = None
    """Cut of edges: ``"code"``, ``"rows"``, ``"pairs"``."""

    @property
    def seconds(self) -> float:
        """Seconds of a call whose future nobody knows: the geometric mean of three uses.

        It may be the only one, one of many of its source, or one of many sources: the mean is least
        where the ratios to the best way for each use have the least product.
        """
        many = LIMITS["calls that share a set-up"]
        only = self.shared + self.setup + self.run
        of_source = (self.shared + self.setup) / many + self.run
        of_sources = self.shared / many + self.setup + self.run
        return math.cbrt(only * of_source * of_sources)


@dataclass(frozen=True)
class Plan:
    """The way taken, and the others."""

    request: Request
    way: Way
    others: tuple[Way, ...]
    """By cost."""

    @property
    def engine(self) -> str:
        """The engine to run on: the way's own, or the compiled one of the request."""
        asked = self.request.engine
        return asked if asked != "auto" else self.way.engine

    def __str__(self) -> str:
        way = self.way
        lines = [f"way: {way.name}", f"because: {self._reason()}", f"estimate: {_takes(way)}"]
        if self.others:
            lines.append(f"next best: {self.others[0].name}: {_takes(self.others[0])}")
        else:
            lines.append("next best: there is no other way")
        lines.append(f"would change it: {self._change()}")
        return "\n".join(lines)

    def _reason(self) -> str:
        request, outline = self.request, self.request.outline
        size = _counted(request.samples, "sample")
        if request.rows:
            places = _counted(request.rows, "place")
            size += f" ({places} x {_counted(request.columns, 'frequency')})"
        if outline is None:
            size += f" of {_counted(request.terms, 'term')}"
        else:
            size += f", {_counted(outline.edges, 'edge')}, "
            size += f"{_counted(outline.pieces, 'convex piece')}, {_counted(outline.cuts, 'cut')}"
        if request.engine != "auto":
            return f"{size}; engine={request.engine!r} was asked for"
        return f"{size}; no way is cheaper, alone and in loops"

    def _change(self) -> str:
        if self.request.engine != "auto":
            return "engine='auto' chooses among all ways"
        for times in (1 << k for k in range(1, _DOUBLINGS)):
            larger = plan(self.request.times(times)).way
            if larger.name != self.way.name:
                return f"{times} times the samples: then {larger.name}"
        return "nothing that is known: more samples go the same way"


def plan(request: Request) -> Plan:
    """The cheapest way for a request."""
    ways = sorted(_allowed(request), key=lambda way: way.seconds)
    return Plan(request, ways[0], tuple(ways[1:]))


def _allowed(request: Request) -> list[Way]:
    wanted = forced_cut.get()
    if wanted == "edges" and request.outline is not None:
        request = replace(request, takes_data=False)
    engines = {"numpy", "llvm"} if request.compiles else {"numpy"}
    if request.engine != "auto":
        engines &= {"numpy"} if request.engine == "numpy" else {"llvm"}
    ways = [way for way in _ways(request) if way.engine in engines]
    return [way for way in ways if wanted and way.cut == wanted] or ways


def _ways(request: Request) -> Iterator[Way]:
    if request.families is not None:
        points = request.families * request.samples
        run = _cost("call", 2) + _cost("family", request.families)
        yield _on_numpy(GRID, run + _cost("point of a family", points))
    if request.outline is None:
        yield from _sums(request)
    elif request.is_array:
        yield from _arrays(request, request.outline)
    else:
        yield from _outlines_on_numpy(request, request.outline)
        yield from _outlines_compiled(request, request.outline)


def _sums(request: Request) -> Iterator[Way]:
    count = request.samples * max(1, request.terms)
    yield _on_numpy("sum on NumPy", _cost("call", 1) + _cost("term", count))
    run = _calling(request) + _cost("compiled term", count)
    yield _compiled("sum, compiled", 0.0, run)
    if request.takes_data:
        yield _by_data(request, _cost("term as data", count))


def _on_numpy(name: str, run: float, setup: float = 0.0, cut: str | None = None) -> Way:
    return Way(name, "numpy", 0.0, setup, run, cut)


def _compiled(name: str, setup: float, run: float, cut: str | None = None) -> Way:
    """A kernel for one source; ``setup``: beside compiling its shortest kernel."""
    return Way(name, "llvm", _cost("load", 1), _cost("compile", 1) + setup, run, cut)


def _by_data(request: Request, run: float) -> Way:
    """The source as data of a kernel that takes any."""
    run += _calling(request) + _cost("source as data", 1)
    return Way(DATA, "llvm", _cost("load", 1) + _cost("kernel for all", 1), 0.0, run, "pairs")


def _arrays(request: Request, outline: Outline) -> Iterator[Way]:
    n, pairs = request.samples * outline.copies, request.samples * outline.copies**2
    more = max(0, request.terms - 1)
    run = _cost("call on copies", outline.copies) + _cost("pair of copies", pairs * more)
    run += _cost("copy", n * outline.waves) + _cost("cut", n * outline.cuts)
    yield _on_numpy("copies on NumPy", run)
    run = 2 * _calling(request) + _cost("compiled copy", n * outline.waves)
    run += _cost("compiled pair of copies", n * more)
    yield _compiled("copies, compiled", _cost("compile copies", outline.copies), run)


# ---- one outline ---------------------------------------------------------------------------------


def _outlines_on_numpy(request: Request, outline: Outline) -> Iterator[Way]:
    n, views = request.samples, outline.copies
    waves = outline.waves * LIMITS["waves of A on NumPy"] if views > 1 else outline.waves
    if request.rows and outline.allows_lists:
        # about half of each copy's edges bound a slice
        terms = _cost("listed term", n * outline.edges * views * waves / 2)
        yield _on_numpy(LISTED, _cost("call", 2) + _listing(outline, request.rows) + terms)
        return
    if request.takes_data and outline.cuts > LIMITS["least cuts by pairs, numpy"]:
        run = _cost("call", 2) + _cost("sample by pairs", n * views * waves)
        run += _cost("edge by pairs", n * views * outline.edges * waves)
        yield _on_numpy("pairs of edges, on NumPy", run, _pairs(outline), "pairs")
    cut = cut_for("numpy", outline.cuts, False, n)
    chunks = math.ceil(n / LIMITS["chunk"])
    lines = n * views * outline.edges * outline.lines
    run = _cost("call", 1) + _cost("cut", lines) + _cost("exact cut", lines * outline.exact)
    edge = "edge with weights" if outline.weighs_lags else "edge"
    run += _cost(edge, n * views * outline.edges * min(outline.pieces, 2) * waves)
    pairs = outline.edges * outline.pieces if cut == "code" else outline.pieces
    run += _cost("pair in Python", chunks * views * pairs)
    if cut == "rows":
        run += _cost("line in Python", views * outline.lines)
    name = "edges one by one, on NumPy" if cut == "code" else "edges as rows, on NumPy"
    yield _on_numpy(name, run, cut=cut)


def _outlines_compiled(request: Request, outline: Outline) -> Iterator[Way]:
    n, views = request.samples * outline.waves, outline.copies
    call, edges = _calling(request), n * views * outline.edges
    is_wide = request.columns >= LIMITS["least columns of a compiled list"]
    if is_wide and outline.allows_lists and outline.edges > LIMITS["most edges not worth listing"]:
        run = call + _listing(outline, request.rows) + _cost("compiled listed term", edges)
        yield _compiled(LISTED_COMPILED, 0.0, run)
        return
    if request.takes_data:
        term = "compiled edge with weights" if outline.weighs_lags else "compiled edge by pairs"
        run = _cost("compiled pairs", n * views) + _cost(term, edges)
        setup = _pairs(outline)
        if not outline.is_uniform:
            setup += _cost("compile", 2) + _cost("compile a wave", (outline.waves - 1) * views)
        yield replace(_by_data(request, run), setup=setup)
    if not loops_over_edges(outline.cuts) and not outline.weighs_lags:
        clip = "compile a clip, double" if request.double else "compile a clip"
        run = call + _cost("compiled clip", n * views * outline.cuts)
        yield _compiled("edges as code", _cost(clip, outline.cuts * views), run, "code")
    elif not request.takes_data:
        run = call + _cost("compiled row", n * views * outline.cuts)
        yield _compiled("edges as rows, compiled", 0.0, run, "rows")


def _listing(outline: Outline, places: int) -> float:
    """To list the parts that bound the slices of some places."""
    boxes = places * outline.copies * outline.edges
    near = min(outline.pieces, 3) * outline.cuts / (outline.edges * outline.pieces)
    return _cost("box", boxes * outline.pieces) + _cost("listed cut", boxes * near)


def _pairs(outline: Outline) -> float:
    """To list the pairs of edges of an outline that can meet."""
    return _cost("call", 2) + _cost("pair of edges", outline.edges**2)


def _calling(request: Request) -> float:
    """To call a compiled kernel with arrays of NumPy, and fetch the results."""
    return _cost("compiled call", 1) + _cost("compiled sample", request.samples)


def _cost(name: str, count: float) -> float:
    return COSTS[name].seconds * count


def _counted(number: int, noun: str) -> str:
    plural = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"


def _takes(way: Way) -> str:
    shared = f"{_seconds(way.shared)} once, " if way.shared else ""
    setup = f"{_seconds(way.setup)} once for the source, " if way.setup else ""
    return f"{shared}{setup}{_seconds(way.run)} a call"


def _seconds(value: float) -> str:
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6)):
        scaled = value * factor
        if scaled >= 1.0:
            return f"{scaled:.0f} {unit}" if scaled >= 100 else f"{scaled:.2g} {unit}"
    return f"{value * 1e9:.2g} ns"
