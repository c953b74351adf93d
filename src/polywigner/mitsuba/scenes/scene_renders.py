"""Scene files rendered in this process, part by part into a store, or by a cluster's workers."""

from __future__ import annotations

import importlib.metadata
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError
from polywigner.execution import MOST_THREADS, kernel_threads
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import checked_count, checked_path
from polywigner.mitsuba.plugins.films import Tiling, check_is_whole
from polywigner.mitsuba.plugins.parameters import is_key, register_source, registered_source
from polywigner.mitsuba.plugins.receiver import receivers_of
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.radar.range_profile import checked_ranges, received_by_range
from polywigner.mitsuba.receive.received import ReceivedPower, ReceiveOptions
from polywigner.mitsuba.receive.received_power import received, scattered_here
from polywigner.mitsuba.receive.scattered import (
    BATCHES,
    Scattering,
    aimed,
    batches_of,
    lights_of,
    unseen,
)
from polywigner.mitsuba.scenes.rendering import exposed, with_delta_lights
from polywigner.mitsuba.scenes.scene_files import digests_of
from polywigner.mitsuba.scenes.scenes import choose_variant, load_file
from polywigner.propagation.stores import (
    Index,
    Scheduler,
    digest_of,
    lazy_array,
    require_stores,
    source_text,
    write_store,
)
from polywigner.transforms.xarray_arguments import labelled_arrays

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class SceneFile:
    """A scene file, and how it is loaded, here or by a worker."""

    path: Path
    variant: str
    sampler: str | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    diffraction: bool = False
    polarisation: str | None = None
    """Polarisation of ends for which the file specifies none; None: the default."""

    def load(self) -> Any:
        """Load the ``mi.Scene``; raises as :func:`load_scene` does."""
        return load_file(
            self.path,
            self.variant,
            self.sampler,
            False,
            self.diffraction,
            self.parameters,
            self.polarisation,
        )


Compute = Callable[[Any, Index], npt.NDArray[np.float64]]
"""(scene, first sample of a part) -> the values of the part."""


class SceneParts:
    """Parts of the results of a scene. Another process, to which they are sent, loads the scene."""

    def __init__(self, file: SceneFile, scene: Any, compute: Compute) -> None:
        self.file = replace(file, path=file.path.absolute(), parameters=dict(file.parameters))
        self.scene, self.compute = scene, compute
        texts = [value for value in file.parameters.values() if isinstance(value, str)]
        self.sources = [registered_source(text) for text in texts if is_key(text)]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "scene": None}

    def __call__(self, origin: Index, shape: Index) -> npt.NDArray[np.float64]:
        if self.scene is None:
            choose_variant(self.file.variant)
            for source in self.sources:  # in the memory of the process that sent the parts
                register_source(source)
            self.scene = self.file.load()
        return self.compute(self.scene, origin)

    def settings(self) -> dict[str, Any]:
        """Return the settings of the scene, with digests of its files and sources."""
        from polywigner import __version__

        settings = dict(vars(self.file))
        path, parameters = settings.pop("path"), settings.pop("parameters")
        digests, folder = digests_of(path, parameters), path.resolve().parent
        files = {f"file {os.path.relpath(file, folder)}": d for file, d in digests.items()}
        sources = {f"source {k}": digest_of(source_text(s)) for k, s in enumerate(self.sources)}
        return {
            "polywigner_version": __version__,
            "mitsuba_version": importlib.metadata.version("mitsuba"),
            "parameters": {name: str(value) for name, value in parameters.items()},
            **settings,
            **files,
            **sources,
        }

    def written(
        self,
        store: str | Path,
        variable: tuple[str, str],
        sizes: Mapping[str, int],
        chunks: Index,
        settings: Mapping[str, Any],
        scheduler: Scheduler,
        threads: int | None,
        progress: bool | None = None,
    ) -> Any:
        """Write all parts to a store as a variable of a name and unit, and return its dataset."""
        name, units = variable
        values = lazy_array(self, tuple(sizes.values()), chunks, "float64", threads=threads)
        parts = labelled_arrays(
            {name: (tuple(sizes), values, {"units": units})}, {}, {**self.settings(), **settings}
        )
        return write_store(store, parts, scheduler=scheduler, threads=threads, progress=progress)


@one_at_a_time
def render_file(
    path: str | Path,
    integrator: str | None = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    *,
    variant: str | None = None,
    sampler: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    store: str | Path | None = None,
    scheduler: Scheduler = None,
    threads: int | None = None,
    progress: bool | None = None,
) -> npt.NDArray[np.float32]:
    """Render a scene file by :func:`load_scene` and :func:`render`.

    Parameters
    ----------
    path: Mitsuba XML; with a scheduler, its workers see it, and the files it names, at this path.
    integrator: name of a plugin; default: as of :func:`render`.
    spp, seed, sensor: as of :func:`render`.
    variant, sampler, parameters: as of :func:`load_scene`.
    store: folder of a zarr store to which finished parts of the image are written. The same call
        completes a store that an interrupted run has left. The store stays when the image is
        complete. Needs the extra ``datasets``.
    scheduler: address of a dask.distributed scheduler whose workers render the parts and see the
        store, or a cluster object such as ``LocalCluster``; None: this machine.
    threads: number of threads, on this machine or of each worker; None: all cores, or the worker's
        threads.
    progress: whether to draw a bar; None: on a terminal.

    The image equals the result of :func:`render`, up to the rounding of single-precision sums.

    Raises
    ------
    What :func:`load_scene` and :func:`render` do; ArgumentError for a scheduler without a store;
    StoreError for a path that cannot be written to, or holds parts of another image; EngineError
    for a scheduler that does not respond; MissingExtraError without the extra ``datasets``.
    """
    if scheduler is not None and store is None:
        raise ArgumentError("expected a store with a scheduler, got none; name one for the parts")
    if store is not None:
        require_stores(scheduler)
    given = parameters if parameters is not None else {}
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise ArgumentError(f"expected parameters as values by their names, got {parameters!r}")
    chosen = choose_variant(mi.variant() if variant is None else variant)
    file = SceneFile(checked_path(path), chosen, sampler, given)
    keeping: dict[str, Any] = {"store": store, "scheduler": scheduler}
    keeping |= {"threads": threads, "progress": progress}
    return render_parts(file, file.load(), integrator, spp, seed, sensor, **keeping)


