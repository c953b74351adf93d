"""Scene files rendered in this process, part by part into a store, or by a cluster's workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError
from polywigner.execution import MOST_THREADS, kernel_threads
from polywigner.geometry.arguments import checked_count
from polywigner.mitsuba.parts import Exposure
from polywigner.mitsuba.range_profile import Ranging, checked_ranges, profile_of, ranged
from polywigner.mitsuba.received import Asked, ReceivedPower
from polywigner.mitsuba.received_power import matched, received, receivers_of, scattered_here
from polywigner.mitsuba.rendering import exposed
from polywigner.mitsuba.scattered import BATCHES, Scattering, batches_of, lights_of, unseen
from polywigner.mitsuba.scenes import choose_variant
from polywigner.mitsuba.sent_scenes import SceneFile, SentScene, check_is_whole
from polywigner.propagation.stores import require_stores, write_dataset
from polywigner.propagation.stores_checks import Layout
from polywigner.radiometry.progress import progress_bar
from polywigner.transforms.xarray_arguments import Labelled, LabelledArray

__all__ = ["Parts", "receive_parts", "receive_ranges", "render_file", "render_parts"]

_VARIABLE = "radiance"


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
    """The image of a scene file: what :func:`load_scene` and :func:`render` make of it.

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
    file = SceneFile(Path(path), choose_variant(variant or mi.variant()), sampler, parameters or {})
    return render_parts(
        file,
        file.load(),
        integrator,
        spp,
        seed,
        sensor,
        store=store,
        scheduler=scheduler,
        threads=threads,
        progress=progress,
    )


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
    if store is None:
        bar = progress_bar("rendering", exposure.cut.steps, show=progress)
        with kernel_threads(threads), bar as advance:
            return exposure.picture(advance)
    parts = Parts(file, integrator, sensor, exposure)
    found = write_dataset(
        store,
        parts.layout(),
        parts,
        parts.settings(),
        scheduler=scheduler,
        threads=threads,
        progress=progress,
    )
    with found:  # set by set, as `Exposure.picture` adds them up
        sets = (found[_VARIABLE][number].values for number in range(exposure.cut.sets))
        return reduce(np.add, sets).astype(np.float32)


