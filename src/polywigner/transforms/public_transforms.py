"""Public functions for the Fourier transform, phase-space functions and marginals of sources."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polywigner import execution, kernels
from polywigner.execution import Differentiable, Engine, Precision
from polywigner.geometry import Aperture, PlacedAperture, Wavefront
from polywigner.geometry.arguments import Points
from polywigner.geometry.illumination import shift_phases
from polywigner.kernels import is_separable
from polywigner.numerics import Floats, phases
from polywigner.optics import FirstOrder
from polywigner.source import Array, Illumination
from polywigner.source.lattices import Sites, checked_sites
from polywigner.source.normal_form import normal_form
from polywigner.transforms.calls import compute, public
from polywigner.transforms.checked_calls import (
    PhaseSpaceSource,
    Source,
    Values,
    array_on_grid,
    checked_points,
    in_blocks,
    in_plane,
)
from polywigner.transforms.traced_sources import fourier_of
from polywigner.transforms.wavefronts import flat_source
from polywigner.transforms.xarray_arguments import takes_xarray


@public
def fourier(
    source: Source | Differentiable,
    nu: Points,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Values:
    """Compute the Fourier transform F(nu) of a source.

    The transform is the integral of u(x) exp(-2 pi i nu.x) over the source, where u is the field.
    The transform has a closed form at any frequency nu, including zero (docs/theory.md, (F2), (F3),
    (S1), (C1), (I1)). The error is 1e-13 of the length, area or volume of the source, or 2e-6 in
    single precision, for any magnitude and direction of nu. Polyhedra and outlines with thin walls,
    and lattices of more than 100 cycles, lose digits (docs/accuracy.md).

    In contrast, the paper's eq. (FVT) has the kernel exp(+2 pi i nu.x) and is singular at nu = 0.
    The paper's factor (nu/|nu|).n for collections is an obliquity factor, which is not part of the
    transform (docs/theory/fields.md).

    The computing time is proportional to the number of edges of an outline, or the number of
    triangles in the faces of a polyhedron, and to the number of waves of the illumination. If the
    illumination of a rectangle is a product of two functions along its sides, the waves along each
    side are summed separately, equation (I4). If the frequencies form a grid from
    ``numpy.meshgrid``, the time per frequency is much shorter for some outlines, equation (F4):
    outlines whose edges are parallel and equally long, or parallel to the axes.

    Parameters
    ----------
    source : Aperture, Slits, PlacedAperture, Polyhedron, Array or Wavefront
        Source, either uniform (u = 1) or with an illumination, or the result of
        :func:`differentiable`.
    nu : array_like, shape (..., d)
        Spatial frequencies in 1/m. The number of components d is 1 for Slits, 2 for an Aperture,
        and 3 for polyhedra and placed apertures. An Aperture also accepts d = 3 and ignores the
        last component, because without a pose it lies in the plane z = 0.
    precision : {"double", "single"}, optional
        Precision of the result. The default is "double" for NumPy input, and the precision of the
        input for Dr.Jit arrays.
    engine : {"auto", "numpy", "llvm", "cuda"}, default "auto"
        Engine of the computation.

    Returns
    -------
    ndarray of complex, shape (...)
        Values of F in m^d, with the type complex64 for single precision. For Dr.Jit input the
        result is a ``Complex2f``, and for a Dr.Jit tensor it is a tensor of real and imaginary
        parts, shape (..., 2). For an ``xarray.DataArray`` with components along its last dimension,
        the result is a DataArray over the other dimensions, with their coordinates, a unit and a
        name. The result for chunked input is lazy (docs/howto/notebook.md).

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or shape.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> round(float(pw.fourier(square, (0.25, 0.0)).real), 6)  # 4 sinc(0.5)
    2.546479
    """
    if isinstance(source, Wavefront):
        return compute("fourier", source, {"nu": nu}, precision, engine)
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    if isinstance(source, Differentiable) or execution.is_drjit(nu):
        numbers = source.numbers if isinstance(source, Differentiable) else {}
        points, restored = execution.component_arrays({"nu": nu}, numbers, precision, engine)
        return restored(_fourier_of_flat(source, points["nu"], how))
    with np.errstate(invalid="ignore", over="ignore"):
        return _fourier_of_flat(source, nu, how)


def _fourier_of_flat(source: Source | Differentiable, nu: Any, how: dict[str, Any]) -> Values:
    """Return the Fourier transform of a source with a flat wave. ``how``: precision and engine."""
    if isinstance(source, Differentiable):
        return fourier_of(source, in_plane(nu), partial(fourier, **how))
    if isinstance(source, Array):
        by_elements = partial(in_blocks, partial(_coherent_sum, source, how=how))
        value = None
        is_uniform = all(_illumination_of(element) is None for element in source.elements)
        if source.repeated is None and is_uniform:
            value = array_on_grid(source, nu, point_by_point=by_elements, **how)
        return by_elements(nu) if value is None else value
    if isinstance(source, Aperture):
        nu = in_plane(nu)
        if is_separable(source):
            return compute("fourier of waves", source, {"nu": nu}, **how)
    if _illumination_of(source) is not None:
        return in_blocks(lambda block: _sum_of_waves(source, block, how), nu)
    return compute("fourier", source, {"nu": nu}, **how)


def _illumination_of(source: Source) -> Illumination | None:
    """Return the plane waves of an aperture or slits; None for other sources and uniform fields."""
    outline = source.aperture if isinstance(source, PlacedAperture) else source
    field: Illumination | None = getattr(outline, "illumination", None)
    return field


def _sum_of_waves(source: Any, nu: Any, how: dict[str, Any]) -> Values:
    """Return the Fourier transform of a source as a sum over its plane waves, equation (I1)."""
    (element,) = normal_form(source).elements
    uniform: Any = element.outline
    total: Values = 0.0
    d = element.frequencies.shape[1]
    rotation, shift = np.eye(d), np.zeros(d)
    centre = np.atleast_1d(uniform.centre)
    if element.pose is not None:
        rotation, shift = element.pose[:3, :2], element.pose[:3, 3]
        uniform = uniform.placed(element.pose)
    centre = rotation @ centre + shift
    frequencies = element.frequencies @ rotation.T
    # Phases of waves are relative to the origin of the placed aperture, not to the world origin.
    amplitudes = element.amplitudes * shift_phases(frequencies, shift)
    for amplitude, kappa in zip(amplitudes, frequencies, strict=True):
        shifted, lost = _frequency_difference(nu, kappa)
        term = execution.times_complex(fourier(uniform, shifted, **how), complex(amplitude))
        if lost is not None:
            term = term * np.exp(-2j * np.pi * (lost @ centre)).astype(term.dtype)
        total = total + term
    return total


def _frequency_difference(nu: Any, kappa: Floats) -> tuple[Values, Floats | None]:
    """Return nu - kappa and its rounding error, which matters for sources far from the origin.

    For Dr.Jit arrays the rounding error is None.
    """
    if execution.is_drjit(nu):
        return execution.shifted(nu, -kappa), None
    difference, lost = phases.difference(checked_points("nu", nu, len(kappa)), kappa)
    return difference, np.where(np.isfinite(lost), lost, 0.0)


def _coherent_sum(array: Array, nu: Any, how: dict[str, Any]) -> Values:
    """Return the Fourier transform of an array by equation (C1), or by its array factor (L3)."""
    if array.repeated is not None:
        first, shifts = array.repeated
        plane = in_plane(nu) if shifts.shape[1] == 2 else nu
        return fourier(first, nu, **how) * array_factor(shifts, array.weights, plane, **how)
    total: Values = 0.0
    for element, weight in zip(array.elements, array.weights.tolist(), strict=True):
        total = total + execution.times_complex(fourier(element, nu, **how), weight)
    return total


@takes_xarray("nu", units="1", long_name="array factor")
def array_factor(
    positions: ArrayLike,
    weights: ArrayLike | None,
    nu: Points,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Values:
    """Compute the array factor of isotropic sources.

    The array factor is the sum of w_k exp(-2 pi i nu.p_k) over all sources, with positions p_k and
    weights w_k. The Fourier transform of a `phased_array` is the transform of its element times the
    array factor (docs/theory.md, (L3)). For a lattice whose weights are a product of two profiles,
    the array factor is the product of two sums, one along each direction.

    Parameters
    ----------
    positions : array_like, shape (n, d) or (n,)
        Positions in m, with d = 1, 2 or 3 components.
    weights : array_like, shape (n,), or None
        Complex weights. None sets all weights to 1.
    nu : array_like, shape (..., d)
        Spatial frequencies in 1/m.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of complex, shape (...)
        Values in the unit of the weights. The type of the array depends on ``nu``, see
        :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or shape.
    IlluminationError
        If the weights are not n finite complex numbers.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> import numpy as np
    >>> row = np.array([(-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)])
    >>> round(float(pw.array_factor(row, np.ones(3), (0.5, 0.0)).real), 6)
    -1.0
    """
    sites = Sites(*checked_sites(positions, weights))
    # Phases of distant sources need float64, even if the result has single precision.
    execution.checked_precision(precision)
    rounded = precision == "single" and not execution.is_drjit(nu)
    inner = None if rounded else precision

    def factor(nu: Any) -> Values:
        """Return the array factor at a block of frequencies."""
        values = compute("array factor", sites, {"nu": nu}, inner, engine)
        return values.astype(np.complex64) if rounded else values

    with np.errstate(invalid="ignore", over="ignore"):
        return in_blocks(factor, nu)


@public
def autocorrelation(
    source: PhaseSpaceSource,
    x: Points,
    xi: Points,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Values:
    """Compute the autocorrelation of the field on a source.

    The autocorrelation is R(x, xi) = u(x + xi/2) conj(u(x - xi/2)), where u is the field, as in the
    paper's eq. (auto_lag). The left and lower sides of the boundary belong to the source, and the
    right and upper sides do not.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        The source, with d = 2 for apertures and arrays of apertures, and d = 1 for slits. The field
        of the source may be uniform, a sum of plane waves, curved or partly coherent.
    x : array_like, shape (..., d)
        Positions in m. A position is the midpoint of the two points.
    xi : array_like, shape (..., d)
        Lags in m, which broadcast against ``x``. A lag is the difference of the two points.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of complex, shape (...)
        Dimensionless values of R, which are 0 or 1 for a uniform source. For Dr.Jit arrays and
        DataArrays see :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or shape.
    GeometryError
        If an Array has elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> float(pw.autocorrelation(square, (0.5, 0.0), (0.5, 0.0)).real)  # both points lie inside
    1.0
    """
    return compute("autocorrelation", source, {"x": x, "xi": xi}, precision, engine)


@public
def wigner(
    source: PhaseSpaceSource | Differentiable,
    x: Points,
    nu: Points,
    *,
    through: FirstOrder | None = None,
    wavelength: float | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Values:
    """Compute the Wigner function W(x, nu) of a source.

    The Wigner function is ``int u(x + xi/2) u*(x - xi/2) exp(-2 pi i nu.xi) d xi``, where u is the
    field on the source. The function is computed in closed form, as the Fourier transform of the
    lag slice at x. (Erratum: in the paper's definition of the slice, the matrices M must translate
    by 2x.) The elements of an Array may overlap, equation (W2). The computing time is proportional
    to the number of pairs of edges that can cross. The slice at a position x is computed only once
    for all frequencies.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        The source, with d = 2 for apertures and arrays of apertures, and d = 1 for slits, or the
        result of :func:`differentiable`.
    x : array_like, shape (..., d)
        Positions in m.
    nu : array_like, shape (..., d)
        Real spatial frequencies in 1/m, which broadcast against ``x``.
    through : FirstOrder, optional
        Optical system between the source and the plane of ``x`` and ``nu``. The Wigner function in
        this plane equals the Wigner function of the source, at the position and direction from
        which the ray comes, equation (O2). For slits the system must not couple x and y.
    wavelength : float, optional
        Wavelength in m; only used together with ``through``.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of float, shape (...)
        Values of W in m^d, which are zero outside the automean. The type is float32 for single
        precision. For Dr.Jit arrays and DataArrays see :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or shape.
    GeometryError
        If an Array has elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> round(float(pw.wigner(square, (0.5, 0.0), (0.0, 0.0))), 12)  # the area of the lag slice
    8.0
    """
    points = {"x": x, "nu": nu}
    return compute(
        "wigner", source, points, precision, engine, through=through, wavelength=wavelength
    )


@public
def ambiguity(
    source: PhaseSpaceSource | Differentiable,
    upsilon: Points,
    xi: Points,
    *,
    through: FirstOrder | None = None,
    wavelength: float | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Values:
    """Compute the ambiguity function A(upsilon, xi) of a source.

    The ambiguity function is ``int u(x + xi/2) u*(x - xi/2) exp(-2 pi i upsilon.x) d x``, where u
    is the field on the source. The function is computed in closed form, as the Fourier transform of
    the position slice at xi. (Erratum: the paper has x.xi in place of upsilon.x in the kernel.) The
    computing time is proportional to twice the number of pairs of edges that can cross.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        The source, with d = 2 for apertures and arrays of apertures, and d = 1 for slits, or the
        result of :func:`differentiable`.
    upsilon : array_like, shape (..., d)
        Real frequency shifts in 1/m.
    xi : array_like, shape (..., d)
        Lags in m, which broadcast against ``upsilon``.
    through : FirstOrder, optional
        Optical system between the source and the plane of the lags, equation (O3). For slits the
        system must not couple x and y.
    wavelength : float, optional
        Wavelength in m; only used together with ``through``.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of complex, shape (...)
        Values of A in m^d. For Dr.Jit arrays and DataArrays see :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or shape.
    GeometryError
        If an Array has elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> float(pw.ambiguity(square, (0.0, 0.0), (1.0, 0.0)).real)  # the overlap of two squares
    2.0
    """
    points = {"upsilon": upsilon, "xi": xi}
    return compute(
        "ambiguity", source, points, precision, engine, through=through, wavelength=wavelength
    )


@public
def position_marginal(
    source: PhaseSpaceSource, x: Points, *, precision: Precision = None, engine: Engine = "auto"
) -> Values:
    """Compute the position marginal R_x(x), the integral of the autocorrelation over all lags.

    The position marginal equals the Wigner function W(x, 0). For a uniform source, the marginal is
    the area of the lag slice at x.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        The source, with d = 2 for apertures and arrays of apertures, and d = 1 for slits. The field
        of the source may be uniform, a sum of plane waves, curved or partly coherent.
    x : array_like, shape (..., d)
        Positions in m.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of float, shape (...)
        Values of R_x in m^d. For Dr.Jit arrays and DataArrays see :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or shape.
    GeometryError
        If an Array has elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> round(float(pw.position_marginal(square, (0.5, 0.0))), 12)
    8.0
    """
    return compute("position_marginal", source, {"x": x}, precision, engine)


@public
def lag_marginal(
    source: PhaseSpaceSource, xi: Points, *, precision: Precision = None, engine: Engine = "auto"
) -> Values:
    """Compute the lag marginal R_xi(xi), the integral of the autocorrelation over all positions.

    The lag marginal equals the ambiguity function A(0, xi). For a uniform source, the marginal is
    the area of the position slice, which is the area of the source times the optical transfer
    function of a pupil of this shape.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        The source, with d = 2 for apertures and arrays of apertures, and d = 1 for slits. The field
        of the source may be uniform, a sum of plane waves, curved or partly coherent.
    xi : array_like, shape (..., d)
        Lags in m.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray, shape (...)
        Values of R_xi in m^d. The values are real for a uniform source, and complex for an Array,
        an illumination and a curved wave. For Dr.Jit arrays and DataArrays see :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or shape.
    GeometryError
        If an Array has elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> float(pw.lag_marginal(square, (0.5, 0.0)))
    3.0
    """
    return compute("lag_marginal", source, {"xi": xi}, precision, engine)


def energy_of(source: PhaseSpaceSource) -> float:
    """Return the integral of |u|^2 over a source, where u is the field.

    Rounding errors may make the value negative if the elements cancel each other everywhere.
    """
    # The engine is NumPy, because compiling a kernel takes longer than computing a single value.
    lag = np.zeros(kernels.kernel_for("ambiguity", flat_source(source)).dimension)
    return float(np.real(lag_marginal(source, lag, engine="numpy")))
