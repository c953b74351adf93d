"""Fields that are a product along the sides of a rectangle, against the sum over pairs of waves."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.pair_sums import (
    ambiguity_of_copies,
    ambiguity_of_waves,
    fourier_of_waves,
    wigner_of_copies,
    wigner_of_waves,
)
from oracles.references import numpy_and_few
from polywigner.kernels import is_separable

# Of int |u|^2 dx; for F of sqrt(area int |u|^2 dx), which bounds it.
TOLERANCE = {"double": 1e-13, "single": 3e-6}
# Central differences over 1e-6 lose ten digits to rounding, and change by 1e-9 with the step.
SLOPE = 1e-7
SIDES = (2.0, 1.25)

precisions = pytest.mark.parametrize("precision", TOLERANCE)


def _turned(points: Any, angle: float) -> Any:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points) @ np.array([[c, s], [-s, c]])


def _source(field: pw.Illumination, angle: float = 0.0, shift: Any = (0.0, 0.0)) -> pw.Aperture:
    """A rectangle with a field, turned and moved together."""
    ring = pw.shapes.rectangle(*SIDES).rings[0]
    turned = pw.Illumination(field.amplitudes, _turned(field.frequencies, angle))
    return pw.Aperture(_turned(ring, angle) + shift).with_illumination(turned.moved(shift))


TAYLOR = pw.taylor_taper(*SIDES, 30, 4)
STEERED = TAYLOR * pw.Illumination([1.0], [[3.5, -40.25]])
# along either axis waves at no multiples of one frequency, with complex amplitudes
ALONG_X = pw.Illumination([1.0, 0.4j, -0.3 + 0.2j], [[0.0, 0.0], [0.71, 0.0], [-0.27, 0.0]])
ALONG_Y = pw.Illumination([0.8, 0.5 - 0.4j], [[0.0, 1.3], [0.0, -0.45]])

SOURCES = {
    "taylor": _source(TAYLOR),
    "steered": _source(STEERED),
    "complex": _source(ALONG_X * ALONG_Y),
    "one axis": _source(ALONG_Y),
    "turned": _source(STEERED, 0.37),
    "moved": _source(STEERED, 0.0, (30.0, -7.0)),
    "turned and moved": _source(ALONG_X * ALONG_Y, -1.1, (3.0, 2.0)),
}
sources = pytest.mark.parametrize("name", SOURCES)


def _points(source: pw.Aperture, count: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, nu, xi: inside and a little outside of where W and A are not 0."""
    rng = np.random.default_rng(5)
    low, high = np.array(source.bounds).reshape(2, 2)
    centre, size = (low + high) / 2, high - low
    x = centre + rng.uniform(-0.55, 0.55, (count, 2)) * size
    field = source.illumination
    assert field is not None
    nu = rng.uniform(-4, 4, (count, 2)) + field.frequencies.mean(axis=0)
    tops = min(20, count // 2)
    nu[:tops] = field.frequencies[rng.integers(0, len(field), tops)]
    return x, nu, rng.uniform(-1.05, 1.05, (count, 2)) * size


def _energy(source: pw.Aperture) -> float:
    return float(pw.lag_marginal(source, (0.0, 0.0)).real)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        itertools.product(SOURCES, TOLERANCE),
        [("one axis", "double"), ("turned and moved", "double"), ("steered", "single")],
    ),
)
def test_products_agree_with_the_sum_over_all_pairs_of_waves(
    name: str, precision: str, engine: str
) -> None:
    source = SOURCES[name]
    assert is_separable(source)
    x, nu, xi = _points(source)
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    upsilon = nu - source.illumination.frequencies.mean(axis=0)  # type: ignore[union-attr]
    found = (
        pw.wigner(source, x, nu, **how),
        pw.ambiguity(source, upsilon, xi, **how),
        pw.fourier(source, nu, **how),
    )
    scale, energy = pw.shapes.rectangle(*SIDES).area, _energy(source)
    expected = (
        wigner_of_waves(source, x, nu),
        ambiguity_of_waves(source, upsilon, xi),
        fourier_of_waves(source, nu),
    )
    sizes = (energy, energy, np.sqrt(scale * energy))
    for got, wanted, size in zip(found, expected, sizes, strict=True):
        assert np.abs(got - wanted).max() < TOLERANCE[precision] * size


