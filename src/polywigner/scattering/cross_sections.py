"""The radar cross section of conducting bodies and plates, by physical optics; its patterns."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import InitVar, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import (
    checked_count,
    checked_flag,
    checked_wavelength,
    takes_frequency,
    warn_caller,
)
from polywigner.propagation.places import checked_angles
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.scattering.antennas import (
    Channel,
    Polarisation,
    Source,
    broadcast_shape,
    checked_channel,
    checked_polarisations,
    checked_unit_vectors,
    checked_wavelengths,
)
from polywigner.scattering.facet_beams import sums_of_beams
from polywigner.scattering.facets import Body, Facets, facets_of, warn_of_reflections
from polywigner.scattering.near_fields import near_sections
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


# Three mirrors at right angles send a wave back; each reflection more multiplies the beams.
MOST_BOUNCES = 3


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
    """Radar cross section of a perfect conductor, by physical optics (docs/rcs.md, (SC1)).

    Currents of lit faces are those of an infinite plane, 2 n x H; the field of each face is its
    Fourier transform in closed form. The parts that transmitter and receiver see are exact
    polygons. Valid for faces of some wavelengths or more, or fine meshes of smooth bodies, near
    specular directions; no waves of edges.

    Parameters
    ----------
    body : a Polyhedron; an Aperture or placed Aperture, which is a plate with two sides, holes
        and all; or an Array (without weights) or a list of these, which shadow each other.
    to_radar : (..., 3) unit vectors from the body towards the radar's receiver.
    wavelength : (...) in m; or ``frequency=``, one number in Hz.
    to_transmitter : (..., 3) unit vectors towards the transmitter; None: it is with the receiver.
    polarisation : which part of the scattered field counts, of which incident one.
        None: all of it, mean over the incident polarisations: of a radar with one antenna the
        co-polar cross section, which does not depend on the polarisation.
        "vv", "hh", "vh" or "hv": receiver first, v along the polar angle from +z of the body's
        frame, h along the azimuth, at each one's own direction (along z at azimuth 0).
        Or a pair of unit vectors (..., 3), receiver first, across each one's direction; complex
        ones for circular polarisations, which the receiver's antenna would radiate.
        With ``source`` also the antennas' own: "x", "45 deg", "right" or a Jones vector, as of
        :func:`polywigner.field` along the axes of the source, for both, or a pair of these,
        receiver first. Then their vector fields count, of Huygens' currents.
    source : the radar's antenna, an Aperture or Array in the plane z = 0 of its own frame, for a
        body near it: its exact field (:func:`amplitude`) lights the body, and its field receives,
        as in :func:`coupling` (docs/rcs.md, (SC3)). ``to_radar`` and ``to_transmitter`` then say
        where it stands: vectors (..., 3) in m from the middle of the box around the body to the
        source, which looks back with its y axis upwards (towards +z of the body); or poses
        (..., 4, 4) that map the body's frame into that of the source, which radiates along its
        +z. None: the antennas are far away.
    receiver : another antenna that receives; None: one like ``source``.
    tolerance : with ``source``: error allowed by splitting what is lit into plane pieces of wave
        fronts, relative to the amplitude of all lit parts in phase, from 1e-6 to 0.1.
    return_power : with ``source``: also return the received over the transmitted power.
    normalise : how these powers count, as in :func:`coupling`: "radiated", or "aperture".
    bounces : reflections that count, 1, 2 or 3, as corner reflectors need: lit polygons go on as
        beams, whose polygons on the faces beyond are exact (docs/rcs.md, (SC6)). Not with
        ``source``.

    All broadcast against each other.

    Returns
    -------
    (...) floats in m^2; NaN, with a warning, in directions whose lit polygons cannot be computed.
    With ``source``, the cross section of a small body that would send back as
    much power from the middle of the box around the body, which tends to that of antennas far
    away; with ``return_power`` a pair of that and of |b|^2 (...). Errors are some 1e-15 of the
    amplitude of a plate of all lit faces, times the body's size in wavelengths where that is above
    1; of parts that stand partly in a shadow, 1e-12 of it. A face seen edge-on, within 1e-12 rad,
    counts as dark.

    Time is linear in the triangles that faces are split into, times directions and wavelengths.
    Bodies that are not convex cost set operations besides, once a direction; each further
    reflection of 500 triangles takes some 0.1 s a direction (docs/rcs.md).

    Warns
    -----
    PolywignerWarning where a face is smaller than a square
    wavelength (facets that join smoothly are one face), and with ``bounces=1`` where the wave goes
    from one face to another, as in corner reflectors; they need not touch.

    Raises
    ------
    ArgumentError for anything but bodies and uniform plates, unit vectors, wavelengths and
    polarisations across the directions; and for more beams than minutes can follow.
    GeometryError for poses that are not rigid, and bodies behind the plane of an antenna.

    Source: E. F. Knott, "Radar cross section", ch. 14 of M. I. Skolnik (ed.), "Radar Handbook", 3rd
    ed. (2008); W. B. Gordon, IEEE Trans. Antennas Propag. 23, 590 (1975). The paper has none.

    >>> import numpy as np
    >>> import polywigner as pw
    >>> sigma = pw.rcs(pw.shapes.square(5.0), (0.0, 0.0, 1.0), frequency=1e9)
    >>> round(10 * np.log10(sigma), 3)  # 4 pi A^2 / wavelength^2
    np.float64(49.414)

    Two plates of 1 m at right angles, a dihedral: 8 pi a^4 / wavelength^2 by two reflections.

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
    lengths = checked_wavelengths(wavelength)
    if lengths.size:
        warn_of_small(facets, float(lengths.min()))
    checked_flag(return_power, "return_power")
    reflections = checked_count(bounces, "bounces", 1, MOST_BOUNCES)
    if source is not None:
        if reflections > 1:
            raise ArgumentError(
                "expected bounces=1 with a source, whose waves are not plane, got "
                f"{reflections}; leave the source out for antennas far away"
            )
        radar = source, receiver, polarisation, tolerance, normalise
        found = near_sections(facets, to_radar, to_transmitter, lengths, *radar)
        return (found[0][()], found[1][()]) if return_power else found[0][()]
    if receiver is not None or return_power:
        raise ArgumentError("expected a source with receiver and return_power, got none; give it")
    return sections(facets, lengths, to_radar, to_transmitter, polarisation, reflections)[()]


