"""The public transforms: Fourier, Wigner and ambiguity functions of sources, and the marginals.

Sources are apertures (plane polygons, two components), slits (one), and, for the Fourier transform
alone, apertures in a pose and polyhedra (three). "Content" is length, area or volume.

Conventions (docs/conventions): Fourier kernel exp(-2 pi i nu.x); nu and upsilon in cycles per
unit length; the last axis of every argument holds the components, everything before it
broadcasts; the result has the broadcast shape without that axis, and one point gives a NumPy
scalar. Lengths are in the source's unit (metres), results in its power of the dimension.

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
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits

__all__ = ["ambiguity", "fourier", "lag_marginal", "position_marginal", "wigner"]

PhaseSpaceSource = Aperture | Slits
Source = PhaseSpaceSource | PlacedAperture | Polyhedron


def fourier(
    source: Source, nu: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """Fourier transform (SFT) of a source: F(nu) = integral of exp(-2 pi i nu.x) over it.

    Closed form, at any nu, zero included (docs/theory.md, (F2), (F3), (S1)). Differs from the
    paper's eq. (FVT), which prints the exp(+) kernel and is singular at nu = 0; its factor
    (nu/|nu|).n for collections is an obliquity and not part of the transform. Cost: linear in the
    edges, or in the triangles of a polyhedron's faces.

    Parameters
    ----------
    source : Aperture, Slits, placed aperture or Polyhedron; |u| = 1 on it.
    nu : (..., d) spatial frequencies in 1/m, real or complex (evanescent or absorbed waves). d = 1
        for Slits, 3 for polyhedra and placed apertures, 2 for an Aperture, or 3, of which the last
        component does not matter: without a pose it lies in the plane z = 0.
    precision : "double", "single", or None: double for NumPy input, its own for Dr.Jit input.
    engine : "auto", "numpy", "llvm" or "cuda".

    Returns
    -------
    (...) complex, in m^d; complex64 for single precision. Dr.Jit input gives ``Complex2f``, or
    for tensors a tensor (..., 2) of real and imaginary parts.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    if isinstance(source, Aperture):
        nu = _in_plane(nu)
    return _transform("fourier", source, [("nu", nu)], precision, engine, outputs=2)


def wigner(
    source: PhaseSpaceSource,
    x: Any,
    nu: Any,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Wigner function W(x, nu) = integral of u(x + xi/2) u*(x - xi/2) exp(-2 pi i nu.xi) d xi.

    Closed form: the Fourier transform of the lag slice at x. Differs from the paper in the slice:
    its M matrices must translate by 2x. Cost: edges times sides of the convex pieces.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), |u| = 1 on it.
    x : (..., d) positions in m.
    nu : (..., d) real spatial frequencies in 1/m; broadcasts against ``x``.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^d; zero outside the automean. float32 for single precision.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    return _transform("wigner", source, [("x", x), ("nu", nu)], precision, engine)


def ambiguity(
    source: PhaseSpaceSource,
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
    source : Aperture (d = 2) or Slits (d = 1), |u| = 1 on it.
    upsilon : (..., d) real frequency shifts in 1/m.
    xi : (..., d) lags in m; broadcasts against ``upsilon``.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) complex, in m^d; Dr.Jit input as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    points = [("upsilon", upsilon), ("xi", xi)]
    return _transform("ambiguity", source, points, precision, engine, outputs=2)


def position_marginal(
    source: PhaseSpaceSource, x: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """R_x(x): the autocorrelation integrated over lag, the area of the lag slice at x.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), |u| = 1 on it.
    x : (..., d) positions in m.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^d; equal to W(x, 0).

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    return _transform("position_marginal", source, [("x", x)], precision, engine)


def lag_marginal(
    source: PhaseSpaceSource, xi: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """R_xi(xi): the autocorrelation integrated over position, the area of the position slice.

    The area times the optical transfer function of a pupil of this shape.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), |u| = 1 on it.
    xi : (..., d) lags in m.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in m^d; equal to A(0, xi).

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    return _transform("lag_marginal", source, [("xi", xi)], precision, engine)


def _in_plane(nu: Any) -> Any:
    """The first two components of three: an aperture without a pose lies in the plane z = 0."""
    if engines.is_drjit(nu):
        return engines.in_plane(nu)
    array = np.asarray(nu)
    return array[..., :2] if array.ndim and array.shape[-1] == 3 else nu


def _transform(
    name: str,
    source: Source,
    points: Sequence[tuple[str, Any]],
    precision: str | None,
    engine: str,
    *,
    outputs: int = 1,
) -> Any:
    """Check the arguments once, and hand them to the engine of their type."""
    kernel = kernels.kernel_for(name, source)
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
    arrays = [
        _points(*point, kernel.dimension, complex_allowed=name == "fourier") for point in points
    ]
    components = [a[..., k] for a in arrays for k in range(kernel.dimension)]
    if any(np.iscomplexobj(a) for a in arrays):
        kernel = kernels.kernel_for(f"complex {name}", source)
        components = [part for c in components for part in (c.real, c.imag)]
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


def _complex(real: Any, imag: Any) -> Any:
    result = np.empty(real.shape, np.complex64 if real.dtype == np.float32 else np.complex128)
    result.real, result.imag = real, imag
    return result


def _points(name: str, value: Any, dimension: int, complex_allowed: bool) -> Any:
    """An array (..., dimension) of float64 or complex128."""
    shape = f"(..., {dimension})"
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "biufc":
        raise ArgumentError(
            f"expected {name} as numbers of shape {shape}, got {type(value).__name__} that is "
            "not an array of numbers"
        )
    if array.ndim == 0 or array.shape[-1] != dimension:
        raise ArgumentError(
            f"expected {name} of shape {shape}, components last, got shape {array.shape}"
        )
    if array.dtype.kind == "c":
        if not complex_allowed:
            raise ArgumentError(f"expected {name} to be real, got complex numbers; use {name}.real")
        return array.astype(np.complex128, copy=False)
    return array.astype(np.float64, copy=False)
