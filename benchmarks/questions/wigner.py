"""How many samples of W a second, and how accurate?"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely

import polywigner as pw
from benchmarks.lines import Line, absent, as_rates, line_of
from benchmarks.peers import by_shapely, cpp, jax_kernel
from benchmarks.timing import Action, Effort, cores, fitting, in_turns, load_average
from polywigner.llvm import prepare

__all__ = [
    "CASES",
    "QUESTION",
    "SOURCES",
    "THREADS",
    "in_engine",
    "measure",
    "oracle",
    "outline",
    "points",
]

QUESTION = "Samples of W per second"
CHEVRON = np.array([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])
PITCH, SIDE = 1.4, 32  # for an array of 32 x 32 squares of side 1
SOURCES: dict[str, Callable[[], Any]] = {
    "square": lambda: pw.shapes.square(1.0),
    "chevron": lambda: pw.Aperture(CHEVRON),
    "two chevrons": lambda: pw.Aperture([CHEVRON, CHEVRON + np.array([0, 1.7])]),
    "18 hexagons": lambda: pw.shapes.hexagonal_segments(1.0, gap=0.02),
    "64-gon": lambda: pw.shapes.regular_polygon(64, 1.0),
    "1024 elements": lambda: pw.phased_array(
        pw.shapes.square(1.0), pw.arrays.grid_positions(SIDE, SIDE, PITCH)
    ),
}
CASES = list(SOURCES)
THREADS = (1, None)  # None: all cores
CYCLES = 10.0  # largest |nu| times diameter

SHAPELY, NUMPY, JAX, CPP = "shapely + NumPy per sample", "our NumPy engine", "JAX", "C++"
CONVERTED, ONE_CORE = "our engine from and to NumPy", "our engine on one core"
# (case, peer) -> error limits in single and in double precision
Asked = dict[tuple[str, str], tuple[float | None, float | None]]
TARGETS: Asked = {  # smallest ratios
    ("square", CPP): (0.85, 0.85),
    ("chevron", CPP): (0.85, 0.85),
    ("square", SHAPELY): (20_000, 8_000),
    ("64-gon", CPP): (10, None),
}
ENOUGH: Asked = {("64-gon", CPP): (20, None)}  # sufficient million samples per second
SCALING_TARGET = 0.9  # relative to the number of cores, at most two
# Largest fraction of busy cores, above which wall-clock time is unreliable.
QUIET = 0.75

# (x, nu) -> a call that computes W, and returns its values.
Method = Callable[[np.ndarray, np.ndarray], Action]


def outline(source: Any) -> list[np.ndarray]:
    """Return the rings of an aperture without holes, or of an array of one aperture."""
    if isinstance(source, pw.Aperture):
        return list(source.rings)
    element, places = source.repeated
    return [ring + place for place in places for ring in element.rings]


@lru_cache(maxsize=8)
def _places(source: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return positions at which W is not zero, all over an array, and frequencies in a disc."""
    rng = np.random.default_rng(0)
    rings = np.concatenate(outline(source))
    low, high = rings.min(axis=0), rings.max(axis=0)
    x = (low + (high - low) * rng.random((1 << 15, 2))).astype(np.float32)
    if isinstance(source, pw.Aperture):
        support = pw.automean(source).polygons
        shapely.prepare(support)
        x = x[shapely.contains_xy(support, *x.T)]
    angle, radius = 2 * np.pi * rng.random(len(x)), np.sqrt(rng.random(len(x)))
    nu = (CYCLES / _size(source) * radius)[:, None] * np.column_stack(
        [np.cos(angle), np.sin(angle)]
    )
    return x.astype(np.float64), nu.astype(np.float32).astype(np.float64)  # exact in float32


def _size(source: Any) -> float:
    element = source if isinstance(source, pw.Aperture) else source.repeated[0]
    return float(element.diameter)


