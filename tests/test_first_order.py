"""First-order systems: their algebra, and the transforms of W and A."""

import copy
import math
import pickle

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

WAVELENGTH = 3.19e-3
# Rounding error of products of a few matrices with elements of order 1.
ROUNDING = 1e-14
# Error relative to the area: the rounding of coordinates, times derivatives of some 100 areas.
MAPPED = 1e-12

TEE = pw.Aperture(
    [(-4e-3, -5e-3), (6e-3, -5e-3), (6e-3, -1e-3), (1e-3, -1e-3), (1e-3, 4e-3), (-4e-3, 4e-3)]
)
TAPERED = TEE.with_illumination(pw.Illumination([1.0, 0.4 - 0.3j], [(20.0, -10.0), (-60.0, 35.0)]))
PAIR = pw.phased_array(pw.shapes.square(2e-3), [(-2e-3, 0.0), (2e-3, 1e-3)], [1.0, 0.5j])
SOURCES = {"outline": TEE, "waves": TAPERED, "array": PAIR}

SPACE, LENS = pw.FirstOrder.free_space(0.07), pw.FirstOrder.lens(0.05)
CROSSED = pw.FirstOrder.lens((0.04, -0.11), angle=0.3)
SYSTEMS = {
    "free space": SPACE,
    "lens": LENS,
    "crossed lenses": CROSSED,
    "magnifier": pw.FirstOrder.magnifier((-1.5, 0.8)),
    "Fourier": pw.FirstOrder.fourier(0.06),
    "fractional": pw.FirstOrder.fractional(0.37, 0.06),
    "turn": pw.FirstOrder.rotation(0.4),
    "all of them": SPACE @ CROSSED @ pw.FirstOrder.rotation(-0.7) @ SPACE @ LENS,
}


def points(count, size, seed):
    return np.random.default_rng(seed).uniform(-size, size, (count, 2))


def unit(system):
    """Return the matrix with lengths in units of 0.1 m."""
    return system.matrix * np.kron([[1.0, 10.0], [0.1, 1.0]], np.ones((2, 2)))


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
def test_the_inverse_undoes_a_system(system):
    assert unit(system @ system.inverse) == pytest.approx(np.eye(4), abs=ROUNDING)
    assert unit(system.inverse @ system) == pytest.approx(np.eye(4), abs=ROUNDING)
    assert system.inverse.inverse == system


@pytest.mark.parametrize(
    ("system", "slope"), [(pw.FirstOrder.rotation(0.3), 0.0), (CROSSED, -1 / 0.04)]
)
def test_angles_count_from_x_to_y(system, slope):
    """A rotation turns the x axis to this angle, and a lens deflects along its axis."""
    along = np.array([math.cos(0.3), math.sin(0.3)])
    x, s = system.rays((1.0, 0.0) if slope == 0 else along, (0.0, 0.0))
    assert x == pytest.approx(along) and s == pytest.approx(slope * along)


def test_the_right_system_acts_first():
    x, s = np.array([0.01, -0.02]), np.array([0.03, 0.0])
    at_lens = x + 0.07 * s
    result = (LENS @ SPACE).rays(x, s)
    assert result[0] == pytest.approx(at_lens, abs=1e-17)
    assert result[1] == pytest.approx(s - at_lens / 0.05, abs=1e-15)


def test_a_lens_between_two_focal_lengths_is_a_fourier_transformer_and_two_are_an_image():
    f = pw.FirstOrder.free_space(0.1)
    half = f @ pw.FirstOrder.lens(0.1) @ f
    assert unit(half) == pytest.approx(unit(pw.FirstOrder.fourier(0.1)), abs=ROUNDING)
    assert unit(half @ half) == pytest.approx(-np.eye(4), abs=ROUNDING)


def test_an_image_made_of_lenses_and_distances_is_one_in_spite_of_rounding():
    rng, space = np.random.default_rng(4), pw.FirstOrder.free_space
    for focus, near, beyond in rng.uniform(0.03, 0.7, (50, 3)):
        far = 1 / (1 / focus - 1 / (focus + near))
        image = space(far) @ pw.FirstOrder.lens(focus) @ space(focus + near)
        assert not image.B.any() and image.A[0, 0] == pytest.approx(-focus / near, rel=1e-12)
        relay = space(beyond).inverse @ space(beyond) @ image @ image
        assert not relay.B.any()
        assert (space(1e-9 * far) @ image).B.any()


def test_a_matrix_of_two_rows_is_that_of_both_axes():
    system = pw.FirstOrder([[1.0, 0.1], [0.0, 1.0]])
    assert system == pw.FirstOrder.free_space(0.1)
    assert system.is_symmetric and not CROSSED.is_symmetric
    assert pw.FirstOrder(CROSSED.matrix) == CROSSED


