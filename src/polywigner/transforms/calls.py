"""The public transforms in one table, the one way that a call of them takes, and its plan.

A call goes through these steps, each of which leaves a simpler one: points behind an optical system
become points before it (O2), (O3); light that is coherent over a width becomes coherent light times
the degree of coherence, or a closed form (PC3); a curved wave becomes the flat one, sheared (Q1) to
(Q5); and the flat source has a kernel. With u = u0 exp(i pi (x - c).Q (x - c)):

    R(x, xi)  = R0(x, xi) exp(2 pi i (x - c).Q xi)
    W(x, nu)  = W0(x, nu - Q (x - c))
    A(up, xi) = A0(up - Q xi, xi) exp(-2 pi i c.Q xi)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution.choice import Plan
from polywigner.geometry import Aperture, Polyhedron, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_wavelength
from polywigner.kernels import is_separable
from polywigner.optics import FirstOrder
from polywigner.source import Array
from polywigner.transforms.checked_calls import (
    PhaseSpaceSource,
    broadcast_shape,
    checked_call,
    checked_points,
    empty_result,
    in_plane,
    kernel_of,
)
from polywigner.transforms.traced_sources import Differentiable, check_no_drjit, phase_space_of
from polywigner.transforms.wavefronts import (
    chirp_transform,
    coherent_source,
    degree_of_coherence,
    is_thin,
    mean_over_tilts,
    principal_axes,
    within_widths,
)
from polywigner.transforms.xarray_arguments import content_units, takes_xarray

_EXPLAINED = (
    "wigner", "ambiguity", "autocorrelation", "fourier", "position_marginal", "lag_marginal",
)  # fmt: skip

Values = NDArray[np.float64]
Points = Mapping[str, Any]
F = TypeVar("F", bound=Callable[..., Any])


@final
@dataclass(frozen=True)
class Transform:
    """A public transform: points, unit, and the change by curved or partly coherent waves."""

    points: tuple[str, ...]
    """Names of its points in the order of its arguments."""
    title: str
    units: Any = content_units
    is_real: bool = False
    plane: tuple[str, ...] = ()
    """Names of the position, or lag, and of the frequency that a system maps together."""
    whole: str | None = None
    """The transform whose value at zero of the other point it is."""
    takes_degree: bool = False
    """Whether partly coherent light multiplies it by the degree of coherence at its last point."""


TRANSFORMS = {
    "wigner": Transform(("x", "nu"), "Wigner function W(x, nu)", is_real=True, plane=("x", "nu")),
    "ambiguity": Transform(
        ("upsilon", "xi"),
        "ambiguity function A(upsilon, xi)",
        plane=("xi", "upsilon"),
        takes_degree=True,
    ),
    "autocorrelation": Transform(("x", "xi"), "autocorrelation R(x, xi)", "1", takes_degree=True),
    "fourier": Transform(("nu",), "Fourier transform F(nu)"),
    "position_marginal": Transform(
        ("x",), "position marginal R_x(x)", is_real=True, whole="wigner"
    ),
    "lag_marginal": Transform(
        ("xi",), "lag marginal R_xi(xi)", whole="ambiguity", takes_degree=True
    ),
    "fourier of waves": Transform(("nu",), "Fourier transform of a product of waves"),
    "array factor": Transform(("nu",), "array factor"),
}


def public(function: F) -> F:
    """Decorate a function of the table's name, so that its points may be DataArrays."""
    declared = TRANSFORMS[function.__name__]
    return takes_xarray(*declared.points, units=declared.units, long_name=declared.title)(function)


def compute(
    name: str,
    source: Any,
    points: Points,
    precision: str | None = None,
    engine: str = "auto",
    *,
    through: Any = None,
    wavelength: Any = None,
    shear: execution.Shear | None = None,
    in_closed_form: bool = False,
) -> Any:
    """Return a transform of any source that it takes, at any points.

    F of sources with waves and of arrays is :func:`polywigner.fourier`'s own: a sum over elements
    and waves. ``shear``: of NumPy's components, as :func:`polywigner.execution.evaluate` has it.
    ``in_closed_form``: of a partly coherent source with a flat wave, by its own kernel.
    """
    declared = TRANSFORMS[name]
    if through is not None or wavelength is not None:
        points = _before(name, source, points, through, wavelength)
        if not isinstance(source, Differentiable):
            source = source.at_wavelength(wavelength)
    if isinstance(source, Wavefront) and not in_closed_form:
        if not source.is_coherent:
            return _partly_coherent(name, source, points, (precision, engine))
        return _curved(name, source, points, (precision, engine))
    is_real = declared.is_real
    if declared.whole is not None:  # the lag marginal is real where the field is 1 on the source
        is_array = isinstance(source, Array)
        is_real |= not is_array and getattr(source, "illumination", None) is None
        whole = kernel_of(declared.whole, source, precision, engine)
        name, points = _of_whole(name, whole.dimension, points)
    if isinstance(source, Differentiable) and declared.plane:
        return phase_space_of(name, source, points, precision, engine, compute)
    for value in points.values():
        if type(value) is not np.ndarray and execution.is_drjit(value):
            return execution.evaluate_traced(
                kernel_of(name, source, precision, engine),
                source,
                list(points.items()),
                precision=precision,
                engine=engine,
                complex_result=not is_real,
            )
    kernel, components = checked_call(name, source, points, precision, engine)
    try:
        shape = np.broadcast_shapes(*[c.shape for c in components])
    except ValueError:
        broadcast_shape([np.asarray(value) for value in points.values()])
        raise
    result, parts = empty_result(shape, precision, 1 if is_real else 2)
    execution.evaluate(
        kernel,
        source,
        components,
        double=precision != "single",
        engine=engine,
        outputs=len(parts),
        into=parts,
        shear=shear,
    )
    return result[()]


