"""Receivers of scene files, batch by batch into a store, or by a cluster's workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution import kernel_threads
from polywigner.mitsuba.range_profile import Ranging, checked_ranges, profile_of, ranged
from polywigner.mitsuba.received import ReceivedPower
from polywigner.mitsuba.received_power import matched, received, receivers_of, scattered_here
from polywigner.mitsuba.receiving_arguments import Asked
from polywigner.mitsuba.scattered import BATCHES, Scattering, batches_of, lights_of
from polywigner.mitsuba.sent_scenes import SceneFile, SentScene
from polywigner.mitsuba.unseen import unseen
from polywigner.propagation.stores import write_dataset
from polywigner.propagation.stores_files import Layout
from polywigner.transforms.xarray_arguments import Labelled, LabelledArray

__all__ = ["receive_parts", "receive_ranges"]

_VARIABLE = "power"


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
        return np.asarray(found[_VARIABLE].values)


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
        return Layout(_VARIABLE, "float64", coords, (1, 1, *counts), {"units": "W"})

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
