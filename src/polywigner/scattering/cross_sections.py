"""The radar cross section of conducting bodies and plates, by physical optics."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import takes_frequency, warn_caller
from polywigner.scattering.antennas import Source
from polywigner.scattering.facets import Body, Facets, facets_of, warn_of_corners
from polywigner.scattering.lit_sums import lit_sums
from polywigner.scattering.near_sections import near_sections
from polywigner.scattering.polarisations import (
    Polarisation,
    checked_polarisations,
    checked_unit_vectors,
    checked_wavelengths,
)
from polywigner.scattering.section_slopes import section_slopes

__all__ = ["rcs"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


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
) -> Any:
    """Radar cross section of a perfect conductor, by physical optics (docs/rcs.md, (SC1)).

    The currents of every lit face are those of an infinite plane, 2 n x H; the field of each face
    is its Fourier transform in closed form. Faces are lit where nothing stands before them: the
    visible parts are found as exact polygons, for the transmitter and for the receiver. Valid for
    faces of some wavelengths or more, or fine meshes of smooth bodies, near specular directions;
    one reflection, no waves of edges: a corner reflector is out of reach (docs/rcs.md).

    Parameters
    ----------
    body : a Polyhedron; an Aperture or placed Aperture, which is a plate with two sides, holes
        and all; or an Array (without weights) or a list of these, which shadow each other.
    to_radar : (..., 3) unit vectors from the body towards the radar's receiver; Dr.Jit arrays of
        any kind for results of that kind, with derivatives.
    wavelength : (...) in m; or ``frequency=``, one number in Hz.
    to_transmitter : (..., 3) unit vectors towards the transmitter; None: it is with the receiver.
    polarisation : which part of the scattered field counts, of which incident one.
        None: all of it, mean over the incident polarisations: of a radar with one antenna the
        co-polar cross section, which does not depend on the polarisation.
        "vv", "hh", "vh" or "hv": receiver first, v along the polar angle from +z of the body's
        frame, h along the azimuth, at each one's own direction (along z at azimuth 0).
        Or a pair of unit vectors (..., 3), receiver first, across each one's direction; complex
        ones for circular polarisations, which the receiver's antenna would radiate.
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

    All broadcast against each other.

    Returns
    -------
    (...) floats in m^2. With ``source``, the cross section of a small body that would send back as
    much power from the middle of the box around the body, which tends to that of antennas far
    away; with ``return_power`` a pair of that and of |b|^2 (...). Errors are some 1e-15 of the
    amplitude of a plate of all lit faces, times the body's size in wavelengths where that is above
    1; of parts that stand partly in a shadow, 1e-12 of it. A face seen edge-on, within 1e-12 rad,
    counts as dark.

    Time is linear in the triangles that faces are split into, times directions and wavelengths.
    Bodies that are not convex cost set operations besides, once a direction (docs/rcs.md).

    Warns
    -----
    PolywignerWarning, once for a line of your code, where a face is smaller than a square
    wavelength, of which physical optics says little. Facets that join smoothly are one face. And
    once where faces light each other across a concave edge, as in corner reflectors: what comes
    back by two or three reflections is left out.

    Raises
    ------
    ArgumentError for anything but bodies and uniform plates, unit vectors, wavelengths and
    polarisations across the directions.
    GeometryError for poses that are not rigid, and bodies behind the plane of an antenna.

    Source: E. F. Knott, "Radar cross section", ch. 14 of M. I. Skolnik (ed.), "Radar Handbook", 3rd
    ed. (2008); W. B. Gordon, "Far-field approximations to the Kirchhoff-Helmholtz representations
    of scattered fields", IEEE Trans. Antennas Propag. 23, 590 (1975). The paper has no scattering.

    >>> import numpy as np
    >>> import polywigner as pw
    >>> sigma = pw.rcs(pw.shapes.square(5.0), (0.0, 0.0, 1.0), frequency=1e9)
    >>> round(10 * np.log10(sigma), 3)  # 4 pi A^2 / wavelength^2
    np.float64(49.414)
    """
    facets = facets_of(body)
    lengths = checked_wavelengths(wavelength)
    if lengths.size:
        _warn_of_small(facets, float(lengths.min()))
    if source is not None:
        found = near_sections(
            facets,
            source,
            receiver,
            to_radar,
            to_transmitter,
            lengths,
            polarisation,
            tolerance,
            normalise,
        )
        return (found[0][()], found[1][()]) if return_power else found[0][()]
    if receiver is not None or return_power:
        raise ArgumentError("expected a source with receiver and return_power, got none; give it")
    find = partial(_sections, facets, lengths, polarisation)
    if execution.is_drjit(to_radar) or execution.is_drjit(to_transmitter):
        points = [("to_radar", to_radar), ("to_transmitter", to_transmitter)]
        if to_transmitter is None:
            points.pop()
        return execution.hosted_values(find, points, 3)
    return find((to_radar, to_transmitter))[0][()]


def _sections(
    facets: Facets,
    lengths: Floats,
    polarisation: Polarisation | None,
    directions: Sequence[Any],
    wanted: Sequence[bool] = (False, False),
) -> tuple[Floats, list[Floats | None]]:
    """Cross sections (...) and their derivatives (..., 3) in directions that want them."""
    to_radar, to_transmitter = (*directions, None)[:2]
    receiver = checked_unit_vectors("to_radar", to_radar)
    transmitter = receiver
    if to_transmitter is not None:
        transmitter = checked_unit_vectors("to_transmitter", to_transmitter)
    polarisations: tuple[Complex, ...] = ()
    if polarisation is not None:
        polarisations = checked_polarisations(polarisation, receiver, transmitter)
    shape = _shape(lengths, receiver, transmitter, *polarisations)
    s, t, *both = (
        np.broadcast_to(vectors, (*shape, 3)).reshape(-1, 3)
        for vectors in (receiver, transmitter, *polarisations)
    )
    warn_of_corners(facets, -t)
    flat = np.broadcast_to(lengths, shape).ravel()
    sums = lit_sums(facets, -t, s, (s + t) / flat[:, None], to_transmitter is None)
    areas = 4 * np.pi / flat**2 * _power(sums, -t, s, both)
    slopes: list[Floats | None] = [None] * len(directions)
    if any(wanted):
        channel = polarisation if isinstance(polarisation, str) else None
        every = section_slopes(facets, s, t, flat, both, channel, to_transmitter is None)
        slopes = [
            own.reshape(*shape, 3) if is_wanted else None
            for own, is_wanted in zip(every, wanted, strict=False)
        ]
    return areas.reshape(shape), slopes


def _warn_of_small(facets: Facets, wavelength: float) -> None:
    if facets.least_face < wavelength:
        warn_caller(
            f"got a face of {facets.least_face:.3g} m, the root of its area, at a wavelength of "
            f"{wavelength:.3g} m: physical optics holds for faces of some wavelengths or more"
        )


def _shape(lengths: Floats, *vectors: Any) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(lengths.shape, *(v.shape[:-1] for v in vectors))
    except ValueError:
        shapes = ", ".join(str(v.shape) for v in vectors)
        raise ArgumentError(
            f"expected directions and wavelengths that broadcast, got {shapes} and wavelengths "
            f"{lengths.shape}; add axes of length 1"
        ) from None


def _power(sums: Complex, k: Floats, s: Floats, polarisations: list[Complex]) -> Floats:
    """|q.(N x (k x p))|^2 (m,) of receiver q and transmitter p; None of them: see :func:`rcs`."""
    if polarisations:
        q, p = polarisations
        amplitude: Complex = (q * np.cross(sums, np.cross(k, p))).sum(axis=1)
        return np.asarray(np.abs(amplitude) ** 2)
    least = np.eye(3)[np.abs(k).argmin(axis=1)]
    one = np.cross(k, least)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    total = np.zeros(len(k))
    for h in (one, np.cross(k, one)):
        field = np.cross(sums, h)
        field -= s * (s * field).sum(axis=1, keepdims=True)
        total += (np.abs(field) ** 2).sum(axis=1)
    return total / 2
