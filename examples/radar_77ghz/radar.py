"""A radar at 77 GHz looks along a street: range-angle and range-Doppler maps from scatterers.

    python examples/radar_77ghz/radar.py --out radar_77ghz.png

The scene as a cloud of scatterers, each a place with a power; what each of 12 receiving elements
gets of it, by its exact field; speckle by random numbers; the beat signal of a chirp (FMCW); and
two Fourier transforms. Posts appear within one bin of where they stand.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import polywigner.mitsuba  # first: chooses the LLVM library before Dr.Jit is loaded

# isort: split
import mitsuba as mi
import numpy as np

import polywigner as pw

HERE = Path(__file__).resolve().parent
LIGHT = 299_792_458.0
WAVELENGTH = LIGHT / 77e9
BANDWIDTH, SAMPLES = 300e6, 128
"""Hz of a chirp, and complex samples of its beat signal: bins of 0.5 m, up to 64 m."""
CHIRPS, PERIOD = 64, 60e-6
"""Chirps, and seconds from one to the next: bins of 0.51 m/s, up to 16 m/s."""
ELEMENTS, SPACING = 12, WAVELENGTH / 2
ANGLES = 64
"""Bins of direction cosine of the transform over elements, padded with zeros."""
POSTS = {
    "post 1": (9.0, 2.0),
    "post 2": (16.0, -3.5),
    "post 3": (24.0, 3.0),
    "post 4": (33.0, -3.0),
}
RADIUS = 0.1
CAR_SPEED = -8.0
"""m/s along x: it comes nearer."""
DRAWS = 200
FLOOR_DB = -50.0

RANGES = np.arange(SAMPLES) * LIGHT / (2 * BANDWIDTH)
SPEEDS = np.fft.fftshift(np.fft.fftfreq(CHIRPS, PERIOD)) * WAVELENGTH / 2
COSINES = np.fft.fftshift(np.fft.fftfreq(ANGLES, SPACING)) * WAVELENGTH


def array() -> pw.Array:
    """The receiving array: columns of patches side by side, in the frame of the receiver."""
    column = pw.read_aperture(HERE / "patch_row.wkt", unit="mm")
    places = (np.arange(ELEMENTS) - (ELEMENTS - 1) / 2) * SPACING
    return pw.Array([column.moved((x, 0.0)) for x in places])


def cloud_of(scene: Any, count: int, seed: int = 0) -> Any:
    """Scatterers; of many rays, for far posts are small."""
    return polywigner.mitsuba.scatterers(
        scene, count, seed=seed, velocities={"car": (CAR_SPEED, 0.0, 0.0)}, rays=20 * count
    )


def speckle(count: int, rng: np.random.Generator) -> np.ndarray:
    """Independent circular Gaussian numbers of variance 1."""
    return (rng.standard_normal(count) + 1j * rng.standard_normal(count)) / np.sqrt(2)


def within_chirp(path: np.ndarray) -> np.ndarray:
    """(scatterers, samples): the phase that a path adds as the frequency rises."""
    return np.exp(2j * np.pi * BANDWIDTH / LIGHT * path[:, None] * np.arange(SAMPLES) / SAMPLES)


def beat_signal(cloud: Any, responses: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
    """(elements, chirps, samples) in root watts."""
    fast = within_chirp(cloud["path_length"].values)
    turns = cloud["path_rate"].values * PERIOD / WAVELENGTH
    signal = np.empty((len(responses), CHIRPS, SAMPLES), complex)
    own = responses * (np.sqrt(cloud["intensity"].values) * amplitudes)
    for chirp in range(CHIRPS):
        signal[:, chirp] = (own * np.exp(2j * np.pi * chirp * turns)) @ fast
    return signal


def window(count: int) -> np.ndarray:
    """Hann's, which keeps the power of noise."""
    shape = np.hanning(count + 2)[1:-1]
    return shape / np.sqrt(np.mean(shape**2))


def by_range(signal: np.ndarray) -> np.ndarray:
    """Spectra over the range bins, the last axis: squared moduli add up to the mean power."""
    return np.fft.fft(signal * window(SAMPLES)) / SAMPLES


def range_doppler(signal: np.ndarray) -> np.ndarray:
    """(chirps, samples) W, the mean over elements; speeds are those of SPEEDS."""
    taper = window(CHIRPS)[:, None]
    spectrum = np.fft.fft(by_range(signal) * taper, axis=1) / CHIRPS
    return np.fft.fftshift(np.mean(np.abs(spectrum) ** 2, axis=0), axes=0)


def range_angle(signal: np.ndarray) -> np.ndarray:
    """(angles, samples) W, the mean over chirps; cosines are those of COSINES."""
    taper = window(ELEMENTS)[:, None, None]
    # elements at larger x are nearer to what lies there: their phases fall
    spectrum = np.fft.ifft(by_range(signal) * taper, ANGLES, axis=0) * (ANGLES / ELEMENTS)
    return np.fft.fftshift(np.mean(np.abs(spectrum) ** 2, axis=1), axes=0)


