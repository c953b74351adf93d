"""The questions of the comparison, each a module.

``QUESTION`` is the heading, ``CASES`` are the cases, ``THREADS`` the numbers of threads (None: all
cores), and ``measure(case, threads, effort)`` returns the lines of a case.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

__all__ = ["NAMES", "Task", "module_of", "tasks"]

# In the order of the report. A quick run measures the first case of a full run.
NAMES = (
    "wigner", "peak", "fourier", "otf", "emitter", "near_field", "latency", "memory", "polyhedra",
)  # fmt: skip


@dataclass(frozen=True)
class Task:
    """The measurement of a process."""

    question: str
    case: str
    threads: int | None
    """None: all cores."""


def module_of(name: str) -> Any:
    """Return the module of a question."""
    return import_module(f"benchmarks.questions.{name}")


def tasks(names: Iterable[str], cores: int, quick: bool = False) -> list[Task]:
    """Return all measurements, or for a quick run the first case of each question on one core."""
    result = []
    for name in names:
        module = module_of(name)
        threads = [t for t in module.THREADS if t is not None or cores > 1] or [1]
        cases = module.CASES[:1] if quick else module.CASES
        threads = threads[:1] if quick else threads
        result += [Task(name, case, count) for count in threads for case in cases]
    return result
