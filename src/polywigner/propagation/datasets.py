"""Datasets on grids: fields on lines, planes, hemispheres and in volumes, and tables of W and A.

Values are computed in memory, lazily, or in a store on disk (docs/volumes.md, docs/large_runs.md).
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_engine, checked_precision
from polywigner.execution.choice import resolved
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import (
    check_options,
    checked_choice,
    checked_wavelength,
    finite_array,
    takes_frequency,
)
from polywigner.geometry.silhouettes import listed_bodies, obstacle_of
from polywigner.kernels import kernel_for
from polywigner.propagation.amplitudes import Obstacle, amplitude
from polywigner.propagation.conducting_sheets import Edge
from polywigner.propagation.irradiances import irradiance
from polywigner.propagation.point_grids import (
    METHODS,
    Grid,
    box_grid,
    hemisphere_grid,
    line_grid,
    plane_grid,
)
from polywigner.propagation.stores import (
    LARGEST_CHUNK,
    Index,
    StoreOptions,
    results_on_grid,
    source_attrs,
    source_coords,
)
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.source.obliquities import DEFAULT
from polywigner.transforms import PhaseSpaceSource, ambiguity, wigner
from polywigner.transforms.projection import is_frequency
from polywigner.transforms.wavefronts import flat_source
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

Quantity = Literal["irradiance", "amplitude", "phase"]

# Methods that accept an obliquity. The boundary condition of any other method determines its
# obliquity.
_WITH_OBLIQUITY = ("wigner", "fraunhofer")
# Options of datasets that :func:`irradiance` and :func:`amplitude` do not accept.
_OF_RESULTS = ("method", "quantity", "dtype", "chunks", "out", "scheduler", "threads", "progress")
# Number of points per block in memory. A block takes tens of megabytes, and is large enough for the
# full speed of compiled engines.
_BLOCK = 1 << 17
# Largest and smallest number of samples per chunk, and target number of chunks. The largest chunk
# has 4 MB of float32. With 64 chunks, the first results are stored within a minute.
_LARGEST_CHUNK, _SMALLEST_CHUNK, _CHUNKS = 1 << 20, 1 << 15, 64
# Unit and long name of each quantity.
_QUANTITIES = {
    "irradiance": ("W m-2", "irradiance |U|^2"),
    "amplitude": ("W0.5 m-1", "complex amplitude U"),
    "phase": ("rad", "phase of U"),
}


class FieldOptions(StoreOptions, total=False):
    """Options of :func:`plane`, :func:`line`, :func:`hemisphere` and :func:`volume`."""

    method: str | Sequence[str]
    quantity: Quantity
    obliquity: str | None
    bandwidth: float | None
    """Bandwidth of the light in Hz, or None for a single wavelength. See :func:`irradiance`."""
    obstacles: Obstacle | Sequence[Obstacle] | None
    edge: Edge
    tolerance: float | None
    dtype: str
    engine: Engine
    out: str | os.PathLike[str] | None


def _field_values(
    source: PlaneSource | Wavefront, grid: Grid, wavelength: float, method: str, quantity: str,
    dtype: np.dtype[Any], options: Mapping[str, Any], origin: Index, shape: Index,
) -> NDArray[Any]:  # fmt: skip
    """Compute the block of a field on a grid that starts at the index ``origin``."""
    compute = irradiance if quantity == "irradiance" else amplitude
    field = compute(source, grid.points(origin, shape), wavelength, method, **options)
    return np.asarray(np.angle(field) if quantity == "phase" else field, dtype)


def _field_attrs(method: str, quantity: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes of the variable that contains a field."""
    units, long_name = _QUANTITIES[quantity]
    return {
        "units": units,
        "long_name": long_name,
        "method": method,
        "quantity": quantity,
        **({"obliquity": DEFAULT} if method in _WITH_OBLIQUITY else {}),
        **options,
        **({"obstacles": _summary(options["obstacles"])} if "obstacles" in options else {}),
        "convention": "waves exp(+ikr)/r, time exp(-i omega t); |u|^2 on the source in W m-2",
    }


def _summary(obstacles: Sequence[Obstacle]) -> str:
    """Return a text with the number, the types and the SHA-256 hash of obstacles."""
    meshes = [obstacle_of(body) for body in obstacles]
    content = b"".join(mesh.vertices.tobytes() + mesh.triangles.tobytes() for mesh in meshes)
    names = f"{'; '.join(map(repr, obstacles)):.150}"
    return f"{len(meshes)} obstacles: {names} (SHA-256 {hashlib.sha256(content).hexdigest()})"


