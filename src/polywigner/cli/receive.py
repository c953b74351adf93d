"""``polywigner receive``: power of a scene's receivers as a table, a record and a picture."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import typer

from polywigner.cli import options, scene_options
from polywigner.cli.sources import frequency_text, short_name
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_frequency, parse_noise

# Panels of a row of the picture.
_COLUMNS = 3


@dataclass(frozen=True, kw_only=True)
class ReceiveSettings(scene_options.SceneOptions):
    """Options of one run, as they are recorded; None: the scene's own."""

    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file with a <sensor type='wigner_receiver'> in it.")
    ]
    spp: Annotated[
        int | None,
        typer.Option(
            min=1, help="Samples of the scattered light of each emitter (default: the scene's)."
        ),
    ] = None
    reflections: Annotated[int, "Maximum number of specular reflections per path, 0 to 3."] = 2
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
    bins: Annotated[
        int | None,
        typer.Option(min=1, max=2**16, help="Number of bins of the range (default: 256)."),
    ] = None
    coherent: Annotated[bool, "Add direct paths as amplitudes, with fringes (docs/channel.md)."] = (
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
    defined: Annotated[
        list[str] | None, "NAME=VALUE of a $parameter of the scene; several times for more."
    ] = None


def receive(settings: ReceiveSettings, out: options.Out = None) -> None:
    """Compute the power at the receivers of a scene: direct, reflected and scattered.

    Prints a table, writes all of it NAME.json, and a picture of where scattered power comes from
    NAME.png; with --range, power by half the length of its path NAME_range.nc and NAME_range.png
    too; with --frequencies, complex amplitudes of paths that interfere NAME_channel.nc,
    NAME_channel.csv and NAME_channel.png. With --scheduler, the workers of a cluster share the
    batches of samples, and the run is resumable.
    """
    defined = dict(parse_definition(text) for text in settings.defined or [])
    scene, seed = settings.scene, settings.seed
    scene_options.check_scene_file(scene)
    noise = parse_noise(settings.bandwidth, settings.temperature, settings.noise_figure)
    stem = options.output_stem(out, Path(scene).stem + "_received")
    edges = settings.edges(settings.bins, 256)
    by_range = ("_range.nc", "_range.png") if edges is not None else ()
    band = parse_band(settings.frequencies)
    of_channel = ("_channel.nc", "_channel.csv", "_channel.png") if band else ()
    files = options.targets(stem, (".json", ".png", *by_range, *of_channel))
    options.check_writable(files)

    from polywigner.figures import draw_channel
    from polywigner.mitsuba import channel, choose_variant
    from polywigner.mitsuba.plugins.polariser import is_polarised
    from polywigner.mitsuba.receive.power_results import ReceiveOptions
    from polywigner.mitsuba.receive.received_power import arrival_map, shapes_in
    from polywigner.mitsuba.scenes import scene_renders
    from polywigner.mitsuba.scenes.surfaces import receivers_of
    from polywigner.propagation.stores import required

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
    by_scene, by_argument = (jones, None) if polarised else (None, jones)
    response = None
    with settings.parts(stem) as store:
        with scene_options.messages_as_warnings():
            if edges is not None:
                scene_options.prepare_ranges(chosen)
            file = scene_renders.SceneFile(
                Path(scene), chosen, None, defined, settings.diffraction, by_scene
            )
            loaded = file.load()
            receivers_of(loaded)
            waves = {"coherent": settings.coherent, "polarisation": by_argument}
            limits = settings.spp, seed, None, settings.reflections, settings.accuracy
            others: dict[str, Any] = {**noise, **waves}
            requested = ReceiveOptions(*limits, **others)
            with _progress("receiving") as progress:
                how: dict[str, Any] = {"store": store, "progress": progress}
                how |= {"scheduler": settings.scheduler, "threads": settings.threads}
                received, profile = scene_renders.receive_parts(
                    file, loaded, requested, edges, **how
                )
            if band:
                how = {"polarisation": by_argument, "tolerance": settings.accuracy}
                with _progress("channels") as progress:
                    response = channel(loaded, band, settings.reflections, progress=progress, **how)
            maps = [arrival_map(loaded, number, seed) for number in range(len(received))]
            names = [shapes_in(loaded, number, power) for number, power in enumerate(maps)]
        record = settings.record(chosen) | {"receivers": [each.to_dict() for each in received]}
        record["settings"]["defined"] = defined
        record["seconds"] = round(time.perf_counter() - start, 3)
        floor, said = settings.floor_db, "\n\n".join(map(str, received))
        contents = [record, _figure(scene, received, maps, names, floor)]
        if profile is not None:
            by_receiver = profile if "receiver" in profile.dims else profile.expand_dims("receiver")
            record["ranges"] = _ranges_record(by_receiver)
            contents += [profile, _draw_ranges(scene, profile, received, floor)]
            said += f"\n{_ranges_text(by_receiver, received)}"
        if response is not None:
            title = f"{short_name(scene)}, {len(band)} frequencies"
            figure = draw_channel(response, floor_db=floor, title=title)
            contents += [response, partial(_write_channel, response), figure]
        options.write(files, contents, said)


def parse_definition(text: str) -> tuple[str, str]:
    """Return name and value of ``--define``; ArgumentError for other texts."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise ArgumentError(
            f"expected --define as NAME=VALUE of a $parameter of the scene, got {text!r}"
        )
    return name, value


@contextmanager
def _progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """Give a function to call after each part with the numbers of completed and of all parts.

    The first call starts the progress bar.
    """
    from polywigner.execution.progress import progress_bar

    with ExitStack() as stack:
        started = cache(lambda total: stack.enter_context(progress_bar(title, total)))
        yield lambda done, total: started(total)()


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


def _write_channel(channel: Any, path: Path) -> None:
    """Write a row for each frequency, pair and path, and for the sum of the paths of a pair."""
    paths = [str(name) or "direct" for name in channel["mirrors"].values]
    frequencies, receivers, emitters = (
        channel[name].values.tolist() for name in ("frequency", "receiver", "emitter")
    )
    h, amplitude, delay = (channel[name].values for name in ("h", "amplitude", "delay"))
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["frequency_hz", "receiver", "emitter", "way", "delay_s", "real", "imag"])
        for i, j, k in product(*map(range, h.shape)):
            first = frequencies[i], receivers[j], emitters[k]
            rows.writerow([*first, "all", "", h[i, j, k].real, h[i, j, k].imag])
            for name, value, seconds in zip(paths, amplitude[i, j, k], delay[j, k], strict=True):
                if not math.isnan(seconds):  # NaN: the pair has no such path
                    rows.writerow([*first, name, seconds, value.real, value.imag])


def _figure(
    scene: str, found: list[Any], maps: list[Any], names: list[Any], floor_db: float
) -> Any:
    """Draw the scattered power of each receiver over its directions, a panel for each receiver."""
    from polywigner.figures.scene_plots import DirectArrival, draw_arrivals
    from polywigner.figures.style import new_figure
    from polywigner.mitsuba.receive.power_results import dbm_text

    columns = min(len(found), _COLUMNS)
    rows = -(-len(found) // columns)
    figure = new_figure(5.4 * columns, 4.7 * rows, spacing=0.05)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, each, power, named in zip(panels, found, maps, names, strict=False):
        marks = [
            DirectArrival(
                path.arrives_from, path.power, " by ".join([path.light or part.name, *path.mirrors])
            )
            for part in each.contributions
            for path in part.paths
        ]
        direct, scattered, total = map(dbm_text, (each.direct, each.scattered, each.power))
        text = f"received {total}: direct {direct}, scattered {scattered}".replace(" -", " −")
        title = f"{_title(scene, each)}\n{text}"
        draw_arrivals(power, marks, floor_db, title, names=named, ax=axes)
    for axes in panels[len(found) :]:
        axes.set_visible(False)
    return figure


def _title(scene: str, found: Any) -> str:
    return f"{short_name(scene)}, receiver {found.receiver}, {frequency_text(found.wavelength)}"


def _ranges_record(profile: Any) -> dict[str, Any]:
    """Return a profile without its powers by emitter, for JSON."""
    import numpy as np

    edges, paths = profile["range_edge"].values, []
    for receiver, emitter, path in np.argwhere(np.isfinite(profile["path_range"].values)).tolist():
        paths.append(
            {
                "receiver": receiver,
                "emitter": str(profile["emitter"].values[emitter]),
                "mirrors": str(profile["mirrors"].values.ravel()[path]),
                "range_m": float(profile["path_range"].values[receiver, emitter, path]),
                "power_w": float(profile["path_power"].values[receiver, emitter, path]),
            }
        )
    names = ("power", "standard_error", "before", "after", "direct_power", "scattered_power")
    receivers = [
        {f"{name}_w": profile[name].values[k].tolist() for name in names}
        for k in range(profile.sizes["receiver"])
    ]
    return {"paths": paths, "edges_m": edges.tolist(), "receivers": receivers}


def _ranges_text(profile: Any, found: list[Any]) -> str:
    """Describe the strongest bin of each receiver, and the power outside all bins."""
    from polywigner.mitsuba.receive.power_results import dbm_text

    edges = profile["range_edge"].values
    lines = []
    for number, each in enumerate(found):
        one = profile.isel(receiver=number)
        k = int(one["power"].values.argmax())
        names = ("power", "standard_error", "direct_power")
        power, error, direct = (float(one[name].values[k]) for name in names)
        before, after = (float(one[name].values) for name in ("before", "after"))
        lines.append(
            f"receiver {each.receiver}: most from {edges[k]:.6g} m to {edges[k + 1]:.6g} m, "
            f"{power:.4g} W +- {error:.4g} W ({dbm_text(power)}), {direct:.4g} W of it direct; "
            f"nearer than all bins {before:.4g} W, farther {after:.4g} W"
        )
    return "\n".join(lines)


def _draw_ranges(scene: str, profile: Any, found: list[Any], floor_db: float) -> Any:
    """Draw the power by range, a panel for each receiver."""
    from polywigner.figures import draw_range_profile
    from polywigner.figures.style import new_figure

    figure = new_figure(6.4, 3.4 * len(found), spacing=0.05)
    panels = figure.subplots(len(found), 1, squeeze=False).ravel()
    for number, (axes, each) in enumerate(zip(panels, found, strict=True)):
        draw_range_profile(profile, number, floor_db=floor_db, title=_title(scene, each), ax=axes)
    return figure
