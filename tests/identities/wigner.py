"""Laws of phase space and of imaging: W, A, F, the marginals and the OTF of fields and arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import shapely

from identities.cases import (
    Case,
    ambiguity_by_pairs,
    array_case_of,
    box_of,
    case_of,
    content_of,
    corners_of,
    moved,
    require,
    split_in_three,
    wigner_by_pairs,
)
from polywigner import transforms
from polywigner.execution import Precision
from polywigner.geometry import Aperture, Slits
from polywigner.illumination import Array as Elements
from polywigner.illumination import phased_array

# Rank-1 lattice sums of continuous functions with kinks, at 10^4 points, relative to content^2:
# at most 1e-4 on triangles, stars, rings and combs.
_LATTICE_POINTS = 10946
_LATTICE_STEP = 6765  # consecutive Fibonacci numbers: the best two-dimensional rank-1 lattice
_LATTICE_TOLERANCE = 5e-4
_SLICES = 12  # slices and pieces, each a source of its own
# exp(-pi GAUSSIANS^2) is 1e-15: a Gaussian window of the frequencies loses no more than that
_GAUSSIANS = 3.3
_MOST_FREQUENCIES = 400_000
# Across the source: a lattice of 10^4 points takes a hundred steps along each axis.
_MOST_CYCLES = 4.0
# Least share of its box that a source fills: a lattice of 10^4 points sees one of less too seldom.
_LEAST_FILLING = 0.02


def assert_wigner_identities(
    source: Aperture | Slits,
    *,
    points: int = 200,
    seed: int = 0,
    precision: Precision = None,
    engine: str = "auto",
    tolerance: float | None = None,
) -> None:
    """Raise an AssertionError unless the transforms of a source obey the laws they must obey.

    In d dimensions: W is real, bounded by 2^d int |u|^2, and that of the conjugate field at -nu; A
    is Hermitian and bounded by A(0, 0) = int |u|^2; W(x, 0), A(0, xi) and A(upsilon, 0) are the
    marginals and the transform of |u|^2; W integrates over x to |F|^2 and over nu to |u|^2; W and A
    are a Fourier pair, through the correlation of spectra that both integrate to; the marginals
    integrate to |F(0)|^2; sums over pairs of waves on slices found another way are the same; and
    moving, turning, scaling or cutting the source changes nothing but coordinates.

    Parameters
    ----------
    source: Aperture or Slits, uniform or with an illumination.
    points: number of random places for each identity.
    seed: of the random places.
    precision, engine: as for the transforms.
    tolerance: relative to the content (times (sum |c_m|)^2, or sum |c_m| for F, of an illumination
        with amplitudes c_m); by default 1e-12 in double and 5e-6 in single precision, and
        more for slivers, in proportion to perimeter * diameter / area. Integrals over x and xi are
        lattice sums and are held to 5e-4 content^2; they are left out for sources that fill less
        than 1/50 of their (turned) box and for waves that differ by more than 4 cycles across it,
        and that over nu where it would take too fine a grid.

    Raises
    ------
    AssertionError: names the first identity that does not hold, where, and the two values.
    ArgumentError: for sources that have no Wigner function.
    """
    case = case_of(source, points, seed, precision, engine, tolerance)
    for check in (*_POINTWISE, *_MARGINALS, *_COVARIANCE):
        check(case)


def assert_marginals(
    source: Aperture | Slits,
    *,
    points: int = 200,
    seed: int = 0,
    precision: Precision = None,
    engine: str = "auto",
    tolerance: float | None = None,
) -> None:
    """Raise an AssertionError unless W and A have the marginals that they must have.

    The part of :func:`assert_wigner_identities` about integrals: W(x, 0) = R_x, A(0, xi) = R_xi,
    A(upsilon, 0) = F, int W dx = |F|^2, int W dnu = |u|^2, int R_x dx = int R_xi dxi = content^2,
    and int W exp(-2 pi i upsilon.x) dx = F(nu + upsilon/2) F*(nu - upsilon/2)
    = int A exp(-2 pi i xi.nu) dxi. Parameters and errors as there.
    """
    case = case_of(source, points, seed, precision, engine, tolerance)
    for check in _MARGINALS:
        check(case)


def _wigner_is_real_and_bounded(case: Case) -> Any:
    """Check W, and return it at the case's places."""
    value = case.evaluate("wigner", case.x, case.nu)
    if np.iscomplexobj(value):
        raise AssertionError(f"W is real: expected a real array, got {value.dtype}")
    bound = 2**case.dimension * case.energy
    allowed = case.allowed * (2**case.dimension if case.is_array else 1)
    law = f"|W| <= {2**case.dimension} times int |u|^2"
    here = {"x": case.x, "nu": case.nu}
    require(law, value, np.clip(value, -bound, bound), allowed, here)
    return value


