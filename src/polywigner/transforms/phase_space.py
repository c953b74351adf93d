"""Autocorrelation, Wigner and ambiguity functions, and the marginals."""

from __future__ import annotations

from typing import Any

import numpy as np

from polywigner import kernels
from polywigner.execution import Differentiable, Engine, Precision
from polywigner.geometry.arguments import Points
from polywigner.optics import FirstOrder
from polywigner.transforms.calls import compute, public
from polywigner.transforms.checked_calls import PhaseSpaceSource
from polywigner.transforms.wavefronts import flat_of


@public
def autocorrelation(
    source: PhaseSpaceSource,
    x: Points,
    xi: Points,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Autocorrelation R(x, xi) = u(x + xi/2) conj(u(x - xi/2)) of the field at two points.

    Source: the paper's eq. (auto_lag). Points on the boundary belong to the source on its left and
    lower sides.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), uniform or with an illumination, or an Array of
        either; or one with a curved or partly coherent wave.
    x : (..., d) positions, the mean of the two points, in m.
    xi : (..., d) lags, their difference, in m; broadcasts against ``x``.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) complex, without unit; 0 or 1 for a uniform source. Dr.Jit input as in :func:`fourier`.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

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
) -> Any:
    """Wigner function W(x, nu) = integral of u(x + xi/2) u*(x - xi/2) exp(-2 pi i nu.xi) d xi.

    Closed form: the Fourier transform of the lag slice at x. Differs from the paper in the slice:
    its M matrices must translate by 2x. Of an Array: (W2), elements that overlap included. Cost:
    edges times the edges that can cross them. Frequencies at one x share the slice.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), uniform or with an illumination, or an Array of
        either; or of :func:`differentiable`.
    x : (..., d) positions in m.
    nu : (..., d) real spatial frequencies in 1/m; broadcasts against ``x``.
    through : a :class:`FirstOrder` between the source and the plane of ``x`` and ``nu``: W there is
        that of the source where the ray came from, (O2). Of slits, one that keeps x and y apart.
    wavelength : in m, with ``through`` only.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^d; zero outside the automean. float32 for single precision.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

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
) -> Any:
    """Ambiguity function: integral of u(x + xi/2) u*(x - xi/2) exp(-2 pi i upsilon.x) d x.

    Closed form: the Fourier transform of the position slice at xi. Differs from the paper, which
    prints x.xi in the kernel. Cost: twice edges times the edges that can cross them.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), uniform or with an illumination, or an Array of
        either; or of :func:`differentiable`.
    upsilon : (..., d) real frequency shifts in 1/m.
    xi : (..., d) lags in m; broadcasts against ``upsilon``.
    through : a :class:`FirstOrder` between the source and the plane of the lags, (O3). Of slits,
        one that keeps x and y apart.
    wavelength : in m, with ``through`` only.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) complex, in m^d; Dr.Jit input as in :func:`fourier`.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

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
) -> Any:
    """R_x(x): the autocorrelation integrated over lag, the area of the lag slice at x.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), uniform or with an illumination, or an Array of
        either; or one with a curved or partly coherent wave.
    x : (..., d) positions in m.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^d; equal to W(x, 0).
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> round(float(pw.position_marginal(square, (0.5, 0.0))), 12)
    8.0
    """
    return compute("position_marginal", source, {"x": x}, precision, engine)


@public
def lag_marginal(
    source: PhaseSpaceSource, xi: Points, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """R_xi(xi): the autocorrelation integrated over position, the area of the position slice.

    For a uniform source its area times the optical transfer function of a pupil of this shape.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), uniform or with an illumination, or an Array of
        either.
    xi : (..., d) lags in m.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) in m^d, equal to A(0, xi): real for a uniform source, complex for an Array and for a
    source with an illumination.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> float(pw.lag_marginal(square, (0.5, 0.0)))
    3.0
    """
    return compute("lag_marginal", source, {"xi": xi}, precision, engine)


def energy_of(source: PhaseSpaceSource) -> float:
    """int |u|^2 = R_xi(0) of a source, in m^d times the unit of |u|^2.

    Rounding may make it negative where elements cancel each other everywhere.
    """
    # NumPy: one value is less work than the compilation of a kernel.
    lag = np.zeros(kernels.kernel_for("ambiguity", flat_of(source)).dimension)
    return float(np.real(lag_marginal(source, lag, engine="numpy")))
