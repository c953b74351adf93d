"""Systems on the command line."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main
from polywigner.cli.transform import system_from


def test_the_light_passes_parts_in_the_order_of_the_text() -> None:
    space, lens = pw.FirstOrder.free_space(0.05), pw.FirstOrder.lens(0.08)
    assert system_from("space 50 mm, lens 8 cm") == lens @ space
    assert system_from("lens 80 mm inf, turn 90 deg") == pw.FirstOrder.rotation(
        np.pi / 2
    ) @ pw.FirstOrder.lens((0.08, np.inf))
    assert system_from("magnifier -2, fourier 0.1, fractional 0.5 20 mm") == (
        pw.FirstOrder.fractional(0.5, 0.02)
        @ pw.FirstOrder.fourier(0.1)
        @ pw.FirstOrder.magnifier(-2)
    )


def test_transform_writes_a_picture_and_the_values_behind_a_system(tmp_path) -> None:
    outline = tmp_path / "square.wkt"
    outline.write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    given = ["transform", str(outline), "--unit", "mm", "--samples", "33"]
    given += ["--through", "fourier 50 mm", "--out", str(tmp_path / "behind.png")]
    assert main([*given, "--frequency", "94 GHz"]) == 0
    assert (tmp_path / "behind.png").stat().st_size > 1e4
    with np.load(tmp_path / "behind.npz") as found:
        wavelength = float(found["wavelength"])
        points = np.stack(np.meshgrid(found["across"], found["up"]), axis=-1)
        light = abs(pw.fourier(pw.shapes.square(0.01), points / (0.05 * wavelength))) ** 2
        assert found["light"] == pytest.approx(light / (0.05 * wavelength) ** 2, rel=1e-6, abs=1e-9)
        assert np.array_equal(found["matrix"], pw.FirstOrder.fourier(0.05).matrix)
