"""Physical laws of the transforms of any aperture, and independent reference values."""

import math
from collections import defaultdict
from functools import lru_cache

import numpy as np
import pytest

import polywigner as pw
from oracles import disc, exact
from oracles.references import ENGINES, aperture, read_json


@pytest.mark.parametrize("name", disc.QUANTITIES)
def test_polygons_approach_the_disc_at_their_order(name):
    """Return the largest errors over several directions."""
    mean_order = disc.orders(disc.errors(name, (32, 64, 128, 256))).mean()
    assert mean_order == pytest.approx(disc.QUANTITIES[name][2], abs=0.25)


ELL = pw.Aperture([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])

WILD = pw.Illumination([1, 0.3 - 0.5j, -0.2 + 1j], [[1.5, 0.5], [0.7, -0.4], [1.6, 0.4]])


def test_fourier_transform_of_a_placed_aperture_with_waves():
    angle = 0.7
    pose = np.array(
        [
            [math.cos(angle), 0, math.sin(angle), 3.0],
            [0, 1, 0, -2.0],
            [-math.sin(angle), 0, math.cos(angle), 1.0],
            [0, 0, 0, 1],
        ]
    )
    nu = np.random.default_rng(11).normal(size=(30, 3))
    source = ELL.with_illumination(WILD)
    expected = pw.fourier(source, nu @ pose[:3, :2]) * np.exp(-2j * np.pi * (nu @ pose[:3, 3]))
    got = pw.fourier(source.placed(pose), nu)
    assert np.abs(got - expected).max() < 1e-13 * np.abs(expected).max()
    moved = pw.Array([source.placed(pose)], [2.0])
    assert np.abs(pw.fourier(moved, nu) - 2 * expected).max() < 2e-13 * np.abs(expected).max()


# Two independent methods agree within 6.5e-16 of the area.

# Accuracy that the documentation states, relative to the area.
TOLERANCE = 1e-12
# Error of the oracles relative to independent values.
ORACLE_TOLERANCE = 2e-15


def _complex(pair):
    return complex(float(pair[0]), float(pair[1]))


def _polygons(shape):
    """Return the three representations of a shape in the files."""
    if "polygons" in shape:
        return [(np.array(p["outer"]), list(map(np.array, p["holes"]))) for p in shape["polygons"]]
    if np.ndim(shape["vertices"]) == 3:
        return [(np.array(ring), []) for ring in shape["vertices"]]
    return [(np.array(shape["vertices"])[:, :2], [])]


@lru_cache(maxsize=8)
def _grouped(name, kind=None):
    """Return (polygons, cases) of each shape in a file."""
    data, groups = read_json(name), defaultdict(list)
    for case in data["cases"]:
        if kind is None or case["kind"] == kind:
            groups[case["shape"]].append(case)
    return [(_polygons(data["shapes"][shape]), cases) for shape, cases in groups.items()]


def _column(cases, key):
    return np.array([case[key] for case in cases])


def _values(cases, key="value"):
    return np.array([_complex(case[key]) for case in cases])


def _at_real_frequencies(cases):
    return [case for case in cases if not any(imag for _, imag in case["q"])]


def _frequencies(cases):
    """Return frequencies nu: the file has exp(+i q.r) instead of exp(-2 pi i nu.x)."""
    return np.array([[real for real, _ in case["q"][:2]] for case in cases]) / (-2 * math.pi)


@pytest.mark.parametrize("engine", ENGINES)
def test_w_a_and_the_otf_have_their_reference_values(engine):
    for kind, transform, first, second in (
        ("W", pw.wigner, "x", "nu"),
        ("A", pw.ambiguity, "upsilon", "xi"),
    ):
        for polygons, cases in _grouped("wigner", kind):
            source, points = aperture(polygons), (_column(cases, first), _column(cases, second))
            value = transform(source, *points, engine=engine)
            assert np.abs(value - _values(cases)).max() / source.area < TOLERANCE
    for polygons, cases in _grouped("otf"):
        xi, expected = _column(cases, "xi"), _column(cases, "otf").astype(float)
        value = pw.otf(aperture(polygons), xi, engine=engine)
        assert np.abs(value - expected).max() < TOLERANCE


def test_fourier_transforms_have_their_reference_values():
    for polygons, cases in _grouped("fourier_polygons"):
        cases, source = _at_real_frequencies(cases), aperture(polygons)
        error = pw.fourier(source, _frequencies(cases)) - _values(cases, "F")
        assert np.abs(error).max(initial=0.0) < TOLERANCE * source.area


def test_the_oracle_has_the_reference_values():
    """The second method integrates over scan lines."""
    for kind, x, nu, transform in (
        ("W", "x", "nu", exact.wigner),
        ("A", "upsilon", "xi", exact.ambiguity),
    ):
        for polygons, cases in _grouped("wigner", kind):
            rings = exact.oriented(polygons)
            value = [transform(rings, case[x], case[nu]) for case in cases]
            expected = _values(cases) if kind == "A" else _values(cases).real
            assert np.abs(np.array(value) - expected).max() < ORACLE_TOLERANCE
    for polygons, cases in _grouped("fourier_polygons"):
        rings, cases = exact.oriented(polygons), _at_real_frequencies(cases)
        value = np.array([exact.fourier(rings, nu) for nu in _frequencies(cases)])
        assert np.abs(value - _values(cases, "F")).max(initial=0.0) < ORACLE_TOLERANCE * exact.area(
            rings
        )
