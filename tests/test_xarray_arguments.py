"""Labelled arrays: names, coordinates, laziness and values of results."""

import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

xarray = pytest.importorskip("xarray", reason="the extra datasets is not installed")
pytest.importorskip("dask", reason="the extra datasets is not installed")

WAVELENGTH = 3e-3
SQUARE = pw.shapes.square(10e-3)
SLIT = pw.shapes.slit(1e-3)
CUBE = pw.Polyhedron(
    [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
)
ROW = pw.phased_array(SQUARE, [(0.0, 0.0), (12e-3, 0.0)], [1.0, 1j])

_RANDOM = np.random.default_rng(5)


def _named(values, *dims):
    """Return an array with labels along each dimension, including the components."""
    array = xarray.DataArray(values, dims=dims)
    labels = {d: (d, 10.0 + np.arange(n), {"units": "m"}) for d, n in array.sizes.items()}
    return array.assign_coords({**labels, "scalar": 7})


def _points(dimension, size, *counts):
    return size * (_RANDOM.random((*counts, dimension)) - 0.5)


def _directions(*counts):
    vectors = _RANDOM.random((*counts, 3)) + 0.2
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


X, NU = _points(2, 12e-3, 3), _points(2, 400.0, 4, 5)
IN_FRONT = np.array([0.0, 0.0, 0.3]) + _points(3, 0.1, 3)

# Test case: function of points, values of the points, and unit of the result.
Case = tuple[Callable[..., Any], tuple[Any, ...], str]
CASES: dict[str, Case] = {
    "fourier": (lambda nu: pw.fourier(SQUARE, nu), (NU,), "m2"),
    "fourier of a slit": (lambda nu: pw.fourier(SLIT, nu), (_points(1, 1e4, 4),), "m"),
    "fourier of a body": (lambda nu: pw.fourier(CUBE, nu), (_points(3, 3.0, 4),), "m3"),
    "array_factor": (lambda nu: pw.array_factor(X, None, nu), (NU,), "1"),
    "autocorrelation": (lambda x, xi: pw.autocorrelation(SQUARE, x, xi), (X, X / 3), "1"),
    "wigner": (lambda x, nu: pw.wigner(SQUARE, x, nu), (X, NU), "m2"),
    "ambiguity": (lambda upsilon, xi: pw.ambiguity(ROW, upsilon, xi), (NU, X), "m2"),
    "position_marginal": (lambda x: pw.position_marginal(SQUARE, x), (X,), "m2"),
    "lag_marginal": (lambda xi: pw.lag_marginal(SQUARE, xi), (X,), "m2"),
    "otf": (lambda xi: pw.otf(SQUARE, xi, 0.5), (X,), "1"),
    "mtf": (lambda f: pw.mtf(SQUARE, f, 5e-7, 0.1), (NU,), "1"),
    "radiance": (
        lambda x, s: pw.radiance(SQUARE, x, s, WAVELENGTH), (X, _directions(4)), "W m-2 sr-1"
    ),
    "radiant_intensity": (
        lambda s: pw.radiant_intensity(SQUARE, s, frequency=1e11), (_directions(2, 4),), "W sr-1"
    ),
    "amplitude": (lambda p: pw.amplitude(SQUARE, p, WAVELENGTH), (IN_FRONT,), "W0.5 m-1"),
    "irradiance": (lambda p: pw.irradiance(SQUARE, p, WAVELENGTH, "auto"), (IN_FRONT,), "W m-2"),
}  # fmt: skip


def _as_labelled(values):
    """Return labelled arguments over separate dimensions, and equivalent NumPy arrays."""
    names = iter(("time", "place", "shot", "run"))
    dims = [[next(names) for _ in range(v.ndim - 1)] for v in values]
    labelled = tuple(_named(v, *d, "component") for v, d in zip(values, dims, strict=True))
    after = [sum(map(len, dims[k + 1 :])) for k in range(len(dims))]
    plain = tuple(
        v.reshape(*v.shape[:-1], *(1,) * n, v.shape[-1]) for v, n in zip(values, after, strict=True)
    )
    return labelled, plain


@pytest.mark.parametrize("name", CASES)
def test_dimensions_and_coordinates_are_kept_and_values_are_those_of_numpy(name):
    function, values, units = CASES[name]
    labelled, plain = _as_labelled(values)
    result, expected = function(*labelled), function(*plain)
    assert isinstance(result, xarray.DataArray)
    assert result.dims == tuple(d for v in labelled for d in v.dims[:-1])
    np.testing.assert_array_equal(result.values, expected)
    assert result.dtype == expected.dtype
    assert set(result.coords) == {*result.dims, "scalar"}
    for array in labelled:
        for dim in array.dims[:-1]:
            assert result[dim].identical(array[dim].drop_vars("component", errors="ignore"))
    assert result.attrs["units"] == units
    assert result.attrs["long_name"]
    assert result.name == name.split()[0]


@pytest.mark.parametrize("name", ["fourier of a body", "ambiguity", "radiance", "irradiance"])
def test_a_lazy_argument_stays_lazy_and_computes_the_same(name):
    function, values, _ = CASES[name]
    labelled, _ = _as_labelled(values)
    eager = function(*labelled)
    chunked = [labelled[0].chunk({labelled[0].dims[0]: 2, "component": 1}), *labelled[1:]]
    lazy = function(*chunked)
    assert lazy.chunks is not None
    assert lazy.dtype == eager.dtype
    assert lazy.chunksizes[eager.dims[0]][0] == 2
    # The results differ by rounding, because sums over blocks have another order.
    np.testing.assert_allclose(lazy.values, eager.values, rtol=1e-12, atol=1e-12 * abs(eager).max())
    assert lazy.compute().attrs == eager.attrs


def test_dimensions_of_one_name_go_together():
    x, nu = _named(X, "ray", "xy"), _named(NU[0, :3], "ray", "frequency")
    result = pw.wigner(SQUARE, x, nu)
    assert result.dims == ("ray",)
    np.testing.assert_array_equal(result.values, pw.wigner(SQUARE, X, NU[0, :3]))


def test_one_point_may_stand_beside_a_labelled_array():
    for origin in ((0.0, 0.0), np.zeros(2)):
        result = pw.wigner(SQUARE, origin, _named(NU, "i", "j", "k"))
        np.testing.assert_array_equal(result.values, pw.wigner(SQUARE, (0.0, 0.0), NU))
    assert pw.fourier(SQUARE, _named(NU[0, 0], "k")).dims == ()


@pytest.mark.parametrize("chunks", [None, {"place": 2}])
def test_the_flux_vector_has_a_dimension_for_its_components(chunks):
    x = _named(X, "place", "component")
    result = pw.flux_vector(SQUARE, x if chunks is None else x.chunk(chunks), WAVELENGTH)
    assert result.dims == ("place", "flux_component")
    assert list(result["flux_component"].values) == ["x", "y", "z"]
    assert result.attrs["units"] == "W m-2"
    expected = pw.flux_vector(SQUARE, X, WAVELENGTH)
    np.testing.assert_allclose(result.values, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("chunks", [None, {"place": 2}])
def test_estimated_errors_are_labelled_too(chunks):
    points = _named(IN_FRONT, "place", "xyz")
    points = points if chunks is None else points.chunk(chunks)
    result = pw.amplitude_with_error(SQUARE, points, WAVELENGTH)
    expected = pw.amplitude_with_error(SQUARE, IN_FRONT, WAVELENGTH)
    for array, values in zip(result, expected, strict=True):
        assert array.dims == ("place",)
        np.testing.assert_allclose(array.values, values, rtol=1e-9, atol=1e-15)
    assert result[1].name == "error"
    assert "error" in result[1].attrs["long_name"]


def test_a_lazy_result_can_be_sent_to_another_process():
    lazy = pw.radiance(SQUARE, _named(X, "place", "c").chunk(place=2), (0, 0, 1), WAVELENGTH)
    there = pickle.loads(pickle.dumps(lazy))
    np.testing.assert_array_equal(there.values, lazy.values)


NAMED = _named(X, "place", "component")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: pw.wigner(SQUARE, NAMED, NU), "expected nu to be an xarray.DataArray like"),
        (lambda: pw.wigner(SQUARE, NAMED, _named(NU, "place", "b", "c")), "equal coordinates"),
        (
            lambda: pw.wigner(SQUARE, NAMED, NAMED.assign_coords(place=[1, 2, 3])),
            "expected x and nu with equal coordinates",
        ),
        (lambda: pw.fourier(SQUARE, xarray.DataArray(1.0)), "along the last dimension"),
        (lambda: pw.fourier("square", NAMED.chunk()), "expected a source"),
        (
            lambda: pw.radiance(SQUARE, NAMED.chunk(), (0, 0, 2.0), 3e-3).compute(),
            "direction to be unit vectors",
        ),
    ],
)
def test_errors_are_those_of_the_package(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()


@pytest.mark.drjit
def test_labelled_points_of_a_differentiable_source_are_refused(llvm):
    import drjit as dr
    from drjit.llvm.ad import Float, TensorXf64  # noqa: F401

    vertices = TensorXf64(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
    dr.enable_grad(vertices)
    source = pw.differentiable(pw.Aperture([(0, 0), (1, 0), (0, 1)]), vertices=vertices)
    with pytest.raises(ArgumentError, match=r"use its attribute \.values"):
        pw.fourier(source, NAMED)


def test_xarray_is_not_imported_by_the_transforms():
    code = (
        "import sys, polywigner as pw; pw.wigner(pw.shapes.square(1.0), (0, 0), (0, 0)); "
        "pw.amplitude(pw.shapes.square(1.0), (0, 0, 1.0), 1.0); sys.exit('xarray' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
