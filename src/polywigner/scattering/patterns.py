"""Cross sections over azimuth and elevation, as labelled arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_wavelength, takes_frequency
from polywigner.propagation.places import checked_angles
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.progress import progress_bar
from polywigner.scattering.antennas import Channel, checked_channel, checked_unit_vectors
from polywigner.scattering.cross_sections import rcs
from polywigner.scattering.facets import Body, facets_of
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray


Floats = NDArray[np.float64]


@takes_frequency
def rcs_pattern(
    body: Body,
    wavelength: float,
    azimuth: ArrayLike,
    elevation: ArrayLike,
    *,
    to_transmitter: ArrayLike | None = None,
    polarisation: Channel | None = None,
    progress: bool | None = None,
) -> xarray.Dataset:
    """Radar cross section of a body over azimuth and elevation of the radar, as a dataset.

    The values are those of :func:`rcs`, which says what they are and where they hold.

    Parameters
    ----------
    body : as for :func:`rcs`.
    wavelength : in m; or ``frequency=`` in Hz.
    azimuth : (n,) angles in rad about z, from +x towards +y; or one.
    elevation : (m,) angles in rad above the plane z = 0, from -pi/2 to pi/2; or one.
    to_transmitter : unit vector (3,) towards a transmitter that stays; None: it is with the radar.
    polarisation : None, "vv", "hh", "vh" or "hv", as for :func:`rcs`.
    progress : a bar on a terminal; None: if stderr is one.

    Returns
    -------
    xarray.Dataset with
    ``rcs`` (azimuth, elevation) in m^2. Attributes: wavelength, frequency, polarisation, number of
    triangles, largest cross section, and the transmitter where it stays.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range, as :func:`rcs` does.

    >>> import polywigner as pw
    >>> found = pw.rcs_pattern(pw.shapes.square(5.0), 0.3, 0.0, 1.5707963267948966)
    >>> round(found["rcs"].values.item())  # 4 pi 5^4/0.3^2
    87266
    """
    length = checked_wavelength(wavelength)
    around, above = (
        checked_angles(azimuth, "azimuth", math.inf),
        checked_angles(elevation, "elevation", math.pi / 2),
    )
    channel = None if polarisation is None else checked_channel(polarisation)
    transmitter = None
    if to_transmitter is not None:
        transmitter = checked_unit_vectors("to_transmitter", to_transmitter)
        if transmitter.shape != (3,):
            raise ArgumentError(
                f"expected to_transmitter as one unit vector (3,), got {transmitter.shape}; use "
                "polywigner.rcs for several"
            )
    facets = facets_of(body)
    values = np.empty((len(around), len(above)))
    with progress_bar("radar cross sections", len(around), show=progress) as advance:
        for row, angle in enumerate(around):
            to_radar = _towards(float(angle), above)
            values[row] = rcs(body, to_radar, length, transmitter, channel)
            advance()
    about: dict[str, Any] = {
        "wavelength": length,
        "frequency": SPEED_OF_LIGHT / length,
        "polarisation": channel or "all, mean over incident ones",
        "triangles": len(facets.corner),
        "largest_rcs": float(values.max()),
    }
    if transmitter is not None:
        about["to_transmitter"] = transmitter.tolist()
    axes = {"azimuth": (around, "angle about z from x"), "elevation": (above, "angle above z = 0")}
    return _described(axes, values, about)


def _described(
    axes: dict[str, tuple[Floats, str]], values: Floats, about: dict[str, Any]
) -> xarray.Dataset:
    from polywigner import __version__

    of_values = {
        "units": "m2",
        "long_name": "radar cross section",
        "method": "physical optics: one reflection, no waves of edges",
        "polywigner_version": __version__,
    }
    return labelled_arrays(
        {"rcs": labelled_array(values, tuple(axes), of_values)},
        {
            name: labelled_array(angles, (name,), {"units": "rad", "long_name": meaning})
            for name, (angles, meaning) in axes.items()
        },
        about,
    )


def _towards(azimuth: float, elevation: Floats) -> Floats:
    """Unit vectors (m, 3)."""
    across = np.cos(elevation)
    # cos(pi/2) is 6e-17: what stands upright is seen edge-on from above
    across = np.where(np.abs(across) < 1e-15, 0.0, across)
    x, y = across * math.cos(azimuth), across * math.sin(azimuth)
    return np.stack([x, y, np.sin(elevation)], axis=1)
