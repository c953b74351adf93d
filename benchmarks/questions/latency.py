"""How long do the import, the first call, the next process and the next call take?

Separate processes. "First call" starts after ``import polywigner`` and includes loading of Dr.Jit
or JAX, compilation, and 1000 samples of W; Dr.Jit stores its compiled kernels on disk for the next
process. CPU time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.lines import Line, absent, as_times, line_of
from benchmarks.timing import Effort

__all__ = ["CASES", "QUESTION", "THREADS", "measure"]

QUESTION = "Seconds until an answer"
IMPORT = "import"
FIRST, NEXT, AGAIN = "first call", "first call of the next process", "next call"
CASES = [IMPORT, "square", "chevron"]
THREADS = (1,)
SAMPLES = 1000
FEWER_ROUNDS = 4
IMPORTED = ("numpy", "shapely", "jax")
ROOT = Path(__file__).resolve().parents[2]


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure processes in turns."""
    rounds = max(2, effort.rounds // FEWER_ROUNDS)
    return _imports(rounds) if case == IMPORT else _calls(case, rounds)


def _labels(case: str, precision: str) -> dict[str, Any]:
    labels = {"question": "latency", "case": case, "precision": precision, "threads": 1}
    return labels | {"unit": "s"}


def _imports(rounds: int) -> list[Line]:
    result: dict[str, list[float]] = {name: [] for name in ("polywigner", *IMPORTED)}
    missing = {name for name in result if not _runs(f"import {name}")}
    for _ in range(rounds):
        for name in result.keys() - missing:
            result[name].append(_cpu_seconds(f"import {name}") - _cpu_seconds("pass"))
    entries = {
        name: (as_times(times, 1.0), times, 1.0)
        for name, times in result.items()
        if name not in missing
    }
    labels, ours = _labels(IMPORT, "-"), entries["polywigner"]
    return [
        absent(labels, f"import {name}", "not installed", ours[0])
        if name in missing
        else line_of(labels, f"import {name}", ours, entries[name])
        for name in IMPORTED
    ]


def _runs(code: str) -> bool:
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


def _cpu_seconds(code: str) -> float:
    before = _children()
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    return _children() - before


def _children() -> float:
    """Return CPU seconds of finished processes, or wall-clock time if the system has none."""
    try:
        import resource
    except ImportError:
        return time.perf_counter()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _calls(case: str, rounds: int) -> list[Line]:
    from benchmarks.peers import jax_kernel
    from polywigner.llvm import prepare

    lines = []
    for precision in ("single", "double"):
        if not prepare().usable:
            lines.append(absent(_labels(f"{case}, {FIRST}", precision), "JAX", "needs LLVM"))
            continue
        ours: dict[str, list[float]] = {FIRST: [], NEXT: [], AGAIN: []}
        theirs: dict[str, list[float]] = {FIRST: [], NEXT: [], AGAIN: []}
        for _ in range(rounds):
            _add(ours, case, precision, "ours")
            if jax_kernel.available():
                _add(theirs, case, precision, "jax")
        for which, times in ours.items():
            labels, own = _labels(f"{case}, {which}", precision), (as_times(times, 1.0), times, 1.0)
            if not theirs[which]:
                lines.append(absent(labels, "JAX", "not installed (pip install jax)", own[0]))
                continue
            other = as_times(theirs[which], 1.0), theirs[which], 1.0
            lines.append(line_of(labels, "JAX", own, other))
    return lines


def _add(result: dict[str, list[float]], case: str, precision: str, who: str) -> None:
    """Add the results of two processes with an empty folder for compiled kernels."""
    with tempfile.TemporaryDirectory() as home:
        first, again = _process(case, precision, who, home)
        later, _ = _process(case, precision, who, home)
    for which, seconds in ((FIRST, first), (NEXT, later), (AGAIN, again)):
        result[which].append(seconds)


def _process(case: str, precision: str, who: str, home: str) -> list[float]:
    command = [sys.executable, "-m", "benchmarks.questions.latency", case, precision, who]
    places = dict.fromkeys(("HOME", "LOCALAPPDATA"), home)  # Dr.Jit stores its kernels there
    environment = {**os.environ, **_verdict(), **places}
    done = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, check=True
    )
    return list(json.loads(done.stdout.splitlines()[-1]))


def _verdict() -> dict[str, str]:
    """Return the folder of the cached LLVM test, so that an empty home does not repeat the test."""
    kept = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return {"XDG_CACHE_HOME": kept}


def main() -> None:
    """Print the seconds of the first and of the second call of a process."""
    from benchmarks.questions import wigner

    case, precision, who = sys.argv[1:]
    source = wigner.SOURCES[case]()
    x, nu = wigner.points(source, SAMPLES)
    times = []
    start = time.process_time()
    if who == "ours":
        call = wigner.through_numpy(source, precision, "llvm")(x, nu)
    else:
        call = wigner.in_jax(source, precision)(x, nu)
    for _ in range(2):
        call()
        times.append(time.process_time() - start)
        start = time.process_time()
    print(json.dumps(times))


if __name__ == "__main__":
    main()
