"""How commands read aperture files; without imports that would slow `--help`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

__all__ = ["Reading"]


class Reading(NamedTuple):
    """How to read an aperture file: the texts of the options of these names."""

    unit: str | None
    tolerance: str | None
    layer: Sequence[str] | None
    union: bool
    allow_outside: bool = False
    """Of a source file: whether it may name files outside of its folder."""

    def of_aperture(self) -> dict[str, Any]:
        """The arguments of :func:`polywigner.read_aperture`."""
        from polywigner.quantities import parse_length

        reach = None if self.tolerance is None else parse_length(self.tolerance)
        return {
            "unit": self.unit or "mm",
            "tolerance": reach,
            "layer": self.layer,
            "union": self.union,
        }
