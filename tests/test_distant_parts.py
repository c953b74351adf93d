"""W and A of sources whose parts are small and far from each other, against exact arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

import polywigner as pw
from oracles import distant_parts, exact
from polywigner.toolchain.llvm import prepare

# What docs/accuracy.md promises, of the source's area: a hundred times what was found, or more, in
# double precision, and four times in single.
TOLERANCE = {"double": 1e-12, "single": 5e-6}

CENTRES = np.array([(0.27, -0.46), (-0.92, -0.97), (0.63, 0.83)])
TURNS = (0.3, 1.1, 2.0)
BETWEEN = np.array([-0.325, -0.715])  # the midpoint of the first two
SLOW = np.array([6e-7, 8e-7])
ENGINES = ["numpy", pytest.param("llvm", marks=pytest.mark.llvm)]


def squares(radius: float) -> list[np.ndarray]:
    quarter = np.arange(4) * np.pi / 2
    return [
        centre + radius * np.column_stack([np.cos(turn + quarter), np.sin(turn + quarter)])
        for centre, turn in zip(CENTRES, TURNS, strict=True)
    ]


def sources(rings: list[np.ndarray]) -> list[pw.Aperture | pw.Array]:
    return [pw.Aperture(rings), pw.Array([pw.Aperture(ring) for ring in rings])]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("radius", [1e-2, 1e-4, 2e-6])
def test_the_distance_of_small_squares_costs_no_digits(
    radius: float, precision: str, engine: str
) -> None:
    rings = squares(radius)
    area, how = exact.area(rings), {"precision": precision, "engine": engine}
    wanted = exact.wigner(rings[:2], BETWEEN, SLOW)  # the third is nowhere near
    lag = CENTRES[0] - CENTRES[2] + 0.3 * radius
    mutual = complex(exact.transform(exact.position_region(rings[:1], lag, rings[2:]), SLOW))
    for source in sources(rings):
        error = abs(pw.wigner(source, BETWEEN, SLOW, **how) - wanted)
        assert error <= TOLERANCE[precision] * area
        error = abs(pw.ambiguity(source, SLOW, lag, **how) - mutual)
        assert error <= TOLERANCE[precision] * area


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("layout", ["points", "outer"])
def test_random_small_parts_agree_with_rational_clipping(layout: str, precision: str) -> None:
    for seed in range(4):
        for case in distant_parts.drawn(seed, most_parts=12):
            found = case.values(layout, engine="numpy", precision=precision)
            errors = distant_parts.errors(case, found, reference(seed)[case.transform])
            assert errors.max() <= TOLERANCE[precision], (seed, case.transform)


@pytest.mark.llvm
@pytest.mark.parametrize("precision", ["double", "single"])
def test_compiled_kernels_agree_with_rational_clipping(precision: str) -> None:
    for seed in (3, 5):  # an array of weights, waves on an aperture
        for case in distant_parts.drawn(seed, most_parts=12):
            found = case.values("points", engine="llvm", precision=precision)
            errors = distant_parts.errors(case, found, reference(seed)[case.transform])
            assert errors.max() <= TOLERANCE[precision], (seed, case.transform)


def test_parts_ten_of_their_sizes_apart_have_coordinates_of_their_own() -> None:
    """The worst source of a search in one frame for all: 1.2e-12 of the energy."""
    for case in distant_parts.drawn(633):
        found = case.values("points", engine="numpy")
        wanted = distant_parts.reference(case)
        assert distant_parts.errors(case, found, wanted).max() <= TOLERANCE["double"] / 10


_known: dict[int, dict[str, np.ndarray]] = {}


def reference(seed: int) -> dict[str, np.ndarray]:
    if seed not in _known:
        cases = distant_parts.drawn(seed, most_parts=12)
        _known[seed] = {case.transform: distant_parts.reference(case) for case in cases}
    return _known[seed]


def test_marginals_are_the_transforms_at_frequency_zero() -> None:
    rings = squares(1e-3)
    for source in sources(rings):
        area = exact.area(rings)
        for x in (BETWEEN, CENTRES[0] + 3e-4, CENTRES[1]):
            region = exact.lag_region(rings, x).area
            assert abs(pw.position_marginal(source, x) - float(region)) <= 1e-12 * area
        for xi in ([2e-4, -1e-4], CENTRES[1] - CENTRES[2]):
            region = exact.position_region(rings, xi).area
            assert abs(pw.lag_marginal(source, xi) - float(region)) <= 1e-12 * area
    assert np.isrealobj(pw.lag_marginal(pw.Aperture(rings), [0.0, 0.0]))


def test_nothing_is_found_where_no_pair_is_and_what_is_no_number_stays_none() -> None:
    source = pw.Aperture(squares(1e-3))
    values = pw.wigner(source, [[0.0, 0.0], [np.nan, 0.0], [0.0, np.inf], [1e300, 0.0]], SLOW)
    assert values[0] == 0.0 and values[3] == 0.0
    assert np.isnan(values[1:3]).all()


@pytest.mark.llvm
def test_derivatives_in_the_frequency_are_those_of_differences() -> None:
    prepare()
    import drjit as dr
    from drjit.llvm.ad import Array2f64, Float64

    source, nu = pw.Aperture(squares(1e-2)), np.array([20.0, 30.0])
    arrays = Array2f64(Float64(nu[0]), Float64(nu[1]))
    dr.enable_grad(arrays)
    place = Array2f64(*(Float64(c) for c in BETWEEN))
    dr.backward(pw.wigner(source, place, arrays))
    step = 1e-4  # of a turn between the parts
    for k in range(2):
        ahead, behind = nu + step * np.eye(2)[k], nu - step * np.eye(2)[k]
        slope = (pw.wigner(source, BETWEEN, ahead) - pw.wigner(source, BETWEEN, behind)) / 2 / step
        assert abs(float(dr.grad(arrays)[k][0]) - slope) <= 1e-5 * abs(slope)
