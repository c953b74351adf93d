"""Arrays of elements with curved waves: one wave over all, and a tilt more on each element.

With d_k = c_k - c, the wave of an element about its own centre is that about c, tilted:

    (x - c_k).Q (x - c_k) = (x - c).Q (x - c) - 2 (x - c).Q d_k + d_k.Q d_k
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import IlluminationError
from polywigner.geometry import Wavefront
from polywigner.illumination.sites import checked_weights
from polywigner.illumination.waves import Illumination

__all__ = ["array_of_waves", "copies_of_wave", "has_waves", "tilted_source"]

# Curvatures of elements that were turned, or read, differ by rounding.
_SAME = 1e-12


def has_waves(elements: Any) -> bool:
    """Whether one of a list of elements has a curved or partly coherent wave."""
    return isinstance(elements, Sequence) and any(isinstance(e, Wavefront) for e in elements)


def array_of_waves(make: Any, elements: Sequence[Any], weights: Any) -> Wavefront:
    """The array of elements whose waves have one curvature, as one curved wave on an array.

    ``make``: (elements, weights) -> Array. Raises IlluminationError where curvatures differ.
    """
    waves = [e if isinstance(e, Wavefront) else Wavefront(e) for e in elements]
    first = waves[0]
    size = float(np.abs([wave.curvature for wave in waves]).max())
    for k, wave in enumerate(waves):
        apart = float(np.abs(wave.curvature - first.curvature).max())
        if apart > _SAME * size or wave.coherence_width != first.coherence_width:
            raise IlluminationError(
                f"expected elements with one curvature and coherence width, got {wave!r} as "
                f"element {k} beside {first!r}; make an array of those alike, and add fields"
            )
    factors = checked_weights(weights, len(waves))
    tilted = [_tilted(wave.source, wave, wave.centre - first.centre) for wave in waves]
    phases = np.array([phase for _, phase in tilted])
    return first._with(source=make([source for source, _ in tilted], factors * phases))


def copies_of_wave(
    make: Any, wave: Wavefront, places: NDArray[np.float64], weights: NDArray[np.complex128]
) -> Wavefront:
    """Copies of an element with its wave at places (n, d)."""
    return array_of_waves(make, [wave.moved(place) for place in places], weights)


def _tilted(source: Any, wave: Wavefront, away: NDArray[np.float64]) -> tuple[Any, complex]:
    """The source with the tilt of a wave whose centre is ``away``, and what is left of its phase.

    exp(-2 pi i x.Q d) stands on the source, exp(i pi d.Q d + 2 pi i c.Q d) is left; c = c_k - d.
    """
    slope = wave.curvature @ away
    turns = float((wave.centre - away / 2) @ slope)
    phase = complex(np.exp(2j * np.pi * (turns - round(turns))))
    return tilted_source(source, -slope), phase


def tilted_source(source: Any, kappa: NDArray[np.float64]) -> Any:
    """A flat source times exp(2 pi i kappa.x), kappa (d,)."""
    if not kappa.any():
        return source
    if hasattr(source, "with_illumination"):
        tilt, own = Illumination([1.0], kappa[None]), source.illumination
        return source.with_illumination(tilt if own is None else own * tilt)
    if source.repeated is None:
        elements = [tilted_source(element, kappa) for element in source.elements_in_plane]
        return type(source)(elements, source.weights)
    # each copy brings its element's tilt along
    (element, positions), make = source.repeated, type(source)._repeated
    return make(
        tilted_source(element, kappa),
        positions,
        source.weights * np.exp(2j * np.pi * (positions @ kappa)),
    )
