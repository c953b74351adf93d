"""Scene files rendered in this process, part by part into a store, or by a cluster's workers."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError, StoreError
from polywigner.execution import MOST_THREADS, kernel_threads
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import (
    checked_count,
    checked_path,
)
from polywigner.mitsuba.films import Tiling, check_is_whole
from polywigner.mitsuba.parameters import is_key, register_source, registered_source
from polywigner.mitsuba.plugins import one_at_a_time
from polywigner.mitsuba.range_profile import checked_ranges, received_by_range
from polywigner.mitsuba.received import ReceivedPower, ReceiveOptions
from polywigner.mitsuba.received_power import received, scattered_here
from polywigner.mitsuba.receiver import receivers_of
from polywigner.mitsuba.rendering import exposed, with_delta_lights
from polywigner.mitsuba.scattered import BATCHES, Scattering, batches_of, lights_of, unseen
from polywigner.mitsuba.scene_files import digest_of_file, digests_of
from polywigner.mitsuba.scenes import choose_variant, load_file
from polywigner.mitsuba.targets import aimed
from polywigner.propagation.stores import one_run, write_dataset
from polywigner.propagation.stores_checks import (
    Index,
    Layout,
    require_stores,
    source_settings,
    with_digest,
)
from polywigner.transforms.xarray_arguments import labelled_array

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
"""(scene, first sample of a chunk) -> the values of the chunk."""


class SceneJob:
    """The block function of a store of renders; loads the scene anew where it is sent to."""

    def __init__(self, file: SceneFile, scene: Any, compute: Compute) -> None:
        self.file = replace(file, path=file.path.absolute(), parameters=dict(file.parameters))
        self.scene, self.compute = scene, compute
        self.mitsuba = importlib.metadata.version("mitsuba")
        try:
            self.digests = digests_of(file.path, file.parameters)
        except OSError as error:
            raise SceneError(f"expected to read the files of {file.path}, got: {error}") from error
        texts = [value for value in file.parameters.values() if isinstance(value, str)]
        self.sources = [registered_source(text) for text in texts if is_key(text)]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "scene": None}

    def __call__(self, origin: Index, shape: Index) -> npt.NDArray[np.float64]:
        if self.scene is None:
            choose_variant(self.file.variant)
            for source in self.sources:  # of the memory of the process that sent the job
                register_source(source)
            self.scene = self.file.load()
        return self.compute(self.scene, origin)

    def check(self) -> None:
        """Raises StoreError where this process has another Mitsuba, or other files."""
        where, version = platform.node(), importlib.metadata.version("mitsuba")
        if version != self.mitsuba:
            raise StoreError(
                f"expected mitsuba {self.mitsuba} on every worker, got {version} on {where}; "
                "install the same everywhere"
            )
        for path, digest in self.digests.items():
            found = digest_of_file(Path(path)) if Path(path).is_file() else None
            if found != digest:
                raise StoreError(
                    f"expected every worker to see the scene's file {path}, got "
                    f"{'none' if found is None else 'another one'} on {where}; share the folder"
                )

    def write(
        self,
        store: str | Path,
        variable: tuple[str, str],
        shape: Mapping[str, int],
        chunks: Index,
        settings: Mapping[str, Any],
        **how: Any,
    ) -> Any:
        """Fill a store with a variable of a name and unit; ``how`` as of ``write_dataset``."""
        coords = {name: labelled_array(np.arange(n), (name,)) for name, n in shape.items()}
        name, units = variable
        folder = self.file.path.resolve().parent
        files = {os.path.relpath(path, folder): digest for path, digest in self.digests.items()}
        sources = [with_digest(source_settings(source)) for source in self.sources]
        of_scene = {
            "mitsuba": self.mitsuba,
            "variant": self.file.variant,
            "sampler": self.file.sampler,
            **({"diffraction": True} if self.file.diffraction else {}),
            **({"polarisation": p} if (p := self.file.polarisation) else {}),
            "parameters": {name: str(value) for name, value in self.file.parameters.items()},
            **{f"file {name}": digest for name, digest in files.items()},
            **{f"source {k}": source["source_sha256"] for k, source in enumerate(sources)},
        }
        parts = Layout(name, "float64", coords, chunks, {"units": units})
        return write_dataset(store, parts, self, {**of_scene, **settings}, **how)


def remove_store(path: str | Path) -> None:
    """Remove a store of parts whose result is done, unless another run goes on with it."""
    folder = Path(path)
    aside = folder.with_name(f"{folder.name}.partial")  # the next run sweeps what is left of it
    with suppress(StoreError, OSError), one_run(folder):
        folder.rename(aside)
        shutil.rmtree(aside, ignore_errors=True)


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
    scheduler: str | None = None,
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
    store: folder that keeps the parts of the picture that are done, a zarr store. A run that ended
        before its time is taken up by calling again: only what is missing or damaged is rendered.
        It stays when the picture is done. Needs the extra ``volume``.
    scheduler: address of a dask.distributed scheduler whose workers render the parts, with a store
        that all of them see; None renders on this machine.
    threads: on this machine, or of each worker; None: all cores, or what each worker has.
    progress: whether to draw a bar; None: on a terminal.

    Where and in how many runs the parts are rendered makes no difference to the picture: it is that
    of :func:`render`, bit by bit with one thread a process, else but for the last digits
    (docs/plugin.md).

    Raises
    ------
    What :func:`load_scene` and :func:`render` do; ArgumentError for a scheduler without a store;
    StoreError for a place that cannot be written to or has another picture's parts, and for workers
    that have other files or versions; EngineError for a scheduler that does not answer;
    MissingExtraError without the extra ``volume`` where there is a store.
    """
    if scheduler is not None and store is None:
        raise ArgumentError("expected a store with a scheduler, got none; say where to keep parts")
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
    scheduler: str | None = None,
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
    job = SceneJob(file, scene, partial(tile, cut, integrator, exposure.seed, sensor))
    found = job.write(
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
        scheduler=scheduler,
        threads=threads,
        progress=progress,
    )
    with found:  # set by set, as `Exposure.picture` adds them up
        sets = (found["radiance"][number].values for number in range(cut.sets))
        return with_delta_lights(exposure, reduce(np.add, sets).astype(np.float32))


def tile(
    cut: Tiling, integrator: str | None, seed: int, sensor: int, scene: Any, origin: Index
) -> npt.NDArray[np.float64]:
    """One strip of a picture by one set of its passes: (1, row, column, channel)."""
    # the caller has told of the integrator's limits
    made = exposed(scene, integrator, cut.samples, seed, sensor, warn=False)
    image = replace(made, cut=cut).image(origin[1] // cut.rows, origin[0])
    check_is_whole(made.integrator)
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
    scheduler: str | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> npt.NDArray[np.float64]:
    """W (receivers, batches, lights, ...) that batches find, here or by a store."""
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
    found = SceneJob(file, scene, partial(_batch, plans)).write(
        store,
        ("power", "W"),
        dict(zip(("receiver", "batch", "light", "path"), shape, strict=False)),
        (1, 1, *counts),
        settings,
        scheduler=scheduler,
        threads=threads,
    )
    with found:
        return np.asarray(found["power"].values)


def _batch(plans: Sequence[Scattering], scene: Any, origin: Index) -> npt.NDArray[np.float64]:
    """W (1, 1, lights, ...) that one batch of one receiver finds."""
    receiver, batch, *_ = origin
    with unseen(scene), aimed(scene):
        return plans[receiver].batch(scene, batch)[None, None]
