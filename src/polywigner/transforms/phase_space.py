"""Autocorrelation, Wigner and ambiguity functions, and the marginals."""

from __future__ import annotations

import numpy as np

from polywigner import kernels
from polywigner.execution import Differentiable, Engine, Precision
from polywigner.geometry.arguments import Points
from polywigner.optics import FirstOrder
from polywigner.transforms.calls import compute, public
from polywigner.transforms.checked_calls import PhaseSpaceSource, Values
from polywigner.transforms.wavefronts import flat_source


@public
def autocorrelation(
    source: PhaseSpaceSource,
    x: Points,
    xi: Points,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Values:
    """Autocorrelation R(x, xi) = u(x + xi/2) conj(u(x - xi/2)) of the field at two points.

    This is the paper's eq. (auto_lag). The source includes its boundary on the left and lower
    sides, and excludes it on the right and upper sides.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        d = 2 for apertures and arrays of apertures, 1 for slits. Fields may be uniform, sums of
        plane waves, curved or partly coherent.
    x : array_like, shape (..., d)
        Positions in m, the mean of the two points.
    xi : array_like, shape (..., d)
        Lags in m, the difference of the two points.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of complex, shape (...)
        Without unit; 0 or 1 for a uniform source. Dr.Jit arrays and DataArrays as in
        :func:`fourier`.

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
    """Wigner function W(x, nu) = integral of u(x + xi/2) u*(x - xi/2) exp(-2 pi i nu.xi) d xi.

    The closed form is the Fourier transform of the lag slice at x. (Erratum: in the paper's
    definition of the slice, the matrices M must translate by 2x.) W of an Array is given by (W2),
    also if its elements overlap. The computing time is proportional to the number of pairs of edges
    that can cross. Frequencies at the same x share the slice.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        d = 2 for apertures and arrays of apertures, 1 for slits; or a source of
        :func:`differentiable`.
    x : array_like, shape (..., d)
        Positions in m.
    nu : array_like, shape (..., d)
        Real spatial frequencies in 1/m.
    through : FirstOrder, optional
        System between the source and the plane of ``x`` and ``nu``. W there is W of the source at
        the origin of the ray, (O2). For slits it must keep x and y apart.
    wavelength : float, optional
        In m; with ``through`` only.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of float, shape (...)
        In m^d; zero outside the automean; float32 for single precision. Dr.Jit arrays and
        DataArrays as in :func:`fourier`.

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
    """Ambiguity function: integral of u(x + xi/2) u*(x - xi/2) exp(-2 pi i upsilon.x) d x.

    The closed form is the Fourier transform of the position slice at xi. (Erratum: the paper has
    x.xi in place of upsilon.x in the kernel.) The computing time is proportional to twice the
    number of pairs of edges that can cross.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        d = 2 for apertures and arrays of apertures, 1 for slits; or a source of
        :func:`differentiable`.
    upsilon : array_like, shape (..., d)
        Real frequency shifts in 1/m.
    xi : array_like, shape (..., d)
        Lags in m.
    through : FirstOrder, optional
        System between the source and the plane of the lags, (O3). For slits it must keep x and y
        apart.
    wavelength : float, optional
        In m; with ``through`` only.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of complex, shape (...)
        In m^d. Dr.Jit arrays and DataArrays as in :func:`fourier`.

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
    """Position marginal R_x(x): the autocorrelation integrated over lag, W(x, 0).

    For a uniform source it is the area of the lag slice at x.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        d = 2 for apertures and arrays of apertures, 1 for slits. Fields may be uniform, sums of
        plane waves, curved or partly coherent.
    x : array_like, shape (..., d)
        Positions in m.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of float, shape (...)
        In m^d. Dr.Jit arrays and DataArrays as in :func:`fourier`.

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
    """Lag marginal R_xi(xi): the autocorrelation integrated over position, A(0, xi).

    For a uniform source it is the area of the position slice: the area of the source times the
    optical transfer function of a pupil of this shape.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        d = 2 for apertures and arrays of apertures, 1 for slits. Fields may be uniform, sums of
        plane waves, curved or partly coherent.
    xi : array_like, shape (..., d)
        Lags in m.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray, shape (...)
        In m^d; real for a uniform source, complex for an Array and for a source with an
        illumination. Dr.Jit arrays and DataArrays as in :func:`fourier`.

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
    """Return int |u|^2 = R_xi(0) of a source, in m^d times the unit of |u|^2.

    Rounding may make it negative if elements cancel each other everywhere.
    """
    # NumPy computes a single value in less time than a kernel takes to compile.
    lag = np.zeros(kernels.kernel_for("ambiguity", flat_source(source)).dimension)
    return float(np.real(lag_marginal(source, lag, engine="numpy")))
