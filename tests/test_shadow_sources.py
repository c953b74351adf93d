"""Sources in front of obstacles: obliquity, curved waves, large apertures and point sources."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import fresnel

import polywigner as pw
from oracles.meshes import at
from oracles.shadow_quadrature import aperture_radiators, shadowed_field
from oracles.sources import cube
from polywigner.errors import ArgumentError

SQUARE = pw.shapes.square(0.6)
RS1, RS2 = "rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2"
TOLERANCE = 1e-6


def upright(outline: pw.Aperture, x: float) -> pw.PlacedAperture:
    """Return a plate in a plane of constant x, with an outline in y and z."""
    pose = np.zeros((4, 4))
    pose[[1, 2, 0, 3], [0, 1, 2, 3]] = 1.0
    pose[0, 3] = x
    return outline.placed(pose)


def raised(body: Any, height: float) -> Any:
    if isinstance(body, pw.Polyhedron):
        return pw.Polyhedron(body.vertices + np.array([0.0, 0.0, height]), body.faces)
    pose = body.pose.copy()
    pose[2, 3] += height
    return body.aperture.placed(pose)


HALF_PLANE = upright(pw.Aperture([(-40, 0.6), (40, 0.6), (40, 40), (-40, 40)]), 8.0)
CASES: dict[str, tuple[Any, Any]] = {
    "half-plane at a wide angle": (HALF_PLANE, [(16.0, 0.0, 2.0), (16.0, 3.0, 1.0)]),
    "box": (cube((4, 3, 2), seed=3, shift=(0.0, 0.5, 5.0)), [(0.1, 0.0, 12.0), (5.0, 3.0, 9.0)]),
    # Points behind the centre, behind an edge, and on the line through the centre and a corner.
    "plate": (
        pw.shapes.square(2.0).placed(at(z=3.0)),
        [(0.0, 0.0, 9.0), (2.0, 0.0, 6.0), (2.0, 2.0, 6.0)],
    ),
}


@pytest.mark.parametrize(
    "engine", ["numpy", pytest.param("llvm", marks=(pytest.mark.llvm, pytest.mark.slow))]
)
@pytest.mark.parametrize("name", CASES)
def test_first_field_of_rayleigh_sommerfeld_is_the_slope_of_the_second(
    name: str, engine: Any
) -> None:
    """U_I is -(1/ik) dU_II/dz for a shift of the source; Kirchhoff's field is the mean of both."""
    body, points = CASES[name]
    points = np.array(points)

    def field(method: Any, height: float = 0.0) -> np.ndarray:
        # A shift of the source is an opposite shift of obstacles and points.
        return pw.amplitude(
            SQUARE, points - [0.0, 0.0, height], 1.0, method,
            obstacles=raised(body, -height), tolerance=1e-8, engine=engine,
        )  # fmt: skip

    h = 4e-3
    slope = 8 * (field(RS2, h) - field(RS2, -h)) - (field(RS2, 2 * h) - field(RS2, -2 * h))
    expected = -slope / (12 * h) / (2j * math.pi)
    free = np.abs(pw.amplitude(SQUARE, points, 1.0)).max()
    assert np.abs(field(RS1) - expected).max() < 1e-8 * free
    off = field("kirchhoff") - 0.5 * (expected + field(RS2))
    assert np.abs(off[:2]).max() < 1e-8 * free


def test_level_behind_a_half_plane_at_a_wide_angle() -> None:
    level = 20 * np.log10(np.abs(pw.amplitude(SQUARE, (16.0, 0.0, 2.0), 1.0, obstacles=HALF_PLANE)))
    assert level == pytest.approx(-71.23, abs=0.01)  # -65.6 with the obliquity at the point


def test_field_of_an_aperture_is_its_surface_integral_over_a_plate() -> None:
    method: Any = "kirchhoff"  # mean of the two other methods, which the test above relates
    plate = upright(pw.Aperture([(-6, -3), (5, -3), (5, 2), (-6, 1.2)]), 4.0)
    points = [(8.0, 0.3, 2.0), (9.0, -1.0, 5.0)]
    source = aperture_radiators(SQUARE, method, order=8, longest=2.0)
    expected = shadowed_field([plate], source, points, order=8, share_regions=True)
    result = pw.amplitude(SQUARE, points, 1.0, method, obstacles=plate)
    assert (
        np.abs(result - expected).max() < TOLERANCE * np.abs(source.field(np.array(points))).max()
    )


CURVED = pw.shapes.square(2.0).curved(5.0, 1.0)


def curved_wave(method: str, nodes: np.ndarray) -> np.ndarray:
    """Return the phase of CURVED times the direction cosine of the local ray, its normal slope."""
    wave = np.exp(1j * math.pi * (nodes**2).sum(axis=1) / 5.0)
    return wave * np.sqrt(1.0 - (nodes**2).sum(axis=1) / 25.0) if method == RS2 else wave


