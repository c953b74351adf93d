"""Which fraction of the peak rate of one core does the kernel of W reach?

Arithmetic instructions per second (multiply-adds, products, sums, quotients and roundings, without
comparisons and selections), against the multiply-adds of an empty loop.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from benchmarks.lines import Line, absent, as_rates, line_of
from benchmarks.peers import cpp
from benchmarks.questions import wigner
from benchmarks.timing import Action, Effort, fitting, in_turns
from polywigner.llvm import prepare

__all__ = ["CASES", "QUESTION", "THREADS", "arithmetic", "measure"]

QUESTION = "Arithmetic instructions per second"
CASES = ["square", "chevron", "two chevrons"]
THREADS = (1,)
_ARITHMETIC = re.compile(
    r"= (?:fadd|fsub|fmul|fdiv) |call [^@]*@llvm\.(?:fma|nearbyint|sqrt|rint|roundeven)\."
)


def arithmetic(action: Action) -> int:
    """Return the instructions per sample of the kernels that an action launches, from LLVM code."""
    import drjit as dr

    action()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        action()
        history = dr.kernel_history()
    largest = max(entry.get("size", 0) for entry in history)
    kernels = [entry for entry in history if entry.get("size") == largest and entry.get("ir")]
    return sum(len(_ARITHMETIC.findall(entry["ir"].getvalue())) for entry in kernels)


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure the kernel in turns with the loop."""
    lines = []
    for precision in ("single", "double"):
        labels: dict[str, Any] = {"question": "peak", "case": case, "precision": precision}
        labels |= {"threads": 1, "unit": "G/s"}
        if not prepare().usable:
            lines.append(absent(labels, "loop of multiply-adds", "needs LLVM (polywigner doctor)"))
            continue
        source = wigner.SOURCES[case]()
        method = wigner.in_engine(source, precision, 1)

        def make(count: int, method: Any = method, source: Any = source) -> Action:
            return method(*wigner.points(source, count))

        action, count = fitting(make, effort)
        per_sample = arithmetic(action)
        loop, amount, name = _loop(precision)
        times = in_turns({"ours": action, name: loop}, effort.rounds)
        own = per_sample * count / 1e9
        lines.append(
            line_of(
                labels,
                name,
                (as_rates(times["ours"], own), times["ours"], own),
                (as_rates(times[name], amount / 1e9), times[name], amount / 1e9),
                note=f"{per_sample} instructions a sample",
            )
        )
    return lines


def _loop(precision: str) -> tuple[Action, float, str]:
    """Return a call that does multiply-adds, their number, and its name."""
    if cpp.compiler():
        run: Callable[[], float] = cpp.multiply_adds(precision)
        return run, run(), "loop of multiply-adds, C++"
    import drjit as dr
    import drjit.llvm as backend

    kind = backend.Float if precision == "single" else backend.Float64
    chains, length, lanes = 12, 200, 1 << 16
    factor, addend = dr.opaque(kind, 0.999), dr.opaque(kind, 0.001)

    def loop() -> None:
        values = [dr.arange(kind, lanes) + k for k in range(chains)]
        for _ in range(length):
            values = [dr.fma(value, factor, addend) for value in values]
        dr.eval(sum(values))
        dr.sync_thread()

    return loop, float(chains * length * lanes), "loop of multiply-adds, Dr.Jit"
