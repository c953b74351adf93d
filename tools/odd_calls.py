#!/usr/bin/env python3
"""Odd values for every argument of the public functions: a result, or one error of the package.

    python tools/odd_calls.py [--count N] [--seed S]

Each call is a plain one in which one or two arguments are replaced. It runs in a process that is
begun anew when it dies; an exception that is not the package's own (TypeError for a wrong number of
arguments is Python's), a warning of NumPy's or the end of the process is a fault. Prints counts by
function and the longest call; the exit status is 1 if there was a fault.
"""

from __future__ import annotations

import argparse
import multiprocessing
import pickle
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from datetime import datetime
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.errors import PolywignerError, PolywignerWarning

COUNT, BATCH = 10_000, 500
LONGEST = 60.0
"""Seconds for a call, on a machine that does other work as well."""

SQUARE, SLITS = pw.shapes.square(0.01), pw.Slits([[0.0, 0.01]])
ARRAY = pw.phased_array(SQUARE, [[0.0, 0.0], [0.02, 0.0]])
TAPERED = SQUARE.with_illumination(pw.cosine_taper(0.01, 0.01))
X, NU, XYZ = np.zeros((3, 2)), np.full((3, 2), 40.0), np.full((3, 3), 0.1)

CALLS: dict[str, tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]] = {
    "Aperture": (pw.Aperture, ([[0, 0], [1, 0], [0, 1]],), {}),
    "Slits": (pw.Slits, ([[0.0, 1.0]],), {}),
    "Array": (pw.Array, ([SQUARE], [1.0]), {}),
    "Illumination": (pw.Illumination, ([1.0], [[0.0, 0.0]]), {}),
    "phased_array": (pw.phased_array, (SQUARE, [[0, 0], [1, 0]]), {"weights": None}),
    "steering": (pw.steering, ([0.3, 0.1], 0.003), {}),
    "cosine_taper": (pw.cosine_taper, (0.01, 0.01), {}),
    "taylor_taper": (pw.taylor_taper, (0.01, 0.01), {}),
    "square": (pw.shapes.square, (0.01,), {}),
    "regular_polygon": (pw.shapes.regular_polygon, (6, 0.01), {}),
    "fourier": (pw.fourier, (SQUARE, NU), {"precision": None, "engine": "auto"}),
    "wigner": (pw.wigner, (SQUARE, X, NU), {"precision": None, "engine": "auto"}),
    "wigner of slits": (pw.wigner, (SLITS, 0.005, 10.0), {"engine": "auto"}),
    "wigner of an array": (pw.wigner, (ARRAY, X, NU), {"engine": "auto"}),
    "ambiguity": (pw.ambiguity, (TAPERED, NU, X), {"engine": "auto"}),
    "autocorrelation": (pw.autocorrelation, (SQUARE, X, X), {"engine": "auto"}),
    "position_marginal": (pw.position_marginal, (SQUARE, X), {}),
    "lag_marginal": (pw.lag_marginal, (SQUARE, X), {}),
    "otf": (pw.otf, (SQUARE, X), {"defocus": 0.0, "pupil_radius": None}),
    "amplitude": (pw.amplitude, (SQUARE, XYZ, 0.003), {"method": "kirchhoff"}),
    "irradiance": (pw.irradiance, (SQUARE, XYZ, 0.003), {"method": "fresnel"}),
    "radiance": (pw.radiance, (SQUARE, X, [0.0, 0.0, 1.0], 0.003), {}),
    "radiant_intensity": (pw.radiant_intensity, (SQUARE, [0.0, 0.0, 1.0], 0.003), {}),
    "power": (pw.power, (SQUARE, 0.003), {}),
    "flux_vector": (pw.flux_vector, (SQUARE, XYZ, 0.003), {}),
    "explain": (pw.explain, (SQUARE, X, NU), {"function": "wigner"}),
    "automean": (pw.automean, (SQUARE,), {}),
    "lag_slice": (pw.lag_slice, (SQUARE, [0.0, 0.0]), {}),
    "suggest_sampling": (pw.suggest_sampling, (SQUARE, 0.003, "intensity"), {"error_db": 1.0}),
    "read_aperture": (pw.read_aperture, ("no-such-file.svg",), {"unit": "mm", "layer": None}),
}


