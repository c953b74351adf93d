"""Datasets of fields on lines, planes and hemispheres and in volumes."""

import math
import pickle
from typing import Any

import numpy as np
import pytest
import xarray
from dask.callbacks import Callback

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError

WAVELENGTH = 299792458 / 94e9
SQUARE = pw.shapes.square(10e-3)
CHEVRONS = pw.shapes.chevron_pair(6e-3, 5e-3, 2e-3)
BOX = ((-20e-3, -15e-3, 30e-3), (10e-3, 15e-3, 60e-3))
SHAPE = (4, 3, 5)

# Rounding error of the same sums in another order.
ROUNDING = 1e-12


def _points(result):
    """Return the points (..., 3) of a dataset."""
    variable = next(iter(result.data_vars.values()))
    parts = [result[name].broadcast_like(variable).transpose(*variable.dims) for name in "xyz"]
    return np.stack([part.values for part in parts], axis=-1)


def _builders(**options):
    corners = ((-10e-3, 0, 30e-3), (10e-3, 0, 30e-3), (-10e-3, 5e-3, 50e-3))
    flat = ((-5e-3, 2e-3, 30e-3), (5e-3, 2e-3, 60e-3))
    return {
        "line": lambda: pw.line(CHEVRONS, BOX, 5, WAVELENGTH, **options),
        "plane": lambda: pw.plane(CHEVRONS, flat, (3, 4), WAVELENGTH, **options),
        "tilted plane": lambda: pw.plane(CHEVRONS, corners, (3, 4), WAVELENGTH, **options),
        "hemisphere": lambda: pw.hemisphere(
            CHEVRONS, 50e-3, [-0.9, 0.0, 0.4], [0.0, 1.0], WAVELENGTH, **options
        ),
        "volume": lambda: pw.volume(CHEVRONS, BOX, SHAPE, WAVELENGTH, dtype="float64", **options),
    }


@pytest.mark.parametrize("name", ["line", "hemisphere", "volume"])
def test_values_are_those_of_irradiance_and_amplitude_at_the_points(name):
    methods = ("wigner", "kirchhoff", "fraunhofer")
    result = _builders(method=methods)[name]()
    assert tuple(result.data_vars) == methods
    points = _points(result)
    for method in methods:
        expected = pw.irradiance(CHEVRONS, points, WAVELENGTH, method)
        assert result[method].values == pytest.approx(expected, rel=ROUNDING)
    field = _builders(method="kirchhoff", quantity="amplitude")[name]()["kirchhoff"]
    expected = pw.amplitude(CHEVRONS, points, WAVELENGTH, "kirchhoff")
    assert field.values == pytest.approx(expected, rel=ROUNDING)
    phase = _builders(method="kirchhoff", quantity="phase")[name]()["kirchhoff"]
    assert phase.values == pytest.approx(np.angle(expected), abs=ROUNDING)
    assert result["kirchhoff"].values == pytest.approx(np.abs(expected) ** 2, rel=1e-6)


def test_every_grid_knows_where_its_points_are():
    builders = _builders(method="fraunhofer")
    line = builders["line"]()
    assert dict(line.sizes) == {"distance": 5}
    assert line["distance"].values[-1] == pytest.approx(np.linalg.norm(np.subtract(*BOX)))
    assert _points(line)[[0, -1]] == pytest.approx(np.array(BOX))
    plane = builders["plane"]()
    assert dict(plane.sizes) == {"x": 3, "z": 4}
    assert float(plane["y"]) == 2e-3
    tilted = builders["tilted plane"]()
    assert dict(tilted.sizes) == {"u": 3, "v": 4}
    assert _points(tilted)[2, 0] == pytest.approx([10e-3, 0, 30e-3])
    assert _points(tilted)[0, 3] == pytest.approx([-10e-3, 5e-3, 50e-3])
    sphere = builders["hemisphere"]()
    assert np.linalg.norm(_points(sphere), axis=-1) == pytest.approx(np.full((3, 2), 50e-3))
    assert sphere["x"].values[0, 0] < 0 < sphere["x"].values[2, 0]
    volume = builders["volume"]()
    assert dict(volume.sizes) == {"x": 4, "y": 3, "z": 5}
    assert volume["x"].values[[0, -1]] == pytest.approx([-20e-3, 10e-3])


def test_a_dataset_describes_its_source_in_a_line_and_gives_it_back(tmp_path):
    """The description has one line for each axis, variable and attribute, and five more lines."""
    field = CHEVRONS.with_illumination(pw.steering((0.6, 0, 0.8), WAVELENGTH))
    computed = pw.line(field, BOX, 3, WAVELENGTH, method=("wigner", "kirchhoff"))
    assert computed["wigner"].attrs["units"] == "W m-2"
    assert computed["wigner"].attrs["obliquity"] == "rayleigh-sommerfeld-1"
    assert "obliquity" not in computed["kirchhoff"].attrs
    assert computed["distance"].attrs["units"] == "m"
    assert computed["wigner"].attrs["polywigner_version"] == pw.__version__
    assert computed.attrs == {
        "wavelength": WAVELENGTH, "frequency": pw.SPEED_OF_LIGHT / WAVELENGTH, "source": repr(field)
    }  # fmt: skip
    pattern = pw.radiation_pattern(field, WAVELENGTH, [0.0, 0.1], [0.0])
    for result, lines in ((computed, 15), (pattern, 24)):
        assert pw.read_source(result) == field
        assert "source_json" not in result.data_vars
        assert len(repr(result).splitlines()) <= lines
    for write in (lambda path: computed.to_netcdf(path, engine="h5netcdf"),
                  lambda path: pw.write_netcdf(computed, path)):  # fmt: skip
        write(tmp_path / "line.nc")
        with xarray.open_dataset(tmp_path / "line.nc", engine="h5netcdf") as read:
            assert read.identical(computed) and pw.read_source(read) == field


