"""Fourier, Wigner and ambiguity functions of sources, and their marginals.

Sources are apertures, which are plane polygons, and slits, which are intervals on a line. The
Fourier transform also accepts polyhedra, and apertures placed at a pose in space.

The Fourier kernel is exp(-2 pi i nu.x), where the frequency nu is in cycles per metre
(docs/conventions). The last axis of every argument contains the components, and all other axes
broadcast. The result has the broadcast shape without the last axis. A single point gives a NumPy
scalar. Lengths are in metres, and results are in m^d, where d is the number of dimensions.

The formulas are in docs/theory.md. The error is at most 1e-12 of the area in float64 and 5e-6 of
the area in float32, if |nu| times the diameter is at most 1e3. This error bound holds at all
positions, even if edges of the two copies of a source coincide. For thin outlines, combs and
spirals the error of Wigner and ambiguity functions in float32 may reach 6e-7 times diameter times
perimeter (docs/accuracy.md, "Limits").
"""

from polywigner.execution import Differentiable
from polywigner.transforms.aberrations import Aberration, fit_zernike, zernike
from polywigner.transforms.calls import explain
from polywigner.transforms.checked_calls import PhaseSpaceSource, Source
from polywigner.transforms.imaging import partially_coherent_image, transmission_cross_coefficient
from polywigner.transforms.projection import PhaseSpaceFunction, projections
from polywigner.transforms.public_transforms import (
    ambiguity,
    array_factor,
    autocorrelation,
    fourier,
    lag_marginal,
    position_marginal,
    wigner,
)
from polywigner.transforms.pupil import mtf, otf, strehl, wavefront_error
from polywigner.transforms.traced_sources import differentiable

__all__ = [
    "Aberration",
    "Differentiable",
    "PhaseSpaceFunction",
    "PhaseSpaceSource",
    "Source",
    "ambiguity",
    "array_factor",
    "autocorrelation",
    "differentiable",
    "explain",
    "fit_zernike",
    "fourier",
    "lag_marginal",
    "mtf",
    "otf",
    "partially_coherent_image",
    "position_marginal",
    "projections",
    "strehl",
    "transmission_cross_coefficient",
    "wavefront_error",
    "wigner",
    "zernike",
]
