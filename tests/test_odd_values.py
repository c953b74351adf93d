"""Values that no function can use: each is told, or is not a number in the result as well."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner import figures
from polywigner.errors import ArgumentError, PolywignerError

SQUARE = pw.shapes.square(1.0)
HUGE = 10**400

REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a wavelength beyond floats": (lambda: pw.power(SQUARE, HUGE), "expected wavelength"),
    "a complex wavelength": (
        lambda: pw.radiated_power(SQUARE, np.complex64(0.003 + 1e-4j)),
        "expected wavelength",
    ),
    "a focal length beyond fields": (
        lambda: pw.psf(SQUARE, (0, 0), 1e-3, 1e308),
        "expected focal_length",
    ),
    "an array for a name": (
        lambda: pw.irradiance(SQUARE, (0, 0, 9), 0.01, sampling=np.ones(3)),
        "expected sampling",
    ),
    "an array for a flag": (
        lambda: pw.amplitude(SQUARE, (0, 0, 9), 0.01, return_error=np.ones(3)),
        "expected return_error",
    ),
    "a masked shape": (
        lambda: pw.plane(SQUARE, ((-1, -1, 9), (1, 1, 9)), np.ma.masked, 0.01),
        "expected a shape",
    ),
    "an array for a position": (
        lambda: pw.shapes.hexagonal_segments(1.0, centre=np.ones(3)),
        "expected centre",
    ),
    "a list for the name of a tile": (lambda: pw.projections(SQUARE, tiles=[[]]), "expected tiles"),
    "a text for chunks": (
        lambda: pw.wigner_table(SQUARE, [0], [0], [0], [0], chunks="xy"),
        "expected chunks",
    ),
    "samples beyond memory": (lambda: pw.sample_automean(SQUARE, HUGE), "expected samples"),
    "a shift of lists": (lambda: pw.Slits([[0, 1]]).moved([[1.0, 2.0], [3.0]]), "expected a shift"),
    "a length whose inverse is no float": (lambda: pw.te_mode(1e-320, 0.01), "expected width"),
    "places farther apart than floats": (
        lambda: pw.arrays.focusing_weights([[1e300, 1e300]], (0, 0, 1), 0.01),
        "expected a wavelength",
    ),
    "a dataset of other things for spots": (
        lambda: figures.draw_psf(pw.plane(SQUARE, ((-1, -1, 9), (1, 1, 9)), (3, 3), 0.01)),
        "expected found with psf",
    ),
    "an array for an aperture": (
        lambda: figures.samples_needed(np.ones(3), None),
        "expected an aperture",
    ),
    "a background beyond squares": (
        lambda: pw.partially_coherent_image(
            SQUARE, (2.0, 2.0), SQUARE, SQUARE, (0, 0), 0.1, 1.0, background=1e308
        ),
        "expected background",
    ),
    "an array for an obliquity": (
        lambda: pw.radiation_pattern(SQUARE, 0.1, 0.0, 0.0, obliquity=np.array([])),
        "expected obliquity",
    ),
    "a text for names": (
        lambda: figures.draw_arrivals(np.ones((4, 4)), names="junk"),
        "expected names",
    ),
    "one cosine for a name": (
        lambda: figures.draw_arrivals(np.ones((4, 4)), names={"wall": [0.5]}),
        "expected two direction cosines",
    ),
    "a list as a seed": (lambda: pw.sample_automean(SQUARE, 4, seed=[]), "expected seed"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_no_function_can_use_is_told_at_once(what):
    call, message = REFUSED[what]
    with pytest.raises(ArgumentError, match=message):
        call()


@pytest.mark.filterwarnings("ignore:the matrix subclass")
def test_a_matrix_as_a_seed_is_refused_and_ends_no_process():
    with pytest.raises(ArgumentError, match="expected seed"):
        pw.sample_automean(SQUARE, 4, seed=np.matrix([[1, 2]]))


def test_hardly_any_defocus_is_none():
    focused, nearly = (pw.psf(SQUARE, (4e-4, 0), 1e-3, 1.0, defocus=w) for w in (0.0, 1e-200))
    assert focused == nearly > 0


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_no_flux_leaves_from_far_beyond_the_source():
    assert (pw.flux_vector(SQUARE, (1e300, 1e300), 1.0) == 0).all()


@pytest.mark.drjit
@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda pm, pose: pm.receiver(SQUARE, 0.01, to_world=pose), "to_world"),
        (lambda pm, pose: pm.aperture(SQUARE, 0.01, to_world=pose), "to_world"),
        (lambda pm, pose: pm.render_file("a.xml", parameters=pose), "expected parameters"),
        (lambda pm, pose: pm.render_file("a.xml", variant=pose), "expected a variant"),
        (lambda pm, pose: pm.load_scene("a.xml", sampler=pose), "expected sampler"),
    ],
)
@pytest.mark.parametrize("odd", [np.array([1j, 2]), HUGE], ids=["complex", "huge"])
def test_scenes_are_told_as_well(call, expected, odd):
    import polywigner.mitsuba as pm

    with pytest.raises(PolywignerError, match=expected):
        call(pm, odd)


@pytest.mark.llvm
@pytest.mark.parametrize("source", [SQUARE, pw.shapes.regular_polygon(40, 1.0)], ids=["4", "40"])
def test_one_place_that_is_no_number_gives_none_at_any_frequency(source):
    from drjit.llvm import Array2f64, Float64

    lost = Array2f64(Float64(np.nan), Float64(0.0))
    found = Array2f64(Float64([0.0, 1.0, 2.0]), Float64([0.0, 0.3, 0.0]))
    assert np.isnan(pw.wigner(source, lost, found).numpy()).all()
    assert np.isnan(pw.ambiguity(source, found, lost).numpy()).all()


def test_a_file_name_is_text_in_a_title_and_no_formula():
    from matplotlib.figure import Figure

    from polywigner.cli.sources import short_name

    figure = Figure()
    title = figure.suptitle(short_name("drawings/a$b_{$.csv"))
    figure.draw_without_rendering()
    assert title.get_text() == r"a\$b_{\$.csv"
