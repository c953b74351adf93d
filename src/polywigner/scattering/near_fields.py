"""Cross sections near a radar's antennas, from their exact fields on the lit surfaces.

Physical optics with the field of the transmitter and, by reciprocity, that of the receiver
(docs/rcs.md, (SC3)). Lit parts are split until each sees of both antennas a plane wave.
"""

from __future__ import annotations

import math
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely.errors import GEOSException

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_number, warn_caller
from polywigner.radiometry.directions import checked_source
from polywigner.reception.norms import checked_normalise
from polywigner.scattering.antennas import (
    Antenna,
    Channel,
    Polarisation,
    Source,
    broadcast_shape,
    checked_places,
    checked_polarisations,
    directions_of,
    spherical_axes,
)
from polywigner.scattering.facet_beams import sums_of_beams
from polywigner.scattering.facets import Facets, warn_of_reflections
from polywigner.scattering.visibility import (
    Pieces,
    Seen,
    facing_place,
    less_hidden,
    lit_pieces,
    seen_from,
    transforms,
)
from polywigner.source.polarisation import checked_pair, is_pair

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Pieces at a time, and most of them: 4 GB.
_BLOCK = 1 << 15
_MOST = 1 << 24
# Extrapolation from pieces and their quarters leaves about the square of a departure.
_SHARE = 0.7
# Variances of places over an equilateral triangle along an axis, in squares of its side, and of
# points across an antenna, in squares of its extent.
_OF_TRIANGLE, _OF_ANTENNA = 1 / 24, 1 / 12


def near_sums(
    facets: Facets,
    transmitter: Antenna,
    receiver: Antenna,
    polarisations: tuple[Complex, Complex],
    tolerance: float,
) -> Complex:
    """Received over transmitted amplitudes of polarisations (..., 3), broadcast (...): (SC3).

    ``polarisations`` of the receiver and of the transmitter, across the directions from the body's
    middle; elsewhere what of them stands across the ray from each antenna's centre. The fields of
    one antenna that sends and receives are computed once.
    """
    try:
        lit = _lit(facets, transmitter, receiver)
    except GEOSException as error:
        warn_caller(
            f"the lit polygons could not be computed and the result is NaN ({error}); turn the "
            "body slightly, or simplify its mesh"
        )
        shape = np.broadcast_shapes(*(vectors.shape for vectors in polarisations))
        return np.full(shape[:-1], complex(np.nan, np.nan))
    pieces = _fine(lit, transmitter, receiver, math.sqrt(tolerance) * _SHARE)
    sums = [_summed(pieces, split, transmitter, receiver, polarisations) for split in (False, True)]
    return np.asarray((4 * sums[1] - sums[0]) / 3)


def echo(
    facets: Facets,
    transmitter: Antenna,
    receiver: Antenna,
    polarisations: tuple[Complex, Complex],
    tolerance: float,
    bounces: int,
) -> complex:
    """Received over transmitted amplitude by a body, with the phase of :func:`coupling`.

    ``polarisations`` (3,) as of :func:`near_sums`, of scalar antennas. The second and later ones of
    ``bounces`` reflections are those of the plane waves at the body's middle, (SC6).
    """
    total = near_sums(facets, transmitter, receiver, polarisations, tolerance)
    if bounces > 1:
        ahead, back = (one.place / -np.linalg.norm(one.place) for one in (transmitter, receiver))
        lengths = np.array([transmitter.wavelength])
        _, later = sums_of_beams(facets, ahead[None], -back[None], lengths, False, bounces)
        if later is not None:
            q, p = (
                _across(vector, way[None])[0]
                for vector, way in zip(polarisations, (back, ahead), strict=True)
            )
            there = transmitter.field(np.zeros(3)) * receiver.field(np.zeros(3))
            total = total + there * (q @ later[0] @ np.cross(ahead, p))
    return -complex(total)


