"""Short texts of scenes and the command line, against functions of Python."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner import arrays
from polywigner.errors import PolywignerError
from polywigner.source.source_tables import apply_texts, parse_direction

WAVELENGTH = 3.19e-3
PATCH = pw.shapes.rectangle(9e-3, 6e-3)
COSINE = pw.cosine_taper(9e-3, 6e-3)
TOWARDS = np.array([0.0, np.sin(np.radians(20)), np.cos(np.radians(20))])
GRID = arrays.grid_positions(3, 4, 12e-3)
BEAM = arrays.steering_weights(GRID, TOWARDS, WAVELENGTH)


def lit(field: Any) -> pw.Aperture:
    return PATCH.with_illumination(field)


SHIFTED = PATCH.moved((5e-3, -2e-3))
ARRAY = pw.phased_array(PATCH, GRID, arrays.window_weights((3, 4), "hamming"))
GOOD = [
    (PATCH, {"taper": "cosine"}, lit(COSINE)),
    (PATCH, {"taper": "Cosine 2 Y"}, lit(pw.cosine_taper(None, 6e-3, power=2))),
    (PATCH, {"taper": "te10"}, lit(pw.te_mode(9e-3, 6e-3))),
    (PATCH, {"taper": "TE02"}, lit(pw.te_mode(9e-3, 6e-3, 0, 2, component="x"))),
    (PATCH, {"taper": "taylor"}, lit(pw.taylor_taper(9e-3, 6e-3))),
    (PATCH, {"taper": "taylor 40 dB 7 x"}, lit(pw.taylor_taper(9e-3, sll=40, nbar=7))),
    (SHIFTED, {"taper": "cosine x"},
     SHIFTED.with_illumination(pw.cosine_taper(9e-3).moved((5e-3, -2e-3)))),
    (PATCH, {"steering": "20 deg, 90 deg"}, lit(pw.steering(TOWARDS, WAVELENGTH))),
    (PATCH, {"taper": "cosine", "steering": "20 deg,90 deg"},
     lit(COSINE * pw.steering(TOWARDS, WAVELENGTH))),
    (PATCH, {"array": "3x4,12 mm,13 mm", "taper": "cosine"},
     pw.phased_array(lit(COSINE), arrays.grid_positions(3, 4, 12e-3, 13e-3))),
    (PATCH, {"array": "triangular 3 × 4, 12 mm"},
     pw.phased_array(PATCH, arrays.triangular_positions(3, 4, 12e-3))),
    (PATCH, {"array": "3 x 4, 12 mm", "window": "Hamming"}, ARRAY),
    (PATCH, {"array": "3 x 4, 12 mm", "window": "taylor 25 dB 3", "steering": "20 deg, 90 deg"},
     pw.phased_array(PATCH, GRID, arrays.window_weights((3, 4), "taylor", 25, 3) * BEAM)),
    (PATCH, {"array": "3 x 4, 12 mm", "focus": "1 mm, -2 mm, 8 cm"},
     pw.phased_array(PATCH, GRID, arrays.focusing_weights(GRID, (1e-3, -2e-3, 0.08), WAVELENGTH))),
    (ARRAY, {"steering": "20 deg, 90 deg"}, pw.phased_array(PATCH, GRID, ARRAY.weights * BEAM)),
    (SHIFTED, {"curved": "60 mm, inf", "coherence": "0.5 mm"},
     SHIFTED.curved((60e-3, np.inf), WAVELENGTH, (5e-3, -2e-3)).partially_coherent(5e-4)),
]  # fmt: skip


@pytest.mark.parametrize(("source", "texts", "expected"), GOOD, ids=str)
def test_texts_do_what_functions_do(source: Any, texts: dict[str, str], expected: Any) -> None:
    result = apply_texts(source, texts, WAVELENGTH)
    fields = [s.repeated[0] if isinstance(s, pw.Array) else s for s in (result, expected)]
    if isinstance(result, pw.Array):
        assert (result.repeated[1] == expected.repeated[1]).all()
        assert result.weights == pytest.approx(expected.weights, rel=1e-12)
    elif not isinstance(result, pw.Wavefront):
        ours, theirs = (field.illumination for field in fields)
        assert ours.amplitudes == pytest.approx(theirs.amplitudes, rel=1e-12)
        assert ours.frequencies == pytest.approx(theirs.frequencies, rel=1e-9, abs=1e-9)
        fields = [field.with_illumination(None) for field in fields]
    assert fields[0] == fields[1]


LISTED = pw.Array([PATCH, PATCH.moved((0.02, 0))])
BAD = [
    (PATCH, {"taper": "gauss"}, "taper: expected a taper such as .* got 'gauss'"),
    (PATCH, {"taper": "cosine 2 z"}, "taper: expected a taper"),
    (PATCH, {"taper": "te10 x"}, "taper: expected a taper"),
    (ARRAY, {"taper": "cosine"}, "taper: expected an aperture for this option, got Array"),
    (PATCH, {"array": "12 by 16"}, "array: expected an array such as .* got '12 by 16'"),
    (PATCH, {"array": "3 x 4, 2 furlong"}, "array: pitch_x: expected a length .* furlong"),
    (
        PATCH,
        {"window": "hamming"},
        "window: expected an array of identical .* specify array as well",
    ),
    (PATCH, {"array": "2 x 2, 1 cm", "window": "25 dB"}, "window: expected a window such as"),
    (
        PATCH,
        {"array": "2 x 2, 1 cm", "window": "boxcar"},
        "window: .* to be one of .*'boxcar'",
    ),
    (PATCH, {"steering": "20"}, "steering: .* within 90 deg of the normal"),
    (PATCH, {"steering": "1 deg, 2 deg, 3 deg"}, "steering: expected a direction"),
    (LISTED, {"steering": "20 deg"}, "steering: expected an array of identical elements"),
    (PATCH.curved(0.1, WAVELENGTH), {"steering": "1 deg"}, "steering: .* got Wavefront"),
    (ARRAY, {"window": "hamming"}, "window: a window requires positions of the kind row, grid"),
    (PATCH, {"focus": "0, 0, 80 mm"}, "focus: expected an array"),
    (ARRAY, {"focus": "0, 0"}, "focus: expected a point"),
    (PATCH, {"curved": "1 mm, 2 mm, 3 mm"}, "curved: expected radius to be a number or a pair"),
    (PATCH.placed(np.eye(4)), {"curved": "1 mm"}, "curved: .* got PlacedAperture"),
    (PATCH.placed(np.eye(4)), {"coherence": "1 mm"}, "coherence: .* got PlacedAperture"),
    (PATCH, {"coherence": "1 GHz"}, "coherence: expected a length"),
]


@pytest.mark.parametrize(("source", "texts", "words"), BAD)
def test_errors_begin_with_the_name_of_the_text(
    source: Any, texts: dict[str, str], words: str
) -> None:
    with pytest.raises(PolywignerError, match=words) as caught:
        apply_texts(source, texts, WAVELENGTH)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["steering", "curved"])
def test_beams_and_curved_waves_require_a_wavelength(name: str) -> None:
    with pytest.raises(PolywignerError, match=f"{name}: expected a frequency or a wavelength"):
        apply_texts(PATCH, {name: "0.1"}, None)


def test_the_angles_of_a_direction_have_theta_from_zero() -> None:
    theta, phi = parse_direction("-20 deg, 30 deg")
    assert np.degrees([theta, phi]) == pytest.approx([20, 210])
    assert parse_direction("0 deg, 30 deg") == (0.0, 0.0)
