"""The commands ``polywigner rcs`` and ``polywigner radar``: cross sections, and radar samples."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli import options
from polywigner.cli.options import Text, Texts
from polywigner.cli.sources import (
    ReadingOptions,
    WaveOptions,
    field_title,
    required_wavelength,
    short_name,
)
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_angle

if TYPE_CHECKING:
    import xarray

    from polywigner.scattering.cross_sections import Pattern

_Format = StrEnum("_Format", "csv nc")
# Default steps of the map [degrees].
_STEPS = (1.0, 2.0, 5.0, 10.0)
_MAP_SECONDS = 60.0  # longest computing time of a map with the default step [s]
_TIMED = 8  # number of directions timed to choose the default steps
# Smallest step of the map [degrees]; its 4,000,000 directions take hours for a simple body.
_FINEST_OF_MAP = 0.1273
_STEPS_PER_LOBE = 4.0  # default number of steps of a cut per backscatter lobe
_CUT_SECONDS = 30.0  # longest computing time of a cut with the default step [s]
_FINEST = 1e-3  # smallest step of a cut [degrees]


def rcs(
    *,
    body: Annotated[str, typer.Argument(help="Mesh of a body, or aperture file of a plate.")],
    wave: WaveOptions,
    polarisation: Annotated[Text, "vv, hh, vh or hv, receiver first (default: total)."] = None,
    step: Annotated[Text, "Step of the map: '2 deg' (default: 1 to 10 deg)."] = None,
    bounces: Annotated[
        int, typer.Option(min=1, max=3, help="Number of reflections (corner reflectors: 3).")
    ] = 1,
    cut_step: Annotated[Text, "Step of the cuts: '0.05 deg' (default: a quarter lobe)."] = None,
    cut_elevation: Annotated[str, "Elevation of the cut over azimuth, such as '35 deg'."] = "0 deg",
    cut_azimuth: Annotated[str, "Azimuth of the cut over elevation, such as '45 deg'."] = "0 deg",
    smooth: Annotated[Text, "Width of a running median over the cuts, such as '2 deg'."] = None,
    open_mesh: Annotated[bool, "Read the faces of a mesh as thin plates with two sides."] = False,
    reading: ReadingOptions,
    floor_db: options.DbFloor = -60.0,
    formats: Annotated[list[_Format] | None, "csv or nc (repeatable; default: csv)."] = None,
    out: options.Out = None,
) -> None:
    """Compute the radar cross section of a metal body or plate by physical optics.

    Prints the largest value and its direction. Writes a figure NAME_rcs.png (cuts over azimuth and
    over elevation, and a map of both, in dBsm), the values of the map, and the values of the cuts
    in NAME_rcs_cuts.csv.
    """
    reading.check_file(body)
    length = required_wavelength(wave.length())
    map_step = None if step is None else options.parse_step(step, _FINEST_OF_MAP, 30.0)
    fine_step = None if cut_step is None else options.parse_step(cut_step, _FINEST, 30.0)
    centre = parse_angle(cut_azimuth), parse_angle(cut_elevation)
    width = None if smooth is None else parse_angle(smooth)
    suffixes = options.suffixes_of(formats or ["csv"])
    files = options.files_to_write(out, Path(body).stem + "_rcs", (".png", "_cuts.csv", *suffixes))

    import numpy as np

    from polywigner.execution.progress import progress_bar
    from polywigner.figures import draw_rcs
    from polywigner.scattering.cross_sections import Pattern
    from polywigner.scattering.facets import facets_of

    metal = reading.read_body(body, open_mesh)
    pattern_of = partial(Pattern, metal, length, polarisation=polarisation, bounces=bounces)
    lobe = math.degrees(length / (2 * facets_of(metal).size))
    degrees, fine = _angular_steps(pattern_of(0.0, 0.0), map_step, fine_step, lobe)
    count = round(90.0 / degrees)
    _warn_if_coarse("the map", 90.0 / count, lobe, "--step")
    _warn_if_coarse("the cuts", fine, lobe, "--cut-step")
    azimuth = np.radians(np.arange(-2 * count, 2 * count + 1) * 90.0 / count)
    elevation = np.radians(np.arange(-count, count + 1) * 90.0 / count)
    around = np.linspace(-np.pi, np.pi, round(360.0 / fine) + 1)
    above = np.linspace(-np.pi / 2, np.pi / 2, round(180.0 / fine) + 1)
    patterns = [
        pattern_of(around, centre[1]),
        pattern_of(centre[0] + np.array([0.0, np.pi]), above),
        pattern_of(azimuth, elevation),
    ]
    with progress_bar("directions", sum(math.prod(p.shape) for p in patterns)) as advance:
        *cuts, pattern = [p.dataset(p.values(advance)) for p in patterns]
    title = field_title(body, length)
    figure = draw_rcs(pattern, cuts=cuts, smooth=width, floor_db=floor_db, title=title)
    values = [pattern if name == ".nc" else partial(write_rows, [pattern]) for name in suffixes]
    contents = [figure, partial(write_rows, cuts), *values]
    options.write(files, contents, _rcs_summary([pattern, *cuts], floor_db))


def _angular_steps(
    pattern: Pattern, map_step: float | None, fine_step: float | None, lobe: float
) -> tuple[float, float]:
    """Return the steps of the map and the cuts in degrees; timed calls determine the defaults.

    ``lobe`` is the width of a backscatter lobe in degrees.
    """
    import numpy as np

    azimuth, elevation = np.linspace(-3.0, 3.0, _TIMED), np.linspace(-1.4, 1.5, _TIMED)
    pattern.at(azimuth[:1], elevation[:1])  # Fill the caches before timing.
    start = time.perf_counter()
    pattern.at(azimuth, elevation)
    seconds = (time.perf_counter() - start) / _TIMED
    if map_step is None:
        quick = [step for step in _STEPS if 2 * (180 / step) ** 2 * seconds <= _MAP_SECONDS]
        map_step = min(quick, default=_STEPS[-1])
    if fine_step is None:
        fine_step = max(lobe / _STEPS_PER_LOBE, 360.0 * seconds / _CUT_SECONDS, _FINEST)
        fine_step = min(360.0 / math.ceil(360.0 / fine_step), _STEPS[0])
    return map_step, fine_step


def write_rows(patterns: Sequence[xarray.Dataset], path: Path) -> None:
    """Write patterns as CSV: azimuth and elevation in degrees, and cross section in m^2."""
    import numpy as np

    for number, pattern in enumerate(patterns):
        table = pattern["rcs"].to_series().reset_index()
        table.columns = ["azimuth_deg", "elevation_deg", "rcs_m2"]
        table.iloc[:, :2] = np.degrees(table.iloc[:, :2])
        settings: dict[str, Any] = {"mode": "a", "header": False} if number else {}
        table.to_csv(path, index=False, float_format="%.12g", na_rep="nan", **settings)


def _rcs_summary(patterns: Sequence[xarray.Dataset], floor_db: float) -> str:
    """Return the text to print: the largest cross section, its direction, and the method.

    ``floor_db``: lowest level of the figure relative to the largest cross section.
    """
    pattern = max(patterns, key=lambda each: float(each.attrs["largest_rcs"]))
    largest = pattern["rcs"].isel(pattern["rcs"].argmax(["azimuth", "elevation"]))
    peak = 10 * math.log10(float(largest))
    azimuth, elevation = (math.degrees(largest[name]) for name in ("azimuth", "elevation"))
    return (
        f"largest RCS   {peak:.2f} dBsm at azimuth {azimuth:.6g} deg, elevation {elevation:.6g} deg"
        f"\nfigure        down to {peak + floor_db:.2f} dBsm\n"
        f"triangles     {pattern.attrs['triangles']}\n"
        f"method        {pattern['rcs'].attrs['method']} (docs/rcs.md)"
    )


def _warn_if_coarse(name: str, step: float, lobe: float, option: str) -> None:
    """Warn if a step in degrees is larger than the width of the backscatter lobes."""
    if step > lobe:
        warnings.warn(
            f"steps of {step:.3g} degrees are too coarse for lobes of {lobe:.2g} degrees in "
            f"{name}; specify {option}, or use polywigner.rcs for the directions of interest",
            RuntimeWarning,
            stacklevel=3,
        )


_POINTS = 20_000


def radar(
    scene: Annotated[str, typer.Argument(help="Mitsuba XML file of a scene with a receiver.")],
    *,
    waveform: Annotated[
        str,
        "Waveform: '76 GHz + 1 GHz, 256 samples at 20 MHz, 64 chirps every 60 us' (docs/radar.md).",
    ],
    velocity: Annotated[
        Texts, ("NAME = VX, VY, VZ in m/s of a shape, emitter or receiver (repeatable).")
    ] = None,
    elements: Annotated[bool, "Record each element of receivers that are arrays."] = False,
    points: Annotated[int, typer.Option(min=0, help="Scatterers of each receiver.")] = _POINTS,
    rays: Annotated[
        int | None, typer.Option(min=1, help="Rays of each receiver (default: 4 per scatterer).")
    ] = None,
    draws: Annotated[int, typer.Option(min=1, help="Draws of speckle and noise.")] = 1,
    reflections: Annotated[int, "Maximum number of specular reflections per path, 0 to 3."] = 2,
    window: Annotated[str, "Window of scipy.signal, such as hann or boxcar."] = "hann",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
    variant: Annotated[Text, "Mitsuba variant (default: the fastest that works)."] = None,
    floor_db: options.DbFloor = -60.0,
    zarr: Annotated[bool, "Write the data cube as a zarr store, NAME.zarr, not NAME.nc."] = False,
    out: options.Out = None,
) -> None:
    """Compute the samples that the receivers of a radar record in a scene.

    Writes the data cube NAME.nc and a figure of power by range and range rate, NAME_rate.png. With
    several receivers or emitters, also writes a figure of power by range and direction,
    NAME_angle.png.
    """
    pairs = [parse_velocity(text) for text in velocity or []]
    velocities = dict(pairs)
    if len(velocities) < len(pairs):
        raise ArgumentError("--velocity: expected one velocity for each name, got several")
    options.check_scene(scene)
    suffixes = (".zarr" if zarr else ".nc", "_rate.png", "_angle.png")
    files = options.files_to_write(out, f"{Path(scene).stem}_radar", suffixes)

    from polywigner.figures import draw_radar_map
    from polywigner.mitsuba import choose_variant, load_scene, radar_cube
    from polywigner.propagation.stores import required
    from polywigner.radar import parse_waveform, range_angle, range_doppler, window_of

    wave = parse_waveform(waveform)
    window_of(window, wave.samples)  # Raise errors in the window before the computation.
    required("zarr" if zarr else "h5netcdf", "dask")
    with options.warnings_of_mitsuba():
        loaded = load_scene(scene, choose_variant(variant))
        cube = radar_cube(
            loaded, wave, velocities=velocities, elements=elements, points=points, rays=rays,
            draws=draws, reflections=reflections, seed=seed,
        )  # fmt: skip
    title, by_rate = short_name(scene), range_doppler(cube, window)
    contents: list[Any] = [cube, draw_radar_map(by_rate, floor_db=floor_db, title=title)]
    if cube.sizes["receiver"] * cube.sizes["emitter"] > 1:
        by_angle = range_angle(cube, window=window)
        contents.append(draw_radar_map(by_angle, floor_db=floor_db, title=title))
    mean = by_rate.mean(by_rate.dims[:-2])
    peak = mean.isel(mean.argmax(...))
    summary = [
        f"receivers: {cube.sizes['receiver']}, emitters: {cube.sizes['emitter']}, "
        f"{cube.attrs['scattered_points']} scatterers; bins of {wave.range_step:.4g} m and "
        f"{wave.rate_step / cube.sizes['emitter']:.4g} m/s",
        f"maximum at {float(peak['range']):.4g} m, {float(peak['range_rate']):.4g} m/s: "
        f"{float(peak):.4g} W",
        *(f"note: {note}" for note in cube.attrs["notes"]),
    ]
    options.write(files[: len(contents)], contents, "\n".join(summary))


def parse_velocity(text: str) -> tuple[str, tuple[float, ...]]:
    """Parse a name and a velocity in m/s from "NAME = VX, VY, VZ"."""
    name, equals, numbers = text.partition("=")
    values = options.parse_numbers("--velocity", numbers, "-8, 0, 0") if equals else ()
    if not name.strip() or len(values) != 3:
        raise ArgumentError(
            "expected --velocity to be NAME = VX, VY, VZ in m/s, such as 'car = -8, 0, 0', got "
            f"{text!r}"
        )
    return name.strip(), values
