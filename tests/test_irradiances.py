"""Irradiance by Wigner rays and by exact fields, against diffraction integrals."""

import warnings
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import read_json
from oracles.surface_integrals import field_by_quadrature
from polywigner.errors import ArgumentError, PolywignerError, PolywignerWarning

CONDITIONS = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2")

# Side of 10 mm at 94 GHz, in wavelengths.
SIDE = 10e-3 / (299792458 / 94e9)
SQUARE = pw.shapes.square(SIDE)

WAVES = pw.Illumination([1, 0.6j, 0.4], [(0.3, 0.1), (-0.25, 0.4), (0.1, -0.6)])
TWO_WAVES = pw.Illumination([1, 0.6j], [(0.3, 0.1), (-0.25, 0.4)])
EVANESCENT = pw.Illumination([1, 0.6j], [(0.3, 0.1), (-0.25, 1.2)])
SOURCES: dict[str, Any] = {
    "square": SQUARE,
    "steered": SQUARE.with_illumination(pw.Illumination([1], [(0.5, 0.1)])),
    "three waves": SQUARE.with_illumination(WAVES),
    "evanescent wave": SQUARE.with_illumination(EVANESCENT),
    "two triangles": pw.Aperture([[(0, 0), (2, 0), (1, 1.5)], [(2.2, 0.3), (3.5, 1), (2.4, 2)]]),
    "array with waves": pw.Array(
        [
            pw.shapes.square(1.0).with_illumination(TWO_WAVES),
            pw.shapes.square(1.0).moved((1.2, 0.3)),
        ],
        [1, 0.7j],
    ),
}

VALUES = {v["id"]: v["value"] for v in read_json("propagation")["values"]}
ACCURATE = 1e-6  # the rtol of the reference values

# Power of the distance with which the error decreases, and tolerance of this power between 40 and
# 80 wavelengths.
POWER, NEARLY = 2, 0.1
# Case with an error of the next lower order: Kirchhoff's integral for waves in different directions
# from an asymmetric source.
UNSYMMETRIC = ("array with waves", "kirchhoff")


def on_arc(distance, degrees, azimuth=0.0):
    theta, phi = np.radians(degrees), np.radians(azimuth)
    rho = np.sin(theta)
    unit = np.stack([rho * np.cos(phi), rho * np.sin(phi), np.cos(theta)], axis=-1)
    return distance * unit


@pytest.mark.parametrize(
    ("name", "obliquity"),
    [
        ("ray_cos_bore_z2", "paper"),
        ("ray_cos2_bore_z2", "rayleigh-sommerfeld-1"),
        ("ray_cos2_bore_z2", None),
        ("ray_kir_bore_z2", "kirchhoff"),
    ],
)
def test_rays_have_their_reference_values(name, obliquity):
    result = pw.irradiance(SQUARE, (0, 0, 2), 1.0, obliquity=obliquity, tolerance=1e-8)
    assert result == pytest.approx(VALUES[name], rel=ACCURATE)


# Each condition with one and with several waves.
CASES = [("square", "kirchhoff"), ("steered", "rayleigh-sommerfeld-1")]
CASES += [("evanescent wave", "kirchhoff"), ("three waves", "rayleigh-sommerfeld-2")]
CASES += [UNSYMMETRIC]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "condition"), CASES)
def test_the_error_of_rays_falls_with_the_square_of_the_distance(name, condition):
    source = SOURCES[name]
    outline = source.support if isinstance(source, pw.Array) else source
    errors = []
    for distance in (40.0, 80.0):
        points = on_arc(distance, np.arange(-60, 61, 20), 35.0)
        points[:, :2] += outline.centre
        expected = np.abs(field_by_quadrature(source, points, 1.0, condition)) ** 2
        result = pw.irradiance(source, points, 1.0, obliquity=condition, tolerance=1e-7)
        errors.append(np.sqrt(((result - expected) ** 2).mean()) / expected.max())
    power = np.log2(errors[0] / errors[1])
    lost = 1 if (name, condition) == UNSYMMETRIC else 0
    assert POWER - lost - NEARLY < power < POWER + NEARLY


def test_points_on_the_source_whose_rays_pass_between_all_nodes_have_no_error_estimate():
    square, points = pw.shapes.square(10e-3), [(0, 0, 1e-9), (1e-3, 2e-3, 1e-9)]
    with pytest.warns(PolywignerWarning, match="tolerance is not met"):
        result, error = pw.irradiance_with_error(square, points, 3.2e-3)
    exact = pw.irradiance(square, points, 3.2e-3, "auto")
    assert (np.abs(result - exact) > 0.5).all()  # relative to 1
    assert np.isinf(error).all()


def test_points_beside_the_source_have_one_however_low_they_are():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*rough approximation")
        result, error = pw.irradiance_with_error(pw.shapes.square(10e-3), (8e-3, 0.0, 1e-8), 3.2e-3)
    assert 0 < result < 1e-12 and error < 1e-15  # square of the height


@pytest.mark.llvm
def test_engines_agree():
    points = on_arc(18.0, np.arange(-80, 81, 20), 15.0)
    source = pw.shapes.triangle(3.0, 2.0)
    first = pw.irradiance(source, points, 1.0, engine="numpy")
    second = pw.irradiance(source, points, 1.0, engine="llvm")
    assert abs(first - second).max() < 1e-12 * first.max()


def test_a_large_lattice_is_the_same_whether_it_is_seen_as_one_or_not():
    element = pw.shapes.rectangle(0.6, 0.4)
    positions = np.array([(0.7 * i, 0.5 * j) for i in range(3) for j in range(2)])
    weights = np.exp(2j * np.pi * positions @ (0.3, 0.1))
    lattice = pw.phased_array(element, positions, weights)
    single = pw.Array([element.moved(p) for p in positions], weights)
    points = on_arc(9.0, np.arange(-60, 61, 20))
    assert pw.irradiance(lattice, points, 1.0) == pytest.approx(pw.irradiance(single, points, 1.0))


