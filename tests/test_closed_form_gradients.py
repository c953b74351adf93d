"""Derivatives in closed form against exact arithmetic and physical laws."""

from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles import exact
from polywigner.errors import ArgumentError, GeometryError

pytestmark = pytest.mark.llvm

CHEVRON = np.array([[0, 0], [1, 0.5], [2, 0], [2, 0.625], [1, 1.125], [0, 0.625]])
FRAME = [
    np.array([[0, 0], [2, 0.125], [1.75, 1.5], [0.25, 1.25]]),
    np.array([[0.5, 0.375], [0.75, 1], [1.25, 0.875]]),  # the hole
]
# Rounding errors relative to the largest component of the gradient.
ERRORS = {"double": 1e-11, "single": 1e-4}
# Step h of extrapolated differences with steps h and h/2, whose error is h^4 (2 pi nu D)^5, about
# 1e-15.
STEP = 2.0**-17
# Rounding error of two float64 sums of tens of terms.
ROUNDING = 1e-11


def _backend():
    import drjit.llvm.ad as backend

    return backend


def _points(values, double=True):
    kind = _backend().Array2f64 if double else _backend().Array2f
    return kind(np.ascontiguousarray(values.T))


def _numbers(values):
    return _backend().Complex2f64(values.real.copy(), values.imag.copy())


def _read(points):
    return np.array(points, np.float64).T


def _on_grid(rng, low, high, count):
    """Return random points that float32 represents exactly, with steps exact in float64."""
    return np.round(rng.uniform(low, high, (count, 2)) * 2**12) / 2**12


def _exact_value(rings, x, nu):
    with exact.mpmath.workdps(exact.DIGITS):
        return exact.transform(exact.lag_region(rings, x), nu).real


def _exact_slope(rings, pair, change):
    """Return the derivative of W along a change of all numbers, with 50 digits."""

    def at(step):
        moved = [ring + step * own for ring, own in zip(rings, change[0], strict=True)]
        return _exact_value(
            moved, *(p + step * own for p, own in zip(pair, change[1], strict=True))
        )

    wide, narrow = (at(h) - at(-h) for h in (STEP, STEP / 2))
    return float((8 * narrow - wide) / (6 * exact.mpmath.mpf(STEP)))


OUTLINES: dict[str, tuple[Any, str]] = {
    "chevron": ([CHEVRON], "double"),
    "frame": (FRAME, "double"),
    "single precision": ([CHEVRON], "single"),
}


@pytest.mark.parametrize(("rings", "precision"), OUTLINES.values(), ids=OUTLINES)
def test_derivatives_are_those_of_exact_arithmetic(rings, precision):
    """The derivatives of A and F use the same derivatives of edges."""
    import drjit as dr

    rng, double, count = np.random.default_rng(8), precision == "double", 3
    source = pw.Aperture([shapely.Polygon(rings[0], rings[1:])])
    low, high = np.reshape(source.bounds, (2, 2))
    middle, size = (low + high) / 2, (high - low) / 5  # W is not zero here.
    pair = _on_grid(rng, middle - size, middle + size, count), _on_grid(rng, -1.5, 1.5, count)
    arrays = [_points(np.concatenate(source.rings), double), *(_points(p, double) for p in pair)]
    dr.enable_grad(arrays)
    value = pw.wigner(pw.differentiable(source, vertices=arrays[0]), *arrays[1:])
    for k in range(count):
        dr.clear_grad(arrays)
        dr.set_grad(value, type(value)(np.eye(count)[k]))
        dr.enqueue(dr.ADMode.Backward, value)
        dr.traverse(dr.ADMode.Backward, dr.ADFlag.ClearInterior)
        gradient = [_read(dr.grad(a)) for a in arrays]
        # Coordinates have few bits, so that sums are exact.
        change = [_on_grid(rng, -1, 1, len(ring)) for ring in source.rings]
        moves = [_on_grid(rng, -1, 1, 1)[0] for _ in pair]
        expected = _exact_slope(source.rings, [p[k] for p in pair], (change, moves))
        got = (gradient[0] * np.concatenate(change)).sum()
        got += sum(g[k] @ move for g, move in zip(gradient[1:], moves, strict=True))
        largest = max(np.abs(component).max() for component in gradient)
        assert abs(got - expected) < ERRORS[precision] * largest


