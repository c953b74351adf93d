"""Strategies that `pw.explain` reports for few and for many samples."""

import re
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.execution import choice

SQUARE, POLYGON = pw.shapes.square(0.01), pw.shapes.regular_polygon(64, 0.01)
LATTICE = pw.phased_array(SQUARE, pw.arrays.grid_positions(4, 4, 0.02))


def points(*shape):
    return np.random.default_rng(2).normal(size=(*shape, 2))


def grid(count):
    axis = np.linspace(-200.0, 200.0, count)
    return np.stack(np.meshgrid(axis, axis), axis=-1)


FEW, MANY, MOST = points(30), points(10_000), points(1 << 18)
CASES = [
    ("wigner", SQUARE, (FEW, FEW), choice.PAIRS, "numpy"),
    ("wigner", SQUARE, (MANY, MANY), choice.DATA, "llvm"),
    ("wigner", SQUARE, (MOST, MOST), choice.CODE, "llvm"),
    ("wigner", POLYGON, (MOST, MOST), choice.DATA, "llvm"),
    ("ambiguity", POLYGON, (points(1000), points(1000)), choice.DATA, "llvm"),
    ("wigner", POLYGON, (points(2, 1), points(100)), choice.LISTED, "numpy"),
    ("wigner", POLYGON, (points(100, 1), points(1000)), choice.LISTED, "llvm"),
    ("fourier", POLYGON, (FEW,), choice.SUM, "numpy"),
    ("fourier", POLYGON, (MANY,), choice.DATA, "llvm"),
    ("fourier", SQUARE, (grid(200),), choice.GRID, "numpy"),
    ("wigner", LATTICE, (FEW, FEW), choice.SUM, "numpy"),
    ("wigner", LATTICE, (MOST, MOST), choice.SUM, "llvm"),
]
IDS = [f"{name} {number}" for number, (name, *_) in enumerate(CASES)]


@pytest.mark.llvm
@pytest.mark.parametrize(("function", "source", "arguments", "strategy", "engine"), CASES, ids=IDS)
def test_strategies_follow_the_number_of_samples_and_edges(
    function, source, arguments, strategy, engine
):
    plan = pw.explain(source, *arguments, function=function)
    assert (plan.strategy, plan.engine) == (strategy, engine)
    assert [line.split(": ")[0] for line in str(plan).splitlines()] == [
        "strategy",
        "engine",
        "because",
    ]


@pytest.mark.parametrize(("function", "source", "arguments"), [case[:3] for case in CASES], ids=IDS)
def test_a_requested_engine_is_used(function, source, arguments):
    plan = pw.explain(source, *arguments, function=function, engine="numpy")
    assert plan.engine == "numpy"
    with choice.uncompiled():
        assert pw.explain(source, *arguments, function=function).engine == "numpy"


def test_the_documents_explain_every_strategy():
    text = (Path(__file__).parents[1] / "docs" / "performance.md").read_text(encoding="utf-8")
    section = text.split("## Strategies", 1)[1].split("\n## ", 1)[0]
    table = section.split("| strategy |", 1)[1].split("\n\n", 1)[0]
    explained = set(re.findall(r"^\| ([a-z][^|]*) \|", table, flags=re.MULTILINE))
    names = "GRID", "LISTED", "PAIRS", "DATA", "CODE", "SUM"
    assert explained == {getattr(choice, name) for name in names}


def test_what_has_no_single_plan_is_refused():
    with pytest.raises(pw.errors.ArgumentError, match="function to be one of"):
        pw.explain(SQUARE, (0, 0), (0, 0), function="otf")
    with pytest.raises(pw.errors.ArgumentError, match="expected x and nu for wigner, got 1"):
        pw.explain(SQUARE, (0, 0))
    with pytest.raises(pw.errors.ArgumentError, match="pass one element of the Array"):
        pw.explain(pw.phased_array(SQUARE, [(0, 0), (1, 0)]), (0, 0), function="fourier")
    curved = pw.Wavefront(SQUARE, [[3.0, 0.0], [0.0, 2.0]])
    with pytest.raises(pw.errors.ArgumentError, match="no choice"):
        pw.explain(curved, FEW, function="fourier")


def test_a_curved_wave_is_explained_as_its_flat_source():
    curved = pw.Wavefront(POLYGON, [[3.0, 0.0], [0.0, 2.0]])
    arguments = points(100, 1), points(1000)
    plan = pw.explain(curved, *arguments, engine="numpy")
    assert plan == pw.explain(POLYGON, *arguments, engine="numpy")
