"""Which way a call takes: a table of requests, and laws of every choice."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import polywigner
import polywigner as pw
import polywigner.plans
from polywigner.plans import Outline, Request, cut_for, forced, launch_for, plan
from polywigner.plans.plan import LISTED

TABLE = Path(__file__).parent / "data" / "plans.txt"

MANY = 100  # calls in a loop
UNNOTICED = 20e-3  # seconds

# Counted of shapes as users have them: edges, convex pieces, cuts, lines, share of exact lines.
OUTLINES = {
    "square": Outline(4, 1, 16, 4),
    "chevron": Outline(6, 2, 48, 7),
    "18 hexagons": Outline(108, 18, 11_664, 33),
    "64-gon": Outline(64, 1, 4_096, 64),
    "coastline": Outline(300, 155, 182_400, 454, 1.0),
    "1000-gon": Outline(1000, 1, 1_000_000, 1000, 1.0),
    "tapered chevron": Outline(6, 2, 2_352, 7, waves=9),
    "two chevrons": Outline(12, 4, 192, 14),
}
SAMPLES = (1, 100, 10_000, 1_000_000)
LAYOUTS = ("points", "one place", "outer")


def requests():
    """By name: W and A of outlines in every layout, arrays, and plain sums."""
    found = {}
    for (name, outline), function, layout, n in itertools.product(
        OUTLINES.items(), ("wigner", "ambiguity"), LAYOUTS, SAMPLES
    ):
        if n == 1 and layout != "points":
            continue
        copies = 1 if function == "wigner" else 2
        counted = replace(outline, copies=copies, is_uniform=outline.waves == 1)
        request = Request(function, n, counted, takes_data=True)
        if layout == "one place":
            request = replace(request, rows=1, columns=n)
        if layout == "outer":
            request = replace(request, rows=int(n**0.5), columns=int(n**0.5))
        found[f"{function} | {name} | {layout} | {n}"] = request
    for terms, n in itertools.product((4, 64, 1000), SAMPLES):
        points = Request("fourier", n, terms=terms, takes_data=True)
        found[f"fourier | {terms} edges | points | {n}"] = points
        families = replace(points, families=terms // 2)
        found[f"fourier | {terms} edges | grid | {n}"] = families
    for pairs, n in itertools.product((1, 40), SAMPLES):
        array = Request("wigner", n, OUTLINES["square"], pairs, is_array=True)
        found[f"wigner | array, {pairs} pairs near | points | {n}"] = array
    return found


def table():
    """The table as it is now; ``python tests/test_plans.py`` writes it."""
    rows = [f"{name} | {plan(request).way.name}" for name, request in requests().items()]
    return "\n".join(rows) + "\n"


def test_requests_take_the_ways_of_the_table():
    expected = TABLE.read_text().splitlines()
    assert len(expected) > 150
    assert table().splitlines() == expected


def test_few_samples_stay_on_numpy_and_many_are_compiled():
    """The regret of the default, as ways instead of seconds: benchmarks/default_regret.py."""
    engines: dict[int, list[str]] = {n: [] for n in SAMPLES}
    for request in requests().values():
        if request.families is None:  # grids have axes on NumPy
            engines[request.samples].append(plan(request).engine)
    assert engines[1].count("numpy") == len(engines[1])
    assert engines[100].count("numpy") >= 0.85 * len(engines[100])
    assert engines[10_000].count("numpy") >= 0.5 * len(engines[10_000])
    assert engines[1_000_000].count("llvm") >= 0.8 * len(engines[1_000_000])


def _alone(way):
    """Seconds of a call that is the only one."""
    return way.shared + way.setup + way.run


def _repeated(way):
    """Of one of many calls of a source."""
    return (way.shared + way.setup) / MANY + way.run


def _in_a_loop(way):
    """Of one of many calls, each of another source."""
    return way.shared / MANY + way.setup + way.run


@pytest.mark.parametrize(("use", "most"), [(_alone, 13.0), (_repeated, 21.0), (_in_a_loop, 3.5)])
def test_no_use_costs_much_more_than_had_it_been_known(use, most):
    """Whether a call is repeated, and whether its source changes, nobody knows beforehand."""
    for request in requests().values():
        found = plan(request)
        best = min(use(way) for way in (found.way, *found.others))
        assert use(found.way) <= max(most * best, UNNOTICED)


@pytest.mark.parametrize(("engine", "ways"), [("numpy",) * 2, ("llvm",) * 2, ("cuda", "llvm")])
def test_an_engine_that_is_asked_for_is_taken(engine, ways):
    for request in requests().values():
        found = plan(replace(request, engine=engine))
        assert (found.engine, found.way.engine) == (engine, ways)


@pytest.mark.parametrize("name", ["64-gon", "coastline", "square"])
def test_what_would_change_a_plan_does(name):
    request = requests()[f"wigner | {name} | points | 1"]
    found = plan(request)
    number, other = re.search(r"change it: (\d+) times.*: then (.*)", str(found)).groups()
    half, whole = (replace(request, samples=int(number) // k) for k in (2, 1))
    assert plan(half).way.name == found.way.name
    assert plan(whole).way.name == other


def test_without_a_compiler_everything_is_numpy_s():
    for request in requests().values():
        found = plan(replace(request, compiles=False))
        assert found.engine == "numpy"
        assert "asked for" not in str(found)


def test_edges_are_cut_as_forced():
    request = requests()["wigner | 64-gon | points | 10000"]
    for cut in ("code", "rows", "pairs"):
        with forced(cut):
            assert plan(request).way.cut in (cut, None)
    with forced("pairs"):
        assert plan(request).way.cut == "pairs"


def test_a_plan_prints_five_lines():
    starts = ["way", "because", "estimate", "next best", "would change it"]
    for request in requests().values():
        assert [line.split(": ")[0] for line in str(plan(request)).splitlines()] == starts


def test_the_documents_explain_every_way():
    """By the names that `pw.explain` prints."""
    text = (Path(__file__).parent.parent / "docs" / "performance.md").read_text(encoding="utf-8")
    explained = set(re.findall(r"^\| ([a-z][^|]*) \|", section(text), flags=re.MULTILINE)) - {"way"}
    everything = requests().values()
    named = {way.name for r in everything for way in (plan(r).way, *plan(r).others)}
    assert named <= explained
    code = (Path(polywigner.plans.__file__).parent / "plan.py").read_text(encoding="utf-8")
    assert all(f'"{name}"' in code for name in explained)


def section(text):
    return text.split("## Which way a call takes", 1)[1].split("\n## ", 1)[0]


@pytest.mark.parametrize(
    ("samples", "changes", "recordable", "by_pairs", "launch"),
    [
        (100, False, True, False, "recorded"),
        (100_000, False, True, False, "code"),  # part of a caller's kernel
        (100_000, False, True, True, "recorded"),
        (100, False, False, True, "code"),
        (100_000, True, False, False, "data"),  # an outline that changes
        (10_000_000, True, False, False, "code"),
    ],
)
def test_arrays_of_the_engine_are_launched_by_their_number(
    samples, changes, recordable, by_pairs, launch
):
    how = {"changes": changes, "recordable": recordable, "by_pairs": by_pairs}
    assert launch_for(samples, **how) == launch


@pytest.mark.parametrize(
    ("target", "cuts", "by_pairs", "samples", "cut"),
    [
        ("derivatives", 48, True, 1_000_000, "code"),
        ("derivatives", 1024, True, 1_000_000, "pairs"),  # code is ten times the function's
        ("derivatives", 10_000, False, 1_000_000, "rows"),
        ("derivatives", 48, True, 1000, "pairs"),
        ("derivatives", 48, False, 1000, "code"),
        ("compiled", 48, True, 0, "code"),
        ("compiled", 1024, True, 0, "code"),
    ],
)
def test_edges_are_cut_by_their_number(target, cuts, by_pairs, samples, cut):
    assert cut_for(target, cuts, by_pairs, samples) == cut


def test_explain_tells_what_a_call_does():
    square, nu = pw.shapes.square(0.01), np.zeros((1000, 2))
    assert pw.explain(square, (0.0, 0.0), nu).way.name == LISTED
    assert pw.explain(square, nu, function="fourier").way.name == "sum on NumPy"
    assert pw.explain(square, nu, nu, function="ambiguity", engine="numpy").engine == "numpy"


def test_a_call_takes_the_same_way_at_every_repetition():
    """And in every process: whatever else has been computed, loaded or compiled."""
    rng = np.random.default_rng(2)
    for count in (10, 1000):
        source, points = pw.shapes.regular_polygon(64, 0.01), 1e-3 * rng.normal(size=(2, count, 2))
        first = pw.explain(source, *points)
        for _ in range(5):
            pw.wigner(source, *points)
        assert pw.explain(source, *points) == first


def test_explain_refuses_what_it_cannot_tell():
    square = pw.shapes.square(0.01)
    with pytest.raises(pw.errors.ArgumentError, match="function to be one of"):
        pw.explain(square, (0, 0), (0, 0), function="otf")
    with pytest.raises(pw.errors.ArgumentError, match="expected x and nu for wigner, got 1"):
        pw.explain(square, (0, 0))
    with pytest.raises(pw.errors.ArgumentError, match="explain that of an element"):
        pw.explain(pw.phased_array(square, [(0, 0), (1, 0)]), (0, 0), function="fourier")


if __name__ == "__main__":
    TABLE.write_text(table())