def test_a_shift_of_all_vertices_of_an_array_turns_the_phase_of_its_transform():
    """The derivative dF/dx is -2 pi i nu_x F."""
    import drjit as dr

    source = pw.Array([pw.shapes.square(0.7), pw.shapes.chevron(2.0, 1.2, 0.4)], [1, 0.5 + 0.3j])
    nu = np.array([[0.3, -0.2], [-0.7, 0.4]])
    rings = [ring for element in source.elements_in_plane for ring in element.rings]
    corners = _points(np.concatenate(rings))
    dr.enable_grad(corners)
    dr.set_grad(corners, type(corners)(1.0, 0.0))
    value = pw.fourier(pw.differentiable(source, vertices=corners), _points(nu))
    change, expected = dr.forward_to(value), pw.fourier(source, nu)
    for result, factor in ((value, 1.0), (change, -2j * np.pi * nu[:, 0])):
        numbers = np.array(result.real) + 1j * np.array(result.imag)
        assert numbers == pytest.approx(factor * expected, abs=ROUNDING)


@pytest.mark.slow
def test_forward_and_reverse_mode_are_adjoint():
    """The test checks <g, J t> = <J* g, t> for random t and g."""
    import drjit as dr

    rng = np.random.default_rng(2)
    pieces = [
        pw.shapes.square(0.7),
        pw.shapes.triangle(1.0, 0.8).moved((0.4, -0.6)),
    ]
    source = pw.Array(pieces, [1, 0.5 + 0.3j])
    corners = np.concatenate([ring for element in pieces for ring in element.rings])
    weights = np.stack([source.weights.real, source.weights.imag], axis=-1)
    points = rng.uniform(-2, 2, (9, 2)), rng.uniform(-0.5, 0.8, (9, 2))
    arrays = [_points(v) for v in (corners, weights, *points)]
    changes = [type(a)(rng.normal(size=np.array(a).shape)) for a in arrays]

    def value():
        numbers = _backend().Complex2f64(arrays[1][0], arrays[1][1])
        traced = pw.differentiable(source, vertices=arrays[0], weights=numbers)
        result = pw.ambiguity(traced, *arrays[2:])
        return dr.square(result.real - 0.3) + 0.5 * result.imag

    for array, change in zip(arrays, changes, strict=True):
        dr.enable_grad(array)
        dr.set_grad(array, change)
    pushed = np.array(dr.forward_to(value())).sum()
    dr.clear_grad(arrays)
    dr.backward(value())
    pulled = sum(
        (np.array(dr.grad(a)) * np.array(c)).sum() for a, c in zip(arrays, changes, strict=True)
    )
    assert abs(pushed - pulled) < ROUNDING * max(1.0, abs(pulled))


def _gradient(source, vertices, *points, double=True):
    """Return the gradient of the sum of W in vertices, x and nu."""
    import drjit as dr

    arrays = [_points(np.asarray(v, float), double) for v in (vertices, *points)]
    dr.enable_grad(arrays)
    dr.backward(pw.wigner(pw.differentiable(source, vertices=arrays[0]), *arrays[1:]))
    return [_read(dr.grad(a)) for a in arrays]


@pytest.mark.parametrize("corners", [24, 80])
def test_of_many_edges_derivatives_by_cells_are_those_by_rows(corners):
    import drjit as dr

    source, rng = pw.shapes.disc(1.0, n=corners), np.random.default_rng(5)
    x, nu = rng.uniform(-0.7, 0.7, (20, 2)), rng.uniform(-3, 3, (20, 2))
    by_rows = _gradient(source, np.concatenate(source.rings), x, nu)[1:]
    arrays = [_points(x), _points(nu)]
    dr.enable_grad(arrays)
    dr.backward(pw.wigner(source, *arrays))
    for expected, array in zip(by_rows, arrays, strict=True):
        assert np.abs(_read(dr.grad(array)) - expected).max() < ROUNDING * np.abs(expected).max()


def test_rings_that_begin_elsewhere_keep_their_own_numbers():
    """Equal apertures share tables, but derivatives belong to the vertices of each aperture."""
    points = np.array([[0.9, 0.7]]), np.array([[0.4, -0.3]])
    gradients = []
    for k in (0, 2):
        ring = np.roll(CHEVRON, k, axis=0)
        gradients.append(np.roll(_gradient(None, ring, *points)[0], -k, axis=0))
    assert np.abs(gradients[0]).max() > 0.1
    assert np.abs(gradients[0] - gradients[1]).max() < ROUNDING


@pytest.mark.cuda
def test_derivatives_on_a_gpu_are_those_of_the_processor():
    import drjit as dr
    import drjit.cuda.ad as cuda

    rng = np.random.default_rng(9)
    points = [np.array(CHEVRON), rng.uniform(0.2, 1.0, (9, 2)), rng.uniform(-2, 2, (9, 2))]
    expected = _gradient(None, *points)
    arrays = [cuda.Array2f64(np.ascontiguousarray(p.T)) for p in points]
    dr.enable_grad(arrays)
    dr.backward(pw.wigner(pw.differentiable(vertices=arrays[0]), *arrays[1:]))
    for result, own in zip(arrays, expected, strict=True):
        assert np.abs(_read(dr.grad(result)) - own).max() < ROUNDING * np.abs(own).max()


