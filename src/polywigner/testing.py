"""Assertions for users: do the transforms of this aperture obey the laws they must obey?

``assert_wigner_identities(aperture)`` evaluates W, A, F and the marginals at random points and
checks them against each other, against the same values by shapely's clipping, and against the
same aperture moved, turned, scaled and cut into pieces. It raises an :class:`AssertionError`
that names the identity, the place and the two values. It needs nothing but the package itself,
takes about a second (more for many edges), and returns nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import shapely
from shapely import affinity

from polywigner.geometry import Aperture, lag_slice, position_slice, triangulate
from polywigner.transforms import ambiguity, fourier, lag_marginal, position_marginal, wigner

__all__ = ["assert_wigner_identities"]

# Relative to the area: what the package promises. Shapely's clipping may move a corner by an ulp
# of the diameter, which is why the tolerance grows with perimeter * diameter for slivers.
TOLERANCE = {"double": 1e-12, "single": 5e-6}
# Rank-1 lattice sums of continuous functions with kinks, at 10^4 points, relative to area^2:
# at most 1e-4 on triangles, stars, rings and combs.
LATTICE_POINTS = 10946
LATTICE_STEP = 6765  # consecutive Fibonacci numbers: the best two-dimensional rank-1 lattice
LATTICE_TOLERANCE = 5e-4
SLICES = 12  # slices by shapely, each an aperture of its own
# exp(-pi GAUSSIANS^2) is 1e-15: a Gaussian window of the frequencies loses no more than that
GAUSSIANS = 3.3
MOST_FREQUENCIES = 400_000


@dataclass(frozen=True)
class _Case:
    """The aperture, the places to look at, and how to evaluate."""

    source: Aperture
    x: np.ndarray
    xi: np.ndarray
    nu: np.ndarray
    keywords: dict[str, Any]
    tolerance: float

    @property
    def area(self) -> float:
        return self.source.area

    def evaluate(self, transform: Callable[..., Any], *points: np.ndarray) -> Any:
        return transform(self.source, *points, **self.keywords)


def assert_wigner_identities(
    source: Aperture,
    *,
    points: int = 200,
    seed: int = 0,
    precision: Literal["double", "single"] | None = None,
    engine: str = "auto",
    tolerance: float | None = None,
) -> None:
    """Raise an AssertionError unless the transforms of an aperture obey the laws they must obey.

    W is real, even in nu and bounded by four areas; A is Hermitian and bounded by A(0, 0);
    W(x, 0) and A(0, xi) are the marginals; W integrates over x to |F|^2 and over nu to 1 inside;
    the marginals integrate to the area squared; slices by shapely have the same transforms; and
    moving, turning, scaling or cutting the aperture changes nothing but coordinates.

    Parameters
    ----------
    source: the aperture, uniformly illuminated.
    points: number of random places for each identity.
    seed: of the random places.
    precision, engine: as for the transforms.
    tolerance: relative to the area; by default 1e-12 in double and 5e-6 in single precision, and
        more for slivers, in proportion to perimeter * diameter / area. Integrals over x and xi
        are lattice sums and are held to 5e-4 area^2.

    Raises
    ------
    AssertionError: names the first identity that does not hold, where, and the two values.
    """
    case = _case(source, points, seed, precision, engine, tolerance)
    for check in _CHECKS:
        check(case)


def _case(
    source: Aperture,
    points: int,
    seed: int,
    precision: str | None,
    engine: str,
    tolerance: float | None,
) -> _Case:
    rng = np.random.default_rng(seed)
    corner, sides = _box(source)
    unit = rng.random((points, 2))
    angle = 2 * np.pi * rng.random(points)
    size = 10 ** rng.uniform(-2, 1.5, points) / source.diameter
    if tolerance is None:
        sliver = source.polygons.length * source.diameter / source.area
        tolerance = TOLERANCE[precision or "double"] * max(1.0, sliver / 10)
    return _Case(
        source,
        x=corner + unit @ sides,
        xi=(2 * rng.permutation(unit) - 1) @ sides,
        nu=size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]),
        keywords={"precision": precision, "engine": engine},
        tolerance=tolerance,
    )


def _box(source: Aperture) -> tuple[np.ndarray, np.ndarray]:
    """Corner and two sides (rows) of the smallest box, turned so that needles fill it too."""
    ring = shapely.get_coordinates(shapely.oriented_envelope(source.polygons))
    return ring[0], np.stack([ring[1] - ring[0], ring[3] - ring[0]])


def _require(
    law: str, got: Any, expected: Any, allowed: float, places: dict[str, np.ndarray]
) -> None:
    """Compare arrays; say where they differ most."""
    error = np.abs(np.atleast_1d(np.asarray(got) - np.asarray(expected)))
    error = np.where(np.isnan(error), np.inf, error)
    worst = int(np.argmax(error))
    if error[worst] <= allowed:
        return
    where = ", ".join(
        f"{name} = {np.broadcast_to(value, (len(error), 2))[worst].tolist()}"
        for name, value in places.items()
    )
    pair = [np.broadcast_to(side, error.shape)[worst] for side in (got, expected)]
    raise AssertionError(
        f"{law}: expected {pair[1]:.17g}, got {pair[0]:.17g} at {where} "
        f"(difference {error[worst]:.3g}, allowed {allowed:.3g})"
    )


def _wigner_is_real_even_and_bounded(case: _Case) -> None:
    here = {"x": case.x, "nu": case.nu}
    value = case.evaluate(wigner, case.x, case.nu)
    if np.iscomplexobj(value):
        raise AssertionError(f"W is real: expected a real array, got {value.dtype}")
    allowed = case.tolerance * case.area
    bound = 4 * case.area
    _require("|W| <= 4 area", value, np.clip(value, -bound, bound), allowed, here)
    mirrored = case.evaluate(wigner, case.x, -case.nu)
    _require("W(x, -nu) = W(x, nu) for a real field", mirrored, value, allowed, here)


def _ambiguity_is_hermitian_and_bounded(case: _Case) -> None:
    here = {"upsilon": case.nu, "xi": case.xi}
    value = case.evaluate(ambiguity, case.nu, case.xi)
    mirrored = case.evaluate(ambiguity, -case.nu, -case.xi)
    allowed = case.tolerance * case.area
    _require("A(-upsilon, -xi) = conj A(upsilon, xi)", mirrored, value.conj(), allowed, here)
    size = np.abs(value)
    _require("|A| <= A(0, 0)", size, np.minimum(size, case.area), allowed, here)
    at_zero = case.evaluate(ambiguity, np.zeros((1, 2)), np.zeros((1, 2)))
    nowhere = {"upsilon": np.zeros(2), "xi": np.zeros(2)}
    _require("A(0, 0) = area", at_zero, case.area, allowed, nowhere)


def _marginals_are_the_values_at_zero_frequency(case: _Case) -> None:
    allowed, zero = case.tolerance * case.area, np.zeros(2)
    by_position = case.evaluate(position_marginal, case.x)
    at_zero = case.evaluate(wigner, case.x, zero)
    _require("W(x, 0) = R_x(x)", at_zero, by_position, allowed, {"x": case.x})
    by_lag = case.evaluate(lag_marginal, case.xi)
    at_zero = case.evaluate(ambiguity, zero, case.xi)
    _require("A(0, xi) = R_xi(xi)", at_zero, by_lag, allowed, {"xi": case.xi})
    at_zero = case.evaluate(ambiguity, case.nu, zero)
    transform = case.evaluate(fourier, case.nu)
    _require("A(upsilon, 0) = F(upsilon)", at_zero, transform, allowed, {"upsilon": case.nu})


def _lattice(corner: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, float]:
    """Points of a rank-1 lattice in a box, and the area that each stands for."""
    k = np.arange(LATTICE_POINTS)
    unit = np.column_stack([k + 0.5, (k * LATTICE_STEP) % LATTICE_POINTS + 0.5]) / LATTICE_POINTS
    return corner + unit @ sides, abs(float(np.linalg.det(sides))) / LATTICE_POINTS


def _integrals_are_the_other_marginals(case: _Case) -> None:
    corner, sides = _box(case.source)
    x, cell = _lattice(corner, sides)
    xi, xi_cell = _lattice(-sides.sum(axis=0), 2 * sides)
    allowed = LATTICE_TOLERANCE * case.area**2
    for name, total in (
        ("int R_x dx", cell * case.evaluate(position_marginal, x).sum(dtype=float)),
        ("int R_xi dxi", xi_cell * case.evaluate(lag_marginal, xi).sum(dtype=float)),
    ):
        _require(f"{name} = area^2", total, case.area**2, allowed, {"corner": corner})
    for nu in case.nu[np.argsort(np.hypot(*case.nu.T))][:: max(1, len(case.nu) // 4)][:3]:
        total = cell * case.evaluate(wigner, x, nu).sum(dtype=float)
        power = np.abs(case.evaluate(fourier, nu)) ** 2
        _require("int W dx = |F(nu)|^2", total, power, allowed, {"nu": nu})


def _wigner_integrates_over_frequencies_to_one_inside(case: _Case) -> None:
    """The sum over a grid of frequencies under a Gaussian window is u(x) smoothed by a Gaussian.

    The window's image stays inside the lag slice, whose boundary is twice as far from xi = 0 as
    that of the aperture from x; the grid is fine enough that periodic images do not meet.
    """
    radius = shapely.maximum_inscribed_circle(case.source.polygons)
    centre, depth = np.array(radius.coords[0]), radius.length
    width = 2 * depth / GAUSSIANS
    period = 4 * case.source.diameter + GAUSSIANS * width
    half = math.ceil(GAUSSIANS / width * period)
    if (2 * half + 1) ** 2 > MOST_FREQUENCIES:
        return  # too thin for a sum over an isotropic grid; the other identities cover it
    axis = np.arange(-half, half + 1) / period
    nu = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    window = np.exp(-np.pi * width**2 * (nu**2).sum(axis=1))
    total = (case.evaluate(wigner, centre, nu) * window).sum(dtype=float) / period**2
    allowed = case.tolerance * case.area * window.sum() / period**2
    _require("int W dnu = |u(x)|^2", total, 1.0, allowed, {"x": centre})


def _transform_of(piece: Any, nu: np.ndarray) -> complex:
    polygons = [
        part for part in shapely.get_parts(piece) if part.geom_type == "Polygon" and part.area > 0
    ]
    return sum((complex(fourier(Aperture(p), nu, engine="numpy")) for p in polygons), 0j)


def _slices_by_shapely_have_the_same_transforms(case: _Case) -> None:
    x, xi, nu = case.x[:SLICES], case.xi[:SLICES], case.nu[:SLICES]
    allowed = case.tolerance * case.area
    by_slice = [_transform_of(lag_slice(case.source, p), q) for p, q in zip(x, nu, strict=True)]
    law = "W(x, nu) = F(nu) of the lag slice"
    got = case.evaluate(wigner, x, nu)
    _require(law, got, np.real(by_slice), allowed, {"x": x, "nu": nu})
    by_slice = [
        _transform_of(position_slice(case.source, p), q) for p, q in zip(xi, nu, strict=True)
    ]
    law = "A(upsilon, xi) = F(upsilon) of the position slice"
    got = case.evaluate(ambiguity, nu, xi)
    _require(law, got, by_slice, allowed, {"upsilon": nu, "xi": xi})


def _moving_turning_and_scaling_only_change_coordinates(case: _Case) -> None:
    angle, scale = 0.7, 3.0
    shift = np.array([0.37, -0.19]) * case.source.diameter
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    matrix = (scale * turn).ravel().tolist()
    moved = Aperture(affinity.affine_transform(case.source.polygons, [*matrix, *shift]))
    x, xi, nu = case.x[:SLICES], case.xi[:SLICES], case.nu[:SLICES]
    x_there, xi_there, nu_there = (
        scale * x @ turn.T + shift,
        scale * xi @ turn.T,
        nu @ turn.T / scale,
    )
    allowed = 10 * case.tolerance * moved.area  # the corners are rounded once more
    got = wigner(moved, x_there, nu_there, **case.keywords)
    expected = scale**2 * case.evaluate(wigner, x, nu)
    law = "W of the aperture turned, scaled by 3 and shifted"
    _require(law, got, expected, allowed, {"x": x, "nu": nu})
    phase = np.exp(-2j * np.pi * nu_there @ shift)
    got = ambiguity(moved, nu_there, xi_there, **case.keywords)
    expected = scale**2 * phase * case.evaluate(ambiguity, nu, xi)
    law = "A of the aperture turned, scaled by 3 and shifted"
    _require(law, got, expected, allowed, {"upsilon": nu, "xi": xi})


def _three_pieces(source: Aperture) -> list[np.ndarray]:
    """Triangles (m, 3, 2) that tile the aperture, in three groups from one side to the other."""
    vertices, indices = triangulate(source)
    triangles = vertices[indices]
    if len(triangles) < 3:
        centres = np.broadcast_to(triangles.mean(axis=1, keepdims=True), triangles.shape)
        ahead = np.roll(triangles, -1, axis=1)
        triangles = np.stack([triangles, ahead, centres], axis=2).reshape(-1, 3, 2)
    order = np.argsort(triangles.mean(axis=1) @ (1.0, 0.3))
    return [triangles[part] for part in np.array_split(order, 3)]


def _cutting_into_pieces_changes_nothing(case: _Case) -> None:
    """F is linear in the field; W and A are quadratic forms, fixed by pieces and pairs of them."""
    pieces = _three_pieces(case.source)
    numpy = {**case.keywords, "engine": "numpy"}  # many apertures, few points: compiling is slower
    x, xi, nu = case.x[:SLICES], case.xi[:SLICES], case.nu[:SLICES]
    allowed = 10 * case.tolerance * case.area  # more edges, more roundings
    singles = [Aperture(list(piece)) for piece in pieces]
    pairs = [Aperture([*pieces[k], *pieces[k - 1]]) for k in range(3)]
    total = sum(fourier(piece, nu, **numpy) for piece in singles)
    whole = case.evaluate(fourier, nu)
    _require("F is the sum over pieces", total, whole, allowed, {"nu": nu})
    for law, transform, points in (
        ("W is the sum over pairs of pieces minus that over pieces", wigner, (x, nu)),
        ("A is the sum over pairs of pieces minus that over pieces", ambiguity, (nu, xi)),
    ):
        total = sum(transform(pair, *points, **numpy) for pair in pairs)
        total = total - sum(transform(piece, *points, **numpy) for piece in singles)
        whole = case.evaluate(transform, *points)
        _require(law, total, whole, allowed, dict(zip(("first", "second"), points, strict=True)))


_CHECKS = (
    _wigner_is_real_even_and_bounded,
    _ambiguity_is_hermitian_and_bounded,
    _marginals_are_the_values_at_zero_frequency,
    _integrals_are_the_other_marginals,
    _wigner_integrates_over_frequencies_to_one_inside,
    _slices_by_shapely_have_the_same_transforms,
    _moving_turning_and_scaling_only_change_coordinates,
    _cutting_into_pieces_changes_nothing,
)