def render_parts(
    file: SceneFile,
    scene: Any,
    integrator: str | None = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    *,
    store: str | Path | None = None,
    scheduler: Scheduler = None,
    threads: int | None = None,
    progress: bool | None = None,
) -> npt.NDArray[np.float32]:
    """The image of the scene that was loaded from a file; see :func:`render_file`."""
    if threads is not None:
        threads = checked_count(threads, "threads", 1, MOST_THREADS)
    exposure = exposed(scene, integrator, spp, seed, sensor)
    cut = exposure.cut
    if store is None:
        bar = progress_bar("rendering", cut.steps, show=progress)
        with kernel_threads(threads), bar as advance:
            return with_delta_lights(exposure, exposure.picture(advance))
    channels = exposure.channels()
    parts = SceneParts(file, scene, partial(tile, cut, integrator, exposure.seed, sensor))
    image = parts.written(
        store,
        ("radiance", "W m-2 sr-1"),
        {"pass": cut.sets, "row": cut.height, "column": cut.width, "channel": channels},
        (1, cut.rows, cut.width, channels),
        {
            "integrator": integrator,
            "spp": cut.samples,
            "passes": cut.passes,
            "seed": exposure.seed,
            "sensor": sensor,
        },
        scheduler,
        threads,
        progress,
    )
    with image:  # one set after the other, as `Exposure.picture` adds them
        sets = (image["radiance"][number].values for number in range(cut.sets))
        return with_delta_lights(exposure, reduce(np.add, sets).astype(np.float32))


def tile(
    cut: Tiling, integrator: str | None, seed: int, sensor: int, scene: Any, origin: Index
) -> npt.NDArray[np.float64]:
    """Render a strip of an image with one set of its passes: (1, row, column, channel)."""
    # the caller has warned of the integrator's limits
    exposure = exposed(scene, integrator, cut.samples, seed, sensor, warn=False)
    image = replace(exposure, cut=cut).image(origin[1] // cut.rows, origin[0])
    check_is_whole(exposure.integrator)
    return image[None]


def receive_parts(
    file: SceneFile, scene: Any, options: ReceiveOptions, **keeping: Any
) -> list[ReceivedPower]:
    """:func:`received_powers` of a scene that was loaded from a file."""
    numbers = list(range(len(receivers_of(scene))))
    return received(scene, numbers, options, partial(_sampled, file, scene, **keeping))


def receive_ranges(
    file: SceneFile,
    scene: Any,
    options: ReceiveOptions,
    edges: npt.NDArray[np.float64],
    **keeping: Any,
) -> tuple[list[ReceivedPower], xarray.Dataset]:
    """:func:`receive_parts`, and the same samples by range as of :func:`range_profile`."""
    numbers = list(range(len(receivers_of(scene))))
    sample = partial(_sampled, file, scene, **keeping)
    return received_by_range(scene, numbers, options, checked_ranges(edges), sample)


def _sampled(
    file: SceneFile,
    scene: Any,
    plans: Sequence[Scattering],
    *,
    store: str | Path | None = None,
    scheduler: Scheduler = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> npt.NDArray[np.float64]:
    """Return W (receivers, batches, lights, ...) of the batches, sampled here or into a store."""
    if store is None:
        with kernel_threads(threads):
            return scattered_here(scene, progress, plans)
    first = plans[0]
    counts = (len(lights_of(scene)), *first.values)
    shape = (len(plans), BATCHES, *counts)
    settings = {
        "integrator": first.integrator,
        "spp": [batches_of(plan.spp) for plan in plans],
        "seed": first.seed,
        **({} if first.edges is None else {"ranges": list(first.edges)}),
    }
    sizes = dict(zip(("receiver", "batch", "light", "path"), shape, strict=False))
    parts = SceneParts(file, scene, partial(_batch, plans))
    chunks = (1, 1, *counts)
    power = parts.written(store, ("power", "W"), sizes, chunks, settings, scheduler, threads)
    with power:
        return np.asarray(power["power"].values)


def _batch(plans: Sequence[Scattering], scene: Any, origin: Index) -> npt.NDArray[np.float64]:
    """Sample one batch of one receiver: W (1, 1, lights, ...)."""
    receiver, batch, *_ = origin
    with unseen(scene), aimed(scene):
        return plans[receiver].batch(scene, batch)[None, None]
