"""The power int |u|^2 of a source; derivatives of a coupling in weights of elements or of waves."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import IlluminationError
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.propagation.field_slopes import parts_of
from polywigner.transforms import Differentiable
from polywigner.transforms.energies import energy_of
from polywigner.transforms.traced_sources import fields_of
from polywigner.transforms.wavefronts import flat_of

__all__ = ["root_of_norm", "slopes_of_fields"]

Complex = NDArray[np.complex128]

# int |u|^2 of a source that cancels itself, relative to that of its parts.
_DARK = 1e-12


@lru_cache(maxsize=16)
def root_of_norm(source: Any) -> float:
    """sqrt(int |u|^2), in m times the unit of the field.

    Raises IlluminationError for a source that cancels itself.
    """
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
    return math.sqrt(norm)


def slopes_of_fields(
    find: Callable[..., Any],
    traced: tuple[Differentiable, ...],
    own: int,
    poses: NDArray[np.float64],
    values: Complex,
) -> Complex:
    """Derivatives (n, 2 k) of couplings (n,) in weights of elements, or of waves, (RX6).

    In the real parts of all weights of the source ``own``, then in the imaginary ones.
    ``find(pair of sources, to_transmitter=, wanted=)`` has the couplings of others.
    """
    source = traced[own].source
    parts = list(parts_of(source, traced[own].amplitudes is not None))
    whole = root_of_norm(source)
    found = np.empty((2, len(parts), len(values)), np.complex128)
    for k, part in enumerate(parts):
        pair = list(traced)
        pair[own] = Differentiable(part)
        alone, _, _ = find(tuple(pair), to_transmitter=poses, wanted=(False,) * 3)
        found[0, k] = alone * (root_of_norm(part) / whole)
    found[1] = 1j * found[0]
    overlaps = _overlaps(parts, fields_of(traced[own])) / whole**2
    for place, part_of in enumerate((overlaps.real, overlaps.imag)):
        found[place] -= part_of[:, None] * values
    return found.reshape(2 * len(parts), len(values)).T


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
