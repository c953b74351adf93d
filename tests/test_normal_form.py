"""Public sources and their normal forms have the same content."""

from __future__ import annotations

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.source.lattices import separated
from polywigner.source.normal_form import normal_form

SQUARE = pw.shapes.square(2.0)
TILT = pw.Illumination([1.0, 0.5j], [(0.25, 0.0), (0.0, -0.5)])
POSITIONS = pw.arrays.grid_positions(4, 3, 3.0, 2.5)
WEIGHTS = np.exp(1j * np.arange(12.0))
POSE = np.array(
    [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.5], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
MIRRORS = pw.shapes.hexagonal_segments(4.0, 0.1, rings=1)
SOURCES = {
    "aperture": SQUARE,
    "waves": SQUARE.with_illumination(TILT),
    "slits": pw.Slits([[0.0, 1.0], [2.0, 2.5]]),
    "array": pw.Array([SQUARE, SQUARE.with_illumination(TILT).moved((3.0, 0.0))], [1.0, 0.5j]),
    "phased array": pw.phased_array(SQUARE.with_illumination(TILT), POSITIONS, WEIGHTS),
    "curved wave": SQUARE.curved(2.0, 0.5, (0.5, 0.0)),
    "partly coherent": SQUARE.partially_coherent(0.5),
    "segments": pw.segmented_pupil(MIRRORS, 0.5, piston=0.1 * np.arange(6)),
}
PLACED = pw.Array([SQUARE.placed(POSE), SQUARE], [1.0, 2.0])
SOURCE = pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)


def values(source, dimension):
    points = np.array([[0.3, -0.2], [1.1, 0.4]])[:, :dimension]
    if normal_form(source).is_coherent:
        return pw.fourier(source, points)
    return pw.wigner(source, 0.1 * points, points)


@SOURCE
def test_a_source_made_of_its_normal_form_has_the_same_transform(source):
    form = normal_form(source)
    result = values(form.public, form.dimension)
    assert result == pytest.approx(values(source, form.dimension), rel=1e-14, abs=1e-14)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_waves_are_proportional_whatever_their_amplitudes(scale):
    waves = [TILT, pw.Illumination([1.0, 0.6j], TILT.frequencies)]
    for second, count in zip(reversed(waves), (2, 1), strict=True):
        fields = [pw.Illumination(scale * w.amplitudes, w.frequencies) for w in (TILT, second)]
        one, other = (SQUARE.with_illumination(field) for field in fields)
        assert len(normal_form(pw.Array([one, other.moved((4.0, 0.0))])).groups) == count


@SOURCE
def test_the_field_of_a_normal_form_is_the_field_of_its_source(source):
    form = normal_form(source)
    assert len(form) == len(form.elements) == len(form.weights)
    assert form.bounds == pytest.approx(source.bounds, rel=1e-15)
    members = np.concatenate([group.members for group in form.groups])
    assert sorted(members) == list(range(len(form)))
    for group in form.groups:
        first = form.elements[group.members[0]]
        for member, factor in zip(group.members, group.factors, strict=True):
            amplitudes = form.elements[member].amplitudes
            assert amplitudes == pytest.approx(factor * first.amplitudes, rel=1e-14)


@SOURCE
def test_a_normal_form_is_kept_with_its_source(source):
    assert normal_form(source) is normal_form(source)
    assert normal_form(normal_form(source)) is normal_form(source)
    assert normal_form(normal_form(source).public) is normal_form(source)


def test_poses_in_the_plane_are_applied():
    form = normal_form(PLACED)
    assert form.elements[0].pose is not None
    assert form.in_plane.bounds == pytest.approx((-1.0, -1.0, 4.0, 1.5))
    nu = np.array([[0.1, 0.2]])
    assert pw.wigner(PLACED, nu, nu) == pytest.approx(pw.wigner(form.in_plane.public, nu, nu))


def test_a_repeated_element_is_found_among_many_elements():
    places = pw.arrays.grid_positions(6, 5, 3.0, 2.5)
    copies = normal_form(pw.Array([SQUARE.moved(place) for place in places])).copies
    assert copies is not None and copies.positions == pytest.approx(places - places[0])
    assert copies.lattice is not None and copies.lattice.weights.size == 30
    assert normal_form(SOURCES["array"]).copies is None


@pytest.mark.parametrize("taper", [[1.0, 1.0], [1.0, 2.0, -2.0, 2.0, 1.0]])
def test_steered_weights_are_real_amplitudes_with_a_linear_phase(taper):
    weights = np.exp(0.4j * np.pi * np.arange(len(taper))) * taper
    column, row = separated(weights[:, None])
    assert column.cycles_per_element == pytest.approx(0.2, abs=1e-14)
    assert column.amplitudes == pytest.approx(taper, rel=1e-13) and row.is_uniform


def test_changed_sources_have_the_fields_of_changed_public_sources():
    for name in ("waves", "array", "phased array"):
        form, kappa, nu = normal_form(SOURCES[name]), np.array([0.2, -0.1]), np.array([[0.3, 0.1]])
        expected = pw.fourier(SOURCES[name], nu - kappa)
        assert pw.fourier(form.tilted(kappa).public, nu) == pytest.approx(expected, rel=1e-13)
        shift = np.array([0.7, -2.0])
        expected = pw.fourier(SOURCES[name], nu) * np.exp(-2j * np.pi * (nu @ shift))
        assert pw.fourier(form.moved(shift).public, nu) == pytest.approx(expected, rel=1e-13)
        weights = np.linspace(1.0, 2.0, len(form))
        assert (form.with_weights(weights).weights == weights).all()


def test_properties_tell_flat_and_coherent_sources():
    forms = {name: normal_form(source) for name, source in SOURCES.items()}
    flat = {name for name, form in forms.items() if form.is_flat}
    assert flat == set(SOURCES) - {"curved wave"}
    assert {name for name, form in forms.items() if not form.is_coherent} == {"partly coherent"}


def test_polyhedra_have_no_normal_form():
    with pytest.raises(ArgumentError, match="got Polyhedron"):
        normal_form(_cube())


def _cube():
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return pw.Polyhedron(corners, faces)
