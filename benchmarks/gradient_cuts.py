"""From how many edges on are derivatives in points faster by lists of pairs than as code?

Run ``python benchmarks/gradient_cuts.py``. Gradients of W and A of regular polygons with respect to
random positions (lags) and frequencies, in double precision, with edges forced to be code of the
kernel, and found in lists of pairs: CPU seconds of the first call, which compiles, and the least of
the later ones, on one core. Kernels that an earlier run has left on disk are not compiled again:
set ``HOME`` to an empty folder to see that. Prints a Markdown table.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.plans import forced
from polywigner.toolchain.llvm import prepare

CORNERS = (12, 20, 32)
SAMPLES, CALLS, CYCLES = 200_000, 4, 5.0
TRANSFORMS: dict[str, Callable[..., Any]] = {
    "W": pw.wigner,
    "A": lambda source, x, nu: pw.ambiguity(source, nu, x),
}


def seconds(name: str, corners: int, cut: str) -> list[float]:
    """CPU seconds of each call."""
    import drjit as dr
    import drjit.llvm.ad as backend

    source, rng = pw.shapes.regular_polygon(corners, 1.0), np.random.default_rng(1)
    x = backend.Array2f64(rng.uniform(-0.5, 0.5, (2, SAMPLES)))
    nu = backend.Array2f64(rng.uniform(-CYCLES, CYCLES, (2, SAMPLES)))
    dr.eval(x, nu)
    times = []
    for _ in range(CALLS):
        start = time.process_time()
        points = [backend.Array2f64(x), backend.Array2f64(nu)]
        dr.enable_grad(points)
        with forced(cut):
            value = TRANSFORMS[name](source, *points)
            dr.backward(value if name == "W" else dr.sum(value.real) + dr.sum(value.imag))
        dr.eval([dr.grad(point) for point in points])
        dr.sync_thread()
        times.append(time.process_time() - start)
    return times


def main() -> None:
    """Measure and print."""
    prepare()
    import drjit as dr

    dr.set_thread_count(1)
    print("| transform | edges | code: first, then | pairs: first, then |")
    print("|---|---|---|---|")
    for corners in CORNERS:
        for name in TRANSFORMS:
            times = [seconds(name, corners, cut) for cut in ("code", "pairs")]
            figures = " | ".join(f"{t[0]:.2f} s, {1e3 * min(t[1:]):.0f} ms" for t in times)
            print(f"| {name} | {corners} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
