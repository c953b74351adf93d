"""Registration of plugins, of their errors, and of sources in memory."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import PolywignerError, SceneError
from polywigner.execution import uncompiled
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront
from polywigner.geometry.io.readers import read_triangles
from polywigner.source import Array
from polywigner.source.source_files import source_json

Logic = TypeVar("Logic")
_Build = Callable[[str, mi.Properties], mi.Object]

# Mitsuba converts exceptions of plugins to text. The scene loader finds the original exceptions in
# this queue, even if several loaders run in parallel.
_recent_errors: deque[PolywignerError] = deque(maxlen=8)
# Mitsuba's kernels contain all emitters and shapes in memory, including unfinished objects of other
# threads. Therefore only one thread at a time may use scenes.
_scene_lock = threading.RLock()
_plugins: dict[tuple[str, str], _Build] = {}


class VariantPlugin:
    """Base class of plugins; `variant_class` sets its attributes."""

    m: Any
    """Mitsuba module of the variant."""
    jit: bool
    """Whether the variant compiles kernels."""
    base: Any
    """Class of Mitsuba that the plugin extends."""


@cache
def variant_class(logic: type[Logic], base: str | type, variant: str) -> type[Logic]:
    """Return the class of a plugin for one variant of Mitsuba.

    ``base`` is Mitsuba's base class or its name. The methods of ``logic`` are copied, because a
    Python class cannot inherit from both a class of Mitsuba and another class.
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
    plugin: type[Logic] = type(parent)(logic.__name__, (parent,), members | bound)
    return plugin


@contextmanager
def exclusive() -> Iterator[None]:
    """Prevent other threads from loading or rendering scenes with this package.

    Mitsuba cannot load a scene in one thread while another thread renders. Therefore only one
    thread at a time runs functions of this package that use scenes. In programs with several
    threads, use this context manager around direct calls to Mitsuba, such as ``mi.load_dict`` and
    ``mi.render``.

    Examples
    --------
    >>> import polywigner.mitsuba as pm
    >>> with pm.exclusive():
    ...     pass  # scene = mi.load_dict(...)
    """
    with _scene_lock:
        yield


one_at_a_time = exclusive()
"""Decorator for functions that only one thread at a time may run, because they use scenes."""


def add_plugin(kind: str, name: str, build: _Build) -> None:
    """Add a shape or sensor for :func:`register`; ``build(variant, props)`` creates it."""
    _plugins[kind, name] = build


def register() -> None:
    """Register all plugins for every Mitsuba variant, including variants that are set later."""
    mi.detail.add_variant_callback(_on_variant_change)
    if mi.variant() is not None:
        _on_variant_change(None, mi.variant())


def original_error(error: BaseException) -> PolywignerError | None:
    """Return the error of this package that caused an error of Mitsuba, or None."""
    text = str(error)
    return next((cause for cause in reversed(_recent_errors) if str(cause) in text), None)


@contextmanager
def scene_errors(about: str = "", kind: type[Exception] = PolywignerError) -> Iterator[None]:
    """Convert errors of this package in a ``with`` block to SceneErrors.

    ``kind`` limits the conversion to one class of errors, and ``about`` is the start of the new
    messages.
    """
    try:
        yield
    except kind as error:
        raise SceneError(f"{about}{error}") from None


def _on_variant_change(_old: str | None, new: str) -> None:
    """Register all plugins for ``scalar_rgb`` and for the variant ``new``."""
    # Mitsuba looks up the kind of every plugin in scalar_rgb. Without a registration in scalar_rgb,
    # it fails to load two equal shapes.
    for variant in ("scalar_rgb", new):
        for (kind, name), build in _plugins.items():
            register_one = getattr(getattr(mi, variant), f"register_{kind}")
            register_one(name, partial(_build_and_keep_error, build, variant))


def _build_and_keep_error(build: _Build, variant: str, props: mi.Properties) -> mi.Object:
    """Create a plugin; keep an error of this package for `original_error`, and raise it."""
    try:
        with uncompiled():
            return build(variant, props)
    except PolywignerError as error:
        _recent_errors.append(error)
        # Mitsuba would print the traceback before the message.
        raise error.with_traceback(None) from None


