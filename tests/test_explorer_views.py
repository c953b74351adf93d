"""The explorer without its page: states and links, outlines changed by hand, views, snippets."""

from __future__ import annotations

import asyncio
import contextlib
import io
import math
import threading
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError, PolywignerError
from polywigner.explorer import exports, outlines, snippets, start_state, views
from polywigner.explorer.computing import Scheduler, queue, results, stages
from polywigner.explorer.readings import Readings
from polywigner.explorer.state import (
    CATALOGUE,
    History,
    State,
    Unit,
    from_query,
    needed,
    to_query,
)
from polywigner.explorer.views import power_of_ten, shown

WAIT = 5.0  # seconds, for another thread on a loaded machine
SMALL = 17  # samples along an axis: the laws do not depend on it
EXACT = 1e-12  # relative, of values from two routes in double precision
RAYS_DB = 0.3  # rays against the exact field at 16 wavelengths, see docs/propagation.md

BEAM_SHIFT = 1.0  # degrees: elements radiate less aside, which pulls a beam of 8 degrees back
SMALL_ELEMENT = (((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),)

SIXTY = State(rings=outlines.rings_of_aperture(pw.shapes.disc(5, 60)))
HOLED = State(
    rings=(
        ((-6.0, -6.0), (6.0, -6.0), (6.0, 6.0), (-6.0, 6.0)),
        ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)),
        ((8.0, 0.0), (10.0, 0.0), (9.0, 3.0)),
    ),
    x=(3.0, 0.5),
    nu=(0.05, -0.03),
    defocus=0.7,
)
numbers = st.floats(-1e6, 1e6)
points = st.tuples(numbers, numbers)


