"""Cross sections of bodies near the antennas of a radar, and the power between these."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_number, warn_caller
from polywigner.radiometry.directions import checked_source
from polywigner.reception.norms import checked_normalise
from polywigner.scattering.antennas import Antenna, Source, checked_places, directions_of
from polywigner.scattering.facets import Facets, warn_of_corners
from polywigner.scattering.near_fields import near_sums
from polywigner.scattering.polarisations import (
    Polarisation,
    checked_polarisations,
    spherical_axes,
)

__all__ = ["near_sections"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LEAST, _MOST = 1e-6, 0.1
# Tolerance of fields, as a share of the whole.
_OF_FIELD = 1e-2


def near_sections(
    facets: Facets,
    source: Source,
    receiver: Source | None,
    to_radar: ArrayLike,
    to_transmitter: ArrayLike | None,
    wavelengths: Floats,
    polarisation: Polarisation | None,
    tolerance: float,
    normalise: str,
) -> tuple[Floats, Floats]:
    """Apparent cross sections (...) in m^2, and received over transmitted powers (...): (SC3)."""
    meaning = f"a number from {_LEAST:g} to {_MOST:g}"
    allowed = checked_number(tolerance, "tolerance", meaning)
    if not _LEAST <= allowed <= _MOST:
        raise ArgumentError(f"expected tolerance as {meaning}, got {tolerance!r}")
    counted = checked_normalise(normalise)
    for antenna in (source, receiver):
        if antenna is not None:
            checked_source(antenna)
    if execution.is_drjit(to_radar) or execution.is_drjit(to_transmitter):
        raise ArgumentError(
            "expected no Dr.Jit arrays with a source, near which there are no derivatives; pass "
            "NumPy's"
        )
    here = checked_places("to_radar", to_radar, facets.middle)
    there = here
    if to_transmitter is not None:
        there = checked_places("to_transmitter", to_transmitter, facets.middle)
    to_sender = directions_of(there)
    warn_of_corners(facets, -to_sender.reshape(-1, 3))
    q, p = _polarisations(polarisation, directions_of(here), to_sender)
    try:
        shape = np.broadcast_shapes(
            wavelengths.shape, here.shape[:-2], there.shape[:-2], q.shape[:-2], p.shape[:-2]
        )
    except ValueError:
        raise ArgumentError(
            "expected places, wavelengths and polarisations that broadcast, got "
            f"{here.shape[:-2]}, {there.shape[:-2]} and {wavelengths.shape}; add axes of length 1"
        ) from None
    lengths = np.broadcast_to(wavelengths, shape)
    own, others = (np.broadcast_to(poses, (*shape, 4, 4)) for poses in (here, there))
    q, p = (np.broadcast_to(v, (*shape, *v.shape[-2:])) for v in (q, p))
    sections, powers = np.empty(shape), np.empty(shape)
    alone = receiver is None and to_transmitter is None
    for k in np.ndindex(*shape):
        how = float(lengths[k]), counted, _OF_FIELD * allowed
        transmitter = Antenna(source, others[k], *how)
        back = Antenna(source if receiver is None else receiver, own[k], *how)
        transmitter.check_in_front(facets, "source")
        back.check_in_front(facets, "receiver")
        sums = near_sums(
            facets,
            transmitter,
            None if alone else back,
            (q[k][:, None], p[k][None]),
            allowed,
        )
        # of all that is received, mean over what is sent
        powers[k] = (np.abs(sums) ** 2).sum() / sums.shape[1]
        there_and_back = transmitter.power_at_middle() * back.power_at_middle()
        with np.errstate(divide="ignore", invalid="ignore"):
            sections[k] = 4 * np.pi / lengths[k] ** 2 * powers[k] / there_and_back
    if not np.isfinite(sections).all():
        warn_caller(
            "got an antenna with a null at the middle of the body, of whose cross section it says "
            "nothing; take the power, with return_power=True"
        )
    return sections, powers


def _polarisations(
    polarisation: Polarisation | None, to_radar: Floats, to_transmitter: Floats
) -> tuple[Complex, Complex]:
    """Polarisations (..., k, 3) of the receiver and of the transmitter; of None, two each."""
    if polarisation is not None:
        q, p = checked_polarisations(polarisation, to_radar, to_transmitter)
        return q[..., None, :], p[..., None, :]
    both = (spherical_axes(towards) for towards in (to_radar, to_transmitter))
    q, p = (np.stack([axes["v"], axes["h"]], axis=-2).astype(np.complex128) for axes in both)
    return q, p
