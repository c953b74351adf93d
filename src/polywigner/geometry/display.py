"""Outlines on axes of matplotlib, and lengths in a readable unit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.quantities import parse_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Points = NDArray[np.float64]

_FILL = "#9ecae1"
_LINE = "#2166ac"


class LengthUnit(NamedTuple):
    """A unit of length to print: its name and its size in metres."""

    name: str
    metres: float


_UNITS = (LengthUnit("nm", 1e-9), LengthUnit("µm", 1e-6), LengthUnit("mm", 1e-3))


def length_unit(length: float) -> LengthUnit:
    """Return the unit that expresses a length (m) as a number from 1 to 1000, or metres."""
    for unit in _UNITS:
        if length < 1000 * unit.metres:
            return unit
    return LengthUnit("m", 1.0)


def length_text(*lengths: float) -> str:
    """Return lengths (m) in the unit of the largest one, such as ``20 x 12 mm``."""
    unit = length_unit(max(lengths))
    return f"{' x '.join(f'{length / unit.metres:.4g}' for length in lengths)} {unit.name}"


def plot_rings(rings: Sequence[Points], ax: Axes | None, unit: str) -> Axes:
    """Plot filled rings on ``ax``, or on new axes of pyplot, in a unit of length.

    Raises ArgumentError for other objects than axes, QuantityError for an unknown unit.
    """
    scale = parse_unit(unit)
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.subplots()[1]
    if not hasattr(ax, "add_patch"):
        raise ArgumentError(f"expected axes of matplotlib, got {type(ax).__name__}")
    closed = [np.append(ring, ring[:1], axis=0) for ring in rings]
    draw_rings(ax, closed, scale, facecolor=_FILL, edgecolor=_LINE)
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel(f"x ({unit})")
    ax.set_ylabel(f"y ({unit})")
    return ax


def draw_rings(ax: Axes, rings: Sequence[Points], metres: float, **how: Any) -> None:
    """Draw closed rings (m) with holes as one patch; the axes have a unit of ``metres``."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    paths: list[Any] = [Path(ring / metres, closed=True) for ring in rings]
    path = Path.make_compound_path(*paths)
    ax.add_patch(PathPatch(path, **how))
    ax.update_datalim(path.vertices)
