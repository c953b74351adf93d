"""A figure of the paper: the picture, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["QUALITIES", "Made", "Quality", "geojson", "number_samples"]

Quality = Literal["draft", "print"]
QUALITIES: tuple[str, ...] = get_args(Quality)


@dataclass(frozen=True, eq=False)
class Made:
    """The pictures of a figure by their letters ("" of a single one), the arrays behind them by
    name, and for each of these its unit and axes in words."""

    figures: Mapping[str, Figure]
    values: Mapping[str, NDArray[Any]]
    about: Mapping[str, str]


def number_samples(quality: Quality, draft: int, final: int) -> int:
    """Number of samples to take along an axis."""
    return draft if quality == "draft" else final


def geojson(shape: Any) -> NDArray[Any]:
    """A shapely geometry as a text in an array, with all its digits."""
    import shapely

    return np.asarray(shapely.to_geojson(shape))
