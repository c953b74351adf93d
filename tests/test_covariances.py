"""Covariances of arrays that receive scatterers, against closed forms and powers."""

from typing import Any

import numpy as np
import pytest
from mpmath import besselj

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

pytestmark = pytest.mark.drjit
pm = pytest.importorskip("polywigner.mitsuba")

WAVELENGTH = 3.893e-3
ELEMENT = pw.shapes.square(0.4 * WAVELENGTH)
PLACES = (np.arange(12) - 5.5) * WAVELENGTH * 0.75
ARRAY = pw.Array([ELEMENT.moved((x, 0.0)) for x in PLACES], np.exp(0.3j * np.arange(12)))
DISTANCE, RADIUS = 5.0, 0.5

# Error of Airy's formula for a disc of the tested angle with random points.
AIRY = 0.01
# Relative error of responses, whose fields have a tolerance of 1e-6.
FIELDS = 1e-5


def cloud(place, intensity, path=None, **attrs):
    """Return scatterers for a receiver at the origin that points along z."""
    values = {
        "position": np.asarray(place, float),
        "intensity": np.asarray(intensity, float),
        "path_length": np.asarray(np.ones(len(place)) if path is None else path, float),
    }
    return labelled_arrays(
        {name: labelled_array(v, ("scatterer", "axis")[: v.ndim]) for name, v in values.items()},
        {},
        {
            "wavelength": WAVELENGTH,
            "obliquity": "rayleigh-sommerfeld-1",
            "to_world": np.eye(4).ravel().tolist(),
            "normalise": "radiated",
            **attrs,
        },
    )


def disc(count=4000):
    """Return points that fill a disc evenly (a sunflower pattern)."""
    k = np.arange(count) + 0.5
    angle, radius = k * np.pi * (3 - np.sqrt(5)), RADIUS * np.sqrt(k / count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * k + DISTANCE], axis=1)


def airy():
    """Return the coherence with the first element, 2 J1(z)/z times a phase."""
    sine = RADIUS / np.hypot(RADIUS, DISTANCE)
    apart = 2 * np.pi / WAVELENGTH * sine * (PLACES - PLACES[0])
    modulus = np.array([1.0 if z == 0 else float(2 * besselj(1, z) / z) for z in apart])
    turn = np.exp(1j * np.pi / WAVELENGTH / DISTANCE * (PLACES[0] ** 2 - PLACES**2))
    return modulus * turn


def degree(matrix):
    diagonal = np.sqrt(np.diag(matrix).real)
    return matrix / np.outer(diagonal, diagonal)


def test_a_disc_gives_airys_coherence():
    """The result follows from the van Cittert-Zernike theorem."""
    result = degree(pm.covariance(cloud(disc(), np.ones(4000)), ARRAY))
    assert np.abs(result[0] - airy()).max() < AIRY
    # The element is beyond the first zero of Airy's function.
    assert result[0, -1].real < 0
    assert np.allclose(result, result.conj().T, rtol=1e-12, atol=1e-12)


def test_responses_are_fields_by_reciprocity():
    """The coupling to a small source of known power equals the response."""
    place = np.array([[0.3, -0.2, 1.0]])
    source = pw.shapes.square(WAVELENGTH / 100)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])
    turned[:3, 3] = place
    how: Any = {"method": "rayleigh-sommerfeld-2", "normalise": "aperture"}
    b = pw.coupling(ELEMENT, source, turned, WAVELENGTH, **how)
    field = pw.amplitude(ELEMENT, place[0], WAVELENGTH, method="rayleigh-sommerfeld-2")
    # The coupling is b = U A_s/sqrt(N_t A_s), with the field U at the small source.
    assert b == pytest.approx(field * np.sqrt(source.area / ELEMENT.area), rel=1e-3)
    first = pw.amplitude(ELEMENT, place[0], WAVELENGTH, method="rayleigh-sommerfeld-1")
    radiated = pw.radiated_power(ELEMENT, WAVELENGTH)
    assert radiated < 0.3 * ELEMENT.area
    for attrs, power in (
        ({}, radiated),
        ({"normalise": "radiated"}, radiated),
        ({"normalise": "aperture"}, ELEMENT.area),
    ):
        (response,) = pm.element_responses(cloud(place, [1.0], **attrs), ELEMENT)[0]
        assert response == pytest.approx(first * WAVELENGTH / np.sqrt(power), rel=FIELDS)


def test_gates_add_up_and_hold_what_is_in_them():
    place = disc(200)
    path = np.linspace(2.0, 10.0, 200)
    whole = cloud(place, np.ones(200), path)
    edges = [1.0, 2.5, 4.0, 5.0]
    gates = pm.covariance(whole, ARRAY, ranges=edges)
    assert gates.shape == (3, 12, 12)
    assert np.allclose(gates.sum(axis=0), pm.covariance(whole, ARRAY), rtol=1e-9)
    inside = (path / 2 >= 2.5) & (path / 2 < 4.0)
    part = cloud(place[inside], np.ones(inside.sum()), path[inside])
    assert np.allclose(gates[1], pm.covariance(part, ARRAY), rtol=1e-9)
    assert not pm.covariance(whole, ARRAY, ranges=[6.0, 7.0]).any()


def test_elements_count_each_alone_and_places_behind_them_for_nothing():
    place = np.concatenate([disc(50), disc(50) * [1, 1, -1]])
    result = pm.element_responses(cloud(place, np.ones(100)), ARRAY)
    assert not result[:, 50:].any() and result[:, :50].all()
    alone = pm.element_responses(cloud(place, np.ones(100)), list(ARRAY.elements_in_plane))
    assert np.array_equal(result, alone)
    shifted = np.eye(4)
    shifted[0, 3] = PLACES[3]
    moved = pm.element_responses(cloud(place, np.ones(100)), ELEMENT, to_world=shifted)
    assert np.allclose(moved[0], result[3], rtol=1e-4, atol=1e-6 * abs(result).max())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cloud": {"power": 1}}, "the result of .*scatterers"),
        ({"to_world": 2 * np.eye(4)}, "rigid"),
        ({"ranges": [1.0]}, "edges of bins"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    given = {"cloud": cloud(disc(3), np.ones(3)), "elements": ARRAY} | change
    with pytest.raises((ArgumentError, GeometryError), match=message):
        pm.covariance(given.pop("cloud"), given.pop("elements"), **given)
