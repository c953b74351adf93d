"""The public transforms: Fourier, Wigner and ambiguity functions of sources, and the marginals.

Sources are apertures (plane polygons, two components) and slits (one component). The Fourier
transform also accepts apertures in a pose and polyhedra (three components).

Conventions (docs/conventions): the Fourier kernel is exp(-2 pi i nu.x); nu and upsilon are in
cycles per unit length. The last axis of every argument contains the components, and all axes before
it broadcast. The result has the broadcast shape without the last axis; a single point gives a NumPy
scalar. Lengths are in metres, results in metres to the power of the dimension.

Formulas: docs/theory.md. The error is at most 1e-12 of the area in float64 and 5e-6 in float32, for
|nu| times diameter up to 1e3 and all positions, including coincident edges of the two copies. For
thin outlines, combs and spirals the error of W and A in float32 may reach 6e-7 times diameter times
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