def sections(
    facets: Facets,
    lengths: Floats,
    to_radar: ArrayLike,
    to_transmitter: ArrayLike | None,
    polarisation: Polarisation | None,
    bounces: int,
    *,
    warns: bool = True,
) -> Floats:
    """Cross sections (...) in m^2 of a body; parameters as of :func:`rcs`.

    ``warns``: whether to warn of faces that illuminate each other.
    """
    receiver = checked_unit_vectors("to_radar", to_radar)
    transmitter = receiver
    if to_transmitter is not None:
        transmitter = checked_unit_vectors("to_transmitter", to_transmitter)
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
            f"got a face of {facets.least_face:.3g} m, the root of its area, at a wavelength of "
            f"{wavelength:.3g} m: physical optics holds for faces of some wavelengths or more"
        )


def _power(
    sums: Complex, later: Complex | None, k: Floats, s: Floats, polarisations: list[Complex]
) -> Floats:
    """|q.(N x h + M h)|^2 (m,) of receiver q and h = k x p; None of them: see :func:`rcs`."""

    def field(h: Floats | Complex) -> Complex:
        found: Complex = np.cross(sums, h)
        return found if later is None else found + np.einsum("mij,mj->mi", later, h)

    if polarisations:
        q, p = polarisations
        return np.asarray(np.abs((q * field(np.cross(k, p))).sum(axis=1)) ** 2)
    total = np.zeros(len(k))
    for h in _across(k):
        there = field(h)
        there -= s * (s * there).sum(axis=1, keepdims=True)
        total += (np.abs(there) ** 2).sum(axis=1)
    return total / 2


