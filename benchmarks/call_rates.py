"""What does a user's call cost, as a multiple of a fixed computation in NumPy?

Default engine, NumPy arrays in and out. Each case runs in separate processes, forked after the
import of polywigner, with no compiled kernels on disk: the first call (the better of two
processes), and the median of the next calls, in turns with the peer. Times are processor seconds of
all threads, which do not depend on the load of the machine. The peer is F of a 16-gon at 4096
frequencies in NumPy, some milliseconds.

    python benchmarks/call_rates.py [--only SOURCE ...] [--functions wigner ...] [--into FILE]
                                    [--against FILE]

Adds the results to a JSON file, and prints the file as a table; ``--against`` adds ratios to
another file, and their geometric means.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pickle
import select
import shutil
import signal
import statistics
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from default_regret import SOURCES as REGRET_SOURCES
from default_regret import Case, arguments, cases

SIZES = (1, 100, 4096, 65_536, 262_144)
PROCESSES, ROUNDS, SECONDS, PATIENCE = 2, 20, 0.6, 30.0
NAMES = ("square", "chevron", "30-gon", "holes", "coastline of 300", "1000-gon",
         "tapered chevron", "8 x 8 lattice", "60 scattered", "5 slits", "pyramid")  # fmt: skip
SOURCES = REGRET_SOURCES | {
    "30-gon": lambda: pw.shapes.regular_polygon(30, 10e-3),
    "holes": lambda: pw.shapes.ring(20e-3, 12e-3, n=12),
}
REGRET_SOURCES.update(SOURCES)

Row = dict[str, float]


def peer() -> Any:
    """Return F of a 16-gon at 4096 frequencies, a sum over edges."""
    ring = np.exp(2j * np.pi * np.arange(16) / 16)
    nu = np.linspace(0.1, 9.0, 4096) * np.exp(1j * np.arange(4096))
    total = np.zeros(4096, complex)
    for a, b in zip(ring, np.roll(ring, -1), strict=True):
        turns = (nu.conj() * (a + b)).real / 2
        half = (nu.conj() * (b - a)).real
        total += (nu.conj() * (b - a)).imag * np.sinc(half) * np.exp(-2j * np.pi * turns)
    return total / (2 * np.pi * abs(nu) ** 2)


def _seconds(action: Any) -> float:
    start = time.process_time()
    action()
    return time.process_time() - start


def _measured(case: Case) -> tuple[float, float]:
    """Return the times of the first call and of the next calls over the peer's time."""
    source = SOURCES[case.source]()
    given, function = arguments(case, source), getattr(pw, case.function)
    before = [_seconds(peer) for _ in range(5)]
    first = _seconds(lambda: function(source, *given))
    peers, nexts = [_seconds(peer)], [_seconds(lambda: function(source, *given))]
    while len(nexts) < ROUNDS and sum(nexts) + sum(peers) < SECONDS:
        peers.append(_seconds(peer))
        nexts.append(_seconds(lambda: function(source, *given)))
    ratios = [ours / theirs for ours, theirs in zip(nexts, peers, strict=True)]
    return first / statistics.median(before + peers), statistics.median(ratios)


def in_child(case: Case) -> tuple[float, float]:
    """Return the times from a separate process, or infinity if it fails."""
    reader, writer = os.pipe()
    home = tempfile.mkdtemp()
    child = os.fork()
    if child == 0:
        os.close(reader)
        os.environ["HOME"] = home  # Dr.Jit stores compiled kernels there
        try:
            os.write(writer, pickle.dumps(_measured(case)))
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.close(writer)
    answer = os.read(reader, 1 << 10) if select.select([reader], [], [], PATIENCE)[0] else b""
    os.close(reader)
    if not answer:
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    shutil.rmtree(home, ignore_errors=True)
    return pickle.loads(answer) if answer else (math.inf, math.inf)


def table(rows: dict[str, Row], reference: dict[str, Row]) -> list[str]:
    """Return rows of times of the first and the next calls, with ratios in brackets."""
    lines = ["| | " + " | ".join(f"{n:,}" for n in SIZES) + " |", "|---|" + "---|" * len(SIZES)]
    groups = dict.fromkeys(key.rsplit(" | ", 1)[0] for key in rows)
    for group in groups:
        cells = []
        for n in SIZES:
            row = rows.get(f"{group} | {n}")
            text = "" if row is None else f"{row['first']:.3g} / {row['next']:.3g}"
            old = reference.get(f"{group} | {n}")
            if row is not None and old is not None:
                own = (f"{row[k] / old[k]:.2f}" for k in ("first", "next"))
                text += f" ({' / '.join(own)})"
            cells.append(text)
        lines.append(f"| {group.replace(' | ', ', ')} | " + " | ".join(cells) + " |")
    return lines


def means(rows: dict[str, Row], reference: dict[str, Row]) -> str:
    both = [(row, reference[key]) for key, row in rows.items() if key in reference]
    result = []
    for which in ("first", "next"):
        ratios = [math.log(row[which] / old[which]) for row, old in both]
        result.append(f"{which} {math.exp(statistics.fmean(ratios)):.2f}" if ratios else "")
    return f"\nGeometric means of the ratios of {len(both)} cases: " + ", ".join(result)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(NAMES), choices=NAMES)
    parser.add_argument("--functions", nargs="+", default=["wigner", "ambiguity", "fourier"])
    parser.add_argument("--layouts", nargs="+", default=["points", "one place", "outer", "grid"])
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES)
    parser.add_argument("--into", type=Path, default=Path("benchmarks/results/call_rates.json"))
    parser.add_argument("--against", type=Path)
    chosen = parser.parse_args()
    chosen.quick = False
    rows = json.loads(chosen.into.read_text()) if chosen.into.exists() else {}
    square, origin = SOURCES["square"](), np.zeros(2)
    for function, count in (("wigner", 2), ("ambiguity", 2), ("fourier", 1)):
        getattr(pw, function)(square, *[origin] * count, engine="numpy")
    for case in cases(chosen):
        result = [in_child(case) for _ in range(PROCESSES)]
        rows[str(case)] = dict(zip(("first", "next"), map(min, *result), strict=True))
        print(case, rows[str(case)], flush=True)
        chosen.into.parent.mkdir(parents=True, exist_ok=True)
        chosen.into.write_text(json.dumps(rows, indent=1) + "\n")
    reference = json.loads(chosen.against.read_text()) if chosen.against else {}
    print("\n".join(table(rows, reference)))
    if reference:
        print(means(rows, reference))


if __name__ == "__main__":
    main()
