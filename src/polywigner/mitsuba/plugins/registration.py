"""Plugins made known to every variant of Mitsuba, and their errors while a scene is loaded.

A plugin is a class with its methods at module level, such as ``WignerEmitter``. Mitsuba's base
class exists once per variant: `variant_class` makes the subclass that binds both.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import PolywignerError, SceneError
from polywigner.execution import uncompiled
from polywigner.geometry.io.readers import read_triangles

Logic = TypeVar("Logic")

# Mitsuba wraps an exception of a plugin into a RuntimeError with a traceback in its text. The
# exceptions are kept here for the scene's loader. Loaders may run in parallel.
_recent_errors: deque[PolywignerError] = deque(maxlen=8)
# Each kernel is traced through all living emitters and shapes, those that another thread is just
# making included: values would be wrong without an error.
_alone = threading.RLock()
_plugins: dict[tuple[str, str], Callable[[str, Any], Any]] = {}


class VariantPlugin:
    """Base of classes with the methods of a plugin; `variant_class` sets its attributes."""

    m: Any
    """Variant of Mitsuba."""
    jit: bool
    """Whether the variant compiles."""
    base: Any
    """Class of the variant that the plugin extends."""


@cache
def variant_class(logic: type[Logic], base: str | type, variant: str) -> type[Logic]:
    """Return the class of a plugin for one variant; the same class on every call.

    Parameters
    ----------
    logic : class with the methods, a `VariantPlugin`.
    base : name of Mitsuba's base class, such as "Emitter", or a class of the variant.
    variant : name of the variant.

    The methods are copied: a class of Mitsuba can be the only base of a Python class.
    """
    m = getattr(mi, variant)
    parent: type = getattr(m, base) if isinstance(base, str) else base
    members = {
        name: member
        for cls in reversed(logic.__mro__[:-1])
        for name, member in vars(cls).items()
        if name not in ("__dict__", "__weakref__")
    }
    bound = {"m": m, "jit": dr.is_jit_v(m.Float), "variant": variant, "base": parent}
    found: type[Logic] = type(parent)(logic.__name__, (parent,), members | bound)
    return found


@contextmanager
def exclusive() -> Iterator[None]:
    """Let no other thread load or render scenes by this package until the block ends.

    Mitsuba is not made for scenes that are loaded in one thread while another one renders. The
    functions of this package wait for each other; whoever calls Mitsuba itself in several threads
    (``mi.load_dict``, ``mi.render``) does so within this.

    >>> import polywigner.mitsuba as pm
    >>> with pm.exclusive():
    ...     pass  # scene = mi.load_dict(...)
    """
    with _alone:
        yield


one_at_a_time = exclusive()
"""Decorator of functions that wait until no other thread is at work on a scene."""


def add_plugin(kind: str, name: str, build: Callable[[str, Any], Any]) -> None:
    """Add a plugin for :func:`register`, which ``build(variant, properties)`` makes."""
    _plugins[kind, name] = build


def register() -> None:
    """Make the plugins known to every Mitsuba variant, those chosen later included."""
    mi.detail.add_variant_callback(_on_variant_change)
    if mi.variant() is not None:
        _on_variant_change(None, mi.variant())


def original_error(error: BaseException) -> PolywignerError | None:
    """Return the package's error that caused an error of Mitsuba's loader, or None."""
    text = str(error)
    return next((cause for cause in reversed(_recent_errors) if str(cause) in text), None)


def _on_variant_change(_old: str | None, new: str) -> None:
    # Mitsuba looks a plugin's kind up under scalar_rgb whatever the variant. Unknown there, two
    # equal shapes would count as one shared object and fail to load.
    for variant in ("scalar_rgb", new):
        for (kind, name), build in _plugins.items():
            register_one = getattr(getattr(mi, variant), f"register_{kind}")
            register_one(name, partial(_built, build, variant))


def _built(build: Callable[[str, Any], Any], variant: str, props: Any) -> mi.Object:
    try:
        with uncompiled():
            return build(variant, props)
    except PolywignerError as error:
        _recent_errors.append(error)
        # Mitsuba puts the traceback before the message, where frames of this package are no help.
        raise error.with_traceback(None) from None


def nested_properties(name: str, props: Any) -> mi.Properties:
    """Return properties of a plugin with the id and the nested objects of others."""
    inner = mi.Properties(name)
    inner.set_id(props.id())
    for key, value in dict(props.objects()).items():
        inner[key] = value
    return inner


STL = "stl"


def _build_stl(variant: str, props: Any) -> mi.Mesh:
    """Return the mesh of an STL file with flat faces; its numbers are units of the scene."""
    path = str(mi.file_resolver().resolve(props["filename"]))
    vertices, triangles = read_triangles(path, "m")
    matrix = np.eye(4)
    if "to_world" in props:
        matrix = np.array(props["to_world"].matrix, np.float64).reshape(4, 4)
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if not (np.abs(vertices) <= np.finfo(np.float32).max).all() or not len(triangles):
        raise SceneError(f"expected finite triangles of {path}, got none or others; export it anew")
    if np.linalg.det(matrix[:3, :3]) < 0:  # normals of mirrored bodies point outwards
        triangles = triangles[:, ::-1]
    name, sizes = props.id() or STL, (len(vertices), len(triangles))
    mesh = getattr(mi, variant).Mesh(name, *sizes, props=nested_properties(STL, props))
    params = mi.traverse(mesh)
    params["vertex_positions"] = vertices.ravel().tolist()
    params["faces"] = triangles.ravel().tolist()
    params.update()
    return mesh


add_plugin("shape", STL, _build_stl)
