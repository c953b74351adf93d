"""The picture of a source before and behind a first-order system."""

import numpy as np
import pytest

import polywigner as pw
from polywigner import figures
from polywigner.errors import ArgumentError
from polywigner.figures.transforms import default_position

WAVELENGTH = 3.19e-3
TEE = pw.Aperture(
    [(-4e-3, -5e-3), (6e-3, -5e-3), (6e-3, -1e-3), (1e-3, -1e-3), (1e-3, 4e-3), (-4e-3, 4e-3)]
)
SYSTEM = pw.FirstOrder.free_space(0.05) @ pw.FirstOrder.lens(0.03)


def test_the_section_behind_is_the_one_before_along_rays() -> None:
    found = figures.system_slices(TEE, SYSTEM, WAVELENGTH, samples=33)
    inside = tuple(np.argwhere(abs(found.before) > 1e-6).mean(axis=0).astype(int))
    assert found.before[inside] != 0.0
    # every third sample behind, traced back, lies in the section before
    x, s = np.meshgrid(found.x_out[::3], WAVELENGTH * found.nu_out[::3])
    place = pw.automean(TEE)
    middle = np.array(default_position(place, TEE.centre))
    y_out, s_out = SYSTEM.rays(middle, np.zeros(2))
    back, slope = SYSTEM.inverse.rays(
        np.stack([x, 0 * x + y_out[1]], axis=-1), np.stack([s, 0 * s + s_out[1]], axis=-1)
    )
    expected = pw.wigner(TEE, back, slope / WAVELENGTH)
    assert found.behind[::3, ::3] == pytest.approx(expected, abs=1e-12 * TEE.area)
    assert np.count_nonzero(expected) > 5


def test_the_light_is_the_irradiance_where_most_of_it_goes() -> None:
    found = figures.system_slices(TEE, SYSTEM, WAVELENGTH, samples=41)
    step = (found.across[1] - found.across[0]) * (found.up[1] - found.up[0])
    share = found.light.sum() * step / TEE.area
    assert 0.7 < share < 1.0
    at = (found.across[7], found.up[30])
    light = pw.irradiance(TEE, at, WAVELENGTH, through=SYSTEM)
    assert found.light[30, 7] == pytest.approx(light, abs=1e-5)


def test_it_is_drawn_as_four_panels() -> None:
    slices = figures.system_slices(TEE, SYSTEM, WAVELENGTH, samples=17)
    drawn = figures.draw_transforms(slices, -30.0, "an L")
    titles = [axes.get_title() for axes in drawn.axes if axes.get_title()]
    assert titles == ["aperture", "W(x, ν) before", "|U|² behind", "W(x, ν) behind"]
    assert "an L" in drawn.get_suptitle() and "dotted" not in drawn.get_suptitle()


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ArgumentError, match="from 2 to"):
        figures.system_slices(TEE, SYSTEM, WAVELENGTH, samples=1)
