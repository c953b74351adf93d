"""Results and options of received power."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_count, checked_flag
from polywigner.mitsuba.plugins.films import check_seed, check_spp
from polywigner.mitsuba.scenes.reflectors import checked_bodies
from polywigner.quantities import NOISE_PARSERS, SPEED_OF_LIGHT, parse_noise
from polywigner.reception.couplings import checked_tolerance
from polywigner.source.polarisation import checked_polarisation
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray

BOLTZMANN = 1.380649e-23
"""Boltzmann constant in J/K, exact since the SI of 2019."""

OTHER_LIGHTS = "other lights"


def dbm_of(watts: float) -> float | None:
    """Convert a power in W to dBm; return None unless the power is positive."""
    return 10 * math.log10(watts / 1e-3) if watts > 0 else None


def dbm_text(watts: float) -> str:
    """Format a power in W in dBm; zero is "none", and a negative power is "below zero"."""
    if watts > 0:
        return f"{dbm_of(watts):.2f} dBm"
    return "none" if watts == 0 else "below zero"


@dataclass(frozen=True)
class DirectPath:
    """Line-of-sight or specular path from an emitter to a receiver."""

    mirrors: tuple[str, ...]
    """Names of shapes and bodies in the order of reflection; empty for the line of sight."""
    power: float
    """Received power in W."""
    coupling: float
    """Ratio |b|^2 of received to emitted power in free space."""
    transmission: float
    """Fraction of the power that obstacles and mirrors transmit, averaged over rays."""
    arrives_from: tuple[float, float]
    """Direction cosines from the receiver to the emitter or its image, in the receiver's frame."""
    polarisation: float = 1.0
    """Fraction of the incident power that is in the receiver's polarisation."""
    amplitude: complex | None = None
    """Complex amplitude of the path if paths interfere, otherwise None."""
    length: float = math.nan
    """Length of the path from emitter to receiver in m; infinite for a directional light."""
    light: str = ""
    """Id of a point, spot, projector or directional light; empty for other emitters.

    If this id is not empty, ``coupling`` is an effective area in m^2: the received power divided by
    4 pi times the radiant intensity, or by the irradiance of a directional light.
    """


@dataclass(frozen=True)
class Contribution:
    """Power received from one emitter, or from all incoherent lights."""

    name: str
    direct: float
    """Power received along the line of sight and specular paths in W."""
    scattered: float
    """Power scattered by surfaces and fog in W."""
    standard_error: float
    """Standard error of ``scattered`` in W."""
    paths: tuple[DirectPath, ...] = ()

    @property
    def power(self) -> float:
        """Total power in W."""
        return self.direct + self.scattered


@dataclass(frozen=True)
class ReceivedPower:
    """Power received by one receiver of a scene.

    ``float()`` returns the power in W. With ``coherent=True``, the direct paths of one emitter
    interfere. Otherwise their powers are added.
    """

    receiver: str
    wavelength: float
    """Wavelength in m."""
    contributions: tuple[Contribution, ...]
    standard_error: float
    """Standard error of ``scattered`` in W.

    Direct light has no sampling noise.
    """
    samples: int
    """Number of samples of scattered light for each emitter."""
    seed: int
    bandwidth: float | None = None
    """Bandwidth in Hz."""
    temperature: float | None = None
    """Noise temperature in K."""
    noise_figure: float | None = None
    """Noise figure in dB, where None counts as 0."""
    notes: tuple[str, ...] = ()
    """Sentences about effects in this scene that are not included."""
    polarisation: str = ""
    """Description of the polarisations, with the names of the emitters and receivers."""

    @property
    def direct(self) -> float:
        """Power received along the line of sight and specular paths in W."""
        return math.fsum(part.direct for part in self.contributions)

    @property
    def scattered(self) -> float:
        """Scattered power in W, which can be negative with the estimator ``wigner``."""
        return math.fsum(part.scattered for part in self.contributions)

    @property
    def power(self) -> float:
        """Total power in W."""
        return self.direct + self.scattered

    @property
    def dbm(self) -> float | None:
        """Power in dBm, or None if the power is not positive."""
        return dbm_of(self.power)

    @property
    def noise_power(self) -> float | None:
        """Noise power k T B F in W, or None if the temperature or the bandwidth is unknown."""
        return noise_power_of(self.bandwidth, self.temperature, self.noise_figure)

    @property
    def snr(self) -> float | None:
        """Ratio of signal to noise power (not in dB), or None if the noise power is unknown."""
        noise = self.noise_power
        return None if noise is None else self.power / noise

    def __float__(self) -> float:
        return self.power

    def to_dict(self) -> dict[str, Any]:
        """Return all values as numbers and strings that JSON supports."""
        return {
            "receiver": self.receiver,
            "wavelength_m": self.wavelength,
            "frequency_hz": SPEED_OF_LIGHT / self.wavelength,
            "power_w": self.power,
            "standard_error_w": self.standard_error,
            "power_dbm": self.dbm,
            "direct_w": self.direct,
            "scattered_w": self.scattered,
            "emitters": [
                {
                    "name": part.name,
                    "power_w": part.power,
                    "direct_w": part.direct,
                    "scattered_w": part.scattered,
                    "standard_error_w": part.standard_error,
                    "paths": [_path_dict(path) for path in part.paths],
                }
                for part in self.contributions
            ],
            "samples": self.samples,
            "seed": self.seed,
            "bandwidth_hz": self.bandwidth,
            "temperature_k": self.temperature,
            "noise_figure_db": self.noise_figure,
            "noise_power_w": self.noise_power,
            "snr": self.snr,
            "polarisation": self.polarisation,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        parts = [
            (part.name, part.direct, part.scattered, part.standard_error, part.power)
            for part in self.contributions
        ]
        if len(parts) != 1:
            total = self.direct, self.scattered, self.standard_error, self.power
            parts.append(("total", *total))
        rows = [(f"receiver {self.receiver}", "direct", "scattered", "standard error", "power")]
        rows += [(n, _watts(d), _watts(s), _watts(e), dbm_text(p)) for n, d, s, e, p in parts]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])])
            for row in rows
        ]
        frequency = SPEED_OF_LIGHT / self.wavelength / 1e9
        lines.append(
            f"{_watts(self.power)} +- {_watts(self.standard_error)} at {frequency:.6g} GHz"
        )
        if self.polarisation:
            lines.append(f"polarisation: {self.polarisation}")
        if (noise := self.noise_power) is not None:
            ratio = self.power / noise
            shown = f"{10 * math.log10(ratio):.2f} dB" if ratio > 0 else "below zero"
            lines.append(
                f"noise {_watts(noise)} ({dbm_text(noise)}), signal-to-noise ratio {shown}"
            )
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])


