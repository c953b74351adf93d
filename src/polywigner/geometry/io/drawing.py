"""Drawings of files: the options of the caller, and the polygons that are read."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from polywigner.errors import ArgumentError
from polywigner.geometry.rings import Ring


@dataclass(frozen=True, eq=False)
class File:
    """A file with the options of the caller."""

    path: Path
    content: bytes
    unit_metres: float
    """Metres per unit of the file, unless the file states its unit."""
    tolerance: float | None
    """Largest distance in metres between a curve and its chords; None: see `flattened`."""
    layers: tuple[str, ...]
    """Layers to read, even if they are hidden; empty: everything that is visible."""
    union: bool
    """Whether to join outlines that overlap."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Polygons of a file, each a list of rings with the exterior first, in the file's unit."""

    polygons: Sequence[Sequence[Any]]
    metres: float
    """Length of the file's unit."""
    remedy: str | None = None
    """Advice to users whose outlines overlap."""


def check_known(requested: Iterable[str], known: Iterable[str]) -> None:
    """Raise ArgumentError for a layer that the drawing does not have."""
    names = sorted(set(known))
    missing = [name for name in requested if name not in names]
    if missing:
        listed = ", ".join(name[:60] for name in names[:12]) + ", ..." * (len(names) > 12)
        raise ArgumentError(
            f"expected a layer of the drawing, got {missing[0][:60]!r}; "
            + (f"it has {listed}" if names else "it names none, so leave layer out")
        )


def overlap_remedy(rings: Sequence[Ring], layers: Sequence[str]) -> str:
    """Return advice for outlines (n, 2) on `layers` that cross, overlap, or touch inside another.

    An outline around all others is often the edge of a board, on a layer of its own.
    """
    largest = max(range(len(rings)), key=lambda k: float(np.prod(np.ptp(rings[k], axis=0))))
    others = sorted(set(layers) - {layers[largest], ""})
    points = [ring for k, ring in enumerate(rings) if k != largest]
    if len(points) < 2 or not _surrounds(rings[largest], np.concatenate(points)):
        return "join them in the drawing, or give union=True (--union)"
    name = f"the outline on layer {layers[largest][:60]!r}" if layers[largest] else "one outline"
    if not others:
        return f"{name} lies around all others: move it to a layer that is not read"
    listed = repr(others[0] if len(others) == 1 else others[:3])
    options = " ".join(f"--layer {shlex.quote(other)}" for other in others[:3])
    return f"{name} lies around all others: read the others with layer={listed} ({options})"


def _surrounds(ring: Ring, points: Ring) -> bool:
    outline = shapely.Polygon(ring)
    shapely.prepare(outline)
    return bool(shapely.intersects_xy(outline, points).all())
