"""``polywigner render``: the signed radiance of a scene, a figure in dB, and a record."""

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
from polywigner.cli.sources import check_wavelength, frequency_text, short_name
from polywigner.errors import SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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

    Writes the signed radiance NAME.exr, a figure in dB NAME.png, and a record NAME.json; with
    --range the image of each bin NAME_range.nc;
    with --polarised the Stokes parameters NAME_stokes.npz, their figure NAME_stokes.png, and degree
    and angle of polarisation NAME_polarisation.png. With --scheduler, the workers of a cluster
    share the parts of the image, and the run is resumable.
    """
    settings.check_file()
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
    from polywigner.mitsuba.plugins.placement import placed_emitter
    from polywigner.mitsuba.radar.range_profile import prepared_frames
    from polywigner.mitsuba.scenes.rendering import default_integrator, default_spp
    from polywigner.mitsuba.scenes.scene_renders import SceneFile, render_parts
    from polywigner.mitsuba.scenes.surfaces import is_receiver, wigner_emitters

    start = time.perf_counter()
    variant = choose_variant(settings.variant, settings.polarised)
    integrator, floor, frames = settings.integrator, settings.floor_db, None
    with settings.running(variant, files[0]) as store:
        file = SceneFile(Path(settings.scene), variant, diffraction=settings.diffraction)
        scene = file.load()
        specs = _checked_specs(scene, settings.scene)
        samples = settings.spp or default_spp(scene)
        receives = is_receiver(scene.sensors()[0])
        if settings.polarised and receives:
            raise SceneError(
                f"expected a camera in {settings.scene} with --polarised, got a wigner_receiver, "
                "which defines its polarisation itself"
            )
        if edges is not None:  # a scene that cannot be sorted by range fails before the rendering
            render_frames = prepared_frames(
                scene, edges, spp=samples, seed=settings.seed, sensor=0, integrator=integrator
            )
        ready = time.perf_counter()
        measured = f"stokes {integrator or ''}" if settings.polarised else integrator
        exposure = {"integrator": measured, "spp": samples, "seed": settings.seed}
        image = render_parts(file, scene, exposure, store, **settings.cluster)
        if edges is not None:
            with kernel_threads(settings.threads):
                frames = render_frames(None)
        done = time.perf_counter()

        title = _title(specs, settings.scene, variant, samples)
        stokes = stokes_of(image) if settings.polarised else None
        radiance = films.mean_of_colours(
            image if stokes is None else image[..., :-_STOKES_CHANNELS]
        )
        reference = figures.image_peak(radiance)
        record, own = settings.record(variant), scene.integrator()
        record["used"] |= {
            "integrator": integrator or (own.class_name() if own else default_integrator(scene)),
            "size": [radiance.shape[1], radiance.shape[0]],
            "spp": samples,
        }
        if polariser.is_polarised(variant):
            sources = [placed_emitter(e, k) for k, e in enumerate(wigner_emitters(scene))]
            record["used"]["polarisation"] = polariser.polarisation_summary(sources, False)
        record["figure"] = {
            "unit": "W" if receives else "W m^-2 sr^-1",
            "zero_db": reference,
            "zero_db_rule": PEAK_RULE,
            "floor_db": floor,
        }
        record["seconds"] = {"load": round(ready - start, 3), "render": round(done - ready, 3)}
        _warn_of_darkness(radiance)
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


def _checked_specs(scene: Any, name: str) -> list[Any]:
    """Return the specifications of the Wigner emitters, after a check of their wavelengths."""
    specs = [emitter.spec for emitter in scene.emitters() if hasattr(emitter, "spec")]
    if not specs:
        raise SceneError(
            f'expected a <shape type="wigner"> in {name}, got a scene without; add one, or render '
            "it with mitsuba itself"
        )
    for spec in specs:
        check_wavelength(spec.wavelength, spec.support.diameter)
    return specs


def _warn_of_darkness(radiance: NDArray[np.float64]) -> None:
    """Warn if the figure shows less than half of the pixels."""
    negative, zero = (radiance < 0).mean(), (radiance == 0).mean()
    if negative + zero > 0.5:
        warnings.warn(
            f"{negative:.0%} of the pixels are negative (noise, which a larger --spp reduces, or "
            f"negative radiance) and {zero:.0%} zero; they have the colour of the floor",
            RuntimeWarning,
            stacklevel=2,
        )


def _title(specs: Sequence[Any], name: str, variant: str, samples: int) -> str:
    """Return the title of the figure: scene, frequencies, variant and samples."""
    texts = list(dict.fromkeys(frequency_text(spec.wavelength) for spec in specs))
    listed = ", ".join(texts[:3]) + (", ..." if len(texts) > 3 else "")
    return (
        f"{short_name(name)}, {listed}\n{variant}, {samples} sample{'s' * (samples > 1)} per pixel"
    )
