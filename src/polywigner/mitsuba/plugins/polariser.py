"""Polarised light of sources and receivers, as Mueller matrices of Mitsuba's polarised variants.

Mitsuba's light carries four Stokes numbers along the axes b = stokes_basis(d) and d x b of its
direction of travel d. A source sends the column of its own, a receiver weighs with a row. Both know
them along the axes of Ludwig's third definition, which this module turns into Mitsuba's.

An end without a polarisation has the default, along its y axis. Unpolarised sources send, and
unpolarised receivers take, all polarisations alike: :func:`spectrum` of `samplers`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import Drjit
from polywigner.geometry.arguments import checked_array
from polywigner.mitsuba.plugins.emissions import UNPOLARISED
from polywigner.mitsuba.plugins.samplers import opaque, spectrum
from polywigner.source.polarisation import (
    checked_polarisation,
    ludwig_axes,
    polarisation_name,
    stokes_vector,
)

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.source_parameters import SourceParameters

Floats = NDArray[np.float64]

_FULL = "_polarized"

DEFAULT_POLARISATION = "y"
"""Polarisation of ends without one: along their y axes."""


def is_polarised(variant: str | None = None) -> bool:
    """Whether a variant, or the one that is set, has light with a polarisation."""
    return (variant or mi.variant() or "").endswith(_FULL)


def polarised_spec(variant: str, spec: SourceParameters, plugin: str) -> SourceParameters:
    """Return a specification with the default polarisation where the scene specifies none.

    Raises SceneError for a polarisation in a variant whose light has none.
    """
    if is_polarised(variant):
        if spec.states_polarisation:
            return spec
        return replace(spec, polarisation=checked_polarisation(DEFAULT_POLARISATION))
    if spec.polarisation is not None:
        raise SceneError(
            f"expected a polarised variant of Mitsuba for the polarisation of a {plugin} plugin, "
            f"got {variant}; set polywigner.mitsuba.choose_variant(polarised=True), such as "
            f"llvm_ad_mono{_FULL}, or leave polarisation out"
        )
    return spec


def polarisation_summary(ends: Sequence[Any], interferes: bool, requested: Any = None) -> str:
    """Return the polarisations that a result counts, as text.

    Parameters
    ----------
    ends : emitters and receivers, each with ``name``, ``polarisation``, ``states_polarisation``.
    interferes : whether amplitudes add.
    requested : Jones vector (2,) for ends without a polarisation; None: the default.
    """
    if not is_polarised():
        if requested is not None:
            name = polarisation_name(requested)
            return (
                f"{name} at both ends of direct and reflected paths; scattered power: not counted"
            )
        default = f"; {DEFAULT_POLARISATION} at both ends of reflected paths" if interferes else ""
        return f"not counted, both ends match (unpolarised variant){default}"
    groups: dict[str, list[str]] = {}
    for end in ends:
        name = UNPOLARISED if end.polarisation is None else polarisation_name(end.polarisation)
        name += "" if end.states_polarisation or requested is not None else " (default)"
        groups.setdefault(name, []).append(end.name)
    return "; ".join(f"{name}: {', '.join(names)}" for name, names in groups.items())


# Of each of four numbers a colour: the last channels of an integrator without others of its own.
_CHANNELS = 12


def stokes_of(image: npt.ArrayLike) -> Floats:
    """Stokes numbers (4, height, width) of a picture rendered with the integrator ``stokes``.

    Parameters
    ----------
    image: (height, width, channels) as :func:`polywigner.mitsuba.render` returns it.

    S0 is the radiance; S1 horizontal less vertical, S2 less S0 at 45 and -45 degrees, S3 left less
    right (IEEE), as the camera sees them: 45 degrees is from its right upwards. Where the radiance
    is negative so may be S0.

    Raises
    ------
    ArgumentError for a picture of other channels.
    """
    values = checked_array(image, "image", 3)
    count = values.shape[-1] - _CHANNELS
    if not 1 <= count <= 4:
        raise ArgumentError(
            'expected a picture rendered with the integrator "stokes", got one of '
            f"{values.shape[-1]} channels"
        )
    colours = values[..., count:].reshape(*values.shape[:2], 4, 3)
    return np.moveaxis(colours.mean(axis=-1), -1, 0)


class Polariser:
    """Turns weights of one source, or of one receiver, into spectra of one variant."""

    def __init__(self, m: Any, polarisation: NDArray[np.complex128] | None) -> None:
        self._m, self._is_plain = m, polarisation is None
        self._own: list[Any] | None = None
        if polarisation is not None and polarisation.ndim == 1:
            self._own = [opaque(m, number) for number in stokes_vector(polarisation)]

    def sent(self, value: Any, direction: Any, frame: Any, active: Any, along: Any = None) -> Drjit:
        """Light that leaves a source in a direction of its frame: a column."""
        if self._is_plain:
            return spectrum(self._m, value, active)
        s0, s1, s2, s3 = self._stokes(value, active)
        c, s = turn(
            self._m, direction, frame, frame.to_scene(direction) if along is None else along
        )
        turned = (s0, c * s1 + s * s2, c * s2 - s * s1, s3)
        return mueller_matrix(self._m, {(k, 0): value for k, value in enumerate(turned)})

    def taken(self, value: Any, direction: Any, frame: Any, active: Any) -> Drjit:
        """Weight of light that arrives from a direction of a receiver's frame: half a row."""
        if self._is_plain:
            return spectrum(self._m, value, active)
        s0, s1, s2, s3 = (0.5 * number for number in self._stokes(value, active))
        c, s = turn(self._m, direction, frame, -frame.to_scene(direction))
        turned = (s0, c * s1 + s * s2, s * s1 - c * s2, s3)
        return mueller_matrix(self._m, {(0, k): value for k, value in enumerate(turned)})

    def _stokes(self, value: Any, active: Any) -> list[Drjit]:
        if self._own is None:
            return [dr.select(active, value[k], 0.0) for k in range(4)]
        known = dr.select(active, value, 0.0)
        return [known * number for number in self._own]


