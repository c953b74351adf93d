"""What is the peak memory for 1e8 samples of W, all pairs of 1e4 positions and frequencies?

In a separate process, including Python, NumPy and LLVM.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.lines import Figure, Line, absent
from benchmarks.timing import Effort

__all__ = ["CASES", "QUESTION", "THREADS", "measure"]

QUESTION = "Peak memory of 1e8 samples"
CASES = ["square", "64-gon"]
THREADS = (None,)
SIDE, SIDE_QUICK = 10_000, 300
LIMIT = 2048.0  # MiB
ROOT = Path(__file__).resolve().parents[2]


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure the peak; the limit is 2 GiB."""
    side = SIDE_QUICK if effort.quick else SIDE
    labels: dict[str, Any] = {
        "question": "memory", "case": case, "precision": "single", "threads": 1, "unit": "MiB",
    }  # fmt: skip
    command = [sys.executable, "-m", "benchmarks.questions.memory", case, str(side)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        return [absent(labels, "asked for", "no peak to be had on this system")]
    peak = float(done.stdout.split()[-1])
    ours, ratio = Figure(peak, peak), LIMIT / peak
    note = f"the result alone: {side**2 * 4 / 2**20:.0f} MiB"
    limit = Figure(LIMIT, LIMIT)
    return [
        Line(**labels, ours=ours, peer="asked for", theirs=limit, ratio=ratio, ratio_median=ratio,
             target=1.0, note=note)
    ]  # fmt: skip


def main() -> None:
    """Print the peak of this process in MiB."""
    import resource  # not on Windows

    import polywigner as pw
    from benchmarks.questions import wigner

    case, side = sys.argv[1], int(sys.argv[2])
    source = wigner.SOURCES[case]()
    x, nu = wigner.points(source, side)
    values = pw.wigner(source, x[:, None], nu[None, :], precision="single")
    assert values.shape == (side, side)
    unit = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, in bytes
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20)


if __name__ == "__main__":
    main()
