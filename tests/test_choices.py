"""Only ``plans`` choose which way is taken, read from the syntax trees.

A choice looks like ``size < _A_NUMBER``. So below the plans every comparison with a number of its
own is refused, unless the table of exceptions says what else it is for.
"""

import ast
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
TOLD = "when a bar is drawn, or a shape named"

# A reason, and below it files and the names that they compare with.
LISTED = {
    MEMORY: """
        execution/on_drjit.py _MOST; kernels/arrays/array_factor.py _CROSSINGS_PER_SITE;
        kernels/arrays/element_pairs.py _MOST_PAIRS _MOST_WAVE_PAIRS;
        kernels/arrays/factors.py _MOST_BYTES; kernels/cut/pair_grid.py _ACROSS _MOST_ROWS;
        kernels/cut/winding.py _MOST_BYTES; kernels/functions/fourier.py _MOST_EDGES;
        mitsuba/parameters.py CAPACITY; transforms/arguments.py _BLOCK; transforms/wavefronts.py
        _BLOCK
    """,
    DIGITS: """
        execution/on_numpy.py _LARGEST; kernels/arrays/array_factor.py _MISFIT;
        kernels/arrays/element_pairs.py _LEAST_RATIO _LEAST_SPREAD; kernels/boundary/edge_waves.py
        _CLOSE _GRAZING _LOST _LOW; kernels/boundary/integrals.py _FARTHEST; kernels/cut/clipping.py
        NEARLY_PARALLEL; kernels/cut/pair_grid.py _MARGIN _NO_WEIGHT _ROUNDED;
        kernels/cut/slice_sums.py _MARGIN; kernels/functions/fourier.py _EQUAL _MOST_SLENDER _NEAR;
        kernels/functions/gauss_schell.py _FAR _LONG _SMALL _STEEP _TINY;
        kernels/functions/separable.py _PRODUCT; kernels/functions/simplices.py _MOST_CANCELLING;
        kernels/functions/simplices.py NEEDLE_ASPECT; kernels/outline/frame.py NEEDLE_ASPECT;
        kernels/outline/lines.py NEARLY_PARALLEL _PARALLEL _SAME_OFFSET _SEPARATE;
        mitsuba/diffraction.py 9 _ENDS _FAINT _LONGEST; mitsuba/channels.py _MATCHED;
        mitsuba/passing.py _IN_PLANE; mitsuba/rendering.py _LEVEL;
        mitsuba/emitter.py _APART; mitsuba/exact.py AWAY _REAL _ROUNDING; mitsuba/mirrors.py _ALONG
        _AXIS _FLAT; mitsuba/ray_transmission.py MASK _ALONG _STRAIGHT; transforms/imaging.py
        _OVERLAP _ROUNDING;
        mitsuba/placement.py _ROUNDING; mitsuba/sources.py _LARGEST_SUM _OF_CURVED;
        transforms/extremes.py _LARGEST_EXPONENT _UNDERFLOW; transforms/pupil.py _DARK _LEAST_WAVES;
        transforms/wavefronts.py _THIN
    """,
    REFUSED: """
        kernels/catalogue.py MOST_WIDTHS; mitsuba/bodies.py _MOST_WAYS; mitsuba/channels.py
        _MOST_FREQUENCIES;
        mitsuba/diffraction.py _MOST_FACES; mitsuba/exact.py _MOST_PANELS; mitsuba/mirrors.py
        MOST_FACES _MOST_CHAINS; mitsuba/parameters.py _LARGEST _SMALLEST; mitsuba/range_film.py
        _MOST_SUMS; mitsuba/range_profile.py _MOST_BINS; mitsuba/rendering.py _NEVER;
        mitsuba/scatterers.py _NO_LIMIT; mitsuba/scene_files.py _DEEPEST_INCLUDE;
        mitsuba/scenes.py _MOST_SAMPLES; transforms/imaging.py _MOST
        _MOST_AMPLITUDE;
        transforms/projection.py LARGEST_SAMPLES; transforms/wavefronts.py MOST_WIDTHS
    """,
    LAYOUT: """
        execution/evaluation.py _LEAST_COLUMNS; execution/on_numpy.py _LEAST_SIDE _MOST_BELOW
    """,
    TOLD: """
        execution/progress.py 120 _AT_ONCE _INTERVAL _PATIENCE; mitsuba/received_power.py
        _LEAST_NAMED
    """,
    SPARED: """
        execution/on_drjit.py _LEAST_EDGES_SORTED _LEAST_SAMPLES_SORTED; execution/on_numpy.py
        _LEAST_MASKED; execution/operations.py _FEW_SAMPLES; mitsuba/scattering_steps.py _ROULETTE;
        mitsuba/targets.py _MOST_FACES _MOST_PIECES _OFTEN _SHARE
    """,
}
EXCEPTIONS = {
    (words[0], name): reason
    for reason, text in LISTED.items()
    for words in map(str.split, text.split(";"))
    for name in words[1:]
}


def thresholds(tree):
    """The constants and numbers that something is compared with by size."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and any(
            isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE) for op in node.ops
        ):
            for side in (node.left, *node.comparators):
                yield from _numbers(side)


def _numbers(expression):
    for node in ast.walk(expression):
        if isinstance(node, ast.Name | ast.Attribute):
            name = node.id if isinstance(node, ast.Name) else node.attr
            if name.isupper() and len(name) > 1:
                yield name
        number = getattr(node, "value", None)
        if isinstance(number, int | float) and abs(number) > LARGEST_PLAIN:
            yield f"{number:g}"


def table_of_plans(tree):
    """Names of the tables of costs and limits, however they are come by."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "polywigner.plans.costs":
            yield "costs"
        names = [a.name for a in node.names] if isinstance(node, ast.ImportFrom) else []
        names += [node.attr] if isinstance(node, ast.Attribute) else []
        yield from {"COSTS", "LIMITS"}.intersection(names)


def files():
    found = (p for room in ROOMS for p in (PACKAGE / room).rglob("*.py"))
    return sorted(path.relative_to(PACKAGE).as_posix() for path in found)


def test_no_module_chooses_a_way_but_plans():
    """Ask polywigner.plans, or say in LISTED what the number is for; and leave out what is gone."""
    trees = {file: ast.parse((PACKAGE / file).read_text(encoding="utf-8")) for file in files()}
    assert {(f, name) for f, tree in trees.items() for name in thresholds(tree)} == set(EXCEPTIONS)
    assert not [file for file, tree in trees.items() if set(table_of_plans(tree))]


@pytest.mark.parametrize(
    "test", ["n > _FEW", "n >> 4 < 100", "limits.MOST_SAMPLES > len(n)", "n * 2 > _FEW[d]"]
)
def test_a_threshold_is_seen(test):
    assert list(thresholds(ast.parse(test)))
