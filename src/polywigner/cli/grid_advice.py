"""Numbers of samples that a field needs, for commands that were not told how many."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray
    from polywigner.cli.where import Place, Point

__all__ = ["samples_of_box", "samples_of_place"]

# Fewest samples, for a smooth picture, and most, for a short wait: a factor of four in time.
_FEWEST = {"line": (401,), "arc": (321,), "plane": (129, 129), "hemisphere": (61, 120)}
_MOST = {"line": (1601,), "arc": (1281,), "plane": (257, 257), "hemisphere": (121, 240)}
_FEWEST_OF_BOX, _MOST_OF_BOX = (64,) * 3, (101,) * 3


def samples_of_place(
    source: Aperture | ApertureArray, place: Place, wavelength: float, amplitude: bool
) -> tuple[int, ...]:
    """Samples along each axis of a place: those given, else what its field needs, within bounds.

    A warning says where the bounds are too narrow.
    """
    if place.shape:
        return place.shape
    quantity = "amplitude" if amplitude else "irradiance"
    needed = _needed(source, place, wavelength, quantity)
    return _within("--samples", needed, _FEWEST[place.kind], _MOST[place.kind])


def samples_of_box(
    source: Aperture | ApertureArray, corners: tuple[Point, Point], wavelength: float
) -> tuple[int, ...]:
    """Along x, y and z of a box, as many as the irradiance needs, within bounds."""
    import polywigner as pw

    axes = pw.suggest_sampling(source, wavelength, "irradiance", box=corners).axes
    return _within("--shape", [axis.count for axis in axes], _FEWEST_OF_BOX, _MOST_OF_BOX)


def _needed(source: Any, place: Place, wavelength: float, quantity: Any) -> list[int]:
    import polywigner as pw

    if place.kind == "line":
        return [
            axis.count
            for axis in pw.suggest_sampling(source, wavelength, quantity, line=place.points).axes
        ]
    if place.kind == "plane":
        axes = pw.suggest_sampling(source, wavelength, quantity, box=place.points).axes
        return [axis.count for axis in axes if axis.high > axis.low]
    theta, phi = pw.suggest_sampling(source, wavelength, quantity, radius=place.radius).axes
    share = place.reach / theta.high
    if place.kind == "arc":
        return [math.ceil(2 * share * (theta.count - 1)) + 1]
    return [math.ceil(share * (theta.count - 1)) + 1, phi.count - 1]


def _within(
    option: str, needed: list[int], fewest: tuple[int, ...], most: tuple[int, ...]
) -> tuple[int, ...]:
    chosen = tuple(
        min(max(n, low), high) for n, low, high in zip(needed, fewest, most, strict=True)
    )
    if any(n > high for n, high in zip(needed, most, strict=True)):
        text = " x ".join(map(str, map(max, needed, chosen)))
        warnings.warn(
            f"{' x '.join(map(str, chosen))} samples miss fringes of this field: "
            f'{option} "{text}" would show all, or look at a smaller region',
            RuntimeWarning,
            stacklevel=3,
        )
    return chosen