def explain(
    source: PhaseSpaceSource | Polyhedron,
    *arguments: ArrayLike,
    function: str = "wigner",
    engine: execution.Engine = "auto",
    precision: execution.Precision = None,
) -> Plan:
    """Return the strategy and the engine of a call, and the reason for the choice.

    The choice depends on sizes alone (docs/performance.md): the same call uses the same strategy at
    every repetition.

    Parameters
    ----------
    source : as the function takes it. For ``"fourier"`` an Aperture, Slits or Polyhedron: that of
        an Array is a sum of several calls. One with a curved wave is explained as what is computed
        of its flat source; its F is always a sum over nodes along edges.
    arguments : those of the function, as NumPy arrays: x and nu for ``"wigner"``.
    function : "wigner", "ambiguity", "autocorrelation", "fourier", "position_marginal" or
        "lag_marginal".
    engine, precision : see :func:`fourier`.

    Returns
    -------
    A plan with the texts ``strategy``, ``engine`` and ``reason``; ``str()`` of it is three lines.

    Raises
    ------
    ArgumentError for a function that is not one of these, Dr.Jit arrays, and what the function
    itself would refuse; EngineError without the engine.

    For example, ``print(pw.explain(pw.shapes.square(0.01), (0.0, 0.0), (10.0, 20.0)))``.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(1.0)
    >>> print(pw.explain(square, (0.0, 0.0), (1.0, 0.0), engine="numpy").strategy)
    pairs of edges
    """
    names = TRANSFORMS[checked_choice(function, "function", _EXPLAINED)].points
    if len(arguments) != len(names):
        raise ArgumentError(
            f"expected {' and '.join(names)} for {function}, got {len(arguments)} arguments"
        )
    if any(map(execution.is_drjit, arguments)):
        raise ArgumentError(
            "expected NumPy arrays, got Dr.Jit arrays, which are computed where they are: there is "
            "no choice to explain"
        )
    name = function
    if function == "fourier" and isinstance(source, Array):
        raise ArgumentError(
            "expected one element for fourier, got an Array, of which F is a sum of several calls; "
            "explain that of an element"
        )
    if function == "fourier" and isinstance(source, Aperture):
        arguments = (in_plane(arguments[0]),)
        name = "fourier of waves" if is_separable(source) else name
    points: Mapping[str, Any] = dict(zip(names, arguments, strict=True))
    if isinstance(source, Wavefront):
        source, name, points = _as_flat(source, function, points)
    declared = TRANSFORMS.get(name)
    if declared is not None and declared.whole is not None:
        whole = kernel_of(declared.whole, source, precision, engine)
        name, points = _of_whole(name, whole.dimension, points)
    kernel, components = checked_call(name, source, points, precision, engine)
    return execution.explained(
        kernel, source, components, double=precision != "single", engine=engine
    )


def _as_flat(wave: Wavefront, name: str, points: Points) -> tuple[Any, str, Points]:
    """The flat source, as coherent as the wave, the transform and the points that a call comes to.

    Raises ArgumentError for F and means over tilts, which are no single call.
    """
    if name == "fourier":
        raise ArgumentError(
            "expected a flat wave for fourier, got a curved one, of which F is a sum over nodes "
            "along the edges, on NumPy: there is no choice to explain"
        )
    name, points = _of_whole(name, wave.dimension, points)
    points, source = _checked(wave, points), wave.source
    if name == "wigner":
        points["nu"] = points["nu"] - (points["x"] - wave.centre) @ wave.curvature
    elif name == "ambiguity":
        points["upsilon"] = points["upsilon"] - points["xi"] @ wave.curvature
    if wave.is_coherent or name != "wigner":
        return source, name, points
    source = Wavefront(source, coherence_width=wave.coherence_width)
    if kernels.partly_coherent_kernel(source) is None:
        raise ArgumentError(
            f"expected a source with a closed form of W in light that is coherent over "
            f"{wave.coherence_width:g} m, got an array whose W is a mean over "
            "tilts of coherent light; explain its .coherent"
        )
    return source, name, points


