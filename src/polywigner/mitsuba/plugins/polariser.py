"""Polarisation of sources and receivers in Mitsuba's polarised variants.

In Mitsuba, the Stokes parameters of light along the direction d refer to the axes b =
stokes_basis(d) and d x b. In this package, polarisations refer to the axes of Ludwig's third
definition. A source emits a column of Stokes parameters, and a receiver weights Stokes parameters
by a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import Drjit
from polywigner.geometry.arguments import checked_array
from polywigner.mitsuba.plugins.samplers import Frame, opaque, spectrum
from polywigner.mitsuba.plugins.source_parameters import UNPOLARISED, SourceParameters
from polywigner.numerics import Complex, Floats
from polywigner.source.polarisation import (
    checked_polarisation,
    ludwig_axes,
    polarisation_name,
    stokes_vector,
)

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.placement import PlacedSource


_FULL = "_polarized"

DEFAULT_POLARISATION = "y"


def is_polarised(variant: str | None = None) -> bool:
    """Return whether a variant, by default the current one, is polarised."""
    return (variant or mi.variant() or "").endswith(_FULL)


def polarised_spec(variant: str, spec: SourceParameters, plugin: str) -> SourceParameters:
    """Return parameters, with the default polarisation if a polarised variant requires one.

    Raises SceneError for a polarisation in an unpolarised variant.
    """
    if is_polarised(variant):
        if spec.states_polarisation:
            return spec
        return replace(spec, polarisation=checked_polarisation(DEFAULT_POLARISATION))
    if spec.polarisation is not None:
        raise SceneError(
            f"the polarisation of a {plugin} plugin requires a polarised variant of Mitsuba, got "
            f"{variant}; select a polarised variant with "
            f"polywigner.mitsuba.choose_variant(polarised=True), such as llvm_ad_mono{_FULL}, or "
            "omit the polarisation"
        )
    return spec


def polarisation_summary(
    ends: Sequence[PlacedSource], interferes: bool, requested: Complex | None = None
) -> str:
    """Describe the polarisations of emitters and receivers in a sentence.

    ``requested`` is the Jones vector of emitters and receivers whose polarisation the scene does
    not specify. ``interferes`` is true if amplitudes are added instead of powers.
    """
    if not is_polarised():
        if requested is not None:
            name = polarisation_name(requested)
            return f"{name} at both ends of direct and reflected paths; ignored for scattered power"
        default = f"; {DEFAULT_POLARISATION} at both ends of reflected paths" if interferes else ""
        return f"ignored, both ends match (unpolarised variant){default}"
    groups: dict[str, list[str]] = {}
    for end in ends:
        name = UNPOLARISED if end.polarisation is None else polarisation_name(end.polarisation)
        name += "" if end.states_polarisation or requested is not None else " (default)"
        groups.setdefault(name, []).append(end.name)
    return "; ".join(f"{name}: {', '.join(names)}" for name, names in groups.items())


# Number of channels at the end of an image that contain four Stokes parameters in three colours.
_CHANNELS = 12


def stokes_of(image: npt.ArrayLike) -> Floats:
    """Return the Stokes parameters of an image rendered with the integrator ``stokes``.

    Parameters
    ----------
    image : (height, width, channels) array_like
        Image of :func:`polywigner.mitsuba.render`.

    Returns
    -------
    float array, shape (4, height, width)
        Stokes parameters S0 to S3. S0 is the radiance, which can be negative. S1 is the
        horizontally polarised radiance minus the vertically polarised radiance. S2 is the radiance
        polarised at 45 degrees minus the radiance polarised at -45 degrees. S3 is the left-handed
        radiance minus the right-handed radiance (IEEE). Directions are as seen by the camera, with
        45 degrees between right and up.

    Raises
    ------
    ArgumentError
        If the image has no channels with Stokes parameters.
    """
    values = checked_array(image, "image", 3)
    count = values.shape[-1] - _CHANNELS
    if not 1 <= count <= 4:
        raise ArgumentError(
            'expected an image rendered with the integrator "stokes", got an image with '
            f"{values.shape[-1]} channels"
        )
    colours = values[..., count:].reshape(*values.shape[:2], 4, 3)
    return np.moveaxis(colours.mean(axis=-1), -1, 0)


class Polariser:
    """Converter from scalar values of a source or receiver to polarised spectra."""

    def __init__(self, m: Any, polarisation: Complex | None) -> None:
        self._m, self._is_plain = m, polarisation is None
        self._stokes_vector: list[Drjit] | None = None
        if polarisation is not None and polarisation.ndim == 1:
            self._stokes_vector = [opaque(m, number) for number in stokes_vector(polarisation)]

    def sent(
        self, value: Drjit, direction: Drjit, frame: Frame, active: Drjit, along: Drjit = None
    ) -> Drjit:
        """Return the emitted Stokes vector as the first column of a Mueller matrix.

        ``direction`` is in the source's frame, and ``along`` is the same direction in the scene, by
        default converted by ``frame``. Without a polarisation, the result is an unpolarised
        spectrum.
        """
        if self._is_plain:
            return spectrum(self._m, value, active)
        s0, s1, s2, s3 = self._stokes(value, active)
        along = frame.to_scene(direction) if along is None else along
        c, s = axis_rotation(self._m, direction, frame, along)
        column = (s0, c * s1 + s * s2, c * s2 - s * s1, s3)
        return mueller_matrix(self._m, {(k, 0): value for k, value in enumerate(column)})

    def received(self, value: Drjit, direction: mi.Vector3f, frame: Frame, active: Drjit) -> Drjit:
        """Return half the row vector that weights Stokes parameters, as a Mueller matrix.

        ``direction`` points from the receiver to the source, in the receiver's frame. Without a
        polarisation, the result is an unpolarised spectrum of ``value``, not half of it.
        """
        if self._is_plain:
            return spectrum(self._m, value, active)
        s0, s1, s2, s3 = (0.5 * number for number in self._stokes(value, active))
        c, s = axis_rotation(self._m, direction, frame, -frame.to_scene(direction))
        row = (s0, c * s1 + s * s2, s * s1 - c * s2, s3)
        return mueller_matrix(self._m, {(0, k): value for k, value in enumerate(row)})

    def _stokes(self, value: Drjit, active: Drjit) -> list[Drjit]:
        """Return the four Stokes parameters of a value, referred to the source's axes."""
        value = dr.select(active, value, 0.0)
        # Sources with several polarisations have four components per value.
        if self._stokes_vector is None:
            return [value[k] for k in range(4)]
        return [value * number for number in self._stokes_vector]


def mueller_matrix(m: Any, entries: dict[tuple[int, int], Drjit]) -> Drjit:
    """Return the Mueller matrix with the given elements; all other elements are zero."""
    matrix = dr.zeros(m.Spectrum)
    for index, value in entries.items():
        matrix[index] = m.UnpolarizedSpectrum(value)
    return matrix


def axis_rotation(
    m: Any, direction: mi.Vector3f, frame: Frame, along: mi.Vector3f
) -> tuple[Drjit, Drjit]:
    """Return cosine and sine of twice the angle from Ludwig's first axis to Mitsuba's first axis.

    The angle is positive towards Ludwig's second axis. ``direction`` is a unit vector in the frame
    of the source, and ``along`` the propagation direction in the scene.
    """
    axes = ludwig_axes(direction.x, direction.y, dr.abs(direction.z))
    basis = m.mueller.stokes_basis(along)
    x, y = (dr.dot(basis, frame.to_scene(m.Vector3f(*axis))) for axis in axes)
    return x * x - y * y, 2.0 * x * y
