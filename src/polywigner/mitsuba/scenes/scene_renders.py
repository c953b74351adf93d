"""Images and received powers of scene files, computed locally or on clusters."""

from __future__ import annotations

import importlib.metadata
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError
from polywigner.execution import MOST_THREADS, kernel_threads
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import checked_count, checked_path, checked_type
from polywigner.mitsuba.plugins.films import Tiling
from polywigner.mitsuba.plugins.registration import (
    is_key,
    one_at_a_time,
    register_source,
    registered_source,
)
from polywigner.mitsuba.radar.range_profile import checked_ranges, received_by_range
from polywigner.mitsuba.receive.power_results import ReceivedPower, ReceiveOptions
from polywigner.mitsuba.receive.received_power import received, scattered_here
from polywigner.mitsuba.receive.scattered import BATCHES, Scattering, aimed, batch_spp, lights_of
from polywigner.mitsuba.scenes.rendering import (
    check_is_complete,
    exposed,
    hide_emitters,
    with_delta_lights,
)
from polywigner.mitsuba.scenes.scenes import SceneFile, choose_variant, digests_of
from polywigner.mitsuba.scenes.surfaces import receivers_of
from polywigner.propagation.stores import Index, Scheduler, results_on_grid
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray


Compute = Callable[[Any, Index], npt.NDArray[np.float64]]
"""Function from a scene and the index of its first sample to a part of a result."""


