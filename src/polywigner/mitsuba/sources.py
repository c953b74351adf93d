"""Apertures and arrays handed to scenes from memory.

Mitsuba's scene dictionaries and files carry numbers and strings, no Python objects. A source is
therefore kept here under a key made of its content, and the scene carries the key.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict

from polywigner.errors import SceneError
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.source_files import json_of, table_of

__all__ = ["CAPACITY", "KEY_PREFIX", "is_key", "register_source", "registered_source"]

KEY_PREFIX = "memory:"

# Bounds what a long-lived process that makes a scene per aperture (an optimiser) keeps. A scene
# needs its key only while it is being loaded.
CAPACITY = 1024

_sources: OrderedDict[str, Aperture | Array | Wavefront] = OrderedDict()
_lock = threading.Lock()


def register_source(source: Aperture | Array | Wavefront) -> str:
    """The key under which scenes find this aperture or array, with its wave; equal ones share one.

    The last 1024 sources are kept. Use the key as the parameter ``source`` (or ``aperture``) of a
    ``wigner`` shape, in a dictionary or in XML.

    Raises
    ------
    SceneError for anything but an Aperture or an Array.
    """
    if not isinstance(source, Aperture | Array | Wavefront):
        raise SceneError(
            f"expected an Aperture or an Array, got {type(source).__name__}; make one with "
            "polywigner.Aperture(vertices)"
        )
    content = json_of(table_of(source))  # all that makes it up, to the last digit
    key = KEY_PREFIX + hashlib.sha256(content.encode()).hexdigest()[:24]
    with _lock:
        _sources[key] = source
        _sources.move_to_end(key)
        while len(_sources) > CAPACITY:
            _sources.popitem(last=False)
    return key


def is_key(name: str) -> bool:
    """Whether the parameter ``aperture`` or ``source`` is a key rather than a file."""
    return name.startswith(KEY_PREFIX)


def registered_source(key: str) -> Aperture | Array | Wavefront:
    """The source of a key, or a SceneError."""
    with _lock:
        source = _sources.get(key)
    if source is None:
        raise SceneError(
            f"expected the key of a source in this process, got {key!r}; make the scene entry "
            "with polywigner.mitsuba.aperture(...) shortly before loading the scene"
        )
    return source