def test_a_source_of_many_vertices_is_described_in_a_line_and_given_back():
    spots = [pw.shapes.disc(1e-3, 200).moved((4e-3 * k, 0)) for k in range(9)]
    source = pw.Array(spots)
    result = pw.line(source, BOX, 2, WAVELENGTH, method="fraunhofer")
    assert len(result.attrs["source"]) <= 200
    assert pw.read_source(result) == source
    with pytest.raises(FileFormatError, match="source_json, got a dataset without"):
        pw.read_source(result.drop_vars("source_json"))


def test_a_lazy_volume_computes_only_what_is_asked_for():
    tasks: list[Any] = []
    eager = pw.volume(CHEVRONS, BOX, SHAPE, WAVELENGTH, method="kirchhoff")
    with Callback(posttask=lambda key, *_: tasks.append(key)):
        lazy = pw.volume(CHEVRONS, BOX, SHAPE, WAVELENGTH, method="kirchhoff", chunks=2)
        assert not tasks
        assert lazy["kirchhoff"].chunks == ((2, 2), (2, 1), (2, 2, 1))
        part = lazy["kirchhoff"][3, 2, :2].values
        assert len(tasks) <= 2  # one of 12 blocks, and one task for the result
    assert part == pytest.approx(eager["kirchhoff"].values[3, 2, :2], rel=1e-6)
    assert lazy["kirchhoff"].values == pytest.approx(eager["kirchhoff"].values, rel=1e-6)
    assert lazy["kirchhoff"].dtype == eager["kirchhoff"].dtype == np.float32


def test_a_lazy_volume_can_be_sent_to_another_process():
    lazy = pw.volume(CHEVRONS, BOX, SHAPE, WAVELENGTH, method="fraunhofer", chunks=2)
    assert pickle.loads(pickle.dumps(lazy)).compute().identical(lazy.compute())


def test_a_bar_is_drawn_on_request_and_never_into_a_pipe(capfd, monkeypatch):
    builders = _builders(method="fraunhofer")
    builders["volume"]()
    assert capfd.readouterr() == ("", "")
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("TERM", "xterm")
    _builders(method="fraunhofer", progress=True)["volume"]()
    drawn = capfd.readouterr().err
    assert "fraunhofer" in drawn
    assert drawn.endswith("\x1b[1A\x1b[2K")  # the bar is erased


REFUSED: dict[str, tuple[Any, str]] = {
    "behind": (lambda: pw.volume(SQUARE, ((0, 0, -1), (1, 1, 1)), (2, 2, 2), 1.0), "z > 0"),
    "no points": (lambda: pw.volume(SQUARE, BOX, (2, 2, 0), 1.0), "from 1 to"),
    "a thick plane": (lambda: pw.plane(SQUARE, BOX, (2, 2), 1.0), "zero thickness"),
    "a rhombus": (
        lambda: pw.plane(SQUARE, ((0, 0, 1), (1, 0, 1), (1, 1, 1)), (2, 2), 1.0),
        "perpendicular",
    ),
    "a point": (lambda: pw.line(SQUARE, ((0, 0, 1), (0, 0, 1)), 2, 1.0), "twice"),
    "the horizon": (lambda: pw.hemisphere(SQUARE, 1.0, math.pi / 2, 0.0, 1.0), "z > 0"),
    "a method": (lambda: pw.line(SQUARE, BOX, 2, 1.0, method="bpm"), "kirchhoff"),
    "a ray's phase": (lambda: pw.line(SQUARE, BOX, 2, 1.0, quantity="phase"), "no phase"),
    "an option": (lambda: pw.line(SQUARE, BOX, 2, 1.0, methods="wigner"), "one of the options"),
    "chunks": (lambda: pw.volume(SQUARE, BOX, SHAPE, 1.0, chunks=(1, 2)), "chunks"),
    "more than memory": (lambda: pw.volume(SQUARE, BOX, (2000, 2000, 2000), 1.0), "chunks"),
    "a cluster without a disk": (
        lambda: pw.volume(SQUARE, BOX, SHAPE, 1.0, scheduler="tcp://x"),
        "require out: expected the path of a store",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_place_or_method_is_refused_in_words(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, words = REFUSED[name]
    with pytest.raises(ArgumentError, match=words) as caught:
        call()
    assert "expected" in str(caught.value) and "got" in str(caught.value)
    assert not list(tmp_path.iterdir())
