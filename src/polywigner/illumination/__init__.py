"""Fields on sources: sums of plane waves, and weights of the elements of coherent collections.

- ``waves``: the immutable :class:`Illumination`; ``tapers``: steering, tapers and modes;
  ``fitting``: waves for sampled fields
- ``array``: :class:`Array` and :func:`phased_array`; ``lattices``: sites of equal elements
- ``arrays``: layouts and weights of elements
- ``files``: sources in TOML and JSON; ``texts``: tapers and layouts in a few words
- ``support``: the region outside of which W is zero
- ``obliquities``: factors of angle and wave, for each boundary condition
"""

from polywigner.illumination import arrays
from polywigner.illumination.array import Array, Element, phased_array
from polywigner.illumination.fitting import FittedIllumination, fit_illumination
from polywigner.illumination.source_files import read_source, write_source
from polywigner.illumination.tapers import (
    cosine_taper,
    fourier_taper,
    steering,
    taylor_taper,
    te_mode,
    uniform,
)
from polywigner.illumination.waves import Illumination

__all__ = [
    "Array",
    "Element",
    "FittedIllumination",
    "Illumination",
    "arrays",
    "cosine_taper",
    "fit_illumination",
    "fourier_taper",
    "phased_array",
    "read_source",
    "steering",
    "taylor_taper",
    "te_mode",
    "uniform",
    "write_source",
]
