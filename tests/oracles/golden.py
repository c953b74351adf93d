"""Make tests/data/golden.npz: run ``python -m oracles.golden`` in tests/.

Values of all functions of many sources, by the NumPy engine in double precision, point by point, at
random and at special places: a change of a kernel or of a plan shows in them. They are no
references, which other files have. Derivatives are by LLVM.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

import polywigner as pw
from oracles.references import awkward
from oracles.sources import cube, prism
from polywigner import execution, kernels
from polywigner.toolchain import llvm

TARGET = Path(__file__).parents[1] / "data" / "golden.npz"

Values = Any

CHEVRON = pw.Aperture([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])
ELL = pw.Aperture([(-1.5, -1.5), (1.5, -1.5), (1.5, -0.5), (-0.4, -0.5), (-0.4, 1.5), (-1.5, 1.5)])
SQUARE = pw.shapes.square(1.0)
WAVES = pw.Illumination([1, 0.5j, 0.3], [(0.3, 0.1), (-0.2, 0.9), (1.3, -0.5)])


def _coast(count: int) -> pw.Aperture:
    rng = np.random.default_rng(1)
    angle = 2 * np.pi * (np.arange(count) + 0.3 * rng.random(count)) / count
    walk = 0.25 * np.cumsum(rng.normal(size=count)) / np.sqrt(count)
    radius = np.maximum(1.0 + walk - np.linspace(0, walk[-1] - walk[0], count), 0.2)
    radius = radius + 9.0 / count * rng.normal(size=count).clip(-1, 1)
    return pw.Aperture(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1))


def _lattice(element: Any, weights: Any = None) -> pw.Array:
    return pw.phased_array(element, pw.arrays.grid_positions(5, 4, 1.25), weights)


def _scattered() -> pw.Array:
    rng = np.random.default_rng(3)
    weights = rng.normal(size=(30, 2)) @ [1, 1j]
    return pw.phased_array(pw.shapes.square(0.4), rng.uniform(-5, 5, (30, 2)), weights)


SOURCES: dict[str, Callable[[], Any]] = {
    "square": lambda: SQUARE,
    "chevron": lambda: CHEVRON,
    "30-gon": lambda: pw.shapes.regular_polygon(30, 0.5),
    "coast": lambda: _coast(300),
    "1000-gon": lambda: pw.shapes.regular_polygon(1000, 0.5),
    "holes": lambda: awkward("holes aligned with edges").aperture,
    "sliver": lambda: awkward("needle 1e-3, rotated").aperture,
    "needle": lambda: awkward("needle 1e-6").aperture,
    "nearly parallel": lambda: awkward("nearly parallel edges, rotated").aperture,
    "nearly collinear": lambda: awkward("nearly collinear corners, rotated").aperture,
    "coincident edges": lambda: awkward("hexagonal segments without gap").aperture,
    "two squares": lambda: awkward("two touching squares, rotated").aperture,
    "distant parts": lambda: pw.Aperture([CHEVRON.rings[0], CHEVRON.rings[0] + [60.0, 17.0]]),
    "far away": lambda: CHEVRON.moved((6500.0, -4000.0)),
    "collection": lambda: pw.Array([SQUARE, pw.Aperture([[2, 0], [3, 0], [2, 1]])], [1, -0.5j]),
    "lattice": lambda: _lattice(SQUARE),
    "steered": lambda: _lattice(CHEVRON.scaled(0.5), np.exp(0.7j * np.arange(20) ** 2)),
    "scattered": _scattered,
    "cosine": lambda: pw.shapes.rectangle(1.0, 0.7).with_illumination(pw.cosine_taper(1.0, 0.7)),
    "tapered": lambda: CHEVRON.with_illumination(pw.cosine_taper(2.2, 1.2)),
    "three waves": lambda: ELL.with_illumination(WAVES),
    "tapered lattice": lambda: _lattice(SQUARE.with_illumination(pw.cosine_taper(1.0, 1.0))),
    "slits": lambda: pw.Slits([(0.0, 1.0), (1.5, 1.8), (2.0, 4.0)]),
    "tapered slits": lambda: pw.Slits([(-1.0, -0.2), (0.1, 1.0)]).with_illumination(
        pw.cosine_taper(2.0, dimension=1)
    ),
    "row of slits": lambda: pw.phased_array(pw.Slits([(0.0, 1.0)]), 1.5 * np.arange(8)[:, None]),
    "curved": lambda: ELL.curved((2.0, -3.0), 0.3, (0.05, -0.1)),
    "curved lattice": lambda: _lattice(SQUARE).curved((20.0, 30.0), 0.3),
    "partly coherent": lambda: CHEVRON.partially_coherent(0.8),
    "curved, partly coherent": lambda: SQUARE.curved(2.0, 0.3).partially_coherent(0.5),
    "cuboid": lambda: cube((1.0, 1.3, 0.7), 3),
    "prism": lambda: pw.Polyhedron(*prism(CHEVRON.rings[0], 0.8)),
}

FUNCTIONS = ("wigner", "ambiguity", "fourier", "position_marginal", "lag_marginal")
KINDS = ("wigner", "ambiguity", "autocorrelation")
MOMENTS = ("square", "chevron", "holes", "sliver", "collection", "cosine", "three waves")
LIT = ("square", "chevron", "holes", "collection", "cosine", "curved")
PROJECTED = ("square", "chevron", "holes", "distant parts", "lattice", "cosine", "slits")
DIFFERENTIATED = ("square", "chevron", "holes", "30-gon", "collection", "three waves", "slits")
PLACES, HARD = 6, 32
# Cycles over the source along the axes of a grid of frequencies.
AXES = np.array([[-7.3, -2.1, -0.4, -1e-9, 0.0, 0.17, 1.6, 5], [-5.1, -1.3, 0, 1e-6, 0.3, 1, 3, 9]])


@cache
def source_of(name: str) -> Any:
    return SOURCES[name]()


@cache
def dimension_of(name: str) -> int:
    return int(_vertices(name).shape[1])


def functions_of(name: str) -> tuple[str, ...]:
    """The functions that a source has."""
    if dimension_of(name) == 3:
        return ("fourier",)
    return FUNCTIONS[:2] if "partly" in name else FUNCTIONS


def scale_of(name: str, function: str) -> float:
    """A bound on a function, all waves and elements in phase: rounding errors are parts of it."""
    total, power = 0.0, 1 if function == "fourier" else 2
    flat = getattr(source_of(name), "source", source_of(name))
    weights = flat.weights if isinstance(flat, pw.Array) else [1.0]
    for element, weight in zip(_elements(name), weights, strict=True):
        field = getattr(element, "illumination", None)
        strength = abs(weight) * (1.0 if field is None else abs(field.amplitudes).sum())
        content = next(c for c in ("area", "length", "volume") if hasattr(element, c))
        total += strength**power * float(getattr(element, content))
    return total * (2.0 ** dimension_of(name) if function == "wigner" else 1.0)


def _elements(name: str) -> list[Any]:
    source = getattr(source_of(name), "source", source_of(name))  # of a curved wave
    return list(source.elements) if isinstance(source, pw.Array) else [source]


def _corners(element: Any) -> Values:
    if isinstance(element, pw.Slits):
        return element.intervals.reshape(-1, 1)
    return element.vertices if isinstance(element, pw.Polyhedron) else np.concatenate(element.rings)


def _vertices(name: str) -> Values:
    return np.concatenate([_corners(element) for element in _elements(name)])


def samples(name: str) -> dict[str, Values]:
    """A few places and a grid of frequencies, for all pairs of them; and hard pairs, one by one."""
    rng, corners = np.random.default_rng(crc32(name.encode())), _vertices(name)
    own = _corners(_elements(name)[0])
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    along = (np.roll(own, -1, axis=0) - own)[rng.integers(len(own), size=HARD)]
    first, second = (corners[rng.integers(len(corners), size=HARD)] for _ in range(2))
    x, xi = (first + second) / 2, first - second
    x[:3], xi[0] = (low + size / 2, own[0], (own[0] + own[1]) / 2), 0.0
    xi[1:8] = along[1:8] * np.array([1, -1, 0.5, 1e-3, 1e-12, 0.25, 1 / 3])[:, None]
    for places in (x, xi):  # the same again, an ulp off
        ways = rng.choice([-np.inf, np.inf], (HARD // 2, len(low)))
        places[HARD // 2 :] = np.nextafter(places[: HARD // 2], ways)
    # any, at the origin and near it, along edges and across them
    nu = rng.normal(size=along.shape) * rng.choice([1.0, 10.0, 100.0], (HARD, 1)) / size
    nu[:3] *= np.array([[0.0], [1e-12], [1e-6]])
    directions = along / np.linalg.norm(along, axis=1, keepdims=True) ** 2
    nu[3:8] = directions[3:8] * rng.uniform(-9, 9, (5, 1))
    nu[8:13] = directions[8:13, ::-1] * np.resize([1.0, -1.0], len(low))
    some = _inside(name, rng.random((2, PLACES, len(low))))
    rows, columns = (some[0] + some[1]) / 2, some[0] - some[1]
    rows[:2], columns[:2] = x[:2], xi[:2]
    axes = AXES[[0, 1, 0][: len(low)]] / size[:, None]
    grid = np.stack(np.meshgrid(*axes[:2], indexing="ij"), axis=-1).reshape(-1, len(axes[:2]))
    if len(low) == 3:
        grid = np.column_stack([grid, np.full(len(grid), 0.3 / size[2])])
    return {"x": x, "xi": xi, "nu": nu, "places x": rows, "places xi": columns, "grid": grid}


def _inside(name: str, numbers: Values) -> Values:
    """Points of a source, uniform; of a body those of its box."""
    corners, shape = _vertices(name), numbers.shape
    if shape[-1] == 3:
        return corners.min(axis=0) + np.ptp(corners, axis=0) * numbers
    twice = np.tile(numbers.reshape(-1, shape[-1]), (1, 2))  # the mean of a point and itself
    return pw.sample_automean(source_of(name), twice, "marginal", engine="numpy")[0].reshape(shape)


def place_of(function: str) -> str:
    return "xi" if function in ("ambiguity", "lag_marginal") else "x"


def evaluate(name: str, function: str, place: Values, nu: Values, **how: Any) -> Any:
    """A function of a source, with arguments in the same order for all; some ignore one."""
    source, call = source_of(name), getattr(pw, function)
    if function in ("fourier", "wigner"):
        return call(source, *([place] if function == "wigner" else []), nu, **how)
    return call(source, *([nu] if function == "ambiguity" else []), place, **how)


def plain_values(name: str) -> dict[str, Values]:
    """Point by point on NumPy: hard pairs, and every place with every frequency of the grid."""
    at, found = samples(name), {}
    for function in functions_of(name):
        place = at[place_of(function)]
        found[function] = evaluate(name, function, place, at["nu"], engine="numpy")
        place, nu = at[f"places {place_of(function)}"], at["grid"]
        if "marginal" not in function:
            rows = 1 if function == "fourier" else PLACES
            pairs = np.repeat(place[:rows], len(nu), axis=0), np.tile(nu, (rows, 1))
            values = evaluate(name, function, *pairs, engine="numpy")
            found[f"{function}, grid"] = values.reshape(rows, len(nu))
    return found


def drawn(name: str) -> Values:
    """Places on the automean by both densities, and their densities, (16, 2 d + 2)."""
    d, numbers = dimension_of(name), np.random.default_rng(5).random((16, 2 * dimension_of(name)))
    source = source_of(name)
    even = pw.sample_automean(source, numbers[:, :d], "uniform", engine="numpy")
    return np.column_stack(
        [*even, *pw.sample_automean(source, numbers, "marginal", engine="numpy")]
    )


def moments(name: str, at: dict[str, Values], engine: str = "numpy", double: bool = True) -> Values:
    """The moments (T1) of lag slices at hard pairs, (n, 6)."""
    components = [at[kind][:, k] for kind in ("x", "nu") for k in (0, 1)]
    kernel = kernels.kernel_for("lag moments", source_of(name))
    how: Any = {"double": double, "engine": engine, "outputs": 6}
    return np.stack(execution.evaluate(kernel, source_of(name), components, **how), axis=-1)


def bounds_on_moments(name: str, at: dict[str, Values]) -> Values:
    """Bounds on the moments (n, 6), from the longest lag and its turns."""
    lag = 2 * float(np.linalg.norm(np.ptp(_vertices(name), axis=0)))
    turns = lag * np.linalg.norm(at["nu"], axis=-1) + 1.0
    powers = [turns**0, turns, turns**2, lag**2 + 0 * turns, lag**2 * turns, turns**3]
    return scale_of(name, "wigner") * np.stack(powers, axis=-1)


def irradiances(name: str, engine: str = "numpy") -> Values:
    """By rays of first and third order, at a few points in front of a source."""
    corners = _vertices(name)
    size = float(np.ptp(corners, axis=0).max())
    points = size * np.array([(0, 0, 4), (0.5, 0.2, 4), (2, -1, 6), (0, 7, 9)])
    points[:, :2] += corners.mean(axis=0)
    how: Any = {"engine": engine, "tolerance": 1e-6}
    values = [pw.irradiance(source_of(name), points, 0.3 * size, order=k, **how) for k in (1, 3)]
    return np.stack(values)


def tiles(name: str, kind: str, engine: str = "numpy") -> dict[str, Values]:
    """The projections of a function, at few coordinates."""
    found = pw.projections(source_of(name), kind, samples=5, engine=engine)
    return {f"{kind}, {tile}": found[tile].values for tile in found.data_vars}


def slopes(name: str, function: str, at: dict[str, Values]) -> dict[str, Values]:
    """Derivatives of a weighted sum in vertices or ends, amplitudes, weights and points."""
    import drjit as dr
    import drjit.llvm.ad as backend

    source, d = source_of(name), dimension_of(name)
    kind = backend.Float64 if d == 1 else backend.Array2f64
    ends = backend.Array2f64(*(source.intervals if d == 1 else _vertices(name)).T.tolist())
    own = {"intervals" if d == 1 else "vertices": ends}
    if isinstance(source, pw.Array):
        own["weights"] = backend.Complex2f64(source.weights.real, source.weights.imag)
    field = getattr(source, "illumination", None)
    if field is not None:
        own["amplitudes"] = backend.Complex2f64(field.amplitudes.real, field.amplitudes.imag)
    points = [at[f"places {place_of(function)}"][2:], at["grid"][: 8 * PLACES : 9][: PLACES - 2]]
    place, nu = (kind(*p.T.tolist()) if d > 1 else kind(p[:, 0]) for p in points)
    dr.enable_grad(place, nu, *own.values())
    changing = pw.differentiable(source, **own)
    arguments = {"wigner": (place, nu), "ambiguity": (nu, place), "fourier": (nu,)}[function]
    value = getattr(pw, function)(changing, *arguments)
    total = value if function == "wigner" else value.real + 0.7 * value.imag
    dr.backward(dr.sum(total * type(total)(np.linspace(1.0, 2.0, PLACES - 2))))
    own |= {"nu": nu} if function == "fourier" else {"nu": nu, "place": place}
    return {f"{function}, {key}": np.array(dr.grad(a)) for key, a in own.items()}


def read() -> dict[str, dict[str, Values]]:
    """The frozen values by source and what they are."""
    found: dict[str, dict[str, Values]] = {}
    with np.load(TARGET) as archive:
        for key, value in archive.items():
            name, what = key.split(" | ")
            found.setdefault(name, {})[what] = value
    return found


def made(name: str) -> dict[str, Values]:
    """All values of a source as they are now."""
    at = samples(name)
    found = {f"at {key}": value for key, value in at.items()} | plain_values(name)
    if dimension_of(name) < 3:
        found["automean"] = drawn(name)
    if name in MOMENTS:
        found["moments"] = moments(name, at)
    if name in LIT:
        found["irradiance"] = irradiances(name)
    for kind in KINDS if name in PROJECTED else ():
        found |= {f"tile of {key}": value for key, value in tiles(name, kind).items()}
    for function in FUNCTIONS[:3] if name in DIFFERENTIATED else ():
        own = slopes(name, function, at)
        found |= {f"slope of {key}": value for key, value in own.items()}
    return found


if __name__ == "__main__":
    llvm.prepare()
    everything = {f"{name} | {what}": v for name in SOURCES for what, v in made(name).items()}
    np.savez_compressed(TARGET, **everything)
