"""The cells between the kinks of the Wigner function, and rules on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.propagation.arrangement import (
    areas,
    gauss_rule,
    kink_count,
    kinks,
    smooth_triangles,
)

CHEVRON = pw.shapes.chevron(2.0, 1.2, 0.4)
SQUARES = [(1.4 * i, 1.4 * j) for i in range(3) for j in range(2)]
SOURCES: dict[str, Any] = {
    "square": pw.shapes.square(1.0),
    "triangle": pw.shapes.triangle(1.0, 0.8),
    "chevrons": pw.Aperture([*CHEVRON.rings, *CHEVRON.moved((2.3, 0.1)).rings]),
    "hexagon with a hole": pw.shapes.ring(1.0, 0.4, n=6),
    "elements on a lattice": pw.phased_array(pw.shapes.square(1.0), SQUARES),
    "different elements": pw.Array(
        [pw.shapes.square(1.0), pw.shapes.triangle(0.5, 0.4).moved((1.0, 0.3))], [1, 0.5j]
    ),
}
# Gauss on analytic functions: what is left with 8 nodes beyond those that the phase needs.
SPECTRAL = 1e-9


@pytest.mark.parametrize("name", SOURCES)
def test_the_cells_tile_the_automean(name: str) -> None:
    source = SOURCES[name]
    outline = source.support if isinstance(source, pw.Array) else source
    assert areas(smooth_triangles(source)).sum() == pytest.approx(
        pw.automean(outline).area, rel=1e-12
    )


@pytest.mark.parametrize("name", SOURCES)
def test_gauss_rules_on_the_cells_integrate_the_wigner_function_to_the_spectrum(name: str) -> None:
    source = SOURCES[name]
    nu = np.array([[0.0, 0.0], [1.1, 0.3], [-0.7, 2.0]])
    nodes, weights = gauss_rule(smooth_triangles(source), 2.2, 8)
    found = pw.wigner(source, nodes, nu[:, None]) @ weights
    expected = abs(pw.fourier(source, nu)) ** 2
    assert abs(found - expected).max() < SPECTRAL * expected[0]


def test_rules_that_ignore_kinks_are_far_from_as_good() -> None:
    source = SOURCES["chevrons"]
    outline = pw.automean(source)
    from polywigner.geometry.aperture import triangulate

    vertices, triangles = triangulate(outline)
    nodes, weights = gauss_rule(vertices[triangles], 1.2, 8)
    expected = abs(pw.fourier(source, (1.1, 0.3))) ** 2
    error = abs(pw.wigner(source, nodes, (1.1, 0.3)) @ weights - expected)
    assert error > 1e3 * SPECTRAL * abs(pw.fourier(source, (0, 0))) ** 2


def test_copies_of_one_element_have_the_kinks_of_all_their_pairs() -> None:
    element, positions = pw.shapes.triangle(1.0, 0.8), np.array(SQUARES)
    phased = pw.phased_array(element, positions)
    alike = kinks(phased)
    apart = kinks(pw.Array([element.moved(p) for p in positions]))
    assert len(alike) == len(apart) <= kink_count(phased)
    assert abs(alike - apart).max() < 1e-12
