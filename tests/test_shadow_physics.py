"""Accuracy of shadows by silhouettes for real bodies (docs/shadows.md).

References are partial waves for spheres, FDTD for boxes and plates, and Kirchhoff's integral for
two edges.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import double_edges, fdtd_bodies, shadow_spheres
from benchmarks.shadow_spheres import Zones
from oracles.spheres import field_of_sphere

FDTD = json.loads((Path(__file__).parent / "data" / "shadows_fdtd.json").read_text("utf-8"))


def test_partial_waves_meet_their_conditions_on_the_sphere() -> None:
    g = np.linspace(0.0, np.pi, 9)
    outwards = np.column_stack([np.sin(g), 0 * g, np.cos(g)])

    def whole(kind: str, radius: float) -> np.ndarray:
        points = radius * outwards
        away = np.linalg.norm(points + np.array([0.0, 0.0, 60.0]), axis=1)
        return field_of_sphere(kind, 5.0, 60.0, points) * np.exp(2j * np.pi * away) / away

    free = 1 / 60.0
    assert np.abs(whole("soft", 5.0)).max() < 1e-10 * free
    slope = (whole("hard", 5.0 + 2e-4) - whole("hard", 5.0)) / (2e-4 * 2 * np.pi)
    assert np.abs(slope).max() < 2e-3 * free  # half of the second difference


@pytest.mark.parametrize("radius", shadow_spheres.RADII)
def test_shadow_of_a_black_ball_is_between_those_of_a_soft_and_a_hard_one(radius: float) -> None:
    result = shadow_spheres.levels(radius, 10 * radius)
    dark = {kind: shadow_spheres.mean_level(result[kind][Zones.dark]) for kind in result}
    assert dark["soft"] < dark["black"] < dark["hard"]
    edge = {kind: level[Zones.boundary] for kind, level in result.items()}
    assert edge["soft"] < edge["black"] < edge["hard"] < edge["soft"] + 3
    for kind in ("soft", "hard"):
        off = (result[kind] - result["black"])[Zones.lit]
        assert np.sqrt(np.mean(off**2)) < 1.0


@pytest.mark.slow
def test_spot_of_arago_fades_behind_a_soft_sphere_as_waves_creep() -> None:
    """Each theta (pi D/(2 lambda))^(1/3) costs 12 dB; a hard sphere is at most 3 dB brighter."""
    for radius in shadow_spheres.RADII:
        for distance in radius * np.array([4.0, 40.0]):
            axis = np.array([[0.0, 0.0, distance]])
            soft, black, hard = (
                20 * np.log10(np.abs(field))[0]
                for field in (
                    field_of_sphere("soft", radius, 100 * radius, axis),
                    shadow_spheres.behind_ball(radius, axis),
                    field_of_sphere("hard", radius, 100 * radius, axis),
                )
            )
            creeping = np.arctan(radius / distance) * (np.pi * radius) ** (1 / 3)
            assert 10 < (black - soft) / creeping < 14
            assert 0 < hard - black < 3
            assert abs(black) < 0.2


@pytest.mark.parametrize(
    ("body", "rms", "largest"),
    [
        # Kirchhoff's black body. The difference is due to the lattice of 24 cells per wavelength.
        ("cube, jumps", 0.1, 0.6),
        ("plate, jumps", 0.1, 0.6),
        # A thin absorber, which is black for normal incidence only.
        ("plate, matched", 0.8, 6.0),
        # A cube of the same absorber, with diffraction at its far edges as well.
        ("cube, matched", 3.8, 18.0),
        ("cube, soft", 4.3, 18.0),
        ("cube, hard", 3.2, 18.0),
    ],
)
def test_box_of_three_wavelengths_beside_finite_differences(
    body: str, rms: float, largest: float
) -> None:
    points, depth = np.array(FDTD["points"]), fdtd_bodies.SHAPES[body.split(",")[0]]
    for angle in fdtd_bodies.ANGLES:
        level = 20 * np.log10(FDTD[f"{body}, {angle:.0f}"])
        result = 20 * np.log10(np.abs(fdtd_bodies.silhouette_field(points, angle, depth)))
        off = (result - level)[level > fdtd_bodies.FLOOR]
        assert np.sqrt(np.mean(off**2)) < rms
        assert np.abs(off).max() < largest


def test_finite_differences_of_a_small_box_are_those_of_its_silhouette() -> None:
    waves = fdtd_bodies.field_around("jumps", 30.0, 12, 0.5, 0.75, wide=1.5, near=-1.0, far=2.5)
    x, y, z = (axis[every::4] for axis, every in ((waves.x, 2), (waves.y, 2), (waves.z, 30)))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    result = np.abs(waves.values[2::4, 2::4, 30::4]).ravel()
    off = 20 * np.log10(np.abs(fdtd_bodies.silhouette_field(points, 30.0, 0.5, 0.75)) / result)
    assert np.sqrt(np.mean(off**2)) < 0.3


def test_two_edges_in_a_row_pass_what_millington_says() -> None:
    """At grazing incidence, the field is 1/4 + arcsin(sqrt(b/(a + b)))/(2 pi); a single edge gives
    1/2.

    Source: Millington, Hewitt and Immirzi, Proc. IEE 109 C, 419 (1962), for a distant source.
    """
    apart = behind = 100.0
    x, z = np.zeros(1), np.array([apart + behind])
    result = np.abs(double_edges.cascade(0.0, apart, x, z))[0]
    assert abs(result - (0.25 + np.arcsin(np.sqrt(behind / (apart + behind))) / (2 * np.pi))) < 0.01
    both = [double_edges.half_plane(0.0, 0.0), double_edges.half_plane(0.3, apart)]
    assert abs(np.abs(double_edges.behind(both, x + 0.3, z))[0] - 0.5) < 0.01
