"""Reference data as apertures and arrays, and the engines of parametrised tests."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles import exact

# Outer ring and holes of each part.
Polygons = list[tuple[np.ndarray, list[np.ndarray]]]

DATA = Path(__file__).parents[1] / "data"

ENGINES = [
    "numpy",
    pytest.param("llvm", marks=pytest.mark.llvm),
    pytest.param("cuda", marks=pytest.mark.cuda),
]

# Shapes with coincident edges, holes or small angles, or far from unit size.
FEW = (
    "two touching squares, rotated",
    "square annulus",
    "nearly parallel edges, rotated",
    "needle 1e-6",
)


def numpy_and_few(
    all_cases: Iterable[Any], few: Iterable[Any], rest: Any = (), slow: Iterable[Any] = ()
) -> list[Any]:
    """Append an engine to each case: NumPy to all cases, the other engines to a few cases.

    ``rest`` is a mark for the other cases on NumPy. ``slow`` are further cases for the other
    engines in the slow tests. Compiled engines run the operations of NumPy, but a kernel takes half
    a second to compile.
    """
    every, some, late = (
        [c if isinstance(c, tuple) else (c,) for c in of] for of in (all_cases, few, slow)
    )
    compiled = [pytest.param(*c, *e.values, marks=e.marks) for e in ENGINES[1:] for c in some]
    compiled += [
        pytest.param(*c, *e.values, marks=[*e.marks, pytest.mark.slow])
        for e in ENGINES[1:]
        for c in late
    ]
    plain = [pytest.param(*c, "numpy", marks=() if c in some else rest) for c in every]
    return plain + compiled


def read_json(name: str) -> Any:
    """Return a JSON file of reference values."""
    return json.loads((DATA / f"{name}.json").read_text())


def aperture(polygons: Polygons) -> pw.Aperture:
    """Return the aperture of (outer, holes) polygons."""
    if any(holes for _, holes in polygons):
        return pw.Aperture(shapely.MultiPolygon([(outer, holes) for outer, holes in polygons]))
    return pw.Aperture([outer for outer, _ in polygons])


@dataclass(frozen=True)
class Reference:
    """An aperture and its exact values at special positions and lags."""

    polygons: Polygons
    x: np.ndarray
    x_nu: np.ndarray
    wigner: np.ndarray
    xi: np.ndarray
    upsilon: np.ndarray
    ambiguity: np.ndarray

    @cached_property
    def aperture(self) -> pw.Aperture:
        return aperture(self.polygons)

    @cached_property
    def rings(self) -> list[np.ndarray]:
        return exact.oriented(self.polygons)

    @cached_property
    def area(self) -> float:
        return exact.area(self.rings)


def _polygons(vertices: np.ndarray, lengths: np.ndarray, hole: np.ndarray) -> Polygons:
    polygons: Polygons = []
    rings: Iterator[np.ndarray] = iter(np.split(vertices, np.cumsum(lengths.astype(int))[:-1]))
    for ring, is_hole in zip(rings, hole, strict=True):
        if is_hole:
            polygons[-1][1].append(ring)
        else:
            polygons.append((ring, []))
    return polygons


@lru_cache(maxsize=1)
def _arrays() -> dict[str, np.ndarray]:
    with np.load(DATA / "coincident_edges.npz") as archive:
        return dict(archive)


def awkward_names() -> list[str]:
    """Return the names of the shapes with special positions."""
    return list(dict.fromkeys(key.split("/")[0] for key in _arrays()))


@lru_cache(maxsize=64)
def awkward(name: str) -> Reference:
    """Return a shape with its special positions."""
    result = {key.split("/")[1]: v for key, v in _arrays().items() if key.split("/")[0] == name}
    return Reference(
        _polygons(result["vertices"], result["lengths"], result["hole"]),
        result["x"],
        result["nu"][result["x_nu"]],
        result["wigner"],
        result["xi"],
        result["nu"][result["xi_nu"]],
        result["ambiguity"],
    )
