"""The radar cross section of conducting bodies and plates, by physical optics."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import (
    checked_count,
    checked_flag,
    takes_frequency,
    warn_caller,
)
from polywigner.scattering.antennas import (
    Polarisation,
    Source,
    broadcast_shape,
    checked_polarisations,
    checked_unit_vectors,
    checked_wavelengths,
)
from polywigner.scattering.beams import sums_of_beams
from polywigner.scattering.facets import Body, Facets, facets_of
from polywigner.scattering.interreflections import warn_of_reflections
from polywigner.scattering.near_fields import near_sections
from polywigner.transforms.traced_sources import check_no_drjit

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
