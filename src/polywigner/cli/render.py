"""``polywigner render``: a scene to signed radiance, a picture in dB, and a record of both."""

from __future__ import annotations

import math
import shutil
import time
import warnings
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from polywigner.cli import options, output, scene_options
from polywigner.cli.sources import check_wavelength, frequency_text, short_name
from polywigner.errors import ArgumentError, SceneError

if TYPE_CHECKING:
    import numpy.typing as npt


_Integrator = Literal["path", "direct", "volpath", "volpathmis", "prb", "prbvolpath"]
_Sampler = Literal["multijitter", "independent", "stratified", "orthogonal", "ldsampler"]
# By how much fewer samples a sampler needs than independent ones; on floors that are lit without
# obstacles it was 60, beside edges of shadows less (docs/sampling.md).
_GAINS = {"multijitter": 10}
_POLARISED = ("_stokes.npz", "_stokes.png", "_polarisation.png")
_STOKES_CHANNELS = 12
_RADIANCE_UNIT = "W m^-2 sr^-1"


@dataclass(frozen=True)
class RenderSettings:
    """Options of one run, as they are recorded; None: the scene's own."""

    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file with a <shape type='wigner'> in it.")
    ]
    spp: Annotated[
        int | None, typer.Option(min=1, max=2**30, help="Samples per pixel (default: the scene's).")
    ] = None
    error_db: Annotated[
        float | None,
        typer.Option(
            min=1e-3,
            help="In place of --spp: rms error in dB at 20 dB below the peak that is due to the "
            "source (docs/sampling.md).",
        ),
    ] = None
    variant: options.Variant = None
    integrator: Annotated[
        _Integrator | None, "path, direct, volpath, ... (default: the scene's)."
    ] = None
    sampler: Annotated[_Sampler | None, "multijitter, independent, ... (default: the scene's)."] = (
        None
    )
    diffraction: options.Diffraction = False
    polarised: Annotated[bool, "Pictures of the light's polarisation too (docs/polarised.md)."] = (
        False
    )
    seed: options.Seed = 0
    range_text: Annotated[
        str | None,
        typer.Option(
            "--range",
            help="A frame for each bin of range as well, such as '0 m to 30 m' (docs/range.md).",
        ),
    ] = None
    bins: Annotated[
        int | None,
        typer.Option(min=1, max=2**10, help="Number of bins of the range (default: 64)."),
    ] = None
    resumable: options.Resumable = False
    threads: options.Threads = None
    scheduler: options.Scheduler = None
    floor_db: options.DbFloor = -40.0


def render(settings: RenderSettings, out: options.Out = None) -> None:
    """Render a Mitsuba scene lit by a coherent aperture.

    Writes the signed radiance NAME.exr, a picture in dB NAME.png, and a record NAME.json; with
    --range the animated picture NAME_range.gif and its frames NAME_range.nc; with --polarised the
    Stokes numbers NAME_stokes.npz, their picture NAME_stokes.png, and degree and angle of
    polarisation NAME_polarisation.png. With --scheduler, the workers of a cluster share the parts
    of the picture, and the run is resumable.
    """
    scene_options.check_scene_file(settings.scene)
    if settings.spp is not None and settings.error_db is not None:
        raise ArgumentError("expected --spp or --error-db, got both; drop one of them")
    scene, seed = settings.scene, settings.seed
    stem = output.output_stem(out, Path(scene).stem)
    edges = scene_options.parse_ranges(settings.range_text, settings.bins, 64)
    by_range = () if edges is None else ("_range.nc", "_range.gif")
    polarised = _POLARISED if settings.polarised else ()
    files = output.targets(stem, (".exr", ".png", ".json", *polarised, *by_range))
    output.check_writable(files)

    import numpy as np

    from polywigner.execution import kernel_threads
    from polywigner.figures import (
        draw_arrivals,
        draw_polarisation,
        draw_scene,
        draw_stokes,
        picture_peak,
        write_range_animation,
    )
    from polywigner.mitsuba import choose_variant, stokes_of
    from polywigner.mitsuba.plugins.films import mean_of_colours, write_exr
    from polywigner.mitsuba.plugins.placement import placed_emitter
    from polywigner.mitsuba.plugins.polariser import is_polarised, polarisation_summary
    from polywigner.mitsuba.plugins.receiver import is_receiver
    from polywigner.mitsuba.radar.range_profile import prepared_frames
    from polywigner.mitsuba.receive.scattered import wigner_emitters
    from polywigner.mitsuba.scenes.rendering import default_spp
    from polywigner.mitsuba.scenes.scene_renders import SceneFile, render_parts

    frames = None
    store = scene_options.store_of_parts(stem, settings.resumable, settings.scheduler)
    start = time.perf_counter()
    chosen = choose_variant(settings.variant, settings.polarised)
    with scene_options.messages_as_warnings():
        if edges is not None:
            scene_options.prepare_ranges(chosen)
        file = SceneFile(Path(scene), chosen, settings.sampler, diffraction=settings.diffraction)
        loaded = file.load()
        specs = _checked_specs(loaded, scene)
        if settings.polarised and is_receiver(loaded.sensors()[0]):
            raise SceneError(
                f"expected a camera in {scene} with --polarised, got a wigner_receiver, which has "
                "a polarisation of its own"
            )
        samples = settings.spp or default_spp(loaded)
        if settings.error_db is not None:
            used = settings.sampler or _plugin(loaded.sensors()[0].sampler(), "Sampler")
            samples = _enough(specs, settings.error_db, used) or samples
        if edges is not None:  # what cannot be sorted by range is told before the picture
            by_range_of = prepared_frames(
                loaded, edges, spp=samples, seed=seed, sensor=0, integrator=settings.integrator
            )
        ready = time.perf_counter()
        integrator = settings.integrator
        image = render_parts(
            file,
            loaded,
            f"stokes {integrator or ''}" if settings.polarised else integrator,
            samples,
            seed,
            store=store,
            scheduler=settings.scheduler,
            threads=settings.threads,
        )
        if edges is not None:
            with kernel_threads(settings.threads):
                frames = by_range_of(None)
        done = time.perf_counter()

    if settings.polarised:
        stokes = stokes_of(image)
        image = image[..., :-_STOKES_CHANNELS]
    radiance = mean_of_colours(image)
    reference = picture_peak(radiance)
    record = _record(settings, loaded, radiance, reference)
    record["used"] |= {"variant": chosen, "spp": samples}
    if is_polarised(chosen):
        sources = [placed_emitter(e, k) for k, e in enumerate(wigner_emitters(loaded))]
        record["used"]["polarisation"] = polarisation_summary(sources, False)
    record["versions"] = scene_options.versions_of(chosen)
    record["seconds"] = {"load": round(ready - start, 3), "render": round(done - ready, 3)}
    _warn_of_darkness(radiance)
    title, floor = _title(specs, scene, chosen, samples), settings.floor_db
    if is_receiver(loaded.sensors()[0]):
        figure = draw_arrivals(radiance, (), floor, title)
    else:
        figure = draw_scene(radiance, reference, floor, title=title)
    contents = [partial(write_exr, image=image), figure, record]
    if settings.polarised:
        contents.append(partial(np.savez_compressed, stokes=stokes.astype(np.float32)))
        contents += [draw_stokes(stokes, title), draw_polarisation(stokes, floor, title)]
    if frames is not None:
        animated = partial(write_range_animation, frames, floor_db=floor, title=title)
        contents += [frames, animated]
    output.write(files, contents)
    if store is not None:
        shutil.rmtree(store, ignore_errors=True)


