"""How accurate are F, W and A, and where do other formulas fail?

Run ``python benchmarks/fourier_accuracy.py``; takes some minutes. Prints three Markdown tables of
largest errors relative to the content (length, area, volume), by class of source and |nu| times
diameter: F, then W and A, in float64 and float32; and F by polywigner, by the form factors of
coxeter (optional, ``pip install coxeter``) and by the vertex formula, on the same cases. Sources,
difficult directions and exact values come from the tests (``tests/oracles``).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import shapely

import polywigner as pw

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles import exact, positions, simplices
from oracles.sources import SOURCES, content, frequencies

__all__ = ["coxeter_form_factor", "vertex_formula"]

# (heading, decades of |nu| D)
RANGES = (
    ("1e-15 .. 1e-10", range(-15, -9)),
    ("1e-9 .. 1e-5", range(-9, -4)),
    ("1e-4 .. 0.1", range(-4, 0)),
    ("1", (0,)),
    ("10", (1,)),
    ("100", (2,)),
    ("1000", (3,)),
)
PEER_RANGES = (
    ("<= 1e-5", range(-15, -4)),
    ("1e-4 .. 1", range(-4, 1)),
    ("10 .. 1000", range(1, 4)),
)
PLANE = ("convex", "concave", "holed", "disjoint", "needle", "off centre")

Array = np.ndarray
Formula = Callable[[Any, Array], Array]


def _exact_fourier(source: Any, nu: Array) -> Array:
    tiling = simplices.simplices_of(source)
    return np.array([complex(simplices.fourier(tiling, row)) for row in nu])


def _row(label: str, cells: list[str]) -> None:
    print(f"| {label} |", " | ".join(cells), "|", flush=True)


def _heading(first: str, columns: list[str]) -> None:
    _row(first, columns)
    print("|---|" + "--:|" * len(columns))


def fourier_table(count: int, engine: str) -> None:
    """Print the largest error of F by class and decade."""
    print(f"\n### F, engine {engine}: worst error over content\n")
    _heading("class", [name for name, _ in RANGES])
    for kind, sources in SOURCES.items():
        worst = {"double": [0.0] * len(RANGES), "single": [0.0] * len(RANGES)}
        for number, source in enumerate(sources.values()):
            rng = np.random.default_rng([1, number])
            for k, (_, decades) in enumerate(RANGES):
                nu = np.concatenate([frequencies(rng, source, d, count) for d in decades])
                expected = _exact_fourier(source, nu)
                for precision, row in worst.items():
                    got = pw.fourier(source, nu, precision=precision, engine=engine)
                    row[k] = max(row[k], np.abs(got - expected).max() / content(source))
        for precision, row in worst.items():
            _row(f"{kind}, {precision}", [f"{error:.0e}" for error in row])


def _slit_slices(source: pw.Slits, x: float, xi: float) -> Iterator[list[tuple[Any, Any]]]:
    """Yield the lag slice at x and the position slice at xi as exact intervals."""
    ends = [(Fraction(a), Fraction(b)) for a, b in source.intervals.tolist()]
    p, half = Fraction(x), Fraction(xi) / 2
    doubled = [(2 * (a - p), 2 * (b - p)) for a, b in ends]
    for first, second in (
        (doubled, [(-b, -a) for a, b in doubled]),
        ([(a - half, b - half) for a, b in ends], [(a + half, b + half) for a, b in ends]),
    ):
        pairs = ((max(a, c), min(b, d)) for a, b in first for c, d in second)
        yield [(low, high) for low, high in pairs if low < high]


def _exact_on_intervals(intervals: list[tuple[Any, Any]], nu: Array) -> complex:
    tiling = [(b - a, ((a,), (b,))) for a, b in intervals]
    return complex(simplices.fourier(tiling, nu)) if tiling else 0j


def _exact_phase_space(source: Any, x: Array, xi: Array, nu: Array) -> tuple[Array, Array]:
    """Return W(x, nu) and A(nu, xi)."""
    if isinstance(source, pw.Slits):
        both = [
            [_exact_on_intervals(piece, n) for piece in _slit_slices(source, p, q)]
            for (p,), (q,), n in zip(x, xi, nu, strict=True)
        ]
        return np.array([w.real for w, _ in both]), np.array([a for _, a in both])
    rings = source.rings
    rows = list(zip(x, xi, nu, strict=True))
    wigner = np.array([exact.wigner(rings, p, n) for p, _, n in rows])
    return wigner, np.array([exact.ambiguity(rings, n, q) for _, q, n in rows])


def _places(source: Any, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Return positions and lags at which edges, or ends of slits, coincide up to ulps."""
    if isinstance(source, pw.Slits):
        ends, near = source.intervals.ravel(), np.diff(source.intervals, axis=1).min()
        first, second = rng.choice(ends, (2, count, 1))
        beside = near * rng.uniform(-1, 1, (2, count, 1)) * rng.integers(0, 2, (2, count, 1))
        return (first + second) / 2 + beside[0], first - second + beside[1]
    shape = positions.outline(list(source.rings))
    return positions.positions(rng, shape, count), positions.lags(rng, shape, count)


