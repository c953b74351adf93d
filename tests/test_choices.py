"""Only ``plans`` choose which way is taken, read from the syntax trees.

A choice looks like ``size < _A_NUMBER``. So below the plans every comparison with a number of its
own is refused, unless the table of exceptions says what else it is for.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import polywigner

PACKAGE = Path(polywigner.__file__).parent
ROOMS = ("execution", "kernels", "mitsuba", "transforms")

# Numbers up to this one are those of dimensions, bytes of a float, and the like.
LARGEST_PLAIN = 8

MEMORY = "how much is in memory at a time"
DIGITS = "which digits are kept"
REFUSED = "what is refused"
LAYOUT = "which arguments count as a grid, or as rows and columns: a request says so"
SPARED = "of one way: samples that need no work, or one instruction for several of them"

EXCEPTIONS: dict[tuple[str, str], str] = {
    ("execution/frozen.py", "_MOST"): MEMORY,
    ("execution/grids.py", "_LARGEST"): DIGITS,
    ("execution/grids.py", "_LEAST_SIDE"): LAYOUT,
    ("execution/grids.py", "_MOST_BELOW"): LAYOUT,
    ("execution/on_drjit_data.py", "_LEAST_EDGES_SORTED"): SPARED,
    ("execution/on_drjit_data.py", "_LEAST_SAMPLES_SORTED"): SPARED,
    ("execution/on_numpy.py", "_LEAST_MASKED"): SPARED,
    ("execution/operations.py", "_FEW_SAMPLES"): SPARED,
    ("execution/evaluation.py", "_LEAST_COLUMNS"): LAYOUT,
    ("kernels/arrays/array_factor.py", "_CROSSINGS_PER_SITE"): MEMORY,
    ("kernels/arrays/array_factor.py", "_MISFIT"): DIGITS,
    ("kernels/arrays/element_pairs.py", "_LEAST_RATIO"): DIGITS,
    ("kernels/arrays/element_pairs.py", "_LEAST_SPREAD"): DIGITS,
    ("kernels/arrays/element_pairs.py", "_MOST_PAIRS"): MEMORY,
    ("kernels/arrays/element_pairs.py", "_MOST_WAVE_PAIRS"): MEMORY,
    ("kernels/arrays/weight_tables.py", "_MOST_BYTES"): MEMORY,
    ("kernels/boundary/integrals.py", "_FARTHEST"): DIGITS,
    ("kernels/boundary/edge_waves.py", "_CLOSE"): DIGITS,
    ("kernels/boundary/edge_waves.py", "_GRAZING"): DIGITS,
    ("kernels/boundary/edge_waves.py", "_LOST"): DIGITS,
    ("kernels/boundary/edge_waves.py", "_LOW"): DIGITS,
    ("kernels/outline/lines.py", "_PARALLEL"): DIGITS,
    ("kernels/outline/lines.py", "_SEPARATE"): DIGITS,
    ("kernels/cut/clipping.py", "NEARLY_PARALLEL"): DIGITS,
    ("kernels/cut/pair_grid.py", "_MARGIN"): DIGITS,
    ("kernels/cut/pair_grid.py", "_NO_WEIGHT"): DIGITS,
    ("kernels/cut/pair_grid.py", "_ROUNDED"): DIGITS,
    ("kernels/cut/pair_grid.py", "_ACROSS"): MEMORY,
    ("kernels/cut/pair_grid.py", "_MOST_ROWS"): MEMORY,
    ("kernels/cut/slice_sums.py", "_MARGIN"): DIGITS,
    ("kernels/cut/winding.py", "_MOST_BYTES"): MEMORY,
    ("kernels/catalogue.py", "MOST_WIDTHS"): REFUSED,
    ("kernels/functions/gauss_schell.py", "_FAR"): DIGITS,
    ("kernels/functions/gauss_schell.py", "_LONG"): DIGITS,
    ("kernels/functions/gauss_schell.py", "_SMALL"): DIGITS,
    ("kernels/functions/gauss_schell.py", "_STEEP"): DIGITS,
    ("kernels/functions/gauss_schell.py", "_TINY"): DIGITS,
    ("kernels/functions/fourier.py", "_MOST_EDGES"): MEMORY,
    ("kernels/functions/fourier.py", "_MOST_SLENDER"): DIGITS,
    ("kernels/functions/fourier.py", "_NEAR"): DIGITS,
    ("kernels/functions/separable.py", "_PRODUCT"): DIGITS,
    ("kernels/functions/simplices.py", "_MOST_CANCELLING"): DIGITS,
    ("kernels/functions/solids.py", "NEEDLE_ASPECT"): DIGITS,
    ("kernels/functions/fourier.py", "_EQUAL"): DIGITS,
    ("kernels/outline/frame.py", "NEEDLE_ASPECT"): DIGITS,
    ("kernels/outline/lines.py", "NEARLY_PARALLEL"): DIGITS,
    ("kernels/outline/lines.py", "_SAME_OFFSET"): DIGITS,
    ("mitsuba/scatterers.py", "_NO_LIMIT"): REFUSED,
    ("mitsuba/scattering_steps.py", "_ROULETTE"): SPARED,
    ("mitsuba/exact.py", "_ROUNDING"): DIGITS,
    ("mitsuba/sources.py", "_LARGEST_SUM"): DIGITS,
    ("mitsuba/sources.py", "_OF_CURVED"): DIGITS,
    ("mitsuba/exact.py", "AWAY"): DIGITS,
    ("mitsuba/exact.py", "_MOST_PANELS"): REFUSED,
    ("mitsuba/exact.py", "_REAL"): DIGITS,
    ("mitsuba/mirrors.py", "_FLAT"): DIGITS,
    ("mitsuba/mirrors.py", "_MOST_CHAINS"): REFUSED,
    ("mitsuba/mirrors.py", "_MOST_FACES"): REFUSED,
    ("mitsuba/parameters.py", "_LARGEST"): REFUSED,
    ("mitsuba/parameters.py", "_SMALLEST"): REFUSED,
    ("mitsuba/range_film.py", "_MOST_SUMS"): REFUSED,
    ("mitsuba/range_profile.py", "_MOST_BINS"): REFUSED,
    ("mitsuba/placement.py", "_ROUNDING"): DIGITS,
    ("mitsuba/rendering.py", "_NEVER"): REFUSED,
    ("mitsuba/scene_files.py", "_MOST_PIXELS"): REFUSED,
    ("mitsuba/scene_files.py", "_MOST_CORNERS"): REFUSED,
    ("mitsuba/scene_files.py", "_LARGEST_MESH"): REFUSED,
    ("mitsuba/scene_files.py", "_MOST_MESHES"): REFUSED,
    ("mitsuba/scenes.py", "_MOST_SAMPLES"): REFUSED,
    ("mitsuba/parameters.py", "CAPACITY"): MEMORY,
    ("mitsuba/emitter.py", "_APART"): DIGITS,
    ("mitsuba/mirrors.py", "_STRAIGHT"): DIGITS,
    ("transforms/arguments.py", "_BLOCK"): MEMORY,
    ("transforms/wavefronts.py", "_BLOCK"): MEMORY,
    ("transforms/wavefronts.py", "MOST_WIDTHS"): REFUSED,
    ("transforms/wavefronts.py", "_THIN"): DIGITS,
    ("transforms/extremes.py", "_LARGEST_EXPONENT"): DIGITS,
    ("transforms/extremes.py", "_UNDERFLOW"): DIGITS,
    ("transforms/projection.py", "LARGEST_SAMPLES"): REFUSED,
    ("transforms/pupil.py", "_DARK"): DIGITS,
}


@cache
def tree_of(file: str) -> ast.AST:
    return ast.parse((PACKAGE / file).read_text(encoding="utf-8"))


def thresholds(tree: ast.AST) -> Iterator[str]:
    """The constants and numbers that something is compared with by size."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and any(
            isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE) for op in node.ops
        ):
            for side in (node.left, *node.comparators):
                yield from _numbers(side)