@pytest.mark.parametrize(
    "method", ["rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2", "fresnel"]
)
def test_other_methods_give_the_square_of_the_field_at_least_to_the_tolerance(method):
    points = on_arc(8.0, np.arange(-80, 81, 8), 15.0)
    exact = abs(pw.amplitude(SQUARE, points, 1.0, method, tolerance=1e-12)) ** 2
    for tolerance in (1e-2, 1e-5):
        result, errors = pw.irradiance_with_error(SQUARE, points, 1.0, method, tolerance=tolerance)
        allowed = tolerance * np.maximum(exact, 1e-3 * exact.max())
        assert (abs(result - exact) <= allowed).all()
        assert (abs(result - exact) <= errors + 1e-11 * exact.max()).all()


def test_the_estimated_error_follows_from_that_of_the_amplitude():
    """The limit is | |U + e|^2 - |U|^2 | <= (2 |U| + |e|) |e|."""
    point = on_arc(8.0, [20.0, 70.0])
    for method in ("kirchhoff", "fraunhofer"):
        field, error = pw.amplitude_with_error(SQUARE, point, 1.0, method)
        values, errors = pw.irradiance_with_error(SQUARE, point, 1.0, method)
        assert values == pytest.approx(np.abs(field) ** 2, rel=1e-14)
        assert errors == pytest.approx((2 * np.abs(field) + error) * error, rel=1e-12)


def test_fraunhofer_irradiance_takes_an_obliquity():
    far = on_arc(1e5, [0.0, 30.0, 60.0])
    for obliquity in CONDITIONS:
        rays = pw.irradiance(SQUARE, far, 1.0, obliquity=obliquity, tolerance=1e-8)
        result = pw.irradiance(SQUARE, far, 1.0, "fraunhofer", obliquity=obliquity)
        assert result == pytest.approx(rays, rel=1e-3, abs=1e-6 * rays.max())


def test_auto_is_the_exact_field_of_a_boundary_condition_and_rays_for_the_paper_s_factor():
    point = on_arc(8.0, 40.0)
    for obliquity in (None, *CONDITIONS):
        result = pw.irradiance(SQUARE, point, 1.0, "auto", obliquity=obliquity)
        assert result == pw.irradiance(SQUARE, point, 1.0, obliquity or CONDITIONS[0])
    result = pw.irradiance(SQUARE, point, 1.0, "auto", obliquity="paper")
    assert result == pw.irradiance(SQUARE, point, 1.0, obliquity="paper")


@pytest.mark.slow
def test_rays_from_many_edges_name_the_faster_method():
    with pytest.warns(
        PolywignerWarning, match="seconds for a source of 60 edges; use method='auto'"
    ):
        pw.irradiance(pw.shapes.regular_polygon(60, 1e-3), (0.0, 0.0, 1e-2), 3e-3)


def test_points_may_have_any_shape_and_one_point_gives_a_number():
    points = on_arc(8.0, np.arange(0, 60, 10)).reshape(2, 3, 3)
    assert pw.irradiance(SQUARE, points, 1.0).shape == (2, 3)
    assert isinstance(pw.irradiance(SQUARE, points[0, 0], 1.0), float)
    assert pw.irradiance(SQUARE, np.empty((0, 3)), 1.0).shape == (0,)


def test_the_sum_over_hundreds_of_wavelengths_is_right_or_refused():
    """W oscillates hundreds of times at lobes of a strip of 400 wavelengths far off its axis."""
    strip, wavelength = pw.shapes.rectangle(1.0, 0.02), 2.5e-3
    lobes = 2000.0 * on_arc(1.0, [30.04, 45.0, 45.02])
    result = pw.irradiance(strip, lobes, wavelength, tolerance=1e-7)
    exact = pw.irradiance(strip, lobes, wavelength, "rayleigh-sommerfeld-1", tolerance=1e-12)
    # The tolerance allows for the error of the leading order at 5 L^2/wavelength.
    assert result == pytest.approx(exact, rel=1e-3, abs=0.0)
    with pytest.raises(ArgumentError, match="quadrature nodes for Wigner rays"):
        pw.irradiance(pw.shapes.square(1.0), (0.5, 0.0, 2.0), 1e-5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"obliquity": "cosine"}, "obliquity"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"tolerance": "fine"}, "tolerance"),
        ({"method": "kirchhoff", "tolerance": 2.0}, "tolerance"),
        ({"method": "guess"}, '"wigner", "rayleigh.*"fraunhofer", "auto", got'),
        ({"method": None}, "method"),
        ({"method": "kirchhoff", "obliquity": "kirchhoff"}, "obliquity"),
        (
            {"through": pw.FirstOrder.free_space(1.0), "obliquity": "kirchhoff"},
            "obliquity='kirchhoff' cannot be combined",
        ),
        (
            {"through": pw.FirstOrder.free_space(1.0), "obstacles": SQUARE},
            "obstacles cannot be combined with",
        ),
        ({"engine": "gpu"}, "engine"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, words):
    with pytest.raises(ArgumentError, match=words):
        pw.irradiance(SQUARE, (0, 0, 5), 1.0, **options)


@pytest.mark.parametrize(
    "source",
    [pw.Slits([(0, 1)]), SQUARE.placed(np.eye(4)), pw.Array([pw.Slits([(0, 1)])]), "square"],
)
def test_sources_without_a_plane_are_refused(source):
    with pytest.raises(PolywignerError, match="expected"):
        pw.irradiance(source, (0, 0, 5), 1.0)