def _across(directions: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (n, 3) across each direction (n, 3), and across each other."""
    one = np.cross(directions, np.eye(3)[np.abs(directions).argmin(axis=1)])
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    return one, np.cross(directions, one)


# ---- patterns -----------------------------------------------------------------------------------

_REFLECTIONS = {1: "one reflection", 2: "two reflections", 3: "three reflections"}
# Directions that are computed together, as beams of several directions are followed at once.
_TOGETHER = 200
# Directions for which the warning of further reflections looks.
_MOST_WARNED = 4096
# cos(pi/2) is 6e-17. Along the z axis backscatter of one reflection is the same for any azimuth.
# Other cross sections depend on it through their polarisations and the walls that are seen. They
# are computed at this angle in rad from the axis, where walls are not edge-on.
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
    """Radar cross section of a body over azimuth and elevation of the radar, as a dataset.

    The values are those of :func:`rcs`, which says what they are and where they hold.

    Parameters
    ----------
    body : as for :func:`rcs`.
    wavelength : in m; or ``frequency=`` in Hz.
    azimuth : (n,) angles in rad about z, from +x towards +y; or one.
    elevation : (m,) angles in rad above the plane z = 0, from -pi/2 to pi/2; or one. At -pi/2 and
        pi/2 the value is the limit for each azimuth: polarisations follow the azimuth there too.
    to_transmitter : unit vector (3,) towards a transmitter that stays; None: it is with the radar.
    polarisation : None, "vv", "hh", "vh" or "hv", as for :func:`rcs`.
    bounces : reflections that count, 1, 2 or 3, as for :func:`rcs`.
    progress : a bar on a terminal; None: if stderr is one.

    Returns
    -------
    xarray.Dataset with
    ``rcs`` (azimuth, elevation) in m^2. Attributes: wavelength, frequency, polarisation, bounces,
    number of triangles, largest cross section, and the transmitter where it stays.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range, as :func:`rcs` does.

    >>> import polywigner as pw
    >>> found = pw.rcs_pattern(pw.shapes.square(5.0), 0.3, 0.0, 1.5707963267948966)
    >>> round(found["rcs"].values.item())  # 4 pi 5^4/0.3^2
    87266
    """
    pattern = Pattern(body, wavelength, azimuth, elevation, to_transmitter, polarisation, bounces)
    with progress_bar("radar cross sections", math.prod(pattern.shape), show=progress) as advance:
        return pattern.dataset(pattern.values(advance))


@dataclass(eq=False)
class Pattern:
    """A pattern that is computed part by part. Parameters and errors: :func:`rcs_pattern`."""

    body: InitVar[Body]
    wavelength: float
    azimuth: Any
    elevation: Any
    to_transmitter: Any = None
    polarisation: Any = None
    bounces: int = 1
    facets: Facets = field(init=False)

    def __post_init__(self, body: Body) -> None:
        self.wavelength = checked_wavelength(self.wavelength)
        self.azimuth = checked_angles(self.azimuth, "azimuth", math.inf)
        self.elevation = checked_angles(self.elevation, "elevation", math.pi / 2)
        if self.polarisation is not None:
            checked_channel(self.polarisation)
        if self.to_transmitter is not None:
            self.to_transmitter = checked_unit_vectors("to_transmitter", self.to_transmitter)
            if self.to_transmitter.ndim > 1:
                raise ArgumentError(
                    "to_transmitter must be one unit vector (3,), got shape "
                    f"{self.to_transmitter.shape}"
                )
        self.facets = facets_of(body)
        self.bounces = checked_count(self.bounces, "bounces", 1, MOST_BOUNCES)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of azimuths and elevations."""
        return len(self.azimuth), len(self.elevation)

    @property
    def together(self) -> int:
        """Number of azimuths that are computed together."""
        return max(1, _TOGETHER // max(1, len(self.elevation)))

    def values(self, advance: Callable[[int], None]) -> Floats:
        """Compute all cross sections (n, m) in m^2; ``advance`` is called with numbers of them."""
        self.warn()
        values, step = np.empty(self.shape), self.together
        for start in range(0, len(values), step):
            rows = values[start : start + step]
            rows[...] = self.part((start, 0), rows.shape)
            advance(rows.size)
        return values

    def warn(self) -> None:
        """Warn where physical optics is a rough approximation."""
        warn_of_small(self.facets, self.wavelength)
        if self.bounces == 1:
            warn_of_reflections(self.facets, self._some_directions())

    def settings(self) -> dict[str, Any]:
        """Return the settings of the values, with a digest of the body."""
        from polywigner import __version__

        arrays = self.facets.corners, self.facets.is_plate
        content = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
        return {
            "wavelength": self.wavelength,
            "polarisation": self.polarisation,
            "bounces": self.bounces,
            "body_sha256": hashlib.sha256(content).hexdigest(),
            "polywigner_version": __version__,
        }

    def part(self, origin: tuple[int, ...], shape: tuple[int, ...]) -> Floats:
        """Compute cross sections of a shape in m^2, from the angles with numbers ``origin`` on."""
        rows, columns = (slice(o, o + n) for o, n in zip(origin, shape, strict=True))
        try:
            return self.at(self.azimuth[rows, None], self.elevation[columns])
        except ArgumentError as error:  # too many overlaps or beams in these directions
            if origin[0] == 0:
                raise
            warn_caller(f"all directions at some azimuths are NaN: {error}")
            return np.full(shape, np.nan)

    def at(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Cross sections (...) in m^2 at angles that broadcast."""
        lengths = np.asarray(self.wavelength)
        towards = self._towards(azimuth, elevation)
        how = self.to_transmitter, self.polarisation, self.bounces
        return sections(self.facets, lengths, towards, *how, warns=False)

    def dataset(self, values: Floats) -> xarray.Dataset:
        """Return the dataset of the cross sections (n, m)."""
        from polywigner import __version__

        about: dict[str, Any] = {
            "wavelength": self.wavelength,
            "frequency": SPEED_OF_LIGHT / self.wavelength,
            "polarisation": self.polarisation or "all, mean over incident ones",
            "bounces": self.bounces,
            "triangles": len(self.facets.corner),
            "largest_rcs": float(np.fmax.reduce(values, axis=None)),
        }
        if self.to_transmitter is not None:
            about["to_transmitter"] = self.to_transmitter.tolist()
        of_values = {
            "units": "m2",
            "long_name": "radar cross section",
            "method": f"physical optics: {_REFLECTIONS[self.bounces]}, no waves of edges",
            "polywigner_version": __version__,
        }
        axes = {
            "azimuth": (self.azimuth, "angle about z from x"),
            "elevation": (self.elevation, "angle above z = 0"),
        }
        angles = {
            name: labelled_array(own, (name,), {"units": "rad", "long_name": meaning})
            for name, (own, meaning) in axes.items()
        }
        table = {"rcs": labelled_array(values, tuple(axes), of_values)}
        return labelled_arrays(table, angles, about)

    def _some_directions(self) -> Floats:
        """Directions (k, 3) of travel of the incident waves: all, or evenly spaced ones."""
        if self.to_transmitter is not None:
            return -self.to_transmitter[None]
        step = math.ceil(math.prod(self.shape) / _MOST_WARNED)
        some = np.unravel_index(np.arange(0, math.prod(self.shape), step), self.shape)
        return -self._towards(self.azimuth[some[0]], self.elevation[some[1]])

    def _towards(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Unit vectors (..., 3) of angles that broadcast."""
        across = np.cos(elevation)
        is_same_around = self.to_transmitter is None and self.bounces == 1
        pole = 0.0 if is_same_around else _NEAR_POLE
        across = np.where(np.abs(across) < _AT_POLE, pole, across)
        x, y = across * np.cos(azimuth), across * np.sin(azimuth)
        return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=-1)