def test_a_precision_is_kept_and_numpy_points_become_tensors():
    backend = _backend()
    single = pw.differentiable(vertices=_points(CHEVRON, double=False))
    assert type(pw.wigner(single, np.zeros((4, 3, 2)) + 0.6, (0.1, 0.2))) is backend.TensorXf
    tensor = pw.differentiable(vertices=backend.TensorXf64(CHEVRON))
    value = pw.fourier(tensor, np.zeros((4, 3, 2)))
    assert type(value) is backend.TensorXf64 and value.shape == (4, 3, 2)
    assert np.abs(np.array(value)[..., 0] - pw.Aperture(CHEVRON).area).max() < ROUNDING


REFUSED: dict[str, Any] = {
    "nothing traced": lambda: pw.differentiable(pw.Aperture(CHEVRON)),
    "vertices of slits": lambda: pw.differentiable(pw.Slits([[0, 1]]), vertices=_points(CHEVRON)),
    "NumPy vertices": lambda: pw.differentiable(vertices=CHEVRON),
    "another count": lambda: pw.differentiable(pw.shapes.square(1.0), vertices=_points(CHEVRON)),
    "weights of one": lambda: pw.differentiable(
        pw.Aperture(CHEVRON), weights=_numbers(np.ones(1) + 0j)
    ),
    "single points": lambda: pw.wigner(
        pw.differentiable(vertices=_points(CHEVRON)), *[_points(CHEVRON, double=False)] * 2
    ),
    "complex x": lambda: pw.wigner(pw.Aperture(CHEVRON), np.full((6, 2), 1j), _points(CHEVRON)),
    "complex nu": lambda: pw.fourier(
        pw.differentiable(vertices=_points(CHEVRON)), np.full((2, 2), 1j)
    ),
}
NO_OUTLINE = {
    "crosses itself": [[0, 0], [1, 1], [1, 0], [0, 1]],
    "repeats a vertex": [[0, 0], [1, 0], [1, 0], [1, 1]],
    "not a number": [[0, 0], [1, 0], [np.nan, 1]],
    "no area": [[0, 0], [1, 0], [2, 0]],
}


@pytest.mark.parametrize("make", REFUSED.values(), ids=REFUSED)
def test_what_is_no_differentiable_source_is_refused(make):
    with pytest.raises(ArgumentError, match="expected"):
        make()


@pytest.mark.parametrize("ring", NO_OUTLINE.values(), ids=NO_OUTLINE)
def test_vertices_that_make_no_outline_are_refused(ring):
    with pytest.raises(GeometryError, match="expected"):
        pw.differentiable(vertices=_points(np.array(ring, float)))
    with pytest.raises(GeometryError, match="orientation of the outline"):
        square = pw.shapes.square(1.0)
        pw.differentiable(square, vertices=_points(square.rings[0] * [1, -1]))


AT = np.array([[0.3125, -0.1875]])
# Direction to the right of all edges, which have directions from 0 to 180 degrees.
RIGHT = np.array([1.0, -0.3125])
# Distance across an edge, and the change of the gradient over this distance, which is due to second
# derivatives of about 2 pi nu D with D up to 4.
ACROSS, CHANGE = 2.0**-36, 1e-7
# Errors relative to the area, and distances from the kink of a few thousand ulps or more.
CLOSE = {"double": (1e-14, 2.0**-10, 2.0**-34), "single": (2e-6, 2.0**-6, 2.0**-14)}


@pytest.mark.parametrize("precision", CLOSE)
@pytest.mark.parametrize(
    "ring", [CHEVRON, [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]], ids=["chevron", "L"]
)
def test_close_to_kinks_derivatives_err_as_elsewhere(ring, precision):
    double, (error, *distances) = precision == "double", CLOSE[precision]
    ring, move = np.asarray(ring, float), np.array([0.25, 0.125])  # not across an edge
    # Vertices of the two copies coincide here, and so do parallel edges.
    for place in np.unique([(p + q) / 2 for p in ring for q in ring], axis=0)[5::6]:
        for distance in distances:
            x = (place + distance * RIGHT).astype(np.float64 if double else np.float32)
            values = [
                _exact_value([ring], x.astype(float) + h * distance * move, AT[0])
                for h in (1 / 4, -1 / 4, 1 / 8, -1 / 8)
            ]
            wide, narrow = values[0] - values[1], values[2] - values[3]
            expected = float((8 * narrow - wide) / (6 * exact.mpmath.mpf(distance / 4)))
            got = _gradient(None, ring, [x], AT, double=double)[1][0] @ move
            # The differences have relative errors of (h 2 pi nu D)^4.
            assert abs(got - expected) < (error + 10 * distance**4) * pw.Aperture(ring).area
