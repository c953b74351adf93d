"""A task in a separate process, with environment variables that libraries read at import.

``python -m benchmarks.worker QUESTION CASE THREADS quick|full`` prints the lines as JSON; 0 threads
are all cores.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from benchmarks.lines import Line, absent
from benchmarks.questions import Task, module_of
from benchmarks.timing import FULL, QUICK, cores

__all__ = ["done_by_child"]

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 900  # seconds until a process counts as hanging
_POOLS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_ONE_THREAD_OF_XLA = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


def done_by_child(task: Task, quick: bool) -> list[Line]:
    """Return the lines of a task, or a line that reports a failed process."""
    threads = task.threads or cores()
    environment = {**os.environ, **dict.fromkeys(_POOLS, str(threads))}
    if threads == 1:
        flags = f"{environment.get('XLA_FLAGS', '')} {_ONE_THREAD_OF_XLA}"
        environment["XLA_FLAGS"] = flags.strip()
    command = [sys.executable, "-m", "benchmarks.worker", task.question, task.case]
    command += [str(task.threads or 0), "quick" if quick else "full"]
    try:
        done = subprocess.run(
            command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT
        )
        if done.returncode == 0:
            result = json.loads(done.stdout.splitlines()[-1])
            return [Line.from_json(line) for line in result]
        reason = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
    except subprocess.TimeoutExpired:
        reason = f"no end within {LIMIT} s"
    labels = {"question": task.question, "case": task.case, "precision": "-"}
    return [absent(labels | {"threads": threads, "unit": ""}, "-", f"failed: {reason}")]


def main() -> None:
    """Run the task of this process."""
    question, case, threads, effort = sys.argv[1:]
    if threads == "1" and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    from polywigner.llvm import prepare

    if prepare().usable:
        import drjit as dr

        dr.set_thread_count(int(threads) or cores())
    module = module_of(question)
    lines = module.measure(case, int(threads) or None, QUICK if effort == "quick" else FULL)
    if effort == "quick":  # too short for a verdict
        lines = [replace(line, target=None) for line in lines]
    print(json.dumps([line.as_json() for line in lines]))


if __name__ == "__main__":
    main()
