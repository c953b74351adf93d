"""Irradiance by Wigner rays against diffraction integrals, limits, and itself by other means."""

import warnings
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.references import read_json
from oracles.surface_integrals import field_by_quadrature
from polywigner.errors import ArgumentError, PolywignerError, PolywignerWarning

CONDITIONS = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2")

# In wavelengths: 10 mm at 94 GHz
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

# The powers of the distance with which errors fall, and how nearly so from 40 to 80 wavelengths.
POWERS, NEARLY = {1: 2, 3: 4}, 0.1
# Kirchhoff's mean of both integrals, for waves that leave at different angles, has a term of the
# next lower power, which vanishes for sources that are symmetric about their centre.
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
    found = pw.irradiance(SQUARE, (0, 0, 2), 1.0, obliquity=obliquity, tolerance=1e-8)
    assert found == pytest.approx(VALUES[name], rel=ACCURATE)


# Each condition with one wave and with several; parts and arrays are sums of the same terms.
CASES = [("square", "kirchhoff"), ("steered", "rayleigh-sommerfeld-1")]
CASES += [("evanescent wave", "kirchhoff"), ("three waves", "rayleigh-sommerfeld-2")]
CASES = [(*case, order) for case in CASES for order in (1, 3)]
CASES += [("two triangles", "rayleigh-sommerfeld-1", 3), (*UNSYMMETRIC, 1)]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "condition", "order"), CASES)
def test_the_error_of_rays_falls_with_the_power_of_the_distance_that_theory_has(
    name, condition, order
):
    source = SOURCES[name]
    outline = source.support if isinstance(source, pw.Array) else source
    errors = []
    for distance in (40.0, 80.0):
        points = on_arc(distance, np.arange(-60, 61, 20), 35.0)
        points[:, :2] += outline.centre
        expected = np.abs(field_by_quadrature(source, points, 1.0, condition)) ** 2
        found = pw.irradiance(source, points, 1.0, obliquity=condition, order=order, tolerance=1e-7)
        errors.append(np.sqrt(((found - expected) ** 2).mean()) / expected.max())
    power = np.log2(errors[0] / errors[1])
    lost = 1 if (name, condition) == UNSYMMETRIC else 0
    assert POWERS[order] - lost - NEARLY < power < POWERS[order] + NEARLY


def test_third_order_is_right_on_axis_from_three_wavelengths_on():
    points = np.array([(0.0, 0.0, z) for z in (3, 3.5, 4, 5, 7, 10, 20, 50)])
    for condition in ("kirchhoff", "rayleigh-sommerfeld-1"):
        expected = np.abs(field_by_quadrature(SQUARE, points, 1.0, condition)) ** 2
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PolywignerWarning)
            found = pw.irradiance(SQUARE, points, 1.0, obliquity=condition, order=3, tolerance=1e-5)
        assert abs(10 * np.log10(found / expected)).max() < 0.025


@pytest.mark.slow
@pytest.mark.parametrize("sampling", ["sobol", "monte-carlo"])
def test_drawn_places_give_the_same_within_their_error(sampling):
    points = on_arc(7.0, np.arange(-60, 61, 20))
    exact = pw.irradiance(SQUARE, points, 1.0, tolerance=1e-8)
    found, errors = pw.irradiance(
        SQUARE, points, 1.0, sampling=sampling, samples=4096, seed=3, return_error=True
    )
    assert (abs(found - exact) < 5 * errors).all()  # 16 batches: five standard deviations
    again = pw.irradiance(SQUARE, points, 1.0, sampling=sampling, samples=4096, seed=3)
    assert (again == found).all()


@pytest.mark.parametrize(("sampling", "height"), [("gauss", 1e-9), ("monte-carlo", 1e-7)])
def test_points_on_the_source_whose_rays_pass_between_all_places_have_no_error_estimate(
    sampling, height
):
    square, points = pw.shapes.square(10e-3), [(0, 0, height), (1e-3, 2e-3, height)]
    with pytest.warns(PolywignerWarning, match="tolerance asked for is not met"):
        found, error = pw.irradiance(
            square, points, 3.2e-3, sampling=sampling, seed=1, return_error=True
        )
    exact = pw.irradiance(square, points, 3.2e-3, "auto")
    assert (np.abs(found - exact) > 0.5).all()  # of 1
    assert np.isinf(error).all()


