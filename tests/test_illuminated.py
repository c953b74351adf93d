"""Transforms of sources with tapers, steering and waves of their own, against direct quadrature."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
import polywigner.testing
from oracles.quadrature import position_nodes, triangle_nodes
from oracles.references import ENGINES, numpy_and_few

# Relative to the integral of |u|^2, as promised; quadrature of 40 x 40 nodes a triangle is good to
# 1e-14 for waves of up to ten cycles across.
TOLERANCE = {"double": 1e-12, "single": 5e-6}

engines = pytest.mark.parametrize("engine", ENGINES)

ELL = pw.Aperture([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
FRAME = pw.Aperture(shapely.box(-1, -1, 1, 1) - shapely.box(-0.5, -0.5, 0.25, 0.5))
PARTS = pw.Aperture(shapely.union(shapely.box(-1, 0, -0.25, 1), shapely.box(0.25, 0, 1, 0.75)))
SQUARE = pw.Aperture(shapely.box(0.5, 0, 1.25, 0.75))  # overlaps the triangle
TRIANGLE = pw.Aperture([[0, 0], [1, 0.25], [0.25, 1.125]])

COSINE = pw.Illumination([0.25] * 4, [[0.25, 0.25], [0.25, -0.25], [-0.25, 0.25], [-0.25, -0.25]])
WILD = pw.Illumination([1, 0.3 - 0.5j, -0.2 + 1j], [[1.5, 0.5], [0.7, -0.4], [1.6, 0.4]])
STEERED = pw.Illumination([1.0], [[50.0, 20.0]])

SOURCES: dict[str, Any] = {
    "convex, cosine": TRIANGLE.with_illumination(COSINE),
    "non-convex, cosine": ELL.with_illumination(COSINE),
    "holed, three waves": FRAME.with_illumination(WILD),
    "disjoint, three waves": PARTS.with_illumination(WILD),
    "steered taper": ELL.with_illumination(STEERED * COSINE),
    "elements with fields of their own": pw.Array(
        [SQUARE.with_illumination(COSINE), TRIANGLE.with_illumination(WILD), TRIANGLE],
        [1, 1j, -0.5],
    ),
    "elements with one field": pw.Array(
        [SQUARE.with_illumination(WILD), TRIANGLE.with_illumination(2j * WILD)], [1.0, 0.5]
    ),
}


def _elements(source: Any) -> list[tuple[pw.Aperture, Callable[[np.ndarray], np.ndarray]]]:
    """Outlines, and the field on each."""
    pairs = [(source, 1.0)]
    if isinstance(source, pw.Array):
        pairs = list(zip(source.elements, source.weights, strict=True))

    def field(element: pw.Aperture, weight: complex) -> Callable[[np.ndarray], np.ndarray]:
        if element.illumination is None:
            return lambda x: np.full(len(x), weight)
        return lambda x: weight * element.illumination(x)

    return [(element, field(*pair)) for pair in pairs for element in pair[:1]]


def _integral(region: Any, f: Callable[[np.ndarray], np.ndarray]) -> Any:
    total: Any = 0.0
    for part in shapely.get_parts(region):
        if part.geom_type != "Polygon" or part.area < 1e-10:
            continue
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(part))
        corners = np.array([shapely.get_coordinates(t)[:3] for t in triangles])
        nodes, weights = triangle_nodes(corners, 40)
        total = total + weights @ f(nodes)
    return total


def _wave(nu: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    return lambda p: np.exp(-2j * np.pi * (p @ nu))


COUNT = 6


@lru_cache
def _by_quadrature(name: str) -> dict[str, np.ndarray]:
    """Points, and the integrals that define F, W and A there."""
    elements, rng = _elements(SOURCES[name]), np.random.default_rng(7)
    carrier = np.array([50.0, 20.0]) if "steered" in name else np.zeros(2)
    x, xi = rng.uniform(0, 1.2, (COUNT, 2)), rng.uniform(-1, 1, (COUNT, 2))
    nu, upsilon = carrier + rng.uniform(-1, 1, (COUNT, 2)), rng.uniform(-1, 1, (COUNT, 2))
    f, w, a = np.zeros((3, COUNT), complex)
    for n in range(COUNT):
        for g, u in elements:
            f[n] += _integral(g.polygons, lambda p, u=u, n=n: u(p) * _wave(nu[n])(p))
            for h, v in elements:
                lag = shapely.intersection(
                    shapely.transform(g.polygons, lambda p, n=n: 2 * (p - x[n])),
                    shapely.transform(h.polygons, lambda p, n=n: 2 * (x[n] - p)),
                )
                w[n] += _integral(
                    lag,
                    lambda s, u=u, v=v, n=n: (
                        u(x[n] + s / 2) * v(x[n] - s / 2).conj() * _wave(nu[n])(s)
                    ),
                )
                position = shapely.intersection(
                    shapely.transform(g.polygons, lambda p, n=n: p - xi[n] / 2),
                    shapely.transform(h.polygons, lambda p, n=n: p + xi[n] / 2),
                )
                a[n] += _integral(
                    position,
                    lambda p, u=u, v=v, n=n: (
                        u(p + xi[n] / 2) * v(p - xi[n] / 2).conj() * _wave(upsilon[n])(p)
                    ),
                )
    return {"x": x, "xi": xi, "nu": nu, "upsilon": upsilon, "f": f, "w": w, "a": a}


def _scale(source: Any) -> float:
    """sum over pairs of elements of the root mean energies: what errors are relative to."""
    energies = [
        _integral(g.polygons, lambda p, u=u: np.abs(u(p)) ** 2) for g, u in _elements(source)
    ]
    return float(np.sqrt(energies).sum() ** 2)


TE10 = 3.1358703246970885  # reference value, in units of the wavelength squared


@pytest.mark.parametrize(
    ("name", "precision", "engine"),
    numpy_and_few(
        itertools.product(SOURCES, TOLERANCE),
        [
            ("holed, three waves", "double"),
            ("convex, cosine", "single"),
        ],
        slow=[("steered taper", "double")],
    ),
)
def test_transforms_are_the_integrals_that_define_them(
    name: str, precision: str, engine: str
) -> None:
    source, data = SOURCES[name], _by_quadrature(name)
    how = {"precision": precision, "engine": engine}
    allowed = TOLERANCE[precision] * _scale(source)
    assert np.abs(pw.wigner(source, data["x"], data["nu"], **how) - data["w"]).max() < allowed
    assert (
        np.abs(pw.ambiguity(source, data["upsilon"], data["xi"], **how) - data["a"]).max() < allowed
    )
    f = pw.fourier(source, data["nu"], **how)
    assert np.abs(f - data["f"]).max() < TOLERANCE[precision] * 4 * math.sqrt(_scale(source))
    zero = np.zeros(2)
    marginal = pw.position_marginal(source, data["x"], **how)
    assert np.abs(marginal - pw.wigner(source, data["x"], zero)).max() < allowed
    marginal = pw.lag_marginal(source, data["xi"], **how)
    assert np.iscomplexobj(marginal)
    assert np.abs(marginal - pw.ambiguity(source, zero, data["xi"])).max() < allowed


@engines
@pytest.mark.parametrize("name", SOURCES)
def test_autocorrelation_is_the_product_of_the_fields(name: str, engine: str) -> None:
    source, rng = SOURCES[name], np.random.default_rng(8)
    x, xi = rng.uniform(-1, 2, (2, 400, 2))

    def field(points: np.ndarray) -> np.ndarray:
        return sum(
            u(points) * shapely.contains_xy(g.polygons, *points.T) for g, u in _elements(source)
        )

    expected = field(x + xi / 2) * field(x - xi / 2).conj()
    got = pw.autocorrelation(source, x, xi, engine=engine)
    assert np.abs(got - expected).max() < 2e-14 * 20


def test_integral_of_w_over_positions_is_the_power_spectrum() -> None:
    source = SOURCES["holed, three waves"]
    nodes, weight = position_nodes(source.rings, 16)
    nu = np.array([[0.0, 0.0], [1.5, 0.5], [-0.5, 0.25]])
    got = pw.wigner(source, nodes[:, None], nu).T @ weight
    assert np.abs(got - np.abs(pw.fourier(source, nu)) ** 2).max() < 1e-10 * _scale(source) ** 2


def test_integral_of_w_over_frequencies_is_the_irradiance() -> None:
    # against a Gaussian window, whose transform is a Gaussian of lags: narrow, so that it only
    # sees lags inside the slice, where the field is smooth; sums over frequencies are spectral
    source = ELL.with_illumination(WILD)
    width, step = 24.0, 0.2
    axis = np.arange(-3.2, 3.2, step / width) * width
    nu = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    window = np.exp(-np.pi * (nu**2).sum(axis=-1) / width**2)
    for x in ([0.5, 0.5], [1.25, 0.625], [0.375, 1.5]):
        got = (pw.wigner(source, np.array(x), nu) * window).sum() * (axis[1] - axis[0]) ** 2
        # the same integral over lags: the autocorrelation times the narrow Gaussian
        lag = np.linspace(-6, 6, 121) / width
        xi = np.stack(np.meshgrid(lag, lag), axis=-1)
        narrow = width**2 * np.exp(-np.pi * width**2 * (xi**2).sum(axis=-1))
        r = source.illumination(x + xi / 2) * source.illumination(x - xi / 2).conj()
        expected = (r * narrow).sum() * (lag[1] - lag[0]) ** 2
        assert got == pytest.approx(expected.real, rel=1e-9)
        # and the window's width costs this much of |u|^2
        assert got == pytest.approx(abs(source.illumination(x)) ** 2, rel=0.05)


def test_te10_mode_has_the_known_wigner_function() -> None:
    # u = cos(pi x/L) on a square of ten millimetres at 94 GHz
    wavelength = 299792458.0 / 94e9
    side = 10e-3 / wavelength
    mode = pw.Illumination([0.5, 0.5], [[0.5 / side, 0.0], [-0.5 / side, 0.0]])
    guide = pw.shapes.square(side).with_illumination(mode)
    assert pw.wigner(guide, (0.5, 0.3), (0.2, 0.1)) == pytest.approx(TE10, rel=1e-6)


@engines
def test_a_single_wave_shifts_the_transforms(engine: str) -> None:
    kappa, rng = np.array([700.0, -300.0]), np.random.default_rng(9)
    source = ELL.with_illumination(pw.Illumination([2j], [kappa]))
    x, xi = rng.uniform(0, 1.5, (2, 50, 2))
    nu = rng.normal(size=(50, 2))
    how = {"engine": engine}
    allowed = 4e-12  # nu + kappa is rounded to 1e-13
    w = pw.wigner(source, x, nu + kappa, **how)
    assert np.abs(w - 4 * pw.wigner(ELL, x, nu, **how)).max() < allowed
    a = pw.ambiguity(source, nu, xi, **how)
    turned = 4 * pw.ambiguity(ELL, nu, xi, **how) * np.exp(2j * np.pi * (xi @ kappa))
    assert np.abs(a - turned).max() < allowed
    f = pw.fourier(source, nu + kappa, **how)
    assert np.abs(f - 2j * pw.fourier(ELL, nu, **how)).max() < allowed


def test_fourier_transform_of_waves_far_from_the_origin_keeps_its_digits() -> None:
    shift = np.array([1024.0, -512.0])
    far = ELL.moved(shift).with_illumination(WILD)
    turn = np.exp(2j * np.pi * np.array([math.fmod(k @ shift, 1.0) for k in WILD.frequencies]))
    near = ELL.with_illumination(pw.Illumination(WILD.amplitudes * turn, WILD.frequencies))
    nu = np.round(np.random.default_rng(10).uniform(-40, 40, (50, 2)) * 2**20) / 2**20
    turns = np.array([math.fmod(n[0] * 1024.0, 1.0) - math.fmod(n[1] * 512.0, 1.0) for n in nu])
    expected = pw.fourier(near, nu) * np.exp(-2j * np.pi * turns)
    assert np.abs(pw.fourier(far, nu) - expected).max() < 1e-12


def test_fourier_transform_of_a_placed_aperture_with_waves() -> None:
    angle = 0.7
    pose = np.array(
        [
            [math.cos(angle), 0, math.sin(angle), 3.0],
            [0, 1, 0, -2.0],
            [-math.sin(angle), 0, math.cos(angle), 1.0],
            [0, 0, 0, 1],
        ]
    )
    nu = np.random.default_rng(11).normal(size=(30, 3)) * (1 + 0.2j)
    source = ELL.with_illumination(WILD)
    expected = pw.fourier(source, nu @ pose[:3, :2]) * np.exp(-2j * np.pi * (nu @ pose[:3, 3]))
    got = pw.fourier(source.placed(pose), nu)
    assert np.abs(got - expected).max() < 1e-13 * np.abs(expected).max()
    moved = pw.Array([source.placed(pose)], [2.0])
    assert np.abs(pw.fourier(moved, nu) - 2 * expected).max() < 2e-13 * np.abs(expected).max()


SLITS = pw.Slits([[-1.0, -0.4], [0.1, 0.9]])
TAPER = pw.Illumination([0.5, 0.5, 0.25j], [[0.25], [-0.25], [1.5]])
LINES = {
    "slits": SLITS.with_illumination(TAPER),
    "an array of slits": pw.Array(
        [SLITS.with_illumination(TAPER), pw.Slits([0.5, 1.5]), pw.Slits([-0.4, 0.1])], [1, -1j, 0.5]
    ),
}


def _line_integral(low: float, high: float, f: Callable[[np.ndarray], np.ndarray]) -> complex:
    if high <= low:
        return 0.0
    node, weight = np.polynomial.legendre.leggauss(40)
    return complex(
        (weight * f((low + high) / 2 + node * (high - low) / 2)).sum() * (high - low) / 2
    )


@engines
@pytest.mark.parametrize("name", LINES)
def test_transforms_of_illuminated_slits(name: str, engine: str) -> None:
    source = LINES[name]
    pairs = [(source, 1.0)]
    if isinstance(source, pw.Array):
        pairs = list(zip(source.elements, source.weights, strict=True))

    def field(slits: pw.Slits, weight: complex) -> Callable[[np.ndarray], np.ndarray]:
        if slits.illumination is None:
            return lambda x: np.full(len(x), weight)
        return lambda x: weight * slits.illumination(x[:, None])

    parts = [(begin, end, field(s, weight)) for s, weight in pairs for begin, end in s.intervals]
    rng = np.random.default_rng(12)
    x, xi, nu, upsilon = rng.uniform(-1.2, 1.2, (4, 12))
    f, w, a = np.zeros((3, 12), complex)
    for n in range(12):
        for p, q, u in parts:
            f[n] += _line_integral(p, q, lambda t, u=u, n=n: u(t) * np.exp(-2j * np.pi * nu[n] * t))
            for r, s, v in parts:
                w[n] += _line_integral(
                    max(2 * (p - x[n]), 2 * (x[n] - s)),
                    min(2 * (q - x[n]), 2 * (x[n] - r)),
                    lambda t, u=u, v=v, n=n: (
                        u(x[n] + t / 2) * np.conj(v(x[n] - t / 2)) * np.exp(-2j * np.pi * nu[n] * t)
                    ),
                )
                a[n] += _line_integral(
                    max(p - xi[n] / 2, r + xi[n] / 2),
                    min(q - xi[n] / 2, s + xi[n] / 2),
                    lambda t, u=u, v=v, n=n: (
                        u(t + xi[n] / 2)
                        * np.conj(v(t - xi[n] / 2))
                        * np.exp(-2j * np.pi * upsilon[n] * t)
                    ),
                )
    x, xi, nu, upsilon = (v[:, None] for v in (x, xi, nu, upsilon))
    assert np.abs(w.imag).max() < 1e-14
    how = {"engine": engine}
    assert np.abs(pw.fourier(source, nu, **how) - f).max() < 1e-13
    assert np.abs(pw.wigner(source, x, nu, **how) - w.real).max() < 1e-13
    assert np.abs(pw.ambiguity(source, upsilon, xi, **how) - a).max() < 1e-13
    zero = np.zeros(1)
    r = pw.position_marginal(source, x, **how)
    assert np.abs(r - pw.wigner(source, x, zero)).max() < 1e-13
    r = pw.lag_marginal(source, xi, **how)
    assert np.abs(r - pw.ambiguity(source, zero, xi)).max() < 1e-13
    there = sum(u(np.array([0.3])) for p, q, u in parts if p <= 0.3 < q)
    assert pw.autocorrelation(source, [0.3], [0.0], **how) == pytest.approx(abs(there[0]) ** 2)


def test_otf_of_a_tapered_pupil_is_its_autocorrelation() -> None:
    pupil = SOURCES["non-convex, cosine"]
    xi = np.array([[0.0, 0.0], [0.25, 0.5]])
    got = pw.otf(pupil, xi)
    assert got[0] == pytest.approx(1.0, abs=1e-14)
    energy = pw.lag_marginal(pupil, [0.0, 0.0]).real
    assert got[1] == pytest.approx(complex(pw.lag_marginal(pupil, xi[1]) / energy))


@pytest.mark.slow
@pytest.mark.llvm
def test_drjit_arrays_and_gradients() -> None:
    import drjit
    import drjit.llvm.ad as backend

    source, rng = SOURCES["convex, cosine"], np.random.default_rng(13)
    x, nu = rng.uniform(0.1, 0.6, (2, 40, 2))
    tensors = [backend.TensorXf64(v) for v in (x, nu)]
    f = pw.fourier(source, tensors[1]).numpy()
    assert np.abs(f[:, 0] + 1j * f[:, 1] - pw.fourier(source, nu)).max() < 1e-13
    first = pw.fourier(source, backend.Array2f64(np.array(nu.T)))
    assert np.abs(np.array(first.real) - f[:, 0]).max() < 1e-13
    for which, step in ((0, 1e-6), (1, 1e-6)):
        arrays = [backend.TensorXf64(v) for v in (x, nu)]
        drjit.enable_grad(arrays[which])
        drjit.backward(drjit.sum(pw.wigner(source, *arrays).array))
        got = np.array(drjit.grad(arrays[which]))
        for k in (0, 1):
            up, down = [x.copy(), nu.copy()], [x.copy(), nu.copy()]
            up[which][:, k] += step
            down[which][:, k] -= step
            slope = (pw.wigner(source, *up) - pw.wigner(source, *down)) / (2 * step)
            assert np.abs(got[:, k] - slope).max() < 1e-6 * np.abs(slope).max()


def test_waves_turn_and_shift_with_elements_posed_in_the_plane() -> None:
    angle = 0.5
    rotation = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    pose = np.eye(4)
    pose[:2, :2], pose[:2, 3] = rotation, (1.0, -2.0)
    source = TRIANGLE.with_illumination(WILD)
    posed = pw.Array([source.placed(pose)])
    x, nu = np.random.default_rng(14).uniform(0, 1, (2, 40, 2))
    there = x @ rotation.T + pose[:2, 3]
    expected = pw.wigner(source, x, nu)
    assert np.abs(pw.wigner(posed, there, nu @ rotation.T) - expected).max() < 1e-13


def test_samples_of_the_automean_bound_the_wigner_function() -> None:
    source = SOURCES["elements with fields of their own"]
    points, density = pw.sample_automean(source, 4000, "marginal", seed=1)
    largest = float(
        sum(
            abs(weight)
            * element.area
            * (1 if element.illumination is None else abs(element.illumination.amplitudes).sum())
            for weight, element in zip(source.weights, source.elements, strict=True)
        )
    )
    nu = np.array([0.3, 0.2])
    ratio = pw.wigner(source, points, nu) / density
    assert np.abs(ratio).max() <= largest**2 * (1 + 1e-9)
    expected = abs(pw.fourier(source, nu)) ** 2
    assert abs(ratio.mean() - expected) < 5 * ratio.std() / math.sqrt(len(ratio))
