"""Seed faults into the code, one at a time, and count the faults that quick tests detect.

    tools/seed_faults.py --area geometry --count 20

A fault is a changed comparison, sign, constant or logical operator, a dropped term, or two swapped
arguments. The same seed selects the same faults as long as the code does not change. Tests run
against a copy of the code until the first failure; tests that take more CPU time than --seconds
count as "too long". Without --lines, the test files of the area run, as AREAS defines them.

The option --lines uses the tests that run the changed line, shortest first, as recorded by

    COVERAGE_FILE=out/lines pytest -n 2 -m "not slow" --cov=polywigner --cov-context=test \\
        --cov-report= --junitxml=out/lines.xml
    tools/seed_faults.py --lines out/lines --count 50 --out out/faults.csv

(pytest-cov is not among the dependencies). A line that no test runs, such as a constant of a
module, uses the tests of its module. The list tests/data/seeded_faults.csv was made in this way;
"no effect" there marks faults that change no result beyond rounding, judged by hand. The option
--again repeats the faults of such a list, except those without effect.
"""

from __future__ import annotations

import argparse
import ast
import csv
import importlib
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from importlib.util import cache_from_source
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src/polywigner"
AREAS = {  # subpackages of an area, and parts of the names of its test files
    "geometry": (
        "geometry",
        "geometry automean readers shapes svg dxf gds gerber mesh set_op curves slits polyhedra "
        "silhouettes file_errors",
    ),
    "source": (
        "source optics",
        "illumin array source first_order cosines laws normal_form element_files",
    ),
    "transforms": (
        "kernels transforms numerics execution",
        "laws identities coherence coincident curved slits polyhedra fourier projection imaging "
        "aberrated pupil zernike gradients steepest autocorrelation explain",
    ),
    "propagation": (
        "propagation radiometry",
        "fields patterns beams irradiance radiometry stores shadow_ builders far_field sampling "
        "test_shadows.",
    ),
    "reception": ("reception scattering rays", "coupling friis rcs rays plausib covar links"),
    "mitsuba": (
        "mitsuba",
        "mitsuba received scatterers range scene channel delta_lights default_pol panes "
        "visibility radar shadows_in power_adds small_targets",
    ),
    "llvm": ("llvm interruption", "llvm doctor interruptions"),
    "interface": ("cli figures quantities", "cli figures doctor quantities mistakes lenses"),
}
# Imported once for all forked processes, except Dr.Jit, whose threads do not survive a fork.
LIBRARIES = ("hypothesis", "matplotlib.pyplot", "mpmath", "pytest", "scipy", "shapely", "xarray")
SHORTEST, SECONDS = 12, 30.0  # number of tests that run first; sum of the durations of all tests
Table = dict[tuple[str, int], list[str]]

_COMPARED = {"Lt": "GtE", "LtE": "Lt", "Gt": "LtE", "GtE": "Gt", "Eq": "NotEq", "NotEq": "Eq"}
_COMPARED |= {"Is": "IsNot", "IsNot": "Is", "In": "NotIn", "NotIn": "In"}
_COMBINED = {"Add": "Sub", "Sub": "Add", "Mult": "Div", "Div": "Mult", "Pow": "Mult"}
_SILENT = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.Assert)


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield faulty variants of an expression."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        if name := _COMPARED.get(type(node.ops[0]).__name__):
            yield ast.Compare(node.left, [getattr(ast, name)()], node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op).__name__ in _COMBINED:
        yield ast.BinOp(node.left, getattr(ast, _COMBINED[type(node.op).__name__])(), node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            yield node.left
        if isinstance(node.op, ast.Sub | ast.Div):
            yield ast.BinOp(node.right, node.op, node.left)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield node.operand
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        is_whole = isinstance(node.value, int) or not node.value
        yield ast.Constant(node.value + 1 if is_whole else 1.5 * node.value)
    elif isinstance(node, ast.Call) and len(node.args) > 1:
        yield ast.Call(node.func, [node.args[1], node.args[0], *node.args[2:]], node.keywords)


def expressions(node: ast.AST) -> Iterator[ast.expr]:
    """Yield the expressions that run, without annotations, messages and docstrings."""
    if isinstance(node, _SILENT):
        return
    if isinstance(node, ast.expr):
        yield node
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "returns", "decorator_list", "bases"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from expressions(child)


def faults_of(raw: bytes) -> Iterator[tuple[int, slice, ast.AST]]:
    """Yield line, byte range and changed expression of each possible fault."""
    starts = [0]
    for line in raw.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in expressions(ast.parse(raw)):
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        for changed in changes(node):
            yield node.lineno, slice(begin, end), changed


class Fault(NamedTuple):
    area: str
    file: str
    line: int
    before: str
    after: str


def faults_in(area: str, file: str) -> Iterator[tuple[Fault, bytes]]:
    """Yield the possible faults of a file, and the source with each fault."""
    raw = (PACKAGE / file).read_bytes()
    for line, place, changed in faults_of(raw):
        after = f"({ast.unparse(changed)})"
        source = raw[: place.start] + after.encode() + raw[place.stop :]
        yield Fault(area, file, line, raw[place].decode(), after), source


def drawn(area: str, count: int, seed: int) -> Iterator[tuple[Fault, bytes]]:
    """Yield faults, at most one a line, and the source with each fault."""
    rng, rooms = random.Random(f"{area} {seed}"), AREAS[area][0].split()
    files = [
        p for room in rooms for p in (*PACKAGE.glob(f"{room}.py"), *(PACKAGE / room).rglob("*.py"))
    ]
    names = [p.relative_to(PACKAGE).as_posix() for p in files]
    lines = sorted({(name, fault.line) for name in names for fault, _ in faults_in(area, name)})
    rng.shuffle(lines)
    for name, line in lines[:count]:
        yield rng.choice([found for found in faults_in(area, name) if found[0].line == line])


def listed(path: Path, area: str) -> Iterator[tuple[Fault, bytes]]:
    """Yield the faults of an area in a list, where their code now stands."""
    with path.open(newline="") as rows:
        for row in csv.DictReader(rows):
            if row["area"] == area and row["result"] != "no effect":
                old = int(row["line"])
                same = [
                    (abs(fault.line - old), fault, source)
                    for fault, source in faults_in(area, row["file"])
                    if (fault.before, fault.after) == (row["before"], row["after"])
                ]
                if same:
                    yield min(same)[1:]


def tests_of_lines(database: Path) -> Table:
    """Return the tests that run each line, and under line 0 those of each file, shortest first."""
    from coverage import CoverageData

    seconds = {
        f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}": float(
            case.get("time", "inf")
        )
        for case in ElementTree.parse(database.with_suffix(".xml")).iter("testcase")
    }
    data, tests = CoverageData(str(database)), defaultdict[tuple[str, int], set[str]](set)
    data.read()
    for path in data.measured_files():
        file = Path(path).relative_to(PACKAGE).as_posix()
        for line, contexts in data.contexts_by_lineno(path).items():
            found = {context.rpartition("|")[0] for context in contexts} & seconds.keys()
            tests[file, line] |= found
            tests[file, 0] |= found
    table = Table()
    for line, found in tests.items():
        timed = sorted((seconds[test], test) for test in found)
        sums = accumulate(second for second, _ in timed)
        table[line] = [test for (_, test), sum_ in zip(timed, sums, strict=True) if sum_ < SECONDS]
    return table


