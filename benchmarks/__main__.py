"""Run the complete comparison: ``python -m benchmarks``, or ``make bench``.

Each case of each question runs in a separate process, in which polywigner and its peers take turns.
Peers that are not installed are listed. Writes comparison.md, comparison.json, rates.png and
ratios.png.
"""

from __future__ import annotations

import argparse
import datetime
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks import machine, plots, report
from benchmarks.lines import Line
from benchmarks.questions import NAMES, Task, module_of, tasks
from benchmarks.timing import cores
from benchmarks.worker import done_by_child

RESULTS = Path(__file__).resolve().parent / "results"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all cases and write the results; return 1 if a process failed."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.list:
        for name in NAMES:
            print(f"{name:12} {module_of(name).QUESTION}: {'; '.join(module_of(name).CASES)}")
        return 0
    chosen = [
        task
        for task in tasks(options.only, cores(), options.quick)
        if not options.case or options.case in task.case
    ]
    if not chosen:
        parser.error(f"expected a --case that there is, got {options.case!r}; see --list")
    try:  # before half an hour of work
        report.check_writable(options.out)
    except OSError as error:
        parser.error(f"expected a folder to write into, got {options.out}: {error.strerror}")
    facts = {
        "date": datetime.date.today().isoformat(),
        "quick": options.quick,
        "machine": machine.facts(),
        "libraries": list(machine.LIBRARIES),
    }
    start = time.perf_counter()
    lines = _measured(chosen, options.quick)
    facts["seconds"] = round(time.perf_counter() - start)
    paths = report.written(options.out, lines, facts) + plots.drawn(options.out, lines)
    print(report.markdown(lines, facts))
    print("\n".join(f"wrote {path}" for path in paths), file=sys.stderr)
    return int(any(line.note.startswith("failed") for line in lines))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one small case of each question")
    parser.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES), metavar="QUESTION")
    parser.add_argument("--case", help="only cases whose name contains this")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder (benchmarks/results)")
    parser.add_argument("--list", action="store_true", help="list the questions and their cases")
    return parser


def _measured(chosen: Sequence[Task], quick: bool) -> list[Line]:
    from rich.console import Console
    from rich.progress import Progress

    lines: list[Line] = []
    terminal = Console(stderr=True)
    with Progress(console=terminal, disable=not terminal.is_terminal) as progress:
        bar = progress.add_task("", total=len(chosen))
        for task in chosen:
            where = "all cores" if task.threads is None else f"{task.threads} core"
            progress.update(bar, description=f"{task.question}: {task.case}, {where}")
            lines += done_by_child(task, quick)
            progress.advance(bar)
    return lines


if __name__ == "__main__":
    sys.exit(main())