def points(source: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and frequencies, which repeat."""
    x, nu = (np.resize(values, (count, 2)) for values in _places(source))
    return x, nu


def checked_points(source: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions, and frequencies from far below one over the size; exact in float32."""
    x, nu = points(source, count)
    scale = np.geomspace(1e-3, 1.0, count)[:, None]
    return x, (nu * scale).astype(np.float32).astype(np.float64)


def in_engine(source: Any, precision: str, threads: int) -> Method:
    """Return a method with arrays that stay in the engine."""
    import drjit as dr
    import drjit.llvm as backend

    vector = backend.Array2f if precision == "single" else backend.Array2f64

    def method(x: np.ndarray, nu: np.ndarray) -> Action:
        # copies, because NumPy memory would be shared
        where = [vector(*(np.ascontiguousarray(c) for c in p.T)) + 0.0 for p in (x, nu)]
        dr.eval(where)
        dr.sync_thread()

        def run() -> Any:
            if dr.thread_count() != threads:
                dr.set_thread_count(threads)
            values = pw.wigner(source, *where)
            dr.eval(values)
            dr.sync_thread()
            return values

        return run

    return method


def through_numpy(source: Any, precision: Any, engine: Any) -> Method:
    """Return a method with NumPy arrays in and out."""
    return lambda x, nu: lambda: pw.wigner(source, x, nu, precision=precision, engine=engine)


def _columns(x: np.ndarray, nu: np.ndarray, precision: str) -> list[np.ndarray]:
    kind = np.float32 if precision == "single" else np.float64
    return [np.ascontiguousarray(column, dtype=kind) for column in (*x.T, *nu.T)]


def in_cpp(source: pw.Aperture, precision: str, threads: int) -> Method:
    """Return the hand-written kernel."""
    kernel = cpp.wigner_kernel(source, precision, threads)

    def method(x: np.ndarray, nu: np.ndarray) -> Action:
        columns = _columns(x, nu, precision)
        out = np.empty_like(columns[0])

        def run() -> np.ndarray:
            kernel(*columns, out)
            return out

        return run

    return method


def in_jax(source: pw.Aperture, precision: str) -> Method:
    """Return a method with arrays that stay in JAX."""
    import jax.numpy as jnp

    kernel = jax_kernel.wigner_kernel(source, precision)

    def method(x: np.ndarray, nu: np.ndarray) -> Action:
        columns = [jnp.asarray(column) for column in _columns(x, nu, precision)]
        return lambda: kernel(*columns)

    return method


def _in_cpp_if_possible(source: pw.Aperture, precision: str, threads: int) -> Method | str:
    if not cpp.compiler():
        return "no C++ compiler that works (set CXX)"
    try:
        return in_cpp(source, precision, threads)
    except RuntimeError as error:
        return str(error)


def _peers(source: Any, precision: str, threads: int) -> dict[str, Method | str]:
    """Return peers by name, or the reasons why they are missing."""
    result: dict[str, Method | str] = {}
    clips = cpp.header_of(source)[1] if isinstance(source, pw.Aperture) else None
    if clips is not None:
        result[CPP] = _in_cpp_if_possible(source, precision, threads)
    if clips is not None and clips <= cpp.UNROLLED_CLIPS:
        missing = "not installed (pip install jax)"
        result[JAX] = in_jax(source, precision) if jax_kernel.available() else missing
    usable = prepare().usable
    if threads > 1:
        if usable:
            result[ONE_CORE] = in_engine(source, precision, 1)
        return result
    if usable:
        result[CONVERTED] = through_numpy(source, precision, "llvm")
        result[NUMPY] = through_numpy(source, precision, "numpy")
    polygons = by_shapely.polygons_of(outline(source))
    result[SHAPELY] = lambda x, nu: lambda: by_shapely.wigner_one_by_one(polygons, x, nu)
    return result


def _target(case: str, peer: str, precision: str, threads: int) -> float | None:
    if peer == ONE_CORE:
        judged = threads == 2 and case == "square" and load_average() <= QUIET * threads
        return SCALING_TARGET * threads if judged else None
    return _asked(TARGETS, case, peer, precision, threads)


def _asked(table: Asked, case: str, peer: str, precision: str, threads: int) -> float | None:
    result = table.get((case, peer)) if threads == 1 else None
    return result and result[precision == "double"]


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure all peers in turns, in both precisions."""
    count = threads or cores()
    source = SOURCES[case]()
    exact = exact_values(source, *checked_points(source, effort.checked))
    lines = []
    for precision in ("single", "double"):
        lines += _lines(case, source, precision, count, effort, exact)
    return lines


def _lines(
    case: str, source: Any, precision: str, threads: int, effort: Effort, exact: np.ndarray | None
) -> list[Line]:
    engine = prepare().usable
    own = (
        in_engine(source, precision, threads)
        if engine
        else through_numpy(source, precision, "numpy")
    )
    peers = _peers(source, precision, threads)
    labels = {"question": "wigner", "case": case, "precision": precision, "threads": threads}
    labels |= {"unit": "M samples/s", "error_unit": "of the area"}
    methods = {"ours": own} | {name: m for name, m in peers.items() if not isinstance(m, str)}
    actions, counts, errors = {}, {}, {}
    for name, method in methods.items():
        make = lambda size, method=method: method(*points(source, size))  # noqa: E731
        actions[name], counts[name] = fitting(make, effort, threads)
        errors[name] = _error(method, source, effort, exact)
    times = in_turns(actions, effort.rounds, threads)

    def entry(name: str) -> tuple[Any, list[float], float]:
        millions = counts[name] / 1e6
        return as_rates(times[name], millions, errors[name]), times[name], millions

    lines = []
    for name, method in peers.items():
        if isinstance(method, str):
            lines.append(absent(labels, name, method, entry("ours")[0]))
        else:
            more: dict[str, Any] = {"target": _target(case, name, precision, threads)}
            more["enough"] = _asked(ENOUGH, case, name, precision, threads)
            more["note"] = f"load {load_average():.1f}" if threads > 1 else ""
            lines.append(line_of(labels, name, entry("ours"), entry(name), **more))
    return lines


def _error(method: Method, source: Any, effort: Effort, exact: np.ndarray | None) -> float | None:
    if exact is None:
        return None
    result = np.asarray(method(*checked_points(source, effort.checked))(), np.float64)
    return float(np.abs(result - exact).max() / _energy(source))


def _energy(source: Any) -> float:
    return float(source.area if isinstance(source, pw.Aperture) else len(source))


def oracle() -> Any:
    """Return slices in rational arithmetic, or None without mpmath or the tests."""
    folder = str(Path(__file__).parents[2] / "tests")
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        from oracles import exact
    except ImportError:
        return None
    return exact


def exact_values(source: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray | None:
    """Return W with all digits of a float64, or None without the :func:`oracle`."""
    if not isinstance(source, pw.Aperture):
        return _pair_sum(source, x, nu)
    exact = oracle()
    if exact is None:
        return None
    rings = outline(source)
    return np.array([exact.wigner(rings, p, q) for p, q in zip(x, nu, strict=True)], np.float64)


def _pair_sum(array: Any, x: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Return W of unit squares with equal weights as a sum over all pairs."""
    _, places = array.repeated
    apart = places[:, None] - places
    values = []
    for at, frequency in zip(x, nu, strict=True):
        sides = np.maximum(0.0, 1 - 2 * np.abs(at - (places[:, None] + places) / 2))
        own = (2 * sides * np.sinc(2 * sides * frequency)).prod(axis=-1)
        values.append((own * np.cos(2 * np.pi * (apart @ frequency))).sum())
    return np.array(values)
