"""The whole comparison in one go: ``python -m benchmarks``, or ``make bench``.

Every question is asked of every case, each in a process of its own, in which polywigner and its
peers take turns. Peers that are not installed are said to be so. Writes comparison.md,
comparison.json, rates.png and ratios.png.
"""

from __future__ import annotations

import argparse
import datetime
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks import machine, plots, report
from benchmarks.lines import Line
from benchmarks.questions import NAMES, module_of, tasks
from benchmarks.timing import cores
from benchmarks.worker import done_by_child

RESULTS = Path(__file__).resolve().parent / "results"


def main() -> int:
    """Measure, write, say where; 1 if a process failed."""
    options = _options()
    if options.list:
        for name in NAMES:
            print(f"{name:12} {module_of(name).QUESTION}: {'; '.join(module_of(name).CASES)}")
        return 0
    facts = {
        "date": datetime.date.today().isoformat(),
        "quick": options.quick,
        "machine": machine.facts(),
        "libraries": list(machine.LIBRARIES),
    }
    start = time.perf_counter()
    lines = _measured(options)
    facts["seconds"] = round(time.perf_counter() - start)
    paths = report.written(options.out, lines, facts) + plots.drawn(options.out, lines)
    print(report.markdown(lines, facts))
    print("\n".join(f"wrote {path}" for path in paths), file=sys.stderr)
    return int(any(line.note.startswith("failed") for line in lines))


def _options() -> Any:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one small case of each question")
    parser.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES), metavar="QUESTION")
    parser.add_argument("--case", help="only cases whose name contains this")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder (benchmarks/results)")
    parser.add_argument("--list", action="store_true", help="list the questions and their cases")
    return parser.parse_args()


def _measured(options: Any) -> list[Line]:
    from rich.console import Console
    from rich.progress import Progress

    chosen = tasks(options.only, cores(), options.quick)
    chosen = [task for task in chosen if not options.case or options.case in task.case]
    lines: list[Line] = []
    terminal = Console(stderr=True)
    with Progress(console=terminal, disable=not terminal.is_terminal) as progress:
        bar = progress.add_task("", total=len(chosen))
        for task in chosen:
            where = "all cores" if task.threads is None else f"{task.threads} core"
            progress.update(bar, description=f"{task.question}: {task.case}, {where}")
            lines += done_by_child(task, options.quick)
            progress.advance(bar)
    return lines


if __name__ == "__main__":
    sys.exit(main())
