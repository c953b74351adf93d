"""The public assertions accept what is right and notice what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

import polywigner as pw
from oracles.drawn import polygons as drawn_polygons
from oracles.references import ENGINES, aperture, awkward, numpy_and_few
from oracles.shapes import Polygons
from oracles.sources import SOURCES, content, points_of
from polywigner import transforms
from polywigner.errors import ArgumentError
from polywigner.testing import (
    assert_fourier_stable,
    assert_marginals,
    assert_otf_properties,
    assert_wigner_identities,
)

engines = pytest.mark.parametrize("engine", ENGINES)

PAIR = pw.Slits([[-1.0, -0.4], [0.1, 0.9]])
TRIANGLE = pw.Aperture([[0, 0], [1.3, 0.2], [0.4, 1.1]])
FAR = pw.Aperture([[1000.0, 700.0], [1001.3, 700.2], [1000.4, 701.1]])
ONE_OF_EACH = [next(iter(sources.values())) for sources in SOURCES.values()]

Wrong = Callable[..., Any]


@pytest.mark.parametrize(
    ("name", "engine"),
    numpy_and_few(
        ["chevron", "square annulus", "double slit", "bow tie, split", "needle 1e-3, rotated"],
        ["chevron", "needle 1e-3, rotated"],
    ),
)
def test_apertures_obey_all_identities(name: str, engine: str) -> None:
    assert_wigner_identities(awkward(name).aperture, engine=engine)


@engines
def test_slits_obey_all_identities(engine: str) -> None:
    assert_wigner_identities(PAIR, engine=engine)
    assert_wigner_identities(pw.Slits([999.7, 1000.1]), engine=engine)


def test_identities_hold_in_single_precision() -> None:
    assert_wigner_identities(awkward("chevron").aperture, engine="numpy", precision="single")
    assert_wigner_identities(PAIR, engine="numpy", precision="single")


@pytest.mark.slow
@given(polygons=drawn_polygons())
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_aperture_obeys_all_identities(polygons: Polygons) -> None:
    assert_wigner_identities(aperture(polygons), points=40, engine="numpy")


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_fourier_transforms_of_all_kinds_are_stable(precision: Any) -> None:
    for source in ONE_OF_EACH:
        assert_fourier_stable(source, points=57, precision=precision, engine="numpy")


@pytest.mark.llvm
def test_fourier_transforms_are_stable_when_compiled() -> None:
    for source in (FAR, PAIR, SOURCES["placed"]["chevron"], SOURCES["convex body"]["cube"]):
        assert_fourier_stable(source, points=57, engine="llvm")


@pytest.mark.parametrize("source", [PAIR, TRIANGLE, FAR], ids=["slits", "triangle", "far"])
def test_pupils_have_the_properties_of_pupils(source: Any) -> None:
    assert_otf_properties(source, engine="numpy")


WAVELENGTH = 3.2e-3
BEAM = (0.48, 0.2, np.sqrt(1 - 0.48**2 - 0.2**2))
CHEVRON = pw.shapes.chevron(10e-3, 10e-3, 4e-3)
ILLUMINATED = {
    "TE10": pw.shapes.rectangle(10e-3, 8e-3).with_illumination(pw.te_mode(10e-3, 8e-3)),
    "steered": CHEVRON.with_illumination(pw.steering(BEAM, WAVELENGTH)),
    "steered by 400 cycles, far away": CHEVRON.moved((3.0, -2.0)).with_illumination(
        pw.steering(BEAM, WAVELENGTH / 250)
    ),
    "tapered and steered": pw.shapes.rectangle(10e-3, 4e-3).with_illumination(
        pw.taylor_taper(10e-3, nbar=3) * pw.steering(BEAM, WAVELENGTH)
    ),
    "three waves on a chevron": pw.shapes.chevron(1.0, 0.8, 0.4).with_illumination(
        pw.Illumination([1, 0.5j, -0.3 + 0.2j], [(0, 0), (1.3, 0.4), (-1, 1)])
    ),
    "three waves on slits": PAIR.with_illumination(
        pw.Illumination([1, 0.5j, 0.2], [0.3, 2.0, -1.2])
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ILLUMINATED)
def test_sources_with_waves_on_them_obey_all_identities(name: str) -> None:
    source = ILLUMINATED[name]
    assert_wigner_identities(source, engine="numpy", points=100)
    assert_otf_properties(source, engine="numpy", points=100)
    assert_fourier_stable(source, engine="numpy", points=57)


def test_sources_with_waves_on_them_obey_all_identities_in_single_precision() -> None:
    for name in ("TE10", "steered by 400 cycles, far away"):
        assert_wigner_identities(ILLUMINATED[name], engine="numpy", precision="single")
    placed = ILLUMINATED["steered"].placed(np.eye(4)[[1, 2, 0, 3]])
    assert_fourier_stable(placed, engine="numpy", points=57, precision="single")


def _times(factor: complex) -> Wrong:
    return lambda right, *a, **k: right(*a, **k) * factor


def _plus(offset: float) -> Wrong:
    return lambda right, *a, **k: right(*a, **k) + offset


def _conjugate(right: Any, *a: Any, **k: Any) -> Any:
    return np.conj(right(*a, **k))


def _broken(monkeypatch: pytest.MonkeyPatch, transform: str, wrong: Wrong) -> None:
    right = getattr(transforms, transform)

    def broken(*args: Any, **keywords: Any) -> Any:
        return wrong(right, *args, **keywords)

    broken.__name__ = transform
    monkeypatch.setattr(transforms, transform, broken)


@pytest.mark.parametrize("source", [TRIANGLE, PAIR], ids=["triangle", "slits"])
@pytest.mark.parametrize(
    ("transform", "wrong"),
    [
        ("wigner", _times(1.0001)),
        ("wigner", _plus(1e-6)),
        ("ambiguity", _conjugate),
        ("position_marginal", _times(0.25)),
        ("lag_marginal", _plus(1e-9)),
        ("fourier", _conjugate),
    ],
)
def test_a_wrong_transform_breaks_an_identity(
    source: Any, transform: str, wrong: Wrong, monkeypatch: pytest.MonkeyPatch
) -> None:
    _broken(monkeypatch, transform, wrong)
    with pytest.raises(AssertionError, match=r"expected .*, got .* at "):
        assert_wigner_identities(source, engine="numpy")


def _shifted_in_phase(right: Any, source: Any, upsilon: Any, xi: Any, **keywords: Any) -> Any:
    """The ambiguity function about one copy instead of the middle of both: the paper's slip."""
    wave = np.exp(1j * np.pi * (np.asarray(upsilon) * xi).sum(axis=-1))
    return right(source, upsilon, xi, **keywords) * wave


