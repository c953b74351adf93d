"""``polywigner render``: a scene to signed radiance, a picture in dB, and a record of both."""

from __future__ import annotations

import json
import math
import os
import platform
import shlex
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polywigner.cli.output import check_text, check_writable, output_stem, targets, writing
from polywigner.cli.plausibility import check_wavelength
from polywigner.cli.sources import frequency_text, short_name
from polywigner.errors import ArgumentError, SceneError

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = ["run_render"]

_INTEGRATORS = ("path", "direct", "volpath", "volpathmis", "prb", "prbvolpath")
_SAMPLERS = ("multijitter", "independent", "stratified", "orthogonal", "ldsampler")
_NO_SCENES = (".csv", ".wkt", ".geojson", ".json", ".svg", ".dxf", ".gds", ".toml")
# By how much fewer samples a sampler needs than independent ones; on floors that are lit without
# obstacles it was 60, beside edges of shadows less (docs/sampling.md).
_GAINS = {"multijitter": 10}
_RADIANCE_UNIT = "W m^-2 sr^-1"


@dataclass(frozen=True)
class RenderSettings:
    """The options of one run, as they are recorded; None stands for what the scene says."""

    scene: str
    spp: int | None
    error_db: float | None
    variant: str | None
    integrator: str | None
    sampler: str | None
    seed: int
    floor_db: float