def _summed(
    pieces: Pieces,
    split: bool,
    transmitter: Antenna,
    receiver: Antenna,
    polarisations: tuple[Complex, Complex],
) -> Complex:
    """The sum over pieces, or over the quarters of each."""
    q, p = polarisations
    total = np.zeros(np.broadcast_shapes(q.shape, p.shape)[:-1], np.complex128)
    for start in range(0, len(pieces), _BLOCK):
        some = pieces.taken(slice(start, start + _BLOCK))
        some = _quartered(some) if split else some
        centre = some.corner + (some.first + some.second) / 3
        sent, slope, ahead = transmitter.wave(centre)
        is_same = receiver is transmitter
        back, _, behind = (sent, slope, ahead) if is_same else receiver.wave(centre)
        if transmitter.jones is not None:  # E of the receiver in currents n x H
            parts = (back * np.cross(some.vector, slope)).sum(axis=-1)
        else:
            q_there = _across(q, centre - receiver.place)
            p_there = _across(p, centre - transmitter.place)
            parts = (q_there * slope).sum(axis=-1) * (p_there * some.vector).sum(axis=-1)
            parts -= (q_there * p_there).sum(axis=-1) * (slope * some.vector).sum(axis=-1)
            parts = parts * back
        nu = -(ahead + behind) / transmitter.wavelength
        phases = [(nu * part).sum(axis=1) for part in (some.first, some.second)]
        weights = transforms(-(phases[0] + phases[1]) / 3, *phases)
        total += (parts * weights).sum(axis=-1)
    return total


def _lit(facets: Facets, transmitter: Antenna, receiver: Antenna) -> Pieces:
    place = transmitter.place
    if not facets.casts_shadows:
        signs = facing_place(facets, place)
        return lit_pieces(facets, Seen(signs, np.full(len(signs), None)))
    seen = seen_from(facets, place, transmitter.frame)
    if receiver is not transmitter:
        there = seen_from(facets, receiver.place, receiver.frame)
        seen = less_hidden(seen, there, facing_place(facets, receiver.place))
    return lit_pieces(facets, seen)


def _fine(pieces: Pieces, transmitter: Antenna, receiver: Antenna, tolerance: float) -> Pieces:
    """Pieces split in four until the field of both antennas is a plane wave on each."""
    done, count = [pieces.taken(slice(0))], 0
    while len(pieces):
        coarse = _departure(pieces, transmitter, receiver) > tolerance
        done.append(pieces.taken(np.flatnonzero(~coarse)))
        pieces = pieces.taken(np.flatnonzero(coarse))
        count += len(done[-1])
        if count + 4 * len(pieces) > _MOST:
            raise ArgumentError(
                f"expected a body whose lit parts split into {_MOST:g} pieces or fewer, got more; "
                "raise the tolerance, or move the source away from the body"
            )
        pieces = _quartered(pieces)
    return Pieces(
        *(np.concatenate(own) for own in zip(*(vars(one).values() for one in done), strict=True))
    )


def _departure(pieces: Pieces, transmitter: Antenna, receiver: Antenna) -> Floats:
    """Mean relative departure of the fields on pieces (n,) from plane waves (docs/rcs.md, (SC4)).

    By curvature, to first order, and by the angles under which points of an antenna are seen, whose
    waves lose step within a piece, to second order.
    """
    sides = (pieces.first, pieces.second, pieces.second - pieces.first)
    longest = np.max([np.linalg.norm(side, axis=1) for side in sides], axis=0)
    centre = pieces.corner + (pieces.first + pieces.second) / 3
    total = np.zeros(len(pieces))
    for antenna in (transmitter, receiver):
        wave_number = 2 * np.pi / antenna.wavelength
        middle = np.linalg.norm(centre - antenna.place, axis=1)
        height = np.abs(antenna.inside(centre)[:, 2])
        # to the nearest point of the antenna
        distance = np.maximum(middle - antenna.extent / 2, height)
        total += wave_number * longest**2 * _OF_TRIANGLE / distance
        spread = antenna.extent / np.hypot(distance, antenna.extent)
        total += (wave_number * longest * spread) ** 2 * _OF_TRIANGLE * _OF_ANTENNA
    return total


def _quartered(pieces: Pieces) -> Pieces:
    """Each piece as four, through the middles of its sides."""
    corner, first, second = pieces.corner, pieces.first / 2, pieces.second / 2
    return Pieces(
        np.concatenate([corner, corner + first, corner + second, corner + first + second]),
        np.concatenate([first, first, first, -first]),
        np.concatenate([second, second, second, -second]),
        np.tile(pieces.vector / 4, (4, 1)),
    )


def _across(polarisation: Complex, ray: Floats) -> Complex:
    """Unit vectors (..., n, 3) of fields across rays (n, 3)."""
    along = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    vectors = polarisation[..., None, :]
    vectors = vectors - (vectors * along).sum(axis=-1, keepdims=True) * along
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


