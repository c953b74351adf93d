"""``polywigner receive``: power of a scene's receivers as a table, a record and a picture."""

from __future__ import annotations

import csv
import shutil
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from polywigner.cli import options, output, scenes
from polywigner.cli.sources import frequency_text, short_name
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_frequency, parse_noise

# Panels of a row of the picture.
_COLUMNS = 3


@dataclass(frozen=True)
class ReceiveSettings:
    """Options of one run, as they are recorded; None: the scene's own."""

    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file with a <sensor type='wigner_receiver'> in it.")
    ]
    spp: Annotated[
        int | None, "Samples of the scattered light of each emitter (default: the scene's)."
    ] = None
    seed: options.Seed = 0
    variant: options.Variant = None
    reflections: Annotated[int, "Most flat mirrors on a direct way, 0 to 3."] = 2
    accuracy: Annotated[float, "Relative error allowed of the fields of direct light."] = 1e-6
    bandwidth: Annotated[
        str | None, "Bandwidth of the noise, such as '1 GHz' (default: the receiver's own)."
    ] = None
    temperature: Annotated[
        str | None, "Noise temperature, such as '290 K' (default: the receiver's own)."
    ] = None
    noise_figure: Annotated[
        str | None, "Noise figure, such as '3 dB' (default: the receiver's own, else 0 dB)."
    ] = None
    range_text: Annotated[
        str | None,
        typer.Option(
            "--range",
            help="Sort the power by range as well, such as '0 m to 60 m' (docs/range.md).",
        ),
    ] = None
    bins: Annotated[int | None, "Number of bins of the range (default: 256)."] = None
    coherent: Annotated[bool, "Add direct ways as amplitudes, with fringes (docs/channel.md)."] = (
        False
    )
    frequencies: Annotated[
        str | None,
        "Write the complex channel at these frequencies as well, such as '76 GHz to 78 "
        "GHz, 201' or '76 GHz, 77 GHz'.",
    ] = None
    polarisation: Annotated[
        str | None,
        "Polarisation of sources and receivers without one: x, y (default), right, left, "
        "unpolarised or a slant such as '45 deg'; selects a polarised variant.",
    ] = None
    diffraction: options.Diffraction = False
    defined: options.Define = None
    resumable: options.Resumable = False
    threads: options.Threads = None
    scheduler: options.Scheduler = None
    floor_db: options.DbFloor = -40.0


def receive(settings: ReceiveSettings, out: options.Out = None) -> None:
    """Say what power the receivers of a scene get, straight, by mirrors and scattered.

    Prints a table, writes all of it NAME.json, and a picture of where scattered power comes from
    NAME.png; with --range, power by half the length of its path NAME_range.nc and NAME_range.png
    too; with --frequencies, complex amplitudes of ways that interfere NAME_channel.nc,
    NAME_channel.csv and NAME_channel.png. With --scheduler, the workers of a cluster share the
    batches of samples, and the run is resumable.
    """
    defined = dict(scenes.scene_definition(text) for text in settings.defined or [])
    scene, seed = settings.scene, settings.seed
    scenes.check_scene_file(scene)
    scenes.check_samples(settings.spp, seed)
    scenes.check_threads(settings.threads)
    noise = parse_noise(settings.bandwidth, settings.temperature, settings.noise_figure)
    stem = output.output_stem(out, Path(scene).stem + "_received")
    edges = scenes.parse_ranges(settings.range_text, settings.bins, "receive")
    by_range = ("_range.nc", "_range.png") if edges is not None else ()
    band = parse_band(settings.frequencies)
    of_channel = ("_channel.nc", "_channel.csv", "_channel.png") if band else ()
    files = output.targets(stem, (".json", ".png", *by_range, *of_channel))
    output.check_writable(files)
    new = output.missing_folders(files)

    from polywigner.figures import draw_channel
    from polywigner.figures.levels import check_floor
    from polywigner.mitsuba import channel, choose_variant
    from polywigner.mitsuba.polarisation import is_polarised
    from polywigner.mitsuba.received import ReceiveOptions, interference_of
    from polywigner.mitsuba.received_power import arrival_map, shapes_in
    from polywigner.mitsuba.receiver import receivers_of
    from polywigner.mitsuba.scene_renders import (
        SceneFile,
        receive_parts,
        receive_ranges,
    )
    from polywigner.propagation.stores import required

    store = scenes.store_of_parts(stem, settings.resumable, settings.scheduler)
    check_floor(settings.floor_db)
    for module in ("h5netcdf", "dask") if band else ():
        required(module)
    start = time.perf_counter()
    jones = settings.polarisation
    chosen = choose_variant(settings.variant, jones is not None and settings.variant is None)
    polarised = is_polarised(chosen)
    if jones is not None and not (polarised or settings.coherent):
        raise ArgumentError(
            f"the unpolarised variant {chosen} counts --polarisation only with --coherent; add it, "
            "or leave --variant out"
        )
    profile = None
    with scenes.messages_as_warnings():
        if edges is not None:
            scenes.prepare_ranges(chosen)
        file = SceneFile(
            Path(scene), chosen, None, defined, settings.diffraction, jones if polarised else None
        )
        loaded = file.load()
        receivers_of(loaded)
        by_argument = None if polarised else jones
        waves = interference_of(settings.coherent, by_argument, None)
        how_many = settings.spp, seed, None, settings.reflections, settings.accuracy
        asked = ReceiveOptions(*how_many, noise, waves)
        with scenes.counted_bar("receiving") as progress:
            how: dict[str, Any] = {"store": store, "progress": progress}
            how |= {"scheduler": settings.scheduler, "threads": settings.threads}
            if edges is None:
                found = receive_parts(file, loaded, asked, **how)
            else:
                found, profile = receive_ranges(file, loaded, asked, edges, **how)
        if band:
            with scenes.counted_bar("channels") as progress:
                found_channel = channel(
                    loaded,
                    band,
                    settings.reflections,
                    polarisation=by_argument,
                    tolerance=settings.accuracy,
                    progress=progress,
                )
        maps = [arrival_map(loaded, number, seed) for number in range(len(found))]
        names = [shapes_in(loaded, number, picture) for number, picture in enumerate(maps)]
    record: dict[str, Any] = {
        "settings": asdict(settings) | {"defined": defined},
        "used": {"variant": chosen},
        "receivers": [each.to_dict() for each in found],
        "versions": scenes.versions_of(chosen),
        "seconds": round(time.perf_counter() - start, 3),
    }
    floor, said = settings.floor_db, "\n\n".join(map(str, found))
    contents = [record, _figure(scene, found, maps, names, floor)]
    if profile is not None:
        record["ranges"] = scenes.ranges_record(profile, len(found))
        contents += [profile, scenes.draw_ranges(scene, profile, found, floor)]
        said += f"\n{scenes.ranges_text(profile, found)}"
    if band:
        title = f"{short_name(scene)}, {len(band)} frequencies"
        picture = draw_channel(found_channel, floor_db=floor, title=title)
        contents += [found_channel, partial(_write_ways, found_channel), picture]
    output.write(files, contents, said)
    if store is not None:
        shutil.rmtree(store, ignore_errors=True)
        output.say_made(new)