def _at_another_nu(right: Any, source: Any, x: Any, nu: Any, **keywords: Any) -> Any:
    return right(source, x, np.asarray(nu) * 1.01, **keywords)


def _of_conjugate_field(right: Any, source: Any, *points: Any, **keywords: Any) -> Any:
    """The second field where the first belongs."""
    field = source.illumination
    if field is not None:
        conjugate = pw.Illumination(field.amplitudes.conj(), -field.frequencies)
        source = source.with_illumination(conjugate)
    return right(source, *points, **keywords)


def _first_wave_alone(right: Any, source: Any, *points: Any, **keywords: Any) -> Any:
    field = source.illumination
    if field is not None:
        first = pw.Illumination(field.amplitudes[:1], field.frequencies[:1])
        source = source.with_illumination(first)
    return right(source, *points, **keywords)


@pytest.mark.parametrize("transform", ["wigner", "ambiguity", "fourier"])
@pytest.mark.parametrize("wrong", [_of_conjugate_field, _first_wave_alone, _times(1.0001)])
def test_waves_taken_wrongly_break_an_identity(
    transform: str, wrong: Wrong, monkeypatch: pytest.MonkeyPatch
) -> None:
    _broken(monkeypatch, transform, wrong)
    for name in ("three waves on a chevron", "three waves on slits"):
        with pytest.raises(AssertionError, match=r"expected .*, got .* at "):
            assert_wigner_identities(ILLUMINATED[name], engine="numpy", points=20)
    if transform == "fourier":
        with pytest.raises(AssertionError, match=r"expected .*, got .* at "):
            assert_fourier_stable(ILLUMINATED["three waves on slits"], engine="numpy", points=20)


