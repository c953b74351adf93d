"""``make paper-figures``: files, letters of panels, and numbers in captions."""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from string import ascii_lowercase

import matplotlib.pyplot as plt
import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import use

sys.path.append(str(Path(__file__).parents[1]))

from paper.figures import FIGURES, make_figure
from paper.figures.__main__ import write
from paper.figures.scenes import intensity_by_fft
from paper.figures.sources import WAVELENGTH, square

Values = dict[str, np.ndarray]


def check_volrender_fdtd(values):
    """Kirchhoff's integral is exact behind a black screen; the lattice causes the difference."""
    axes = [values["x"][35::7], values["y"][35::7], values["z"][::6]]  # from the centre outwards
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    exact = pw.irradiance(square(), points, WAVELENGTH, "kirchhoff")
    peak = values["fdtd"].max()
    assert np.abs(values["fdtd"][35::7, 35::7, ::6] - exact).max() < 0.06 * peak
    assert np.abs(values["rays"] - values["fdtd"]).max() < 0.16 * peak
    assert np.array_equal(values["fdtd"], values["fdtd"][::-1, ::-1])


def levels_apart(first, second):
    """Return the level difference of means over the beam, above -10 dB of the peak."""
    beam = second > 0.1 * np.quantile(second, 0.999)
    return abs(10 * np.log10(first[beam].mean() / second[beam].mean()))


def check_emitters(values):
    """At equal power, a cosine source is twice as bright near the axis as a uniform source."""
    assert levels_apart(values["wigner"], values["fft"]) < 0.1
    ratio = values["cosine"] / np.where(values["uniform"] > 0, values["uniform"], np.inf)
    beam = values["fft"] > 0.5 * np.quantile(values["fft"], 0.999)
    assert 1.9 < np.median(ratio[beam]) < 2.0
    theta = np.radians([0.0, 5, 12, 27, 40])
    sines = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    exact = pw.radiant_intensity(square(), sines, WAVELENGTH)
    # The error is due to a raster of 25 cells, and to linear interpolation between frequencies.
    assert np.abs(intensity_by_fft(sines) - exact).max() < 0.02 * exact.max()


def check_error(values):
    """The error on the axis decreases as the square of the distance."""
    (paper, matched, _, fraunhofer), far = values["boresight_error"], values["distance"]
    fit = far > 20
    for errors in (matched, fraunhofer):
        slope = np.polyfit(np.log(far[fit]), np.log(np.abs(errors[fit])), 1)[0]
        assert -2.1 < slope < -1.9
    beside = values["arc_rms"][:, -1]
    assert beside[1] < beside[0] / 10
    assert np.abs(paper - matched)[far > 3].max() < 0.01


CHECKS: dict[str, Callable[[Values], None]] = {
    "volrender_fdtd": check_volrender_fdtd,
    "emitters": check_emitters,
    "error": check_error,
}


RENDERED = {"render", "emitters"}  # minutes without LLVM
SHORT = {"indmk", "xforms"}


def marks(name):
    return [pytest.mark.llvm] * (name in RENDERED) + [pytest.mark.slow] * (name not in SHORT)


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks(name)) for name in FIGURES])
def test_a_figure_is_written_with_its_numbers_which_captions_agree_with(name, tmp_path):
    if name in RENDERED:  # Other tests leave a scalar variant, which takes minutes.
        use("llvm_ad_mono")
    made = make_figure(name)
    write(tmp_path, name, made, 150)
    parts = FIGURES[name].parts
    stems = [f"{name}_{part}" if part else name for part in parts]
    pictures = [tmp_path / f"{stem}.png" for stem in stems]
    expected = [*pictures, *(path.with_suffix(".pdf") for path in pictures)]
    assert sorted(tmp_path.iterdir()) == sorted([*expected, tmp_path / f"{name}.npz"])
    with np.load(tmp_path / f"{name}.npz") as file:  # plain arrays without pickle
        values = dict(file)
    metadata = json.loads(str(values.pop("metadata")))
    assert set(metadata["about"]) == set(values)
    if name in CHECKS:
        CHECKS[name](values)
    for picture, part, figure in zip(pictures, parts, made.figures.values(), strict=True):
        check_nothing_is_cut_off(picture)
        check_panels_have_letters(figure, part)


def check_nothing_is_cut_off(picture):
    """The outermost pixels are white unless a label exceeds the figure."""
    pixels = plt.imread(picture)[..., :3]
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert edge.min() == 1.0, picture.name


def check_panels_have_letters(figure, part):
    """Letters (a), (b), ... of panels, or (a1), (a2), ... within a part (a)."""
    panels = [axes for axes in figure.axes if axes.get_title() or axes.get_title(loc="left")]
    if len(panels) < 2:
        return
    letters = [re.search(r"\((\w+)\)", axes.get_title(loc="left")) for axes in panels]
    names = [f"{part}{k}" for k in range(1, 10)] if part else list(ascii_lowercase)
    assert [letter[1] for letter in letters if letter] == names[: len(panels)]