_MOST_FREQUENCIES = 1 << 16


def parse_band(text: str | None) -> list[float]:
    """Frequencies in Hz of a text such as "76 GHz to 78 GHz, 201" or "76 GHz, 77 GHz".

    None: no frequencies. Raises ArgumentError or QuantityError for another text.
    """
    if text is None:
        return []
    ends, _, number = text.partition(",")
    first, to, last = ends.partition(" to ")
    if not to:
        return [parse_frequency(part.strip()) for part in text.split(",")]
    low, high = (parse_frequency(end.strip()) for end in (first, last))
    count = int(number) if number.strip().isdecimal() and len(number) < 9 else 0
    if not (low < high and 2 <= count <= _MOST_FREQUENCIES):
        raise ArgumentError(
            "expected --frequencies as a lower and a higher one with a number from 2 to "
            f"{_MOST_FREQUENCIES}, got {text[:100]!r}; write such as '76 GHz to 78 GHz, 201'"
        )
    return [low + (high - low) * k / (count - 1) for k in range(count)]


def _write_ways(found: Any, path: Path) -> None:
    """A row for each frequency and pair, of the channel itself and of each of its ways."""
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["frequency_hz", "receiver", "emitter", "way", "delay_s", "real", "imag"])
        ways = [str(name) or "direct" for name in found["mirrors"].values]
        for i, frequency in enumerate(found["frequency"].values.tolist()):
            for j, receiver in enumerate(found["receiver"].values.tolist()):
                for k, emitter in enumerate(found["emitter"].values.tolist()):
                    total = complex(found["h"].values[i, j, k])
                    first = [frequency, receiver, emitter]
                    rows.writerow([*first, "all", "", total.real, total.imag])
                    each = found["amplitude"].values[i, j, k], found["delay"].values[j, k]
                    for way, value, delay in zip(ways, *each, strict=True):
                        if delay == delay:  # a number: the way is there
                            rows.writerow([*first, way, delay, value.real, value.imag])


def _figure(
    scene: str, found: list[Any], maps: list[Any], names: list[Any], floor_db: float
) -> Any:
    """A panel for each receiver."""
    from polywigner.figures.scenes import DirectArrival, draw_arrivals
    from polywigner.figures.style import new_figure

    columns = min(len(found), _COLUMNS)
    rows = -(-len(found) // columns)
    figure = new_figure(5.4 * columns, 4.7 * rows, spacing=0.05)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, each, picture, named in zip(panels, found, maps, names, strict=False):
        marks = [
            DirectArrival(
                path.arrives_from, path.power, " by ".join([path.light or part.name, *path.mirrors])
            )
            for part in each.contributions
            for path in part.paths
        ]
        draw_arrivals(picture, marks, floor_db, _title(scene, each), names=named, ax=axes)
    for axes in panels[len(found) :]:
        axes.set_visible(False)
    return figure


def _title(scene: str, found: Any) -> str:
    from polywigner.mitsuba.received import dbm_text

    parts = f"direct {dbm_text(found.direct)}, scattered {dbm_text(found.scattered)}"
    total = dbm_text(found.power)
    text = (
        f"{short_name(scene)}, receiver {found.receiver}, {frequency_text(found.wavelength)}\n"
        f"received {total}: {parts}"
    )
    return text.replace(" -", " −")