@precisions
@sources
@pytest.mark.parametrize("positions_lead", [True, False])
def test_products_of_every_place_with_every_frequency_are_those_of_each_with_each(
    name: str, precision: str, positions_lead: bool
) -> None:
    """Frequencies include those of the waves, where the sum over shifts divides by nothing."""
    source = SOURCES[name]
    x, nu, xi = (p[:n] for p, n in zip(_points(source), (20, 90, 20), strict=True))
    nu = np.concatenate([nu, [[np.nan, 0.0]]])
    for transform, first, second in ((pw.wigner, x, nu), (pw.ambiguity, nu, xi)):
        leads = positions_lead == (transform is pw.wigner)
        pair = (first[:, None], second) if leads else (first, second[:, None])
        found = transform(source, *pair, engine="numpy", precision=precision)
        flat = [np.broadcast_to(p, (*found.shape, 2)).reshape(-1, 2) for p in pair]
        each = transform(source, *flat, engine="numpy", precision=precision).reshape(found.shape)
        limit = TOLERANCE[precision] * _energy(source)
        np.testing.assert_allclose(found, each, rtol=0, atol=limit)


@sources
def test_marginals_of_products_are_the_field_squared_and_its_correlation(name: str) -> None:
    source = SOURCES[name]
    x, _, xi = _points(source)
    field = source.illumination
    assert field is not None
    zero = np.zeros(2)
    peak = np.abs(field(x)).max() ** 2
    inside = np.abs(pw.autocorrelation(source, x, zero) - np.abs(field(x)) ** 2) < 1e-12 * peak
    outside = pw.autocorrelation(source, x, zero) == 0
    assert (inside | outside).all() and inside.any() and outside.any()
    energy = _energy(source)
    tolerance = TOLERANCE["double"] * energy
    assert np.abs(pw.position_marginal(source, x) - pw.wigner(source, x, zero)).max() < tolerance
    assert np.abs(pw.lag_marginal(source, xi) - pw.ambiguity(source, zero, xi)).max() < tolerance


@pytest.mark.parametrize("name", ["taylor", "turned and moved"])
def test_wigner_of_a_product_is_the_transform_of_its_lag_slice(name: str) -> None:
    source = SOURCES[name]
    field = source.illumination
    assert field is not None
    angle = -1.1 if name != "taylor" else 0.0
    centre = np.array(source.centre)
    half = np.array(SIDES) / 2
    nodes, weights = np.polynomial.legendre.leggauss(80)
    _, nu, _ = _points(source, 12)
    for own, at in zip(
        np.random.default_rng(3).uniform(-0.9, 0.9, (12, 2)) * half, nu, strict=True
    ):
        reach = 2 * (half - np.abs(own))
        lags = np.stack(np.meshgrid(nodes * reach[0], nodes * reach[1], indexing="ij"), axis=-1)
        share = np.multiply.outer(weights * reach[0], weights * reach[1])
        x, xi = centre + _turned(own, angle), _turned(lags, angle)
        mutual = field(x + xi / 2) * field(x - xi / 2).conj()
        expected = (share * mutual * np.exp(-2j * np.pi * (xi @ at))).sum().real
        assert abs(pw.wigner(source, x, at) - expected) < TOLERANCE["double"] * _energy(source)


@pytest.mark.parametrize("angle", [0.0, 0.37])
def test_rectangles_with_vertices_along_their_sides_are_rectangles(angle: float) -> None:
    a, b = SIDES[0] / 2, SIDES[1] / 2
    ring = [[-a, -b], [0.25, -b], [a, -b], [a, b], [-a, b], [-a, 0.125]]
    turned = pw.Illumination(TAYLOR.amplitudes, _turned(TAYLOR.frequencies, angle))
    assert is_separable(pw.Aperture(_turned(ring, angle)).with_illumination(turned))


def test_what_is_no_product_or_no_rectangle_is_summed_over_pairs() -> None:
    rectangle = pw.shapes.rectangle(*SIDES)
    a, b = SIDES[0] / 2, SIDES[1] / 2
    leaning = pw.Aperture([[-a, -b], [a, -b], [a + 1e-9, b], [-a + 1e-9, b]])
    holed = pw.Aperture(rectangle.polygons.difference(pw.shapes.square(0.5).polygons))
    others = (
        rectangle,
        rectangle.with_illumination(pw.Illumination([1.0], [[1.0, 0.0]])),
        rectangle.with_illumination(ALONG_X + ALONG_Y),
        rectangle.with_illumination(
            pw.Illumination(TAYLOR.amplitudes, _turned(TAYLOR.frequencies, 0.37))
        ),
        leaning.with_illumination(TAYLOR),
        holed.with_illumination(TAYLOR),
        pw.shapes.triangle(1.0, 1.0).with_illumination(TAYLOR),
    )
    for source in others:
        assert not is_separable(source)


