"""``polywigner render``: a scene to signed radiance, a picture in dB, and a record of both."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from polywigner.cli import options, scene_options
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


@dataclass(frozen=True, kw_only=True)
class RenderSettings(scene_options.SceneOptions):
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
    integrator: Annotated[
        _Integrator | None, "path, direct, volpath, ... (default: the scene's)."
    ] = None
    sampler: Annotated[_Sampler | None, "multijitter, independent, ... (default: the scene's)."] = (
        None
    )
    polarised: Annotated[bool, "Pictures of the light's polarisation too (docs/polarisation.md)."] = (
        False
    )
    bins: Annotated[
        int | None,
        typer.Option(min=1, max=2**10, help="Number of bins of the range (default: 64)."),
    ] = None


def render(settings: RenderSettings, out: options.Out = None) -> None:
    """Render a Mitsuba scene lit by a coherent aperture.

    Writes the signed radiance NAME.exr, a picture in dB NAME.png, and a record NAME.json; with
    --range the animated picture NAME_range.gif, a frame for each bin, and its frames NAME_range.nc;
    with --polarised the Stokes numbers NAME_stokes.npz, their picture NAME_stokes.png, and degree
    and angle of polarisation NAME_polarisation.png. With --scheduler, the workers of a cluster
    share the parts of the picture, and the run is resumable.
    """
    scene, seed = settings.scene, settings.seed
    scene_options.check_scene_file(scene)
    if settings.spp is not None and settings.error_db is not None:
        raise ArgumentError("expected --spp or --error-db, got both; drop one of them")
    stem = options.output_stem(out, Path(scene).stem)
    edges = settings.edges(settings.bins, 64)
    by_range = () if edges is None else ("_range.nc", "_range.gif")
    polarised = _POLARISED if settings.polarised else ()
    files = options.targets(stem, (".exr", ".png", ".json", *polarised, *by_range))
    options.check_writable(files)

    import numpy as np

    from polywigner import figures
    from polywigner.execution import kernel_threads
    from polywigner.mitsuba import choose_variant, stokes_of
    from polywigner.mitsuba.plugins import films, polariser
    from polywigner.mitsuba.plugins.placement import placed_emitter
    from polywigner.mitsuba.radar.range_profile import prepared_frames
    from polywigner.mitsuba.scenes.rendering import default_spp
    from polywigner.mitsuba.scenes.scene_renders import SceneFile, render_parts
    from polywigner.mitsuba.scenes.surfaces import is_receiver, wigner_emitters

    start = time.perf_counter()
    chosen = choose_variant(settings.variant, settings.polarised)
    integrator, frames = settings.integrator, None
    with settings.parts(stem) as store:
        with scene_options.messages_as_warnings():
            if edges is not None:
                scene_options.prepare_ranges(chosen)
            path = Path(scene)
            file = SceneFile(path, chosen, settings.sampler, diffraction=settings.diffraction)
            loaded = file.load()
            specs = _checked_specs(loaded, scene)
            if settings.polarised and is_receiver(loaded.sensors()[0]):
                raise SceneError(
                    f"expected a camera in {scene} with --polarised, got a wigner_receiver, which "
                    "has a polarisation of its own"
                )
            samples = settings.spp or default_spp(loaded)
            if settings.error_db is not None:
                used = settings.sampler or _plugin(loaded.sensors()[0].sampler(), "Sampler")
                samples = _enough(specs, settings.error_db, used) or samples
            if edges is not None:  # a scene that cannot be sorted by range fails before the picture
                by_range_of = prepared_frames(
                    loaded, edges, spp=samples, seed=seed, sensor=0, integrator=integrator
                )
            ready = time.perf_counter()
            measured = f"stokes {integrator or ''}" if settings.polarised else integrator
            how: dict[str, Any] = {"scheduler": settings.scheduler, "threads": settings.threads}
            exposure = {"integrator": measured, "spp": samples, "seed": seed}
            image = render_parts(file, loaded, exposure, store, **how)
            if edges is not None:
                with kernel_threads(settings.threads):
                    frames = by_range_of(None)
            done = time.perf_counter()

        receives = is_receiver(loaded.sensors()[0])
        title, floor = _title(specs, scene, chosen, samples), settings.floor_db
        stokes = stokes_of(image) if settings.polarised else None
        radiance = films.mean_of_colours(
            image if stokes is None else image[..., :-_STOKES_CHANNELS]
        )
        reference = figures.picture_peak(radiance)
        record = settings.record(chosen)
        record["used"] |= _used(settings, loaded, radiance.shape) | {"spp": samples}
        if polariser.is_polarised(chosen):
            sources = [placed_emitter(e, k) for k, e in enumerate(wigner_emitters(loaded))]
            record["used"]["polarisation"] = polariser.polarisation_summary(sources, False)
        record |= _measured(radiance, "W" if receives else _RADIANCE_UNIT, reference, floor)
        record["seconds"] = {"load": round(ready - start, 3), "render": round(done - ready, 3)}
        _warn_of_darkness(radiance)
        if receives:
            figure = figures.draw_arrivals(radiance, (), floor, title)
        else:
            figure = figures.draw_scene(radiance, reference, floor, title=title)
        contents = [partial(films.write_exr, image=image), figure, record]
        if stokes is not None:
            contents.append(partial(np.savez_compressed, stokes=stokes.astype(np.float32)))
            contents.append(figures.draw_stokes(stokes, title))
            contents.append(figures.draw_polarisation(stokes, floor, title))
        if frames is not None:
            write = partial(figures.write_range_animation, frames, floor_db=floor, title=title)
            contents += [frames, write]
        options.write(files, contents)


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


def _used(settings: RenderSettings, scene: Any, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return what the scene chose, for NAME.json."""
    return {
        "integrator": settings.integrator or _integrator_of(scene),
        "sampler": settings.sampler or _plugin(scene.sensors()[0].sampler(), "Sampler"),
        "size": [shape[1], shape[0]],
    }


def _measured(
    radiance: npt.NDArray[Any], unit: str, reference: float | None, floor_db: float
) -> dict[str, Any]:
    """Return the numbers of the picture, for NAME.json."""
    from polywigner.figures.levels import PEAK_RULE

    return {
        "radiance": {
            "unit": unit,
            "largest": float(radiance.max()),
            "smallest": float(radiance.min()),
            "fraction_not_positive": float((~(radiance > 0)).mean()),
        },
        "picture": {"zero_db": reference, "zero_db_rule": PEAK_RULE, "floor_db": floor_db},
    }


def _integrator_of(scene: Any) -> str:
    from polywigner.mitsuba.scenes.rendering import default_integrator

    own = scene.integrator()
    return default_integrator(scene) if own is None else _plugin(own, "Integrator")


def _plugin(instance: Any, kind: str) -> str:
    """The name under which a scene asks for it: ``path`` for a ``PathIntegrator``."""
    name = str(instance.class_name()).removesuffix(kind).lower()
    return {"particletracer": "ptracer"}.get(name, name)
