"""Seed faults into the code, one at a time, and count the faults that quick tests detect.

    tools/seed_faults.py --area geometry --count 20

A fault is a changed comparison, sign, constant or logical operator, a dropped term, or two swapped
arguments. The same seed selects the same faults as long as the code does not change. Tests run
against a copy of the code until the first failure; tests that take more CPU time than --seconds
count as "too long". The option --lines names a table (JSON such as {"geometry/io/svg.py:17":
["tests/...", ...]}) of the tests that run each line. Without the table, the test files of the area
run (AREAS).
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
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
Table = dict[str, list[str]]

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


def drawn(area: str, count: int, seed: int, table: Table | None) -> Iterator[tuple[Any, bytes]]:
    """Yield faults as (path, line, before, after), at most one per line, and the faulty source."""
    rng, package = random.Random(f"{area} {seed}"), ROOT / "src/polywigner"
    rooms = AREAS[area][0].split()
    files = [
        p for room in rooms for p in (*package.glob(f"{room}.py"), *(package / room).rglob("*.py"))
    ]
    lines = {
        (p.relative_to(package).as_posix(), n) for p in files for n, *_ in faults_of(p.read_bytes())
    }
    known = sorted(lines if table is None else {x for x in lines if f"{x[0]}:{x[1]}" in table})
    for name, line in rng.sample(known, min(count, len(known))):
        raw = (package / name).read_bytes()
        _, place, changed = rng.choice([fault for fault in faults_of(raw) if fault[0] == line])
        after = f"({ast.unparse(changed)})"
        fault = (name, line, raw[place].decode(), after)
        yield fault, raw[: place.start] + after.encode() + raw[place.stop :]


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


def tried(module: Path, source: bytes, chosen: list[str], seconds: int) -> str:
    """Return the result of tests with a faulty module, and restore the module."""
    import pytest

    arguments = ["-xq", "-m", "not slow", "-p", "no:cacheprovider", *chosen]
    kept, compiled = module.read_bytes(), Path(cache_from_source(str(module)))
    module.write_bytes(source)
    compiled.unlink(missing_ok=True)  # Python compares times and sizes too coarsely here
    status = apart(lambda: int(pytest.main(arguments)), seconds) if chosen else 5
    module.write_bytes(kept)
    compiled.unlink(missing_ok=True)
    if -status in (signal.SIGXCPU, signal.SIGKILL, signal.SIGALRM):
        return "too long"
    return {0: "missed", 5: "not run"}.get(status, "caught")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--area", choices=AREAS, action="append", help="default: all areas")
    for name, default, meaning in (
        ("count", 20, "faults per area"), ("seed", 1, None), ("seconds", 300, "CPU time per fault"),
    ):  # fmt: skip
        parser.add_argument(f"--{name}", type=int, default=default, help=meaning)
    parser.add_argument("--tests", type=Path, default=ROOT / "tests", help="their folder")
    parser.add_argument("--lines", type=Path, help="JSON table of the tests that run each line")
    parser.add_argument(
        "--out", type=Path, help="JSON lines: each fault, and whether it was caught"
    )
    options = parser.parse_args()
    for library in LIBRARIES:
        importlib.import_module(library)
    table = json.loads(options.lines.read_text()) if options.lines else None
    tests = options.tests.resolve()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        sys.path.insert(0, str(copy))
        os.environ |= {"PYTHONPATH": str(copy), "HYPOTHESIS_STORAGE_DIRECTORY": folder}
        os.chdir(tests.parent)
        for area in options.area or AREAS:
            words, count = AREAS[area][1].split(), Counter()
            files = [
                str(f) for f in sorted(tests.glob("test_*.py")) if any(w in f.name for w in words)
            ]
            for fault, source in drawn(area, options.count, options.seed, table):
                chosen = [*map(str, files)] if table is None else table[f"{fault[0]}:{fault[1]}"]
                result = tried(copy / "polywigner" / fault[0], source, chosen, options.seconds)
                count[result] += 1
                print(area, *fault, result, sep=" | ", flush=True)
                if options.out:
                    with options.out.open("a") as out:
                        out.write(json.dumps([area, *fault, result]) + "\n")
            print(area, dict(count), flush=True)


if __name__ == "__main__":
    main()
