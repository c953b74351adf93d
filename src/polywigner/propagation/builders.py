"""Fields along lines, on planes and hemispheres, and in volumes, as labelled arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from numpy.typing import ArrayLike

from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import takes_frequency
from polywigner.propagation.datasets import FieldOptions, dataset
from polywigner.propagation.grids import box_grid, hemisphere_grid, line_grid, plane_grid
from polywigner.radiometry.directions import PlaneSource

if TYPE_CHECKING:
    import xarray


@takes_frequency
def line(
    source: PlaneSource | Wavefront,
    ends: ArrayLike,
    samples: int,
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field along a line, both ends included.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, as are errors.
    ends : two points (2, 3) in m, z > 0.
    samples : number of points.

    Returns
    -------
    As of :func:`plane`, with the dimension ``distance`` from the first end; x, y and z along it.

    >>> import polywigner as pw
    >>> square, ends = pw.shapes.square(10e-3), [(0, 0, 0.05), (0, 0, 0.2)]
    >>> field = pw.line(square, ends, 5, 3.2e-3, method="kirchhoff")
    >>> field.kirchhoff.shape
    (5,)
    """
    return dataset(source, line_grid(ends, samples), wavelength, options)


@takes_frequency
def plane(
    source: PlaneSource | Wavefront,
    where: ArrayLike,
    shape: tuple[int, int],
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field on a rectangle of any size, position and resolution (docs/volumes.md).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, with any fields; or one with a
        curved wave.
    where : ((x0, y0, z0), (x1, y1, z1)) in m with one pair of equal coordinates; or three corners
        (3, 3) of a rectangle in any direction, the first between the other two. z > 0.
    shape : number of points along both axes, edges included.
    wavelength : in m.
    method : "wigner" (default), or one of "rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2",
        "kirchhoff", "fresnel" and "fraunhofer", or several of these side by side.
    quantity : "irradiance" (default), |U|^2 in W/m^2 for |u|^2 in W/m^2; "amplitude", complex, or
        its "phase" in rad, which "wigner" does not have.
    obliquity : of "wigner" and "fraunhofer", as :func:`irradiance` takes it.
    bandwidth : of the light in Hz, for the irradiance, as :func:`irradiance` takes it.
    tolerance : as :func:`irradiance` and :func:`amplitude` take it; None: their defaults.
    obstacles : bodies and plates, as :func:`amplitude` takes them, whose shadows diffract
        (docs/shadows.md); with an exact method and light of one wavelength.
    dtype : type of the values, "float64" (default) or "float32" (amplitudes: complex).
    precision, engine : see :func:`fourier`.
    chunks : None: all values are computed now; or sizes of chunks as dask takes them, a number,
        one for each axis, or "auto": the result is lazy, and values are computed when needed.
    out : folder of a zarr store (format 3) to which the values are written chunk by chunk; the
        same call completes a store that an interrupted run has left. Needs the extra ``datasets``.
    scheduler : with ``out``: address of a dask.distributed scheduler whose workers see ``out``, or
        a cluster object such as ``LocalCluster``; None: this machine.
    threads : with ``out``: number of threads, on this machine or of each worker; None: all cores,
        or the worker's threads.
    progress : whether to draw a bar; None: on a terminal.

    Returns
    -------
    xarray.Dataset with a variable for each method, named after it, over two of x, y and z; for
    three corners over u and v, the distances from the first corner. Attributes hold units, settings
    and the version; a coordinate holds the source.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine, or the scheduler;
    StoreError for a path that cannot be written to, or holds results of other settings;
    MissingExtraError for ``chunks`` and ``out`` without the extra ``datasets``.

    >>> import polywigner as pw
    >>> square, where = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.1), (0.02, 0.02, 0.1)]
    >>> field = pw.plane(square, where, (5, 4), 3.2e-3, method="kirchhoff")
    >>> sorted(field.kirchhoff.shape)
    [4, 5]
    """
    return dataset(source, plane_grid(where, shape), wavelength, options)


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
    """Compute a field at one distance from a point, over angles: on a hemisphere or along a cut.

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
    >>> field = pw.hemisphere(square, 0.1, theta, [0.0], 3.2e-3, method="kirchhoff")
    >>> field.kirchhoff.shape
    (2, 1)
    """
    return dataset(source, hemisphere_grid(radius, theta, phi, centre), wavelength, options)


@takes_frequency
def volume(
    source: PlaneSource | Wavefront,
    box: ArrayLike,
    shape: tuple[int, int, int],
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field in a box of any size, position and resolution (docs/volumes.md).

    Values are computed in blocks, which need some hundred megabytes in addition to the result.
    Volumes larger than memory need ``chunks`` or ``out``.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, but ``dtype`` is "float32" by default.
    box : ((x0, y0, z0), (x1, y1, z1)) in m, z > 0.
    shape : number of points along x, y and z, faces included.

    Returns
    -------
    As of :func:`plane`, with the dimensions ``x``, ``y`` and ``z``.

    Raises
    ------
    As :func:`plane`.

    >>> import polywigner as pw
    >>> square, box = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
    >>> field = pw.volume(square, box, (3, 3, 2), 3.2e-3, method="kirchhoff")
    >>> field.kirchhoff.size
    18
    """
    return dataset(source, box_grid(box, shape), wavelength, options, "float32")
