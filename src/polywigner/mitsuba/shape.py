"""The ``wigner`` shape: the mutual support of a source as a mesh that carries the emitter.

A shape rather than an emitter, because in Mitsuba an emitter cannot make the surface it radiates
from. The radiance lives on the automean, the mutual support {(a + b)/2 : a, b in the source}:
for a convex aperture that is the aperture, for two slits it reaches into the gap between them.
Where it would be costly the mesh is the convex hull around it, on the rest of which W is zero.

The surface is there to be hit by rays, not to be seen: its BSDF is ``null`` unless the scene gives
one. What Mitsuba's integrators make of that:

- ``direct``, ``path`` and ``prb`` let it stand in the light of other sources: module `shadows`. A
  source that is not ``visible`` has no surface.
- passing through it counts as a bounce towards ``max_depth``; in scalar variants ``path`` needs a
  ``max_depth`` of 3 to show an aperture that is looked at directly.
- ``path`` leaves a pixel black whose rays meet null surfaces and then nothing at all. To look at an
  aperture itself, put something behind it, be it a faint ``constant`` emitter. An
  ``irradiancemeter`` that looks at it reads exactly zero for the same reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mitsuba as mi

from polywigner.errors import SceneError
from polywigner.geometry import triangulate
from polywigner.mitsuba.emitter import emitter_class
from polywigner.mitsuba.parameters import EmitterSpec, read_parameters
from polywigner.mitsuba.placement import cover, hide
from polywigner.mitsuba.plugins import add_plugin

__all__ = ["PLUGIN_NAME", "check_nested"]

PLUGIN_NAME = "wigner"


def check_nested(names: Iterable[str], visible: bool) -> None:
    """Raise SceneError for anything nested in a shape without a surface."""
    for name in () if visible else names:
        raise SceneError(
            f"expected nothing nested in a wigner shape that is not visible, got {name!r}; leave "
            "it out, or make the shape visible"
        )


def _build(variant: str, props: Any) -> Any:
    """The mesh for the parameters of one ``wigner`` element."""
    return _mesh(variant, props, read_parameters(props))


def _mesh(variant: str, props: Any, spec: EmitterSpec) -> Any:
    m = getattr(mi, variant)
    vertices, triangles = triangulate(spec.radiator.support)
    inner = mi.Properties(PLUGIN_NAME)
    inner.set_id(props.id())
    nested = dict(props.objects())
    check_nested(nested, spec.visible)
    for name, value in nested.items():
        inner[name] = value
    if not any(isinstance(value, m.BSDF) for value in nested.values()):
        inner["bsdf"] = mi.load_dict({"type": "null"})
    inner["emitter"] = emitter_class(variant)(spec, id=f"{props.id()}_emitter")
    mesh = m.Mesh(
        props.id() or PLUGIN_NAME,
        len(vertices),
        len(triangles),
        props=inner,
        has_vertex_texcoords=True,
    )
    centre = spec.radiator.centre / spec.scene_unit
    cover(mesh, spec.radiator.support, spec.pose, centre, spec.scene_unit)
    if not spec.visible:
        hide(mesh)
    return mesh


add_plugin("shape", PLUGIN_NAME, _build)