class SceneParts:
    """Function that computes parts of a result in this process or in workers."""

    def __init__(self, file: SceneFile, scene: Any, compute: Compute) -> None:
        self.file = replace(file, path=file.path and file.path.absolute())
        self.scene, self.compute = scene, compute
        texts = [value for value in file.parameters.values() if isinstance(value, str)]
        self.sources = [registered_source(text) for text in texts if is_key(text)]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for other processes, which load the scene again."""
        return {**self.__dict__, "scene": None}

    def __call__(self, origin: Index, shape: Index) -> npt.NDArray[np.float64]:
        """Return the part of the result that starts at the index ``origin``.

        ``shape`` is not used.
        """
        if self.scene is None:
            choose_variant(self.file.variant)
            # Keys of sources in memory are valid in one process only.
            for source in self.sources:
                register_source(source)
            self.scene = self.file.load()
        return self.compute(self.scene, origin)

    def written(
        self,
        store: str | Path,
        variable: tuple[str, str],
        sizes: Mapping[str, int],
        chunks: Index,
        settings: Mapping[str, Any],
        **keeping: Any,
    ) -> npt.NDArray[np.float64]:
        """Compute the parts that are missing in a store, and return all values.

        ``variable`` contains the name and the unit, ``sizes`` the lengths of the axes, ``chunks``
        the lengths of a part, and ``settings`` attributes that identify the result. ``keeping``
        contains ``scheduler``, ``threads`` and ``progress``.
        """
        name, units = variable
        attrs = {**vars(self.file), **settings}
        path = attrs.pop("path")
        digests = digests_of(path, self.file.parameters).items()
        attrs["files"] = {os.path.relpath(file, path.parent.resolve()): d for file, d in digests}
        attrs["mitsuba_version"] = importlib.metadata.version("mitsuba")
        axes = {axis: labelled_array(np.arange(n), (axis,)) for axis, n in sizes.items()}
        variables = {name: (self, "float64", {"units": units})}
        keeping |= {"out": store, "chunks": chunks}
        with results_on_grid(variables, axes, {}, attrs, keeping) as stored:
            return np.asarray(stored[name].values)


@one_at_a_time
def render_file(
    path: str | Path,
    integrator: str | None = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    *,
    variant: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    store: str | Path | None = None,
    scheduler: Scheduler = None,
    threads: int | None = None,
    progress: bool | None = None,
) -> npt.NDArray[np.float32]:
    """Load a scene file with :func:`load_scene`, and render it as :func:`render` does.

    Parameters
    ----------
    path : path
        Mitsuba XML file. Workers of a scheduler must be able to access the file, and the files that
        it names, at the same paths.
    integrator, spp, seed, sensor : optional
        As in :func:`render`.
    variant, parameters : optional
        As in :func:`load_scene`.
    store : path, optional
        Folder of a zarr store to which finished parts of the image are written. After an
        interruption, the same call completes the store. The store remains when the image is
        complete. Requires the extra ``datasets``.
    scheduler : str or cluster, default this machine
        Address of a dask.distributed scheduler whose workers can access the store, or a cluster
        object such as ``LocalCluster``.
    threads : int, optional
        Number of threads on this machine, or of each worker. The default is one thread for each
        core, or the number of threads of the worker.
    progress : bool, optional
        Whether to show a progress bar. By default it is shown on a terminal.

    Returns
    -------
    ndarray, shape (height, width, channels)
        Image as in :func:`render`, except for rounding errors of sums in single precision.

    Raises
    ------
    ArgumentError
        If ``scheduler`` is specified without ``store``.
    StoreError
        If the path cannot be written to, or contains parts of another image.
    EngineError
        If the scheduler does not respond.
    MissingExtraError
        If the extra ``datasets`` is not installed.
    PolywignerError
        As in :func:`load_scene` and :func:`render`.
    """
    if scheduler is not None and store is None:
        raise ArgumentError(
            "scheduler= requires a store for the computed parts; pass its path as store="
        )
    if threads is not None:
        checked_count(threads, "threads", 1, MOST_THREADS)
    expected = "parameters to be a mapping from names to values"
    checked_type(parameters, expected, Mapping, NoneType)
    chosen = choose_variant(mi.variant() if variant is None else variant)
    file = SceneFile(checked_path(path), chosen, dict(parameters or {}))
    options = {"integrator": integrator, "spp": spp, "seed": seed, "sensor": sensor}
    keeping: dict[str, Any] = {"scheduler": scheduler, "threads": threads, "progress": progress}
    return render_parts(file, file.load(), options, store, **keeping)


def render_parts(
    file: SceneFile,
    scene: Any,
    options: Mapping[str, Any],
    store: str | Path | None = None,
    **keeping: Any,
) -> npt.NDArray[np.float32]:
    """Render a scene that was loaded from a file.

    ``options`` are arguments of :func:`render`, and ``keeping`` contains ``scheduler``, ``threads``
    and ``progress``.
    """
    exposure = exposed(scene, **options)
    cut = exposure.cut
    if store is None:
        bar = progress_bar("rendering", cut.steps, show=keeping.get("progress"))
        with kernel_threads(keeping.get("threads")), bar as advance:
            return with_delta_lights(exposure, exposure.full_image(advance))
    settings = {**options, "spp": cut.samples, "seed": exposure.seed}
    parts = SceneParts(file, scene, partial(strip, cut, settings))
    sizes = {"row": cut.height, "column": cut.width, "channel": exposure.channels()}
    chunks = cut.rows, cut.width, sizes["channel"]
    settings = settings | {"passes": cut.passes}
    image = parts.written(store, ("radiance", "W m-2 sr-1"), sizes, chunks, settings, **keeping)
    return with_delta_lights(exposure, image.astype(np.float32))


def strip(
    cut: Tiling, options: Mapping[str, Any], scene: Any, origin: Index
) -> npt.NDArray[np.float64]:
    """Render the strip (rows, width, channels) that starts at the row ``origin[0]`` of an image."""
    # The first process has already issued the warnings.
    exposure = exposed(scene, **options, warn=False)
    image = replace(exposure, cut=cut).image(origin[0] // cut.rows)
    check_is_complete(exposure.integrator)
    return image


def receive_parts(
    file: SceneFile,
    scene: Any,
    options: ReceiveOptions,
    edges: npt.NDArray[np.float64] | None = None,
    **keeping: Any,
) -> tuple[list[ReceivedPower], xarray.Dataset | None]:
    """Compute :func:`received_powers` of a scene that was loaded from a file.

    If ``edges`` of range bins in m are specified, the second result is the :func:`range_profile` of
    the same samples. Otherwise, the second result is None. ``keeping`` contains ``store``,
    ``scheduler``, ``threads`` and ``progress``.
    """
    numbers = list(range(len(receivers_of(scene))))
    sample = partial(_sampled, file, scene, **keeping)
    if edges is None:
        return received(scene, numbers, options, sample).powers, None
    return received_by_range(scene, numbers, options, checked_ranges(edges), sample)


def _sampled(
    file: SceneFile,
    scene: Any,
    plans: Sequence[Scattering],
    store: str | Path | None = None,
    **keeping: Any,
) -> npt.NDArray[np.float64]:
    """Return scattered powers in W, shape (receivers, batches, lights, ...)."""
    if store is None:
        with kernel_threads(keeping.get("threads")):
            return scattered_here(scene, None, plans)
    first = plans[0]
    counts = (len(lights_of(scene)), *first.values)
    shape = (len(plans), BATCHES, *counts)
    sizes = dict(zip(("receiver", "batch", "light", "path"), shape, strict=False))
    settings = {"integrator": first.integrator, "seed": first.seed}
    settings |= {"spp": [batch_spp(plan.spp) for plan in plans]}
    if first.edges is not None:
        settings["ranges"] = list(first.edges)
    parts = SceneParts(file, scene, partial(_batch, plans))
    return parts.written(store, ("power", "W"), sizes, (1, 1, *counts), settings, **keeping)


def _batch(plans: Sequence[Scattering], scene: Any, origin: Index) -> npt.NDArray[np.float64]:
    """Render the batch with the index ``origin`` (receiver, batch, ...).

    The result has the shape (1, 1, lights, ...).
    """
    receiver, batch, *_ = origin
    with hide_emitters(scene), aimed(scene):
        return plans[receiver].batch(scene, batch)[None, None]