def test_points_beside_the_source_have_one_however_low_they_are():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*rough picture")
        found, error = pw.irradiance(
            pw.shapes.square(10e-3), (8e-3, 0.0, 1e-8), 3.2e-3, return_error=True
        )
    assert 0 < found < 1e-12 and error < 1e-15  # as the square of the height


@pytest.mark.llvm
@pytest.mark.parametrize("order", [1, 3])
def test_engines_and_precisions_agree(order):
    points = on_arc(18.0, np.arange(-80, 81, 20), 15.0)
    source = pw.shapes.triangle(3.0, 2.0)
    first = pw.irradiance(source, points, 1.0, order=order, engine="numpy")
    second = pw.irradiance(source, points, 1.0, order=order, engine="llvm")
    assert abs(first - second).max() < 1e-12 * first.max()
    single = pw.irradiance(
        source, points, 1.0, order=order, engine="llvm", precision="single", tolerance=1e-6
    )
    assert abs(first - single).max() < 1e-5 * first.max()


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
        found, errors = pw.irradiance(
            SQUARE, points, 1.0, method, tolerance=tolerance, return_error=True
        )
        allowed = tolerance * np.maximum(exact, 1e-3 * exact.max())
        assert (abs(found - exact) <= allowed).all()
        assert (abs(found - exact) <= errors + 1e-11 * exact.max()).all()


def test_fraunhofer_irradiance_takes_an_obliquity():
    far = on_arc(1e5, [0.0, 30.0, 60.0])
    for obliquity in CONDITIONS:
        rays = pw.irradiance(SQUARE, far, 1.0, obliquity=obliquity, tolerance=1e-8)
        found = pw.irradiance(SQUARE, far, 1.0, "fraunhofer", obliquity=obliquity)
        assert found == pytest.approx(rays, rel=1e-3, abs=1e-6 * rays.max())


def test_points_may_have_any_shape_and_one_point_gives_a_number():
    points = on_arc(8.0, np.arange(0, 60, 10)).reshape(2, 3, 3)
    assert pw.irradiance(SQUARE, points, 1.0).shape == (2, 3)
    assert isinstance(pw.irradiance(SQUARE, points[0, 0], 1.0), float)
    assert pw.irradiance(SQUARE, np.empty((0, 3)), 1.0).shape == (0,)


def test_the_sum_over_hundreds_of_wavelengths_is_right_or_refused():
    """Lobes of a strip of 400 wavelengths, far off its axis, where W turns hundreds of times."""
    strip, wavelength = pw.shapes.rectangle(1.0, 0.02), 2.5e-3
    lobes = 2000.0 * on_arc(1.0, [30.04, 45.0, 45.02])
    found = pw.irradiance(strip, lobes, wavelength, tolerance=1e-7)
    exact = pw.irradiance(strip, lobes, wavelength, "rayleigh-sommerfeld-1", tolerance=1e-12)
    # of leading order, at 5 L^2/wavelength
    assert found == pytest.approx(exact, rel=1e-3, abs=0.0)
    with pytest.raises(ArgumentError, match="fewer wavelengths"):
        pw.irradiance(pw.shapes.square(1.0), (0.5, 0.0, 2.0), 1e-5)


@pytest.mark.parametrize(
    "options",
    [
        {"order": 2},
        {"order": True},
        {"obliquity": "cosine"},
        {"obliquity": "paper", "order": 3},
        {"tolerance": 0.0},
        {"tolerance": "fine"},
        {"sampling": "grid"},
        {"samples": 100},
        {"sampling": "sobol", "samples": 3},
        {"sampling": "monte-carlo", "seed": "x"},
        {"sampling": "sobol", "samples": 64, "tolerance": 1e-4},
        {"method": "guess"},
        {"method": "kirchhoff", "order": 3},
        {"method": "kirchhoff", "obliquity": "kirchhoff"},
        {"method": "kirchhoff", "sampling": "sobol"},
        {"method": "fresnel", "samples": 64},
        {"engine": "gpu"},
        {"precision": "half"},
    ],
)
def test_options_that_make_no_sense_are_refused(options):
    with pytest.raises(ArgumentError, match="expected"):
        pw.irradiance(SQUARE, (0, 0, 5), 1.0, **options)


@pytest.mark.parametrize(
    "source",
    [pw.Slits([(0, 1)]), SQUARE.placed(np.eye(4)), pw.Array([pw.Slits([(0, 1)])]), "square"],
)
def test_sources_without_a_plane_are_refused(source):
    with pytest.raises(PolywignerError, match="expected"):
        pw.irradiance(source, (0, 0, 5), 1.0)