def noise_power_of(
    bandwidth: float | None, temperature: float | None, noise_figure: float | None
) -> float | None:
    """Return the noise power k T B F in W, or None if T in K or B in Hz is unknown.

    F is in dB, and None counts as 0 dB.
    """
    if temperature is None or bandwidth is None:
        return None
    return BOLTZMANN * temperature * bandwidth * 10 ** ((noise_figure or 0.0) / 10)


def _path_dict(path: DirectPath) -> dict[str, Any]:
    """Return the values of a path as numbers and strings that JSON supports."""
    wave = path.amplitude
    return {
        "mirrors": list(path.mirrors),
        "coupling": path.coupling,
        "transmission": path.transmission,
        "arrives_from": list(path.arrives_from),
        "polarisation": path.polarisation,
        "power_w": path.power,
        "length_m": path.length if math.isfinite(path.length) else None,
        **({"light": path.light} if path.light else {}),
        **({} if wave is None else {"amplitude": [wave.real, wave.imag]}),
    }


def _watts(value: float) -> str:
    """Return a power as a text in W with four digits."""
    return f"{value:.4g} W"


MOST_REFLECTIONS = 3


@dataclass(frozen=True)
class ReceiveOptions:
    """Checked arguments of :func:`polywigner.mitsuba.received_power`."""

    spp: int | None = None
    """Number of samples, or None for the value of the scene."""
    seed: int = 0
    integrator: Any = None
    reflections: int = 0
    tolerance: float = 1e-6
    bandwidth: float | str | None = None
    temperature: float | str | None = None
    noise_figure: float | str | None = None
    coherent: bool = False
    """Whether the direct paths of one emitter interfere."""
    polarisation: Any = None
    """Jones vector of emitters and receivers whose polarisation the scene does not specify."""
    bodies: Any = None
    """Conducting bodies, converted to a tuple of :class:`Body`."""

    def __post_init__(self) -> None:
        is_coherent = checked_flag(self.coherent, "coherent")
        for name in ("polarisation", "bodies"):
            if not is_coherent and getattr(self, name) is not None:
                raise ArgumentError(f"{name}= requires coherent=True, got coherent=False")
        checked: dict[str, Any] = {
            "spp": None if self.spp is None else check_spp(self.spp),
            "seed": check_seed(self.seed),
            "reflections": checked_count(self.reflections, "reflections", 0, MOST_REFLECTIONS),
            "tolerance": checked_tolerance(self.tolerance),
            **parse_noise(self.bandwidth, self.temperature, self.noise_figure),
            "bodies": checked_bodies(self.bodies),
        }
        if self.polarisation is not None:
            checked["polarisation"] = checked_polarisation(self.polarisation)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def noise_of(self, spec: Any) -> dict[str, Any]:
        """Return bandwidth, temperature and noise figure, by default the receiver's values."""
        noise = {name: getattr(self, name) for name in NOISE_PARSERS}
        return {n: spec.noise[n] if value is None else value for n, value in noise.items()}


Variables = dict[str, tuple[Any, tuple[str, ...], str, str]]
"""Array, dimensions, unit and description of each variable of a dataset, by name."""


def described(
    values: Variables,
    coords: Mapping[str, Any],
    about: Mapping[str, Any],
) -> xarray.Dataset:
    """Create a dataset with the attributes ``about`` and the version of this package."""
    from polywigner import __version__

    return labelled_arrays(
        {
            name: labelled_array(
                np.ascontiguousarray(array) if np.ndim(array) else array,
                dims,
                ({"units": unit} if unit else {}) | {"long_name": meaning},
            )
            for name, (array, dims, unit, meaning) in values.items()
        },
        coords,
        {**about, "polywigner_version": __version__},
    )
