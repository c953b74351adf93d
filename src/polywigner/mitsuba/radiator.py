"""A source as the emitter sees it: centred, with its energy and the region that radiates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.errors import PolywignerError, SceneError
from polywigner.geometry import Aperture, PlacedAperture, Wavefront
from polywigner.geometry.parts import union_on_grid
from polywigner.illumination import Array
from polywigner.illumination.support import moved_source, mutual_support
from polywigner.mitsuba.radiance import PLAIN, Mixture, check_obliquity
from polywigner.plans import shifts_samples
from polywigner.propagation.far_fields import check_slopes, powers_of
from polywigner.radiometry.directions import checked_radiator
from polywigner.reception.norms import NORMALISATIONS
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import checked_wavefront, flat_of


@dataclass(frozen=True, eq=False)
class Radiator:
    """A source in the plane with its numbers for an emitter, in SI units."""

    source: Any
    """An Aperture or an Array, or one with a curved wave."""
    centre: npt.NDArray[np.float64]
    """(2,), of the region that radiates, read-only."""
    support: Aperture
    """A region relative to the centre outside of which W is zero."""
    energy: float
    """int |u|^2 dx, in m^2 for fields of unit 1."""
    shifts: npt.NDArray[np.float64]
    """(k, 3): a sample of a position stands for those at these shifts (x, y), by weights that add
    up to 1; read-only."""

    @property
    def centred(self) -> Any:
        """The source relative to the centre.

        Single precision resolves positions by 6e-8 of their distance from the origin, which should
        not be more than the size of the source.
        """
        if isinstance(self.source, Wavefront):
            return self.source.on(moved_source(self.source.source, -self.centre), -self.centre)
        return moved_source(self.source, -self.centre)


def radiator_of(source: Any, obliquity: str, antithetic: bool = False) -> Radiator:
    """An aperture, or an array of apertures in the plane z = 0, prepared for an emitter.

    ``antithetic``: samples of arrays on a lattice stand for a few midpoints of elements at a time.

    Raises SceneError for other sources, for those whose field is zero, and for an obliquity that is
    not known.
    """
    if not isinstance(flat_of(source), Aperture | Array):
        raise SceneError(
            "expected an aperture, or an array of apertures in one plane, to radiate in a scene, "
            f"got {type(source).__name__}; {_advice(source)}"
        )
    check_obliquity(obliquity)
    try:
        check_slopes(source, obliquity)
        if isinstance(source, Wavefront):
            flat = _prepared(checked_wavefront(source).source, antithetic)
            return replace(flat, source=source)
        return _prepared(source, antithetic)
    except PolywignerError as error:
        raise SceneError(str(error)) from None


# Read when an entry is made, when its scene is loaded, and whenever a parameter changes.
@lru_cache(maxsize=64)
def norm_of(
    source: Any,
    wavelength: float,
    obliquity: str,
    mixture: Mixture = PLAIN,
    normalise: str = NORMALISATIONS[0],
) -> float:
    """Power of a source's field in W for |u|^2 in W/m^2, as ``normalise`` counts it.

    ``radiated``: the power that leaves through the hemisphere in front, by the obliquity and, of a
    mixture, the mean over its waves. ``aperture``: int |u|^2.

    Raises SceneError for a source that radiates nothing.
    """
    if normalise == "aperture":
        return _energy(source)
    try:
        radiator = checked_radiator(source)
        if mixture.is_plain:
            return powers_of(radiator, wavelength, obliquity)[0]
        return mixture.power(radiator, wavelength, obliquity)
    except PolywignerError as error:
        raise SceneError(str(error)) from None


def emitted_power(
    radiator: Radiator, norm: float, power: float | None, aperture_power: float | None
) -> float:
    """Radiated power of an emitter in W; its ``norm`` for neither number.

    ``norm``: the power that the field as it is radiates; ``aperture_power``: int |u|^2 in W.

    Raises SceneError for both.
    """
    if power is not None and aperture_power is not None:
        raise SceneError(
            "expected power or aperture_power, got both; power leaves through the hemisphere in "
            "front, aperture_power is the integral of |u|^2 over the aperture: give one"
        )
    if aperture_power is not None:
        return norm * (aperture_power / radiator.energy)
    return norm if power is None else power


# A scene entry is checked when it is made, and read when the scene is loaded.
@lru_cache(maxsize=16)
def _prepared(source: Aperture | Array, antithetic: bool) -> Radiator:
    shifts = _half_pitches(source) if antithetic else np.array([[0.0, 0.0, 1.0]])
    shifts.setflags(write=False)
    support = mutual_support(source)
    if len(shifts) > 1:
        support = Aperture(
            union_on_grid([support.moved(-shift).polygons for shift in shifts[:, :2]])
        )
    energy = _energy(source)
    return Radiator(source, support.centre, support.moved(-support.centre), energy, shifts)


def _half_pitches(source: Aperture | Array) -> npt.NDArray[np.float64]:
    """(k, 3): places half a pitch apart, about 0, along each direction of a lattice; weights.

    W of a lattice of elements lives about the midpoints of pairs, half a pitch apart. Off the beams
    it changes its sign from each of them to the next, while its size grows evenly towards the
    middle (the number of pairs): second differences, 1/4, 1/2, 1/4, leave next to nothing.
    """
    lattice = None
    if isinstance(source, Array) and source.phased is not None:
        lattice = source.phased.sites.lattice
    found = np.array([[0.0, 0.0, 1.0]])
    if lattice is None:
        return found
    for count, pitch in zip(lattice.weights.shape, lattice.basis, strict=True):
        if shifts_samples(count):
            steps = np.outer([-0.5, 0.0, 0.5], [*pitch, 0.0])
            steps[:, 2] = 0.25, 0.5, 0.25
            places = found[:, None, :2] + steps[:, :2]
            shares = found[:, None, 2:] * steps[:, 2:]
            found = np.concatenate([places, shares], axis=-1).reshape(-1, 3)
    return found


def _advice(source: Any) -> str:
    if isinstance(source, PlacedAperture):
        return "leave its pose out, and give it as the to_world of the shape"
    return "make rectangles of slits" if type(source).__name__ == "Slits" else "use an aperture"


def _energy(source: Aperture | Array | Wavefront) -> float:
    source = flat_of(source)
    if isinstance(source, Aperture) and source.illumination is None:
        return source.area
    energy = energy_of(source)
    if not energy > 0:
        raise SceneError(
            "expected a source with a field, got elements that cancel each other everywhere"
        )
    return energy
