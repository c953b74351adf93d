"""Powers by which links are divided; derivatives of links in weights of elements or waves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError, PolywignerError
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.obliquities import CONDITIONS, DEFAULT, Obliquity
from polywigner.illumination.obliquities import fields_of as fields_on
from polywigner.propagation.far_fields import powers_of
from polywigner.propagation.vector_fields import parts_of as parts_of_polarised
from polywigner.propagation.vector_fields import vector_powers
from polywigner.radiometry.hemisphere import directions_and_weights, largest_lag
from polywigner.transforms import fourier
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import flat_of

Complex = NDArray[np.complex128]

NORMALISATIONS = ("radiated", "aperture")
"""Powers of sources that links count: through the hemisphere in front, or int |u|^2."""

# int |u|^2 of a source that cancels itself, relative to that of its parts.
_DARK = 1e-12
# Far fields of parts at a time: 64 MB.
_BLOCK = 1 << 22


def checked_normalise(name: Any, error: type[PolywignerError] = ArgumentError) -> str:
    """Return ``name`` itself, or raise the error with the names that there are."""
    if not isinstance(name, str) or name not in NORMALISATIONS:
        names = " or ".join(f'"{known}"' for known in NORMALISATIONS)
        raise error(f"expected normalise to be {names}, got {name!r}")
    return str(name)


def root_of_norm(
    source: Any, wavelength: float, method: str, normalise: str, jones: Complex | None = None
) -> float:
    """Root of a source's power in W for |u|^2 in W/m^2, by which couplings are divided.

    ``radiated``: the power that leaves by the boundary condition of the method, which takes u for
    what it needs, as (RX1) does; with Jones vectors (2,) or (k, 2) that of its currents.
    ``aperture``: int |u|^2.

    Raises IlluminationError for a source that cancels itself, or radiates nothing.
    """
    key = None if jones is None else (jones.tobytes(), jones.shape)  # arrays have no hash
    return _root_of_norm(source, wavelength, method, normalise, key)


@lru_cache(maxsize=128)
def _root_of_norm(source: Any, wavelength: float, method: str, normalise: str, jones: Any) -> float:
    if jones is not None:
        parts = parts_of_polarised(source, np.frombuffer(jones[0], complex).reshape(jones[1]))
        if normalise == "aperture":
            return math.sqrt(sum(energy_of(part) for part, _ in parts))
        return math.sqrt(vector_powers(parts, wavelength, method)[0])
    _check_field(source)
    if normalise == "aperture":
        return math.sqrt(energy_of(source))
    condition = CONDITIONS[method if method in CONDITIONS else DEFAULT]
    is_flat = not isinstance(source, Wavefront)
    if not condition.takes_slopes or (is_flat and fields_on(source) == (None,)):
        return math.sqrt(powers_of(source, wavelength, condition.name)[0])
    alone = radiated_overlaps([source], np.ones(1, np.complex128), source, wavelength, condition)
    return math.sqrt(alone[0].real)


def _check_field(source: Any) -> None:
    source = flat_of(source)  # a curved wave is of the same modulus
    norm = energy_of(source)
    weights = [1.0] if isinstance(source, Aperture) else np.abs(source.weights).tolist()
    parts = 0.0
    for weight, element in zip(weights, source.elements_in_plane, strict=True):
        field = element.illumination
        peak = 1.0 if field is None else float(np.abs(field.amplitudes).max())
        parts += (weight * peak) ** 2 * element.area
    if not norm > _DARK * parts:
        raise IlluminationError(
            f"expected a source with a field on it, got one whose elements cancel, int |u|^2 = "
            f"{norm:.3g}"
        )


def radiated_overlaps(
    parts: Sequence[Any], weights: Complex, source: Any, wavelength: float, condition: Obliquity
) -> Complex:
    """Overlaps int g F_k* F dOmega/lambda^2 of the parts of a source with their sum, (k,) in W.

    ``source``: of whose size the parts are; g takes u for what the boundary condition needs.
    """
    found = np.zeros(len(parts), np.complex128)
    step = max(1, _BLOCK // len(parts))
    for directions, solid_angle in directions_and_weights(largest_lag(source), wavelength):
        factor = condition.of_pairs(directions[:, 2], 1.0, 1.0) * solid_angle / wavelength**2
        for start in range(0, len(directions), step):
            some = slice(start, start + step)
            nu = directions[some, :2] / wavelength
            far = np.stack([fourier(part, nu) for part in parts])
            found += (far.conj() * factor[some]) @ (weights @ far)
    return found


def overlaps_of(
    parts: Sequence[Any],
    weights: Complex,
    source: Any,
    wavelength: float,
    method: str,
    normalise: str,
) -> Complex:
    """Overlaps of the parts of a source with their sum, (k,) in W, as :func:`root_of_norm`."""
    if normalise == "aperture":
        return _overlaps(parts, weights)
    return radiated_overlaps(parts, weights, source, wavelength, CONDITIONS[method])


def _overlaps(parts: Sequence[Aperture], weights: Complex) -> Complex:
    """int u_k* u dx of each part u_k with u, the sum of all with their weights, (k,).

    With weights that change by dw, int |u|^2 changes by 2 Re sum_k overlap_k* dw_k.
    """
    outlines = [part.polygons for part in parts]
    tree = shapely.STRtree(outlines)
    found = np.empty(len(parts), np.complex128)
    for k, part in enumerate(parts):
        own = energy_of(part)
        found[k] = weights[k] * own
        others = [j for j in tree.query(outlines[k]).tolist() if j != k and weights[j] != 0]
        common = shapely.area(shapely.intersection([outlines[j] for j in others], outlines[k]))
        near = [j for j, area in zip(others, common, strict=True) if area > 0]
        if near:
            elements, beside = [parts[j] for j in near], weights[near]
            size = np.abs(beside).max()
            rest = energy_of(Array(elements, beside))
            # |a + b|^2 - |a|^2 - |b|^2 = 2 Re a* b, and of i a in place of a 2 Im a* b
            both = (
                energy_of(Array([part, *elements], [turn * size, *beside])) - size**2 * own - rest
                for turn in (1.0, 1j)
            )
            found[k] += complex(*both) / (2 * size)
    return found
