"""Links to a tolerance: pairs of cells whose interpolation is raised, or which are cut."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.reception.cell_pairs import Links, Pairs, pairs_of, table

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Orders of interpolation that are tried; the difference between two of them tells the error of the
# lower one. A pair that needs more is cut, which makes it dearer up to then: of 10 wavelengths at
# a distance of 10 one pair of order 22 has 2e5 values, its parts of order 18 have twice as many.
_ORDERS = np.array([2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26, 32, 38, 46, 56])
# Pairs are cut before they are tried where the phase across them is of more radians, ...
_MOST_TURN = 70.0
# ... or where both cells together are so many times larger than their distance.
_MOST_RATIO = 4.0
# Orders for each radian of it below which rules tell nothing: less than half of one, that of Gauss.
_IDLE = 0.25
# Rounding of a pair's sum, relative to the sum of moduli.
_ROUNDING = 1e-15
# Values of the kernel for a pose, some minutes' work, and pairs that need as many in the end.
_MOST_VALUES, _MOST_PAIRS = 1 << 29, 1 << 17


class LinkSums(NamedTuple):
    """Couplings of n poses, but for the phase of the distance and the norms, and errors."""

    values: Complex
    errors: Floats
    allowed: Floats


def link_sums(links: Links, tolerance: float, floor: Floats) -> LinkSums:
    """int int u_t K u_r of n poses to ``tolerance`` of itself, or of ``floor`` (n,) if larger.

    Raises ArgumentError where that is more work than minutes.
    """
    count = len(links.offset)
    none = np.zeros(count, np.intp)
    digits = -math.log10(tolerance)
    parts = _first(links, _tryable(links, pairs_of(np.arange(count), none, none)), digits)
    work = 0.0
    while True:
        pose = parts.pose
        real, imag = (np.bincount(pose, v, count) for v in (parts.values.real, parts.values.imag))
        total = real + 1j * imag
        allowed = tolerance * np.maximum(np.abs(total), floor)
        open_ = _to_refine(parts, allowed / 2)
        if not open_.any():
            break
        share = (allowed / 2 / np.maximum(np.bincount(pose[open_], minlength=count), 1))[pose]
        halved = open_ & (_foreseen(links, parts) > share)
        raised = open_ & ~halved
        fresh = _first(links, _tryable(links, _halves(links, parts[halved])), digits)
        again = _raised(links, parts[raised])
        work += sum(float((_ORDERS[part.orders] ** 4.0).sum()) for part in (fresh, again))
        if work > _MOST_VALUES * count:
            raise _too_much(links, parts)
        parts = _joined(parts[~open_], fresh, again)
    errors = np.bincount(pose, parts.errors, count).astype(np.float64)
    return LinkSums(total, errors, allowed)


def _to_refine(parts: Pairs, allowed: Floats) -> NDArray[np.bool_]:
    """Pairs with the largest errors; the errors of all others add up to ``allowed`` a pose."""
    pose = parts.pose
    ordered = np.lexsort((parts.errors, pose))
    sums = np.cumsum(parts.errors[ordered])
    starts = np.searchsorted(pose[ordered], np.arange(len(allowed)))
    before = np.concatenate([[0.0], sums])[starts]
    found = np.zeros(len(pose), np.bool_)
    found[ordered] = sums - before[pose[ordered]] > allowed[pose[ordered]]
    return found & (parts.errors > _ROUNDING * parts.sizes)


def _foreseen(links: Links, parts: Pairs) -> Floats:
    """The error that a pair will be seen to have at the highest order; infinite there."""
    idle = _IDLE * _turn(links, parts)
    falling = np.maximum(_ORDERS[np.maximum(parts.orders - 1, 0)] - idle, 1.0)
    size = np.maximum(np.maximum(np.abs(parts.values), parts.errors), 1e-300)
    rate = np.log(np.maximum(parts.errors, 1e-300) / size) / falling
    found = size * np.exp(rate * np.maximum(_ORDERS[-2] - idle, 1.0))
    return np.where(parts.orders == len(_ORDERS) - 1, np.inf, found)


def _first(links: Links, pairs: Pairs, digits: float) -> Pairs:
    """Pairs at the first two orders that can tell something of them."""
    turn = _turn(links, pairs)
    # the least that was found to do, of squares at any distance; more costs nothing but one more
    likely = 1 + digits / 3 + 0.8 * np.sqrt(turn)
    least = np.minimum(np.maximum(2 + _IDLE * turn, likely), _ORDERS[-2])
    orders = np.searchsorted(_ORDERS, least)
    values, sizes = _at(links, pairs, orders)
    unknown = np.full(len(pairs), np.inf)
    return _raised(links, _parts(pairs, values, orders, unknown, sizes))


def _raised(links: Links, parts: Pairs) -> Pairs:
    """Pairs at the next order."""
    orders = parts.orders + 1
    values, sizes = _at(links, parts, orders)
    return _parts(parts, values, orders, np.abs(values - parts.values), sizes)


def _parts(pairs: Pairs, values: Complex, orders: Indices, errors: Floats, sizes: Floats) -> Pairs:
    columns = [pairs.pose, pairs.transmitter, pairs.receiver, values, orders, errors, sizes]
    names = "pose,transmitter,receiver,values,orders,errors,sizes"
    return table(columns, names=names)


def _joined(*pairs: Pairs) -> Pairs:
    return np.concatenate(pairs).view(np.recarray)


def _at(links: Links, pairs: Pairs, orders: Indices) -> tuple[Complex, Floats]:
    work = float((_ORDERS[orders].astype(np.float64) ** 4).sum())
    if work > _MOST_VALUES * len(links.offset):
        raise _too_much(links, pairs)
    values, sizes = np.empty(len(pairs), np.complex128), np.empty(len(pairs))
    for order in np.unique(orders):
        mine = np.flatnonzero(orders == order)
        values[mine], sizes[mine] = links.sums(pairs[mine], int(_ORDERS[order]))
    return values, sizes


def _too_much(links: Links, pairs: Pairs) -> ArgumentError:
    _, _, distance = links.sizes(pairs)
    nearest = int(distance.argmin())
    return ArgumentError(
        "expected sources of fewer wavelengths, or farther from each other, got a link for which "
        f"{len(pairs)} pairs of their parts must be summed up, {distance[nearest]:.3g} wavelengths "
        f"apart at pose {int(pairs.pose[nearest])}; allow a larger tolerance, or check the units"
    )


def _turn(links: Links, pairs: Pairs) -> Floats:
    """Most radians of phase, in one coordinate, beyond the two plane waves."""
    here, there, distance = links.sizes(pairs)
    result: Floats = 2 * math.pi * np.maximum(here, there) * (here + there) / distance
    return result


def _tryable(links: Links, pairs: Pairs) -> Pairs:
    """Pairs so small that an interpolation is worth a try, in place of larger ones."""
    found = pairs[:0]
    while len(pairs):
        here, there, distance = links.sizes(pairs)
        good = (_turn(links, pairs) <= _MOST_TURN) | (here + there < 1e-3)
        good &= here + there <= _MOST_RATIO * distance
        found = _joined(found, pairs[good])
        pairs = _halves(links, pairs[~good])
        if len(pairs) + len(found) > _MOST_PAIRS * len(links.offset):
            raise _too_much(links, pairs)
    return found


def _halves(links: Links, pairs: Pairs) -> Pairs:
    """Pairs with the larger of both cells halved."""
    here, there, _ = links.sizes(pairs)
    first = here >= there
    one, other = pairs[first], pairs[~first]
    cells, place = links.transmitter.halved(one.transmitter)
    halved = pairs_of(one.pose[place], cells, one.receiver[place])
    cells, place = links.receiver.halved(other.receiver)
    others = pairs_of(other.pose[place], other.transmitter[place], cells)
    return _joined(halved, others)