def mean_profile(cloud: Any, responses: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(samples,) W of the first element, the mean over draws of speckle."""
    own = np.sqrt(cloud["intensity"].values) * responses[0]
    fast = by_range(within_chirp(cloud["path_length"].values))
    draws = np.array([speckle(len(own), rng) * own for _ in range(DRAWS)])
    return np.mean(np.abs(draws @ fast) ** 2, axis=0)


def expected_profile(ranges: np.ndarray, power: np.ndarray) -> np.ndarray:
    """(samples,) W: powers at their ranges, as the chirp's bins resolve them."""
    return power @ np.abs(by_range(within_chirp(2 * ranges))) ** 2


def seen_at(pose: np.ndarray, place: tuple[float, float]) -> tuple[float, float]:
    """Range (m) of a post's face and its direction cosine along the array, analytically."""
    way = np.array([*place, pose[2, 3]]) - pose[:3, 3]
    distance = float(np.linalg.norm(way))
    return distance - RADIUS, float(way @ pose[:3, 0]) / distance


def peak_near(picture: np.ndarray, x: int, y: int, reach: int) -> tuple[int, int]:
    """Row and column of the largest value at most so many bins away."""
    rows, columns = (slice(max(k - reach, 0), k + reach + 1) for k in (y, x))
    result = np.unravel_index(picture[rows, columns].argmax(), picture[rows, columns].shape)
    return int(result[0]) + rows.start, int(result[1]) + columns.start


def draw(angle: np.ndarray, doppler: np.ndarray, pose: np.ndarray, path: Path) -> None:
    """Both maps side by side, with rings where posts and car are."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    mpl.rcParams["font.size"] = 9
    figure = Figure(figsize=(10, 4.2), layout="constrained", dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    for ax, picture, across in ((axes[0], angle, COSINES), (axes[1], doppler, SPEEDS)):
        peak = 10 * np.log10(picture.max() / 1e-3)
        level = 10 * np.log10(np.maximum(picture, 1e-30) / 1e-3)
        shown = ax.pcolormesh(
            RANGES, across, level, cmap="inferno", vmin=peak + FLOOR_DB, vmax=peak, rasterized=True
        )
        bar = figure.colorbar(shown, ax=ax)
        bar.set_label(f"dBm; floor {-FLOOR_DB:g} dB below the peak")
        ax.set(xlabel="range (m)", xlim=(0, 45))
    axes[0].set(
        ylabel="direction cosine along the array",
        ylim=(-0.8, 0.8),
        title="Range and angle, mean of 64 draws of speckle",
    )
    axes[1].set(ylabel="radial speed (m/s)", title="Range and Doppler, one draw of speckle")
    for place in POSTS.values():
        axes[0].plot(*seen_at(pose, place), "o", mfc="none", mec="white", ms=11)
    axes[1].plot(18.0, CAR_SPEED, "o", mfc="none", mec="white", ms=11)
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("radar_77ghz.png"))
    parser.add_argument("--count", type=int, default=20_000, help="scatterers")
    asked = parser.parse_args()
    mi.set_variant(polywigner.mitsuba.choose_variant())
    scene = polywigner.mitsuba.load_scene(HERE / "radar.xml", merge=False)
    cloud = cloud_of(scene, asked.count)
    pose = np.reshape(cloud.attrs["to_world"], (4, 4))
    responses = polywigner.mitsuba.element_responses(cloud, array())
    rng = np.random.default_rng(1)
    power = float(cloud["power"].values.sum())
    print(f"{len(responses[0])} scatterers, {power:.3e} W +- {cloud.attrs['standard_error']:.1e} W")

    signal = beat_signal(cloud, responses, speckle(len(responses[0]), rng))
    doppler = range_doppler(signal)
    angle = np.mean([range_angle(one) for one in draws_of_angle(cloud, responses, rng)], axis=0)
    for name, place in POSTS.items():
        distance, cosine = seen_at(pose, place)
        x, y = (
            int(np.abs(axis - v).argmin()) for axis, v in ((RANGES, distance), (COSINES, cosine))
        )
        row, column = peak_near(angle, x, y, 2)
        print(
            f"{name}: {distance:.2f} m, cosine {cosine:+.3f}; "
            f"peak {RANGES[column]:.2f} m, {COSINES[row]:+.3f}"
        )
    mean, expected = (
        mean_profile(cloud, responses, rng),
        expected_profile(cloud["path_length"].values / 2, cloud["power"].values),
    )
    off = (mean / expected - 1) * np.sqrt(DRAWS)
    strong = expected > expected.max() * 1e-4
    print(f"mean of {DRAWS} draws less the cloud: {off[strong].std():.2f} standard errors of a bin")
    draw(angle, doppler, pose, asked.out)
    print(asked.out)


def draws_of_angle(cloud: Any, responses: np.ndarray, rng: np.random.Generator) -> Any:
    """Beat signals (elements, 1, samples) of 64 draws, of one chirp each."""
    fast = within_chirp(cloud["path_length"].values)
    own = responses * np.sqrt(cloud["intensity"].values)
    for _ in range(64):
        yield ((own * speckle(own.shape[1], rng)) @ fast)[:, None]


if __name__ == "__main__":
    main()
