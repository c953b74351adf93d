"""A check that the transforms of a source obey the laws of phase space."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from polywigner import transforms
from polywigner.geometry import Aperture, Slits
from polywigner.geometry.arguments import checked_count, checked_type
from polywigner.numerics import Floats
from polywigner.source import Array
from polywigner.source.normal_form import normal_form

__all__ = ["check"]

# A law: its name, its left and right side, their allowed difference, and the arguments by name.
Law = tuple[str, Any, Any, float, dict[str, Floats]]

# Allowed difference between the two sides of a law, relative to the largest possible value, for a
# source at the origin.
_TOLERANCE = 1e-12
# Lattice for the integral of W over x: number of points, generator, and relative error of the
# integral of |u|^2.
_LATTICE, _STEP, _LATTICE_ERROR = 10946, 6765, 2e-3


def check(source: Aperture | Slits | Array, points: int = 100, seed: int = 0) -> None:
    """Raise an AssertionError unless the transforms of a source obey the laws of phase space.

    The laws, in d dimensions: W is real and bounded by 2^d int |u|^2; A is Hermitian and bounded by
    A(0, 0) = int |u|^2; W(x, 0) and A(0, xi) are the marginals; int W dx = |F(nu)|^2; translations
    only change coordinates and phases; weights of an array act linearly on F and quadratically on
    W; F(0) of a uniform source is its area. docs/theory/transforms.md derives the laws.

    Parameters
    ----------
    source : Aperture, Slits or Array
        Source in the plane z = 0, uniform or with illuminations.
    points : int, default 100
        Number of random arguments at which each law is tested.
    seed : int, default 0
        Seed of the random arguments.

    Raises
    ------
    AssertionError
        If a law does not hold; the message contains the arguments and both values.
    ArgumentError
        If the source has an unsupported type.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.testing.check(pw.shapes.u_shape(20e-3, 12e-3, 3e-3))
    """
    checked_type(source, "an Aperture, Slits or an Array", Aperture, Slits, Array)
    checked_count(points, "points", 1)
    for law, left, right, allowed, arguments in _laws(source, points, seed):
        off = np.abs(np.asarray(left) - np.asarray(right))
        if not np.all(off <= allowed):
            at = np.unravel_index(np.argmax(np.where(np.isnan(off), np.inf, off)), off.shape)
            point = ", ".join(
                f"{name} = {values[at].tolist()}" for name, values in arguments.items()
            )
            left, right = (np.broadcast_to(side, off.shape)[at] for side in (left, right))
            raise AssertionError(
                f"the law '{law}' is violated at {point or 'all points'}: {left} and {right} "
                f"differ by more than {allowed:.3g}"
            )


def _laws(source: Aperture | Slits | Array, points: int, seed: int) -> Iterator[Law]:
    """Yield each law, with its two sides evaluated for a source at random arguments.

    Each item is (name, left side, right side, allowed absolute difference, arguments by name).
    """
    form = normal_form(source)
    low, high = np.reshape(form.bounds, (2, -1))
    size = float(np.linalg.norm(high - low))
    d = len(low)
    random = np.random.default_rng(seed)
    x = random.uniform(low, high, (points, d))
    xi = random.uniform(low - high, high - low, (points, d))
    nu, upsilon = random.uniform(-8.0 / size, 8.0 / size, (2, points, d))
    zero = np.zeros(d)
    energy = float(np.real(transforms.lag_marginal(source, zero)))
    field = sum(abs(e.weight) * float(np.abs(e.amplitudes).sum()) for e in form.elements)
    bound = math.prod((high - low).tolist()) * field**2
    # Coordinates far from the origin have larger rounding errors.
    far = 1.0 + float(np.abs([low, high]).max()) / size
    allowed = _TOLERANCE * far * max(bound, energy)

    w, a = transforms.wigner(source, x, nu), transforms.ambiguity(source, upsilon, xi)
    at_x, at_xi = {"x": x, "nu": nu}, {"upsilon": upsilon, "xi": xi}
    limit = 2**d * energy
    yield "W is real", np.imag(w), 0.0, 0.0, at_x
    yield f"|W| <= {2**d} int |u|^2", w, np.clip(w, -limit, limit), 2**d * allowed, at_x
    mirrored = transforms.ambiguity(source, -upsilon, -xi)
    yield "A(-upsilon, -xi) = conj A(upsilon, xi)", mirrored, np.conj(a), allowed, at_xi
    excess = np.maximum(np.abs(a) - energy, 0.0)
    yield "|A| <= A(0, 0)", excess, 0.0, allowed, at_xi

    at_zero, marginal = transforms.wigner(source, x, zero), transforms.position_marginal(source, x)
    yield "W(x, 0) = R_x(x)", at_zero, marginal, 2**d * allowed, {"x": x}
    at_zero, marginal = transforms.ambiguity(source, zero, xi), transforms.lag_marginal(source, xi)
    yield "A(0, xi) = R_xi(xi)", at_zero, marginal, allowed, {"xi": xi}

    # The lattice resolves only low frequencies, so the integral is tested at a few low frequencies.
    few = nu[: max(1, points // 25)] / 8.0
    lattice, cell = _lattice(low, high)
    integral = cell * transforms.wigner(source, lattice, few[:, None]).sum(axis=1)
    power = np.abs(transforms.fourier(source, few)) ** 2
    loss = _LATTICE_ERROR * (bound / field) ** 2
    yield "int W dx = |F(nu)|^2", integral, power, loss, {"nu": few}

    shift = np.linspace(0.37, -0.19, d) * size
    moved = form.moved(shift).public
    shifted = transforms.wigner(moved, x + shift, nu)
    yield "W of the shifted source", shifted, w, 4 * 2**d * allowed, at_x
    shifted, phase = transforms.ambiguity(moved, upsilon, xi), np.exp(-2j * np.pi * upsilon @ shift)
    yield "A of the shifted source", shifted, phase * a, 4 * allowed, at_xi
    f, shifted = transforms.fourier(source, nu), transforms.fourier(moved, nu)
    phase = np.exp(-2j * np.pi * nu @ shift)
    strength = 4 * allowed / field
    yield "F of the shifted source", shifted, phase * f, strength, {"nu": nu}

    if isinstance(source, Array):
        weighted = Array(source.elements, 2j * np.asarray(source.weights))
        twice = transforms.wigner(weighted, x, nu)
        yield "W of the array with weights 2i", twice, 4 * w, 16 * 2**d * allowed, at_x
        terms = [transforms.fourier(element, nu) for element in source.elements]
        total = np.tensordot(np.asarray(source.weights), terms, 1)
        yield "F is the weighted sum over elements", f, total, strength, {"nu": nu}
    elif source.illumination is None:
        content = source.area if isinstance(source, Aperture) else source.length
        at_zero = transforms.fourier(source, zero)
        yield "F(0) is the area", np.atleast_1d(at_zero), content, strength, {}


def _lattice(low: Floats, high: Floats) -> tuple[Floats, float]:
    """Return the points (n, d) of a rank-1 lattice that fills a box, and the volume per point."""
    k = np.arange(_LATTICE)
    unit = np.column_stack([k + 0.5, (k * _STEP) % _LATTICE + 0.5])[:, : len(low)] / _LATTICE
    return low + unit * (high - low), math.prod((high - low).tolist()) / _LATTICE