def _numbers(expression: ast.expr) -> Iterator[str]:
    for node in ast.walk(expression):
        if isinstance(node, ast.Name | ast.Attribute):
            name = node.id if isinstance(node, ast.Name) else node.attr
            if name.isupper() and len(name) > 1:
                yield name
        number = getattr(node, "value", None)
        if isinstance(number, int | float) and abs(number) > LARGEST_PLAIN:
            yield f"{number:g}"


def table_of_plans(tree: ast.AST) -> Iterator[str]:
    """Names of the tables of costs and limits, however they are come by."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "polywigner.plans.costs":
            yield "costs"
        names = [a.name for a in node.names] if isinstance(node, ast.ImportFrom) else []
        names += [node.attr] if isinstance(node, ast.Attribute) else []
        yield from {"COSTS", "LIMITS"}.intersection(names)


def files() -> list[str]:
    found = (p for room in ROOMS for p in (PACKAGE / room).rglob("*.py"))
    return sorted(path.relative_to(PACKAGE).as_posix() for path in found)


@pytest.mark.parametrize("file", files())
def test_no_module_chooses_a_way_but_plans(file: str) -> None:
    tree = tree_of(file)
    found = {name for name in thresholds(tree) if (file, name) not in EXCEPTIONS}
    assert not found, f"ask polywigner.plans, or say in EXCEPTIONS what {sorted(found)} is for"
    assert not set(table_of_plans(tree))


def test_every_exception_is_still_needed() -> None:
    for file, name in EXCEPTIONS:
        tree = tree_of(file)
        assert name in set(thresholds(tree)), f"{file} compares nothing with {name} any more"


@pytest.mark.parametrize(
    "source",
    [
        "_FEW = 1 << 16\ndef f(n):\n    return g(n) if n > _FEW else h(n)",
        "def f(n):\n    return g(n) if n > 65536 else h(n)",
        "def f(n):\n    return g(n) if n >> 4 < 100 else h(n)",
        "from other import LEAST\ndef f(n):\n    while LEAST <= n < 3 * n:\n        n = g(n)",
        "import limits\ndef f(n):\n    return g(n) if limits.MOST_SAMPLES > len(n) else h(n)",
        "_A, _FEW = 1, {True: 3, False: 4}\ndef f(n, d):\n    return [g, h][n * 2 > _FEW[d]](n)",
    ],
)
def test_a_threshold_is_seen(source: str) -> None:
    assert list(thresholds(ast.parse(source)))


@pytest.mark.parametrize(
    "source",
    [
        "def f(n):\n    return g(n) if n > 1 else h(n)",
        "def f(n):\n    return g(n) if is_recorded(n) else h(n)",
        "_BLOCK = 1 << 16\ndef f(n):\n    return [g(k) for k in range(0, n, _BLOCK)]",
        "GRID = 'grid'\ndef f(way):\n    return g(way) if way == GRID else h(way)",
    ],
)
def test_what_is_no_threshold_passes(source: str) -> None:
    assert not list(thresholds(ast.parse(source)))


@pytest.mark.parametrize(
    "source",
    [
        "from polywigner.plans.costs import LIMITS",
        "from polywigner.plans import COSTS",
        "from polywigner import plans\nplans.costs.LIMITS['chunk']",
    ],
)
def test_a_look_at_the_tables_is_seen(source: str) -> None:
    assert list(table_of_plans(ast.parse(source)))
