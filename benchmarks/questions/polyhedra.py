"""How accurate and how fast is F of polyhedra, against libformfactor?

20,000 frequencies, as for a powder or a detector; and errors at difficult frequencies with |nu| D
from 1e-15 to 1e3, along and across edges and faces, rotated by 0, 1e-16, ... 1e-4 rad.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from itertools import product
from typing import Any, NamedTuple

import numpy as np

import polywigner as pw
from benchmarks.lines import Line, absent, as_times, line_of
from benchmarks.peers import libformfactor
from benchmarks.questions import wigner
from benchmarks.timing import Action, Effort, cores, in_turns
from polywigner.llvm import prepare

__all__ = ["BODIES", "CASES", "QUESTION", "THREADS", "centre", "hard_frequencies", "measure"]

QUESTION = "Fourier transform of bodies at 20,000 frequencies"
COUNT, COUNT_QUICK = 20_000, 1_000
CYCLES = 10.0  # largest |nu| times diameter
DECADES = range(-15, 4)
PYTHON, CPP = "libformfactor, from Python", "libformfactor, from C++"
OURS, LLVM, NUMPY = "ours", "llvm", "our NumPy engine"
THREADS = (1,)

Vectors = Sequence[Sequence[float]]


class Body(NamedTuple):
    """A convex body with its bottom at z = 0, and BornAgain's name and sizes of it."""

    vertices: np.ndarray
    normals: np.ndarray
    name: str
    sizes: tuple[float, ...]

    @property
    def source(self) -> pw.Polyhedron:
        return pw.Polyhedron(self.vertices, [self._face(normal) for normal in self.normals])

    def _face(self, normal: np.ndarray) -> list[int]:
        """Return the vertices farthest along a normal, counter-clockwise around it."""
        height = self.vertices @ normal
        on_face = np.flatnonzero(height > height.max() - 1e-9)
        arms = self.vertices[on_face] - self.vertices[on_face].mean(axis=0)
        across = np.cross(normal, arms[0])
        angles = np.arctan2(arms @ across, arms @ arms[0] * np.linalg.norm(normal))
        return [int(k) for k in on_face[np.argsort(angles)]]


def _body(vertices: Any, normals: Any, name: str, *sizes: float) -> Body:
    points = np.asarray(vertices, float)
    return Body(points - [0, 0, points[:, 2].min()], np.asarray(normals, float), name, sizes)


def _signs(*values: float) -> list[tuple[float, ...]]:
    """Return all points with these coordinates, up to sign."""
    return list(product(*((value, -value) if value else (value,) for value in values)))


def _ring(count: int, radius: float, z: float) -> list[tuple[float, float, float]]:
    angles = 2 * np.pi * np.arange(count) / count
    return [(radius * np.cos(a), radius * np.sin(a), z) for a in angles]