def odd_values() -> list[Any]:
    """Values that stand for no argument, or for one at the edge of what is allowed."""
    ragged: Any = [[1.0, 2.0], [3.0]]
    return [
        None, True, 0, -1, 1e-320, 1e308, np.nan, np.inf, -np.inf, 10**400, 1j, "", "junk", "1 mm",
        "a\nb", "\0", b"bytes", [], [[]], (), {}, set(), object(), lambda: 1, type,
        NotImplemented, Fraction(1, 3), Decimal("0.1"), datetime(2020, 1, 1), Path("x"), range(3),
        iter([1.0]), np.float32(0.003), SQUARE, SLITS, ARRAY, np.dtype("f8"), slice(1, 2), ragged,
        np.array([]), np.zeros((0, 2)), np.zeros((2, 0)), np.zeros((3, 5)), np.zeros((2, 2, 2, 2)),
        np.array(["a", "b"]), np.array([None, 1.0]), np.array([1, 2], "M8[s]"), np.array([1j, 2]),
        np.ma.masked_array([1.0, 2.0], [True, False]), np.matrix([[1.0, 2.0]]),
        np.full((3, 2), np.nan), np.full((3, 2), 1e300), np.zeros((3, 2), np.float16),
        np.zeros((3, 2), np.int8), np.array([True, False]),
        np.broadcast_to(np.float64(0.0), (3, 2)), np.arange(12.0).reshape(6, 2)[::-2],
    ]  # fmt: skip


def changed(number: int, seed: int) -> tuple[str, tuple[Any, ...], dict[str, Any], str]:
    """Name, arguments and keywords of a call, and what is odd about it."""
    rng = np.random.default_rng([seed, number])
    name = list(CALLS)[number % len(CALLS)]
    _, arguments, keywords = CALLS[name]
    given, named, values = list(arguments), dict(keywords), odd_values()
    places: list[Any] = [*range(len(given)), *named]
    said = []
    for place in rng.permutation(len(places))[: 1 + (rng.random() < 0.3)]:
        which = int(rng.integers(len(values)))
        key = places[place]
        (given if isinstance(key, int) else named)[key] = values[which]
        said.append(f"{key}: odd value {which} ({values[which]!r:.40})")
    return name, tuple(given), named, "; ".join(said)


def work(numbers: range, seed: int, file: Path) -> None:
    """Make calls, and write what came of them; the number of the one that is made comes first."""
    found: list[tuple[int, str, float, str]] = []
    for number in numbers:
        file.with_suffix(".now").write_text(str(number))
        name, arguments, keywords, what = changed(number, seed)
        start, outcome = time.monotonic(), "result"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", PolywignerWarning)
                warnings.filterwarnings("ignore", "the matrix subclass")
                CALLS[name][0](*arguments, **keywords)
        except PolywignerError:
            outcome = "clear error"
        except Exception as error:
            outcome = f"FAULT: {type(error).__name__}: {error!s:.120}"
        found.append((number, outcome, time.monotonic() - start, f"{name}({what})"))
    file.write_bytes(pickle.dumps(found))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    import tempfile

    context, counts, faults, longest = multiprocessing.get_context("spawn"), Counter(), 0, (0.0, "")
    with tempfile.TemporaryDirectory() as folder:
        first = 0
        while first < options.count:
            file = Path(folder) / "calls"
            file.unlink(missing_ok=True)
            numbers = range(first, min(first + BATCH, options.count))
            process = context.Process(target=work, args=(numbers, options.seed, file))
            process.start()
            process.join(LONGEST * 5)
            if not file.exists():  # it died, or hangs
                process.kill()
                number = int(file.with_suffix(".now").read_text())
                name, _, _, what = changed(number, options.seed)
                print(f"{number}: ended the process, or does not end: {name}({what})")
                faults += 1
                first = number + 1
                continue
            for number, outcome, seconds, what in pickle.loads(file.read_bytes()):
                counts[outcome.partition(":")[0]] += 1
                longest = max(longest, (seconds, what))
                if outcome.startswith("FAULT"):
                    faults += 1
                    print(f"{number}: {what}: {outcome}")
            first = numbers.stop
    print(f"{options.count} calls: {dict(counts)}, faults {faults}")
    print(f"longest: {longest[0]:.2f} s, {longest[1]}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
