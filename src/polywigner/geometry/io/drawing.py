"""Drawings of files: the formats, the options of the caller, and the polygons that are read."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from polywigner.errors import ArgumentError, missing_extra
from polywigner.geometry.exact import Ring


@dataclass(frozen=True, eq=False)
class File:
    """A file with the options of the caller."""

    path: Path
    content: bytes
    unit_metres: float
    """Metres of one unit of the file, unless it states its own."""
    tolerance: float | None
    """Largest distance in metres between a curve and its chords; None: see `flattened`."""
    layers: tuple[str, ...]
    """Layers to read alone, even where they are hidden; none: all that is visible."""
    union: bool
    """Whether to join outlines that overlap."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Polygons of a file, each a list of rings with the exterior first, in the file's own unit."""

    polygons: Sequence[Sequence[Any]]
    metres: float
    """Length of the file's unit."""
    remedy: str | None = None
    """Advice to users whose outlines overlap."""


@dataclass(frozen=True, eq=False)
class Format:
    """A file format; `readers` finds it in the module that is its reader, as ``FORMAT``."""

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[File], Drawing]
    start: bytes = rb"(?!)"
    """Pattern of the first bytes, for files of another suffix."""
    libraries: tuple[str, ...] = ()
    """Modules of the extra `formats` without which it is not read."""
    has_layers: bool = False


def check_installed(library: str, kind: str) -> None:
    """Raise MissingExtraError where a library that the extra `formats` brings is not installed."""
    try:
        found = find_spec(library)
    except (ImportError, ValueError):
        found = None
    if found is None:
        raise missing_extra(library, "formats", f"reads {kind} files")


_MOST_NAMED = 12


def check_known(asked: Iterable[str], known: Iterable[str]) -> None:
    """Raise ArgumentError for a layer that the drawing does not have."""
    names = sorted(set(known))
    for name in asked:
        if name not in names:
            listed = ", ".join(shown[:60] for shown in names[:_MOST_NAMED])
            more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
            raise ArgumentError(
                f"expected a layer of the drawing, got {name[:60]!r}; "
                + (f"it has {listed}{more}" if names else "it names none, so leave layer out")
            )


def overlap_remedy(rings: Sequence[Ring], layers: Sequence[str]) -> str:
    """Advice for outlines (n, 2) on `layers` that cross, overlap, or touch inside another."""
    frame = _frame(rings)
    if frame is None:
        return "join them in the drawing, or give union=True (--union)"
    others = sorted(set(layers) - {layers[frame]} - {""})
    place = f"the outline on layer {layers[frame][:60]!r}" if layers[frame] else "one outline"
    if not others:
        return f"{place} lies around all others: move it to a layer that is not read"
    if len(others) > 3:
        return f"{place} lies around all others: read the others with layer={others[:3]} and so on"
    listed = repr(others[0] if len(others) == 1 else others)
    options = " ".join(f"--layer {shlex.quote(name)}" for name in others)
    return f"{place} lies around all others: read the others with layer={listed} ({options})"


def _frame(rings: Sequence[Ring]) -> int | None:
    """The number of the ring around two others or more, if it is around all."""
    if len(rings) < 3:
        return None
    boxes = np.array([[*ring.min(axis=0), *-ring.max(axis=0)] for ring in rings])
    around = (boxes <= boxes.min(axis=0)).all(axis=1)
    if not around.any():
        return None
    frame = int(np.argmax(around))
    points = np.concatenate([ring for k, ring in enumerate(rings) if k != frame])
    outline = shapely.Polygon(rings[frame])
    shapely.prepare(outline)
    return frame if shapely.intersects_xy(outline, points).all() else None