def test_a_system_is_a_value():
    assert pickle.loads(pickle.dumps(CROSSED)) == copy.deepcopy(CROSSED) == CROSSED
    assert len({CROSSED, pw.FirstOrder.lens((0.04, -0.11), angle=0.3), LENS}) == 2
    assert eval(repr(CROSSED), {"FirstOrder": pw.FirstOrder}) == CROSSED
    assert LENS != "lens"
    with pytest.raises(AttributeError):
        LENS.matrix = np.eye(4)
    with pytest.raises(ValueError, match="read-only"):
        LENS.matrix[0, 0] = 2.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pw.FirstOrder([[1.0, 0.1], [0.2, 1.0]]), r"A\^T D - C\^T B = 1.*0\.02"),
        (lambda: pw.FirstOrder(np.diag([1.0, 2.0, 1.0, 1.0])), "symplectic"),
        (lambda: pw.FirstOrder(np.eye(4) + np.eye(4, k=3)), r"B\^T D - D\^T B = 0"),
        (lambda: pw.FirstOrder(np.eye(3)), r"\(4, 4\) or \(2, 2\), got shape \(3, 3\)"),
        (lambda: pw.FirstOrder([[math.nan, 0], [0, 1]]), "finite"),
        (lambda: pw.FirstOrder("abcd"), "got str"),
        (lambda: pw.FirstOrder.lens(0.0), "other than 0"),
        (lambda: pw.FirstOrder.lens((0.1, 0.2, 0.3)), r"\(f_x, f_y\)"),
        (lambda: pw.FirstOrder.lens("50 mm"), "f to be a focal length in m"),
        (lambda: pw.FirstOrder.lens(1e-310), "other than 0"),
        (lambda: pw.FirstOrder.magnifier(0.0), "other than 0"),
        (lambda: pw.FirstOrder.magnifier(math.inf), "magnification"),
        (lambda: pw.FirstOrder.free_space(math.inf), "distance in m"),
        (lambda: pw.FirstOrder.fourier(0.0), "other than 0"),
        (lambda: pw.FirstOrder.fractional("half", 0.1), "quarter turns"),
        (lambda: LENS.rays((1.0, 2.0, 3.0), (0.0, 0.0)), r"x of shape \(\.\.\., 2\)"),
    ],
)
def test_what_is_no_system_is_refused_in_one_sentence(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()


CASES = [("waves", name) for name in SYSTEMS] + [("outline", "all of them"), ("array", "lens")]


@pytest.mark.parametrize(("source", "system"), CASES)
def test_wigner_and_ambiguity_functions_are_constant_along_rays(source, system):
    """Lags and frequency shifts transform like positions and directions."""
    source, system = SOURCES[source], SYSTEMS[system]
    first, second = points(60, 4e-3, 2), points(60, 200.0, 3)
    places, slopes = system.rays(first, WAVELENGTH * second)
    how = {"through": system, "wavelength": WAVELENGTH}
    result = pw.wigner(source, places, slopes / WAVELENGTH, **how)
    assert np.count_nonzero(result) > 8
    assert result == pytest.approx(pw.wigner(source, first, second), abs=MAPPED * TEE.area)
    result = pw.ambiguity(source, slopes / WAVELENGTH, places, **how)
    assert np.count_nonzero(result) > 10
    assert abs(result - pw.ambiguity(source, second, first)).max() < MAPPED * TEE.area


def test_the_ambiguity_function_behind_a_system_is_the_transform_of_the_wigner_function():
    """A is the integral of W exp(-2 pi i (upsilon.x - nu.xi)), a sum over a periodic lattice."""
    slits = pw.Slits([(-1.0, 0.4), (0.7, 1.1)])
    system = pw.FirstOrder.free_space(0.3) @ pw.FirstOrder.lens(0.8)
    how = {"through": system, "wavelength": 1.0}
    # Lines of constant x are sheared, so the sum is over the coordinates of the source.
    x = np.linspace(-1.2, 1.2, 481)[:-1] + 0.0025
    nu = np.linspace(-40.0, 40.0, 1601)[:-1] + 0.025
    rays = np.stack(np.broadcast_arrays(x[:, None], nu), axis=-1)
    a, b, c, d = (block[0, 0] for block in (system.A, system.B, system.C, system.D))
    out_x, out_nu = a * rays[..., :1] + b * rays[..., 1:], c * rays[..., :1] + d * rays[..., 1:]
    w = pw.wigner(slits, out_x, out_nu, **how)
    xi, upsilon = 0.25, -0.4
    kernel = np.exp(-2j * np.pi * (upsilon * out_x - out_nu * xi))[..., 0]
    total = (w * kernel).sum() * (x[1] - x[0]) * (nu[1] - nu[0])
    # W decreases as 1/nu at some points, so the finite lattice omits some thousandths of the
    # integral.
    assert total == pytest.approx(pw.ambiguity(slits, [upsilon], [xi], **how), abs=5e-3)


def test_slits_take_what_keeps_x_and_y_apart():
    slits = pw.Slits([(-1e-3, 1e-3)])
    x, nu = np.array([[2e-4], [5e-4]]), np.array([[30.0], [-70.0]])
    flat_along_y = pw.FirstOrder.lens((0.05, math.inf))
    result = pw.wigner(slits, x, nu, through=flat_along_y, wavelength=WAVELENGTH)
    expected = pw.wigner(slits, x, nu + x / (0.05 * WAVELENGTH))
    assert result == pytest.approx(expected, abs=1e-16)
    with pytest.raises(ArgumentError, match="does not couple x and y"):
        pw.wigner(slits, x, nu, through=CROSSED, wavelength=WAVELENGTH)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"through": LENS}, "through= requires a wavelength"),
        ({"wavelength": 1e-3}, "requires an optical system"),
        ({"through": np.eye(4), "wavelength": 1e-3}, "polywigner.FirstOrder, got ndarray"),
        ({"through": LENS, "wavelength": -1.0}, "wavelength"),
    ],
)
def test_a_system_and_a_wavelength_belong_together(how, message):
    for function in (pw.wigner, pw.ambiguity):
        with pytest.raises(ArgumentError, match=message):
            function(TEE, (0.0, 0.0), (0.0, 0.0), **how)


