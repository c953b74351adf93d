"""Fields on sources as sums of plane waves, and weights of the elements of arrays.

- ``waves``: the immutable :class:`Illumination`, and waves for sampled fields; ``tapers``:
  steering, tapers and modes
- ``normal_form``: :class:`Source`, the form into which all public sources are converted
- ``array``: :class:`Array` and :func:`phased_array`; ``lattices``: sites of equal elements
- ``arrays``: layouts and weights of elements, and tables of both
- ``source_files``: sources in TOML and JSON; ``source_tables``: tables and short texts of fields,
  layouts, weights and shapes
- ``support``: the region that contains all points with W != 0
- ``obliquities``: factors of angle and wave, for each boundary condition
"""

from polywigner.source import arrays
from polywigner.source.array import Array, Element, phased_array, segmented_pupil
from polywigner.source.source_files import read_polarisation, read_source, write_source
from polywigner.source.tapers import (
    cosine_taper,
    steering,
    taylor_taper,
    te_mode,
    uniform,
)
from polywigner.source.waves import FittedIllumination, Illumination, fit_illumination

__all__ = [
    "Array",
    "Element",
    "FittedIllumination",
    "Illumination",
    "arrays",
    "cosine_taper",
    "fit_illumination",
    "phased_array",
    "read_polarisation",
    "read_source",
    "segmented_pupil",
    "steering",
    "taylor_taper",
    "te_mode",
    "uniform",
    "write_source",
]