def test_curved_waves_have_shadows() -> None:
    method: Any = RS2  # depends on the slope of the wave
    plate = pw.Aperture([(-1, -4), (6, -4), (6, 3), (-1, 4)]).placed(at(z=6.0))
    points = np.array([(0.0, 0.5, 12.0), (-2.0, 1.0, 9.0)])
    source = aperture_radiators(
        pw.shapes.square(2.0), method, 12, 4.0, lambda nodes: curved_wave(method, nodes)
    )
    expected = shadowed_field([plate], source, points, order=8, share_regions=True)
    result = pw.amplitude(CURVED, points, 1.0, method, obstacles=plate)
    assert np.abs(result - expected).max() < TOLERANCE * np.abs(source.field(points)).max()


def test_kirchhoff_field_of_a_curved_wave_is_the_mean_of_both() -> None:
    plate = pw.shapes.square(3.0).placed(at(1.0, 0.0, 6.0))
    points = [(0.0, 0.5, 12.0), (3.0, 1.0, 9.0)]
    first, second, mean = (
        pw.amplitude(CURVED, points, 1.0, method, obstacles=plate)
        for method in (RS1, RS2, "kirchhoff")
    )
    assert np.abs(0.5 * (first + second) - mean).max() < TOLERANCE * np.abs(mean).max()


def paraxial_over_a_half_plane(side: float, x: Any, edge: float, z: float, end: float) -> Any:
    """Return Fresnel's field along x of a square with a half plane at z.

    Each point of the square has the closed form of a half plane; the sum over points is a Gauss
    rule.
    """
    nodes, weights = np.polynomial.legendre.leggauss(1000)
    nodes, weights = nodes * side / 2, weights * side / 2

    def free(x: Any) -> Any:
        return np.exp(1j * math.pi * (x[:, None] - nodes) ** 2 / end) / np.sqrt(1j * end)

    rest = end - z
    cross = nodes + (x[:, None] - nodes) * z / end  # at the plane z
    s, c = fresnel((edge - cross) * math.sqrt(2.0 * end / (z * rest)))
    open_part = 0.5 * (1.0 + (1.0 - 1j) * (c + 1j * s))
    return ((free(x) * open_part) @ weights) * (free(np.zeros(1)) @ weights)


@pytest.mark.filterwarnings("ignore:implausible wavelength")
def test_source_of_1000_wavelengths_behind_a_distant_edge() -> None:
    z, end, edge = 3e5, 9e5, 100.0
    x = np.array([-600.0, 100.0, 900.0])
    wide = pw.Aperture([(edge, -3e3), (3e3, -3e3), (3e3, 3e3), (edge, 3e3)]).placed(at(z=z))
    points = np.column_stack([x, 0 * x, 0 * x + end])
    result = pw.amplitude(pw.shapes.square(1e3), points, 1.0, obstacles=wide, tolerance=1e-4)
    expected = np.abs(paraxial_over_a_half_plane(1e3, x, edge, z, end))
    assert np.abs(np.abs(result) - expected).max() < 2e-3 * expected.max()


def test_equivalent_points_for_few_directions_are_those_for_all() -> None:
    source = pw.Aperture([(-4, -3), (4, -1), (3, 4), (-2, 2)])
    plate = pw.shapes.square(30.0).placed(at(12.0, 3.0, 200.0))
    points = [(5.0, 0.0, 500.0), (-20.0, 10.0, 400.0)]
    few = pw.amplitude(source, points, 1.0, obstacles=plate)
    # The point at a wide angle uses the same equivalent points as the other points.
    wide = [*points, (60.0, 60.0, 0.1)]
    everywhere = pw.amplitude(source, wide, 1.0, obstacles=plate)[:2]
    assert np.abs(few - everywhere).max() < TOLERANCE * np.abs(few).max()


@pytest.mark.filterwarnings("ignore:implausible wavelength")
def test_sources_that_are_too_large_are_refused_before_anything_is_computed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def never(*_: Any) -> Any:
        raise AssertionError

    monkeypatch.setattr("polywigner.propagation.equivalent_points.fourier", never)
    near = pw.shapes.square(50.0).placed(at(z=100.0))
    words = r"source of 1e\+03 × 1e\+03 wavelengths requires at least \d+ .* at most 32768"
    with pytest.raises(ArgumentError, match=words):
        pw.amplitude(pw.shapes.square(1e3), (0.0, 0.0, 200.0), 1.0, obstacles=near)


def test_free_field_of_a_point_source_is_its_wave() -> None:
    source, point = pw.PointSource((1.0, 0.0, 0.0), 2j), (1.0, 3.0, 4.0)
    assert pw.amplitude(source, point, 0.3) == pytest.approx(
        2j * np.exp(10j * math.pi / 0.3) / 5.0, rel=1e-12
    )
    for method in ("wigner", "auto", RS1, RS2, "kirchhoff"):
        result = pw.irradiance(source, [point, (1.0, 0.0, -2.0)], 0.1, method)
        assert result == pytest.approx([4 / 25, 1.0])
    with pytest.raises(ArgumentError, match="position of the point source"):
        pw.amplitude(source, source.position, 0.3)
    with pytest.raises(ArgumentError, match="a PointSource, and any source"):
        pw.amplitude(source, point, 0.3, "fresnel")