def phase_space_table(count: int, engine: str) -> None:
    """Print the largest error of W and A by class and decade."""
    print(f"\n### W and A, engine {engine}: worst error over content\n")
    _heading("class", [name for name, _ in RANGES])
    for kind in (*PLANE, "slits", "thin slits"):
        worst: dict[tuple[str, str], list[float]] = {}
        for number, (name, source) in enumerate(SOURCES[kind].items()):
            if name == "64-gon":
                continue  # rational arithmetic takes a second per slice
            rng = np.random.default_rng([2, number])
            for k, (_, decades) in enumerate(RANGES):
                nu = np.concatenate([frequencies(rng, source, d, count) for d in decades])
                x, xi = _places(source, rng, len(nu))
                wigner, ambiguity = _exact_phase_space(source, x, xi, nu)
                for precision in ("single", "double"):
                    how: dict[str, Any] = {"precision": precision, "engine": engine}
                    for letter, got, expected in (
                        ("W", pw.wigner(source, x, nu, **how), wigner),
                        ("A", pw.ambiguity(source, nu, xi, **how), ambiguity),
                    ):
                        row = worst.setdefault((letter, precision), [0.0] * len(RANGES))
                        row[k] = max(row[k], np.abs(got - expected).max() / content(source))
        for (letter, precision), row in sorted(worst.items(), reverse=True):
            _row(f"{letter}, {kind}, {precision}", [f"{error:.0e}" for error in row])


def coxeter_form_factor(source: Any, nu: Array) -> Array:
    """Return coxeter's form factor at q = 2 pi nu, of simple polygons and polyhedra."""
    import coxeter

    if isinstance(source, pw.Polyhedron):
        shape = coxeter.shapes.Polyhedron(source.vertices, [list(face) for face in source.faces])
        return np.asarray(shape.compute_form_factor_amplitude(2 * np.pi * nu))
    q = 2 * np.pi * np.column_stack([nu, np.zeros(len(nu))])
    total = np.zeros(len(nu), complex)
    for ring in source.rings:  # holes have the opposite orientation, and count as negative
        flat = np.column_stack([ring, np.zeros(len(ring))])
        sign = 1.0 if shapely.LinearRing(ring).is_ccw else -1.0
        polygon = coxeter.shapes.Polygon(flat[:: int(sign)], normal=[0, 0, 1])
        total += sign * polygon.compute_form_factor_amplitude(q)
    return total


def vertex_formula(source: Any, nu: Array) -> Array:
    """Return sum w sum_k exp(z_k)/prod_j (z_k - z_j) over simplices, z = -2 pi i nu.V."""
    tiling = simplices.simplices_of(source)
    weights = np.array([float(weight) for weight, _ in tiling])
    corners = np.array([[[float(x) for x in p] for p in points] for _, points in tiling])
    z = -2j * np.pi * np.einsum("nd,skd->nsk", nu, corners)
    gaps = z[..., :, None] - z[..., None, :] + np.eye(z.shape[-1])
    with np.errstate(all="ignore"):
        return np.asarray((weights[:, None] * np.exp(z) / gaps.prod(axis=-1)).sum(axis=(1, 2)))


def _verdict(errors: list[Array], refused: int) -> str:
    """Return median, maximum, the number of NaN, and the number of rejected sources."""
    if not errors:
        return "refused"
    every = np.concatenate(errors)
    finite = every[np.isfinite(every)]
    parts = [f"{np.median(finite):.0e} / {finite.max():.0e}"]
    if len(finite) < len(every):
        parts.append(f"{1 - len(finite) / len(every):.0%} NaN")
    if refused:
        parts.append(f"{refused} of {refused + len(errors)} refused")
    return ", ".join(parts)


def peer_table(count: int) -> None:
    """Print the largest errors of F by this package, coxeter and the vertex formula."""
    formulas: dict[str, Formula] = {"polywigner": pw.fourier}
    try:
        import coxeter
    except ImportError:
        print("\ncoxeter is not installed (pip install coxeter); the next table is without it.")
    else:
        formulas[f"coxeter {coxeter.__version__}"] = coxeter_form_factor
    formulas["vertex formula"] = vertex_formula
    print("\n### F by three formulas, float64: median / worst error over content\n")
    _heading("class, nu D", list(formulas))
    for kind, sources in SOURCES.items():
        if kind in ("slits", "thin slits", "placed"):
            continue
        for name, decades in PEER_RANGES:
            worst: dict[str, list[Array]] = {formula: [] for formula in formulas}
            for number, source in enumerate(sources.values()):
                rng = np.random.default_rng([3, number])
                nu = np.concatenate([frequencies(rng, source, d, count) for d in decades])
                expected = _exact_fourier(source, nu)
                for formula, transform in formulas.items():
                    try:
                        got = transform(source, nu)
                    except ValueError:  # rejected inputs are a result
                        continue
                    worst[formula].append(np.abs(got - expected) / content(source))
            cells = [_verdict(errors, len(sources) - len(errors)) for errors in worst.values()]
            _row(f"{kind}, {name}", cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="frequencies per decade and source")
    parser.add_argument("--engine", default="numpy")
    parser.add_argument("--table", choices=["fourier", "phase-space", "peers"])
    arguments = parser.parse_args()
    if arguments.table in (None, "fourier"):
        fourier_table(arguments.count, arguments.engine)
    if arguments.table in (None, "phase-space"):
        phase_space_table(max(1, arguments.count // 4), arguments.engine)
    if arguments.table in (None, "peers"):
        peer_table(arguments.count)


if __name__ == "__main__":
    main()
