"""Plausible mistakes in arguments: each raises one error that names the argument."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import PolywignerError

SQUARE = pw.shapes.square(1.0)
BOX = ((-1, -1, 9), (1, 1, 9))
NAN = float("nan")

MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "negative wavelength": (lambda: pw.power(SQUARE, -0.01), "wavelength"),
    "wavelength of zero": (lambda: pw.amplitude(SQUARE, (0, 0, 9), 0.0), "wavelength"),
    "wavelength NaN": (lambda: pw.radiated_power(SQUARE, NAN), "wavelength"),
    "complex wavelength": (lambda: pw.power(SQUARE, 0.01 + 1e-4j), "wavelength"),
    "wavelength with a unit": (lambda: pw.power(SQUARE, "3 mm"), "wavelength"),
    "source of another type": (lambda: pw.fourier("square", (0, 0)), "Aperture"),
    "two vertices": (lambda: pw.Aperture([[0, 0], [1, 1]]), "vert"),
    "vertex NaN": (lambda: pw.Aperture([[0, 0], [1, NAN], [1, 1]]), "finite"),
    "vertices in space": (lambda: pw.Aperture(np.eye(3)), r"shape|\(n, 2\)|z = 0"),
    "frequencies with four columns": (lambda: pw.fourier(SQUARE, np.ones((3, 4))), "nu"),
    "different numbers of points": (
        lambda: pw.wigner(SQUARE, np.zeros((3, 2)), np.zeros((4, 2))),
        "3|4",
    ),
    "points in the plane": (lambda: pw.amplitude(SQUARE, (0, 0), 0.01), "points"),
    "text for points": (lambda: pw.amplitude(SQUARE, "origin", 0.01), "points"),
    "misspelt obliquity": (
        lambda: pw.radiation_pattern(SQUARE, 0.1, 0.0, 0.0, obliquity="kirchoff"),
        "obliquity",
    ),
    "misspelt sampling": (
        lambda: pw.sample_rays(SQUARE, 0.01, 10, sampling="margin"),
        "sampling",
    ),
    "misspelt engine": (lambda: pw.fourier(SQUARE, (0, 0), engine="numpi"), "engine"),
    "samples below one": (lambda: pw.sample_automean(SQUARE, 0), "samples"),
    "fraction of a sample": (lambda: pw.sample_automean(SQUARE, 2.5), "samples"),
    "negative seed": (lambda: pw.sample_automean(SQUARE, 4, seed=-1), "seed"),
    "shape of a plane with three numbers": (
        lambda: pw.plane(SQUARE, BOX, (3, 3, 3), 0.01),
        "shape",
    ),
    "chunks as text": (
        lambda: pw.wigner_table(SQUARE, [0], [0], [0], [0], chunks="xy"),
        "chunks",
    ),
    "negative focal length": (lambda: pw.psf(SQUARE, (0, 0), 1e-3, -1.0), "focal_length"),
    "negative width of a guide": (lambda: pw.te_mode(-0.02, 0.01), "width"),
    "polygon of two sides": (lambda: pw.shapes.regular_polygon(2, 1.0), "3"),
    "negative side": (lambda: pw.shapes.square(-1.0), "above zero|positive"),
    "shift with three numbers": (lambda: SQUARE.moved((1.0, 2.0, 3.0)), "shift"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_raises_an_error_that_names_the_argument(name: str) -> None:
    call, words = MISTAKES[name]
    with pytest.raises(PolywignerError, match=words) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 400


SCENE_MISTAKES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "pose (3, 3)": (lambda pm: pm.receiver(SQUARE, 0.01, to_world=np.eye(3)), "to_world"),
    "scaled pose": (
        lambda pm: pm.aperture(SQUARE, 0.01, to_world=np.diag([2.0, 2.0, 2.0, 1.0])),
        "to_world",
    ),
    "pose NaN": (lambda pm: pm.aperture(SQUARE, 0.01, to_world=np.eye(4) * NAN), "to_world"),
    "negative power": (lambda pm: pm.aperture(SQUARE, 0.01, power=-1.0), "power"),
    "unknown variant": (lambda pm: pm.choose_variant("llvm"), "variant"),
    "missing file": (lambda pm: pm.load_scene("a.xml", variant="scalar_rgb"), "a.xml"),
    "parameters as a list": (lambda pm: pm.render_file("a.xml", parameters=["p"]), "parameters"),
}


@pytest.mark.drjit
@pytest.mark.parametrize("name", SCENE_MISTAKES)
def test_a_mistake_in_a_scene_raises_an_error_that_names_it(name: str) -> None:
    import polywigner.mitsuba as pm

    call, words = SCENE_MISTAKES[name]
    with pytest.raises(PolywignerError, match=words):
        call(pm)


@pytest.mark.parametrize("engine", ["numpy", pytest.param("llvm", marks=pytest.mark.llvm)])
@pytest.mark.parametrize("source", [SQUARE, pw.shapes.regular_polygon(40, 1.0)], ids=["4", "40"])
def test_nan_points_give_nan_values_and_leave_the_others_alone(source: Any, engine: str) -> None:
    points = np.array([[0.0, 0.1], [NAN, 0.0], [0.2, 0.0]])
    nu = np.full((3, 2), 0.3)
    for transform in (pw.wigner, pw.ambiguity):
        values = transform(source, points, nu, engine=engine)
        assert np.isnan(values).tolist() == [False, True, False]
        rest = transform(source, points[::2], nu[::2], engine=engine)
        assert values[::2] == pytest.approx(rest, rel=1e-12, abs=1e-12)


def test_a_file_name_is_text_in_a_title_and_no_formula() -> None:
    from matplotlib.figure import Figure

    from polywigner.cli.sources import short_name

    figure = Figure()
    title = figure.suptitle(short_name("drawings/a$b_{$.csv"))
    figure.draw_without_rendering()
    assert title.get_text() == r"a\$b_{\$.csv"
