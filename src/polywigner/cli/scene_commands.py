"""The commands ``polywigner render`` and ``polywigner receive``: radiance and received power."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from polywigner.cli import options
from polywigner.cli.options import Text, Texts
from polywigner.cli.sources import frequency_text, short_name
from polywigner.errors import ArgumentError, SceneError
from polywigner.quantities import parse_frequency, parse_noise

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from polywigner.mitsuba.receive.power_results import ReceivedPower

_Integrator = Literal["path", "direct", "volpath", "volpathmis", "prb", "prbvolpath"]
_POLARISED = ("_stokes.npz", "_stokes.png", "_polarisation.png")
_STOKES_CHANNELS = 12


@dataclass(frozen=True, kw_only=True)
class RenderSettings(options.SceneOptions):
    """Options of ``render``; None selects the setting of the scene."""

    spp: Annotated[
        int | None, typer.Option(min=1, max=2**30, help="Samples per pixel (default: the scene's).")
    ] = None
    integrator: Annotated[_Integrator | None, "path, volpath, ... (default: the scene's)."] = None
    polarised: Annotated[bool, "Also write the Stokes parameters (docs/polarisation.md)."] = False


def render(settings: RenderSettings, out: options.Out = None) -> None:
    """Render a Mitsuba scene with a coherent aperture as its source.

    Writes the signed radiance NAME.exr, a figure in dB NAME.png, and a record NAME.json. With
    --range, also writes the image of each bin, NAME_range.nc. With --polarised, also writes the
    Stokes parameters NAME_stokes.npz, their figure NAME_stokes.png, and a figure of the degree and
    angle of polarisation, NAME_polarisation.png. With --scheduler, the workers of a cluster share
    the parts of the image, and the run is resumable.
    """
    options.check_scene(settings.scene)
    edges = settings.edges(64)
    suffixes = [".exr", ".png", ".json"]
    suffixes += _POLARISED if settings.polarised else ()
    suffixes += ("_range.nc",) if edges is not None else ()
    files = options.files_to_write(out, Path(settings.scene).stem, suffixes)

    import numpy as np

    from polywigner import figures
    from polywigner.execution import kernel_threads
    from polywigner.figures.levels import PEAK_RULE
    from polywigner.mitsuba import choose_variant, stokes_of
    from polywigner.mitsuba.plugins import films, polariser
    from polywigner.mitsuba.plugins.placement import placed_emitters
    from polywigner.mitsuba.radar.range_profile import range_frames
    from polywigner.mitsuba.scenes.rendering import default_integrator, default_spp
    from polywigner.mitsuba.scenes.scene_renders import SceneFile, render_parts
    from polywigner.mitsuba.scenes.surfaces import is_receiver

    start = time.perf_counter()
    variant = choose_variant(settings.variant, settings.polarised)
    integrator, floor, frames = settings.integrator, settings.floor_db, None
    with settings.running(variant, files[0]) as store:
        file = SceneFile(Path(settings.scene), variant, diffraction=settings.diffraction)
        scene = file.load()
        specs = _emitter_parameters(scene, settings.scene)
        samples = settings.spp or default_spp(scene)
        receives = is_receiver(scene.sensors()[0])
        if settings.polarised and receives:
            raise SceneError(
                f"--polarised requires a camera, but {settings.scene} has a wigner_receiver; set "
                "the polarisation in the parameters of the receiver"
            )
        ready = time.perf_counter()
        # Scenes without path lengths raise an error here, before the slow render.
        if edges is not None:
            with kernel_threads(settings.threads):
                frames = range_frames(
                    scene, edges, spp=samples, seed=settings.seed, integrator=integrator
                )
        measured = f"stokes {integrator or ''}" if settings.polarised else integrator
        exposure = {"integrator": measured, "spp": samples, "seed": settings.seed}
        image = render_parts(
            file, scene, exposure, store, scheduler=settings.scheduler, threads=settings.threads
        )
        done = time.perf_counter()

        title = _render_title(specs, settings.scene, variant, samples)
        stokes = stokes_of(image) if settings.polarised else None
        radiance = films.mean_of_colours(
            image if stokes is None else image[..., :-_STOKES_CHANNELS]
        )
        reference = figures.image_peak(radiance)
        record, default = settings.record(variant), scene.integrator()
        record["used"] |= {
            "integrator": integrator
            or (default.class_name() if default else default_integrator(scene)),
            "size": [radiance.shape[1], radiance.shape[0]],
            "spp": samples,
        }
        if polariser.is_polarised(variant):
            sources = placed_emitters(scene)
            record["used"]["polarisation"] = polariser.polarisation_summary(sources, False)
        record["figure"] = {
            "unit": "W" if receives else "W m^-2 sr^-1",
            "zero_db": reference,
            "zero_db_rule": PEAK_RULE,
            "floor_db": floor,
        }
        record["seconds"] = {"load": round(ready - start, 3), "render": round(done - ready, 3)}
        _warn_if_mostly_dark(radiance)
        if receives:
            figure = figures.draw_arrivals(radiance, (), floor, title)
        else:
            figure = figures.draw_scene(radiance, reference, floor, title=title)
        contents: list[Any] = [partial(films.write_exr, image=image), figure, record]
        if stokes is not None:
            contents.append(partial(np.savez_compressed, stokes=stokes.astype(np.float32)))
            contents.append(figures.draw_stokes(stokes, title))
            contents.append(figures.draw_polarisation(stokes, floor, title))
        if frames is not None:
            contents.append(frames)
        options.write(files, contents)


def _emitter_parameters(scene: Any, name: str) -> list[Any]:
    """Return the parameters of all Wigner emitters; warn if a wavelength is implausible.

    Raises SceneError if there are no emitters.
    """
    from polywigner.geometry.arguments import warn_of_wavelength

    specs = [emitter.spec for emitter in scene.emitters() if hasattr(emitter, "spec")]
    if not specs:
        raise SceneError(
            f'the scene {name} has no <shape type="wigner">; add one, or render the scene with '
            "Mitsuba itself"
        )
    for spec in specs:
        warn_of_wavelength(spec.source, spec.wavelength)
    return specs


def _warn_if_mostly_dark(radiance: NDArray[np.float64]) -> None:
    """Warn if more than half of the pixels are zero or negative."""
    negative, zero = (radiance < 0).mean(), (radiance == 0).mean()
    if negative + zero > 0.5:
        warnings.warn(
            f"{negative:.0%} of the pixels are negative (noise, which a larger --spp reduces, or "
            f"negative radiance) and {zero:.0%} are zero; the figure shows them in the colour of "
            "the floor",
            RuntimeWarning,
            stacklevel=2,
        )


def _render_title(specs: Sequence[Any], name: str, variant: str, samples: int) -> str:
    """Return a title: scene, frequencies, variant and number of samples per pixel."""
    texts = list(dict.fromkeys(frequency_text(spec.wavelength) for spec in specs))
    listed = ", ".join(texts[:3]) + (", ..." if len(texts) > 3 else "")
    return (
        f"{short_name(name)}, {listed}\n{variant}, {samples} sample{'s' * (samples > 1)} per pixel"
    )


_COLUMNS = 3  # largest number of panels in a row
_MOST_FREQUENCIES = 1 << 16


@dataclass(frozen=True, kw_only=True)
class ReceiveSettings(options.SceneOptions):
    """Options of ``receive``; None selects the setting of the scene."""

    spp: Annotated[
        int | None,
        typer.Option(min=1, help="Samples per emitter of scattered power (default: the scene's)."),
    ] = None
    reflections: Annotated[int, "Maximum number of specular reflections per path, 0 to 3."] = 2
    accuracy: Annotated[float, "Relative error of the fields on line-of-sight paths."] = 1e-6
    bandwidth: Annotated[Text, "Noise bandwidth: '1 GHz' (default: the receiver's)."] = None
    temperature: Annotated[Text, "Noise temperature: '290 K' (default: the receiver's)."] = None
    noise_figure: Annotated[Text, "Noise figure: '3 dB' (default: the receiver's or 0 dB)."] = None
    coherent: Annotated[bool, "Add direct paths as amplitudes (docs/channel.md)."] = False
    frequencies: Annotated[Text, "Channel at '76 GHz to 78 GHz, 201' or '76 GHz, 77 GHz'."] = None
    polarisation: Annotated[Text, "x (default), y, right, left, unpolarised or '45 deg'."] = None
    defined: Annotated[Texts, "NAME=VALUE of a $parameter of the scene (repeatable)."] = None


def receive(settings: ReceiveSettings, out: options.Out = None) -> None:
    """Compute the power at the receivers of a scene: direct, reflected and scattered.

    Prints a table. Writes a record of all results, NAME.json, and a figure of the directions of
    scattered power, NAME.png. With --range, also writes the power over half the path length,
    NAME_range.nc and NAME_range.png. With --frequencies, also writes the complex amplitudes of the
    paths, NAME_channel.nc and NAME_channel.png. With --scheduler, the workers of a cluster share
    the batches of samples, and the run is resumable.
    """
    defined = dict(parse_definition(text) for text in settings.defined or [])
    options.check_scene(settings.scene)
    noise = parse_noise(settings.bandwidth, settings.temperature, settings.noise_figure)
    edges = settings.edges(256)
    band = parse_band(settings.frequencies)
    suffixes = [".json", ".png"]
    suffixes += ("_range.nc", "_range.png") if edges is not None else ()
    suffixes += ("_channel.nc", "_channel.png") if band else ()
    files = options.files_to_write(out, Path(settings.scene).stem + "_received", suffixes)

    from polywigner.figures import draw_channel
    from polywigner.mitsuba import channel, choose_variant
    from polywigner.mitsuba.plugins.polariser import is_polarised
    from polywigner.mitsuba.receive.power_results import ReceiveOptions
    from polywigner.mitsuba.receive.received_power import arrival_map, shapes_in
    from polywigner.mitsuba.scenes import scene_renders
    from polywigner.mitsuba.scenes.surfaces import receivers_of
    from polywigner.propagation.stores import required

    if band:
        required("h5netcdf", "dask")
    start = time.perf_counter()
    jones = settings.polarisation
    variant = choose_variant(settings.variant, jones is not None and settings.variant is None)
    polarised = is_polarised(variant)
    by_scene, by_argument = (jones, None) if polarised else (None, jones)
    response = None
    with settings.running(variant, files[0]) as store:
        file = scene_renders.SceneFile(
            Path(settings.scene), variant, defined, settings.diffraction, by_scene
        )
        scene = file.load()
        receivers_of(scene)
        requested = ReceiveOptions(
            settings.spp, settings.seed, None, settings.reflections, settings.accuracy,
            coherent=settings.coherent, polarisation=by_argument, **noise,
        )  # fmt: skip
        received, profile = scene_renders.receive_parts(
            file, scene, requested, edges, store=store, scheduler=settings.scheduler,
            threads=settings.threads,
        )  # fmt: skip
        if band:
            response = channel(
                scene, band, settings.reflections, polarisation=by_argument,
                tolerance=settings.accuracy,
            )  # fmt: skip
        maps = [arrival_map(scene, number, settings.seed) for number in range(len(received))]
        names = [shapes_in(scene, number, power) for number, power in enumerate(maps)]
        titles = [
            f"{short_name(settings.scene)}, receiver {each.receiver}, "
            f"{frequency_text(each.wavelength)}"
            for each in received
        ]
        record = settings.record(variant) | {"receivers": [each.to_dict() for each in received]}
        record["settings"]["defined"] = defined
        record["seconds"] = round(time.perf_counter() - start, 3)
        floor, summary = settings.floor_db, "\n\n".join(map(str, received))
        contents: list[Any] = [record, _draw_receivers(received, maps, names, titles, floor)]
        if profile is not None:
            by_receiver = profile if "receiver" in profile.dims else profile.expand_dims("receiver")
            contents += [profile, _draw_range_profiles(profile, titles, floor)]
            summary += f"\n{_range_summary(by_receiver, received)}"
        if response is not None:
            title = f"{short_name(settings.scene)}, {len(band)} frequencies"
            figure = draw_channel(response, floor_db=floor, title=title)
            contents += [response, figure]
        options.write(files, contents, summary)


def parse_definition(text: str) -> tuple[str, str]:
    """Parse a name and a value from "NAME=VALUE"."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise ArgumentError(
            f"expected --define to be NAME=VALUE for a $parameter of the scene, got {text!r}"
        )
    return name, value