def mueller_matrix(m: Any, entries: dict[tuple[int, int], Any]) -> Drjit:
    """Return a Mueller matrix of the variant ``m`` that is zero but for some entries."""
    matrix = dr.zeros(m.Spectrum)
    for place, value in entries.items():
        matrix[place] = m.UnpolarizedSpectrum(value)
    return matrix


def turned(m: Any, share: Any, arrives: tuple[Any, Any], leaves: tuple[Any, Any] | None) -> Drjit:
    """A Mueller matrix of Mitsuba's axes, between Ludwig's axes of a source and of a receiver.

    ``leaves``: None for unpolarised light, whose axes do not matter.
    """
    ends = []
    for end, sign in ((arrives, -1.0), (leaves, 1.0)):
        if end is None:
            ends.append(m.Spectrum(1.0))
            continue
        frame, direction = end
        c, s = turn(m, frame.to_own(direction), frame, sign * direction)
        entries = {(0, 0): 1, (1, 1): c, (1, 2): s, (2, 1): -sign * s, (2, 2): sign * c, (3, 3): 1}
        ends.append(mueller_matrix(m, entries))
    return ends[0] * share * ends[1]


def turn(m: Any, direction: Any, frame: Any, along: Any) -> tuple[Drjit, Drjit]:
    """Cosine and sine of twice the angle from Ludwig's x to Mitsuba's axis, about a direction."""
    axes = ludwig_axes(direction.x, direction.y, dr.abs(direction.z))
    basis = m.mueller.stokes_basis(along)
    x, y = (dr.dot(basis, frame.to_scene(m.Vector3f(*axis))) for axis in axes)
    return x * x - y * y, 2.0 * x * y