@pytest.mark.slow
@given(
    st.lists(st.lists(points, max_size=6).map(tuple).filter(bool), max_size=4).map(tuple),
    points, points, numbers, st.sampled_from(["m", "mm", "µm"]),
    st.sampled_from(["94 GHz", "3.19 mm", "532 nm"]), st.text(max_size=20),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_a_link_restores_the_whole_state(
    rings: Any, x: Any, nu: Any, defocus: float, unit: Any, wave: str, taper: str
) -> None:
    state = State(rings=rings, x=x, nu=nu, defocus=defocus, unit=unit, wave=wave, taper=taper)
    assert from_query(to_query(state)) == state


@given(st.text(max_size=60) | st.sampled_from(["rings=1,2 3", "x=1", "order=2", "wave=0", "a=b"]))
@settings(max_examples=60, deadline=None)
def test_a_damaged_link_is_refused_and_never_crashes(text: str) -> None:
    with contextlib.suppress(PolywignerError):
        assert isinstance(from_query(text), State)


@pytest.mark.parametrize(
    "query",
    ["unit=furlong", "wave=ten", "order=2", "distance=0", "x=1,nan", "reach=2", "part=all",
     "rings=" + "0,0 " * 2000, "rings=0,0 1", "taper=" + "x" * 200],
)  # fmt: skip
def test_a_link_with_values_that_cannot_be_shown_says_so(query: str) -> None:
    with pytest.raises(PolywignerError, match="expected"):
        from_query(query)


def test_rings_inside_others_are_holes() -> None:
    source = outlines.source_of(HOLED)
    expected = (12 * 12 - 4 * 4 + 3) * 1e-6
    assert math.isclose(source.area, expected, rel_tol=EXACT)


def test_an_outline_that_crosses_itself_is_refused_with_the_place_in_units() -> None:
    bow_tie = State(rings=(((0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.0)),))
    with pytest.raises(GeometryError, match=r"2.*2"):
        outlines.source_of(bow_tie)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_shape_of_the_catalogue_keeps_its_area_as_a_state(name: str) -> None:
    shape = CATALOGUE[name]()
    state = State(rings=outlines.rings_of_aperture(shape))
    assert math.isclose(outlines.source_of(state).area * 1e6, shape.area, rel_tol=1e-4)


def test_undo_and_redo_go_through_the_same_states() -> None:
    states = [State(x=(float(k), 0.0)) for k in range(4)]
    history = History(states[0])
    for state in states[1:]:
        history = history.then(state)
    assert history.then(states[-1]) is history
    back = history.undone().undone()
    assert back.present == states[1]
    assert back.redone().redone().present == states[3] == history.redone().present
    assert back.then(State(x=(9.0, 0.0))).redone().present.x == (9.0, 0.0)
    assert History(states[0]).undone().present == states[0]


def test_snapping_puts_vertices_on_the_raster_without_stray_digits() -> None:
    ring = (((0.26, 0.34), (-0.01, 0.149), (1.0, 1.0)),)
    assert outlines.snapped(ring, 0.1) == (((0.3, 0.3), (0.0, 0.1), (1.0, 1.0)),)
    assert outlines.snapped(ring, 0.0) == ring


def test_a_new_vertex_goes_into_the_nearest_edge_and_can_be_taken_out_again() -> None:
    rings = HOLED.rings
    more = outlines.with_vertex_near(rings, (2.5, 0.0))
    assert [len(ring) for ring in more] == [4, 5, 3]
    assert more[1][2] == (2.5, 0.0)
    row = outlines.rows_of_rings(more).index((2, 2.5, 0.0))
    assert outlines.without_vertex(more, row) == (rings, "")


def triangle(size: float) -> tuple[tuple[float, float], ...]:
    return (-size, -size), (size, -size), (0.0, size)


@pytest.mark.parametrize(
    ("vertex", "left"), [(0, (2, 3)), (3, (0, 3)), (6, (0, 1)), (9, (0, 1, 2))]
)
def test_what_stays_of_nested_outlines_keeps_its_side(vertex: int, left: tuple[int, ...]) -> None:
    """An outline takes what lies directly in it along: a hole would become an aperture."""
    rings = tuple(map(triangle, (16.0, 8.0, 4.0, 2.0)))
    found, farewell = outlines.without_vertex(rings, vertex)
    assert found == tuple(rings[k] for k in left)
    gone = [k for k in range(4) if k not in left]
    assert all(str(k + 1) in farewell for k in gone)
    solid = [k % 2 == 0 for k in left]  # by the number of outlines around each, before
    assert solid == [k % 2 == 0 for k in range(len(found))]


def test_outlines_that_go_together_with_all_their_vertices_are_counted() -> None:
    rings = tuple(map(triangle, (16.0, 8.0)))
    assert outlines.without_lost(rings, {1: rings[1]})[0] == ()
    assert outlines.without_lost(rings, {0: rings[0]})[0] == rings[:1]
    assert outlines.without_lost(rings, dict(enumerate(rings))) == (rings, "")


def test_the_page_begins_in_the_unit_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "mirror.wkt"
    path.write_text("POLYGON((0 0, 6.5 0, 6.5 6.5, 0 6.5, 0 0))")
    state = start_state(str(path), unit="m", wave="2 um")
    assert state.unit == "m" and state.rings[0][2] == (0.0, 6.5)
    assert math.isclose(outlines.source_of(state).area, 6.5**2, rel_tol=EXACT)
    assert start_state(str(path), unit="in").unit == "mm"


def test_an_upload_is_read_in_the_units_of_the_page() -> None:
    content = b"POLYGON((0 0, 3 0, 3 2, 0 2, 0 0))"
    rings = asyncio.run(Readings().rings("a.wkt", content, "µm"))
    state = State(rings=rings, unit="µm")
    assert math.isclose(outlines.source_of(state).area, 6e-12, rel_tol=EXACT)


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("big.csv", b"0" * (outlines.LARGEST_UPLOAD + 1), "at most 1 MiB"),
        ("a.exe", b"MZ", "expected GeoJSON"),
        ("a.wkt", b"POLYGON((0 0, 1 1))", "a.wkt"),
        ("../../a.json", b"{", "expected GeoJSON"),
        ("a.svg\n", b"<svg/>", r"a\.svg\?: expected GeoJSON"),
        ("$(id)\n.wkt", b"POINT(0 0)", r"^\$\(id\)\?\.wkt: expected"),
        ("a.svg", b"<!DOCTYPE x [<!ENTITY a 'b'>]><svg>&a;</svg>", "expected"),
        ("many.csv", b"\n".join(b"%d,%d" % (k, k * k) for k in range(2000)), "at most"),
    ],
)
def test_a_bad_upload_says_what_is_wrong_and_no_path_of_the_server(
    name: str, content: bytes, match: str
) -> None:
    with pytest.raises(PolywignerError, match=match) as caught:
        asyncio.run(Readings().rings(name, content, "mm"))
    assert "tmp" not in str(caught.value)


