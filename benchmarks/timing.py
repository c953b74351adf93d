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
# A call whose cost per sample does not fall below this with eight times as many is long enough.
STEADY = 0.7
PATIENCE = 0.1  # seconds
FEW_ROUNDS, LONG = 3, 1.0  # seconds
# Threads of a pool look out for work for a while after the last; whoever comes next would share the
# cores with them.
REST = 0.1  # seconds


@dataclass(frozen=True)
class Effort:
    """How much work a question may be given."""

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
    """How many cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def load_average() -> float:
    """How many processes wanted to run in the last minute; 0 where the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0


def clock_for(threads: int) -> Callable[[], float]:
    """CPU time for one thread, which a busy machine disturbs less; else the clock on the wall."""
    return time.process_time if threads == 1 else time.perf_counter


def in_turns(
    actions: Mapping[str, Action], rounds: int, threads: int = 1
) -> dict[str, list[float]]:
    """Seconds of every call, in the order of the rounds; after one call of each.

    Who has taken long enough after a few rounds sits out the others.
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
                action()  # wakes its own threads
            start = clock()
            action()
            times[name].append(clock() - start)
    return times


def fitting(make: Callable[[int], Action], effort: Effort, threads: int = 1) -> tuple[Action, int]:
    """Return an action whose number of samples, a power of two, makes a call long enough.

    The fixed cost of a call is then small, so more samples would not be cheaper per sample.
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
    """The median, over the rounds that both had, of how many times as long they took."""
    return statistics.median(b / a for a, b in zip(ours, theirs, strict=False))
