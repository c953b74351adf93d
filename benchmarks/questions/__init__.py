"""The questions of the comparison, each a module.

``QUESTION`` is its heading, ``CASES`` what it is asked of, ``THREADS`` with how many threads (None:
all cores), and ``measure(case, threads, effort)`` gives the lines of one case.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

__all__ = ["NAMES", "Task", "module_of", "tasks"]

# In the order of the report. The last case of a quick run is the first of a full one.
NAMES = (
    "wigner", "peak", "fourier", "otf", "emitter", "near_field", "latency", "memory", "polyhedra",
)  # fmt: skip


@dataclass(frozen=True)
class Task:
    """What one process measures."""

    question: str
    case: str
    threads: int | None
    """None: all cores."""


def module_of(name: str) -> Any:
    """The module of a question."""
    return import_module(f"benchmarks.questions.{name}")


def tasks(names: Iterable[str], cores: int, quick: bool = False) -> list[Task]:
    """All there is to measure; of a quick run the first case of each question, on one core."""
    result = []
    for name in names:
        module = module_of(name)
        threads = [t for t in module.THREADS if t is not None or cores > 1] or [1]
        cases = module.CASES[:1] if quick else module.CASES
        threads = threads[:1] if quick else threads
        result += [Task(name, case, count) for count in threads for case in cases]
    return result
