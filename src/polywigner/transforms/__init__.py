"""The public transforms: Fourier, Wigner and ambiguity functions of sources, and the marginals.

Sources are apertures (plane polygons, two components), slits (one), and, for the Fourier transform
alone, apertures in a pose and polyhedra (three). "Content" is length, area or volume.

Conventions (docs/conventions): Fourier kernel exp(-2 pi i nu.x); nu and upsilon in cycles per
unit length; the last axis of every argument holds the components, everything before it
broadcasts; the result has the broadcast shape without that axis, and one point gives a NumPy
scalar. Lengths are in the source's unit (metres), results in its power of the dimension.

Formulas: docs/theory.md. Accuracy: |error| <= 1e-12 area in float64 and 5e-6 area in float32, for
|nu| times diameter up to 1e3 and all positions, including those where edges of the two copies
coincide. Of thin outlines, and of those that run to and fro (combs, spirals), W and A are accurate
to 6e-7 diameter perimeter in float32 where that is more (docs/accuracy.md, "Limits").
"""

from polywigner.execution import Differentiable
from polywigner.transforms.automean_samples import Weights, sample_automean
from polywigner.transforms.calls import explain
from polywigner.transforms.checked_calls import PhaseSpaceSource, Source
from polywigner.transforms.imaging import (
    partially_coherent_image,
    transmission_cross_coefficient,
)
from polywigner.transforms.phase_space import (
    ambiguity,
    autocorrelation,
    lag_marginal,
    position_marginal,
    wigner,
)
from polywigner.transforms.projection import PhaseSpaceFunction, projections
from polywigner.transforms.pupil import mtf, otf
from polywigner.transforms.spectrum import array_factor, fourier
from polywigner.transforms.traced_sources import differentiable

__all__ = [
    "Differentiable",
    "PhaseSpaceFunction",
    "PhaseSpaceSource",
    "Source",
    "Weights",
    "ambiguity",
    "array_factor",
    "autocorrelation",
    "differentiable",
    "explain",
    "fourier",
    "lag_marginal",
    "mtf",
    "otf",
    "partially_coherent_image",
    "position_marginal",
    "projections",
    "sample_automean",
    "transmission_cross_coefficient",
    "wigner",
]