@pytest.mark.parametrize(
    ("transform", "wrong", "law"),
    [
        ("ambiguity", _shifted_in_phase, r"int A exp"),
        ("wigner", _at_another_nu, r"int W "),
        ("fourier", _times(1.001), r"F\(upsilon\)|int "),
        ("position_marginal", _times(1.001), r"R_x"),
        ("lag_marginal", _times(1.001), r"R_xi"),
    ],
)
def test_a_wrong_transform_has_wrong_marginals(
    transform: str, wrong: Wrong, law: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert_marginals(TRIANGLE, engine="numpy")
    _broken(monkeypatch, transform, wrong)
    with pytest.raises(AssertionError, match=law):
        assert_marginals(TRIANGLE, engine="numpy")


def _centre(source: Any) -> np.ndarray:
    points = points_of(source)
    return (points.min(axis=0) + points.max(axis=0)) / 2


def _no_linear_term(right: Any, source: Any, nu: Any, **keywords: Any) -> Any:
    """F of a small nu is the content: the linear term of an off-centre source is lost."""
    small = np.linalg.norm(nu, axis=-1) < 1e-9
    return np.where(small, content(source), right(source, nu, **keywords))


def _rounded_phase(right: Any, source: Any, nu: Any, **keywords: Any) -> Any:
    """The phase of the centre to the nearest float instead of modulo one turn."""
    turns = nu @ _centre(source)
    error = np.spacing(np.abs(turns)) / 2
    return right(source, nu, **keywords) * np.exp(2j * np.pi * error)


def _not_a_number_along_an_edge(right: Any, source: Any, nu: Any, **keywords: Any) -> Any:
    """0/0 where nu is normal to an edge."""
    points = points_of(source)
    along = np.abs(nu @ (points - np.roll(points, 1, axis=0)).T).min(axis=-1)
    value = right(source, nu, **keywords)
    return np.where((along == 0) & nu.any(axis=-1), np.nan, value)


def _threshold(right: Any, source: Any, nu: Any, **keywords: Any) -> Any:
    """A step of 1e-12 where one formula takes over from another."""
    size = np.linalg.norm(nu, axis=-1)
    return right(source, nu, **keywords) * (1 + 1e-12 * (size > 0.1))


def _mirrored(right: Any, source: Any, nu: Any, **keywords: Any) -> Any:
    return right(source, -np.asarray(nu), **keywords)


SQUARE = pw.shapes.square(1.0)
CUBE = SOURCES["convex body"]["tetrahedron"]


@pytest.mark.parametrize(
    ("source", "wrong"),
    [
        (FAR, _no_linear_term),
        (FAR, _rounded_phase),
        (SQUARE, _not_a_number_along_an_edge),
        (TRIANGLE, _threshold),
        (CUBE, _threshold),
        (PAIR, _threshold),
        (TRIANGLE, _mirrored),
        (CUBE, _mirrored),
        (CUBE, _times(1 + 1e-12)),
        (PAIR, _times(1j)),
    ],
)
def test_an_unstable_fourier_transform_is_noticed(
    source: Any, wrong: Wrong, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert_fourier_stable(source, engine="numpy")
    _broken(monkeypatch, "fourier", wrong)
    with pytest.raises(AssertionError, match=r"expected .*, got .* at "):
        assert_fourier_stable(source, engine="numpy")


def _same_for_both_signs(right: Any, source: Any, xi: Any, w: float = 0.0, **k: Any) -> Any:
    return right(source, xi, abs(w), **k)


def _wider(right: Any, source: Any, xi: Any, w: float = 0.0, **k: Any) -> Any:
    return right(source, np.asarray(xi) / 1.1, w, **k)


def _brighter_out_of_focus(right: Any, source: Any, xi: Any, w: float = 0.0, **k: Any) -> Any:
    return right(source, xi, w / 4, **k) * (1 + w * w)


@pytest.mark.parametrize(
    ("wrong", "law"),
    [
        (_times(2.0), "1 at xi = 0"),
        (_same_for_both_signs, "opposite defocus"),
        (_wider, "no larger than in focus|mutual content|cut-off"),
        (_brighter_out_of_focus, "no larger than in focus|1 at xi = 0"),
    ],
)
def test_an_otf_with_wrong_properties_is_noticed(
    wrong: Wrong, law: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _broken(monkeypatch, "otf", wrong)
    with pytest.raises(AssertionError, match=law):
        assert_otf_properties(TRIANGLE, engine="numpy")


def test_sources_without_a_phase_space_are_refused() -> None:
    placed = TRIANGLE.placed(np.eye(4))
    for check in (assert_wigner_identities, assert_marginals, assert_otf_properties):
        with pytest.raises(ArgumentError, match="expected an Aperture or Slits"):
            check(placed)
    with pytest.raises(ArgumentError, match="expected Slits"):
        assert_fourier_stable("square")  # type: ignore[arg-type]
