"""How many samples does a pixel need for a stated error, by sampler and control variate?

A white floor under a 10 mm square at 94 GHz, near (5 wavelengths) and far (100): rms error over
seeds at boresight, the first sidelobe and the first null along x, over the peak of the irradiance,
against quadrature of the same integral. In the table: the error of `independent` samples
at 1024 per pixel, how many samples other methods need for that error (log-interpolated), how many
times fewer that is, the cost of a sample, and the mean signed error of the line over its own error.
The last lines measure the bias of the control variate where it is not meant for: in the shadow
edge of a screen halfway, and on a glossy floor. The figure shows errors against samples.

    python benchmarks/render_noise.py [--seeds 16] [--out docs/images/render_noise.png]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import polywigner as pw
import polywigner.mitsuba as pwm  # before Mitsuba: it chooses the LLVM library

# isort: split
import mitsuba as mi

from render_floor_line import Case, floor_scene, quadrature_line, rendered

COLUMNS = 101
DISTANCES = (5.0, 100.0)
REFERENCE = 1024
SPP = (16, 64, 256, 1024, 4096)
# 'orthogonal' takes squares of primes.
SPP_OF = {"orthogonal": (25, 121, 289, 1369, 4489)}


@dataclass(frozen=True)
class Route:
    """How samples are drawn."""

    sampler: str
    control_variate: bool = False

    @property
    def name(self) -> str:
        more = " + control variate" if self.control_variate else ""
        return f"{self.sampler}{more}"

    @property
    def options(self) -> dict[str, Any]:
        return {"control_variate": self.control_variate}


WAYS = (
    Route("independent"),
    Route("multijitter"),
    Route("ldsampler"),
    Route("orthogonal"),
    Route("independent", control_variate=True),
    Route("multijitter", control_variate=True),
    Route("orthogonal", control_variate=True),
)


def places(truth: np.ndarray) -> dict[str, int]:
    """Columns of boresight, the first null and the first sidelobe beyond it."""
    middle = len(truth) // 2
    right = truth[middle:]
    null = next(k for k in range(1, len(right) - 1) if right[k] <= right[k + 1])
    sidelobe = next(k for k in range(null, len(right) - 1) if right[k] >= right[k + 1])
    return {"boresight": middle, "sidelobe": middle + sidelobe, "null": middle + null}


def errors(case: Case, way: Route, truth: np.ndarray, seeds: int) -> tuple[np.ndarray, ...]:
    """(spp, rms errors (spp, columns), bias over its error, CPU ns a sample) of one method."""
    scene = floor_scene(case, COLUMNS, way.sampler, **way.options)
    counts = SPP_OF.get(way.sampler, SPP)
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
    """At a point: rms over its pixel and the neighbours of equal footing, mirrored ones too."""
    mirrored = COLUMNS - 1 - column
    return np.sqrt((rms[:, [column, mirrored]] ** 2).mean(axis=1))


def needed(counts: np.ndarray, error: np.ndarray, wanted: float) -> float:
    """Samples to an error, on the line between the two nearest, or along the last slope."""
    x, y = np.log(counts), np.log(np.minimum.accumulate(error))
    goal = np.log(wanted)
    if goal > y[0]:
        return float(counts[0])
    k = min(int(np.searchsorted(-y, -goal)), len(y) - 1)
    slope = (x[k] - x[k - 1]) / min(y[k] - y[k - 1], -1e-9)
    return float(np.exp(x[k - 1] + slope * (goal - y[k - 1])))


def shadow_edge(way: Route, distance: float) -> np.ndarray:
    """Mean over seeds of a line that a screen halfway to the floor shades for x > 0."""
    case = Case("square", pw.shapes.square(0.01), distance, 0.0)
    z = case.z / 1e-3
    transform = mi.ScalarTransform4f()
    screen = {
        "type": "rectangle",
        "to_world": transform.translate([z, 0, 0.5 * z]).scale([z, 4 * z, 1]),
    }
    scene = floor_scene(case, COLUMNS, way.sampler, more={"screen": screen}, **way.options)
    return np.mean([rendered(scene, 4096, seed) for seed in range(8)], axis=0)


def glossy(way: Route, distance: float) -> np.ndarray:
    """The same on a floor of rough metal."""
    case = Case("square", pw.shapes.square(0.01), distance, 0.0)
    bsdf = {"type": "roughconductor", "alpha": 0.1, "material": "none"}
    scene = floor_scene(case, COLUMNS, way.sampler, bsdf=bsdf, **way.options)
    return np.mean([rendered(scene, 4096, seed) for seed in range(8)], axis=0)


def bias_lines() -> None:
    """Print the bias of the control variate where receivers are shaded or glossy."""
    plain, varied = Route("multijitter"), Route("multijitter", control_variate=True)
    for distance in DISTANCES:
        for name, scene in (("shadow edge", shadow_edge), ("glossy floor", glossy)):
            own, other = scene(plain, distance), scene(varied, distance)
            worst = np.abs(other - own).max() / np.abs(own).max()
            print(f"control variate, {name} at {distance:.0f} wavelengths: {worst:.1e} of the peak")


def main() -> None:
    """Measure, print Markdown tables, and draw."""
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
        print("| way | " + " | ".join(where) + " | ns | bias |\n|" + "---|" * 6)
        wanted: dict[str, float] = {}
        for way in WAYS:
            counts, rms, bias, cost = errors(case, way, truth, options.seeds)
            cells = []
            for name, column in where.items():
                error = about(rms, column)
                curves[distance, name, way.name] = (counts, error)
                if way == WAYS[0]:
                    wanted[name] = float(error[list(counts).index(REFERENCE)])
                    cells.append(f"{REFERENCE} ({wanted[name]:.1e})")
                else:
                    samples = needed(counts, error, wanted[name])
                    fewest = ("< ", "> ") if samples <= counts[0] else ("", "")
                    ratio = f"{fewest[1]}{REFERENCE / samples:.2g}"
                    cells.append(f"{fewest[0]}{samples:.0f} ({ratio})")
            print(f"| {way.name} | {' | '.join(cells)} | {cost:.0f} | {bias:+.1f} |", flush=True)
    bias_lines()
    if options.out:
        draw(curves, options.out)


SHOWN = {
    "independent": ("0.5", "o-"),
    "multijitter": ("C0", "s-"),
    "orthogonal": ("C2", "^-"),
    "multijitter + control variate": ("C1", "D-"),
}


def draw(curves: dict[tuple[float, str, str], tuple[np.ndarray, np.ndarray]], out: str) -> None:
    """Errors against samples, one panel for each position and distance."""
    import matplotlib.pyplot as plt

    names = ("boresight", "sidelobe", "null")
    figure, axes = plt.subplots(2, 3, sharex=True, sharey=True, figsize=(9, 5.4))
    for row, distance in zip(axes, DISTANCES, strict=True):
        for axis, name in zip(row, names, strict=True):
            for way, (colour, mark) in SHOWN.items():
                axis.loglog(*curves[distance, name, way], mark, color=colour, ms=4, label=way)
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
