"""The power that surfaces and fog scatter to a receiver, with its standard error.

Samples come in batches with seeds of their own, and the spread of the batches is the error. Paths
do not depend on the power of a source: with one seed, the render by one source and the other
lights, less the render by the other lights alone, is what that source gives, sample by sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.mitsuba.films import Exposure, check_is_whole, mean_of_colours, seed_of
from polywigner.mitsuba.placement import is_source
from polywigner.mitsuba.polarisation import Polariser
from polywigner.mitsuba.range_film import sorted_by_range, transient_integrator
from polywigner.mitsuba.receiver import receivers_of
from polywigner.mitsuba.rendering import check_spp, exposed
from polywigner.mitsuba.scene_order import sorted_emitters

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Of the size of a surface: its share of rays is the square, and those that meet it read zero.
_SHRUNK = 1e-3


def wigner_emitters(scene: Any) -> list[Any]:
    """Return the coherent sources of a scene, sorted by the ids of their shapes."""
    return list(filter(is_source, sorted_emitters(scene)))


@contextmanager
def unseen(scene: Any) -> Iterator[None]:
    """Within, coherent sources light the scene but rays that meet them read nothing."""
    sources = wigner_emitters(scene)
    specs = [source.spec for source in sources]
    null = mi.BSDFFlags.Null
    visible = [source.get_shape() for source in sources if source.spec.visible]
    shapes = [shape for shape in visible if mi.has_flag(shape.bsdf().flags(), null)]
    places = [_positions(shape) for shape in shapes]
    middles = [(place.min(axis=0) + place.max(axis=0)) / 2 for place in places]
    shrunk = [m + _SHRUNK * (place - m) for m, place in zip(middles, places, strict=True)]
    try:
        for source, spec in zip(sources, specs, strict=True):
            source.spec = replace(spec, visible=False)
        _move(scene, shapes, shrunk)
        yield
    finally:
        # while nothing is visible: a mesh elsewhere than its emitter would be refused
        _move(scene, shapes, places)
        for source, spec in zip(sources, specs, strict=True):
            source.spec = spec


@contextmanager
def polarised_by_default(scene: Any, polarisation: Complexes | None) -> Iterator[None]:
    """Within, ends without a polarisation have this Jones vector (2,), in polarised variants."""
    ends: list[Any] = []
    if polarisation is not None and mi.is_polarized:
        every = [*wigner_emitters(scene), *(sensor for _, sensor in receivers_of(scene))]
        ends = [end for end in every if not end.spec.states_polarisation]
    before = [(end, end.spec, end.polariser) for end in ends]
    try:
        for end in ends:
            end.spec = replace(end.spec, polarisation=polarisation)
            end.polariser = Polariser(mi, polarisation)
        yield
    finally:
        for end, spec, polariser in before:
            end.spec, end.polariser = spec, polariser


@contextmanager
def lit_by(sources: Sequence[Any], lit: Any) -> Iterator[None]:
    """Within, all of these sources but ``lit`` (None: all of them) have a power of zero."""
    dark = [source for source in sources if source is not lit]
    powers = [source.power for source in dark]
    try:
        for source in dark:
            source.power = type(source.power)(0.0)
            if dr.is_jit_v(source.power):
                dr.make_opaque(source.power)  # as a literal, it would compile the kernel again
        yield
    finally:
        for source, power in zip(dark, powers, strict=True):
            source.power = power


def _positions(shape: Any) -> Floats:
    positions = dr.detach(mi.traverse(shape)["vertex_positions"])
    return np.array(positions, np.float64).reshape(-1, 3)


def _move(scene: Any, shapes: list[Any], places: list[Floats]) -> None:
    for shape, place in zip(shapes, places, strict=True):
        params = mi.traverse(shape)
        params["vertex_positions"] = place.ravel().tolist()
        params.update()
    scene.parameters_changed([])  # rays are traced among surfaces where they are now


# Their spread tells the standard error to 18 %.
BATCHES = 16


def batches_of(spp: int) -> int:
    """Samples in each of 16 batches, for ``spp`` or a few more in all."""
    return -(-check_spp(spp) // BATCHES)


@dataclass(frozen=True)
class Scattering:
    """Sampling of the light scattered to one receiver, in a scene whose sources are unseen."""

    sensor: int
    integrator: Any
    spp: int
    """Samples of all batches, as asked."""
    seed: int

    edges: tuple[float, ...] | None = None
    """Edges of bins of range: lengths of paths in units of the scene; None: all in one number."""

    @property
    def values(self) -> tuple[int, ...]:
        """Shape of a batch's power of each light: (), or nearer than all bins, in each, farther."""
        return () if self.edges is None else (len(self.edges) + 1,)

    def batch(
        self, scene: Any, number: int, done: Callable[[], None] = lambda: None
    ) -> NDArray[np.float64]:
        """W (lights, values) that one batch finds of each of :func:`lights_of`."""
        own, samples = seed_of(self.seed, number), batches_of(self.spp)
        exposure = exposed(
            scene, self.integrator, samples, own, self.sensor, self.edges is None or number == 0
        )
        power: Callable[[], Any] = partial(_power, exposure)
        if self.edges is not None:
            integrator = transient_integrator(exposure.integrator, scene, exposure.camera)
            edges = np.array(self.edges)
            ranged = scene, exposure.camera, integrator, edges, samples, own
            power = lambda: sorted_by_range(*ranged).sum(axis=(0, 1))  # noqa: E731
        sources, found = wigner_emitters(scene), []
        for light in lights_of(scene):
            with lit_by(sources, light):
                found.append(power())
            done()
        return np.array(found)


def _power(exposure: Exposure) -> Any:
    image = exposure.picture(lambda: None)
    check_is_whole(exposure.integrator)
    return mean_of_colours(image).sum()


def lights_of(scene: Any) -> list[Any]:
    """Lights that shine in turns: None for all incoherent ones, then each coherent source."""
    sources = wigner_emitters(scene)
    return ([None] if len(sources) < len(scene.emitters()) else []) + sources


def shares_of(scene: Any, found: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """W of each coherent source (emitters, batches), and of other lights (batches,)."""
    if len(lights_of(scene)) == len(wigner_emitters(scene)):
        return np.moveaxis(found, 1, 0), np.zeros_like(found[:, 0])
    return np.moveaxis(found[:, 1:] - found[:, :1], 1, 0), found[:, 0]


def standard_error(batches: Floats, axis: int = 0) -> Any:
    """Standard error of the mean of equal batches."""
    return np.std(batches, ddof=1, axis=axis) / math.sqrt(batches.shape[axis])