# --- rectangles that are known to the rounding of their coordinates only

# The roundings of coordinates 10,000 shorter sides from the origin move W by 3e-13 of the energy at
# most, which is below what is stated of W anywhere.
STATED = 1e-12
# Farther away W moves by less than the vertices do, per shorter side.
VERTICES = 8 * np.finfo(float).eps / 2
ANGLES = np.random.default_rng(7).uniform(-np.pi, np.pi, 24)


def _far(aspect: float, angle: float, distance: float, waves: pw.Illumination) -> pw.Aperture:
    """A rectangle of width 1 with a steered field, turned, and moved by a distance."""
    field = waves * pw.Illumination([1.0], [[3.3 / aspect, -7.1]])
    ring = _turned(pw.shapes.rectangle(aspect, 1.0).rings[0], angle)
    shift = distance * _turned((0.8, 0.6), -2 * angle)
    turned = pw.Illumination(field.amplitudes, _turned(field.frequencies, angle))
    return pw.Aperture(ring + shift).with_illumination(turned.moved(shift))


@pytest.mark.slow
@pytest.mark.parametrize("distance", [0.0, 50.0, 1e4])
@pytest.mark.parametrize("aspect", [1.0, 10.0, 1000.0])
def test_tapers_on_rectangles_are_products_at_any_angle_and_place(
    aspect: float, distance: float
) -> None:
    field = pw.taylor_taper(aspect, 1.0)
    for angle in ANGLES:
        assert is_separable(_far(aspect, angle, distance, field))
        assert is_separable(_far(aspect, angle, distance * aspect, field))


@pytest.mark.parametrize(
    ("aspect", "distance"), [(1.0, 1e4), (10.0, 1e4), (1000.0, 0.0), (1000.0, 1e4), (100.0, 1e6)]
)
def test_products_on_turned_rectangles_are_those_of_the_vertices_as_given(
    aspect: float, distance: float
) -> None:
    rng = np.random.default_rng(9)
    steering = np.array([3.3, -7.1])
    cases: list[tuple[pw.Aperture, Any]] = []
    for angle in ANGLES[:4]:
        source = _far(aspect, angle, distance, pw.cosine_taper(aspect, 1.0, 2))
        x, xi = rng.uniform(-0.5, 0.5, (2, 30, 2)) * [aspect, 1.0]
        nu = (rng.uniform(-2, 2, (30, 2)) + steering) / [aspect, 1.0]
        inside = _turned(x, angle) + source.centre
        cases.append((source, (inside, _turned(nu, angle), _turned(2 * xi, angle))))

    tolerance = max(STATED, VERTICES * distance)
    for source, (x, nu, xi) in cases:
        assert is_separable(source)
        upsilon = nu - source.illumination.frequencies.mean(axis=0)  # type: ignore[union-attr]
        energy = _energy(source)
        how: dict[str, Any] = {"engine": "numpy"}
        for found, expected, size in (
            (pw.wigner(source, x, nu, **how), wigner_of_waves(source, x, nu), energy),
            (
                pw.ambiguity(source, upsilon, xi, **how),
                ambiguity_of_waves(source, upsilon, xi),
                energy,
            ),
            (
                pw.fourier(source, nu, **how),
                fourier_of_waves(source, nu),
                np.sqrt(source.area * energy),
            ),
        ):
            assert np.abs(found - expected).max() < tolerance * size


def test_phases_rounded_at_the_origin_leave_a_product_a_product() -> None:
    field, shift = TAYLOR * pw.Illumination([1.0], [[3.3, -7.1]]), np.array([7313.1, -2111.7])
    phases = np.exp(-2j * np.pi * (field.frequencies @ shift))
    moved = pw.Illumination(field.amplitudes * phases, field.frequencies)
    ring = pw.shapes.rectangle(*SIDES).rings[0]
    assert is_separable(pw.Aperture(ring + shift).with_illumination(moved))
    assert not is_separable(
        pw.Aperture(ring + shift).with_illumination(
            pw.Illumination(moved.amplitudes * (1 + 1e-9 * np.arange(49) ** 2), field.frequencies)
        )
    )


