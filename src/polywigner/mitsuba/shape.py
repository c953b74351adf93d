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

import threading
from collections import deque
from collections.abc import Iterable
from functools import partial
from typing import Any

import mitsuba as mi

from polywigner.errors import PolywignerError, SceneError
from polywigner.geometry import triangulate
from polywigner.mitsuba.emitter import emitter_class
from polywigner.mitsuba.parameters import EmitterSpec, read_parameters
from polywigner.mitsuba.placement import cover, hide

__all__ = ["PLUGIN_NAME", "check_nested", "original_error", "register"]

PLUGIN_NAME = "wigner"

# Mitsuba wraps what a plugin raises into a RuntimeError with a traceback in its text. The errors
# themselves wait here until the scene's loader asks for them; loaders may run in parallel.
_recent_errors: deque[PolywignerError] = deque(maxlen=8)
_registered: set[str] = set()
_lock = threading.Lock()


def register() -> None:
    """Make the shape known to every Mitsuba variant, those chosen later included."""
    mi.detail.add_variant_callback(_on_variant_change)
    if mi.variant() is not None:
        _on_variant_change(None, mi.variant())


def original_error(error: BaseException) -> PolywignerError | None:
    """The package's own error behind one that Mitsuba raised while loading, if there is one."""
    text = str(error)
    return next((own for own in reversed(_recent_errors) if str(own) in text), None)


def check_nested(names: Iterable[str], visible: bool) -> None:
    """Raise SceneError for anything nested in a shape without a surface."""
    for name in () if visible else names:
        raise SceneError(
            f"expected nothing nested in a wigner shape that is not visible, got {name!r}; leave "
            "it out, or make the shape visible"
        )


def _on_variant_change(_old: str | None, new: str) -> None:
    # Mitsuba looks a plugin's kind up under scalar_rgb whatever the variant. Unknown there, two
    # equal shapes would count as one shared object and fail to load.
    for variant in ("scalar_rgb", new):
        getattr(mi, variant).register_shape(PLUGIN_NAME, partial(_build, variant))


def _build(variant: str, props: Any) -> Any:
    """The mesh for the parameters of one ``wigner`` element."""
    try:
        spec = read_parameters(props)
        return _mesh(variant, props, spec)
    except PolywignerError as error:
        _recent_errors.append(error)
        # Mitsuba puts the traceback before the message, where frames of this package are no help.
        raise error.with_traceback(None) from None


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
