"""The plugins made known to Mitsuba, and the errors that they raise while a scene is loaded."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from typing import Any, ParamSpec, TypeVar

import mitsuba as mi
import numpy as np

from polywigner.errors import PolywignerError, SceneError
from polywigner.execution import uncompiled
from polywigner.geometry import triangulate
from polywigner.geometry.io.readers import read_triangles
from polywigner.mitsuba.emitter import emitter_class
from polywigner.mitsuba.parameters import SceneParameters, read_emitter, values_of
from polywigner.mitsuba.placement import cover, hide
from polywigner.mitsuba.polarisation import polarised_spec

# Mitsuba wraps what a plugin raises into a RuntimeError with a traceback in its text. The errors
# themselves wait here until the scene's loader asks for them; loaders may run in parallel.
_recent_errors: deque[PolywignerError] = deque(maxlen=8)
# Each kernel is traced through all emitters and shapes alive, those that another thread is just
# making included: values would be wrong without a word.
_alone = threading.RLock()
_plugins: dict[tuple[str, str], Callable[[str, Any], Any]] = {}


P = ParamSpec("P")
R = TypeVar("R")


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


def one_at_a_time(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function, made to wait until no other thread is at work on a scene."""

    @wraps(function)
    def waiting(*arguments: P.args, **options: P.kwargs) -> R:
        with _alone:
            return function(*arguments, **options)

    return waiting


def add_plugin(kind: str, name: str, build: Callable[[str, Any], Any]) -> None:
    """A plugin for :func:`register`: ``build(variant, properties)`` makes one."""
    _plugins[kind, name] = build


def register() -> None:
    """Make the plugins known to every Mitsuba variant, those chosen later included."""
    mi.detail.add_variant_callback(_on_variant_change)
    if mi.variant() is not None:
        _on_variant_change(None, mi.variant())


def original_error(error: BaseException) -> PolywignerError | None:
    """The package's own error behind one that Mitsuba raised while loading, if there is one."""
    text = str(error)
    return next((own for own in reversed(_recent_errors) if str(own) in text), None)


def _on_variant_change(_old: str | None, new: str) -> None:
    # Mitsuba looks a plugin's kind up under scalar_rgb whatever the variant. Unknown there, two
    # equal shapes would count as one shared object and fail to load.
    for variant in ("scalar_rgb", new):
        for (kind, name), build in _plugins.items():
            register_one = getattr(getattr(mi, variant), f"register_{kind}")
            register_one(name, partial(_built, build, variant))


def _built(build: Callable[[str, Any], Any], variant: str, props: Any) -> Any:
    try:
        with uncompiled():
            return build(variant, props)
    except PolywignerError as error:
        _recent_errors.append(error)
        # Mitsuba puts the traceback before the message, where frames of this package are no help.
        raise error.with_traceback(None) from None


def nested_properties(name: str, props: Any) -> Any:
    """Properties of a plugin with the id and the nested objects of others."""
    inner = mi.Properties(name)
    inner.set_id(props.id())
    for key, value in dict(props.objects()).items():
        inner[key] = value
    return inner


PLUGIN_NAME = "wigner"


def _build(variant: str, props: Any) -> Any:
    """The mesh for the parameters of one ``wigner`` element."""
    spec = read_emitter(values_of(props))
    spec = polarised_spec(variant, spec, "wigner shape")
    m = getattr(mi, variant)
    vertices, triangles = triangulate(spec.centred.support)
    inner = nested_properties(PLUGIN_NAME, props)
    if not any(isinstance(value, m.BSDF) for _, value in props.objects()):
        inner["bsdf"] = mi.load_dict({"type": "null"})
    inner["emitter"] = emitter_class(variant)(spec, id=f"{props.id()}_emitter")
    mesh = m.Mesh(
        props.id() or PLUGIN_NAME,
        len(vertices),
        len(triangles),
        props=inner,
        has_vertex_texcoords=True,
    )
    centre = spec.centred.centre / spec.scene_unit
    cover(mesh, spec.centred.support, spec.pose, centre, spec.scene_unit)
    if not spec.visible:
        hide(mesh)
    return mesh


add_plugin("shape", PLUGIN_NAME, _build)


STL_NAME = "stl"


def _build_stl(variant: str, props: Any) -> Any:
    """The mesh of an STL file, whose numbers are units of the scene, with its faces flat."""
    given = SceneParameters(values_of(props), f"{STL_NAME} shape")
    given.check_names(("filename", "to_world"))
    path = str(mi.file_resolver().resolve(given.text("filename", None)))
    vertices, triangles = read_triangles(path, "m")
    matrix = np.eye(4)
    if "to_world" in given.values:
        matrix = np.array(given.values["to_world"].matrix, np.float64).reshape(4, 4)
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if not (np.abs(vertices) <= np.finfo(np.float32).max).all() or not len(triangles):
        raise SceneError(f"expected finite triangles of {path}, got none or others; export it anew")
    if np.linalg.det(matrix[:3, :3]) < 0:  # outsides stay outsides in mirror images
        triangles = triangles[:, ::-1]
    inner = nested_properties(STL_NAME, props)
    mesh = getattr(mi, variant).Mesh(
        props.id() or STL_NAME, len(vertices), len(triangles), props=inner
    )
    params = mi.traverse(mesh)
    params["vertex_positions"] = vertices.ravel().tolist()
    params["faces"] = triangles.ravel().tolist()
    params.update()
    return mesh


add_plugin("shape", STL_NAME, _build_stl)
