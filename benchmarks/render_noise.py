"""How many samples per pixel are needed for an error, by sampler?

A white floor below a 10 mm square at 94 GHz, near (5 wavelengths) and far (100): rms error over
seeds at boresight, the first sidelobe and the first null along x, relative to the peak of the
irradiance, against quadrature of the same integral. The table contains the error of 1024
`independent` samples per pixel, the samples of other samplers for this error (log-interpolated),
their ratio, the cost of a sample, and the mean signed error of the line over its standard error.
The figure shows errors over samples.

    python benchmarks/render_noise.py [--seeds 16] [--out docs/images/render_noise.png]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import polywigner as pw
import polywigner.mitsuba as pwm  # before Mitsuba: selects the LLVM library

# isort: split
import mitsuba as mi

from render_floor_line import Case, floor_scene, quadrature_line, rendered

COLUMNS = 101
DISTANCES = (5.0, 100.0)
REFERENCE = 1024
SPP = (16, 64, 256, 1024, 4096)
# 'orthogonal' requires squares of primes.
SPP_OF = {"orthogonal": (25, 121, 289, 1369, 4489)}


SAMPLERS = ("independent", "multijitter", "ldsampler", "orthogonal")


def places(truth: np.ndarray) -> dict[str, int]:
    """Return the columns of boresight, the first null and the first sidelobe beyond it."""
    middle = len(truth) // 2
    right = truth[middle:]
    null = next(k for k in range(1, len(right) - 1) if right[k] <= right[k + 1])
    sidelobe = next(k for k in range(null, len(right) - 1) if right[k] >= right[k + 1])
    return {"boresight": middle, "sidelobe": middle + sidelobe, "null": middle + null}


def errors(case: Case, sampler: str, truth: np.ndarray, seeds: int) -> tuple[np.ndarray, ...]:
    """Return (spp, rms errors (spp, columns), bias over its error, CPU ns per sample)."""
    scene = floor_scene(case, COLUMNS, sampler)
    counts = SPP_OF.get(sampler, SPP)
    rms, bias, cost = [], 0.0, 0.0
    for spp in counts:
        rendered(scene, spp, 0)  # compiles
        start = time.process_time()
        runs = np.array([rendered(scene, spp, 1 + seed) for seed in range(seeds)])
        cost = (time.process_time() - start) / (seeds * spp * COLUMNS)
        result = (runs - truth) / truth.max()
        rms.append(np.sqrt((result**2).mean(axis=0)))
        each = result.mean(axis=1)
        bias = each.mean() / (each.std(ddof=1) / np.sqrt(seeds))
    return np.array(counts), np.array(rms), np.array(bias), np.array(1e9 * cost)


def about(rms: np.ndarray, column: int) -> np.ndarray:
    """Return the rms over a pixel and its equivalent neighbours, including mirrored pixels."""
    mirrored = COLUMNS - 1 - column
    return np.sqrt((rms[:, [column, mirrored]] ** 2).mean(axis=1))


def needed(counts: np.ndarray, error: np.ndarray, wanted: float) -> float:
    """Return the samples for an error, interpolated between neighbours or by the last slope."""
    x, y = np.log(counts), np.log(np.minimum.accumulate(error))
    goal = np.log(wanted)
    if goal > y[0]:
        return float(counts[0])
    k = min(int(np.searchsorted(-y, -goal)), len(y) - 1)
    slope = (x[k] - x[k - 1]) / min(y[k] - y[k - 1], -1e-9)
    return float(np.exp(x[k - 1] + slope * (goal - y[k - 1])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--out")
    options = parser.parse_args()
    mi.set_variant(pwm.choose_variant())
    mi.set_log_level(mi.LogLevel.Error)
    curves: dict[tuple[float, str, str], tuple[np.ndarray, np.ndarray]] = {}
    for distance in DISTANCES:
        case = Case("square", pw.shapes.square(0.01), distance, 0.0)
        truth = quadrature_line(case, COLUMNS)
        where = places(truth)
        print(f"\n{distance:.0f} wavelengths; irradiance over the peak at the sidelobe "
              f"{truth[where['sidelobe']] / truth.max():.1e}, at the null "
              f"{truth[where['null']] / truth.max():.1e}\n")  # fmt: skip
        print("| sampler | " + " | ".join(where) + " | ns | bias |\n|" + "---|" * 6)
        wanted: dict[str, float] = {}
        for sampler in SAMPLERS:
            counts, rms, bias, cost = errors(case, sampler, truth, options.seeds)
            cells = []
            for name, column in where.items():
                error = about(rms, column)
                curves[distance, name, sampler] = (counts, error)
                if sampler == SAMPLERS[0]:
                    wanted[name] = float(error[list(counts).index(REFERENCE)])
                    cells.append(f"{REFERENCE} ({wanted[name]:.1e})")
                else:
                    samples = needed(counts, error, wanted[name])
                    fewest = ("< ", "> ") if samples <= counts[0] else ("", "")
                    ratio = f"{fewest[1]}{REFERENCE / samples:.2g}"
                    cells.append(f"{fewest[0]}{samples:.0f} ({ratio})")
            print(f"| {sampler} | {' | '.join(cells)} | {cost:.0f} | {bias:+.1f} |", flush=True)
    if options.out:
        draw(curves, options.out)


SHOWN = {
    "independent": ("0.5", "o-"),
    "multijitter": ("C0", "s-"),
    "orthogonal": ("C2", "^-"),
}


def draw(curves: dict[tuple[float, str, str], tuple[np.ndarray, np.ndarray]], out: str) -> None:
    """Draw errors over samples, with a panel for each position and distance."""
    import matplotlib.pyplot as plt

    names = ("boresight", "sidelobe", "null")
    figure, axes = plt.subplots(2, 3, sharex=True, sharey=True, figsize=(9, 5.4))
    for row, distance in zip(axes, DISTANCES, strict=True):
        for axis, name in zip(row, names, strict=True):
            for sampler, (colour, mark) in SHOWN.items():
                axis.loglog(
                    *curves[distance, name, sampler], mark, color=colour, ms=4, label=sampler
                )
            axis.set_title(f"{name}, {distance:.0f} wavelengths", fontsize=9)
            axis.grid(alpha=0.3)
    for axis in axes[1]:
        axis.set_xlabel("samples per pixel")
    for axis in axes[:, 0]:
        axis.set_ylabel("rms error / peak")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=3, fontsize=8, frameon=False)
    figure.tight_layout(rect=(0, 0.09, 1, 1))
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main()
