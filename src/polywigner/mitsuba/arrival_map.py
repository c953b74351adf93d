"""The scattered power of a receiver by the directions that it comes from, for pictures."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.mitsuba.images import mean_of_colours, silent
from polywigner.mitsuba.parts import film_of, seed_of
from polywigner.mitsuba.range_film import is_transient
from polywigner.mitsuba.received_power import receivers_of
from polywigner.mitsuba.receiver import RECEIVER_NAME, receiver_class
from polywigner.mitsuba.rendering import default_integrator
from polywigner.mitsuba.scattered import unseen

# Pixels on a side, and samples of each: some seconds at most, in scalar variants too.
_FINE, _COARSE = (64, 64), (24, 4)


def arrival_map(scene: Any, receiver: int, seed: int = 0) -> NDArray[np.float64]:
    """W (n, n) that surfaces, fog and incoherent lights send from each direction, sources unseen.

    Over direction cosines of the receiver's frame, from -1 to 1: columns along x, rows along y. For
    a receiver by its number among those of the scene; its own film stays as it is.
    """
    _, own = receivers_of(scene)[receiver]
    size, spp = _FINE if dr.is_jit_v(mi.Float) else _COARSE
    props = mi.Properties(RECEIVER_NAME)
    props.set_id(own.id())
    props["film"] = mi.load_dict(film_of(size, size))
    sensor = receiver_class(mi.variant())(own.spec, props)
    sensor.scene = scene
    try:
        with unseen(scene), silent():
            integrator = scene.integrator()
            if integrator is None or is_transient(integrator):
                integrator = mi.load_dict({"type": default_integrator(scene)})
            own = seed_of(seed)
            found = mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=own)
            image = np.array(found, dtype=np.float64)
    finally:
        sensor.scene = None  # or it would keep the scene alive
    return mean_of_colours(image)
