"""Apertures handed to scenes from memory.

Mitsuba's scene dictionaries and files carry numbers and strings, no Python objects. An aperture
is therefore kept here under a key made of its content, and the scene carries the key.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict

from polywigner.errors import SceneError
from polywigner.geometry import Aperture

__all__ = ["CAPACITY", "KEY_PREFIX", "is_key", "register_source", "registered_source"]

KEY_PREFIX = "memory:"

# Bounds what a long-lived process that makes a scene per aperture (an optimiser) keeps. A scene
# needs its key only while it is being loaded.
CAPACITY = 1024

_sources: OrderedDict[str, Aperture] = OrderedDict()
_lock = threading.Lock()


def register_source(aperture: Aperture) -> str:
    """The key under which scenes find this aperture; equal apertures share one.

    The last 1024 apertures are kept. Use the key as the parameter ``aperture`` of a ``wigner``
    shape, in a dictionary or in XML.

    Raises
    ------
    SceneError for anything but an Aperture.
    """
    if not isinstance(aperture, Aperture):
        raise SceneError(
            f"expected an Aperture, got {type(aperture).__name__}; make one with "
            "polywigner.Aperture(vertices)"
        )
    digest = hashlib.sha256()
    for ring in aperture.rings:
        digest.update(ring.tobytes())
        digest.update(b"|")
    key = KEY_PREFIX + digest.hexdigest()[:24]
    with _lock:
        _sources[key] = aperture
        _sources.move_to_end(key)
        while len(_sources) > CAPACITY:
            _sources.popitem(last=False)
    return key


def is_key(name: str) -> bool:
    """Whether the parameter ``aperture`` is a key rather than a file."""
    return name.startswith(KEY_PREFIX)


def registered_source(key: str) -> Aperture:
    """The aperture of a key, or a SceneError."""
    with _lock:
        aperture = _sources.get(key)
    if aperture is None:
        raise SceneError(
            f"expected the key of an aperture in this process, got {key!r}; make the scene entry "
            "with polywigner.mitsuba.aperture(...) shortly before loading the scene"
        )
    return aperture
