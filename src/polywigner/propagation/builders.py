"""Fields along lines, on planes and hemispheres, and in volumes, as labelled arrays."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack

from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.execution.choice import resolved
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import takes_frequency
from polywigner.propagation.datasets import (
    FieldBlock,
    FieldOptions,
    checked_settings,
    dataset,
    described,
)
from polywigner.propagation.grids import (
    box_grid,
    hemisphere_grid,
    line_grid,
    plane_grid,
    shape_of_grid,
)
from polywigner.propagation.stores import write_dataset
from polywigner.propagation.stores_checks import (
    Layout,
    check_memory,
    chunks_within,
    source_attrs,
    source_settings,
)
from polywigner.radiometry.directions import PlaneSource, checked_radiator

if TYPE_CHECKING:
    import xarray


# Samples of a stored chunk: at most 4 MB of float32, a file that disks and clusters like. Smaller
# volumes have some dozens of chunks, so that a run saves its parts within seconds or a minute.
_CHUNK, _LEAST_CHUNK, _CHUNKS = 1 << 20, 1 << 15, 64
Chunks: TypeAlias = int | str | Sequence[int | str | Sequence[int] | None] | Mapping[int, Any]
"""Sizes of chunks as dask takes them."""

# Sums over edges and rays make many samples of one point: worth a compiler even for small chunks.
_COMPILED = 1 << 16


@takes_frequency
def line(
    source: PlaneSource | Wavefront,
    ends: ArrayLike,
    samples: int,
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """A field along a line, both ends included, over its ``distance`` from the first end.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, as are errors.
    ends : two points (2, 3) in m, z > 0.
    samples : how many points.

    Returns
    -------
    As of :func:`plane`, with the dimension ``distance``, and x, y and z along it.

    >>> import polywigner as pw
    >>> square, ends = pw.shapes.square(10e-3), [(0, 0, 0.05), (0, 0, 0.2)]
    >>> found = pw.line(square, ends, 5, 3.2e-3, method="kirchhoff")
    >>> found.kirchhoff.shape
    (5,)
    """
    settings = checked_settings(wavelength, options)
    return dataset(source, line_grid(ends, samples), settings, options.get("progress"))


@takes_frequency
def plane(
    source: PlaneSource | Wavefront,
    where: ArrayLike,
    shape: tuple[int, int],
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """A field on a rectangle of any size, place and resolution (docs/volumes.md).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, with any fields; or one with a
        curved wave.
    where : ((x0, y0, z0), (x1, y1, z1)) in m, of which one pair is equal; or three corners (3, 3)
        of a rectangle in any direction, the first between the other two. z > 0.
    shape : how many points along its two axes, edges included.
    wavelength : in m.
    method : "wigner" (default), or one of "rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2",
        "kirchhoff", "fresnel" and "fraunhofer", or several of these side by side.
    quantity : "irradiance" (default), |U|^2 in W/m^2 for |u|^2 in W/m^2; "amplitude", complex, or
        its "phase" in rad, which "wigner" does not have.
    obliquity : of "wigner" and "fraunhofer", as :func:`irradiance` takes it.
    tolerance : as :func:`irradiance` and :func:`amplitude` take it; None: their own.
    obstacles : bodies and plates in the way, as :func:`amplitude` takes them, whose shadows
        diffract (docs/shadows.md); with an exact method, of light of one wavelength.
    dtype : "float64" (default) or "float32" to store values as (amplitudes as complex numbers).
    precision, engine : see :func:`fourier`.
    progress : whether to draw a bar; None: on a terminal.

    Returns
    -------
    xarray.Dataset with a variable for each method, named after it, over x, y or z; of three corners
    over u and v, the distances from the first to the others. Units, settings, the source and the
    version are in the attributes.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine; MissingExtraError
    without xarray, which the extra ``volume`` brings.

    >>> import polywigner as pw
    >>> square, where = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.1), (0.02, 0.02, 0.1)]
    >>> found = pw.plane(square, where, (5, 4), 3.2e-3, method="kirchhoff")
    >>> sorted(found.kirchhoff.shape)
    [4, 5]
    """
    settings = checked_settings(wavelength, options)
    return dataset(source, plane_grid(where, shape), settings, options.get("progress"))


@takes_frequency
def hemisphere(
    source: PlaneSource | Wavefront,
    radius: float,
    theta: ArrayLike,
    phi: ArrayLike,
    wavelength: float,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """A field at one distance from a point, over angles: on a hemisphere, or along a cut.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, as are errors.
    radius : distance from ``centre`` in m.
    theta : (n,) angles from the z axis in rad; negative ones, for cuts, lie at the opposite phi.
    phi : (m,) angles from the x axis in rad; or one.
    centre : (3,) in m; all points have z > 0, |theta| < pi/2 about the origin.

    Returns
    -------
    As of :func:`plane`, with the dimensions ``theta`` and ``phi``, and x, y and z over them.

    >>> import polywigner as pw
    >>> square, theta = pw.shapes.square(10e-3), [0.0, 0.5]
    >>> found = pw.hemisphere(square, 0.1, theta, [0.0], 3.2e-3, method="kirchhoff")
    >>> found.kirchhoff.shape
    (2, 1)
    """
    settings = checked_settings(wavelength, options)
    grid = hemisphere_grid(radius, theta, phi, centre)
    return dataset(source, grid, settings, options.get("progress"))


@takes_frequency
def volume(
    source: PlaneSource | Wavefront,
    box: ArrayLike,
    shape: tuple[int, int, int],
    wavelength: float,
    *,
    chunks: Chunks | None = None,
    out: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
    threads: int | None = None,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """A field in a box of any size, place and resolution (docs/volumes.md).

    Eager by default, in blocks of bounded memory: beside the result, float32 unless told otherwise,
    some hundred megabytes. With ``chunks`` a lazy array, of which only what is asked for is
    computed. With ``out`` it is written to disk chunk by chunk, and taken up where it was killed.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, but ``dtype`` is "float32" by default.
    box : ((x0, y0, z0), (x1, y1, z1)) in m, z > 0.
    shape : how many points along x, y and z, faces included.
    chunks : None; or as dask takes them, a number, one for each axis, or "auto".
    out : folder of a zarr store, as of :func:`wigner_table`; one ``method``, and ``chunks`` None, a
        number, or one for each axis.
    scheduler, threads : with ``out``, as of :func:`wigner_table`.

    Returns
    -------
    As of :func:`plane`, with the dimensions ``x``, ``y`` and ``z``.

    Raises
    ------
    As :func:`plane`; StoreError for a place that cannot be written to or has other data.

    >>> import polywigner as pw
    >>> square, box = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
    >>> found = pw.volume(square, box, (3, 3, 2), 3.2e-3, method="kirchhoff")
    >>> found.kirchhoff.size
    18
    """
    settings = checked_settings(wavelength, options, dtype="float32")
    grid = box_grid(box, shape)
    if out is None:
        if scheduler is not None or threads is not None:
            raise ArgumentError(
                "expected out with scheduler or threads, got none; say where to write"
            )
        if chunks is None:
            check_memory(shape_of_grid(grid))
        return dataset(source, grid, settings, options.get("progress"), chunks)
    if len(settings.methods) != 1:
        raise ArgumentError(f"expected one method for a store, got {settings.methods}")
    radiator = checked_radiator(source, partly=True)
    sizes = _stored_chunks(chunks, shape_of_grid(grid))
    # Every chunk by the same engine, wherever it is computed.
    engine = resolved(settings.engine, max(_COMPILED, math.prod(sizes)))
    settings = replace(settings, engine=engine)
    block = FieldBlock(radiator, grid, settings.methods[0], settings)
    about = described(settings)
    shown = about | source_attrs(radiator)
    layout = Layout(block.method, settings.stored, grid.coords, sizes, block.attrs, shown)
    return write_dataset(
        out,
        layout,
        block,
        {**block.attrs, **about, **source_settings(radiator)},
        exclusive=engine != "numpy",
        scheduler=scheduler,
        threads=threads,
        progress=options.get("progress"),
    )


def _stored_chunks(chunks: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    if chunks is None or chunks == "auto":
        size = math.prod(shape) // _CHUNKS
        return chunks_within(shape, min(max(size, _LEAST_CHUNK), _CHUNK))
    sizes = tuple(chunks) if isinstance(chunks, Sequence) else (chunks,) * len(shape)
    if len(sizes) != len(shape) or not all(isinstance(n, int) and n > 0 for n in sizes):
        raise ArgumentError(f"expected chunks of {len(shape)} whole numbers, got {chunks!r}")
    return tuple(min(n, most) for n, most in zip(sizes, shape, strict=True))