def run_render(
    scene: str,
    *,
    spp: int | None,
    error_db: float | None,
    variant: str | None,
    integrator: str | None,
    sampler: str | None,
    seed: int,
    floor_db: float,
    out: str | None,
) -> None:
    """Render a Mitsuba XML scene, write NAME.exr, NAME.png and NAME.json, print their paths.

    Raises
    ------
    PolywignerError : input that cannot be used; nothing is written then.
    """
    settings = RenderSettings(scene, spp, error_db, variant, integrator, sampler, seed, floor_db)
    _check(settings)
    files = targets(output_stem(out, Path(scene).stem), (".exr", ".png", ".json"))
    check_writable(files)
    _check_is_no_aperture(scene)

    from polywigner.figures import draw_scene, picture_peak
    from polywigner.figures.levels import check_floor
    from polywigner.mitsuba import choose_variant, load_scene, render
    from polywigner.mitsuba.images import write_exr
    from polywigner.mitsuba.logs import to_list
    from polywigner.mitsuba.rendering import check_spp, default_spp

    check_floor(floor_db)
    if spp is not None:
        check_spp(spp)
    start = time.perf_counter()
    chosen = choose_variant(variant)
    with to_list() as messages:
        loaded = load_scene(scene, chosen, sampler)
        _check_scene(loaded, scene)
        samples = spp or default_spp(loaded)
        if error_db is not None:
            used = sampler or _plugin(loaded.sensors()[0].sampler(), "Sampler")
            samples = check_spp(_enough(loaded, error_db, used))
        ready = time.perf_counter()
        with _progress_bar() as progress:
            image = render(loaded, integrator, samples, seed, progress=progress)
        done = time.perf_counter()
    for message in messages:
        warnings.warn(f"Mitsuba: {message}", RuntimeWarning, stacklevel=2)

    radiance = _radiance(image)
    reference = picture_peak(radiance)
    record = _record(settings, loaded, radiance, reference)
    record["used"] |= {"variant": chosen, "spp": samples}
    record["versions"] = _versions(chosen)
    record["seconds"] = {"load": round(ready - start, 3), "render": round(done - ready, 3)}
    _warn_of_darkness(radiance)
    title = _title(loaded, scene, chosen, samples)
    figure = draw_scene(radiance, reference, floor_db, title=title)
    with writing(files) as (exr, png, text):
        write_exr(exr, image)
        figure.savefig(png, format="png")
        text.write_text(json.dumps(record, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    for path in files:
        print(path)


def _check(settings: RenderSettings) -> None:
    """All that can be known to be wrong before Mitsuba takes its second to load."""
    check_text("the scene file", settings.scene)
    if not os.path.isfile(settings.scene):  # noqa: PTH113 (pathlib raises for a name too long)
        raise SceneError(
            f"expected a Mitsuba scene file, got {settings.scene!r}, which is not a file"
        )
    if settings.spp is not None and settings.spp < 1:
        raise ArgumentError(f"expected --spp of at least 1, got {settings.spp}")
    if settings.spp is not None and settings.error_db is not None:
        raise ArgumentError("expected --spp or --error-db, got both; drop one of them")
    if settings.error_db is not None and not 0 < settings.error_db < math.inf:
        raise ArgumentError(f"expected --error-db above zero, got {settings.error_db:g}")
    if settings.seed < 0:
        raise ArgumentError(f"expected --seed of zero or more, got {settings.seed}")
    _check_name("--integrator", settings.integrator, _INTEGRATORS)
    _check_name("--sampler", settings.sampler, _SAMPLERS)


def _check_is_no_aperture(scene: str) -> None:
    suffix = Path(scene).suffix.lower()
    if suffix in _NO_SCENES:
        kind = "a source file" if suffix == ".toml" else "an aperture"
        raise SceneError(
            f"expected a scene, which is Mitsuba XML, got {scene!r}, which is {kind}; "
            f"see its transforms by `polywigner transform {shlex.quote(scene)}`, or name it in "
            'the <shape type="wigner"> of a scene'
        )


def _check_scene(scene: Any, name: str) -> None:
    """That a Wigner emitter lights it, with a wavelength that belongs to its aperture."""
    specs = [emitter.spec for emitter in scene.emitters() if hasattr(emitter, "spec")]
    if not specs:
        raise SceneError(
            f'expected a <shape type="wigner"> in {name}, got a scene without; add one, or render '
            "it with mitsuba itself"
        )
    for spec in specs:
        check_wavelength(spec.wavelength, spec.radiator.support.diameter)


def _enough(scene: Any, error_db: float, sampler: str) -> int:
    """Samples per pixel for an error at 20 dB below the peak, of the source that needs most.

    Exact light has no error that samples lower: the scene's own number then.
    """
    import polywigner as pw
    from polywigner.mitsuba.rendering import default_spp

    specs = [emitter.spec for emitter in scene.emitters() if hasattr(emitter, "spec")]
    noisy = [spec for spec in specs if spec.estimator != "exact"]
    if not noisy:
        return int(default_spp(scene))
    independent = max(
        pw.suggest_sampling(
            spec.radiator.source, spec.wavelength, "render", error_db=error_db
        ).samples
        for spec in noisy
    )
    return math.ceil(independent / _GAINS.get(sampler, 1))


def _check_name(option: str, name: str | None, known: tuple[str, ...]) -> None:
    if name is not None and name not in known:
        raise ArgumentError(f"expected {option} to be one of {', '.join(known)}, got {name!r}")


@contextmanager
def _progress_bar() -> Iterator[Callable[[int, int], None]]:
    """A function to call after each part: moves a bar on a terminal, does nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("rendering"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _radiance(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(height, width) from a film of one channel, or of colours (their mean) and others."""
    import numpy as np

    colours = 3 if image.shape[-1] >= 3 else 1
    return np.asarray(image[..., :colours].mean(axis=-1, dtype=np.float64))


def _warn_of_darkness(radiance: npt.NDArray[Any]) -> None:
    """A warning where the picture shows less than half of its pixels."""
    negative, zero = float((radiance < 0).mean()), float((radiance == 0).mean())
    if negative + zero > 0.5:
        warnings.warn(
            f"{negative + zero:.0%} of the pixels are not positive ({negative:.0%} negative, "
            f"{zero:.0%} zero) and have the colour of the floor; negative ones are noise, which "
            "more samples (--spp) take away, or radiance that is negative; zero is where no light "
            "comes from",
            RuntimeWarning,
            stacklevel=2,
        )


def _title(scene: Any, name: str, variant: str, samples: int) -> str:
    """What the picture is of, and how it was made."""
    specs = [emitter.spec for emitter in scene.emitters() if hasattr(emitter, "spec")]
    found = list(dict.fromkeys(frequency_text(spec.wavelength) for spec in specs))
    listed = ", ".join(found[:3]) + (", ..." if len(found) > 3 else "")
    return (
        f"{short_name(name)}, {listed}\n{variant}, {samples} sample{'s' * (samples > 1)} per pixel"
    )


def _record(
    settings: RenderSettings,
    scene: Any,
    radiance: npt.NDArray[Any],
    reference: float | None,
) -> dict[str, Any]:
    """The content of NAME.json: the settings and figures of the picture."""
    import numpy as np

    from polywigner.figures.levels import PEAK_RULE

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
            "unit": _RADIANCE_UNIT,
            "largest": float(radiance.max()),
            "smallest": float(radiance.min()),
            "fraction_not_positive": float(np.mean(~(radiance > 0))),
        },
        "picture": {
            "zero_db": reference,
            "zero_db_rule": PEAK_RULE,
            "floor_db": settings.floor_db,
        },
    }


def _integrator_of(scene: Any) -> str:
    from polywigner.mitsuba.rendering import default_integrator

    own = scene.integrator()
    return default_integrator(scene) if own is None else _plugin(own, "Integrator")


def _plugin(instance: Any, kind: str) -> str:
    """The name under which a scene asks for it: ``path`` for a ``PathIntegrator``."""
    name = str(instance.class_name()).removesuffix(kind).lower()
    return {"particletracer": "ptracer"}.get(name, name)


def _versions(variant: str) -> dict[str, str | None]:
    from importlib.metadata import version

    from polywigner.toolchain.llvm import prepare

    packages = ("polywigner", "mitsuba", "drjit", "numpy")
    found: dict[str, str | None] = {name: version(name) for name in packages}
    found["llvm"] = prepare().version if variant.startswith("llvm_") else None
    found["python"] = platform.python_version()
    found["machine"] = f"{platform.system()} {platform.machine()}"
    return found
