"""The laws of phase space for coherent collections: sums over elements, and over pairs of them."""

from __future__ import annotations

import numpy as np

from polywigner import transforms
from polywigner.illumination import Array as Elements
from polywigner.illumination import phased_array
from polywigner.testing.cases import (
    ArrayCase,
    Precision,
    ambiguity_is_hermitian_and_bounded,
    array_case_of,
    content_of,
    corners_of,
    require,
    values_at_zero,
    wigner_is_real_and_bounded,
)
from polywigner.testing.pieces import ambiguity_by_pairs, wigner_by_pairs


def assert_array_identities(
    array: Elements,
    *,
    points: int = 200,
    seed: int = 0,
    precision: Precision = None,
    engine: str = "auto",
    tolerance: float | None = None,
) -> None:
    """Raise an AssertionError unless the transforms of an array obey the laws they must obey.

    F is the weighted sum over elements. W is real and bounded by 2^d int |u|^2, A Hermitian and
    bounded by A(0, 0) = int |u|^2; W(x, 0) and A(0, xi) are the marginals. W and A are quadratic
    forms in the field: of two halves of the array, drawn at random, those of the sum and of the
    difference add up to twice those of the halves; and they are the sums over pairs of elements and
    of their waves, on slices that are cut pair by pair. A common phase of all weights, and moving
    the whole, change nothing but coordinates.

    Parameters
    ----------
    array: of Slits, or of apertures in the plane z = 0, each with a field of its own or none.
    points: number of random places, at which some pair of elements is seen.
    seed: of the random places.
    precision, engine: as for the transforms.
    tolerance: relative to what int |u|^2 would be if all fields were in phase; by default 1e-12 in
        double and 5e-6 in single precision, and more for elements that are slivers, as for
        :func:`assert_wigner_identities`, and for those so far from the origin, in their own sizes
        or in wavelengths, that rounding of their positions is felt.

    Raises
    ------
    AssertionError: names the first law that does not hold, where, and the two values.
    ArgumentError: for anything but an Array; GeometryError for elements that are not in the plane.
    """
    case = array_case_of(array, points, seed, precision, engine, tolerance)
    for check in _CHECKS:
        check(case)


def _fourier_is_the_weighted_sum(case: ArrayCase) -> None:
    terms = [transforms.fourier(element, case.nu, **case.otherwise) for element in case.elements]
    bound = float(
        sum(s * content_of(e) for s, e in zip(case.strengths, case.elements, strict=True))
    )
    allowed = case.tolerance * bound + case.allowed / float(case.strengths.max())
    got = case.evaluate("fourier", case.nu)
    law = "F is the weighted sum over elements"
    require(law, got, case.weights @ np.stack(terms), allowed, {"nu": case.nu})


def _wigner_is_real_and_bounded(case: ArrayCase) -> None:
    wigner_is_real_and_bounded(case, 2**case.dimension * case.allowed)


def _marginals_are_the_values_at_zero(case: ArrayCase) -> None:
    values_at_zero(case, 4 * case.allowed)


def _halves_obey_the_parallelogram_law(case: ArrayCase) -> None:
    """Weights of halves drawn at random are no product and no lattice: another way to sum."""
    if len(case.array) < 2:
        return
    rng = np.random.default_rng(len(case.array))
    first = rng.permutation(len(case.array)) < len(case.array) // 2
    elements, weights = case.elements, case.weights

    def half(chosen: np.ndarray) -> Elements | None:
        kept = [e for e, keep in zip(elements, chosen.tolist(), strict=True) if keep]
        return Elements(kept, weights[chosen]) if weights[chosen].any() else None

    halves = [found for found in (half(first), half(~first)) if found is not None]
    difference = Elements(elements, np.where(first, weights, -weights))
    for name, transform, places in (
        ("W", transforms.wigner, {"x": case.x, "nu": case.nu}),
        ("A", transforms.ambiguity, {"upsilon": case.upsilon, "xi": case.xi}),
    ):
        few = {key: values[: case.few] for key, values in places.items()}
        both = case.evaluate(transform.__name__, *few.values())
        both = both + transform(difference, *few.values(), **case.otherwise)
        parts = sum(2 * transform(part, *few.values(), **case.otherwise) for part in halves)
        law = f"{name} of the sum and that of the difference of halves: twice those of both"
        require(law, both, parts, 16 * case.allowed, few)


def _common_phases_and_shifts_only_change_coordinates(case: ArrayCase) -> None:
    corners = np.concatenate([corners_of(element) for element in case.elements])
    shift = np.array([0.37, -0.19])[: case.dimension] * float(np.ptp(corners, axis=0).max())
    if case.array.repeated is None:
        moved = Elements([e.moved(shift) for e in case.elements], 1j * case.weights)
    else:
        element, positions = case.array.repeated
        moved = phased_array(element, positions + shift, 1j * case.weights)
    got = transforms.wigner(moved, case.x + shift, case.nu, **case.keywords)
    law = "W of the array shifted, all of it in another phase"
    places = {"x": case.x, "nu": case.nu}
    require(law, got, case.evaluate("wigner", case.x, case.nu), 16 * case.allowed, places)
    got = transforms.ambiguity(moved, case.upsilon, case.xi, **case.keywords)
    turned = np.exp(-2j * np.pi * case.upsilon @ shift)
    expected = turned * case.evaluate("ambiguity", case.upsilon, case.xi)
    law = "A of the array shifted, all of it in another phase"
    require(law, got, expected, 4 * case.allowed, {"upsilon": case.upsilon, "xi": case.xi})


def _pairs_of_elements_sum_up(case: ArrayCase) -> None:
    x, nu = case.x[: case.few], case.nu[: case.few]
    got = case.evaluate("wigner", x, nu)
    by_pairs = [wigner_by_pairs(case, *place) for place in zip(x, nu, strict=True)]
    law = "W is the sum over pairs of elements"
    require(law, got, by_pairs, 8 * case.allowed, {"x": x, "nu": nu})
    upsilon, xi = case.upsilon[: case.few], case.xi[: case.few]
    got = case.evaluate("ambiguity", upsilon, xi)
    by_pairs = [ambiguity_by_pairs(case, *place) for place in zip(upsilon, xi, strict=True)]
    law = "A is the sum over pairs of elements"
    require(law, got, by_pairs, 8 * case.allowed, {"upsilon": upsilon, "xi": xi})


_CHECKS = (
    _fourier_is_the_weighted_sum,
    _wigner_is_real_and_bounded,
    ambiguity_is_hermitian_and_bounded,
    _marginals_are_the_values_at_zero,
    _halves_obey_the_parallelogram_law,
    _common_phases_and_shifts_only_change_coordinates,
    _pairs_of_elements_sum_up,
)
