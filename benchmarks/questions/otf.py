"""What does a value of the optical transfer function cost, and how accurate is it?"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np

import polywigner as pw
from benchmarks.lines import Line, as_rates, line_of
from benchmarks.peers import by_shapely
from benchmarks.questions import wigner
from benchmarks.timing import Action, Effort, cores, fitting, in_turns
from polywigner.llvm import prepare

__all__ = ["CASES", "QUESTION", "THREADS", "measure"]

QUESTION = "Values of the OTF per second"
CASES = ["square", "18 hexagons", "64-gon"]
THREADS = (1,)
NUMPY = "our NumPy engine"
# Names of peers: (polygons, lags) -> values
BY_SHAPELY: dict[str, Callable[..., np.ndarray]] = {
    "shapely per lag": by_shapely.otf_one_by_one,
    "shapely, arrays": by_shapely.otf,
}


def lags(source: pw.Aperture, count: int) -> np.ndarray:
    """Return lags in a disc that contains most of the OTF."""
    rng = np.random.default_rng(0)
    angle, radius = 2 * np.pi * rng.random(1 << 14), 0.9 * np.sqrt(rng.random(1 << 14))
    xi = source.diameter * radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.resize(xi, (count, 2))


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure shapely in turns with polywigner, for NumPy arrays in double precision."""
    source = wigner.SOURCES[case]()
    polygons = by_shapely.polygons_of(source.rings)
    count = threads or cores()
    engine: Any = "llvm" if prepare().usable else "numpy"
    methods: dict[str, Callable[[np.ndarray], Action]] = {
        "ours": lambda xi: lambda: pw.otf(source, xi, engine=engine),
        **{name: _method(function, polygons) for name, function in BY_SHAPELY.items()},
    }
    if engine == "llvm":
        methods[NUMPY] = lambda xi: lambda: pw.otf(source, xi, engine="numpy")
    actions, counts, errors = {}, {}, {}
    checked = lags(source, effort.checked)
    exact = exact_values(source, checked)
    for name, method in methods.items():
        make = lambda size, method=method: method(lags(source, size))  # noqa: E731
        actions[name], counts[name] = fitting(make, effort, count)
        result = method(checked)()
        errors[name] = None if exact is None else float(np.abs(result - exact).max())
    times = in_turns(actions, effort.rounds, count)

    def entry(name: str) -> tuple[Any, list[float], float]:
        millions = counts[name] / 1e6
        return as_rates(times[name], millions, errors[name]), times[name], millions

    labels = {"question": "otf", "case": case, "precision": "double", "threads": count}
    labels |= {"unit": "M values/s", "error_unit": "of 1"}
    return [line_of(labels, name, entry("ours"), entry(name)) for name in times if name != "ours"]


def _method(function: Callable[..., np.ndarray], polygons: Any) -> Callable[[np.ndarray], Action]:
    return lambda xi: lambda: function(polygons, xi)


def exact_values(source: pw.Aperture, xi: np.ndarray) -> np.ndarray | None:
    """Return ratios of areas in rational arithmetic, or None without the packages of the tests."""
    exact = wigner.oracle()
    if exact is None:
        return None
    rings = list(source.rings)
    whole = Fraction(str(exact.plain_region(rings).area))
    overlap = (Fraction(str(exact.position_region(rings, lag).area)) for lag in xi)
    return np.array([float(area / whole) for area in overlap])