def _checked_specs(scene: Any, name: str) -> list[Any]:
    """Specifications of its Wigner emitters, whose wavelengths belong to their apertures."""
    specs = [emitter.spec for emitter in scene.emitters() if hasattr(emitter, "spec")]
    if not specs:
        raise SceneError(
            f'expected a <shape type="wigner"> in {name}, got a scene without; add one, or render '
            "it with mitsuba itself"
        )
    for spec in specs:
        check_wavelength(spec.wavelength, spec.region.support.diameter)
    return specs


def _enough(specs: list[Any], error_db: float, sampler: str) -> int:
    """Samples per pixel for an error at 20 dB below the peak, of the source that needs most.

    Zero for exact light, which has no error that samples lower.
    """
    import polywigner as pw

    independent = [
        pw.suggest_sampling(spec.source, spec.wavelength, "render", error_db=error_db).samples
        for spec in specs
        if spec.estimator != "exact"
    ]
    return math.ceil(max(independent, default=0) / _GAINS.get(sampler, 1))


def _warn_of_darkness(radiance: npt.NDArray[Any]) -> None:
    """A warning where the picture shows less than half of its pixels."""
    negative, zero = (radiance < 0).mean(), (radiance == 0).mean()
    if negative + zero > 0.5:
        warnings.warn(
            f"{negative + zero:.0%} of the pixels are not positive ({negative:.0%} negative, "
            f"{zero:.0%} zero) and have the colour of the floor; negative ones are noise, which "
            "more samples (--spp) remove, or negative radiance; no light comes from the others",
            RuntimeWarning,
            stacklevel=2,
        )


def _title(specs: list[Any], name: str, variant: str, samples: int) -> str:
    """Title of the picture: scene, frequency, variant and samples."""
    found = list(dict.fromkeys(frequency_text(spec.wavelength) for spec in specs))
    listed = ", ".join(found[:3]) + (", ..." if len(found) > 3 else "")
    return (
        f"{short_name(name)}, {listed}\n{variant}, {samples} sample{'s' * (samples > 1)} per pixel"
    )


def _record(
    settings: RenderSettings, scene: Any, radiance: npt.NDArray[Any], reference: float | None
) -> dict[str, Any]:
    """The content of NAME.json: the settings and figures of the picture."""
    import numpy as np

    from polywigner.figures.levels import PEAK_RULE
    from polywigner.mitsuba.plugins.receiver import is_receiver

    camera = scene.sensors()[0]
    height, width = radiance.shape
    return {
        "settings": asdict(settings),
        "used": {
            "integrator": settings.integrator or _integrator_of(scene),
            "sampler": settings.sampler or _plugin(camera.sampler(), "Sampler"),
            "size": [width, height],
        },
        "radiance": {
            "unit": "W" if is_receiver(camera) else _RADIANCE_UNIT,
            "largest": float(radiance.max()),
            "smallest": float(radiance.min()),
            "fraction_not_positive": float(np.mean(~(radiance > 0))),
        },
        "picture": {"zero_db": reference, "zero_db_rule": PEAK_RULE, "floor_db": settings.floor_db},
    }


def _integrator_of(scene: Any) -> str:
    from polywigner.mitsuba.scenes.rendering import default_integrator

    own = scene.integrator()
    return default_integrator(scene) if own is None else _plugin(own, "Integrator")


def _plugin(instance: Any, kind: str) -> str:
    """The name under which a scene asks for it: ``path`` for a ``PathIntegrator``."""
    name = str(instance.class_name()).removesuffix(kind).lower()
    return {"particletracer": "ptracer"}.get(name, name)
