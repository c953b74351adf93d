"""Arrays from tables of elements."""

from __future__ import annotations

import math
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, PolywignerError, PolywignerWarning

PATCH = pw.shapes.rectangle(1.2e-3, 0.4e-3).with_illumination(pw.cosine_taper(1.2e-3))
NU = np.random.default_rng(0).normal(size=(12, 2)) * 300


def _read(folder: Path, text: str, element: Any = PATCH, **how: Any) -> Any:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return pw.arrays.read_elements(path, element, **how)


def test_columns_have_any_order_and_weights_are_polar_or_complex(tmp_path: Path) -> None:
    places, weights = [(-1e-3, 0.5e-3), (1.5e-3, 0.0)], [2j, -0.5]
    expected = pw.fourier(pw.phased_array(PATCH, places, weights), NU)
    for text in (
        "x,y,amplitude,phase\n-1,0.5,2,90\n1.5,0,0.5,180\n",
        "# made by hand\nIM; Re; y; x\n2;0;0,5;-1\n0;-0,5;0;1,5\n",
        "y x re im\n0.5 -1 0 2\n\n0 1.5 -0.5 0 # last\n",
    ):
        assert pw.fourier(_read(tmp_path, text), NU) == pytest.approx(expected, abs=1e-18)
    metres = "-0.001 0.0005\n0.0015 0\n"
    assert (_read(tmp_path, metres, unit="m").weights == 1).all()
    assert _read(tmp_path, metres, unit="m").repeated[1] == pytest.approx(np.array(places))


def test_elements_are_turned_with_their_fields(tmp_path: Path) -> None:
    """F of a rotated element equals F of the element at rotated frequencies."""
    angles, places = np.radians([30.0, -75.0, 30.0]), np.array([(0, 0), (2, 1), (-2, 1.5)])
    rows = "".join(
        f"{x}, {y}, {math.degrees(a)}\n" for (x, y), a in zip(places, angles, strict=True)
    )
    result = pw.fourier(_read(tmp_path, "x, y, angle\n" + rows), NU)
    expected = np.zeros(len(NU), complex)
    for angle, place in zip(angles, 1e-3 * places, strict=True):
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        expected += pw.fourier(PATCH, NU @ turn) * np.exp(-2j * np.pi * NU @ place)
    assert result == pytest.approx(expected, abs=1e-12 * PATCH.area)


def _overlaps(make: Any) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = make()
        pw.fourier(pickle.loads(pickle.dumps(made)), [0.0, 0.0])
    return " ".join(str(warning.message) for warning in caught)


SQUARE = pw.shapes.square(1e-3)
CORNER = pw.Aperture([(0, 0), (3e-3, 0), (3e-3, 1e-3), (1e-3, 1e-3), (1e-3, 3e-3), (0, 3e-3)])


@pytest.mark.parametrize(
    ("element", "positions", "words"),
    [
        (SQUARE, pw.arrays.grid_positions(4, 3, 0.75e-3), "overlap by 2.5e-07 m^2"),
        (SQUARE, [(0, 0), (1e-3, 0), (0, 1e-3)], ""),
        (pw.shapes.square(1e-3 / 3), [(k / 3e3, 0) for k in range(9)], ""),
        # The outlines overlap less than their bounds. Each has a foot of 2.5 x 1 mm and a leg of
        # 0.5 x 2 mm.
        (CORNER, [(0, 0), (0.5e-3, 0)], "overlap by 3.5e-06 m^2"),
        (CORNER, [(0, 0), (1.5e-3, 1.5e-3)], ""),
        (SQUARE.curved(20e-3, 4e-3), [(0, 0), (0.5e-3, 0)], "overlap by 5e-07 m^2"),
    ],
)
def test_arrays_and_tables_warn_of_elements_that_overlap(
    tmp_path: Path, element: Any, positions: Any, words: str
) -> None:
    message = _overlaps(lambda: pw.phased_array(element, positions))
    assert words in message and bool(words) == bool(message)
    if isinstance(element, pw.Aperture):
        table = "x,y\n" + "".join(f"{x},{y}\n" for x, y in np.array(positions).tolist())
        assert _overlaps(lambda: _read(tmp_path, table, element, unit="m")) == message


def test_slits_and_many_elements_that_overlap_are_reported_as_well() -> None:
    with pytest.warns(PolywignerWarning, match="0 and 1 \\(counted from 0\\) overlap by 0.0003 m,"):
        pw.phased_array(pw.Slits([0, 1e-3]), [0, 0.7e-3])
    with pytest.warns(PolywignerWarning, match="overlap by 1e-06"):
        pw.phased_array(SQUARE, np.zeros((2000, 2)))
    row = pw.arrays.grid_positions(80, 1, 1e-3)
    row[79] = row[70] + (0.25e-3, 0.0)
    with pytest.warns(PolywignerWarning, match="70 and 79 .* overlap by 7.5e-07 m"):
        pw.phased_array(SQUARE, row)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("x,y\n", "row"),
        ("x,z\n0,0\n", "each only once"),
        ("x,x,y\n0,0,0\n", "once"),
        ("x,y,re,phase\n0,0,1,1\n", "once"),
        ("x,y\n0,nan\n", "line 2"),
        ("x,y\n0,\x1b[31m\n", "expected 2 numbers .* in line 2, got"),
        ("x,y\n0\n", "expected 2 numbers .* in line 2, got .0"),
        ("x,y,amplitude\n0,0,0\n", "zero"),
    ],
)
def test_tables_that_are_none_are_refused_in_a_sentence(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(PolywignerError, match=words) as error:
        _read(tmp_path, text)
    assert "table.csv" in str(error.value) and str(error.value).isprintable()


def test_other_elements_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="Aperture"):
        _read(tmp_path, "x,y\n0,0\n", pw.Slits([0, 1]))
    with pytest.raises(FileFormatError, match="does not exist"):
        pw.arrays.read_elements(tmp_path / "none.csv", PATCH)
