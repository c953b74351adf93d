"""Rays drawn from the Wigner function of a source."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution import Engine
from polywigner.geometry import PlacedAperture, Wavefront
from polywigner.geometry.arguments import (
    checked_count,
    checked_number,
    checked_wavelength,
    rigid_pose,
    takes_frequency,
)
from polywigner.illumination.obliquities import (
    ObliquityName,
    checked_obliquity,
    emission_factor,
    weighted_sources,
)
from polywigner.propagation.far_fields import check_slopes, radiated_power
from polywigner.propagation.stores_layout import source_attrs
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.radiometry.hemisphere import largest_lag
from polywigner.rays.bundles import bundle
from polywigner.rays.draws import (
    BATCHES,
    RaySampling,
    cone_of,
    normal_numbers,
    numbers_of,
    positions_by,
)
from polywigner.transforms import sample_automean, wigner
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import flat_of, is_partly_coherent

if TYPE_CHECKING:
    import xarray

__all__ = ["sample_rays"]

Directions = Literal["beam", "uniform"]

Values = NDArray[np.float64]

# 12 GB of rays; of more draw several sets.
_MOST = 100_000_000
# Rays at a time: some 200 MB.
_BLOCK = 1 << 20


@takes_frequency
def sample_rays(
    source: PlaneSource | Wavefront | PlacedAperture,
    wavelength: float,
    count: int,
    seed: int | np.random.Generator | None = 0,
    *,
    sampling: RaySampling = "uniform",
    cone: float | None = None,
    axis: ArrayLike = (0.0, 0.0, 1.0),
    directions: Directions = "beam",
    to_world: ArrayLike | None = None,
    obliquity: ObliquityName | None = None,
    power: float | None = None,
    aperture_power: float | None = None,
    engine: Engine = "auto",
) -> xarray.Dataset:
    """Rays of a source, weighted by its Wigner function: positions, directions and watts.

    Each of n rays carries ``W(x, s_par/lambda) h/(lambda^2 p n)``, h = g/cos, p the density of rays
    per area and projected solid angle: the sum over rays is the power in their cone, without bias,
    and with no ``cone`` it is :func:`radiated_power`. Weights are negative where W is. Source:
    docs/signed_rays.md, (Y1).

    Trace them through ray optics, then :func:`polywigner.rays.rebuild` the irradiance.

    Parameters
    ----------
    source : Aperture, placed or not, or Array of apertures in the plane z = 0, |u|^2 on it in
        W/m^2, with any fields; or one with a curved or partly coherent wave, of which each ray
        has one tilt, drawn at random. It radiates to +z.
    wavelength : in m.
    count : how many rays, up to 100 million.
    seed : of the numbers, or a NumPy Generator.
    sampling : positions uniform in the automean ("uniform"), or in proportion to the position
        marginal ("marginal"), see :func:`sample_automean`; both from independent random numbers.
        "quasi-random" is uniform from the numbers of Sobol sequences, which leave about half the
        noise (needs scipy, of the extra ``arrays``): 16 independent sets, told apart by the
        coordinate ``batch``.
    cone : half angle in rad of the directions that rays are drawn in; None: the hemisphere.
    axis : unit vector (3,), the middle of the cone in the frame of the source; that of the beam,
        where the source is steered.
    directions : "beam" draws most of them within wavelength/diameter of the axis, of a curved or
        partly coherent wave as far from it as the wave is inclined there, ever fewer outside;
        "uniform" is uniform in projected solid angle.
    to_world : (4, 4) rigid pose of the source; None: its own, or none. Units of m.
    obliquity : as of :func:`irradiance`: None is "rayleigh-sommerfeld-1", h = cos; "paper" is
        h = 1. Curved and partly coherent waves have these two.
    power : radiated in W, over all directions; None: the power of the field as it is.
    aperture_power : in place of power, int |u|^2 over the aperture in W.
    engine : see :func:`fourier`.

    Returns
    -------
    xarray.Dataset with ``position`` (ray, component) in m, ``direction`` (ray, component) and
    ``weight`` (ray) in W. The settings are in its attributes.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for a pose that is
    not rigid, or an Array whose elements do not lie in the plane z = 0; IlluminationError for a
    power asked of a source without any; MissingExtraError without xarray or scipy.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(10e-3)
    >>> rays = pw.sample_rays(square, 3.2e-3, 4096)
    >>> abs(float(rays.weight.sum()) / pw.radiated_power(square, 3.2e-3) - 1) < 0.1
    True
    >>> bool((rays.weight < 0).any())
    True
    """
    radiator, pose = _placed(source, to_world)
    length = checked_wavelength(wavelength)
    density = positions_by(sampling)
    least = 2 * BATCHES if sampling == "quasi-random" else 1
    n = checked_count(count, "count", least, _MOST)
    where = cone_of(cone, axis, _width(directions, radiator, length))
    name = checked_obliquity(obliquity)
    check_slopes(radiator, name)
    flat = flat_of(radiator)
    scale = _scale(radiator, length, name, power, aperture_power)
    parts = weighted_sources(flat, name, length)
    tilts = 2 if is_partly_coherent(radiator) else 0

    position, direction, weight = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    batch = np.empty(n, np.int32) if sampling == "quasi-random" else None
    start = 0
    for numbers, number in numbers_of(sampling, n, seed, _BLOCK, tilts):
        some = slice(start, start + len(numbers))
        first, tilt = np.split(numbers, [numbers.shape[1] - tilts], axis=1)
        places, per_area = sample_automean(flat, first[:, 2:], density, engine=engine)
        turn = _turn(radiator, places, tilt)
        own, solid_angle = where.directions(first[:, :2], None if turn is None else length * turn)
        radiance = _radiance(parts, places, own, turn, length, engine)
        weight[some] = radiance * (scale / n) * solid_angle / per_area
        position[some] = places @ pose[:3, :2].T + pose[:3, 3]
        direction[some] = own @ pose[:3, :3].T
        if batch is not None and number is not None:
            batch[some] = number
        start += len(numbers)
    attrs = {
        "wavelength": length,
        "frequency": SPEED_OF_LIGHT / length,
        "count": n,
        "sampling": sampling,
        "obliquity": name,
        **source_attrs(radiator),
    }
    return bundle(position, direction, weight, batch, attrs)


def _turn(source: PlaneSource | Wavefront, places: Values, numbers: Values) -> Values | None:
    """Frequencies (n, 2) by which the wave is inclined at each place; None: nowhere.

    W of the curved wave is that of the flat source less its slope Q (x - c), (Q2), and of partly
    coherent light the mean over normal tilts, (PC4), of which each ray has one.
    """
    if not isinstance(source, Wavefront):
        return None
    turn = (places - source.centre) @ source.curvature
    if not source.is_coherent:
        turn += normal_numbers(numbers) / (2 * math.pi * source.coherence_width)
    return np.asarray(turn)


def _placed(source: Any, to_world: Any) -> tuple[PlaneSource | Wavefront, Values]:
    """The source in its own plane, and its pose (4, 4)."""
    if not isinstance(source, PlacedAperture):
        radiator = checked_radiator(source, partly=True)
        return radiator, np.eye(4) if to_world is None else rigid_pose(to_world)
    if to_world is not None:
        raise ArgumentError(
            "expected a placed aperture or to_world, got both; a placed aperture has a pose"
        )
    return source.aperture, source.pose


def _width(directions: Any, source: PlaneSource | Wavefront, wavelength: float) -> float:
    """The sine of the angle up to which rays are densest."""
    if directions == "uniform":
        return math.inf
    if directions != "beam":
        raise ArgumentError(f'expected directions to be "beam" or "uniform", got {directions!r}')
    return wavelength / largest_lag(source)


def _scale(
    source: Any, wavelength: float, obliquity: str, power: Any, aperture_power: Any
) -> float:
    """Power in W that is wanted over the power that the field has as it is."""
    if power is not None and aperture_power is not None:
        raise ArgumentError(
            "expected power or aperture_power, got both; power leaves through the hemisphere in "
            "front, aperture_power is the integral of |u|^2 over the aperture: give one"
        )
    if aperture_power is not None:
        return _watts("aperture_power", aperture_power) / _energy(flat_of(source))
    if power is None:
        return 1.0
    return _watts("power", power) / radiated_power(source, wavelength, obliquity)  # type: ignore


def _watts(name: str, power: Any) -> float:
    meaning = "a number in W above zero"
    watts = checked_number(power, name, meaning)
    if not watts > 0:
        raise ArgumentError(f"expected {name} as {meaning}, got {power!r}")
    return watts


def _energy(source: PlaneSource) -> float:
    """int |u|^2 in W."""
    energy = energy_of(source)
    if not energy > 0:
        raise IlluminationError(
            "expected a source with a field to give power to, got elements that cancel each other "
            "everywhere"
        )
    return energy


def _radiance(
    parts: Any,
    places: Values,
    direction: Values,
    turn: Values | None,
    wavelength: float,
    engine: Engine,
) -> Values:
    """Sums over the parts of their radiance times h, (n,) in W/(m^2 sr)."""
    nu, cosine = direction[:, :2] / wavelength, direction[:, 2]
    if turn is not None:
        nu = nu - turn
    total = np.zeros(len(places))
    for source, forms in parts:
        total += wigner(source, places, nu, engine=engine) * emission_factor(forms, cosine)
    return total / wavelength**2