def _ambiguity_is_hermitian_and_bounded(case: Case) -> None:
    here = {"upsilon": case.upsilon, "xi": case.xi}
    value = case.evaluate("ambiguity", case.upsilon, case.xi)
    mirrored = case.evaluate("ambiguity", -case.upsilon, -case.xi)
    require("A(-upsilon, -xi) = conj A(upsilon, xi)", mirrored, value.conj(), case.allowed, here)
    size = np.abs(value)
    require("|A| <= A(0, 0)", size, np.minimum(size, case.energy), case.allowed, here)


def _values_at_zero_are_marginals(case: Case) -> None:
    zero = np.zeros(case.dimension)
    by_position = case.evaluate("position_marginal", case.x)
    at_zero = case.evaluate("wigner", case.x, zero)
    allowed = case.allowed * (4 if case.is_array else 1)
    require("W(x, 0) = R_x(x)", at_zero, by_position, allowed, {"x": case.x})
    by_lag = case.evaluate("lag_marginal", case.xi)
    at_zero = case.evaluate("ambiguity", zero, case.xi)
    require("A(0, xi) = R_xi(xi)", at_zero, by_lag, case.allowed, {"xi": case.xi})


def _wigner_is_mirrored(case: Case) -> None:
    here = {"x": case.x, "nu": case.nu}
    value = _wigner_is_real_and_bounded(case)
    conjugate = case.source
    law = "W(x, -nu) = W(x, nu) for a real field"
    if not case.waves.uniform:
        conjugate = case.outline.with_illumination(case.waves.conjugate())
        law = "W(x, -nu) of the conjugate field = W(x, nu)"
    mirrored = transforms.wigner(conjugate, case.x, -case.nu, **case.keywords)
    require(law, mirrored, value, case.allowed, here)


def _ambiguity_at_zero_is_the_energy(case: Case) -> None:
    zero = np.zeros((1, case.dimension))
    at_zero = case.evaluate("ambiguity", zero, zero)
    places = {"upsilon": zero, "xi": zero}
    require("A(0, 0) = int |u|^2", at_zero, case.energy, case.allowed, places)


def _fourier_is_the_sum_over_waves(case: Case) -> None:
    if case.waves.uniform:
        return
    offsets = case.nu[:, None] - case.waves.frequencies
    by_wave = transforms.fourier(case.outline, offsets, **case.keywords) @ case.waves.amplitudes
    allowed = (case.allowed + case.turned) / case.waves.strength
    law = "F is the sum over waves of that of the outline"
    require(law, case.evaluate("fourier", case.nu), by_wave, allowed, {"nu": case.nu})


def _ambiguity_without_lag_is_the_spectrum_of_the_intensity(case: Case) -> None:
    at_zero = case.evaluate("ambiguity", case.upsilon, np.zeros(case.dimension))
    transform = case.intensity_spectrum(case.upsilon)
    law = "A(upsilon, 0) = F(upsilon)" + ("" if case.waves.uniform else " of |u|^2")
    require(law, at_zero, transform, case.allowed, {"upsilon": case.upsilon})


def _lattice(corner: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, float]:
    """Points of a rank-1 lattice in a box, and the content that each stands for."""
    k = np.arange(_LATTICE_POINTS)
    unit = np.column_stack([k + 0.5, (k * _LATTICE_STEP) % _LATTICE_POINTS + 0.5])
    unit = unit[:, : len(corner)] / _LATTICE_POINTS
    return corner + unit @ sides, abs(float(np.linalg.det(sides))) / _LATTICE_POINTS