@pytest.mark.parametrize(
    ("x", "nu", "message"),
    [
        ((0.0, 0.0), (0.0, 0.0, 0.0), r"expected nu of shape \(\.\.\., 2\)"),
        (np.zeros((3, 2)), np.zeros((4, 2)), "shapes that broadcast"),
    ],
)
def test_points_of_the_wrong_shape_are_named(x, nu, message):
    with pytest.raises(ArgumentError, match=message):
        pw.wigner(TEE, x, nu, through=SPACE, wavelength=WAVELENGTH)


def test_labelled_points_keep_their_labels_through_a_system():
    xarray = pytest.importorskip("xarray")
    x, nu = points(3, 3e-3, 10), points(4, 90.0, 11)
    how = {"through": CROSSED @ SPACE, "wavelength": WAVELENGTH}
    labelled = (
        xarray.DataArray(x, dims=("place", "xy"), coords={"place": list("abc")}),
        xarray.DataArray(nu, dims=("frequency", "xy")),
    )
    result = pw.wigner(TEE, *labelled, **how)
    assert result.dims == ("place", "frequency") and list(result.place.values) == list("abc")
    assert np.array_equal(result.values, pw.wigner(TEE, x[:, None], nu, **how))
    lazy = pw.wigner(TEE, *(value.chunk() for value in labelled), **how)
    assert np.array_equal(lazy.values, result.values)


@pytest.mark.llvm
def test_compiled_points_go_through_systems_and_have_derivatives(llvm):
    import drjit as dr
    from drjit.llvm.ad import Array2f64, TensorXf64

    x, nu = points(5, 4e-3, 12), points(5, 100.0, 13)
    how = {"through": SYSTEMS["all of them"], "wavelength": WAVELENGTH}
    expected = pw.wigner(TEE, x, nu, **how)
    position = Array2f64(*x.T)
    dr.enable_grad(position)
    result = pw.wigner(TEE, position, nu, **how)
    assert result.numpy() == pytest.approx(expected, abs=MAPPED * TEE.area)
    dr.backward(dr.sum(result))
    step = 1e-8
    slopes = [
        (pw.wigner(TEE, x + e, nu, **how) - pw.wigner(TEE, x - e, nu, **how)) / (2 * step)
        for e in step * np.eye(2)
    ]
    assert dr.grad(position).numpy() == pytest.approx(np.array(slopes), rel=1e-5, abs=1e-8)
    tensor = pw.wigner(TEE, TensorXf64(x[:, None]), TensorXf64(nu), **how)
    outer = pw.wigner(TEE, x[:, None], nu, **how)
    assert tensor.numpy() == pytest.approx(outer, abs=MAPPED * TEE.area)
    lags = pw.ambiguity(TEE, Array2f64(*nu.T), position, **how)
    assert lags.numpy() == pytest.approx(pw.ambiguity(TEE, nu, x, **how), abs=MAPPED * TEE.area)
