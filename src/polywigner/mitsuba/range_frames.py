"""What a camera sees by range: one frame for each bin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError
from polywigner.mitsuba.parts import seed_of
from polywigner.mitsuba.range_film import check_sums, sorted_by_range
from polywigner.mitsuba.range_profile import checked_ranges, range_axes
from polywigner.mitsuba.receiver import is_receiver
from polywigner.mitsuba.rendering import check_seed, check_spp, default_spp, exposed
from polywigner.mitsuba.transients import require_transients, transient_integrator
from polywigner.mitsuba.unseen import wigner_emitters
from polywigner.transforms.xarray_arguments import Labelled, LabelledArray, LabelledArrays, labelled

__all__ = ["prepared_frames", "range_frames"]

Progress = Callable[[int, int], None]

# Renders of which the mean is taken, so that progress can be told.
_PARTS = 4


def range_frames(
    scene: Any,
    ranges: npt.ArrayLike,
    *,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    integrator: Any = None,
    progress: Progress | None = None,
) -> Labelled:
    """What a camera sees by range: the radiance of a render, shared out to bins.

    Range is half the length of the way from a place on a source to the camera, as in
    :func:`range_profile`; a camera's near clip counts. Here sources are seen, as in
    :func:`polywigner.mitsuba.render`. Pixels have a box filter. docs/range.md.

    Parameters
    ----------
    scene : a ``mi.Scene`` of a compiled variant; its camera brings size, crop and sampler.
    ranges : (n + 1,) rising edges of n bins, in m, zero or more.
    spp : samples per pixel; default: the sampler's own.
    seed : of the random numbers, zero or more.
    sensor : index of the scene's camera.
    integrator : as of :func:`range_profile`.
    progress : called after each of 4 parts with the number of those done, and of all.

    Returns
    -------
    xarray.Dataset if xarray can be imported, else a LabelledArrays as of
    :func:`polywigner.projections`, with
    ``radiance`` (range, row, column), ``before`` and ``after`` (row, column) in W m^-2 sr^-1, of
    nearer and of farther than all bins. All of them add up to the picture, its luminance where it
    has colours. Coordinates ``range`` and ``range_edge`` in m.

    Raises
    ------
    As :func:`range_profile`, and ArgumentError for a receiver, or more than 2^28 numbers.
    """
    how = {"spp": spp, "seed": seed, "sensor": sensor, "integrator": integrator}
    return prepared_frames(scene, ranges, **how)(progress)


def prepared_frames(
    scene: Any, ranges: npt.ArrayLike, *, spp: int | None, seed: int, sensor: int, integrator: Any
) -> Callable[[Progress | None], Labelled]:
    """What renders the frames of :func:`range_frames`, whose arguments have been checked."""
    edges = checked_ranges(ranges)
    require_transients()
    entropy = check_seed(seed)
    exposure = exposed(scene, integrator, 1, 0, sensor)
    camera = exposure.camera
    if is_receiver(camera):
        raise ArgumentError(
            f"expected a camera, got sensor {sensor}, which is a receiver; use range_profile"
        )
    total = check_spp(default_spp(scene, sensor) if spp is None else spp)
    own = transient_integrator(exposure.integrator, scene, camera)
    units = {emitter.spec.scene_unit for emitter in wigner_emitters(scene)} or {1.0}
    if len(units) > 1:
        raise ArgumentError(f"expected one scene_unit of all sources, got {sorted(units)} m")
    lengths = 2.0 * edges / units.pop()
    check_sums(camera.film().crop_size(), edges)
    parts = min(_PARTS, total)

    def rendered(progress: Progress | None) -> Labelled:
        found: Any = 0.0
        for part in range(parts):
            samples = total // parts + (part < total % parts)
            image = sorted_by_range(scene, camera, own, lengths, samples, seed_of(entropy, part))
            found = found + samples / total * image
            if progress is not None:
                progress(part + 1, parts)
        return labelled(_described(np.asarray(found), edges, total, entropy))

    return rendered


def _described(
    found: npt.NDArray[np.float64], edges: npt.NDArray[np.float64], spp: int, seed: int
) -> LabelledArrays:
    from polywigner import __version__

    picture = ("row", "column")
    frames = np.ascontiguousarray(np.moveaxis(found[..., 1:-1], -1, 0))
    values = {
        "radiance": (frames, ("range", *picture), "radiance of a bin"),
        "before": (found[..., 0].copy(), picture, "radiance from nearer than all bins"),
        "after": (found[..., -1].copy(), picture, "radiance from farther than all bins"),
    }
    return LabelledArrays(
        {
            name: LabelledArray(array, dims, {"units": "W m-2 sr-1", "long_name": meaning})
            for name, (array, dims, meaning) in values.items()
        },
        range_axes(edges),
        {"samples": spp, "seed": seed, "polywigner_version": __version__},
    )
