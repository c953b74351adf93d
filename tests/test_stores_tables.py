"""Tables of W and A over four coordinates: in memory, on disk, on a cluster, killed, taken up."""

import pickle

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, StoreError
from stored import hashes

_EXTRA = "the extra `volume` is not installed"
for _library in ("xarray", "zarr", "dask", "distributed"):
    pytest.importorskip(_library, reason=_EXTRA)

CHEVRON = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
# Four million samples are sums of float32 (5e-6 of the area, docs/accuracy).
SINGLE = 5e-6 * CHEVRON.area


def test_a_table_holds_the_function_at_every_point_of_its_grid(tmp_path):
    x, nu = np.linspace(-0.01, 0.01, 7), np.linspace(-300.0, 500.0, 6)
    table = pw.wigner_table(CHEVRON, x, x[:5] / 2, nu, nu[1:], tmp_path / "w.zarr", engine="numpy")
    assert table["W"].dims == ("x", "y", "nu_x", "nu_y")
    assert table["W"].attrs["units"] == "m2"
    assert {name: table[name].attrs["units"] for name in table.dims} == {
        "x": "m",
        "y": "m",
        "nu_x": "1/m",
        "nu_y": "1/m",
    }
    for index in ((0, 0, 0, 0), (3, 2, 1, 4), (6, 4, 5, 0), (4, 1, 2, 3)):
        place = {name: float(table[name][i]) for name, i in zip(table.dims, index, strict=True)}
        exact = pw.wigner(CHEVRON, (place["x"], place["y"]), (place["nu_x"], place["nu_y"]))
        assert abs(float(table["W"][index]) - exact) < SINGLE
    source = CHEVRON.with_illumination(pw.steering((0.48, 0.36, 0.8), 3.2e-3))
    table = pw.ambiguity_table(source, nu, nu[1:], x, x[2:], tmp_path / "a.zarr", engine="numpy")
    assert table["A"].dims == ("upsilon_x", "upsilon_y", "xi_x", "xi_y")
    assert table["A"].dtype == np.complex64
    for i in ((0, 0, 0, 0), (1, 3, 2, 0), (4, 2, 1, 1), (3, 1, 4, 3)):
        exact = pw.ambiguity(source, (nu[i[0]], nu[1 + i[1]]), (x[i[2]], x[2 + i[3]]))
        assert abs(complex(table["A"][i]) - exact) < SINGLE


def test_a_table_on_disk_is_that_in_memory_bit_by_bit(tmp_path, llvm):
    x, nu = np.linspace(-0.01, 0.01, 20), np.linspace(-500.0, 500.0, 21)
    arguments = (CHEVRON, x, x[3:], nu, nu[5:])
    stored = pw.wigner_table(*arguments, tmp_path / "w.zarr", chunks={"y": 7}, engine="llvm")
    assert stored["W"].chunks[1] == (7, 7, 3)
    held = pw.wigner_table(*arguments, engine="llvm")
    np.testing.assert_array_equal(stored["W"], held["W"])
    assert stored["W"].attrs == held["W"].attrs


def test_how_many_threads_compute_makes_no_difference(tmp_path, llvm):
    import drjit

    before, found = drjit.thread_count(), []
    x, nu = np.linspace(-0.01, 0.01, 8), np.linspace(-500.0, 500.0, 9)
    for threads in (1, None):
        out, how = tmp_path / f"{threads}.zarr", {"threads": threads, "chunks": {"x": 3}}
        pw.wigner_table(CHEVRON, x, x, nu, nu, out, engine="llvm", **how)
        found.append(hashes(out))
    assert found[0] == found[1]
    assert drjit.thread_count() == before


@pytest.mark.parametrize(
    "source",
    [
        CHEVRON,
        CHEVRON.with_illumination(pw.steering((0.48, 0.36, 0.8), 3.2e-3)),
        pw.Array([CHEVRON, pw.shapes.square(5e-3)], weights=[1, 1j]),
        pw.phased_array(pw.shapes.square(4e-3), np.argwhere(np.ones((20, 20))) * 5e-3),
    ],
)
def test_sources_go_to_other_processes_without_what_they_have_cached(source):
    fresh = len(pickle.dumps(source))
    x, nu = np.random.default_rng(0).random((2, 50, 2))
    pw.wigner(source, x, nu, engine="numpy")
    for element in source.elements if isinstance(source, pw.Array) else (source,):
        _ = element.diameter, element.convex_cover, element.polygons, hash(element)
    again = pickle.dumps(source)
    assert len(again) == fresh
    copy = pickle.loads(again)
    assert copy == source
    np.testing.assert_array_equal(pw.wigner(copy, x, nu), pw.wigner(source, x, nu))


def test_another_source_or_engine_is_another_table(tmp_path, llvm):
    x, nu, out = np.linspace(-0.01, 0.01, 5), np.linspace(-500.0, 500.0, 5), tmp_path / "w.zarr"
    pw.wigner_table(CHEVRON, x, x, nu, nu, out, engine="numpy")
    with pytest.raises(StoreError, match="differs in source"):
        pw.wigner_table(pw.shapes.square(5e-3), x, x, nu, nu, out, engine="numpy")
    with pytest.raises(StoreError, match="differs in engine 'llvm'"):
        pw.wigner_table(CHEVRON, x, x, nu, nu, out, engine="llvm")


X = np.linspace(-0.01, 0.01, 5)


@pytest.mark.parametrize(
    ("arguments", "keywords", "expected"),
    [
        ((CHEVRON, X, X, X, [[0.0]]), {}, r"expected nu_y as finite numbers of shape \(n,\)"),
        ((CHEVRON, X, X, [np.nan], X), {}, "expected nu_x as finite"),
        ((pw.Slits([(0, 1)]), X, X, X, X), {}, "two coordinates only"),
        ((CHEVRON, X, X, X, X), {"scheduler": "tcp://a:1"}, "expected out with scheduler"),
        ((CHEVRON, X, X, X, X), {"chunks": {"x": 2}}, "expected out with chunks"),
        ((CHEVRON, X, X, X, X), {"precision": "half"}, "expected precision"),
        (
            (CHEVRON, X, X, X, X, "w"),
            {"chunks": {"z": 2}},
            "expected chunks as samples along some of x, y, nu_x",
        ),
        ((CHEVRON, X, X, X, X, "w"), {"chunks": {"x": 0}}, "expected chunks along x as a whole"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, monkeypatch, arguments, keywords, expected):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=expected):
        pw.wigner_table(*arguments, **keywords)
    assert not list(tmp_path.iterdir())


def test_more_than_memory_is_refused_with_the_way_out():
    axis = np.linspace(0.0, 1.0, 1000)
    with pytest.raises(ArgumentError, match="write them to disk with out"):
        pw.wigner_table(CHEVRON, axis, axis, axis, axis)
