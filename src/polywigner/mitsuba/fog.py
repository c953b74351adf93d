"""Where fog reaches into the near zone of a receiver.

The estimator ``exact`` weighs a ray by the field at the surface that it meets, not by that at the
drops on its way, which scatter light as well. Where r |U| no longer depends on the distance r, in
the far zone, both are the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from polywigner.mitsuba.receiver import is_receiver

__all__ = ["is_fog_near"]


def is_fog_near(scene: Any, sensor: Any) -> bool:
    """Whether fog is nearer to a receiver of exact weights than 2 D^2/wavelength (Fraunhofer)."""
    if not is_receiver(sensor) or sensor.spec.estimator != "exact":
        return False
    if sensor.get_medium() is not None:
        return True
    spec = sensor.spec
    size = np.ptp(np.reshape(spec.source.bounds, (2, 2)), axis=0)
    far = 2 * float(size @ size) / spec.wavelength / spec.scene_unit
    middle = spec.pose[:3] @ [*(spec.radiator.centre / spec.scene_unit), 0.0, 1.0]
    bounds = (shape.bbox() for shape in scene.shapes() if shape.is_medium_transition())
    return any(float(box.distance(middle.tolist())) < far for box in bounds)