def apart(call: Callable[[], int], seconds: int) -> int:
    """Return the exit status of a call in a forked process with a limit of CPU time."""
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        signal.alarm(20 * seconds)  # for processes that wait without CPU time
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1), os.dup2(null, 2)
        status = 1
        try:
            status = call()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def tried(module: Path, source: bytes, batches: list[list[str]], seconds: int) -> str:
    """Return the result of tests with a faulty module, and restore the module."""
    import pytest

    arguments = ["-xq", "-m", "not slow", "-p", "no:cacheprovider"]
    kept, compiled = module.read_bytes(), Path(cache_from_source(str(module)))
    module.write_bytes(source)
    compiled.unlink(missing_ok=True)  # Python compares times and sizes too coarsely here
    result = "not run"
    for tests in filter(None, batches):
        status = apart(lambda: int(pytest.main([*arguments, *tests])), seconds)  # noqa: B023
        if status == 0:
            result = "missed"
        elif status != 5:  # no test is selected
            is_late = -status in (signal.SIGXCPU, signal.SIGKILL, signal.SIGALRM)
            result = "too long" if is_late else "caught"
            break
    module.write_bytes(kept)
    compiled.unlink(missing_ok=True)
    return result


def check_names(table: Table, seconds: int) -> None:
    """Raise SystemExit if tests of a table no longer exist, which pytest reports as an error."""
    import pytest

    names = sorted({name for found in table.values() for name in found})
    if apart(lambda: int(pytest.main(["--collect-only", "-q", *names])), seconds):
        raise SystemExit("expected the names of existing tests; record --lines again")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--area", choices=AREAS, action="append", help="default: all areas")
    for name, default, meaning in (
        ("count", 20, "faults per area"), ("seed", 1, None), ("seconds", 300, "CPU time per fault"),
    ):  # fmt: skip
        parser.add_argument(f"--{name}", type=int, default=default, help=meaning)
    parser.add_argument("--tests", type=Path, default=ROOT / "tests", help="their folder")
    parser.add_argument("--lines", type=Path, help="coverage data: the tests that run each line")
    parser.add_argument("--again", type=Path, help="repeat the faults of this list (CSV)")
    parser.add_argument("--out", type=Path, help="append the faults and results to this list (CSV)")
    options = parser.parse_args()
    for library in LIBRARIES:
        importlib.import_module(library)
    table = tests_of_lines(options.lines) if options.lines else None
    tests, again = options.tests.resolve(), options.again and options.again.resolve()
    options.out = options.out and options.out.resolve()
    done = set()
    if options.out and options.out.exists():
        with options.out.open(newline="") as rows:
            done = {tuple(row[:-1]) for row in csv.reader(rows)}
    elif options.out:
        options.out.write_text(f"{','.join(Fault._fields)},result\n")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        sys.path[:0] = [str(copy), str(ROOT)]  # tests also import benchmarks and paper
        os.environ |= {"PYTHONPATH": str(copy), "HYPOTHESIS_STORAGE_DIRECTORY": folder}
        os.chdir(tests.parent)
        if table is not None:
            check_names(table, options.seconds)
        for area in options.area or AREAS:
            words, count = AREAS[area][1].split(), Counter[str]()
            files = [
                str(f) for f in sorted(tests.glob("test_*.py")) if any(w in f.name for w in words)
            ]
            faults = listed(again, area) if again else drawn(area, options.count, options.seed)
            for fault, source in faults:
                if tuple(map(str, fault)) in done:
                    continue
                chosen = [files]
                if table is not None:
                    found = table.get((fault.file, fault.line)) or table.get((fault.file, 0), [])
                    chosen = [found[:SHORTEST], found[SHORTEST:]]
                module = copy / "polywigner" / fault.file
                result = tried(module, source, chosen, options.seconds)
                count[result] += 1
                print(*fault, result, sep=" | ", flush=True)
                if options.out:
                    with options.out.open("a", newline="") as out:
                        csv.writer(out, lineterminator="\n").writerow([*fault, result])
            print(area, dict(count), flush=True)


if __name__ == "__main__":
    main()