@pytest.mark.parametrize("distance", [0.0, 1e4])
def test_outlines_that_lean_by_more_than_rounding_are_no_rectangles(distance: float) -> None:
    ring = _turned(pw.shapes.rectangle(*SIDES).rings[0], 0.4)
    lean = 60 * np.spacing(max(distance, 1.0))
    leaning = ring + distance + lean * np.array([[0, 0], [0, 0], [1, 0], [0, 0]])
    assert not is_separable(
        pw.Aperture(leaning).with_illumination(
            pw.Illumination(TAYLOR.amplitudes, _turned(TAYLOR.frequencies, 0.4))
        )
    )


ELEMENT = SOURCES["complex"]
POSITIONS = {
    "lattice": pw.arrays.grid_positions(3, 2, 2.5, 1.5),
    "touching": pw.arrays.grid_positions(2, 2, *SIDES),
    "scattered": np.random.default_rng(2).uniform(-6, 6, (7, 2)),
}


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        itertools.product(POSITIONS, TOLERANCE),
        [("lattice", "single"), ("touching", "double"), ("scattered", "double")],
    ),
)
def test_arrays_of_products_agree_with_the_sum_over_all_pairs_of_waves(
    name: str, precision: str, engine: str
) -> None:
    places = POSITIONS[name]
    weights = np.exp(1j * np.arange(len(places)) ** 2)
    array = pw.phased_array(ELEMENT, places, weights)
    rng = np.random.default_rng(4)
    reach = np.ptp(places, axis=0) / 2 + SIDES
    x, xi = rng.uniform(-1, 1, (200, 2)) * reach, rng.uniform(-2, 2, (200, 2)) * reach
    nu = rng.uniform(-2, 2, (200, 2))
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    energy = _energy(ELEMENT) * len(places) ** 2
    peak = np.abs(ELEMENT.illumination.amplitudes).sum() ** 2  # type: ignore[union-attr]
    for found, expected, size in (
        (pw.wigner(array, x, nu, **how), wigner_of_copies(array, x, nu, wigner_of_waves), energy),
        (
            pw.ambiguity(array, nu, xi, **how),
            ambiguity_of_copies(array, nu, xi, ambiguity_of_waves),
            energy,
        ),
        (
            pw.autocorrelation(array, x, xi / 4, **how),
            _field_of(array, x + xi / 8) * _field_of(array, x - xi / 8).conj(),
            peak,
        ),
    ):
        assert np.abs(found - expected).max() < TOLERANCE[precision] * size


def _field_of(array: pw.Array, x: np.ndarray) -> np.ndarray:
    """(n,) u(x) of copies of the element, which is an upright rectangle."""
    total = np.zeros(len(x), complex)
    for place, weight in zip(array.repeated[1], array.weights, strict=True):
        own = x - place
        inside = (np.abs(own) < np.array(SIDES) / 2).all(axis=-1)
        total += weight * inside * ELEMENT.illumination(own)  # type: ignore[misc]
    return total


@pytest.mark.slow
@pytest.mark.drjit
def test_derivatives_of_products_are_those_of_differences(llvm: Any) -> None:
    import drjit as dr
    from drjit.llvm.ad import Array2f64

    source, step = SOURCES["turned"], 1e-6
    x, nu, _ = _points(source, 60)
    where = Array2f64(*np.ascontiguousarray(x.T)), Array2f64(*np.ascontiguousarray(nu.T))
    dr.enable_grad(where)
    dr.backward(dr.sum(pw.wigner(source, *where)))
    scale = _energy(source)
    for k in range(2):
        shift = np.eye(2)[k] * step
        slope = (pw.wigner(source, x + shift, nu) - pw.wigner(source, x - shift, nu)) / (2 * step)
        assert np.abs(where[0].grad[k].numpy() - slope).max() < SLOPE * scale
        slope = (pw.wigner(source, x, nu + shift) - pw.wigner(source, x, nu - shift)) / (2 * step)
        assert np.abs(where[1].grad[k].numpy() - slope).max() < SLOPE * scale