def nested_properties(name: str, props: mi.Properties) -> mi.Properties:
    """Return new properties with the id and the nested objects of ``props``."""
    inner = mi.Properties(name)
    inner.set_id(props.id())
    for key, value in dict(props.objects()).items():
        inner[key] = value
    return inner


def set_mesh(mesh: mi.Mesh, **values: Any) -> None:
    """Set parameters of a mesh, such as ``faces`` and ``vertex_positions``, to NumPy arrays."""
    params = mi.traverse(mesh)
    for name, value in values.items():
        # Lists are copied. If the memory of a NumPy array were used instead, kernels would depend
        # on its alignment, and freeing a scene while a kernel is recorded would crash the process.
        params[name] = value.ravel().tolist()
    params.update()


STL = "stl"


def _build_stl(variant: str, props: mi.Properties) -> mi.Mesh:
    """Create a mesh from an STL file and the parameter ``to_world``."""
    path = str(mi.file_resolver().resolve(props["filename"]))
    vertices, triangles = read_triangles(path, "m")
    matrix = np.eye(4)
    if "to_world" in props:
        matrix = np.array(props["to_world"].matrix, np.float64).reshape(4, 4)
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if not (np.abs(vertices) <= np.finfo(np.float32).max).all() or not len(triangles):
        raise SceneError(
            f"expected {path} to contain triangles with finite coordinates, got an empty mesh, "
            "NaN or infinity; export the file again"
        )
    # A mirrored body needs reversed triangles for outward normals.
    if np.linalg.det(matrix[:3, :3]) < 0:
        triangles = triangles[:, ::-1]
    name, sizes = props.id() or STL, (len(vertices), len(triangles))
    mesh = getattr(mi, variant).Mesh(name, *sizes, props=nested_properties(STL, props))
    set_mesh(mesh, vertex_positions=vertices, faces=triangles)
    return mesh


add_plugin("shape", STL, _build_stl)


KEY_PREFIX = "memory:"

# Largest number of registered sources; keys are needed only until a scene is loaded.
_CAPACITY = 1024

_sources: OrderedDict[str, Aperture | Array | Wavefront] = OrderedDict()
_sources_lock = threading.Lock()


def register_source(source: Aperture | Array | Wavefront) -> str:
    """Register a source in memory, and return a key that scenes can contain.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source to register. Equal sources share one key. Only the last 1024 sources are kept.

    Returns
    -------
    str
        Key, which is a value of the parameter ``source`` (or ``aperture``) of a ``wigner`` shape,
        in a dictionary or in XML.

    Raises
    ------
    SceneError
        If ``source`` is an object of another type.
    """
    if not isinstance(source, Aperture | Array | Wavefront):
        raise unsuitable_source(source)
    key = KEY_PREFIX + hashlib.sha256(source_json(source).encode()).hexdigest()[:24]
    with _sources_lock:
        _sources[key] = source
        _sources.move_to_end(key)
        while len(_sources) > _CAPACITY:
            _sources.popitem(last=False)
    return key


def is_key(name: str) -> bool:
    """Return whether a value of the parameter ``source`` is a key instead of a file name."""
    return name.startswith(KEY_PREFIX)


def registered_source(key: str) -> Aperture | Array | Wavefront:
    """Return the source with a key of `register_source`; raise SceneError if it is unknown."""
    with _sources_lock:
        source = _sources.get(key)
    if source is None:
        raise SceneError(
            f"there is no source with the key {key!r} in this process; create the scene entry "
            "with polywigner.mitsuba.aperture(...) shortly before loading the scene"
        )
    return source


def unsuitable_source(source: object) -> SceneError:
    """Return the error for a source that cannot radiate in a scene."""
    advice = "create one with polywigner.Aperture(vertices)"
    if isinstance(source, PlacedAperture):
        advice = "omit its pose, and pass it as the to_world of the shape"
    elif isinstance(source, Slits):
        advice = "use rectangles instead of slits"
    return SceneError(f"expected an Aperture or an Array, got {type(source).__name__}; {advice}")
