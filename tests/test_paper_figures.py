"""``polywigner figures``: the numbers behind figures are those of the public functions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.cli import main
from polywigner.figures.paper import FIGURES
from polywigner.figures.paper.sampling import POSITION, dense_samples
from polywigner.figures.paper.sources import WAVELENGTH, chevrons, triangle, triangles

Values = dict[str, np.ndarray]

# Of values that are computed in another way or order than those in the file.
ROUNDING = 1e-12


def frequencies(axis: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(axis, axis), axis=-1)


def shape(values: Values, name: str) -> Any:
    return shapely.from_geojson(str(values[name]))


def check_amp_spec(values: Values) -> None:
    """The transform is that of both chevrons together, each by itself from its own edges."""
    assert values["frequency"][-1] == 1 / WAVELENGTH
    nu = frequencies(values["frequency"])[::8, ::8]
    parts = [pw.fourier(pw.Aperture(part), nu) for part in chevrons().polygons.geoms]
    apart = np.abs(values["fourier"][::8, ::8] - sum(parts)).max()
    assert apart < ROUNDING * chevrons().area


def check_indmk(values: Values) -> None:
    """The automean is where the position marginal is not zero; it lies inside the hull."""
    elements, automean, hull = (shape(values, name) for name in ("elements", "automean", "hull"))
    assert elements.equals(triangles().polygons)
    xmin, ymin, xmax, ymax = hull.bounds
    places = np.random.default_rng(1).uniform((xmin, ymin), (xmax, ymax), (2000, 2))
    inside = shapely.contains_xy(automean, places)
    assert np.array_equal(inside, pw.position_marginal(triangles(), places) > 0)
    assert values["areas"][0] < values["areas"][1] < values["areas"][2]
    assert automean.difference(hull).area < ROUNDING * hull.area


def check_marginals(values: Values) -> None:
    """Both integrate to the square of the area: a sum over samples does to their distance."""
    for name, x, y in (("position", "x", "y"), ("lag", "xi_x", "xi_y")):
        cell = (values[x][1] - values[x][0]) * (values[y][1] - values[y][0])
        total = values[f"{name}_marginal"].sum() * cell
        assert total == pytest.approx(triangles().area ** 2, rel=1e-3)


def check_xforms(values: Values) -> None:
    """Slices are overlaps of the two outlines drawn; their areas are the marginals."""
    for first, second, found, area in (
        ("doubled", "mirrored", "lag_slice", pw.position_marginal(triangle(), values["x"])),
        ("behind", "ahead", "position_slice", pw.lag_marginal(triangle(), values["xi"])),
    ):
        overlap = shape(values, first).intersection(shape(values, second))
        assert shape(values, found).symmetric_difference(overlap).area < ROUNDING * area
        assert shape(values, found).area == pytest.approx(area, rel=ROUNDING)


def check_projs(values: Values) -> None:
    """Diagonal tiles are known: R_x, |F|^2, and for A the product of two transforms."""
    x = np.stack(np.meshgrid(values["x"], values["y"], indexing="ij"), axis=-1)
    close(values["autocorrelation_x_y"], pw.position_marginal(chevrons(), x))
    nu = np.stack(np.meshgrid(values["nu_x"], values["nu_y"], indexing="ij"), axis=-1)
    close(values["wigner_nu_x_nu_y"], np.abs(pw.fourier(chevrons(), nu)) ** 2)
    half = np.stack(np.meshgrid(values["upsilon_x"], values["upsilon_y"], indexing="ij"), -1) / 2
    product = pw.fourier(chevrons(), half) * pw.fourier(chevrons(), -half).conj()
    close(values["ambiguity_upsilon_x_upsilon_y"], product)


def close(found: np.ndarray, expected: np.ndarray) -> None:
    assert np.abs(found - expected).max() < ROUNDING * np.abs(expected).max()


def check_sampling(values: Values) -> None:
    """The paper's own count; and grids get better with their number of cells, to first order."""
    assert dense_samples(10e-3, WAVELENGTH, 2) == 4096
    assert tuple(values["x"]) == POSITION
    finer = values["error"] * values["cells"]
    assert values["error"][-1] < 0.01 < 0.5 < values["error"][0]
    assert finer[-1] < finer[0]


def check_appendix(values: Values) -> None:
    """At zero the transform is the area; the circle's is Airy's to what its 64 corners leave."""
    from scipy.special import j1

    middle = len(values["nu_x"]) // 2
    assert values["rectangle"][middle, middle] == pytest.approx(12e-3 * 8e-3, rel=ROUNDING)
    nu = values["nu_x"][values["nu_x"] > 0]
    airy = 5e-3 * j1(2 * np.pi * nu * 5e-3) / nu
    assert np.abs(values["circle"][middle, middle + 1 :] - airy).max() < 1e-3 * np.pi * 5e-3**2
    slit = 10e-3 * np.sinc(values["nu"] * 10e-3)
    assert np.abs(values["single_slit_1D"] - slit).max() < ROUNDING * 10e-3


CHECKS: dict[str, Callable[[Values], None]] = {
    "amp_spec": check_amp_spec,
    "indmk": check_indmk,
    "marginals": check_marginals,
    "xforms": check_xforms,
    "projs": check_projs,
    "sampling": check_sampling,
    "appendix": check_appendix,
}


def test_every_figure_is_checked() -> None:
    assert set(CHECKS) == set(FIGURES)


@pytest.mark.parametrize("name", FIGURES)
def test_the_numbers_behind_a_figure_are_those_of_the_public_functions(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["figures", name, "--out", str(tmp_path / "new")]) == 0
    written = [Path(line) for line in capfd.readouterr().out.splitlines()]
    assert sorted((tmp_path / "new").iterdir()) == sorted(written)
    assert {path.suffix for path in written} == {".png", ".pdf", ".npz"}
    assert len(written) == 2 * len(FIGURES[name].parts) + 1
    with np.load(written[-1]) as file:  # without pickle: plain arrays only
        values = dict(file)
    metadata = json.loads(str(values.pop("metadata")))
    assert set(metadata["about"]) == set(values)
    CHECKS[name](values)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["amp_spec", "nosuch"], "got 'nosuch'"),
        (["amp_spec", "--quality", "best"], "got 'best'"),
        (["amp_spec", "--out", ""], "got nothing"),
        (["amp_spec", "--out", "taken"], "got the file taken"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_written(
    words: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()
    assert main(["figures", *words]) == 2
    captured = capfd.readouterr()
    assert told in captured.err and captured.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
