"""The public assertions accept what is right and notice what is wrong."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from identities import (
    assert_array_identities,
    assert_marginals,
    assert_otf_properties,
    assert_wigner_identities,
)
from oracles.references import awkward, numpy_and_few
from polywigner import transforms
from polywigner.errors import ArgumentError, GeometryError

PAIR = pw.Slits([[-1.0, -0.4], [0.1, 0.9]])
TRIANGLE = pw.Aperture([[0, 0], [1.3, 0.2], [0.4, 1.1]])
FAR = pw.Aperture([[1000.0, 700.0], [1001.3, 700.2], [1000.4, 701.1]])

Wrong = Callable[..., Any]


@pytest.mark.parametrize(
    ("name", "engine"),
    numpy_and_few(
        ["chevron", "square annulus", "double slit", "bow tie, split", "needle 1e-3, rotated"],
        ["chevron", "needle 1e-3, rotated"],
    ),
)
def test_apertures_obey_all_identities(name, engine):
    assert_wigner_identities(awkward(name).aperture, engine=engine)


@pytest.mark.parametrize("source", [PAIR, TRIANGLE, FAR], ids=["slits", "triangle", "far"])
def test_pupils_have_the_properties_of_pupils(source):
    assert_otf_properties(source, engine="numpy")


WAVES = [
    pw.shapes.chevron(1.0, 0.8, 0.4).with_illumination(
        pw.Illumination([1, 0.5j, -0.3 + 0.2j], [(0, 0), (1.3, 0.4), (-1, 1)])
    ),
    PAIR.with_illumination(pw.Illumination([1, 0.5j, 0.2], [0.3, 2.0, -1.2])),
]
UNIT_SQUARE = pw.shapes.square(1.0)
_WEIGHTS = np.random.default_rng(5).normal(size=(6, 2)) @ (1, 1j)
ARRAYS = [  # of elements that overlap, and on a lattice
    pw.Array(
        [
            UNIT_SQUARE,
            pw.shapes.chevron(1.0, 0.8, 0.3).moved((0.3, 0.2)),
            pw.shapes.regular_polygon(5, 0.7),
        ],
        [1, 1j, -0.4],
    ),
    pw.phased_array(pw.Slits([0.0, 1.0]), np.arange(6) * 1.3, _WEIGHTS),
]


def _times(factor):
    return lambda right, *a, **k: right(*a, **k) * factor


def _plus(offset):
    return lambda right, *a, **k: right(*a, **k) + offset


def _conjugate(right, *a, **k):
    return np.conj(right(*a, **k))


def _shifted_in_phase(right, source, upsilon, xi, **keywords):
    """The ambiguity function about one copy instead of the middle of both: the paper's slip."""
    wave = np.exp(1j * np.pi * (np.asarray(upsilon) * xi).sum(axis=-1))
    return right(source, upsilon, xi, **keywords) * wave


def _at_another_nu(right, source, x, nu, **keywords):
    return right(source, x, np.asarray(nu) * 1.01, **keywords)


def _of_conjugate_field(right, source, *points, **keywords):
    """The second field where the first belongs."""
    field = source.illumination
    if field is not None:
        conjugate = pw.Illumination(field.amplitudes.conj(), -field.frequencies)
        source = source.with_illumination(conjugate)
    return right(source, *points, **keywords)


def _first_wave_alone(right, source, *points, **keywords):
    field = source.illumination
    if field is not None:
        first = pw.Illumination(field.amplitudes[:1], field.frequencies[:1])
        source = source.with_illumination(first)
    return right(source, *points, **keywords)


def _same_for_both_signs(right, source, xi, w=0.0, **k):
    return right(source, xi, abs(w), **k)


def _wider(right, source, xi, w=0.0, **k):
    return right(source, np.asarray(xi) / 1.1, w, **k)


def _brighter_out_of_focus(right, source, xi, w=0.0, **k):
    return right(source, xi, w / 4, **k) * (1 + w * w)


def _without_weights(right, array, *places, **keywords):
    return right(pw.Array(array.elements_in_plane, np.abs(array.weights)), *places, **keywords)


def _conjugate_weights(right, array, *places, **keywords):
    return right(pw.Array(array.elements_in_plane, array.weights.conj()), *places, **keywords)