# --- optical systems: points of phase space behind them, as points before them


def _before(name: str, source: Any, points: Points, through: Any, wavelength: Any) -> Points:
    """A position and a frequency, or a lag and a frequency shift, as they were in the first plane.

    Both go by the same matrix, (x, lambda nu) and (xi, lambda upsilon): W_out of W, and A_out of A.
    Raises ArgumentError for a system without a wavelength, and the other way round.
    """
    if through is None:
        raise ArgumentError(
            f"expected wavelength with through= only, got {wavelength!r}; leave it out, or pass a "
            "FirstOrder"
        )
    if not isinstance(through, FirstOrder):
        raise ArgumentError(
            f"expected through as a polywigner.FirstOrder, got {type(through).__name__}"
        )
    if wavelength is None:
        raise ArgumentError("expected a wavelength with through=, got none; pass wavelength=...")
    length = checked_wavelength(wavelength)
    plain = source.source if isinstance(source, Differentiable | Wavefront) else source
    dimension = kernels.kernel_for(name, plain).dimension
    a, b, c, d = _blocks_for(through, dimension)
    place, frequency = TRANSFORMS[name].plane
    x, nu = (place, points[place]), (frequency, points[frequency])
    mapped = {
        place: _combined(dimension, (d.T, x), (-length * b.T, nu)),
        frequency: _combined(dimension, (a.T, nu), (-c.T / length, x)),
    }
    return {label: mapped[label] for label in points}


def _blocks_for(system: FirstOrder, dimension: int) -> tuple[Values, ...]:
    """A, B, C and D of sources in two dimensions, or (1, 1) of slits, which lie along x."""
    blocks = (system.A, system.B, system.C, system.D)
    if dimension == 2:
        return blocks
    if any(block[0, 1] or block[1, 0] for block in blocks):
        raise ArgumentError(
            "expected a system that keeps x and y apart for slits, got one that mixes them: "
            f"{system!r}"
        )
    return tuple(block[:1, :1] for block in blocks)


def _combined(dimension: int, *terms: tuple[Values, tuple[str, Any]]) -> Any:
    """Sum of matrices times points; zero matrices do not even broadcast."""
    present = [(matrix, point) for matrix, point in terms if matrix.any()]
    if any(execution.is_drjit(value) for _, (_, value) in present):
        found, kind = execution.components_of_all([point for _, point in present], dimension)
        whole = np.concatenate([matrix for matrix, _ in present], axis=1)
        return kind.points(execution.matrix_times(whole, [c for row in found for c in row]))
    arrays = [checked_points(*point, dimension, complex_allowed=False) for _, point in present]
    broadcast_shape(arrays)
    # without the elements that are zero: grids stay grids, and infinite points are no nan
    return sum(
        array @ matrix.T if (matrix - np.diag(np.diag(matrix))).any() else array * np.diag(matrix)
        for array, (matrix, _) in zip(arrays, present, strict=True)
    )


# --- partly coherent light


def _partly_coherent(name: str, wave: Wavefront, points: Points, how: tuple[Any, Any]) -> Any:
    """A transform of partly coherent light, by coherent light or in closed form.

    Raises IlluminationError for F, which there is in coherent light alone.
    """
    if name == "fourier":
        raise IlluminationError(
            f"expected a coherent source for {name}, got one that is coherent over "
            f"{wave.coherence_width:g} m, of which there is no spectrum with a phase; use "
            "polywigner.radiant_intensity, or wigner and ambiguity, which it has"
        )
    double, takes_degree = (
        execution.checked_precision(how[0]) != "single",
        TRANSFORMS[name].takes_degree,
    )
    has_closed_form = not takes_degree and kernels.partly_coherent_kernel(wave) is not None
    traced = [(label, value) for label, value in points.items() if execution.is_drjit(value)]
    if traced and not has_closed_form:
        label, _ = traced[0]
        raise ArgumentError(
            f"expected {label} as a NumPy array for a partly coherent source, got a Dr.Jit "
            f"array; use {label}.numpy()"
        )
    if traced:
        _, double = execution.checked_float(*traced[0], *how)
    points, coherent = _checked(wave, points), coherent_source(wave)
    if takes_degree:
        values = compute(name, coherent, points, *how)
        degree = degree_of_coherence(wave, list(points.values())[-1])
        return values * degree.astype(np.asarray(values).real.dtype)
    x, nu = _of_whole(name, wave.dimension, points)[1].values()

    def of_coherent(x: Any, nu: Any) -> Any:
        return compute("wigner", coherent, {"x": x, "nu": nu}, *how)

    if not has_closed_form:
        return mean_over_tilts(of_coherent, wave, nu, x, double=double)
    is_raised = not double and not traced and is_thin(wave)
    if is_raised:
        double, how = True, (None, how[1])

    def closed_form(held: Wavefront, x: Any, nu: Any) -> Any:
        return _curved("wigner", held, {"x": x, "nu": nu}, how)

    values = within_widths(closed_form, of_coherent, wave, x, nu, double)
    return values.astype(np.float32) if is_raised else values


