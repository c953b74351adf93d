"""Cross sections over azimuth and elevation, as a dataset."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import InitVar, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import (
    checked_count,
    checked_wavelength,
    takes_frequency,
    warn_caller,
)
from polywigner.propagation.places import checked_angles
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.scattering.antennas import Channel, checked_channel, checked_unit_vectors
from polywigner.scattering.cross_sections import MOST_BOUNCES, sections, warn_of_small
from polywigner.scattering.facets import Body, Facets, facets_of
from polywigner.scattering.interreflections import warn_of_reflections
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]

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