def _no_cross_terms(right, array, *places, **keywords):
    """The elements as if they were incoherent."""
    pairs = zip(array.elements_in_plane, np.abs(array.weights) ** 2, strict=True)
    return sum(factor * right(element, *places, **keywords) for element, factor in pairs)


def _one_element_nudged(right, array, *places, **keywords):
    first, *others = array.elements_in_plane
    nudge = np.full(1 if isinstance(first, pw.Slits) else 2, 1e-8)
    return right(pw.Array([first.moved(nudge), *others], array.weights), *places, **keywords)


LITTLE, A_LOT = _times(1 + 1e-9), _times(1.0001)
# Assertion, source, the transform that is broken, how, and the law that does not hold.
BROKEN: list[tuple[Callable[..., None], Any, str, Wrong, str]] = [
    *(
        (assert_wigner_identities, source, transform, wrong, "")
        for source in (TRIANGLE, PAIR)
        for transform, wrong in (
            ("wigner", A_LOT),
            ("wigner", _plus(1e-6)),
            ("ambiguity", _conjugate),
            ("position_marginal", _times(0.25)),
            ("lag_marginal", _plus(1e-9)),
            ("fourier", _conjugate),
        )
    ),
    *(
        (assert_wigner_identities, source, transform, wrong, "")
        for source in WAVES
        for transform in ("wigner", "ambiguity", "fourier")
        for wrong in (_of_conjugate_field, _first_wave_alone, A_LOT)
    ),
    (assert_marginals, TRIANGLE, "ambiguity", _shifted_in_phase, r"int A exp"),
    (assert_marginals, TRIANGLE, "wigner", _at_another_nu, r"int W "),
    (assert_marginals, TRIANGLE, "fourier", _times(1.001), r"F\(upsilon\)|int "),
    (assert_marginals, TRIANGLE, "position_marginal", _times(1.001), r"R_x"),
    (assert_marginals, TRIANGLE, "lag_marginal", _times(1.001), r"R_xi"),
    (assert_otf_properties, TRIANGLE, "otf", _times(2.0), "1 at xi = 0"),
    (assert_otf_properties, TRIANGLE, "otf", _same_for_both_signs, "opposite defocus"),
    (assert_otf_properties, TRIANGLE, "otf", _wider, "in focus|mutual content|cut-off"),
    (assert_otf_properties, TRIANGLE, "otf", _brighter_out_of_focus, "in focus|1 at xi = 0"),
    *(
        (assert_array_identities, array, transform, wrong, "")
        for array in ARRAYS
        for transform in ("fourier", "wigner", "ambiguity", "lag_marginal")
        for wrong in (
            _without_weights, _conjugate_weights, _no_cross_terms, _one_element_nudged, LITTLE
        )
        if (transform, wrong) != ("fourier", _no_cross_terms)  # which F has none of
    ),
]  # fmt: skip


@pytest.mark.parametrize(("check", "source", "transform", "wrong", "law"), BROKEN)
def test_a_wrong_transform_is_noticed(check, source, transform, wrong, law, monkeypatch):
    right = getattr(transforms, transform)

    def broken(given, *places, **keywords):
        # the elements of an array are sources as well, and right
        if isinstance(source, pw.Array) and given != source:
            return right(given, *places, **keywords)
        return wrong(right, given, *places, **keywords)

    broken.__name__ = transform
    monkeypatch.setattr(transforms, transform, broken)
    with pytest.raises(AssertionError, match=rf"{law}.*expected .*, got .* at ") as caught:
        check(source, engine="numpy", points=40)
    expected, got = re.findall(r"(?:expected|got) (\S+?),? ", str(caught.value))[:2]
    assert expected != got


@pytest.mark.parametrize(
    ("check", "source"),
    [(assert_marginals, TRIANGLE), (assert_otf_properties, TRIANGLE)],
)
def test_right_transforms_are_accepted(check, source):
    check(source, engine="numpy")


def test_other_sources_are_refused():
    placed = TRIANGLE.placed(np.eye(4)[[1, 2, 0, 3]])
    for check in (assert_wigner_identities, assert_marginals, assert_otf_properties):
        with pytest.raises(ArgumentError, match="expected an Aperture or Slits"):
            check(placed)
    with pytest.raises(ArgumentError, match="expected an Array, got Aperture"):
        assert_array_identities(TRIANGLE)
    with pytest.raises(GeometryError):
        assert_array_identities(pw.Array([TRIANGLE, placed]))
