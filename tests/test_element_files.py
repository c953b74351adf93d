"""Arrays from tables of their elements."""

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
    """F of an element turned by its angle: that of the element at frequencies turned back."""
    angles, places = np.radians([30.0, -75.0, 30.0]), np.array([(0, 0), (2, 1), (-2, 1.5)])
    rows = "".join(
        f"{x}, {y}, {math.degrees(a)}\n" for (x, y), a in zip(places, angles, strict=True)
    )
    found = pw.fourier(_read(tmp_path, "x, y, angle\n" + rows), NU)
    expected = np.zeros(len(NU), complex)
    for angle, place in zip(angles, 1e-3 * places, strict=True):
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        expected += pw.fourier(PATCH, NU @ turn) * np.exp(-2j * np.pi * NU @ place)
    assert found == pytest.approx(expected, abs=1e-12 * PATCH.area)


def test_elements_that_overlap_are_told_with_their_area(tmp_path: Path) -> None:
    square = pw.shapes.square(1e-3)
    with pytest.warns(PolywignerWarning, match="elements 1 and 2 overlap by 2.5e-07 m") as told:
        _read(tmp_path, "x,y\n0,0\n5,0\n5.5,0.5\n9,0\n9.9,0.9\n", square)
    assert "1 other pair" in str(told[0].message)
    assert len(_read(tmp_path, "x,y\n0,0\n1,0\n0,1\n", square)) == 3  # they touch
    with pytest.warns(PolywignerWarning, match="or more"):
        _read(tmp_path, "x,y\n" + "0,0\n" * 2000, square)


def _overlap_warnings(make: Any) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make()
    return [str(warning.message) for warning in caught]


def test_phased_arrays_and_tables_warn_of_overlaps_in_the_same_words(tmp_path: Path) -> None:
    """Squares of 2 mm every 1.5 mm: 4 x 3 elements, with 17 neighbours and 12 diagonal pairs."""
    square, places = pw.shapes.square(2e-3), pw.arrays.grid_positions(4, 3, 1.5e-3)
    table = "x,y\n" + "".join(f"{1e3 * x},{1e3 * y}\n" for x, y in places)
    (of_array,) = _overlap_warnings(lambda: pw.phased_array(square, places))
    (of_table,) = _overlap_warnings(lambda: _read(tmp_path, table, square))
    assert of_array == of_table
    assert "elements 0 and 1 overlap by 1e-06 m^2, and 28 other pairs" in of_array


def test_overlaps_are_those_of_outlines_and_not_of_their_boxes() -> None:
    """Copies of an L-shape, 3 mm long and 1 mm wide."""
    corner = pw.Aperture([(0, 0), (3e-3, 0), (3e-3, 1e-3), (1e-3, 1e-3), (1e-3, 3e-3), (0, 3e-3)])
    assert not _overlap_warnings(lambda: pw.phased_array(corner, [(0, 0), (1.5e-3, 1.5e-3)]))
    (message,) = _overlap_warnings(lambda: pw.phased_array(corner, [(0, 0), (0.5e-3, 0)]))
    assert "overlap by 3.5e-06 m^2" in message  # 2.5 x 1 mm of the foot and 0.5 x 2 mm of the leg


def test_elements_that_touch_and_arrays_made_of_arrays_do_not_warn() -> None:
    square = pw.shapes.square(1e-3 / 3)
    assert not _overlap_warnings(lambda: pw.phased_array(square, [(k / 3e3, 0) for k in range(9)]))
    with pytest.warns(PolywignerWarning, match="overlap"):
        array = pw.phased_array(square, [(0, 0), (0.1e-3, 0)])
    again = _overlap_warnings(
        lambda: (pickle.loads(pickle.dumps(array)), pw.fourier(array, [0.0, 0.0]))
    )
    assert not again


def test_slits_and_curved_waves_that_overlap_are_reported_as_well() -> None:
    (message,) = _overlap_warnings(lambda: pw.phased_array(pw.Slits([0, 1e-3]), [0, 0.7e-3]))
    assert "elements 0 and 1 overlap by 0.0003 m, counted" in message
    horn = pw.shapes.square(1e-3).curved(20e-3, 4e-3)
    (message,) = _overlap_warnings(lambda: pw.phased_array(horn, [(0, 0), (0.5e-3, 0)]))
    assert "overlap by 5e-07 m^2" in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("x,y\n", "row"),
        ("x,z\n0,0\n", "columns"),
        ("x,x,y\n0,0,0\n", "once"),
        ("x,y,re,phase\n0,0,1,1\n", "once"),
        ("x,y\n0,nan\n", "line 2"),
        ("x,y\n0,1e300\n", "finite"),
        ("x,y\n0,\x1b[31m\n", "characters of text"),
        ("x,y,amplitude\n0,0,0\n", "zero"),
        ("x,y\n" + "1" * 70_000, "characters"),
    ],
)
def test_tables_that_are_none_are_refused_in_a_sentence(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(PolywignerError, match=words) as told:
        _read(tmp_path, text)
    assert "table.csv" in str(told.value) and str(told.value).isprintable()


def test_other_elements_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="Aperture"):
        _read(tmp_path, "x,y\n0,0\n", pw.Slits([0, 1]))
    with pytest.raises(FileFormatError, match="does not exist"):
        pw.arrays.read_elements(tmp_path / "none.csv", PATCH)
    rows = "".join(f"{k},0,{k}\n" for k in range(10_001))
    with pytest.raises(FileFormatError, match="angles of their own"):
        _read(tmp_path, "x,y,angle\n" + rows)
