"""What do receivers gain by importance sampling of small plates?

Transmitter of 10 mm, receiver of 2 mm at one position, 94 GHz; white plates 0.1 m wide. For each
scene and estimator, with equal samples: 16 plain renders of the sensor, which sample its pattern,
and `received_power`, which samples bounding boxes of the shapes. Standard errors, known to 18 %;
the error of the second against quadrature (for a wall, against the first) in its standard errors;
and the ratio of processor times.

    python benchmarks/small_targets.py [--samples 262144]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import polywigner.mitsuba as pwm  # before Mitsuba: selects the LLVM library

# isort: split
import mitsuba as mi

from receive_reference import End, of_surface
from receive_scene import Case, measured, on_plate, plate, pose, reader, scene_of, sender

SENDS, TAKES = End(0.010, pose()), End(0.002, pose())
HALF = 0.05
FACING = (0.0, 0.0, 0.0)


def quadrature(place: Any) -> float:
    """Return the power in W by reflection at a plate."""
    return of_surface(SENDS, TAKES, *on_plate(place, FACING, HALF, 4))


def scenes() -> dict[str, tuple[list[dict[str, Any]], float]]:
    """Return objects, and the power by quadrature; NaN without a reference."""
    ahead, aside, behind = (0.0, 0.0, 10.0), (3.0, 1.0, 9.0), (0.0, 0.0, 12.0)
    small, wall = plate(ahead, FACING, HALF), plate(behind, FACING, 6.0)
    hidden = plate(behind, FACING, HALF)
    return {
        "plate at 10 m": ([small], quadrature(ahead)),
        "plate off the beam": ([plate(aside, FACING, HALF)], quadrature(aside)),
        "plate, another behind": ([small, hidden], quadrature(ahead)),
        "plate and wall": ([small, wall], np.nan),
        "wall": ([wall], np.nan),
    }


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """Return the value of a second call, and its processor time; the first call compiles."""
    function()
    start = time.process_time()
    return function(), time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1 << 18)
    samples = parser.parse_args().samples
    mi.set_variant(pwm.choose_variant())
    mi.set_log_level(mi.LogLevel.Error)
    print("| scene | estimator | plain | received_power | off, errors | time |")
    print("|" + "---|" * 6)
    for name, (things, expected) in scenes().items():
        for estimator in ("exact", "wigner"):
            entries = scene_of(reader(TAKES, estimator), sender(SENDS), *things)
            plain = Case(partial(dict, entries), partial(float, expected))
            (mean, error), before = timed(partial(measured, plain, samples))
            scene = mi.load_dict(entries)
            result, after = timed(partial(pwm.received_power, scene, spp=samples))
            gap = result.scattered - (mean if np.isnan(expected) else expected)
            noise = np.hypot(result.standard_error, error if np.isnan(expected) else 0.0)
            print(
                f"| {name} | {estimator} | {error / mean:.2%} | "
                f"{result.standard_error / result.scattered:.2%} | {gap / noise:+.1f} | "
                f"{after / before:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