def _integrals_are_the_other_marginals(case: Case) -> None:
    corner, sides = box_of(case.source)
    x, cell = _lattice(corner, sides)
    xi, xi_cell = _lattice(-sides.sum(axis=0), 2 * sides)
    if case.content < _LEAST_FILLING * abs(np.linalg.det(sides)):
        return  # two needles far apart, a thin ring: the other identities cover them
    if case.waves.spread * case.source.diameter > _MOST_CYCLES:
        return  # waves that turn against each other too often for the lattice
    allowed = _LATTICE_TOLERANCE * (case.waves.strength * case.content) ** 2
    carrier = case.waves.carrier
    if np.linalg.norm(carrier) * case.source.diameter <= _MOST_CYCLES:
        square = np.abs(case.evaluate("fourier", np.zeros((1, case.dimension)))) ** 2
        right = "content^2" if case.waves.uniform else "|F(0)|^2"
        for name, total in (
            ("int R_x dx", cell * case.evaluate("position_marginal", x).sum(dtype=float)),
            ("int R_xi dxi", xi_cell * case.evaluate("lag_marginal", xi).sum()),
        ):
            require(f"{name} = {right}", total, square, allowed, {"corner": corner})
    order = np.argsort(np.linalg.norm(case.nu - carrier, axis=1))
    low = (case.nu - carrier)[order][:: max(1, len(order) // 4)][:2]  # what a lattice resolves
    for nu, upsilon in zip(carrier + low, np.roll(low, 1, axis=0), strict=True):
        total = cell * case.evaluate("wigner", x, nu).sum(dtype=float)
        power = np.abs(case.evaluate("fourier", nu)) ** 2
        require("int W dx = |F(nu)|^2", total, power, allowed, {"nu": nu})
        ahead, behind = (case.evaluate("fourier", nu + s * upsilon / 2) for s in (1, -1))
        here = {"nu": nu, "upsilon": upsilon}
        wave = np.exp(-2j * np.pi * x @ upsilon)
        total = cell * (case.evaluate("wigner", x, nu) * wave).sum(dtype=complex)
        law = "int W exp(-2 pi i upsilon.x) dx = F(nu + upsilon/2) F*(nu - upsilon/2)"
        require(law, total, ahead * behind.conj(), allowed, here)
        wave = np.exp(-2j * np.pi * xi @ nu)
        total = xi_cell * (case.evaluate("ambiguity", upsilon, xi) * wave).sum(dtype=complex)
        law = "int A exp(-2 pi i xi.nu) dxi = F(nu + upsilon/2) F*(nu - upsilon/2)"
        require(law, total, ahead * behind.conj(), allowed, here)


def _deepest_point(source: Aperture | Slits) -> tuple[np.ndarray, float]:
    """The point of the source farthest from its boundary, and that distance."""
    if isinstance(source, Slits):
        begin, end = source.intervals[np.argmax(np.diff(source.intervals, axis=1)[:, 0])]
        return np.array([(begin + end) / 2]), float(end - begin) / 2
    radius = shapely.maximum_inscribed_circle(source.polygons)
    return np.array(radius.coords[0]), float(radius.length)


def _wigner_integrates_over_frequencies_to_the_intensity(case: Case) -> None:
    """The sum over a grid of frequencies under a Gaussian window is R(x, xi) smoothed at xi = 0.

    The window's image stays inside the lag slice, whose boundary is twice as far from xi = 0 as
    that of the source from x, so that R is a sum of waves there; the grid is fine enough that
    periodic images do not meet. Of a uniform field 1 is left, of others nearly |u|^2.
    """
    d, carrier = case.dimension, case.waves.carrier
    centre, depth = _deepest_point(case.source)
    width = 2 * depth / _GAUSSIANS
    period = 4 * case.source.diameter + _GAUSSIANS * width
    half = math.ceil(_GAUSSIANS / width * period)
    if (2 * half + 1) ** d > _MOST_FREQUENCIES:
        return  # too thin for a sum over an isotropic grid; the other identities cover it
    axis = np.arange(-half, half + 1) / period
    nu = np.stack(np.meshgrid(*d * [axis]), axis=-1).reshape(-1, d)
    window = np.exp(-np.pi * width**2 * (nu**2).sum(axis=1))
    total = (case.evaluate("wigner", centre, carrier + nu) * window).sum(dtype=float) / period**d
    expected = sum(
        factor
        * np.exp(2j * np.pi * apart @ centre - np.pi * width**2 * ((mean - carrier) ** 2).sum())
        for factor, mean, apart in case.waves.pairs()
    )
    allowed = case.allowed * window.sum() / period**d + case.turned / case.content
    require("int W dnu = |u(x)|^2", total, np.real(expected), allowed, {"x": centre})


def _slices_found_otherwise_have_the_same_transforms(case: Case) -> None:
    """By pairs of elements, and of their waves, on slices that are cut one by one."""
    allowed = 8 * case.allowed
    if not case.is_array:
        allowed = case.allowed + 4 * case.rounding * case.waves.strength**2 + case.turned
    x, nu = case.x[: case.few], case.nu[: case.few]
    by_lag = [wigner_by_pairs(case, *place) for place in zip(x, nu, strict=True)]
    got = case.evaluate("wigner", x, nu)
    law = "W(x, nu) = F(nu) of the lag slice, by pairs"
    require(law, got, by_lag, allowed, {"x": x, "nu": nu})
    upsilon, xi = case.upsilon[: case.few], case.xi[: case.few]
    by_position = [ambiguity_by_pairs(case, *place) for place in zip(upsilon, xi, strict=True)]
    got = case.evaluate("ambiguity", upsilon, xi)
    law = "A(upsilon, xi) = F(upsilon) of the position slice, by pairs"
    require(law, got, by_position, allowed, {"upsilon": upsilon, "xi": xi})


def _moving_turning_and_scaling_only_change_coordinates(case: Case) -> None:
    scale, d = 3.0, case.dimension
    angle = 0.7 if d == 2 else math.pi  # on a line there is but the mirror image
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    turn = turn[:d, :d]
    shift = np.array([0.37, -0.19])[:d] * case.source.diameter
    there = moved(case.source, scale * turn, shift)
    x, xi = case.x[:_SLICES], case.xi[:_SLICES]
    nu, upsilon = case.nu[:_SLICES], case.upsilon[:_SLICES]
    x_there, xi_there = scale * x @ turn.T + shift, scale * xi @ turn.T
    nu_there, upsilon_there = nu @ turn.T / scale, upsilon @ turn.T / scale
    rounding = 4 * case.rounding * case.waves.strength**2 + 4 * case.turned
    allowed = (10 * case.allowed + rounding) * scale**d
    got = transforms.wigner(there, x_there, nu_there, **case.keywords)
    expected = scale**d * case.evaluate("wigner", x, nu)
    law = "W of the source turned, scaled by 3 and shifted"
    require(law, got, expected, allowed, {"x": x, "nu": nu})
    phase = np.exp(-2j * np.pi * upsilon_there @ shift)
    got = transforms.ambiguity(there, upsilon_there, xi_there, **case.keywords)
    expected = scale**d * phase * case.evaluate("ambiguity", upsilon, xi)
    law = "A of the source turned, scaled by 3 and shifted"
    require(law, got, expected, allowed, {"upsilon": upsilon, "xi": xi})


def _cutting_into_pieces_changes_nothing(case: Case) -> None:
    """F is linear in the field; W and A are quadratic forms, fixed by pieces and pairs of them."""
    singles, pairs = split_in_three(case.source)
    numpy = {**case.keywords, "engine": "numpy"}  # many sources, few points: compiling is slower
    x, xi = case.x[:_SLICES], case.xi[:_SLICES]
    nu, upsilon = case.nu[:_SLICES], case.upsilon[:_SLICES]
    strength = case.waves.strength
    # more edges, more roundings
    allowed = 10 * case.allowed + case.rounding * strength**2 + case.turned
    total = sum(transforms.fourier(piece, nu, **numpy) for piece in singles)
    whole = case.evaluate("fourier", nu)
    require("F is the sum over pieces", total, whole, allowed / strength, {"nu": nu})
    for name, transform, points in (
        ("W", transforms.wigner, {"x": x, "nu": nu}),
        ("A", transforms.ambiguity, {"upsilon": upsilon, "xi": xi}),
    ):
        total = sum(transform(pair, *points.values(), **numpy) for pair in pairs)
        total = total - sum(transform(piece, *points.values(), **numpy) for piece in singles)
        whole = case.evaluate(transform.__name__, *points.values())
        law = f"{name} is the sum over pairs of pieces minus that over pieces"
        require(law, total, whole, allowed, points)


_POINTWISE = (
    _wigner_is_mirrored,
    _ambiguity_is_hermitian_and_bounded,
    _ambiguity_at_zero_is_the_energy,
    _fourier_is_the_sum_over_waves,
)
_MARGINALS = (
    _values_at_zero_are_marginals,
    _ambiguity_without_lag_is_the_spectrum_of_the_intensity,
    _integrals_are_the_other_marginals,
    _wigner_integrates_over_frequencies_to_the_intensity,
)
_COVARIANCE = (
    _slices_found_otherwise_have_the_same_transforms,
    _moving_turning_and_scaling_only_change_coordinates,
    _cutting_into_pieces_changes_nothing,
)


def assert_otf_properties(
    source: Aperture | Slits,
    *,
    defocus: float = 0.75,
    points: int = 200,
    seed: int = 0,
    precision: Precision = None,
    engine: str = "auto",
    tolerance: float | None = None,
) -> None:
    """Raise an AssertionError unless the OTF of a pupil has the properties that it must have.

    OTF(0) = 1; OTF(-xi) = conj OTF(xi), since the image of a point is real; in focus it is the
    lag marginal over int |u|^2, of a uniform pupil the mutual area over the area; out of focus a
    uniform pupil's is nowhere larger than that (any pupil's not than the mutual area times the
    largest |u|^2 over int |u|^2); with the conjugate field and the opposite defocus it is the
    conjugate; and it is zero beyond the largest distance of two points of the pupil, the cut-off.

    Parameters
    ----------
    source: the pupil, an Aperture or Slits, uniform or with an illumination.
    defocus: W20 in waves, at the pupil's largest radius.
    points, seed, precision, engine, tolerance: as in :func:`assert_wigner_identities`.

    Raises
    ------
    AssertionError: names the first property that does not hold, where, and the two values.
    ArgumentError: for sources that are no pupils.
    """
    case = case_of(source, points, seed, precision, engine, tolerance)
    xi, allowed = case.xi, case.allowed / case.energy
    outline = transforms.lag_marginal(case.outline, xi, **case.keywords)
    mutual = case.evaluate("lag_marginal", xi) / case.energy
    largest = case.waves.strength**2 / case.energy * outline
    conjugate = case.source
    if not case.waves.uniform:
        conjugate = case.outline.with_illumination(case.waves.conjugate())
    for waves in (0.0, defocus):
        name = f"OTF at {waves} waves"
        value = transforms.otf(source, xi, waves, **case.keywords)
        origin = np.zeros((1, case.dimension))
        at_zero = transforms.otf(source, origin, waves, **case.keywords)
        require(f"{name}: 1 at xi = 0", at_zero, 1.0, allowed, {"xi": origin})
        reversed_ = transforms.otf(conjugate, xi, -waves, **case.keywords)
        law = f"{name}: the conjugate of that with the opposite defocus"
        require(law, reversed_, value.conj(), allowed, {"xi": xi})
        mirrored = transforms.otf(source, -xi, waves, **case.keywords)
        require(f"{name}: OTF(-xi) = conj OTF(xi)", mirrored, value.conj(), allowed, {"xi": xi})
        size = np.abs(value)
        law = f"{name}: no larger than in focus"
        require(law, size, np.minimum(size, largest), allowed, {"xi": xi})
        if not waves:
            require(f"{name}: mutual content over content", value, mutual, allowed, {"xi": xi})
        beyond = xi * (1.001 * source.diameter / np.linalg.norm(xi, axis=1, keepdims=True))
        value = transforms.otf(source, beyond, waves, **case.keywords)
        require(f"{name}: zero beyond the cut-off", value, 0.0, allowed, {"xi": beyond})


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
    for check in _ARRAY_LAWS:
        check(case)


def _fourier_is_the_weighted_sum(case: Case) -> None:
    terms = [transforms.fourier(element, case.nu, **case.otherwise) for element in case.elements]
    bound = float(
        sum(s * content_of(e) for s, e in zip(case.strengths, case.elements, strict=True))
    )
    allowed = case.tolerance * bound + case.allowed / float(case.strengths.max())
    got = case.evaluate("fourier", case.nu)
    law = "F is the weighted sum over elements"
    require(law, got, case.weights @ np.stack(terms), allowed, {"nu": case.nu})


def _halves_obey_the_parallelogram_law(case: Case) -> None:
    """Weights of halves drawn at random are no product and no lattice: another way to sum."""
    if len(case.source) < 2:
        return
    rng = np.random.default_rng(len(case.source))
    first = rng.permutation(len(case.source)) < len(case.source) // 2
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


def _common_phases_and_shifts_only_change_coordinates(case: Case) -> None:
    corners = np.concatenate([corners_of(element) for element in case.elements])
    shift = np.array([0.37, -0.19])[: case.dimension] * float(np.ptp(corners, axis=0).max())
    if case.source.repeated is None:
        moved = Elements([e.moved(shift) for e in case.elements], 1j * case.weights)
    else:
        element, positions = case.source.repeated
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


_ARRAY_LAWS = (
    _fourier_is_the_weighted_sum,
    _wigner_is_real_and_bounded,
    _ambiguity_is_hermitian_and_bounded,
    _values_at_zero_are_marginals,
    _halves_obey_the_parallelogram_law,
    _common_phases_and_shifts_only_change_coordinates,
    _slices_found_otherwise_have_the_same_transforms,
)