def test_the_views_agree_with_each_other_where_their_slices_meet() -> None:
    """W over nu at x and W over x at nu share W(x, nu); W(x, 0) is the area of the lag slice."""
    state = HOLED.moved(nu=(0.0, 0.0))
    at_nu = views.wigner_at_frequency(state, SMALL)
    x, y, half = views.position_window(state)
    corner = state.moved(x=((x + half / 2) * 1000, y * 1000))
    over_nu = views.wigner_at_position(corner, SMALL)
    middle = SMALL // 2
    value = over_nu.arrays["W"][middle, middle]
    assert np.isclose(at_nu.arrays["W"][middle, middle + SMALL // 4], value, rtol=EXACT)
    assert np.isclose(views.values_at(corner)["W(x, 0)"][0], value, rtol=EXACT)
    assert value > 0


def test_the_centre_of_the_fourier_view_is_the_area_and_of_the_otf_one() -> None:
    middle = SMALL // 2
    area = outlines.source_of(HOLED).area
    assert np.isclose(views.fourier(HOLED, SMALL).arrays["F"][middle, middle], area, rtol=EXACT)
    otf = views.transfer(HOLED, SMALL).arrays["OTF"]
    assert np.isclose(otf[middle, middle], 1, rtol=EXACT)
    assert np.allclose(otf, otf[::-1, ::-1].conj(), atol=EXACT)
    assert abs(otf[middle, 0]) < EXACT < abs(otf[middle, 1])  # the window has all lags


def test_defocus_lowers_the_otf() -> None:
    sharp = np.abs(views.transfer(HOLED.moved(defocus=0.0), SMALL).arrays["OTF"])
    blurred = np.abs(views.transfer(HOLED, SMALL).arrays["OTF"])
    assert (blurred <= sharp + EXACT).all()
    assert (blurred < sharp - 0.1).any()


def test_rays_and_the_exact_field_agree_far_in_front() -> None:
    near = views.near_field(State(distance=150.0, order=3), 9)
    difference = near.arrays["difference"]
    assert np.isfinite(difference).any()
    assert np.nanmax(np.abs(difference)) < RAYS_DB
    assert near.note == ""


def test_rays_close_to_the_source_carry_a_warning() -> None:
    assert "rough picture" in views.near_field(State(distance=3.0), 5).note


def test_rays_of_outlines_that_would_take_minutes_are_refused() -> None:
    state = State(rings=outlines.rings_of_aperture(CATALOGUE["18 hexagons"]()))
    with pytest.raises(ArgumentError, match="108"):
        views.near_field(state, 5)


def test_the_far_field_peaks_at_four_pi_area_over_wavelength_squared() -> None:
    state = State(rings=(((-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)),))
    cuts = views.far_field(state)
    expected = 10 * np.log10(4 * np.pi * 0.1**2 / state.wavelength**2)
    assert abs(cuts.largest - expected) < 0.1  # one per cent of the power is evanescent
    assert cuts.directivity[len(cuts.theta) // 2].max() == cuts.largest


def test_the_first_cut_of_a_steered_array_goes_through_its_beam() -> None:
    state = State(array="8 x 8, 2 mm", steering="15 deg, 30 deg", rings=SMALL_ELEMENT)
    cuts = views.far_field(state)
    peak = cuts.theta[np.argmax(cuts.directivity[:, 0])]
    assert abs(np.degrees(peak) - 15) < BEAM_SHIFT
    assert cuts.directivity[:, 1].max() < cuts.largest - 10  # the cut across misses it
    assert np.allclose(np.degrees(cuts.phi), (30, 120))


def test_the_parts_of_a_polarised_far_field_add_up_to_that_of_both() -> None:
    slanted = views.far_field(State(polarisation="30 deg"))
    turned = views.far_field(State(polarisation="right"))
    assert slanted.cross is not None and turned.cross is not None
    both = [10 ** (c.directivity / 10) + 10 ** (c.cross / 10) for c in (slanted, turned)]
    middle = len(slanted.theta) // 2
    assert np.allclose(both[0][middle], both[1][middle], rtol=1e-12)
    assert turned.axial_ratio < 1e-6 < slanted.axial_ratio
    assert [name for name, _ in turned.lines][2:] == ["φ = 0°, cross", "φ = 90°, cross"]


def test_a_polarisation_that_is_none_is_said_in_the_far_field_alone() -> None:
    found = {r.name: r.error for r in results(State(polarisation="up"), ("fourier", "far")) if r}
    assert found["fourier"] == "" and "45 deg" in found["far"]


TAPERED = State(unit="µm", wave="532 nm", taper="cosine", nu=(0.1, 0.02), x=(0.3, 0.1))
STEERED = State(array="3 x 2, 12 mm", steering="10 deg, 30 deg", x=(6.0, 1.0))
BLURRED = State(coherence=8.0, nu=(0.05, 0.0), x=(1.0, 0.5))


@pytest.mark.parametrize(
    ("name", "state"),
    [
        *((name, HOLED) for name in snippets.SNIPPETS if name != "near"),
        ("near", State(order=3)),  # of four edges: sums over more take seconds
        *(("fourier", state) for state in (TAPERED, STEERED)),
        *(("wigner_nu", state) for state in (TAPERED, STEERED, BLURRED)),
        *(("wigner_x", state) for state in (TAPERED, STEERED, BLURRED)),
        *(("far", state) for state in (TAPERED, STEERED, State(polarisation="right"))),
    ],
)
def test_a_snippet_computes_its_view_digit_for_digit(name: str, state: State) -> None:
    samples = 5 if name == "near" else SMALL
    found: dict[str, Any] = {}
    exec(snippets.snippet(state, name, samples), found)
    if name == "far":
        cuts = views.far_field(state)
        expected = {"values": cuts.directivity}
        expected |= {} if cuts.cross is None else {"cross": cuts.cross}
    else:
        expected = {**views.PICTURES[name](state, samples).arrays}
        expected.pop("difference", None)
        expected = expected if name == "near" else {"values": expected.popitem()[1]}
    for key, values in expected.items():
        assert np.array_equal(found[key], values)


# What Python's str.split takes for a space, and so polywigner's texts may have between words.
_GAPS = ["\r\n", "\x0b", "\x1c", "\x85", "\xa0", "\u2028"]


@pytest.mark.parametrize("gap", _GAPS, ids=ascii)
def test_a_snippet_of_texts_with_line_breaks_computes_its_view(gap: str, tmp_path: Path) -> None:
    texts = {"wave": f"94{gap}GHz", "array": f"3 x 2,{gap}12 mm", "steering": f"10 deg,{gap}30 deg"}
    state = State(**texts)
    script, namespace = tmp_path / "script.py", {}
    script.write_text(snippets.snippet(state, "fourier", SMALL), encoding="utf-8")
    exec(script.read_text(encoding="utf-8"), namespace)
    picture = views.PICTURES["fourier"](state, SMALL)
    assert np.array_equal(namespace["values"], next(iter(picture.arrays.values())))


@pytest.mark.parametrize("text", ['"', "'", "'\"", "\\", '"""', "\\\n", "µ", "{x}", "#", "\x00"])
def test_texts_that_would_break_a_script_are_no_fields_and_give_none(text: str) -> None:
    for name in ("taper", "array", "window", "steering"):
        with pytest.raises(PolywignerError):
            snippets.snippet(State().moved(**{name: text}), "fourier", SMALL)


def test_a_width_of_coherence_blurs_w_and_leaves_the_transfer_function_of_the_pupil() -> None:
    state = State(coherence=6.0)
    assert from_query(to_query(state)) == state
    source = outlines.light_of(state)
    picture = views.wigner_at_position(state, SMALL)
    grid = views.square(picture.half, SMALL)
    assert np.array_equal(picture.arrays["W"], pw.wigner(source, (0.0, 0.0), grid, engine="numpy"))
    coherent = views.transfer(State(), SMALL).arrays["OTF"]
    assert np.array_equal(views.transfer(state, SMALL).arrays["OTF"], coherent)
    with pytest.raises(ArgumentError, match="at least a tenth"):
        views.wigner_at_position(State(coherence=0.5), SMALL)


@pytest.mark.parametrize("suffix", ["geojson", "svg"])
@pytest.mark.parametrize("unit", ["mm", "µm"])
def test_exported_outlines_are_read_back_as_the_same_aperture(
    suffix: str, unit: Unit, tmp_path: Path
) -> None:
    state = HOLED.moved(unit=unit)
    path = tmp_path / f"outline.{suffix}"
    path.write_text(getattr(exports, suffix)(state), encoding="utf-8")
    if suffix == "svg":
        pytest.importorskip("svgelements")
    read, source = pw.read_aperture(path), outlines.source_of(state)
    assert math.isclose(read.area, source.area, rel_tol=EXACT)
    assert len(read.rings) == len(source.rings)
    assert read.polygons.symmetric_difference(source.polygons).area < EXACT * source.area
    assert (suffix, unit) != ("geojson", "mm") or read == source  # elsewhere with a rounding


def test_exported_values_are_those_of_the_view_and_carry_the_link() -> None:
    with np.load(io.BytesIO(exports.values_file(HOLED, "fourier"))) as saved:
        assert np.array_equal(saved["F"], views.fourier(HOLED).arrays["F"])
        assert saved["F"].shape == (len(saved["second"]), len(saved["first"]))
        assert from_query(str(saved["link"])) == HOLED
    with np.load(io.BytesIO(exports.values_file(HOLED, "far"))) as saved:
        assert saved["directivity_dbi"].shape == (len(saved["theta_rad"]), 2)


@pytest.mark.parametrize("name", ["wigner_x", "far"])
@pytest.mark.parametrize(("suffix", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_views_are_exported_as_pictures(name: str, suffix: str, start: bytes) -> None:
    assert exports.picture_file(State(), name, suffix).startswith(start)


@pytest.mark.parametrize(("unit", "number"), [("m", "10⁻⁹ m⁴"), ("mm", "10000 mm⁴"), ("nm", "nm⁴")])
def test_the_peak_is_named_in_the_unit_of_the_page(unit: Any, number: str) -> None:
    picture = views.fourier(State(), SMALL + 1)
    assert number in shown(picture, "F", unit=unit).bar
    assert f"{unit}²" in shown(picture, "F", "real", unit=unit).bar


@pytest.mark.parametrize("samples", [64, 65])
def test_the_peak_of_a_square_is_the_square_of_its_area(samples: int) -> None:
    """10 mm: also where no sample lies at the middle of the picture."""
    what = shown(views.fourier(State(), samples), "F", unit="mm")
    assert what.bar == "dB relative to 10000 mm⁴"
    assert what.values.max() <= 0.0


def test_the_peak_of_a_beam_between_samples_is_that_of_its_array() -> None:
    """A beam of sixteen elements, which the pattern of one pulls towards the normal a little."""
    state = State(array="4 x 4, 12 mm", steering="3 deg, 20 deg")
    between = 1e-5  # of the peak, a thousandth of a lobe beside it
    peak = views.fourier(state, 256).peak
    nearby = pw.fourier(outlines.source_of(state), _beam_frequencies(state), engine="numpy")
    assert peak == pytest.approx(float((np.abs(nearby) ** 2).max()), rel=between)


def _beam_frequencies(state: State) -> Any:
    """Frequencies around the beam, a thousandth of a lobe apart."""
    sine, phi = math.sin(math.radians(3)), math.radians(20)
    x, y = np.array([math.cos(phi), math.sin(phi)]) * sine / state.wavelength
    return views.square(2.0, 201, x, y)


@pytest.mark.parametrize(
    ("value", "exponent"),
    [(0.0, 0), (400.0, 0), (-9999.0, 0), (0.01, 0), (2e4, 3), (-4e-6, -6), (4e-4, -6), (4e18, 18)],
)
def test_what_is_too_long_for_a_colour_bar_is_written_beside_it(
    value: float, exponent: int
) -> None:
    assert power_of_ten(value) == exponent
    assert exponent == 0 or 1 <= abs(value) / 10.0**exponent < 1000


def test_what_is_to_be_computed_of_many_edges_is_told_before() -> None:
    names = ("fourier", "wigner_nu", "far", "values")
    found = [r for r in results(SIXTY, names) if r is not None]
    order = [(r.name, r.value.samples if isinstance(r.value, views.Picture) else 0) for r in found]
    assert order[1:] == queue(SIXTY, names)


@pytest.mark.parametrize(("part", "low"), [("level", -40), ("real", -1), ("phase", -180)])
def test_what_is_shown_fills_its_scale(part: Any, low: float) -> None:
    what = shown(views.fourier(HOLED, SMALL), "F", part)
    assert what.low == low
    assert (what.values >= what.low).all() and (what.values <= what.high).all()
    between = {"level": 0.1, "real": 0.0, "phase": 360.0}  # dB: the peak is not on a sample
    assert what.values.max() >= what.high - between[part]


def test_results_come_coarse_first_in_the_order_asked_for_and_the_source_before_all() -> None:
    found = []
    for result in results(State(), ("near", "fourier", "values", "far")):
        found += [] if result is None else [result]
        if [r.name for r in found].count("near") == 2:  # the third takes seconds
            break
    assert [r.error for r in found] == [""] * len(found)
    assert [r.name for r in found] == ["source", "near", "fourier", "values", "far", "near"]
    near = [r.value.samples for r in found if r.name == "near"]
    assert near == list(stages("near", 4))[:2] == sorted(near)


def test_between_strips_of_the_near_field_others_have_their_turn() -> None:
    coarsest = stages("near", views.edges_of(HOLED))[0]
    strips = views.near_strips(HOLED, coarsest)
    first, *pauses, picture = islice(results(HOLED, ("near",)), strips + 1)
    assert first is not None and first.name == "source"
    assert pauses == [None] * (strips - 1) and len(pauses) > 2
    assert picture is not None and picture.value.samples == coarsest


def test_the_near_field_is_one_for_all_places_frequencies_and_defocus() -> None:
    state = State(distance=77.0)
    elsewhere = state.moved(x=(1.0, 2.0), nu=(0.1, 0.0), defocus=1.0)
    assert needed(elsewhere, "near") == needed(state, "near")
    first, again = (views.near_field(s, 9).arrays["rays"] for s in (state, elsewhere))
    assert np.array_equal(first, again)
    farther = state.moved(distance=78.0)
    assert needed(farther, "near") != needed(state, "near")
    assert not np.array_equal(first, views.near_field(farther, 9).arrays["rays"])


@pytest.mark.parametrize("name", ["fourier", "wigner_nu", "wigner_x", "otf"])
def test_a_view_changes_with_what_it_needs_and_with_nothing_else(name: str) -> None:
    other = HOLED.moved(x=(2.0, -1.0), nu=(-0.02, 0.01), defocus=-0.4, distance=9.0, snap=1.0)
    alone = needed(other, name)
    for state in (HOLED, other):
        pictures = (
            views.PICTURES[name](state, SMALL),
            views.PICTURES[name](needed(state, name), SMALL),
        )
        (key,) = pictures[0].arrays
        assert np.array_equal(pictures[0].arrays[key], pictures[1].arrays[key])
    assert (needed(HOLED, name) != alone) == (name != "fourier")


def test_results_of_no_polygon_are_one_error_and_nothing_else() -> None:
    (found,) = results(State(rings=()), ("fourier", "far"))
    assert found is not None and "blank" in found.error


def test_an_array_that_would_keep_others_waiting_is_refused() -> None:
    (found,) = results(State(array="1000 x 1000, 12 mm"), ("wigner_x",))
    assert found is not None and "256 elements" in found.error


class _Worker:
    """A scheduler whose work waits for a gate, and notes what it did."""

    def __init__(self) -> None:
        self.scheduler, self.gate, self.done = Scheduler(), threading.Event(), list[str]()

    def work(self, name: str, steps: int = 1) -> Callable[[], Iterator[None]]:
        def run() -> Iterator[None]:
            for k in range(steps):
                self.gate.wait(5)
                self.done.append(f"{name}{k}")
                yield

        return run

    def wait_for(self, name: str) -> None:
        deadline = time.monotonic() + 5
        while name not in self.done and time.monotonic() < deadline:
            time.sleep(0.005)
        assert name in self.done


def test_old_requests_are_dropped_and_the_newest_wins() -> None:
    worker = _Worker()
    worker.scheduler.submit("anna", worker.work("a", 3))
    for k in range(5):
        worker.scheduler.submit("anna", worker.work(f"b{k}"))
    worker.gate.set()
    worker.wait_for("b40")
    worker.scheduler.stop()
    assert [name for name in worker.done if name.startswith("b")] == ["b40"]
    assert "a1" not in worker.done


def test_a_computation_that_goes_on_keeps_nobody_who_stops() -> None:
    scheduler, begun, leave = Scheduler(), threading.Event(), threading.Event()

    def long() -> Iterator[None]:
        begun.set()
        leave.wait(WAIT)
        yield

    scheduler.submit("visitor", long)
    assert begun.wait(WAIT)
    assert not scheduler.stop(patience=0.01)
    leave.set()
    assert scheduler.stop(patience=WAIT)


def test_visitors_take_turns_and_a_fault_of_one_does_not_stop_the_others() -> None:
    worker = _Worker()

    def fails() -> Iterator[None]:
        raise RuntimeError("a fault")
        yield

    worker.scheduler.submit("first", worker.work("f"))
    worker.scheduler.submit("anna", worker.work("a", 3))
    worker.scheduler.submit("karl", fails)
    worker.scheduler.submit("bert", worker.work("b", 3))
    worker.scheduler.submit("cara", worker.work("c"))
    worker.scheduler.forget("cara")
    worker.gate.set()
    worker.wait_for("b2")
    worker.scheduler.stop()
    assert worker.done == ["f0", "a0", "b0", "a1", "b1", "a2", "b2"]
