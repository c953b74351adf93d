"""Set operations and scaling of apertures, and the repr of sources."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import GeometryError, IlluminationError, PolywignerError

# Relative rounding error of new vertices, which have a grid of 2^-44 of the size.
GRID = 1e-12

DISC, BAR = pw.shapes.ring(10e-3, 5e-3), pw.shapes.rectangle(30e-3, 4e-3)
FIELD = pw.cosine_taper(30e-3, 4e-3)
NU = np.array([[0.0, 0.0], [30.0, -20.0], [400.0, 90.0]])


def test_areas_and_transforms_add_up():
    """1_A + 1_B = 1_(A or B) + 1_(A and B), and 1_A = 1_(A and B) + 1_(A without B)."""
    either, both, rest = DISC | BAR, DISC & BAR, DISC - BAR
    bound = GRID * either.area
    for nu in NU:
        one, other = pw.fourier(DISC, nu), pw.fourier(BAR, nu)
        assert abs(pw.fourier(either, nu) + pw.fourier(both, nu) - one - other) < bound
        assert abs(pw.fourier(both, nu) + pw.fourier(rest, nu) - one) < bound
    assert len(rest.rings) == 2 and len(both.rings) == 2


def test_operations_undo_each_other():
    square, corner = pw.shapes.square(2.0), pw.shapes.square(1.0).moved((0.5, 0.5))
    assert (square - corner) | corner == square
    assert square & corner == corner


def test_the_left_one_keeps_its_field():
    fed = BAR.with_illumination(FIELD)
    assert (fed & DISC).illumination == FIELD
    assert (fed - DISC).illumination == FIELD
    assert (fed | fed.moved((0.0, 0.0))).illumination == FIELD


def test_a_scaled_aperture_has_a_scaled_transform():
    """F of u(x/s) is s^2 F(s nu)."""
    fed = BAR.with_illumination(FIELD)
    for nu in NU:
        expected = 6.25 * pw.fourier(fed, 2.5 * nu)
        assert pw.fourier(fed.scaled(2.5), nu) == pytest.approx(expected, abs=1e-13 * fed.area)


@pytest.mark.parametrize(
    ("made", "error", "words"),
    [
        (lambda: DISC & pw.shapes.square(1e-3), GeometryError, "do not overlap"),
        (lambda: pw.shapes.square(1e-3) - BAR, GeometryError, "the result has zero area"),
        (lambda: DISC | BAR.with_illumination(FIELD), IlluminationError, "with_illumination"),
        (lambda: DISC & BAR.with_illumination(FIELD), IlluminationError, "remove one of them"),
        (lambda: DISC.scaled(0.0), PolywignerError, "factor"),
        (lambda: DISC.scaled(float("nan")), PolywignerError, "factor"),
    ],
)
def test_what_cannot_be_is_refused(made, error, words):
    with pytest.raises(error, match=words):
        made()


def test_operations_with_anything_else_are_type_errors():
    for operate in (lambda: DISC | 3, lambda: DISC & "a", lambda: DISC - None):
        with pytest.raises(TypeError):
            operate()


def test_an_outline_is_drawn_on_given_axes_in_its_unit():
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    assert (DISC | BAR).plot(axes, unit="mm") is axes
    assert DISC.placed(np.eye(4)).plot(axes) is axes
    low, high = axes.get_xlim()
    assert low <= -15.0 and high >= 15.0 and high < 20.0
    assert axes.get_xlabel() == "x (mm)"
    with pytest.raises(PolywignerError, match="axes"):
        DISC.plot(3)


def test_a_misspelt_name_is_answered_with_the_nearest():
    with pytest.raises(AttributeError, match="did you mean 'wigner'"):
        _ = pw.wignr
    assert dir(pw.shapes) == sorted(pw.shapes.__all__)