_LEAST, _LARGEST = 1e-6, 0.1
# Tolerance of fields, as a share of the whole.
_OF_FIELD = 1e-2


def near_sections(
    facets: Facets,
    to_radar: ArrayLike,
    to_transmitter: ArrayLike | None,
    wavelengths: Floats,
    source: Source,
    receiver: Source | None,
    polarisation: Polarisation | None,
    tolerance: float,
    normalise: str,
) -> tuple[Floats, Floats]:
    """Apparent cross sections (...) in m^2, and received over transmitted powers (...): (SC3)."""
    meaning = f"a number from {_LEAST:g} to {_LARGEST:g}"
    allowed = checked_number(tolerance, "tolerance", meaning)
    if not _LEAST <= allowed <= _LARGEST:
        raise ArgumentError(f"expected tolerance as {meaning}, got {tolerance!r}")
    counted = checked_normalise(normalise)
    for antenna in (source, receiver):
        if antenna is not None:
            checked_source(antenna)
    here = checked_places("to_radar", to_radar, facets.middle)
    there = here
    if to_transmitter is not None:
        there = checked_places("to_transmitter", to_transmitter, facets.middle)
    to_sender = directions_of(there)
    warn_of_reflections(facets, -to_sender.reshape(-1, 3))
    ends = receiver or source, source
    jones, (q, p) = _polarisations(polarisation, *ends, directions_of(here), to_sender)
    shape = broadcast_shape(
        wavelengths.shape, here.shape[:-2], there.shape[:-2], q.shape[:-2], p.shape[:-2]
    )
    lengths = np.broadcast_to(wavelengths, shape)
    poses = [np.broadcast_to(own, (*shape, 4, 4)) for own in (here, there)]
    q, p = (np.broadcast_to(v, (*shape, *v.shape[-2:])) for v in (q, p))
    sections, powers = np.empty(shape), np.empty(shape)
    same = jones[0] is jones[1] or np.array_equal(*jones)
    alone = receiver is None and to_transmitter is None and same
    for k in np.ndindex(*shape):
        how = float(lengths[k]), counted, _OF_FIELD * allowed
        back, transmitter = (
            Antenna(end, pose[k], *how, own)
            for end, pose, own in zip(ends, poses, jones, strict=True)
        )
        transmitter.check_in_front(facets, "source")
        back.check_in_front(facets, "receiver")
        back = transmitter if alone else back
        sums = near_sums(facets, transmitter, back, (q[k][:, None], p[k][None]), allowed)
        # of all that is received, mean over what is sent
        powers[k] = (np.abs(sums) ** 2).sum() / sums.shape[1]
        there_and_back = transmitter.power_at_middle() * back.power_at_middle()
        with np.errstate(divide="ignore", invalid="ignore"):
            sections[k] = 4 * np.pi / lengths[k] ** 2 * powers[k] / there_and_back
    if not np.isfinite(sections[np.isfinite(powers)]).all():
        warn_caller(
            "got an antenna with a null at the middle of the body, of whose cross section it says "
            "nothing; take the power, with return_power=True"
        )
    return sections, powers


Pair = tuple[Complex, Complex]


def _polarisations(
    polarisation: Any, receiver: Source, transmitter: Source, to_radar: Floats, to_sender: Floats
) -> tuple[Pair | tuple[None, None], Pair]:
    """Polarisations of the receiver and of the transmitter.

    Jones vectors in the antennas' axes, None of scalar ones; and vectors (..., k, 3) of scalar
    ones, two each without a polarisation.
    """
    both = [spherical_axes(towards) for towards in (to_radar, to_sender)]
    q, p = (np.stack([axes["v"], axes["h"]], axis=-2).astype(np.complex128) for axes in both)
    if polarisation is None:
        return (None, None), (q, p)
    is_named = isinstance(polarisation, str) and polarisation in get_args(Channel)
    if is_named or (is_pair(polarisation) and any(_is_in_space(one) for one in polarisation)):
        q, p = checked_polarisations(polarisation, to_radar, to_sender)
        return (None, None), (q[..., None, :], p[..., None, :])
    # one sum, whatever the directions
    return checked_pair(polarisation, receiver, transmitter), (q[..., :1, :], p[..., :1, :])


def _is_in_space(vectors: Any) -> bool:
    """Whether vectors have three components."""
    try:
        return np.shape(vectors)[-1:] == (3,)
    except ValueError:  # lists of unequal lengths
        return False
