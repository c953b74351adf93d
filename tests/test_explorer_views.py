"""States, views and files of the explorer without a browser."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, GeometryError
from polywigner.explorer import start_state
from polywigner.explorer.state import (
    CATALOGUE,
    History,
    State,
    geojson,
    read_upload,
    rings_of,
    source_of,
    with_vertex,
)
from polywigner.explorer.views import VIEWS, compute_view, npz, snippet

SQUARE = State(rings=rings_of(CATALOGUE["square"]()), wave="3 mm")
FED = replace(SQUARE, taper="cosine", theta=20.0, columns=2, pitch=12.0)


def test_a_drag_is_one_step_that_undo_takes_back():
    history, widths = History(SQUARE), []
    for width in (8.0, 7.0, 6.0):
        history.add(SQUARE.with_width(width), "drag")
    history.move(0)
    history.add(SQUARE.with_width(5.0), "drag")
    for steps in (0, -1, -1, -1, 1):
        history.move(steps)
        widths.append(history.present.box[2] * 2)
    assert widths == [5.0, 6.0, 10.0, 10.0, 6.0]


def test_a_vertex_is_inserted_into_the_nearest_edge():
    (ring,) = with_vertex(SQUARE.rings, (0.5, 6.0))
    assert len(ring) == 5
    k = ring.index((0.5, 6.0))
    assert {ring[k - 1], ring[(k + 1) % 5]} == {(-5.0, 5.0), (5.0, 5.0)}


def test_an_outline_inside_another_is_a_hole():
    inner = tuple((x / 2, y / 2) for x, y in SQUARE.rings[0])
    assert source_of(replace(SQUARE, rings=(*SQUARE.rings, inner))).area == pytest.approx(75e-6)


@pytest.mark.parametrize(
    ("state", "error"),
    [
        (replace(SQUARE, rings=(((0, 0), (1, 1), (1, 0), (0, 1)),)), GeometryError),
        (replace(SQUARE, rings=()), GeometryError),
        (replace(SQUARE, columns=100, rows=100), ArgumentError),
    ],
    ids=["self-intersection", "empty sheet", "large array"],
)
def test_a_state_that_cannot_be_computed_raises_one_error(state, error):
    with pytest.raises(error):
        compute_view(state, "wigner_nu", 8)


def test_a_wave_that_is_no_quantity_is_refused():
    with pytest.raises(ArgumentError, match="94 GHz"):
        State(wave="blue")


def test_the_views_of_a_square_have_its_closed_forms():
    side, samples = 10e-3, 33
    fourier = compute_view(SQUARE, "fourier", samples).arrays
    nx, ny = np.meshgrid(fourier["x"], fourier["y"])
    expected = side**2 * np.sinc(side * nx) * np.sinc(side * ny)
    np.testing.assert_allclose(fourier["values"], expected, atol=1e-15)
    otf = compute_view(SQUARE, "otf", samples).arrays
    triangle = np.maximum(0, 1 - np.abs(otf["x"]) / side)
    np.testing.assert_allclose(otf["values"], triangle[:, None] * triangle, atol=1e-12)
    ambiguity = compute_view(SQUARE, "ambiguity", samples).arrays
    overlap = side * triangle
    expected = side * overlap * np.sinc(ambiguity["y"][:, None] * overlap)
    np.testing.assert_allclose(np.abs(ambiguity["values"]), np.abs(expected), atol=1e-15)
    # For the square, W(0, nu) equals 4 F(2 nu).
    wigner = compute_view(SQUARE, "wigner_nu", samples).arrays
    nx, ny = np.meshgrid(wigner["x"], wigner["y"])
    expected = 4 * side**2 * np.sinc(2 * side * nx) * np.sinc(2 * side * ny)
    np.testing.assert_allclose(wigner["values"], expected, atol=1e-14)


def test_the_directivity_of_a_large_aperture_is_4_pi_area_over_wavelength_squared():
    peak = compute_view(replace(SQUARE, wave="0.5 mm"), "far").arrays["values"].max()
    assert peak == pytest.approx(10 * np.log10(4 * np.pi * 10**2 / 0.5**2), abs=0.1)


@pytest.mark.parametrize("state", [SQUARE, FED], ids=["square", "steered array"])
@pytest.mark.parametrize("name", VIEWS)
def test_the_code_of_a_view_computes_its_values(name, state):
    variables: dict = {}
    exec(snippet(state, name, 12), variables)
    shown = compute_view(state, name, 12)
    with np.load(io.BytesIO(npz(shown))) as file:
        if name == "lags":
            rings = [file[key] for key in file.files if key.startswith("ring")]
            values = sum(pw.Aperture.from_ring(ring).area for ring in rings)
            assert values == pytest.approx(variables["values"].area)
        else:
            np.testing.assert_allclose(file["values"], variables["values"], rtol=1e-9)


def test_geojson_of_the_page_is_read_back_by_the_page():
    content = geojson(FED)
    assert json.loads(content)["properties"]["unit"] == "mm"
    assert source_of(replace(SQUARE, rings=read_upload("a.geojson", content.encode(), "mm"))).area \
        == pytest.approx(100e-6)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.geojson", b"{"), ("a.exe", b"x"), ("a.csv", b"0 0\n1 0\n1 1\n" * 400)],
    ids=["damaged", "unknown suffix", "too many vertices"],
)
def test_a_bad_file_is_one_error_with_its_name(name, content):
    with pytest.raises(FileFormatError, match=name):
        read_upload(name, content, "mm")


def test_the_command_starts_with_the_outline_of_a_file_in_its_unit(tmp_path):
    path = tmp_path / "slot.wkt"
    path.write_text("POLYGON ((0 0, 4 0, 4 1, 0 1, 0 0))")
    state = start_state(str(path), unit="um", wave="1 um")
    assert (state.unit, state.box) == ("µm", (0.0, 0.0, 4.0, 1.0))
    assert source_of(state).area == pytest.approx(4e-12)
