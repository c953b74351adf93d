"""Apertures and tiles for the tests of projections."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw

SHAPES = {
    "square": pw.shapes.square(1.0),
    "chevrons": pw.Aperture(
        [ring + np.array([0.1, 0.05]) for ring in pw.shapes.chevron_pair(2, 1.2, 0.4).rings]
    ),
    "holed": pw.Aperture(shapely.box(-1, -1, 1, 1) - shapely.box(-0.5, -0.5, 0.25, 0.5)),
    "triangle": pw.Aperture([[-0.6, -0.4], [0.7, -0.2], [0.1, 0.8]]),
    "unequal slits": pw.shapes.double_slit((0.2, 0.5), 1.0, (-0.6, 0.4)),
    "star": pw.shapes.star(5, 1.0, 0.45),
}
# Fields with different phases in overlapping elements.
ARRAY = pw.Array(
    [
        pw.Aperture([[-0.6, -0.4], [0.7, -0.2], [0.1, 0.8]]),
        pw.Aperture(pw.shapes.star(5, 0.4, 0.2).rings[0] + np.array([0.3, 0.1])),
        pw.Aperture([[-0.7, 0.3], [-0.2, 0.35], [-0.5, 0.8]]),
    ],
    [1.0, 0.7j, 0.6 - 0.8j],
)
LIT = SHAPES["triangle"].with_illumination(pw.Illumination([0.7, 0.4j], [[0.3, -0.2], [-0.4, 0.6]]))
SQUARE = SHAPES["square"]
shapes = pytest.mark.parametrize("source", SHAPES.values(), ids=SHAPES)

KINDS = ("autocorrelation", "wigner", "ambiguity")
TILES = {
    "autocorrelation": ["x_y", "xi_x_xi_y", "x_xi_x", "y_xi_y", "x_xi_y", "y_xi_x"],
    "wigner": ["x_y", "nu_x_nu_y", "x_nu_x", "y_nu_y", "x_nu_y", "y_nu_x"],
    "ambiguity": [
        *("xi_x_xi_y", "upsilon_x_upsilon_y", "upsilon_x_xi_x", "upsilon_y_xi_y"),
        *("upsilon_y_xi_x", "upsilon_x_xi_y"),
    ],
}


def tile(source: Any, kind: str, name: str, first: Any, second: Any) -> np.ndarray:
    """Return the values of a tile, whose coordinate names may contain underscores."""
    result = pw.projections(source, kind, tiles=[name], samples=2)
    axes = dict(zip(result[name].dims, (np.atleast_1d(first), np.atleast_1d(second)), strict=True))
    result = pw.projections(source, kind, tiles=[name], coordinates=axes)
    return np.asarray(result[name].values)


def bounds_of(source: pw.Aperture | pw.Array) -> tuple[float, float, float, float]:
    return (source.support if isinstance(source, pw.Array) else source).bounds


def box_of(source: pw.Aperture | pw.Array) -> tuple[float, float]:
    """Return width and height of the bounds."""
    west, south, east, north = bounds_of(source)
    return east - west, north - south
