"""Values that no function can use: each is told, or is not a number in the result as well."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

SQUARE = pw.shapes.square(1.0)
HUGE = 10**400

REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a wavelength beyond floats": (lambda: pw.power(SQUARE, HUGE), "expected wavelength"),
    "a side beyond floats": (lambda: pw.shapes.square(HUGE), "a length above zero"),
    "a frequency beyond floats": (lambda: pw.fourier(SQUARE, [HUGE, 0]), "expected nu"),
    "an option of another quantity": (
        lambda: pw.suggest_sampling(SQUARE, 0.01, "intensity", error_db="junk"),  # type: ignore[arg-type]
        "expected error_db",
    ),
    "a complex wavelength": (
        lambda: pw.radiated_power(SQUARE, np.complex64(0.003 + 1e-4j)),
        "expected wavelength",
    ),
    "a focal length beyond fields": (
        lambda: pw.psf(SQUARE, (0, 0), 1e-3, 1e308),
        "expected focal_length",
    ),
    "an array for a name": (
        lambda: pw.irradiance(SQUARE, (0, 0, 9), 0.01, sampling=np.ones(3)),  # type: ignore[call-overload]
        "expected sampling",
    ),
    "an array for a flag": (
        lambda: pw.amplitude(SQUARE, (0, 0, 9), 0.01, return_error=np.ones(3)),  # type: ignore[arg-type]
        "expected return_error",
    ),
    "an array for an order": (
        lambda: pw.irradiance(SQUARE, (0, 0, 9), 0.01, order=np.ones(3)),  # type: ignore[call-overload]
        "expected order",
    ),
    "a masked shape": (
        lambda: pw.plane(SQUARE, ((-1, -1, 9), (1, 1, 9)), np.ma.masked, 0.01),
        "expected a shape",
    ),
    "a list as a seed": (lambda: pw.sample_automean(SQUARE, 4, seed=[]), "expected seed"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_no_function_can_use_is_told_at_once(what: str) -> None:
    call, message = REFUSED[what]
    with pytest.raises(ArgumentError, match=message):
        call()


@pytest.mark.filterwarnings("ignore:the matrix subclass")
def test_a_matrix_as_a_seed_is_refused_and_ends_no_process() -> None:
    with pytest.raises(ArgumentError, match="expected seed"):
        pw.sample_automean(SQUARE, 4, seed=np.matrix([[1, 2]]))


@pytest.mark.llvm
@pytest.mark.parametrize("source", [SQUARE, pw.shapes.regular_polygon(40, 1.0)], ids=["4", "40"])
def test_one_place_that_is_no_number_gives_none_at_any_frequency(source: pw.Aperture) -> None:
    from drjit.llvm import Array2f64, Float64

    lost = Array2f64(Float64(np.nan), Float64(0.0))
    found = Array2f64(Float64([0.0, 1.0, 2.0]), Float64([0.0, 0.3, 0.0]))
    assert np.isnan(pw.wigner(source, lost, found).numpy()).all()
    assert np.isnan(pw.ambiguity(source, found, lost).numpy()).all()


def test_a_file_name_is_text_in_a_title_and_no_formula() -> None:
    from matplotlib.figure import Figure

    from polywigner.cli.sources import short_name

    figure = Figure()
    title = figure.suptitle(short_name("drawings/a$b_{$.csv"))
    figure.draw_without_rendering()
    assert title.get_text() == r"a\$b_{\$.csv"
