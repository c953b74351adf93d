"""``polywigner radar``: samples of a radar in a scene, and maps of range, rate and direction."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from polywigner.cli import options
from polywigner.cli.options import Text, Texts
from polywigner.cli.sources import short_name
from polywigner.errors import ArgumentError, SceneError

_POINTS = 20_000


def radar(
    scene: Annotated[str, typer.Argument(help="Mitsuba XML file of a scene with a receiver.")],
    *,
    waveform: Annotated[
        str,
        "Waveform: '76 GHz + 1 GHz, 256 samples at 20 MHz, 64 chirps every 60 us' (docs/radar.md).",
    ],
    velocity: Annotated[Texts, "NAME = VX, VY, VZ in m/s of a shape or end (repeatable)."] = None,
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

    Writes the data cube NAME.nc, and figures of power by range and range rate, NAME_rate.png, and
    with several receivers or emitters by range and direction, NAME_angle.png.
    """
    velocities = dict(parse_velocity(text) for text in velocity or [])
    if not Path(scene).is_file():
        raise SceneError(f"expected a Mitsuba scene file, got {scene!r}, which is not a file")
    suffixes = (".zarr" if zarr else ".nc", "_rate.png", "_angle.png")
    files = options.files_to_write(out, f"{Path(scene).stem}_radar", suffixes)

    from polywigner.figures import draw_radar_map
    from polywigner.mitsuba import choose_variant, load_scene, radar_cube
    from polywigner.mitsuba.plugins.films import to_list
    from polywigner.propagation.stores import required
    from polywigner.radar import parse_waveform, range_angle, range_doppler

    wave = parse_waveform(waveform)
    for module in ("zarr" if zarr else "h5netcdf", "dask"):
        required(module)
    with to_list() as messages:
        loaded = load_scene(scene, choose_variant(variant))
        cube = radar_cube(
            loaded, wave, velocities=velocities, elements=elements, points=points, rays=rays,
            draws=draws, reflections=reflections, seed=seed,
        )  # fmt: skip
    for message in messages:
        warnings.warn(f"Mitsuba: {message}", RuntimeWarning, stacklevel=2)
    title, by_rate = short_name(scene), range_doppler(cube, window)
    contents: list[Any] = [cube, draw_radar_map(by_rate, floor_db=floor_db, title=title)]
    if cube.sizes["receiver"] * cube.sizes["emitter"] > 1:
        by_angle = range_angle(cube, window=window)
        contents.append(draw_radar_map(by_angle, floor_db=floor_db, title=title))
    mean = by_rate.mean(by_rate.dims[:-2])
    peak = mean.isel(mean.argmax(...))
    summary = [
        f"{cube.sizes['receiver']} receivers, {cube.sizes['emitter']} emitters, "
        f"{cube.attrs['scattered_points']} scatterers; bins of {wave.range_step:.4g} m and "
        f"{wave.rate_step / cube.sizes['emitter']:.4g} m/s",
        f"maximum at {float(peak['range']):.4g} m, {float(peak['range_rate']):.4g} m/s: "
        f"{float(peak):.4g} W",
        *(f"note: {note}" for note in cube.attrs["notes"]),
    ]
    options.write(files[: len(contents)], contents, "\n".join(summary))


def parse_velocity(text: str) -> tuple[str, tuple[float, ...]]:
    """Return the name and velocity of a text NAME = VX, VY, VZ; ArgumentError for other texts."""
    name, equals, numbers = text.partition("=")
    values = options.parse_numbers("--velocity", numbers, "-8, 0, 0") if equals else ()
    if not name.strip() or len(values) != 3:
        raise ArgumentError(
            f"expected --velocity as NAME = VX, VY, VZ in m/s, got {text!r}; write such as "
            "'car = -8, 0, 0'"
        )
    return name.strip(), values
