"""The power that surfaces and fog scatter to a receiver, with its standard error.

Samples come in batches with seeds of their own, and the spread of the batches is the error. Paths
do not depend on the power of a source: with one seed, the render by one source and the other
lights, less the render by the other lights alone, is what that source gives, sample by sample.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.mitsuba.rendering import check_seed, check_spp, render
from polywigner.mitsuba.unseen import lit_by, wigner_emitters

__all__ = ["BATCHES", "batches_of", "scattered_batches"]

Floats = NDArray[np.float64]

# Their spread tells the standard error to 18 %.
BATCHES = 16


def batches_of(spp: int) -> int:
    """Samples in each of 16 batches, for ``spp`` or a few more in all."""
    return -(-check_spp(spp) // BATCHES)


def scattered_batches(
    scene: Any,
    sensor: int,
    integrator: Any,
    spp: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Floats, Floats]:
    """W that each batch finds: (emitters, 16) of each coherent source, and (16,) of other lights.

    Of a scene whose sources are unseen (:func:`unseen`). ``spp``: samples in all, a multiple of 16
    or rounded up. ``progress``: called with the numbers of renders done and in all.
    """
    check_seed(seed)
    sources = wigner_emitters(scene)
    has_others = len(sources) < len(scene.emitters())
    lights = ([None] if has_others else []) + sources
    found = np.zeros((len(lights), BATCHES))
    samples = batches_of(spp)
    for batch in range(BATCHES):
        own = int(np.random.SeedSequence(seed, spawn_key=(batch,)).generate_state(1)[0])
        for number, light in enumerate(lights):
            with lit_by(sources, light):
                found[number, batch] = _watts(render(scene, integrator, samples, own, sensor))
            if progress is not None:
                progress(batch * len(lights) + number + 1, BATCHES * len(lights))
    if not has_others:
        return found, np.zeros(BATCHES)
    return found[1:] - found[0], found[0]


def _watts(image: NDArray[Any]) -> float:
    """The sum over pixels, of colours their mean."""
    colours = 3 if image.shape[-1] >= 3 else 1
    return float(image[..., :colours].astype(np.float64).mean(axis=-1).sum())
