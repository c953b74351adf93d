"""Curved waves in scenes: the radiance of emitters, what a floor gets of them, and receivers."""

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import (
    MILLIMETRE,
    MONO,
    RADIANCE_ERROR,
    WAVELENGTH,
    draws,
    emitter_of,
    evaluated,
    light,
    use,
)
from polywigner.errors import SceneError

pytestmark = pytest.mark.drjit

HORN = (
    pw.shapes.rectangle(12e-3, 8e-3)
    .with_illumination(pw.te_mode(12e-3, 8e-3))
    .curved((0.03, 0.05), WAVELENGTH, (1e-3, 0.0))
    .moved((2e-3, 1e-3))
)
MIDDLE = np.array([2e-3, 1e-3])


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_the_radiance_of_a_curved_wave_is_its_wigner_function_times_the_cosine(variant):
    mi = use(variant)
    x, direction = draws(10, 0.005)
    seen = evaluated(mi, emitter_of(light(HORN)), x / MILLIMETRE, direction)
    expected = pw.radiance(HORN, x + MIDDLE, direction, WAVELENGTH) * direction[:, 2]
    scale = 4 * HORN.area / WAVELENGTH**2
    assert np.abs(seen - expected[:, None]).max() < RADIANCE_ERROR * scale


def test_obliquities_that_take_slopes_are_refused_in_one_sentence():
    use("scalar_rgb")
    import polywigner.mitsuba as scenes

    entries: list[Any] = [scenes.aperture, scenes.receiver]
    for entry in entries:
        with pytest.raises(SceneError, match="for a curved wave"):
            entry(HORN, WAVELENGTH, estimator="wigner", obliquity="kirchhoff")
