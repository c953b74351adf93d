"""Fields on sources, and arrays of weighted elements.

- ``tapers``: steering, tapers and modes, and plane waves for sampled fields
- ``normal_form``: :class:`Source`, the form into which all public sources are converted
- ``array``: :class:`Array`, :func:`phased_array`, and the region that contains all points with
  W != 0; ``lattices``: sites of equal elements
- ``arrays``: layouts and weights of elements, and tables of both
- ``source_files``: sources in TOML and JSON; ``source_tables``: tables and short texts of fields,
  layouts, weights and shapes
- ``obliquities``: factors that depend on the angle and the waves, for each boundary condition
"""

from polywigner.geometry.illumination import Illumination
from polywigner.source import arrays
from polywigner.source.array import Array, Element, phased_array, segmented_pupil
from polywigner.source.source_files import read_polarisation, read_source, write_source
from polywigner.source.tapers import (
    FittedIllumination,
    cosine_taper,
    fit_illumination,
    steering,
    taylor_taper,
    te_mode,
    uniform,
)

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
