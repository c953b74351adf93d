"""The public transforms: Fourier, Wigner and ambiguity functions of apertures, and the marginals.

Conventions (docs/conventions): Fourier kernel exp(-2 pi i nu.x); nu and upsilon in cycles per
unit length; the last axis of every argument holds the two components, everything before it
broadcasts; the result has the broadcast shape without that axis, and one point gives a NumPy
scalar. Lengths are in the aperture's unit (metres), results in its square.

Formulas: docs/theory.md. Accuracy: |error| <= 1e-12 area in float64 and 5e-6 area in float32, for
|nu| times diameter up to 1e3 and all positions, including those where edges of the two copies
coincide.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from polywigner import engines, kernels
from polywigner.engines import Engine, Precision
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture

__all__ = ["ambiguity", "fourier", "lag_marginal", "position_marginal", "wigner"]


def fourier(
    source: Aperture, nu: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """Fourier transform (SFT) of an aperture: F(nu) = integral of exp(-2 pi i nu.x) over it.

    Closed form, at any nu, zero included. Differs from the paper's eq. (FVT), which prints the
    exp(+) kernel and is singular at nu = 0. Cost: linear in the edges.

    Parameters
    ----------
    source : the aperture, |u| = 1 on it.
    nu : (..., 2) spatial frequencies in 1/m, real or complex (evanescent or absorbed waves).
    precision : "double", "single", or None: double for NumPy input, its own for Dr.Jit input.
    engine : "auto", "numpy", "llvm" or "cuda".

    Returns
    -------
    (...) complex, in m^2; complex64 for single precision. Dr.Jit input gives ``Complex2f``, or
    for tensors a tensor (..., 2) of real and imaginary parts.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    return _transform(
        kernels.FOURIER, source, [("nu", nu)], precision, engine, outputs=2, complex_arguments=True
    )


def wigner(
    source: Aperture, x: Any, nu: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """Wigner function W(x, nu) = integral of u(x + xi/2) u*(x - xi/2) exp(-2 pi i nu.xi) d xi.

    Closed form: the Fourier transform of the lag slice at x. Differs from the paper in the slice:
    its M matrices must translate by 2x. Cost: edges times sides of the convex pieces.

    Parameters
    ----------
    source : the aperture, |u| = 1 on it.
    x : (..., 2) positions in m.
    nu : (..., 2) real spatial frequencies in 1/m; broadcasts against ``x``.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^2; zero outside the automean. float32 for single precision.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    return _transform(kernels.WIGNER, source, [("x", x), ("nu", nu)], precision, engine)


def ambiguity(
    source: Aperture,
    upsilon: Any,
    xi: Any,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Ambiguity function: integral of u(x + xi/2) u*(x - xi/2) exp(-2 pi i upsilon.x) d x.

    Closed form: the Fourier transform of the position slice at xi. Differs from the paper, which
    prints x.xi in the kernel. Cost: twice edges times sides of the convex pieces.

    Parameters
    ----------
    source : the aperture, |u| = 1 on it.
    upsilon : (..., 2) real frequency shifts in 1/m.
    xi : (..., 2) lags in m; broadcasts against ``upsilon``.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) complex, in m^2; Dr.Jit input as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    points = [("upsilon", upsilon), ("xi", xi)]
    return _transform(kernels.AMBIGUITY, source, points, precision, engine, outputs=2)


def position_marginal(
    source: Aperture, x: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """R_x(x): the autocorrelation integrated over lag, the area of the lag slice at x.

    Parameters
    ----------
    source : the aperture, |u| = 1 on it.
    x : (..., 2) positions in m.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^2; equal to W(x, 0).

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    return _transform(kernels.POSITION_MARGINAL, source, [("x", x)], precision, engine)


def lag_marginal(
    source: Aperture, xi: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """R_xi(xi): the autocorrelation integrated over position, the area of the position slice.

    The area times the optical transfer function of a pupil of this shape.

    Parameters
    ----------
    source : the aperture, |u| = 1 on it.
    xi : (..., 2) lags in m.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^2; equal to A(0, xi).

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    return _transform(kernels.LAG_MARGINAL, source, [("xi", xi)], precision, engine)


def _transform(
    kernel: kernels.Kernel,
    source: Aperture,
    points: Sequence[tuple[str, Any]],
    precision: str | None,
    engine: str,
    *,
    outputs: int = 1,
    complex_arguments: bool = False,
) -> Any:
    """Check the arguments once, and hand them to the engine of their type."""
    if not isinstance(source, Aperture):
        raise ArgumentError(
            f"expected source to be an Aperture, got {type(source).__name__}; "
            "make one with polywigner.Aperture(vertices)"
        )
    engines.checked_precision(precision)
    engines.checked_engine(engine)
    if any(engines.is_drjit(value) for _, value in points):
        return engines.evaluate_traced(
            kernel,
            source,
            points,
            precision=precision,
            engine=engine,
            complex_result=outputs == 2,
        )
    arrays = [_points(name, value, complex_arguments) for name, value in points]
    if any(np.iscomplexobj(a) for a in arrays):
        kernel = kernels.FOURIER_COMPLEX
        components = [part for a in arrays for k in (0, 1) for part in _parts(a[..., k])]
    else:
        components = [a[..., k] for a in arrays for k in (0, 1)]
    try:
        np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    except ValueError:
        shapes = " and ".join(str(a.shape) for a in arrays)
        raise ArgumentError(
            f"expected shapes that broadcast before the last axis, got {shapes}; "
            "insert axes of length 1, as in x[:, None, :]"
        ) from None
    results = engines.evaluate(
        kernel,
        source,
        components,
        double=precision != "single",
        engine=engine,
        outputs=outputs,
    )
    return results[0][()] if outputs == 1 else _complex(*results)[()]


def _parts(values: Any) -> tuple[Any, Any]:
    return values.real, values.imag


def _complex(real: Any, imag: Any) -> Any:
    result = np.empty(real.shape, np.complex64 if real.dtype == np.float32 else np.complex128)
    result.real, result.imag = real, imag
    return result


def _points(name: str, value: Any, complex_allowed: bool) -> Any:
    """An array (..., 2) of float64 or complex128."""
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "biufc":
        raise ArgumentError(
            f"expected {name} as numbers of shape (..., 2), got {type(value).__name__} that is "
            "not an array of numbers"
        )
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ArgumentError(
            f"expected {name} of shape (..., 2), two components last, got shape {array.shape}"
        )
    if array.dtype.kind == "c":
        if not complex_allowed:
            raise ArgumentError(f"expected {name} to be real, got complex numbers; use {name}.real")
        return array.astype(np.complex128, copy=False)
    return array.astype(np.float64, copy=False)
