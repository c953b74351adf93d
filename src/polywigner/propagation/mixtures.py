"""Irradiance of light that is not coherent: the mean over the waves that it is a mixture of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from polywigner.geometry.arguments import checked_wavelength
from polywigner.geometry.wavefront import Wavefront
from polywigner.radiometry.bands import checked_bandwidth, wavelengths_of_band
from polywigner.radiometry.hemisphere import largest_lag
from polywigner.transforms.wavefronts import coherent_source, is_partly_coherent, tilts_of

__all__ = ["is_mixture", "mean_over_mixture", "parts_of"]


def is_mixture(source: Any, bandwidth: Any, by_lags: bool = False) -> bool:
    """Whether light is a mixture: of a band of wavelengths, or of tilts.

    ``by_lags``: partly coherent light is none, but lags with a weight.
    """
    return bandwidth is not None or (is_partly_coherent(source) and not by_lags)


def mean_over_mixture(
    compute: Callable[[Any, float], Any],
    source: Any,
    wavelength: Any,
    bandwidth: float | None,
    error: float,
    return_error: bool,
    by_lags: bool = False,
) -> Any:
    """The mean of ``compute(source, wavelength)`` over the tilts and wavelengths of light.

    With ``return_error`` of values and of errors. ``error`` : of the mean, relative to the largest
    irradiance that there could be.
    """
    total: Any = 0.0
    parts = parts_of(source, checked_wavelength(wavelength), bandwidth, error, by_lags)
    for one, length, weight in parts:
        total = total + weight * np.asarray(compute(one, length))
    return (total[0][()], total[1][()]) if return_error else total[()]


def parts_of(
    source: Any,
    wavelength: float,
    bandwidth: float | None,
    error: float,
    by_lags: bool = False,
) -> Iterator[tuple[Any, float, float]]:
    """Sources, wavelengths in m, and weights, whose mean is that of the mixture.

    The sources are coherent, unless partly coherent light is computed ``by_lags``.
    """
    band = [(wavelength, 1.0)]
    if bandwidth is not None:
        flat = source.source if isinstance(source, Wavefront) else source
        width = checked_bandwidth(bandwidth, wavelength)
        band = wavelengths_of_band(wavelength, width, largest_lag(flat), error)
    for tilted, share in [(source, 1.0)] if by_lags else _tilted(source, error):
        for length, weight in band:
            yield tilted, length, share * weight


def _tilted(source: Any, error: float) -> Iterator[tuple[Any, float]]:
    if not is_partly_coherent(source):
        yield source, 1.0
        return
    for tilt, share in zip(*tilts_of(source, error), strict=True):
        yield coherent_source(source, tilt), float(share)
