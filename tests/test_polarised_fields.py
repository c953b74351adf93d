"""Electric fields of polarised sources: Maxwell's equations, sums of dipoles and far fields.

Lengths are in wavelengths.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.quadrature import graded_in_plane, triangle_nodes
from polywigner.errors import ArgumentError, IlluminationError, PolywignerError

MODELS: tuple[Any, ...] = ("huygens", "magnetic", "electric")
models = pytest.mark.parametrize("model", MODELS)
SHARES = {"huygens": (0.5, 0.5), "magnetic": (1.0, 0.0), "electric": (0.0, 1.0)}
DUAL: dict[Any, Any] = {"huygens": "huygens", "magnetic": "electric", "electric": "magnetic"}
K = 2 * math.pi

EXACT = 1e-9
"""Relative; asked for are 1e-12, and the dense sums reach 1e-12 away from the edges."""

ELL = pw.Aperture([[-1.5, -1.5], [1.5, -1.5], [1.5, -0.5], [-0.4, -0.5], [-0.4, 1.5], [-1.5, 1.5]])
SLANT = pw.shapes.triangle(1.6, 1.1)
SOURCES: dict[str, Any] = {
    "L": ELL,
    "steered taper": ELL.with_illumination(
        pw.steering((0.5, -0.3, math.sqrt(0.66)), 1.0) * pw.cosine_taper(3.2)
    ),
    "evanescent": SLANT.with_illumination(pw.Illumination([1.0, 0.5], [(0.9, 0.8), (0.0, 0.2)])),
    "grazing": SLANT.with_illumination(pw.Illumination([1.0], [(0.6, 0.8)])),
    "nearly grazing": SLANT.with_illumination(pw.Illumination([1.0], [(0.999, 0.01)])),
}
JONES = np.array([0.6, 0.8j])
POINTS = np.array(
    [(0.1, -0.9, 0.05), (-1.49, 0.3, 0.02), (0.8, 0.7, 0.4), (3.0, -2.0, 1.5), (-4.0, 6.0, 20.0)]
)


def dipole(way: np.ndarray, q: np.ndarray, model: str) -> np.ndarray:
    """Return textbook fields (n, 3) of a short dipole at vectors ``way`` (n, 3)."""
    r = np.linalg.norm(way, axis=1, keepdims=True)
    s = way / r
    wave = np.exp(1j * K * r) / (1j * r)
    m = np.cross([0.0, 0.0, 1.0], q)
    of_magnetic = (1 + 1j / (K * r)) * np.cross(m, s)
    across = np.cross(np.cross(s, q), s)  # electric dipole with near-field terms
    near = (3 * s * (s @ q)[:, None] - q) * (1 / (K * r) ** 2 - 1j / (K * r))
    share = SHARES[model]
    return wave * (share[0] * of_magnetic + share[1] * (across + near))


def dense(source: Any, point: np.ndarray, jones: np.ndarray, model: str) -> np.ndarray:
    """Sum dipoles over the opening, on triangles graded towards the point."""
    q = np.append(jones, 0.0)
    field = source.illumination or pw.Illumination([1.0], [(0.0, 0.0)])
    nodes, weights = triangle_nodes(graded_in_plane(source, point, 0.6), 18)
    total = np.zeros(3, np.complex128)
    for some in np.array_split(np.arange(len(nodes)), 1 + len(nodes) // 50000):
        way = np.column_stack([point[:2] - nodes[some], np.full(len(some), point[2])])
        total += (weights[some] * field(nodes[some])) @ dipole(way, q, model)
    return total


# The model "huygens" contains the terms of both other models.
cases = pytest.mark.parametrize(
    ("name", "model"), [("L", m) for m in MODELS] + [(n, "huygens") for n in SOURCES if n != "L"]
)


@cases
def test_a_near_field_is_the_sum_of_its_dipoles(name: str, model: Any) -> None:
    result = pw.field(SOURCES[name], POINTS, 1.0, JONES, model, tolerance=1e-12)
    for point, value in zip(POINTS, result, strict=True):
        expected = dense(SOURCES[name], point, JONES, model)
        assert value == pytest.approx(expected, abs=EXACT * np.abs(expected).max())


@pytest.mark.parametrize("model", ["magnetic", "electric"])
def test_power_through_a_near_hemisphere_is_the_radiated_power(model: Any) -> None:
    """The Poynting vector of near fields at one wavelength is compared with the pattern.

    Some power of Huygens currents leaves through the plane next to the source.
    """
    patch = pw.shapes.rectangle(0.5, 0.3)
    node, weight = np.polynomial.legendre.leggauss(24)
    polar, azimuth = np.meshgrid((node + 1) / 2, np.arange(16) * math.pi / 8, indexing="ij")
    sine = np.sqrt(1 - polar**2)
    s = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), polar], axis=-1)
    electric = pw.field(patch, s, 1.0, JONES, model)
    magnetic = pw.field(patch, s, 1.0, (-JONES[1], JONES[0]), DUAL[model])
    flux = (np.cross(electric, magnetic.conj()).real * s).sum(axis=-1).mean(axis=1)
    result = math.pi * (weight @ flux)
    pattern = pw.radiation_pattern(patch, 1.0, 0.0, 0.0, polarisation=JONES, method=model)
    assert result == pytest.approx(pattern.attrs["radiated_power"], rel=1e-5)


def test_the_magnetic_model_has_the_field_of_the_opening_along_the_plane() -> None:
    """The tangential field is Rayleigh-Sommerfeld I times p: u p in the opening, zero outside."""
    source = SOURCES["steered taper"]
    result = pw.field(source, POINTS, 1.0, JONES, "magnetic", tolerance=1e-12)
    scalar = pw.amplitude(source, POINTS, 1.0, tolerance=1e-12)
    assert result[:, :2] == pytest.approx(scalar[:, None] * JONES, abs=1e-12)
    inside, beside = pw.field(source, [(-1.0, 0.2, 1e-6), (0.5, 0.5, 1e-6)], 1.0, "x", "magnetic")
    assert inside[0] == pytest.approx(source.illumination((-1.0, 0.2)), abs=1e-5)
    assert beside[:2] == pytest.approx([0, 0], abs=1e-5)


@models
def test_a_curved_wave_of_large_radius_is_a_flat_one(model: Any) -> None:
    """The algorithms are a sum over points for curved waves, and along edges for flat waves."""
    curved = ELL.curved(1e12, 1.0)
    flat = pw.field(ELL, POINTS, 1.0, "30 deg", model, tolerance=1e-12)
    result = pw.field(curved, POINTS, 1.0, "30 deg", model)
    assert result == pytest.approx(flat, abs=EXACT * np.abs(flat).max())


def test_elements_may_have_polarisations_of_their_own() -> None:
    """A sequentially rotated array of dipoles is circularly polarised on its axis."""
    speck = pw.shapes.square(0.3)
    places = [(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4)]
    slants = ["0 deg", "90 deg", "180 deg", "270 deg"]
    array = pw.phased_array(speck, places, [1, 1j, -1, -1j])
    whole = pw.field(array, POINTS, 1.0, slants)
    angles = np.radians([0, 90, 180, 270])
    parts = [
        w * pw.field(speck.moved(place), POINTS, 1.0, (math.cos(a), math.sin(a)))
        for w, place, a in zip(array.weights, places, angles, strict=True)
    ]
    assert whole == pytest.approx(sum(parts), abs=1e-8)
    ahead = pw.field(array, (0.0, 0.0, 1e6), 1.0, slants)
    assert ahead[1] == pytest.approx(1j * ahead[0], rel=1e-6)  # right-handed


def test_handedness_is_that_of_the_ieee() -> None:
    """For "right", E of exp(-i omega t) rotates counter-clockwise when viewed against the wave."""
    field = pw.field(pw.shapes.square(1.0), (0.0, 0.0, 1e4), 1.0, "right")
    angles = [np.angle(complex(*(field * np.exp(-1j * t)).real[:2])) for t in (0.0, 0.1)]
    assert (angles[1] - angles[0]) % (2 * math.pi) == pytest.approx(0.1)


def test_labels_of_points_stay() -> None:
    xarray = pytest.importorskip("xarray")
    points = xarray.DataArray(POINTS[2:], dims=("place", "axis"))
    result = pw.field(ELL, points, 1.0, "y")
    assert result.dims == ("place", "component")
    plain = pw.field(ELL, POINTS[2:], 1.0, "y")
    assert result.sel(component="z").values == pytest.approx(plain[:, 2])


PARTLY = pw.shapes.square(1.0).partially_coherent(0.5)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ((ELL, (0, 0, 1), 1.0, "up"), ArgumentError, "45 deg"),
        ((ELL, (0, 0, 1), 1.0, "x", "kirchhoff"), ArgumentError, "magnetic"),
        ((ELL, (0, 0, -1), 1.0, "x"), ArgumentError, "in front"),
        ((PARTLY, (0, 0, 1), 1.0, "x"), IlluminationError, "coherent"),
        ((pw.Slits([[0, 1]]), (0, 0, 1), 1.0, "x"), PolywignerError, "Aperture"),
    ],
)
def test_what_is_no_polarised_source_is_refused(arguments: Any, error: Any, words: str) -> None:
    with pytest.raises(error, match=words):
        pw.field(*arguments)
