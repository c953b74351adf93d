"""Where the surface of one source takes away the light of another.

A ray that looks for a surface must find that of a source, or nothing would see it. Mitsuba asks
the same surfaces whether anything stands between a receiver and a light, and has no way to leave
some of them out: no masks of rays, and no shape that answers the two questions differently. So
``direct``, ``path`` and ``prb`` take a surface with a null BSDF for an obstacle to the light that
they sample. ``path`` and ``prb`` meet that light again where a reflected ray passes the surface by
chance: without bias, with noise, and not at the last bounce, for the passage counts as one.
``volpath`` and its like look on behind each null surface.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.mitsuba.placement import PLACE_ERROR, matrix_of

__all__ = ["looks_through", "may_shadow"]

# Those that look behind null surfaces, and the particle tracer, whose light passes them.
_TRANSPARENT = ("Volumetric", "Volpath", "ParticleTracer")


def looks_through(integrator: Any) -> bool:
    """Whether light passes null surfaces on its way to what this integrator shades."""
    # Integrators written in Python share a class name in Mitsuba.
    names = integrator.class_name() + type(integrator).__name__
    return any(name in names for name in _TRANSPARENT)


def may_shadow(scene: Any) -> bool:
    """Whether the null surface of a source stands where another light shines.

    A source shines before its plane: sources side by side in one plane do not meet each other's
    light. The light of an environment is left out: it is often faint, and there for the background.
    """
    lights = [emitter for emitter in scene.emitters() if not emitter.is_environment()]
    for number, source in enumerate(lights):
        if _is_source(source) and _has_null_surface(source):
            corners = _corners(source.get_shape())
            others = lights[:number] + lights[number + 1 :]
            if any(_shines_on(other, corners) for other in others):
                return True
    return False


def _is_source(emitter: Any) -> bool:
    return getattr(type(emitter), "is_wigner", False)


def _has_null_surface(source: Any) -> bool:
    bsdf = source.get_shape().bsdf()
    return source.spec.visible and mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)


def _corners(shape: Any) -> npt.NDArray[np.float64]:
    return np.asarray(mi.traverse(shape)["vertex_positions"], dtype=np.float64).reshape(-1, 3)


def _shines_on(light: Any, points: npt.NDArray[np.float64]) -> bool:
    if not _is_source(light):
        return True
    pose = np.array(matrix_of(light.to_world))
    heights = (points - pose[:3, 3]) @ pose[:3, 2]
    rounding = PLACE_ERROR * max(np.abs(points).max(), np.abs(pose).max())
    return bool(heights.max() > rounding)
