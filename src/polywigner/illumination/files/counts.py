"""What a source file has asked for so far, within limits: a short text can describe very much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.limits import (
    LARGEST_FILE,
    LARGEST_PART,
    MOST_RINGS,
    MOST_WAVES,
    check_rings,
    check_vertices,
)

__all__ = ["Counts", "check_shape"]


@dataclass
class Counts:
    """Sums over all elements of a file and the files that it names."""

    rings: int = 0
    vertices: int = 0
    waves: int = 0
    bytes: int = 0

    def add_outlines(self, rings: int, vertices: int) -> None:
        """Count outlines and their vertices."""
        self.rings += rings
        self.vertices += vertices
        check_rings(self.rings)
        check_vertices(self.vertices)

    def add_waves(self, count: int) -> None:
        """Count plane waves, before they are made."""
        self.waves += count
        if self.waves > MOST_WAVES:
            raise FileFormatError(
                f"expected fields of at most {MOST_WAVES} plane waves in a file, got more; use "
                "fewer or lower tapers"
            )

    def add_bytes(self, count: int) -> None:
        """Count what is read of another file."""
        self.bytes += count
        if self.bytes > LARGEST_FILE:
            raise FileFormatError(
                f"expected to read at most {LARGEST_FILE >> 20} MiB of other files, got more; "
                "simplify them"
            )


def check_shape(values: Mapping[str, Any]) -> None:
    """Raise for parameters of a shape by name that make it very large."""
    for name, value in values.items():
        if isinstance(value, int) and value > LARGEST_PART:
            raise FileFormatError(f"expected {name} of at most {LARGEST_PART}, got more")
    sizes = [len(v) if isinstance(v, list) else v if type(v) is int else 1 for v in values.values()]
    check_vertices(math.prod(max(1, size) for size in sizes))
    rings = values.get("rings", 0)
    if 3 * rings * rings > MOST_RINGS:  # of hexagons around each other
        raise FileFormatError(
            f"expected rings of at most {MOST_RINGS} segments, got {3 * rings * (rings + 1)}"
        )
