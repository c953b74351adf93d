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

    def of_aperture(self) -> dict[str, Any]:
        """The arguments of :func:`polywigner.read_aperture`."""
        from polywigner.quantities import parse_length

        reach = None if self.tolerance is None else parse_length(self.tolerance)
        return self._asdict() | {"unit": self.unit or "mm", "tolerance": reach}