class Parts:
    """The block function of a store of parts; loads the scene anew where it is sent to."""

    def __init__(
        self,
        file: SceneFile,
        integrator: str | None,
        sensor: int,
        exposure: Exposure,
    ) -> None:
        self.sent = SentScene(file)
        self.integrator, self.sensor = integrator, sensor
        self.cut, self.seed = exposure.cut, exposure.seed
        self.exposure: Exposure | None = exposure

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "exposure": None}

    def __call__(self, origin: tuple[int, ...], shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
        if self.exposure is None:
            self.exposure = self._loaded()
        image = self.exposure.image(origin[1] // self.cut.rows, origin[0])
        check_is_whole(self.exposure.integrator)
        return image[None]

    def _loaded(self) -> Exposure:
        """On a worker: what the caller has as well, which has told of the integrator's limits."""
        scene = self.sent.load()
        made = exposed(scene, self.integrator, self.cut.samples, self.seed, self.sensor, warn=False)
        return replace(made, cut=self.cut)

    def check(self) -> None:
        """Raises StoreError where this process has another Mitsuba, or other files."""
        self.sent.check()

    def layout(self) -> Layout:
        """(set of passes, row, column, channel); a chunk is a part of the picture."""
        assert self.exposure is not None
        cut, channels = self.cut, self.exposure.channels()
        shape = {"pass": cut.sets, "row": cut.height, "column": cut.width, "channel": channels}
        coords = {name: LabelledArray(np.arange(n), (name,)) for name, n in shape.items()}
        chunks = (1, cut.rows, cut.width, channels)
        return Layout(_VARIABLE, "float64", coords, chunks, {"units": "W m-2 sr-1"})

    def settings(self) -> dict[str, Any]:
        """All that the values depend on."""
        return {
            **self.sent.settings(),
            "integrator": self.integrator,
            "spp": self.cut.samples,
            "passes": self.cut.passes,
            "seed": self.seed,
            "sensor": self.sensor,
        }


_POWER = "power"


def receive_parts(
    file: SceneFile,
    scene: Any,
    asked: Asked,
    *,
    store: str | Path | None = None,
    scheduler: str | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[ReceivedPower]:
    """:func:`received_powers` of a scene that was loaded from a file.

    ``store``, ``scheduler`` and ``threads`` as of :func:`render_file`: a part is a batch of one
    receiver. ``progress`` is told without a store, which has a bar of its own.
    """

    sample = partial(_sampled, file, scene, store, scheduler, threads, progress)
    return received(scene, list(range(len(receivers_of(scene)))), asked, sample)


def receive_ranges(
    file: SceneFile,
    scene: Any,
    asked: Asked,
    edges: npt.NDArray[np.float64],
    *,
    store: str | Path | None = None,
    scheduler: str | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[ReceivedPower], Labelled]:
    """:func:`receive_parts`, and the same samples by range as of :func:`range_profile`.

    ``edges``: of bins, in m.
    """
    edges = checked_ranges(edges)
    numbers = list(range(len(receivers_of(scene))))
    parties = matched(scene, numbers, asked)
    kept: list[Any] = []

    def scattered(plans: list[Scattering]) -> npt.NDArray[np.float64]:
        by_range = ranged(plans, parties, edges)
        found = _sampled(file, scene, store, scheduler, threads, progress, by_range)
        kept.extend((plans[0], found))
        return np.asarray(found.sum(axis=-1))

    powers = received(scene, numbers, asked, scattered)
    return powers, profile_of(scene, parties, edges, *kept)


def _sampled(
    file: SceneFile,
    scene: Any,
    store: str | Path | None,
    scheduler: str | None,
    threads: int | None,
    progress: Callable[[int, int], None] | None,
    plans: Sequence[Scattering],
) -> npt.NDArray[np.float64]:
    """W (receivers, batches, lights, ...) that batches find, here or by a store."""
    if store is None:
        with kernel_threads(threads):
            return scattered_here(scene, progress, plans)
    batches = Batches(file, scene, plans)
    found = write_dataset(
        store,
        batches.layout(),
        batches,
        batches.settings(),
        scheduler=scheduler,
        threads=threads,
    )
    with found:
        return np.asarray(found[_POWER].values)


class Batches:
    """The block function of a store of batches; loads the scene anew where it is sent to."""

    def __init__(self, file: SceneFile, scene: Any, plans: Sequence[Scattering]) -> None:
        self.sent, self.plans = SentScene(file), plans
        self.lights = len(lights_of(scene))
        self.scene: Any = scene

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "scene": None}

    def __call__(self, origin: tuple[int, ...], shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
        if self.scene is None:
            self.scene = self.sent.load()
        receiver, batch, *_ = origin
        with unseen(self.scene):
            return self.plans[receiver].batch(self.scene, batch)[None, None]

    def check(self) -> None:
        """Raises StoreError where this process has another Mitsuba, or other files."""
        self.sent.check()

    def layout(self) -> Layout:
        """(receiver, batch, light), and path; a chunk is one batch of one receiver."""
        counts = (self.lights, *self.plans[0].values)
        axes = ("receiver", "batch", "light", "path")
        shape = dict(zip(axes, (len(self.plans), BATCHES, *counts), strict=False))
        coords = {name: LabelledArray(np.arange(n), (name,)) for name, n in shape.items()}
        return Layout(_POWER, "float64", coords, (1, 1, *counts), {"units": "W"})

    def settings(self) -> dict[str, Any]:
        """All that the values depend on."""
        first = self.plans[0]
        return {
            **self.sent.settings(),
            "integrator": self.plans[0].integrator,
            "spp": [batches_of(plan.spp) for plan in self.plans],
            "seed": first.seed,
            **({"ranges": list(first.edges)} if isinstance(first, Ranging) else {}),
        }
