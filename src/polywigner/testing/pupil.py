"""Laws of imaging that the optical transfer function of any pupil must obey."""

from __future__ import annotations

import numpy as np

from polywigner import transforms
from polywigner.geometry import Aperture, Slits
from polywigner.testing.cases import Precision, case_of, require


def assert_otf_properties(
    source: Aperture | Slits,
    *,
    defocus: float = 0.75,
    points: int = 200,
    seed: int = 0,
    precision: Precision = None,
    engine: str = "auto",
    tolerance: float | None = None,
) -> None:
    """Raise an AssertionError unless the OTF of a pupil has the properties that it must have.

    OTF(0) = 1; OTF(-xi) = conj OTF(xi), since the image of a point is real; in focus it is the
    lag marginal over int |u|^2, of a uniform pupil the mutual area over the area; out of focus a
    uniform pupil's is nowhere larger than that (any pupil's not than the mutual area times the
    largest |u|^2 over int |u|^2); with the conjugate field and the opposite defocus it is the
    conjugate; and it is zero beyond the largest distance of two points of the pupil, the cut-off.

    Parameters
    ----------
    source: the pupil, an Aperture or Slits, uniform or with an illumination.
    defocus: W20 in waves, at the pupil's largest radius.
    points, seed, precision, engine, tolerance: as in :func:`assert_wigner_identities`.

    Raises
    ------
    AssertionError: names the first property that does not hold, where, and the two values.
    ArgumentError: for sources that are no pupils.
    """
    case = case_of(source, points, seed, precision, engine, tolerance)
    xi, allowed = case.xi, case.allowed / case.energy
    outline = transforms.lag_marginal(case.outline, xi, **case.keywords)
    mutual = case.evaluate("lag_marginal", xi) / case.energy
    largest = case.waves.strength**2 / case.energy * outline
    conjugate = case.source
    if not case.waves.uniform:
        conjugate = case.outline.with_illumination(case.waves.conjugate().field())
    for waves in (0.0, defocus):
        name = f"OTF at {waves} waves"
        value = transforms.otf(source, xi, waves, **case.keywords)
        origin = np.zeros((1, case.dimension))
        at_zero = transforms.otf(source, origin, waves, **case.keywords)
        require(f"{name}: 1 at xi = 0", at_zero, 1.0, allowed, {"xi": origin})
        reversed_ = transforms.otf(conjugate, xi, -waves, **case.keywords)
        law = f"{name}: the conjugate of that with the opposite defocus"
        require(law, reversed_, value.conj(), allowed, {"xi": xi})
        mirrored = transforms.otf(source, -xi, waves, **case.keywords)
        require(f"{name}: OTF(-xi) = conj OTF(xi)", mirrored, value.conj(), allowed, {"xi": xi})
        size = np.abs(value)
        law = f"{name}: no larger than in focus"
        require(law, size, np.minimum(size, largest), allowed, {"xi": xi})
        if not waves:
            require(f"{name}: mutual content over content", value, mutual, allowed, {"xi": xi})
        beyond = xi * (1.001 * source.diameter / np.linalg.norm(xi, axis=1, keepdims=True))
        value = transforms.otf(source, beyond, waves, **case.keywords)
        require(f"{name}: zero beyond the cut-off", value, 0.0, allowed, {"xi": beyond})
