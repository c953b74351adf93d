"""Files of ``polywigner radar``."""

from pathlib import Path

import pytest

from polywigner.cli import main

pytestmark = [pytest.mark.drjit, pytest.mark.llvm]
xarray = pytest.importorskip("xarray")
pytest.importorskip("mitsuba")

SCENE = str(Path(__file__).parents[1] / "examples" / "radar_77ghz" / "radar.xml")
WAVEFORM = "76.85 GHz + 300 MHz, 128 samples at 5 MHz, 8 chirps every 60 us"


@pytest.mark.usefixtures("unrendered_figures", "few_batches")
def test_the_command_writes_the_cube_and_both_maps(tmp_path, capsys):
    out = tmp_path / "street"
    options = ("--velocity", "car = -8, 0, 0", "--elements", "--points", "500", "--out", str(out))
    assert main(["radar", SCENE, "--waveform", WAVEFORM, *options]) == 0
    printed = capsys.readouterr().out
    assert "receivers: 12, emitters: 1, 500 scatterers" in printed
    with xarray.open_dataset(tmp_path / "street.nc", engine="h5netcdf") as cube:
        assert dict(cube.sizes)["receiver"] == 12 and cube.attrs["chirps"] == 8
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["street.nc", "street_angle.png", "street_rate.png"]


@pytest.mark.usefixtures("unrendered_figures", "few_batches")
def test_zarr_replaces_an_earlier_store(tmp_path):
    for chirps in ("8 chirps", "4 chirps"):
        out = ("--points", "50", "--zarr", "--out", str(tmp_path / "street"))
        waveform = WAVEFORM.replace("8 chirps", chirps)
        assert main(["radar", SCENE, "--waveform", waveform, *out]) == 0
    with xarray.open_zarr(tmp_path / "street.zarr", consolidated=False) as cube:
        assert cube["signal"].shape == (1, 1, 1, 4, 128) and cube["signal"].dtype == complex
