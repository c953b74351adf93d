"""Contenders that take turns in one process, and statistics of their times."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = [
    "FULL",
    "QUICK",
    "Action",
    "Effort",
    "cores",
    "fitting",
    "in_turns",
    "load_average",
    "median_ratio",
]

Action = Callable[[], Any]

FEWEST = 1 << 3
# A call is long enough if eight times the samples do not reduce its cost per sample.
STEADY = 0.7
PATIENCE = 0.1  # seconds
FEW_ROUNDS, LONG = 3, 1.0  # seconds
# Threads of a pool wait actively for a while after their last task, and would disturb the next
# contender.
REST = 0.1  # seconds


@dataclass(frozen=True)
class Effort:
    """Limits of the work for a question."""

    rounds: int
    """Turns of every contender."""
    seconds: float
    """Intended duration of one call."""
    most: int
    """Samples of one call, at most."""
    checked: int
    """Places at which errors are measured."""
    quick: bool = False


FULL = Effort(rounds=15, seconds=0.03, most=1 << 22, checked=20)
QUICK = Effort(rounds=3, seconds=0.003, most=1 << 16, checked=4, quick=True)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def load_average() -> float:
    """Return the load average of the last minute, or 0 if the system has none."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0


def clock_for(threads: int) -> Callable[[], float]:
    """Return CPU time for one thread, or wall-clock time for more threads."""
    return time.process_time if threads == 1 else time.perf_counter


def in_turns(
    actions: Mapping[str, Action], rounds: int, threads: int = 1
) -> dict[str, list[float]]:
    """Return seconds of every call, in the order of the rounds, after one call of each.

    Slow contenders take part in a few rounds only.
    """
    clock = clock_for(threads)
    times: dict[str, list[float]] = {name: [] for name in actions}
    for action in actions.values():
        action()
    for turn in range(rounds):
        for name, action in actions.items():
            if turn >= FEW_ROUNDS and sum(times[name]) > LONG:
                continue
            if threads > 1:
                time.sleep(REST)
                action()  # wakes its threads
            start = clock()
            action()
            times[name].append(clock() - start)
    return times


def fitting(make: Callable[[int], Action], effort: Effort, threads: int = 1) -> tuple[Action, int]:
    """Return an action whose number of samples, a power of two, makes a call long enough.

    The fixed cost of a call is then negligible.
    """
    clock = clock_for(threads)
    count, before = min(FEWEST, effort.most), float("inf")
    while True:
        action = make(count)
        action()  # compiles
        start = clock()
        action()
        took = max(clock() - start, 1e-6)
        steady = took / count > STEADY * before
        if count == effort.most or (took > effort.seconds and steady) or took > PATIENCE:
            break
        before, count = took / count, min(count << 3, effort.most)
    while took < effort.seconds / 1.5 and count < effort.most:
        count, took = count << 1, took * 2
    return make(count), count


def median_ratio(theirs: Sequence[float], ours: Sequence[float]) -> float:
    """Return the median ratio of times over the rounds of both."""
    return statistics.median(b / a for a, b in zip(ours, theirs, strict=False))
