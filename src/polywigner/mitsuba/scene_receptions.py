"""Receivers of scene files, batch by batch into a store, or by a cluster's workers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution import kernel_threads
from polywigner.mitsuba.received import ReceivedPower
from polywigner.mitsuba.received_power import received, receivers_of, scattered_here
from polywigner.mitsuba.receiving_arguments import Asked
from polywigner.mitsuba.scattered import BATCHES, Scattering, batches_of, lights_of
from polywigner.mitsuba.sent_scenes import SceneFile, SentScene
from polywigner.mitsuba.unseen import unseen
from polywigner.propagation.stores import write_dataset
from polywigner.propagation.stores_layout import Layout
from polywigner.transforms.labelled import LabelledArray

__all__ = ["receive_parts"]

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

    def scattered(plans: list[Scattering]) -> npt.NDArray[np.float64]:
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

    return received(scene, list(range(len(receivers_of(scene)))), asked, scattered)


class Batches:
    """The block function of a store of batches; loads the scene anew where it is sent to."""

    def __init__(self, file: SceneFile, scene: Any, plans: list[Scattering]) -> None:
        self.sent, self.plans = SentScene(file), plans
        self.lights = len(lights_of(scene))
        self.scene: Any = scene

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "scene": None}

    def __call__(self, origin: tuple[int, ...], shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
        if self.scene is None:
            self.scene = self.sent.load()
        receiver, batch, _ = origin
        with unseen(self.scene):
            return self.plans[receiver].batch(self.scene, batch)[None, None]

    def check(self) -> None:
        """Raises StoreError where this process has another Mitsuba, or other files."""
        self.sent.check()

    def layout(self) -> Layout:
        """(receiver, batch, light); a chunk is one batch of one receiver."""
        shape = {"receiver": len(self.plans), "batch": BATCHES, "light": self.lights}
        coords = {name: LabelledArray(np.arange(n), (name,)) for name, n in shape.items()}
        return Layout(_VARIABLE, "float64", coords, (1, 1, self.lights), {"units": "W"})

    def settings(self) -> dict[str, Any]:
        """All that the values depend on."""
        return {
            **self.sent.settings(),
            "integrator": self.plans[0].integrator,
            "spp": [batches_of(plan.spp) for plan in self.plans],
            "seed": self.plans[0].seed,
        }
