"""One source for each code path of the kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import polywigner as pw
from oracles.references import awkward

CHEVRON = pw.Aperture([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])
ELL = pw.Aperture([(-1.5, -1.5), (1.5, -1.5), (1.5, -0.5), (-0.4, -0.5), (-0.4, 1.5), (-1.5, 1.5)])
SQUARE = pw.shapes.square(1.0)
WAVES = pw.Illumination([1, 0.5j, 0.3], [(0.3, 0.1), (-0.2, 0.9), (1.3, -0.5)])


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
}

FUNCTIONS = ("wigner", "ambiguity", "fourier", "position_marginal", "lag_marginal")


def place_of(function: str) -> str:
    return "xi" if function in ("ambiguity", "lag_marginal") else "x"
