"""Curved waves in the public transforms: each is what the flat source has, sheared (Q1) to (Q5).

The one place where transforms take a Wavefront apart. With u = u0 exp(i pi (x - c).Q (x - c)):

    R(x, xi)  = R0(x, xi) exp(2 pi i (x - c).Q xi)
    W(x, nu)  = W0(x, nu - Q (x - c))
    A(up, xi) = A0(up - Q xi, xi) exp(-2 pi i c.Q xi)
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry import Wavefront
from polywigner.transforms.arguments import checked_points, in_plane, transform
from polywigner.transforms.coherence import is_partly_coherent, partly_coherent
from polywigner.transforms.curved_spectrum import chirp_transform, principal_axes
from polywigner.transforms.through import before

__all__ = ["POINTS_OF", "as_flat", "checked_wavefront", "flat_of", "sheared", "takes_wavefronts"]

POINTS_OF = {
    "autocorrelation": ("x", "xi"),
    "wigner": ("x", "nu"),
    "ambiguity": ("upsilon", "xi"),
}

F = TypeVar("F", bound=Callable[..., Any])


def takes_wavefronts(function: F) -> F:
    """A decorator of a transform (source, points..., **how): its source may be a Wavefront."""
    of_wavefront = _TRANSFORMS[function.__name__]
    names = list(inspect.signature(function).parameters)

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        source = args[0] if args else kwargs.get("source")
        if not isinstance(source, Wavefront):
            return function(*args, **kwargs)
        given = dict(zip(names, args, strict=False)) | kwargs
        inspect.signature(function).bind(**given)  # its TypeError for what is missing
        how = {name: value for name, value in given.items() if name != "source"}
        how = _before_system(function.__name__, source, how)
        if is_partly_coherent(source):
            return partly_coherent(function.__name__, _PUBLIC, _wigner, source, how)
        return of_wavefront(checked_wavefront(source), **how)

    _PUBLIC[function.__name__] = wrapper
    return wrapper  # type: ignore[return-value]


# What the decorator has made, for partly coherent sources.
_PUBLIC: dict[str, Callable[..., Any]] = {}


def flat_of(source: Any) -> Any:
    """The flat source of a Wavefront; any other source as it is."""
    return source.source if isinstance(source, Wavefront) else source


def checked_wavefront(wave: Wavefront) -> Wavefront:
    """The source, unless it is one that transforms do not take.

    Raises IlluminationError for one that is partly coherent.
    """
    if not wave.is_coherent:
        raise IlluminationError(
            "expected a coherent source, got one that is coherent over "
            f"{wave.coherence_width:g} m, of which there is no field with a phase; use "
            "polywigner.irradiance or radiant_intensity, which take it"
        )
    return wave


def as_flat(
    wave: Wavefront, function: str, points: Sequence[Any]
) -> tuple[Any, str, tuple[Any, ...]]:
    """The flat source, the transform and NumPy's points that a call with a Wavefront comes to.

    Raises ArgumentError for F, which is no call of another transform.
    """
    checked_wavefront(wave)
    none = np.zeros(wave.dimension)
    if function == "autocorrelation":
        return wave.source, function, tuple(_checked(wave, function, x=points[0], xi=points[1]))
    if function in ("wigner", "position_marginal"):
        x, nu = _checked(wave, "wigner", x=points[0], nu=[*points, none][1])
        return wave.source, "wigner", (x, nu - _slope(wave, x))
    if function in ("ambiguity", "lag_marginal"):
        upsilon, xi = _checked(wave, "ambiguity", upsilon=[none, *points][-2], xi=points[-1])
        return wave.source, "ambiguity", (upsilon - xi @ wave.curvature, xi)
    raise ArgumentError(
        "expected a flat wave for fourier, got a curved one, of which F is a sum over nodes along "
        "the edges, on NumPy: there is no choice to explain"
    )


def sheared(wave: Wavefront, nu: Any, x: Any) -> Any:
    """nu - Q (x - c), where the flat source has the value of the curved one; Dr.Jit's arrays."""
    found, kind = execution.components_of_all([("nu", nu), ("x", x)], wave.dimension)
    return kind.points([a - b for a, b in zip(found[0], _slopes(wave, found[1]), strict=True)])


