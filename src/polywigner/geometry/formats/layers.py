"""Layers of drawings: those asked for, and the one whose outline frames all others."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import shapely

from polywigner.errors import ArgumentError
from polywigner.geometry.exact import Ring

__all__ = ["check_known", "checked_layers", "checked_union", "overlap_remedy"]

_MOST_NAMED = 12


def checked_layers(layer: Any) -> tuple[str, ...]:
    """The names that a caller gives: one, several, or None for all layers."""
    given = () if layer is None else (layer,) if isinstance(layer, str) else layer
    names = tuple(given) if isinstance(given, Iterable) else (given,)
    if not all(isinstance(name, str) and name for name in names):
        raise ArgumentError(
            f"expected a layer by its name, or several names, got {layer!r}; give for example "
            'layer="pads" or layer=["pads", "feed"]'
        )
    return names


def checked_union(union: Any) -> bool:
    """The flag itself, or ArgumentError."""
    if not isinstance(union, bool | np.bool_):
        raise ArgumentError(f"expected union as True or False, got {union!r}; give one of them")
    return bool(union)


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