def _field_dataset(
    source: Any, grid: Grid, wavelength: float, options: FieldOptions, dtype: str = "float64"
) -> xarray.Dataset:
    """Return fields of all requested methods on a grid as an in-memory, lazy or stored dataset."""
    check_options(options, FieldOptions)
    radiator, length = checked_radiator(source, partly=True), checked_wavelength(wavelength)
    given = options.get("method", "wigner")
    methods = [
        checked_choice(name, "method", ("wigner", *METHODS))
        for name in (given if isinstance(given, list | tuple) else [given])
    ]
    quantity = checked_choice(options.get("quantity", "irradiance"), "quantity", list(_QUANTITIES))
    number = checked_choice(options.get("dtype", dtype), "dtype", ("float32", "float64"))
    number_type = np.result_type(number, *([np.complex64] if quantity == "amplitude" else []))
    common, shape = _checked_settings(options, quantity), grid.shape
    is_lazy = options.get("chunks") is not None or options.get("out") is not None
    samples = math.prod(shape)
    if is_lazy:  # All chunks need the same engine, even on different machines.
        common["engine"] = resolved(common["engine"], samples // _CHUNKS)
    variables = {}
    with _warnings_once():
        for method in methods:
            settings = dict(common)
            if method not in _WITH_OBLIQUITY:
                settings.pop("obliquity", None)
            block = partial(_field_values, radiator, grid, length, method, quantity, number_type)
            if is_lazy or len(methods) > 1:
                # Compute one point first, so that invalid arguments are reported before hours of
                # work.
                block({**settings, "engine": "numpy"}, (0,) * len(shape), (1,) * len(shape))
            attrs = _field_attrs(method, quantity, settings)
            variables[method] = partial(block, settings), number_type, attrs
        return results_on_grid(
            variables,
            grid.coords,
            source_coords(radiator) | _positions(grid),
            {"wavelength": length, "frequency": SPEED_OF_LIGHT / length, **source_attrs(radiator)},
            options,
            block_size=_BLOCK,
            chunk_size=min(max(samples // _CHUNKS, _SMALLEST_CHUNK), _LARGEST_CHUNK),
            compiled=common["engine"] != "numpy",
        )


def _checked_settings(options: FieldOptions, quantity: str) -> dict[str, Any]:
    """Return the options for irradiance or amplitude that are not None, and always the engine.

    Only the engine, the obstacles and the bandwidth of an irradiance are checked here.
    """
    settings: dict[str, Any] = {
        name: value
        for name, value in options.items()
        if name not in _OF_RESULTS and value is not None
    }
    settings["engine"] = checked_engine(options.get("engine", "auto"))
    if "bandwidth" in settings and quantity != "irradiance":
        raise ArgumentError(
            f"the {quantity} requires light of a single wavelength, got "
            f"bandwidth={settings['bandwidth']!r} Hz; only the irradiance has a bandwidth"
        )
    if "obstacles" in settings:
        settings["obstacles"] = listed_bodies(settings["obstacles"])
    return settings


def _positions(grid: Grid) -> dict[str, Any]:
    """Return the coordinates x, y and z that are not axes of a grid."""
    axes = tuple(grid.coords)
    origin, missing = (0,) * len(axes), [k for k, name in enumerate("xyz") if name not in axes]
    if len(missing) < 3:
        axes, points = (), grid.points(origin, (1,) * len(axes)).reshape(3)
    else:
        points = grid.points(origin, grid.shape)
    return {"xyz"[k]: (axes, points[..., k], {"units": "m"}) for k in missing}


@contextmanager
def _warnings_once() -> Iterator[None]:
    """Issue the warnings of a ``with`` block at its end; omit those that differ only in numbers."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in {re.sub(r"[\d.]+", "", str(w.message)): w for w in caught}.values():
        # The stack level refers to the caller of `line`, `plane`, ..., which `takes_frequency`
        # wraps.
        warnings.warn(warning.message, warning.category, stacklevel=6)


@takes_frequency
def line(
    source: PlaneSource | Wavefront,
    ends: ArrayLike,
    samples: int,
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field along a straight line.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    ends : array_like, shape (2, 3)
        Positions of both ends of the line in m, with z > 0.
    samples : int
        Number of points, both ends included.
    wavelength : float
        Wavelength in m.
    **options
        Options of :func:`plane`.

    Returns
    -------
    xarray.Dataset
        One variable for each method, as in :func:`plane`, over the ``distance`` from the first end
        in m. The coordinates x, y and z are the positions of the points.

    Raises
    ------
    PolywignerError
        See :func:`plane`.

    >>> import polywigner as pw
    >>> square, ends = pw.shapes.square(10e-3), [(0, 0, 0.05), (0, 0, 0.2)]
    >>> field = pw.line(square, ends, 5, 3.2e-3, method="fresnel")
    >>> field.fresnel.shape
    (5,)
    """
    return _field_dataset(source, line_grid(ends, samples), wavelength, options)


@takes_frequency
def plane(
    source: PlaneSource | Wavefront,
    where: ArrayLike,
    shape: tuple[int, int],
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field on a plane rectangle of any size, position and resolution (docs/volumes.md).

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    where : array_like, shape (2, 3) or (3, 3)
        Opposite corners in m of a rectangle parallel to two axes, with one pair of equal
        coordinates and the other pairs ascending; or three corners of a rectangle in any
        orientation, the first of which is adjacent to the other two. All corners must have z > 0.
    shape : tuple of int
        Number of points along both axes in the order x, y, z or u, v, edges included.
    wavelength : float
        Wavelength in m.
    method : str or sequence of str, default "wigner"
        "wigner", a method of :func:`amplitude`, or a list of these.
    quantity : {"irradiance", "amplitude", "phase"}
        Quantity to compute: the irradiance |U|^2 in W/m^2 for |u|^2 in W/m^2, the complex amplitude
        U, or the phase of U in rad. The method "wigner" provides only the irradiance.
    obliquity : str, optional
        Obliquity factor of "wigner" and "fraunhofer", as in :func:`irradiance`.
    bandwidth : float, optional
        Bandwidth of an irradiance in Hz, as in :func:`irradiance`.
    tolerance : float, optional
        Allowed error as in :func:`irradiance` and :func:`amplitude`, with the same defaults.
    obstacles : sequence of bodies and plates, optional
        Obstacles as in :func:`amplitude`; their shadows include diffraction (docs/shadows.md).
        Obstacles require an exact method and a single wavelength.
    edge : {"black", "soft", "hard"}, default "black"
        Boundary condition on the obstacles, as in :func:`amplitude`.
    dtype : {"float64", "float32"}
        Type of real values, and of the real and imaginary parts of amplitudes.
    engine : str, optional
        See :func:`fourier`.
    chunks : int, str or sequence, optional
        Chunk size of a lazy result: a number of samples, one number for each axis, or "auto", as in
        dask. By default all values are computed before the function returns.
    out : path, optional
        Folder of a zarr store (format 3) to which the values are written chunk by chunk. After an
        interruption the same call completes the store. Requires the extra ``datasets``.
    scheduler : str or cluster, default this machine
        Address of a dask.distributed scheduler, for use with ``out``, whose workers can access
        ``out``, or a cluster object such as ``LocalCluster``.
    threads : int, optional
        Number of threads with ``out``, on this machine or of each worker. The default is all cores,
        or the worker's threads.
    progress : bool, optional
        Whether to draw a progress bar. By default, the bar is drawn on a terminal.

    Returns
    -------
    xarray.Dataset
        One variable for each method, with the name of the method. The axes are two of x, y and z,
        or, for three corners, the distances u and v from the first corner. Attributes contain
        units, settings and the version. One of the coordinates contains the source.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.
    EngineError
        If the engine or the scheduler is not available.
    StoreError
        If the path cannot be written to, or contains results of other settings.
    MissingExtraError
        If ``chunks`` or ``out`` is specified, and the extra ``datasets`` is not installed.

    >>> import polywigner as pw
    >>> square, where = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.1), (0.02, 0.02, 0.1)]
    >>> field = pw.plane(square, where, (5, 4), 3.2e-3, method="fresnel")
    >>> sorted(field.fresnel.shape)
    [4, 5]
    """
    return _field_dataset(source, plane_grid(where, shape), wavelength, options)


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
    """Compute a field over angles at a fixed distance from a point.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    radius : float
        Distance from ``centre`` in m.
    theta : array_like, shape (n,)
        Angles from the z axis in rad. A negative angle theta at phi is the same direction as -theta
        at phi + pi.
    phi : array_like, shape (m,) or ()
        Angles from the x axis in rad.
    wavelength : float
        Wavelength in m.
    centre : tuple of float, default the origin
        Centre (x, y, z) of the hemisphere in m. All points must have z > 0.
    **options
        Options of :func:`plane`.

    Returns
    -------
    xarray.Dataset
        One variable for each method, as in :func:`plane`, and the coordinates x, y and z of the
        points, over ``theta`` and ``phi``.

    Raises
    ------
    PolywignerError
        See :func:`plane`.

    >>> import polywigner as pw
    >>> square, theta = pw.shapes.square(10e-3), [0.0, 0.5]
    >>> field = pw.hemisphere(square, 0.1, theta, [0.0], 3.2e-3, method="fresnel")
    >>> field.fresnel.shape
    (2, 1)
    """
    return _field_dataset(source, hemisphere_grid(radius, theta, phi, centre), wavelength, options)


@takes_frequency
def volume(
    source: PlaneSource | Wavefront,
    box: ArrayLike,
    shape: tuple[int, int, int],
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field in a box of any size, position and resolution (docs/volumes.md).

    Fields larger than memory require ``chunks`` or ``out``.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    box : array_like, shape (2, 3)
        Opposite corners (x0, y0, z0) and (x1, y1, z1) in m, with z > 0.
    shape : tuple of int
        Number of points along x, y and z, faces included.
    wavelength : float
        Wavelength in m.
    **options
        Options of :func:`plane`; ``dtype`` is "float32" by default.

    Returns
    -------
    xarray.Dataset
        One variable for each method, as in :func:`plane`, over ``x``, ``y`` and ``z``.

    Raises
    ------
    PolywignerError
        See :func:`plane`.

    >>> import polywigner as pw
    >>> square, box = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
    >>> field = pw.volume(square, box, (3, 3, 2), 3.2e-3, method="fresnel")
    >>> field.fresnel.size
    18
    """
    return _field_dataset(source, box_grid(box, shape), wavelength, options, "float32")


Kind = Literal["wigner", "ambiguity"]

# Symbol, long name, sign convention, and dtype in single precision of each table.
_TABLES: dict[Kind, tuple[str, str, str, type]] = {
    "wigner": ("W", "Wigner function", "exp(-2 pi i nu.xi)", np.float32),
    "ambiguity": ("A", "ambiguity function", "exp(-2 pi i upsilon.x)", np.complex64),
}


class TableOptions(StoreOptions, total=False):
    """Options of :func:`wigner_table` and :func:`ambiguity_table`."""

    precision: Precision
    engine: Engine


def wigner_table(
    source: PhaseSpaceSource,
    x: ArrayLike,
    y: ArrayLike,
    nu_x: ArrayLike,
    nu_y: ArrayLike,
    out: str | os.PathLike[str] | None = None,
    **options: Unpack[TableOptions],
) -> xarray.Dataset:
    """Return the Wigner function W(x, y, nu_x, nu_y) of a planar source on a grid.

    With ``out`` the table is written to disk chunk by chunk, and may be larger than memory
    (docs/large_runs.md). See :func:`wigner` for the accuracy.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    x, y : array_like, shape (n,)
        Positions in m.
    nu_x, nu_y : array_like, shape (n,)
        Spatial frequencies in 1/m.
    out : path, optional
        Folder of a zarr store, as in :func:`plane`.
    chunks : int, str or sequence, optional
        Chunk size as in :func:`plane`. With ``out``, the default is chunks of up to 4 million
        samples.
    precision : {"single", "double"}, default "single"
        Precision of sums and results.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`wigner`.
    scheduler, threads, progress : optional
        As in :func:`plane`.

    Returns
    -------
    xarray.Dataset
        The real variable W (x, y, nu_x, nu_y) in m^2, lazy with ``chunks`` or ``out``.

    Raises
    ------
    PolywignerError
        See :func:`plane`.

    >>> import polywigner as pw
    >>> table = pw.wigner_table(pw.shapes.square(1.0), [0.0], [0.0], [0.0, 0.5], [0.0])
    >>> table.W.shape
    (1, 1, 2, 1)
    """
    axes = {"x": x, "y": y, "nu_x": nu_x, "nu_y": nu_y}
    return _table_dataset("wigner", source, axes, out, options)


def ambiguity_table(
    source: PhaseSpaceSource,
    upsilon_x: ArrayLike,
    upsilon_y: ArrayLike,
    xi_x: ArrayLike,
    xi_y: ArrayLike,
    out: str | os.PathLike[str] | None = None,
    **options: Unpack[TableOptions],
) -> xarray.Dataset:
    """Return the ambiguity function of a planar source on a grid of its four coordinates.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    upsilon_x, upsilon_y : array_like, shape (n,)
        Frequency shifts in 1/m.
    xi_x, xi_y : array_like, shape (n,)
        Lags in m.
    out : path, optional
        Folder of a zarr store, as in :func:`wigner_table`.
    **options
        Options of :func:`wigner_table`.

    Returns
    -------
    xarray.Dataset
        The complex variable A (upsilon_x, upsilon_y, xi_x, xi_y) in m^2.

    Raises
    ------
    PolywignerError
        See :func:`plane`.

    >>> import polywigner as pw
    >>> table = pw.ambiguity_table(pw.shapes.square(1.0), [0.0, 0.5], [0.0], [0.0], [0.0])
    >>> table.A.shape
    (2, 1, 1, 1)
    """
    axes = {"upsilon_x": upsilon_x, "upsilon_y": upsilon_y, "xi_x": xi_x, "xi_y": xi_y}
    return _table_dataset("ambiguity", source, axes, out, options)


def _values(
    kind: Kind, source: PhaseSpaceSource, axes: Sequence[NDArray[np.float64]], how: Any,
    origin: Index, shape: Index,
) -> NDArray[Any]:  # fmt: skip
    """Compute the block of a table of W or A that starts at the index ``origin``."""
    parts = [a[o : o + n] for a, o, n in zip(axes, origin, shape, strict=True)]
    first, second = (
        np.stack(np.meshgrid(*pair, indexing="ij"), axis=-1) for pair in (parts[:2], parts[2:])
    )
    # Kernels compute the slice of the source at each x (for W) or xi (for A) only once if these
    # axes come first.
    if kind == "wigner":
        return np.asarray(wigner(source, first[:, :, None, None, :], second, **how))
    values = ambiguity(source, first, second[:, :, None, None, :], **how)
    return np.ascontiguousarray(values.transpose(2, 3, 0, 1))


def _table_dataset(
    kind: Kind,
    source: PhaseSpaceSource,
    axes: Mapping[str, ArrayLike],
    out: str | os.PathLike[str] | None,
    options: TableOptions,
) -> xarray.Dataset:
    """Return W or A on a grid of four coordinates as an in-memory, lazy or stored dataset.

    ``axes``, in this order: x, y, nu_x, nu_y for W; upsilon_x, upsilon_y, xi_x, xi_y for A.
    """
    check_options(options, TableOptions)
    if kernel_for(kind, flat_source(source)).dimension != 2:
        raise ArgumentError(
            "a table of four coordinates requires a source in a plane, got "
            f"{type(source).__name__}; call polywigner.{kind} for other sources"
        )
    coords = {name: _checked_axis(name, values) for name, values in axes.items()}
    precision = checked_precision(options.get("precision", "single")) or "double"
    samples = min(LARGEST_CHUNK, math.prod(axis.size for axis in coords.values()))
    # All chunks need the same engine, even on different machines.
    engine: Any = resolved(checked_engine(options.get("engine", "auto")), samples)
    symbol, label, convention, single = _TABLES[kind]
    number_type = np.result_type(single, np.float32 if precision == "single" else np.float64)
    settings = {"precision": precision, "engine": engine}
    block = partial(_values, kind, source, [axis.values for axis in coords.values()], settings)
    about = {"kind": kind, "convention": convention, **settings}
    return results_on_grid(
        {symbol: (block, number_type, {"units": "m2", "long_name": label})},
        coords,
        source_coords(source),
        about | source_attrs(source),
        {**options, "out": out},
        compiled=engine != "numpy",
    )


def _checked_axis(name: str, values: ArrayLike) -> xarray.Variable:
    """Return a coordinate of a table in m or 1/m; raise ArgumentError for other values."""
    expected = f"expected {name} to be finite numbers of shape (n,)"
    array = finite_array(values, expected, (None,))
    return labelled_array(array, (name,), {"units": "1/m" if is_frequency(name) else "m"})
