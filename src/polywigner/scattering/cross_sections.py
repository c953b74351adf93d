"""Radar cross sections of conducting bodies and plates by physical optics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import InitVar, dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args, overload

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import (
    broadcast_shape,
    checked_choice,
    checked_count,
    checked_flag,
    checked_vectors,
    checked_wavelength,
    takes_frequency,
    warn_caller,
)
from polywigner.geometry.polyhedron import axes_across
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.propagation.point_grids import angle_axes, checked_angles
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.scattering.facet_beams import sums_of_beams
from polywigner.scattering.facets import Body, Facets, facets_of, warn_of_reflections
from polywigner.scattering.near_fields import (
    Channel,
    Polarisation,
    Source,
    checked_polarisations,
    near_sections,
    normalised_vectors,
)
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray


# Largest number of reflections, which suffices for corner reflectors of three perpendicular
# mirrors. Each further reflection multiplies the number of beams.
MOST_BOUNCES = 3


@overload
def rcs(
    body: Body,
    to_radar: ArrayLike,
    wavelength: ArrayLike = ...,
    to_transmitter: ArrayLike | None = ...,
    polarisation: Polarisation | None = ...,
    *,
    source: Source | None = ...,
    receiver: Source | None = ...,
    tolerance: float = ...,
    return_power: Literal[False] = ...,
    normalise: Literal["radiated", "aperture"] = ...,
    bounces: int = ...,
    frequency: float = ...,
) -> Floats: ...


@overload
def rcs(
    body: Body,
    to_radar: ArrayLike,
    wavelength: ArrayLike = ...,
    to_transmitter: ArrayLike | None = ...,
    polarisation: Polarisation | None = ...,
    *,
    source: Source | None = ...,
    receiver: Source | None = ...,
    tolerance: float = ...,
    return_power: Literal[True],
    normalise: Literal["radiated", "aperture"] = ...,
    bounces: int = ...,
    frequency: float = ...,
) -> tuple[Floats, Floats]: ...


@takes_frequency
def rcs(
    body: Body,
    to_radar: ArrayLike,
    wavelength: ArrayLike,
    to_transmitter: ArrayLike | None = None,
    polarisation: Polarisation | None = None,
    *,
    source: Source | None = None,
    receiver: Source | None = None,
    tolerance: float = 1e-3,
    return_power: bool = False,
    normalise: Literal["radiated", "aperture"] = "radiated",
    bounces: int = 1,
) -> Any:
    """Return the radar cross section of a perfect conductor by physical optics (docs/rcs.md).

    The current on an illuminated face is 2 n x H, as on an infinite plane with the normal n in the
    incident magnetic field H. The scattered field of each face is the exact Fourier transform of
    its polygon, equation (SC1). The parts of faces that transmitter and receiver see are computed
    as exact polygons. Physical optics is valid near specular directions, both for faces of several
    wavelengths or more and for fine meshes of smooth bodies. Edge diffraction is not included.

    Array arguments broadcast against each other.

    Parameters
    ----------
    body : Polyhedron, Aperture, PlacedAperture, Array or list
        A closed body, a plate, or a list of bodies and plates, which shadow each other. A plate has
        two sides and may have holes. The weights of an Array must be 1.
    to_radar : array_like, shape (..., 3)
        Unit vectors from the body towards the radar's receiver.
    wavelength : array_like, shape (...)
        Wavelengths in m, or ``frequency=``, one number in Hz.
    to_transmitter : array_like, shape (..., 3), optional
        Unit vectors towards the transmitter. Default: ``to_radar`` (monostatic).
    polarisation : str or pair, optional
        Received and incident polarisation:

        - None: the power of the total scattered field, averaged over incident polarisations. For a
          monostatic radar, this is the co-polar cross section, which does not depend on the
          polarisation.
        - "vv", "hh", "vh" or "hv", receiver first. v is along the polar angle from +z of the body's
          frame, and h along the azimuth, both for the direction of the receiver or transmitter. For
          a direction along z, the azimuth is zero.
        - Without ``source``, a pair of unit vectors of shape (..., 3), receiver first. Each vector
          is normal to the direction of the receiver or transmitter, and is complex for circular
          polarisations. Specify the receiver as if its antenna radiated.
        - With ``source``, the polarisation of both antennas, or a pair of polarisations, receiver
          first. A polarisation is "x", "45 deg", "right" or a Jones vector, as in
          :func:`polywigner.field`, and refers to the axes of the source. Fields are then electric
          fields of Huygens' currents.
    source : Aperture or Array, optional
        Antenna of a radar near the body. The antenna lies in the plane z = 0 of its frame and
        radiates along +z. Its exact field (:func:`amplitude`) illuminates the body and weights the
        received field, as in :func:`coupling` (docs/rcs.md, (SC3)). With ``source``, ``to_radar``
        and ``to_transmitter`` are vectors or poses. Vectors of shape (..., 3) in m extend from the
        centre of the body's bounding box to the source, which faces that centre with its y axis
        towards +z of the body. Poses of shape (..., 4, 4) map the body's frame into the source's
        frame. By default antennas are far away.
    receiver : Aperture or Array, optional
        Receiving antenna. Default: ``source``.
    tolerance : float, default 1e-3
        Allowed error with ``source``, from 1e-6 to 0.1. It is relative to the amplitude that would
        result if all illuminated parts contributed in phase. The illuminated parts are divided into
        pieces on which the fields are plane waves.
    return_power : bool, default False
        Whether to also return the ratio of received to transmitted power. Requires ``source``.
    normalise : {"radiated", "aperture"}, default "radiated"
        Definition of transmitted power with ``source``, as in :func:`coupling`.
    bounces : {1, 2, 3}, default 1
        Maximum number of reflections; corner reflectors require 2 or 3. Reflected beams illuminate
        exact polygons on other faces (docs/rcs.md, (SC6)). Must be 1 with ``source``.

    Returns
    -------
    rcs : float or ndarray, shape (...)
        Cross section in m^2. It is NaN, with a warning, in directions whose polygons cannot be
        computed. With ``source``, it is the cross section of a small body at the centre of the
        bounding box that would return the same power. At large distances, this value approaches the
        far-field cross section. With ``return_power``, a pair of cross section and power ratio.

    Warns
    -----
    PolywignerWarning
        If a face is smaller than a square wavelength. Triangles that join smoothly count as one
        face. With ``bounces=1``, also if faces illuminate each other, as in corner reflectors.

    Raises
    ------
    ArgumentError
        If ``body`` has the wrong type, a vector is not of unit length, a polarisation is not normal
        to its direction, or there are too many beams.
    GeometryError
        If a pose is not rigid, or part of the body is behind the plane of an antenna.

    Notes
    -----
    Rounding errors are relative to the amplitude of a flat plate with the area of all
    illuminated faces. The relative error is about 1e-15, times the body's size in wavelengths if
    that is above 1. For partly shadowed faces it is 1e-12. A face within 1e-12 rad of edge-on
    counts as dark.

    The computing time is proportional to the product of the numbers of triangles, directions and
    wavelengths. Concave bodies require polygon operations for each direction. For a body of 500
    triangles, each additional reflection takes about 0.1 s per direction (docs/rcs.md).

    Source: E. F. Knott, "Radar cross section", ch. 14 of M. I. Skolnik (ed.), "Radar Handbook", 3rd
    ed. (2008); W. B. Gordon, IEEE Trans. Antennas Propag. 23, 590 (1975). Cross sections are not
    part of the paper of polywigner.

    Examples
    --------
    >>> import numpy as np
    >>> import polywigner as pw
    >>> sigma = pw.rcs(pw.shapes.square(5.0), (0.0, 0.0, 1.0), frequency=1e9)
    >>> round(10 * np.log10(sigma), 3)  # 4 pi A^2 / wavelength^2
    np.float64(49.414)

    Two plates of 1 m at right angles, a dihedral: 8 pi a^4 / wavelength^2 from two reflections.

    >>> upright = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0.5], [0, 0, 0, 1.0]])
    >>> floor = pw.shapes.square(1.0).placed(
    ...     [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    ... )
    >>> pair = [floor, pw.shapes.square(1.0).placed(upright)]
    >>> sigma = pw.rcs(pair, np.array([1, 0, 1]) / np.sqrt(2), 0.03, bounces=2)
    >>> round(float(sigma * 0.03**2 / (8 * np.pi)), 2)
    1.0
    """
    check_no_drjit(to_radar=to_radar, to_transmitter=to_transmitter)
    facets = facets_of(body)
    expected = "expected wavelengths to be numbers above zero, in m"
    lengths = checked_vectors(wavelength, expected, ())
    usable = (lengths > 0) & np.isfinite(lengths)
    if not usable.all():
        raise ArgumentError(f"{expected}, got {lengths[~usable].flat[0]:g}; check the unit")
    if lengths.size:
        warn_of_small(facets, float(lengths.min()))
    checked_flag(return_power, "return_power")
    reflections = checked_count(bounces, "bounces", 1, MOST_BOUNCES)
    if source is not None:
        if reflections > 1:
            raise ArgumentError(
                f"bounces={reflections} cannot be combined with a source, because later "
                "reflections are computed for plane waves; pass bounces=1, or omit source for "
                "antennas far away"
            )
        radar = source, receiver, polarisation, tolerance, normalise
        area, power = near_sections(facets, to_radar, to_transmitter, lengths, *radar)
        return (area[()], power[()]) if return_power else area[()]
    if receiver is not None or return_power:
        raise ArgumentError("receiver and return_power require a source; pass the argument source")
    return far_sections(facets, lengths, to_radar, to_transmitter, polarisation, reflections)[()]


def far_sections(
    facets: Facets,
    lengths: Floats,
    to_radar: ArrayLike,
    to_transmitter: ArrayLike | None,
    polarisation: Polarisation | None,
    bounces: int,
    *,
    warns: bool = True,
) -> Floats:
    """Return radar cross sections (...) in m^2 for distant antennas, with parameters as in `rcs`.

    ``lengths``: wavelengths in m. ``warns``: whether to warn if faces illuminate each other. A
    cross section is NaN, with a warning, if its computation fails.
    """
    receiver = normalised_vectors("to_radar", to_radar)
    transmitter = receiver
    if to_transmitter is not None:
        transmitter = normalised_vectors("to_transmitter", to_transmitter)
    polarisations: tuple[Complex, ...] = ()
    if polarisation is not None:
        polarisations = checked_polarisations(polarisation, receiver, transmitter)
    vectors = receiver, transmitter, *polarisations
    shape = broadcast_shape(lengths.shape, *(v.shape[:-1] for v in vectors))
    s, t, *both = (
        np.broadcast_to(vectors, (*shape, 3)).reshape(-1, 3)
        for vectors in (receiver, transmitter, *polarisations)
    )
    if warns and bounces == 1:
        warn_of_reflections(facets, -t)
    flat = np.broadcast_to(lengths, shape).ravel()
    sums, later = sums_of_beams(facets, -t, s, flat, to_transmitter is None, bounces)
    areas = 4 * np.pi / flat**2 * _power(sums, later, -t, s, both)
    return areas.reshape(shape)


def warn_of_small(facets: Facets, wavelength: float) -> None:
    """Warn if a face is smaller than a square wavelength."""
    if facets.least_face < wavelength:
        warn_caller(
            "physical optics requires faces of several wavelengths, but at the wavelength of "
            f"{wavelength:.3g} m the smallest face is {facets.least_face:.3g} m wide (the square "
            "root of its area)"
        )


def _power(
    sums: Complex, later: Complex | None, k: Floats, s: Floats, polarisations: list[Complex]
) -> Floats:
    """Return ``|q.(N x h + M h)|^2`` of equations (SC1) and (SC6) in m^4 for m samples.

    ``sums`` is N and ``later`` is M. ``polarisations``: q of the receiver and p of the incident
    wave with h = k x p. Without ``polarisations``, the total power is averaged over incident
    polarisations.
    """

    def field(h: Floats | Complex) -> Complex:
        """Return the scattered field for the magnetic field h (m, 3), shape (m, 3)."""
        first: Complex = np.cross(sums, h)
        return first if later is None else first + np.einsum("mij,mj->mi", later, h)

    if polarisations:
        q, p = polarisations
        return np.asarray(np.abs((q * field(np.cross(k, p))).sum(axis=1)) ** 2)
    total = np.zeros(len(k))
    for h in np.moveaxis(axes_across(k), 1, 0):
        there = field(h)
        there -= s * (s * there).sum(axis=1, keepdims=True)
        total += (np.abs(there) ** 2).sum(axis=1)
    return total / 2


_REFLECTIONS = {1: "one reflection", 2: "two reflections", 3: "three reflections"}
# Number of directions per block.
_TOGETHER = 200
# Largest number of directions that are tested for further reflections, which cause a warning.
_MOST_WARNED = 4096
# In floating point, cos(pi/2) is 6e-17, so cosines below _AT_POLE count as zero. At the poles, most
# cross sections depend on the azimuth, through the polarisation and through walls parallel to z,
# which are edge-on. These cross sections are computed at the angle _NEAR_POLE [rad] from the pole.
_AT_POLE, _NEAR_POLE = 1e-15, 1e-8


@takes_frequency
def rcs_pattern(
    body: Body,
    wavelength: float,
    azimuth: ArrayLike,
    elevation: ArrayLike,
    *,
    to_transmitter: ArrayLike | None = None,
    polarisation: Channel | None = None,
    bounces: int = 1,
    progress: bool | None = None,
) -> xarray.Dataset:
    """Return the radar cross section of a body as a function of azimuth and elevation.

    Parameters
    ----------
    body : Polyhedron, Aperture, PlacedAperture, Array or list
        As in :func:`rcs`.
    wavelength : float
        Wavelength in m, or ``frequency=`` in Hz.
    azimuth : array_like, shape (n,), or float
        Angles in rad about z, from +x towards +y.
    elevation : array_like, shape (m,), or float
        Angles in rad above the plane z = 0, from -pi/2 to pi/2. At -pi/2 and pi/2, the polarisation
        vectors depend on the azimuth, and the cross section is the limit for each azimuth.
    to_transmitter : array_like, shape (3,), optional
        Unit vector towards a fixed transmitter. By default the radar is monostatic.
    polarisation : {"vv", "hh", "vh", "hv"}, optional
        As in :func:`rcs`.
    bounces : {1, 2, 3}, default 1
        Maximum number of reflections, as in :func:`rcs`.
    progress : bool, optional
        Whether to show a progress bar. By default, a bar is shown if stderr is a terminal.

    Returns
    -------
    xarray.Dataset
        ``rcs`` in m^2 with the dimensions (azimuth, elevation). The attributes are the wavelength,
        the frequency, the polarisation, ``bounces``, the number of triangles, the largest cross
        section, and the direction of a fixed transmitter.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range, as in :func:`rcs`.

    Examples
    --------
    >>> import polywigner as pw
    >>> pattern = pw.rcs_pattern(pw.shapes.square(5.0), 0.3, 0.0, 1.5707963267948966)
    >>> round(pattern["rcs"].values.item())  # 4 pi 5^4/0.3^2
    87266
    """
    pattern = Pattern(body, wavelength, azimuth, elevation, to_transmitter, polarisation, bounces)
    with progress_bar("radar cross sections", math.prod(pattern.shape), show=progress) as advance:
        return pattern.dataset(pattern.values(advance))


@dataclass(eq=False)
class Pattern:
    """Radar cross sections over angles, with the parameters of :func:`rcs_pattern`."""

    body: InitVar[Body]
    wavelength: float
    azimuth: Any
    elevation: Any
    to_transmitter: Any = None
    polarisation: Any = None
    bounces: int = 1
    facets: Facets = field(init=False)

    def __post_init__(self, body: Body) -> None:
        """Check all arguments, and convert the body to triangles."""
        self.wavelength = checked_wavelength(self.wavelength)
        self.azimuth = checked_angles(self.azimuth, "azimuth", math.inf)
        self.elevation = checked_angles(self.elevation, "elevation", math.pi / 2)
        if self.polarisation is not None:
            checked_choice(self.polarisation, "polarisation", get_args(Channel))
        if self.to_transmitter is not None:
            self.to_transmitter = normalised_vectors("to_transmitter", self.to_transmitter, 3)
        self.facets = facets_of(body)
        self.bounces = checked_count(self.bounces, "bounces", 1, MOST_BOUNCES)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of azimuths and elevations."""
        return len(self.azimuth), len(self.elevation)

    def values(self, advance: Callable[[int], None]) -> Floats:
        """Return cross sections at all angles in m^2, shape (n, m).

        ``advance`` is called with the number of new values. Values at azimuths with too many beams
        are NaN, with a warning. Raises ArgumentError if the first azimuths have too many beams.
        """
        warn_of_small(self.facets, self.wavelength)
        if self.bounces == 1:
            warn_of_reflections(self.facets, self._some_directions())
        values = np.empty(self.shape)
        for rows in index_blocks(len(values), _TOGETHER // max(1, len(self.elevation))):
            try:
                values[rows] = self.at(self.azimuth[rows, None], self.elevation)
            except ArgumentError as error:  # too many overlaps or beams
                if rows.start == 0:
                    raise
                warn_caller(f"the cross sections at some azimuths are NaN: {error}")
                values[rows] = np.nan
            advance(values[rows].size)
        return values

    def at(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the cross sections in m^2 at angles in rad, which broadcast against each other."""
        lengths = np.asarray(self.wavelength)
        towards = self._towards(azimuth, elevation)
        how = self.to_transmitter, self.polarisation, self.bounces
        return far_sections(self.facets, lengths, towards, *how, warns=False)

    def dataset(self, values: Floats) -> xarray.Dataset:
        """Return cross sections at all angles as a dataset."""
        from polywigner import __version__

        about: dict[str, Any] = {
            "wavelength": self.wavelength,
            "frequency": SPEED_OF_LIGHT / self.wavelength,
            "polarisation": self.polarisation or "total, mean over incident polarisations",
            "bounces": self.bounces,
            "triangles": len(self.facets.corner),
            "largest_rcs": float(np.fmax.reduce(values, axis=None)),
        }
        if self.to_transmitter is not None:
            about["to_transmitter"] = self.to_transmitter.tolist()
        of_values = {
            "units": "m2",
            "long_name": "radar cross section",
            "method": f"physical optics: {_REFLECTIONS[self.bounces]}, no edge diffraction",
            "polywigner_version": __version__,
        }
        axes = angle_axes(azimuth=self.azimuth, elevation=self.elevation)
        table = {"rcs": labelled_array(values, tuple(axes), of_values)}
        return labelled_arrays(table, axes, about)

    def _some_directions(self) -> Floats:
        """Return propagation directions (k, 3) of incident waves, for the reflection test."""
        if self.to_transmitter is not None:
            return -self.to_transmitter[None]
        step = math.ceil(math.sqrt(math.prod(self.shape) / _MOST_WARNED))
        return -self._towards(self.azimuth[::step, None], self.elevation[::step]).reshape(-1, 3)

    def _towards(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return unit vectors (..., 3) towards the radar, displaced from the poles.

        The angles are in rad.
        """
        across = np.cos(elevation)
        is_same_around = self.to_transmitter is None and self.bounces == 1
        pole = 0.0 if is_same_around else _NEAR_POLE
        across = np.where(np.abs(across) < _AT_POLE, pole, across)
        x, y = across * np.cos(azimuth), across * np.sin(azimuth)
        return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=-1)