# --- curved waves


def _of_whole(name: str, dimension: int, points: Points) -> tuple[str, Points]:
    """A marginal as the value of the whole function, whose other point is zero."""
    whole = TRANSFORMS[name].whole
    if whole is None:
        return name, points
    none = np.zeros(dimension)
    return whole, {label: points.get(label, none) for label in TRANSFORMS[whole].points}


def _checked(wave: Wavefront, points: Points) -> dict[str, Any]:
    """Points as the flat source takes them, of the right shape."""
    dimension = kernels.kernel_for("wigner", wave.source).dimension
    return {
        name: p
        if execution.is_drjit(p)
        else checked_points(name, p, dimension, complex_allowed=False)
        for name, p in points.items()
    }


def _curved(name: str, wave: Wavefront, points: Points, how: tuple[Any, Any]) -> Any:
    """Transform of a curved wave by the transform of the flat source, as coherent as the wave."""
    if name == "fourier":
        return _curved_spectrum(wave, points["nu"], *how)
    name, points = _of_whole(name, wave.dimension, points)
    points, flat, plane = _checked(wave, points), wave.source, TRANSFORMS[name].plane
    if not wave.is_coherent:
        flat = Wavefront(flat, coherence_width=wave.coherence_width)
    evaluate = partial(
        compute, name, flat, precision=how[0], engine=how[1], in_closed_form=not wave.is_coherent
    )
    if name == "wigner":
        return _sheared(evaluate, wave, points, plane)
    if name == "autocorrelation":
        value = evaluate(points=points)
        return _turned(value, wave, points, lambda x, xi: _dot(_slopes(wave, x), xi))
    about_origin = wave._with(centre=np.zeros(wave.dimension))
    value = _sheared(evaluate, about_origin, points, plane)
    slope = (wave.curvature @ wave.centre).tolist()
    return _turned(value, wave, points, lambda _, xi: -_dot(slope, xi)) if any(slope) else value


def _slopes(wave: Wavefront, x: Sequence[Any]) -> list[Any]:
    """The components of Q (x - c), the frequency of the wave at x."""
    inner = [c - o for c, o in zip(x, wave.centre.tolist(), strict=True)]
    return execution.matrix_times(wave.curvature, inner)


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum(p * q for p, q in zip(a, b, strict=True))


def _sheared(
    evaluate: Callable[..., Any], wave: Wavefront, points: Points, plane: tuple[str, ...]
) -> Any:
    """W or A of the flat source at a place, at the frequency relative to the wave's there."""
    place, frequency = (list(points).index(label) for label in plane)
    d = wave.dimension

    def moved(groups: list[list[Any]]) -> list[Any]:
        slopes = _slopes(wave, groups[place])
        return [n - s for n, s in zip(groups[frequency], slopes, strict=True)]

    def shear(components: Sequence[Any]) -> Sequence[Any]:
        groups = [list(components[:d]), list(components[d:])]
        groups[frequency] = moved(groups)
        return groups[0] + groups[1]

    if not any(map(execution.is_drjit, points.values())):
        return evaluate(points=points, shear=shear)
    found, kind = execution.components_of_all(list(points.items()), d)
    return evaluate(points={**points, plane[1]: kind.points(moved(found))})


def _turned(value: Any, wave: Wavefront, points: Points, turns: Callable[..., Any]) -> Any:
    """A value times exp(2 pi i turns), in its own precision; turns of the points' components."""
    if any(map(execution.is_drjit, points.values())):
        found, kind = execution.components_of_all(list(points.items()), wave.dimension)
        return kind.turned(value, turns(*found))
    angle = turns(*([p[..., k] for k in range(wave.dimension)] for p in points.values()))
    phase = np.exp(2j * math.pi * (angle - np.round(angle)))
    return (value * phase).astype(np.asarray(value).dtype)[()]


def _curved_spectrum(wave: Wavefront, nu: Any, precision: str | None, engine: Any) -> Any:
    """F of a curved wave, Fresnel integrals along edges, on NumPy."""
    dimension = kernels.kernel_for("wigner", wave.source).dimension
    check_no_drjit(nu=nu)
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
