"""Radar waveforms, and maps of range, range rate and angle from data cubes.

A waveform defines the frequency f_n and the time t_n of each sample n within a repetition of the
duration T. After mixing with the transmitted signal, a path with the amplitude a and the delay
tau(t) adds the following signal to sample n of repetition m, equation (RC1):

    s_mn = a exp(2 pi i f_n tau(t_mn)),    t_mn = m T + t_n

The phase increases with n for a positive range, and with m for an increasing range. Data cubes are
computed by :func:`polywigner.mitsuba.radar_cube`. The functions of this module process any cube of
this form.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from polywigner.errors import ArgumentError, require, value_text
from polywigner.geometry.arguments import (
    checked_choice,
    checked_count,
    checked_length,
    checked_number,
    checked_type,
)
from polywigner.numerics import Complex, Floats
from polywigner.quantities import SPEED_OF_LIGHT, parse_duration, parse_frequency

if TYPE_CHECKING:
    import xarray


# Largest number of samples, and largest number of repetitions.
_MOST = 1 << 20
# Relative tolerance in comparisons of intervals and sample rates.
_ROUNDING = 1e-9
# Number of points at which windows over an array are computed before interpolation.
_WINDOW_POINTS = 1025


@dataclass(frozen=True)
class FMCW:
    """Linear chirps, mixed with the transmitted signal (dechirped).

    Parameters
    ----------
    start : float
        Lowest frequency in Hz.
    bandwidth : float
        Bandwidth in Hz. Sample n has the frequency ``start + n * bandwidth / samples``.
    samples : int
        Number of complex samples per chirp.
    sample_rate : float
        Sampling rate in Hz, which is also the noise bandwidth of a sample.
    chirps : int, default 1
        Number of chirps of each transmitter.
    interval : float, optional
        Time in s from the start of one chirp to the start of the next chirp, at least
        ``samples / sample_rate``, which is the default.

    Raises
    ------
    ArgumentError
        If a value is not positive, or the interval is shorter than the samples.

    Examples
    --------
    >>> import polywigner as pw
    >>> chirps = pw.radar.FMCW(76e9, 1e9, samples=256, sample_rate=20e6, chirps=64, interval=60e-6)
    >>> round(chirps.range_step, 3), round(chirps.rate_step, 3)  # m and m/s
    (0.15, 0.51)
    """

    start: float
    bandwidth: float
    samples: int
    sample_rate: float
    chirps: int = 1
    interval: float = 0.0

    repetition: ClassVar[str] = "chirps"

    def __post_init__(self) -> None:
        for name in ("start", "bandwidth", "sample_rate"):
            checked_length(getattr(self, name), name, meaning="a frequency in Hz above zero")
        for name in ("samples", "chirps"):
            checked_count(getattr(self, name), name, 1, _MOST)
        shortest = self.samples / self.sample_rate
        meaning = f"a time of at least samples/sample_rate, {shortest:.4g} s"
        least = shortest * (1 - _ROUNDING)
        interval = self.interval or shortest
        checked_number(interval, "interval", meaning, lambda x: x >= least)
        object.__setattr__(self, "interval", interval)

    @property
    def frequencies(self) -> Floats:
        """Radio frequencies of the samples in Hz, shape (samples,)."""
        return np.asarray(self.start + self.bandwidth / self.samples * np.arange(self.samples))

    @property
    def time_step(self) -> float:
        """Time in s from one frequency to the next, the reciprocal of the sampling rate."""
        return 1.0 / self.sample_rate

    @property
    def times(self) -> Floats:
        """Times of the samples in s, relative to the start of a repetition, shape (samples,)."""
        return np.asarray(self.time_step * np.arange(self.samples))

    @property
    def wavelength(self) -> float:
        """Wavelength in m at the mean frequency."""
        return SPEED_OF_LIGHT / float(self.frequencies.mean())

    @property
    def range_step(self) -> float:
        """Width of a range bin in m, which is c/(2 bandwidth)."""
        return SPEED_OF_LIGHT / (2 * self.bandwidth)

    @property
    def rate_step(self) -> float:
        """Width of a range-rate bin in m/s, for a radar with one transmitter."""
        return self.wavelength / (2 * self.chirps * self.interval)

    @property
    def noise_gain(self) -> float:
        """Noise power of a spectrum value divided by the noise power of a sample; always 1."""
        return 1.0

    def from_spectrum(self, spectrum: Complex) -> Complex:
        """Convert amplitudes at all frequencies to samples, shape (..., samples).

        For waveforms with one frequency per sample, the argument is returned unchanged.
        """
        return spectrum

    def to_spectrum(self, signal: Complex) -> Complex:
        """Convert samples, shape (..., samples), to amplitudes at all frequencies.

        For waveforms with one frequency per sample, the argument is returned unchanged.
        """
        return signal


class SteppedFrequency(FMCW):
    """Steps of constant frequency, with one sample per step.

    All parameters of :class:`FMCW` apply: ``samples`` is the number of steps, and
    ``1 / sample_rate`` the duration of a step.
    """

    repetition: ClassVar[str] = "bursts"


class Pulse(FMCW):
    """Pulses with a flat spectrum, as received after matched filtering.

    All parameters of :class:`FMCW` apply: ``start`` and ``bandwidth`` specify the spectrum, and
    ``sample_rate`` must equal ``bandwidth``. Sample n is received at the time ``n / bandwidth``
    after the pulse and is therefore range bin n.
    """

    repetition: ClassVar[str] = "pulses"

    def __post_init__(self) -> None:
        super().__post_init__()
        if abs(self.sample_rate / self.bandwidth - 1) > _ROUNDING:
            raise ArgumentError(
                f"sample_rate of a pulse must equal its bandwidth of {self.bandwidth:.6g} Hz, "
                f"got {self.sample_rate:.6g} Hz"
            )

    @property
    def time_step(self) -> float:
        """Time in s from one frequency to the next; zero for pulses."""
        return 0.0

    @property
    def noise_gain(self) -> float:
        """Noise power of a spectrum value divided by the noise power of a sample.

        The quotient equals the number of samples.
        """
        return float(self.samples)

    def from_spectrum(self, spectrum: Complex) -> Complex:
        """Convert amplitudes at all frequencies to samples in time, shape (..., samples).

        A path at the centre of a range bin gives one sample with the modulus of its amplitude.
        """
        return np.fft.fft(spectrum) / self.samples

    def to_spectrum(self, signal: Complex) -> Complex:
        """Convert samples in time, shape (..., samples), to amplitudes at all frequencies.

        This is the exact inverse of :meth:`from_spectrum`.
        """
        return np.fft.ifft(signal) * self.samples


_CLASSES = {kind.repetition: kind for kind in (FMCW, SteppedFrequency, Pulse)}
_TEXT = re.compile(
    r"(?P<start>[^+]+)\+(?P<bandwidth>[^,]+),\s*(?P<samples>\d+)\s+(?:samples|steps)"
    rf"(?:\s+at\s+(?P<rate>[^,]+))?,\s*(?P<chirps>\d+)\s+(?P<kind>{'|'.join(_CLASSES)})"
    r"(?:\s+every\s+(?P<interval>.+))?"
)


def parse_waveform(text: str | FMCW) -> FMCW:
    """Convert a string to a waveform.

    Parameters
    ----------
    text : str or FMCW
        A string with the start frequency, the bandwidth and the timing, such as
        ``"76 GHz + 1 GHz, 256 samples at 20 MHz, 64 chirps every 60 us"``. With ``bursts`` instead
        of ``chirps``, the result is a :class:`SteppedFrequency`. With ``pulses``, it is a
        :class:`Pulse`, whose sampling rate may be omitted. A waveform is returned unchanged.

    Returns
    -------
    FMCW
        Waveform of the class that the text specifies.

    Raises
    ------
    ArgumentError
        If the text does not have this form.
    QuantityError
        If a quantity in the text has no known unit.
    """
    if isinstance(text, FMCW):
        return text
    match = _TEXT.fullmatch(text.strip()) if isinstance(text, str) else None
    if match is None or (match["rate"] is None and match["kind"] != Pulse.repetition):
        raise ArgumentError(
            'expected a waveform as "START + BANDWIDTH, N samples at RATE, M chirps every '
            'INTERVAL", such as "76 GHz + 1 GHz, 256 samples at 20 MHz, 64 chirps every 60 '
            f'us", got {value_text(text)}'
        )
    bandwidth = parse_frequency(match["bandwidth"])
    return _CLASSES[match["kind"]](
        start=parse_frequency(match["start"]),
        bandwidth=bandwidth,
        samples=int(match["samples"]),
        sample_rate=bandwidth if match["rate"] is None else parse_frequency(match["rate"]),
        chirps=int(match["chirps"]),
        interval=0.0 if match["interval"] is None else parse_duration(match["interval"]),
    )


def waveform_attrs(waveform: FMCW) -> dict[str, Any]:
    """Return the parameters of a waveform as attributes of a data cube."""
    return {"waveform": waveform.repetition, **asdict(waveform)}


def waveform_of(cube: Any) -> FMCW:
    """Create a waveform from the attributes of a data cube; raise ArgumentError if this fails."""
    try:
        names = [field.name for field in fields(FMCW)]
        if tuple(cube["signal"].dims) == CUBE_DIMS:
            kind = _CLASSES[cube.attrs["waveform"]]
            return kind(**{name: cube.attrs[name] for name in names})
    except (AttributeError, KeyError, TypeError):
        pass
    raise ArgumentError(
        "expected a data cube made by polywigner.mitsuba.radar_cube, got "
        f"{type(cube).__name__}, which lacks the signal and attributes of a cube"
    )


CUBE_DIMS = ("draw", "receiver", "emitter", "chirp", "sample")


def range_doppler(cube: Any, window: str = "hann", pad: int = 1) -> xarray.DataArray:
    """Compute the received power by range and range rate, for each pair of receiver and emitter.

    If a path is at the centre of a bin, the value of this bin is the received power of the path
    (coherent gain 1). Ranges refer to the time at the centre of the frame. For each bin, motion
    within a repetition is compensated at the range rate of the bin.

    Parameters
    ----------
    cube : xarray.Dataset
        A result of :func:`polywigner.mitsuba.radar_cube`.
    window : str, default "hann"
        Name of a window of ``scipy.signal.get_window``, which is applied along both axes. Use
        "boxcar" for no window.
    pad : int, default 1
        Number of bins per resolution cell; values above 1 add zero padding.

    Returns
    -------
    xarray.DataArray
        Power in W with the dimensions draw, receiver, emitter, ``range_rate`` in m/s (positive for
        receding objects) and ``range`` in m (half the path length). The attribute
        ``noise_floor`` is the mean noise power of a bin in W for each receiver.

    Raises
    ------
    ArgumentError
        If the cube, the window or ``pad`` is not valid.
    """
    spectra, rates, gain = _by_rate(cube, window, pad)
    values, ranges, of_range = _by_range(cube, spectra, window, pad)
    floor = cube["noise_power"].values * gain * of_range
    dims = (*CUBE_DIMS[:3], "range_rate", "range")
    return _labelled(np.abs(values) ** 2, dims, {"range_rate": rates, "range": ranges}, cube, floor)


def range_angle(
    cube: Any,
    array_axis: str = "x",
    window: str = "hann",
    directions: int = 257,
    pad: int = 1,
) -> xarray.DataArray:
    """Compute the received power by range and by angle of arrival at a virtual array.

    All receivers and emitters form one virtual array. Each pair of a receiver and an emitter is an
    element at the sum of their positions. Emitters may transmit one after the other. The phase
    change of a moving target between their transmissions is therefore compensated for each range
    rate. The power is then summed over range rates.

    Parameters
    ----------
    cube : xarray.Dataset
        A result of :func:`polywigner.mitsuba.radar_cube` with several receivers or emitters.
    array_axis : {"x", "y"}
        Axis of the virtual array in the frame of the first receiver.
    window : str, default "hann"
        Name of a window of ``scipy.signal.get_window``, which is applied over the array, the chirps
        and the samples.
    directions : int, default 257
        Number of equally spaced direction cosines from -1 to 1, positive towards +x or +y.
    pad : int, default 1
        Number of bins per range resolution cell; values above 1 add zero padding.

    Returns
    -------
    xarray.DataArray
        Power in W with the dimensions draw, ``direction_cosine`` and ``range`` in m, and with the
        additional coordinate ``angle`` in rad. If a point target is at the centre of a bin, the
        value of this bin is the power that one pair of a receiver and an emitter receives. The
        attribute ``noise_floor`` is the mean noise power of a bin in W.

    Raises
    ------
    ArgumentError
        If the virtual array has only one element, or an argument is not valid.
    """
    axis = "xyz".index(checked_choice(array_axis, "array_axis", ("x", "y")))
    cosines = np.linspace(-1.0, 1.0, checked_count(directions, "directions", 2, _MOST))
    waveform = waveform_of(cube)
    spectra, rates, _ = _by_rate(cube, window, 1)
    values, ranges, of_range = _by_range(cube, spectra, window, pad)
    frequency = SPEED_OF_LIGHT / waveform.wavelength
    waits = cube["start_time"].values[:, None]
    values = values * np.exp(-4j * np.pi * frequency * waits * rates / SPEED_OF_LIGHT)[..., None]
    positions = np.add.outer(
        cube["receiver_position"].values[:, axis], cube["emitter_position"].values[:, axis]
    )
    extent = np.ptp(positions)
    if not extent > 0:
        raise ArgumentError(
            f"expected array elements at several positions along {array_axis}, got positions "
            f"{positions.ravel()!r:.60}"
        )
    # The window extends beyond the array by half an element spacing at both ends, so that no weight
    # is zero.
    spacing = extent / (len(np.unique(positions.round(9))) - 1)
    across = (positions - positions.min() + spacing / 2) / (extent + spacing)
    shape = window_of(window, _WINDOW_POINTS)
    weights = np.interp(across, np.linspace(0.0, 1.0, _WINDOW_POINTS), shape)
    weights /= weights.sum()
    waves = np.exp(2j * np.pi / waveform.wavelength * np.multiply.outer(cosines, positions))
    image = np.zeros((len(values), len(cosines), len(ranges)))
    # Processing one range rate at a time limits the memory.
    for rate in range(values.shape[3]):
        beams = np.tensordot(values[..., rate, :], waves * weights, axes=([1, 2], [1, 2]))
        image += np.square(np.abs(beams)).swapaxes(1, 2)
    # The window spreads a target over several range rates. Therefore the sum over the range rates
    # is divided by the noise bandwidth of the window in bins.
    of_rates = window_of(window, waveform.chirps)
    image /= len(of_rates) * (of_rates**2).sum() / of_rates.sum() ** 2
    floor = float(cube["noise_power"].values.mean() * of_range * (weights**2).sum())
    axes = {"direction_cosine": cosines, "range": ranges}
    result = _labelled(image, ("draw", *axes), axes, cube, floor)
    angles = ("direction_cosine", np.arcsin(cosines), {"units": "rad"})
    return result.assign_coords(angle=angles)


def detections(
    image: xarray.DataArray,
    guard: Sequence[int] = (2, 2),
    training: Sequence[int] = (8, 8),
    false_alarm: float = 1e-6,
) -> xarray.DataArray:
    """Detect peaks with a constant false-alarm rate (CA-CFAR).

    A bin is detected if its power exceeds the mean power of the training bins around it by the
    factor ``N (P**(-1/N) - 1)``, where N is the number of training bins and P the false-alarm
    probability.

    Parameters
    ----------
    image : xarray.DataArray
        Power from :func:`range_doppler` or :func:`range_angle`.
    guard, training : sequence of two int
        Numbers of guard bins, which are skipped, and of training bins, which are averaged, on each
        side of a bin. Each pair contains the numbers for the last two axes. Beyond its edges, the
        map is periodic along ``range_rate`` and mirrored along other axes.
    false_alarm : float, default 1e-6
        Probability of a detection in a bin that contains only noise.

    Returns
    -------
    xarray.DataArray
        Mask that is True for each detected bin, in the shape of ``image``.

    Raises
    ------
    ArgumentError
        If ``image`` is no DataArray, or the numbers of bins or the probability are out of range.
    """
    filters = require("scipy.ndimage", "arrays", "detections are found with")
    import xarray

    expected = "image to be a DataArray from range_doppler or range_angle"
    checked_type(image, expected, xarray.DataArray)
    near = [checked_count(n, "guard", 0, _MOST) for n in guard]
    far = [n + checked_count(m, "training", 1, _MOST) for n, m in zip(near, training, strict=True)]
    if any(2 * n >= size for n, size in zip(far, image.shape[-2:], strict=True)):
        raise ArgumentError(
            f"the {guard!r} guard bins and {training!r} training bins on each side do not fit into "
            f"a map of {image.shape[-2:]} bins; use fewer of them"
        )
    checked_number(false_alarm, "false_alarm", "between 0 and 1", lambda x: 0 < x < 1)
    modes = ["wrap" if dim == "range_rate" else "reflect" for dim in image.dims[-2:]]

    def sums(half_widths: list[int]) -> tuple[Floats, int]:
        """Return sums of the image over windows around all bins, and the window size in bins."""
        sizes = [2 * n + 1 for n in half_widths]
        mean = filters.uniform_filter(image.values, sizes, mode=modes, axes=(-2, -1))
        return mean * np.prod(sizes), int(np.prod(sizes))

    (outer, all_bins), (inner, inner_bins) = sums(far), sums(near)
    count = all_bins - inner_bins
    factor = false_alarm ** (-1 / count) - 1
    return image.copy(data=image.values > factor * (outer - inner)).rename("detected")


def window_of(name: str, count: int) -> Floats:
    """Return a symmetric window, shape (count,), unnormalised and without zeros at its ends.

    Raises ArgumentError for unknown names.
    """
    signal = require("scipy.signal", "arrays", "windows are computed with")
    try:
        return np.asarray(signal.get_window(name, count + 2, fftbins=False)[1:-1], np.float64)
    except (ValueError, TypeError) as error:
        raise ArgumentError(
            "expected the name of a window for scipy.signal.get_window, got "
            f"{value_text(name)}: {error}"
        ) from None


def _by_rate(cube: Any, window: str, pad: int) -> tuple[Complex, Floats, float]:
    """Transform a data cube from repetitions to range rates.

    Returns spectra (draw, receiver, emitter, rate, frequency), ascending range rates in m/s, and
    the factor by which the window changes the noise power. The spectra are compensated for motion
    within repetitions. ``pad``: number of bins per resolution cell.
    """
    waveform = waveform_of(cube)
    bins = waveform.chirps * checked_count(pad, "pad", 1, 64)
    weights = window_of(window, waveform.chirps)
    period = cube.attrs["period"]
    signal = waveform.to_spectrum(np.asarray(cube["signal"].values))
    spectra = np.fft.fft(signal * weights[:, None], bins, axis=-2) / weights.sum()
    rates = np.fft.fftshift(np.fft.fftfreq(bins, period)) * waveform.wavelength / 2
    spectra = np.fft.fftshift(spectra, axes=-2)
    delays = 2 / SPEED_OF_LIGHT * np.multiply.outer(rates, waveform.times)
    spectra *= np.exp(-2j * np.pi * waveform.frequencies * delays)
    return spectra, rates, float((weights**2).sum() / weights.sum() ** 2)


def _by_range(cube: Any, spectra: Complex, window: str, pad: int) -> tuple[Complex, Floats, float]:
    """Transform spectra to ranges.

    Returns values (..., range), ascending ranges in m from zero, and the noise power of a value
    relative to the noise power of a sample. ``spectra`` has the frequencies of the waveform along
    its last axis. ``pad`` is the number of bins per resolution cell.
    """
    waveform = waveform_of(cube)
    bins = waveform.samples * checked_count(pad, "pad", 1, 64)
    weights = window_of(window, waveform.samples)
    values = np.fft.fft(spectra * weights, bins) / weights.sum()
    ranges = np.arange(bins) * waveform.range_step * waveform.samples / bins
    noise = waveform.noise_gain * float((weights**2).sum() / weights.sum() ** 2)
    return values, ranges, noise


def _labelled(
    values: Floats, dims: Sequence[str], coords: dict[str, Floats], cube: Any, floor: Any
) -> xarray.DataArray:
    """Return received power as a DataArray; ``floor`` is the noise power of a bin in W."""
    import xarray

    units = {"range": "m", "range_rate": "m/s", "direction_cosine": "1"}
    labels = {name: (name, axis, {"units": units[name]}) for name, axis in coords.items()}
    axes = {name: cube.coords[name] for name in dims if name in cube.coords}
    attrs = {"units": "W", "long_name": "received power", "noise_floor": floor}
    return xarray.DataArray(values, {**axes, **labels}, dims, "power", attrs)
