"""Sources that light a scene and are not seen, for the light that surfaces scatter.

What comes straight from a source to a receiver is a link of two coherent fields, which is computed
exactly (module `links`) and must not be counted again by rays that meet the source. Nor may its
null surface stand in the way of other light. So for a while each source shines as one that is not
``visible``, and its surface is so small that no ray finds it: Mitsuba cannot take it away.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["lit_by", "unseen", "wigner_emitters"]

# Of the size of a surface: its share of rays is the square, and those that meet it read zero.
_SHRUNK = 1e-3


def wigner_emitters(scene: Any) -> list[Any]:
    """The coherent sources of a scene, in its order."""
    return [emitter for emitter in scene.emitters() if getattr(type(emitter), "is_wigner", False)]


@contextmanager
def unseen(scene: Any) -> Iterator[None]:
    """Within, coherent sources light the scene but rays that meet them read nothing.

    Those with a null BSDF are no obstacles either. All is put back at the end, whatever ends it;
    render kernels are compiled once for each of both states.
    """
    sources = wigner_emitters(scene)
    specs = [source.spec for source in sources]
    shapes = [source.get_shape() for source in sources if _is_transparent(source)]
    places = [_positions(shape) for shape in shapes]
    try:
        for source, spec in zip(sources, specs, strict=True):
            source.spec = replace(spec, visible=False)
        _move(scene, shapes, [_shrunk(place) for place in places])
        yield
    finally:
        # while nothing is visible: a mesh elsewhere than its emitter would be refused
        _move(scene, shapes, places)
        for source, spec in zip(sources, specs, strict=True):
            source.spec = spec


@contextmanager
def lit_by(sources: Sequence[Any], lit: Any) -> Iterator[None]:
    """Within, all of these sources but ``lit`` (None: all of them) have a power of zero."""
    dark = [source for source in sources if source is not lit]
    powers = [source.power for source in dark]
    try:
        for source in dark:
            source.power = _zero_like(source.power)
        yield
    finally:
        for source, power in zip(dark, powers, strict=True):
            source.power = power


def _is_transparent(source: Any) -> bool:
    flags = source.get_shape().bsdf().flags()
    return source.spec.visible and mi.has_flag(flags, mi.BSDFFlags.Null)


def _zero_like(power: Any) -> Any:
    zero = type(power)(0.0)
    if dr.is_jit_v(zero):
        dr.make_opaque(zero)  # as a literal, it would compile the render kernel again
    return zero


def _positions(shape: Any) -> list[float]:
    positions = dr.detach(mi.traverse(shape)["vertex_positions"])
    result: list[float] = np.asarray(positions, dtype=np.float64).ravel().tolist()
    return result


def _shrunk(positions: list[float]) -> list[float]:
    points = np.reshape(positions, (-1, 3))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    result: list[float] = (middle + _SHRUNK * (points - middle)).ravel().tolist()
    return result


def _move(scene: Any, shapes: list[Any], places: list[list[float]]) -> None:
    for shape, place in zip(shapes, places, strict=True):
        params = mi.traverse(shape)
        params["vertex_positions"] = place
        params.update()
    scene.parameters_changed([])  # rays are traced among surfaces where they are now
