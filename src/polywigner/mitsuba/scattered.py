"""The power that surfaces and fog scatter to a receiver, with its standard error.

Samples come in batches with seeds of their own, and the spread of the batches is the error. Paths
do not depend on the power of a source: with one seed, the render by one source and the other
lights, less the render by the other lights alone, is what that source gives, sample by sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.mitsuba.images import mean_of_colours
from polywigner.mitsuba.parts import seed_of
from polywigner.mitsuba.rendering import check_spp, exposed
from polywigner.mitsuba.sent_scenes import check_is_whole
from polywigner.mitsuba.unseen import lit_by, wigner_emitters

__all__ = ["BATCHES", "Scattering", "batches_of", "lights_of", "shares_of", "standard_error"]

Floats = NDArray[np.float64]

# Their spread tells the standard error to 18 %.
BATCHES = 16


def batches_of(spp: int) -> int:
    """Samples in each of 16 batches, for ``spp`` or a few more in all."""
    return -(-check_spp(spp) // BATCHES)


@dataclass(frozen=True)
class Scattering:
    """How what is scattered to one receiver is sampled, in a scene whose sources are unseen."""

    sensor: int
    integrator: Any
    spp: int
    """Samples of all batches, as asked."""
    seed: int

    @property
    def values(self) -> tuple[int, ...]:
        """Shape of what a batch finds of each light, one number."""
        return ()

    def batch(
        self, scene: Any, number: int, done: Callable[[], None] = lambda: None
    ) -> NDArray[np.float64]:
        """W that one batch finds of each of :func:`lights_of`; ``done`` is called after each.

        Raises what :func:`polywigner.mitsuba.render` does.
        """
        sources = wigner_emitters(scene)
        own = seed_of(self.seed, number)
        exposure = exposed(scene, self.integrator, batches_of(self.spp), own, self.sensor)
        found = []
        for light in lights_of(scene):
            with lit_by(sources, light):
                image = exposure.picture(lambda: None)
            check_is_whole(exposure.integrator)
            found.append(float(mean_of_colours(image).sum()))
            done()
        return np.array(found)


def lights_of(scene: Any) -> list[Any]:
    """What shines in turns: None, all but the coherent sources, where there are such; each source.

    Other lights shine all the time.
    """
    sources = wigner_emitters(scene)
    return ([None] if len(sources) < len(scene.emitters()) else []) + sources


def shares_of(scene: Any, found: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """W of each coherent source (emitters, batches), and of other lights (batches,).

    ``found`` : of all batches (batches, lights); more axes behind these stay.
    """
    if len(lights_of(scene)) == len(wigner_emitters(scene)):
        return np.moveaxis(found, 1, 0), np.zeros_like(found[:, 0])
    return np.moveaxis(found[:, 1:] - found[:, :1], 1, 0), found[:, 0]


def standard_error(batches: Floats, axis: int = 0) -> Any:
    """Of the mean of equal batches."""
    return np.std(batches, ddof=1, axis=axis) / math.sqrt(batches.shape[axis])
