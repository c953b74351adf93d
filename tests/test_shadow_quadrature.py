"""The oracle of shadows agrees with screens, with itself and with sequential Kirchhoff."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import at
from oracles.shadow_quadrature import (
    Radiators,
    aperture_radiators,
    lit_regions,
    point_radiator,
    shadowed_field,
    surface_of,
)
from oracles.sources import cube

SOURCE = (0.3, 0.1, -20.0)
POINTS = np.array([[0.0, 0.0, 6.0], [3.0, -2.0, 4.0], [-6.0, 5.0, 15.0]])
OUTLINE = pw.Aperture([(-4, -3), (4, -3), (5, 4), (-4, 4)])


def test_plate_is_a_screen() -> None:
    field = shadowed_field([OUTLINE.placed(at())], point_radiator(SOURCE), POINTS)
    screen = pw.Screen(OUTLINE, pw.PointSource(SOURCE))
    expected = pw.amplitude(screen, POINTS, 1.0, "kirchhoff")
    assert np.abs(field - expected).max() < 1e-12 * np.abs(expected).max()


def test_convex_body_agrees_with_line_integrals_along_its_silhouette() -> None:
    box = cube((4.0, 3.0, 2.0), seed=3, shift=(0.0, 0.0, -5.0))
    field = shadowed_field([box], point_radiator(SOURCE), POINTS)
    expected = pw.amplitude(pw.PointSource(SOURCE), POINTS, 1.0, obstacles=box, tolerance=1e-8)
    assert np.abs(field - expected).max() < 1e-9 * np.abs(expected).max()


def test_lit_regions_have_the_solid_angle_that_random_rays_hit_first() -> None:
    bodies: list[Any] = [
        cube((3.0, 2.0, 1.0), seed=2, shift=(0.5, 0.2, 1.0)),
        pw.shapes.rectangle(3.0, 5.0).placed(at(-0.5, 0.3, 4.0)),
        cube((1.0, 4.0, 1.0), seed=5, shift=(-1.0, 0.0, -2.0)),
    ]
    surfaces = [surface_of(body) for body in bodies]
    regions, normals = lit_regions(surfaces, SOURCE)
    rng = np.random.default_rng(1)
    rays = np.column_stack([rng.uniform(-0.2, 0.2, (4000, 2)), np.ones(4000)])

    def hits(triangles: np.ndarray) -> np.ndarray:
        a, b, c = np.moveaxis(triangles - np.array(SOURCE), 1, 0)
        sides = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
        shares = np.einsum("stk,rk->srt", sides, rays)
        return (shares > 0.0).all(axis=0) | (shares < 0.0).all(axis=0)

    everything = np.concatenate([surface.triangles for surface in surfaces])
    counts = hits(regions).sum(axis=1)
    assert np.array_equal(counts, hits(everything).any(axis=1).astype(int))
    assert (np.einsum("tk,tk->t", regions[:, 0] - np.array(SOURCE), normals) > 0.0).all()


def test_gradient_of_radiators_is_that_of_their_field() -> None:
    rng = np.random.default_rng(2)
    many = Radiators(rng.normal(size=(5, 3)), rng.normal(size=5) * 1j, rng.normal(size=(5, 3)) + 1j)
    _, gradient = many.field(POINTS, with_gradient=True)
    step = 1e-5 * np.eye(3)
    slopes = [(many.field(POINTS + s) - many.field(POINTS - s)) / 2e-5 for s in step]
    assert np.abs(np.stack(slopes, axis=1) - gradient).max() < 1e-7 * np.abs(gradient).max()


@pytest.mark.parametrize(
    "condition", ["rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff"]
)
def test_huygens_points_radiate_as_their_aperture(condition: Any) -> None:
    square = pw.shapes.square(1.5)
    field = aperture_radiators(square, condition, order=12, longest=2.0).field(POINTS)
    assert np.abs(field / pw.amplitude(square, POINTS, 1.0, condition) - 1).max() < 1e-9