_AXES = [*_signs(1, 0, 0), *_signs(0, 1, 0), *_signs(0, 0, 1)]
_SIDES_OF_HEXAGON = [(np.cos(a), np.sin(a), 0) for a in np.pi * (np.arange(6) / 3 + 1 / 6)]
_DOWN = (0, 0, -1)
BODIES: dict[str, Callable[[], Body]] = {
    "square pyramid": lambda: _body(
        [*((x, y, 0) for x, y in _signs(1, 1)), (0, 0, 1)],
        [_DOWN, *((x, y, 1) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)))],
        *("Pyramid4", 2, 1, np.pi / 4),
    ),
    "cube": lambda: _body(_signs(0.5, 0.5, 0.5), _AXES, "Box", 1, 1, 1),
    "tetrahedron": lambda: _body(
        [*_ring(3, 1 / np.sqrt(3), 0), (0, 0, np.sqrt(2 / 3))],
        [
            _DOWN,
            *(-np.array(point) + (0, 0, 1 / np.sqrt(24)) for point in _ring(3, 1 / np.sqrt(3), 0)),
        ],
        *("PlatonicTetrahedron", 1),
    ),
    "octahedron": lambda: _body(
        [*((x, y, 0) for x, y in _signs(0.5, 0.5)), *_signs(0, 0, np.sqrt(0.5))],
        [(x, y, z * np.sqrt(0.5)) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)) for z in (1, -1)],
        *("PlatonicOctahedron", 1),
    ),
    "hexagonal prism": lambda: _body(
        [*_ring(6, 1, 0), *_ring(6, 1, 0.7)],
        [*_SIDES_OF_HEXAGON, *_signs(0, 0, 1)],
        *("Prism6", 1, 0.7),
    ),
    "truncated cube": lambda: _body(
        [*_signs(0.25, 0.5, 0.5), *_signs(0.5, 0.25, 0.5), *_signs(0.5, 0.5, 0.25)],
        [*_AXES, *_signs(1, 1, 1)],
        *("TruncatedCube", 1, 0.25),
    ),
}
CASES = list(BODIES)


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure all contenders, from and to NumPy, in double precision."""
    body, count = BODIES[case](), threads or cores()
    source = body.source
    nu = _frequencies(source, COUNT_QUICK if effort.quick else COUNT)
    ways: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        OURS: lambda nu: pw.fourier(source, nu),
        NUMPY: lambda nu: pw.fourier(source, nu, engine="numpy"),
    }
    if prepare().usable:
        ways[LLVM] = lambda nu: pw.fourier(source, nu, engine="llvm")
    missing = {}
    if libformfactor.available():
        shape = libformfactor.body(body.name, *body.sizes)
        ways[PYTHON] = lambda nu: libformfactor.from_python(shape, nu)
        try:
            ways[CPP] = libformfactor.from_cpp(shape, centre(source))
        except RuntimeError as error:
            missing[CPP] = str(error)
    else:
        missing[PYTHON] = "not installed (pip install bornagain)"
    errors = _errors(source, ways, effort.checked)
    actions: dict[str, Action] = {
        name: lambda way=way: way(nu)  # type: ignore[misc]
        for name, way in ways.items()
    }
    times = in_turns(actions, effort.rounds, count)

    def entry(name: str) -> tuple[Any, list[float], float]:
        return as_times(times[name], 1e3, errors.get(name)), times[name], 1.0

    labels: dict[str, Any] = {"question": "polyhedra", "case": case, "precision": "double"}
    labels |= {"threads": count, "unit": "ms", "error_unit": "of the volume"}
    lines = [line_of(labels, NUMPY, entry(OURS), entry(NUMPY))]
    for own, named in ((OURS, ""), (LLVM, f", engine {LLVM}")):
        if own not in ways:
            continue
        labels["case"] = f"{case}{named}"
        lines += [line_of(labels, p, entry(own), entry(p)) for p in (PYTHON, CPP) if p in ways]
        lines += [absent(labels, peer, why, entry(own)[0]) for peer, why in missing.items()]
    return lines


def _frequencies(source: pw.Polyhedron, count: int) -> np.ndarray:
    """Return frequencies in all directions, of sizes up to CYCLES."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction * rng.uniform(0, CYCLES / _diameter(source), (count, 1))


def _diameter(source: pw.Polyhedron) -> float:
    points = source.vertices
    return float(max(np.linalg.norm(points - point, axis=1).max() for point in points))


def centre(source: pw.Polyhedron) -> float:
    """Return the height of the centre of mass, from tetrahedra with an apex at the origin."""
    corners = source.vertices[source.triangles]
    volumes = np.linalg.det(corners) / 6
    return float(volumes @ corners[..., 2].sum(axis=1) / 4 / volumes.sum())


def hard_frequencies(source: pw.Polyhedron, count: int) -> np.ndarray:
    """Return ``count`` difficult frequencies of each decade, as in the tests."""
    from oracles.sources import frequencies

    rng = np.random.default_rng(1)
    return np.concatenate([frequencies(rng, source, decade, count) for decade in DECADES])


def _errors(
    source: pw.Polyhedron, ways: dict[str, Callable[[np.ndarray], np.ndarray]], count: int
) -> dict[str, float]:
    """Return largest errors over the volume against 60 digits, if the tests' packages exist."""
    if not find_spec("mpmath") or wigner.oracle() is None:
        return {}
    from oracles import simplices

    nu = hard_frequencies(source, count)
    tiling = simplices.simplices_of(source)
    exact = np.array([complex(simplices.fourier(tiling, row)) for row in nu])
    return {
        name: float(np.abs(way(nu) - exact).max() / source.volume) for name, way in ways.items()
    }