def _slope(wave: Wavefront, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Q (x - c), the frequency of the curved wave at x."""
    return np.asarray((x - wave.centre) @ wave.curvature)


def _slopes(wave: Wavefront, x: Sequence[Any]) -> list[Any]:
    """The components of Q (x - c)."""
    inner = [c - o for c, o in zip(x, wave.centre.tolist(), strict=True)]
    return execution.matrix_times(wave.curvature, inner)


def _checked(wave: Wavefront, what: str, **points: Any) -> list[Any]:
    """Points as the flat source takes them, of the right shape."""
    dimension = kernels.kernel_for(what, wave.source).dimension
    return [
        p if execution.is_drjit(p) else checked_points(name, p, dimension, complex_allowed=False)
        for name, p in points.items()
    ]


def _autocorrelation(wave: Wavefront, x: Any, xi: Any, **how: Any) -> Any:
    x, xi = _checked(wave, "autocorrelation", x=x, xi=xi)
    value = _flat("autocorrelation", wave, [x, xi], 2, **how)
    if not (execution.is_drjit(x) or execution.is_drjit(xi)):
        return _turned(value, np.sum(_slope(wave, x) * xi, axis=-1))
    found, kind = execution.components_of_all([("x", x), ("xi", xi)], wave.dimension)
    products = zip(_slopes(wave, found[0]), found[1], strict=True)
    return kind.turned(value, sum(a * b for a, b in products))


def _before_system(name: str, wave: Wavefront, given: dict[str, Any]) -> dict[str, Any]:
    """The arguments of a call behind a system as one without it: points as they were before."""
    rest = {key: value for key, value in given.items() if key not in ("through", "wavelength")}
    through, wavelength = given.get("through"), given.get("wavelength")
    if through is None and wavelength is None:
        return rest
    first, second = POINTS_OF[name] if name == "wigner" else POINTS_OF[name][::-1]
    named = ((first, given[first]), (second, given[second]))
    points = before(name, wave.source, through, wavelength, *named)
    return rest | dict(zip((first, second), points, strict=True))


def _wigner(wave: Wavefront, x: Any, nu: Any, **how: Any) -> Any:
    x, nu = _checked(wave, "wigner", x=x, nu=nu)
    return _of_sheared("wigner", wave, x, nu, 1, how)


def _position_marginal(wave: Wavefront, x: Any, **how: Any) -> Any:
    return _wigner(wave, x, np.zeros(wave.dimension), **how)


def _ambiguity(wave: Wavefront, upsilon: Any, xi: Any, **how: Any) -> Any:
    upsilon, xi = _checked(wave, "ambiguity", upsilon=upsilon, xi=xi)
    about_origin = wave._with(centre=np.zeros(wave.dimension))
    value = _of_sheared("ambiguity", about_origin, xi, upsilon, 2, how)
    slope = wave.curvature @ wave.centre
    if not slope.any():
        return value
    if not (execution.is_drjit(upsilon) or execution.is_drjit(xi)):
        return _turned(value, -(xi @ slope))
    both = [("upsilon", upsilon), ("xi", xi)]
    found, kind = execution.components_of_all(both, wave.dimension)
    return kind.turned(value, -sum(a * s for a, s in zip(found[1], slope.tolist(), strict=True)))


def _lag_marginal(wave: Wavefront, xi: Any, **how: Any) -> Any:
    return _ambiguity(wave, np.zeros(wave.dimension), xi, **how)


def _fourier(wave: Wavefront, nu: Any, obliquity: Any = None, **how: Any) -> Any:
    if obliquity is not None:
        raise ArgumentError(f"expected no obliquity for a curved wave, got {obliquity!r}")
    dimension = kernels.kernel_for("wigner", wave.source).dimension
    precision, engine = how.get("precision"), how.get("engine", "auto")
    if execution.is_drjit(nu):
        compute = functools.partial(_spectrum, wave)
        return execution.evaluate_hosted(
            compute, "nu", in_plane(nu), dimension, precision=precision, engine=engine
        )
    execution.checked_engine(engine)
    points = in_plane(nu) if dimension == 2 else nu
    points = checked_points("nu", points, dimension, complex_allowed=True)
    if np.iscomplexobj(points):
        raise ArgumentError(
            "expected real nu for a curved wave, got complex numbers; use nu.real, or the flat "
            "source for evanescent waves"
        )
    return _spectrum(wave, points, precision=precision)


def _spectrum(wave: Wavefront, nu: Any, precision: str | None) -> Any:
    """F at NumPy's points (..., d)."""
    single = execution.checked_precision(precision) == "single"
    q, axes = principal_axes(wave.curvature)
    flat = nu.reshape(-1, wave.dimension)
    values = chirp_transform(wave.source, q, axes, wave.centre, flat).reshape(nu.shape[:-1])
    return values.astype(np.complex64)[()] if single else values[()]


def _of_sheared(
    name: str, wave: Wavefront, place: Any, frequency: Any, outputs: int, how: dict[str, Any]
) -> Any:
    """W or A of the flat source at a place and at the frequency less that of the wave there."""
    leads, d = name == "wigner", wave.dimension
    if execution.is_drjit(place) or execution.is_drjit(frequency):
        pair = [place, sheared(wave, frequency, place)]
        return _flat(name, wave, pair if leads else pair[::-1], outputs, **how)

    def shear(components: Sequence[Any]) -> Sequence[Any]:
        first, second = list(components[:d]), list(components[d:])
        x, nu = (first, second) if leads else (second, first)
        moved = [n - s for n, s in zip(nu, _slopes(wave, x), strict=True)]
        return [*x, *moved] if leads else [*moved, *x]

    points = [place, frequency] if leads else [frequency, place]
    return _flat(name, wave, points, outputs, shear=shear, **how)


def _flat(
    name: str, wave: Wavefront, points: Sequence[Any], outputs: int, shear: Any = None, **how: Any
) -> Any:
    """A transform of the flat source, as coherent as the wave."""
    named = list(zip(POINTS_OF[name], points, strict=True))
    flat = wave.source
    if not wave.is_coherent:
        flat = Wavefront(flat, coherence_width=wave.coherence_width)
    precision, engine = how.get("precision"), how.get("engine", "auto")
    return transform(name, flat, named, precision, engine, outputs=outputs, shear=shear)


def _turned(value: Any, turns: Any) -> Any:
    """A value times exp(2 pi i turns), in its own precision."""
    wave = np.exp(2j * math.pi * (turns - np.round(turns)))
    return (value * wave).astype(np.asarray(value).dtype)[()]


_TRANSFORMS: dict[str, Callable[..., Any]] = {
    "fourier": _fourier,
    "autocorrelation": _autocorrelation,
    "wigner": _wigner,
    "ambiguity": _ambiguity,
    "position_marginal": _position_marginal,
    "lag_marginal": _lag_marginal,
}