def parse_band(text: str | None) -> list[float]:
    """Return frequencies in Hz from "76 GHz to 78 GHz, 201" or "76 GHz, 77 GHz".

    The list is empty for None.
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
            "expected --frequencies to be two ascending frequencies and a number from 2 to "
            f"{_MOST_FREQUENCIES}, such as '76 GHz to 78 GHz, 201', got {text[:100]!r}"
        )
    return [low + (high - low) * k / (count - 1) for k in range(count)]


def _draw_receivers(
    received: Sequence[ReceivedPower],
    maps: Sequence[NDArray[np.float64]],
    names: Sequence[Any],
    titles: Sequence[str],
    floor_db: float,
) -> Figure:
    """Draw the power by direction of arrival, with one panel for each receiver.

    ``names``: for each receiver, the direction cosines (s_x, s_y) of each label.
    """
    from polywigner.figures.scene_plots import DirectArrival, draw_arrivals
    from polywigner.figures.style import new_figure
    from polywigner.mitsuba.receive.power_results import dbm_text

    columns = min(len(received), _COLUMNS)
    rows = -(-len(received) // columns)
    figure = new_figure(5.4 * columns, 4.7 * rows, spacing=0.05)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, each, power, shapes, title in zip(
        panels, received, maps, names, titles, strict=False
    ):
        marks = [
            DirectArrival(
                path.arrives_from, path.power, " by ".join([path.light or part.name, *path.mirrors])
            )
            for part in each.contributions
            for path in part.paths
        ]
        direct, scattered, total = map(dbm_text, (each.direct, each.scattered, each.power))
        text = f"received {total}: direct {direct}, scattered {scattered}".replace(" -", " −")
        draw_arrivals(power, marks, floor_db, f"{title}\n{text}", names=shapes, ax=axes)
    for axes in panels[len(received) :]:
        axes.set_visible(False)
    return figure


def _range_summary(profile: xarray.Dataset, received: Sequence[ReceivedPower]) -> str:
    """Return a line for each receiver: its strongest range bin, and the power outside the range."""
    from polywigner.mitsuba.receive.power_results import dbm_text

    edges = profile["range_edge"].values
    lines = []
    for number, each in enumerate(received):
        values = {name: profile[name].values[number] for name in profile.data_vars}
        k = int(values["power"].argmax())
        power, error = values["power"][k], values["standard_error"][k]
        lines.append(
            f"receiver {each.receiver}: maximum from {edges[k]:.6g} m to {edges[k + 1]:.6g} m, "
            f"{power:.4g} W +- {error:.4g} W ({dbm_text(power)}); nearer than all bins "
            f"{values['before']:.4g} W, farther {values['after']:.4g} W"
        )
    return "\n".join(lines)


def _draw_range_profiles(profile: xarray.Dataset, titles: Sequence[str], floor_db: float) -> Figure:
    """Draw the power over range, with one panel for each receiver."""
    from polywigner.figures import draw_range_profile
    from polywigner.figures.style import new_figure

    figure = new_figure(6.4, 3.4 * len(titles), spacing=0.05)
    panels = figure.subplots(len(titles), 1, squeeze=False).ravel()
    for number, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        draw_range_profile(profile, number, floor_db=floor_db, title=title, ax=axes)
    return figure
