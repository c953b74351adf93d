"""The common implementation of the public transforms.

Points behind an optical system are mapped to points in front of it by equations (O2) and (O3). A
partially coherent source is replaced by a coherent source times the degree of coherence, or by a
closed form, equation (PC3). A curved wave is replaced by a flat wave at sheared points, equations
(Q1) to (Q5). A kernel computes the transform of the flat source. For the curved wave u = u0 exp(i
pi (x - c).Q (x - c)), which touches the plane of the source at c and has the curvature matrix Q,

    R(x, xi)  = R0(x, xi) exp(2 pi i (x - c).Q xi)
    W(x, nu)  = W0(x, nu - Q (x - c))
    A(up, xi) = A0(up - Q xi, xi) exp(-2 pi i c.Q xi)

Points are NumPy arrays of shape (..., d) or Dr.Jit component arrays. Results are NumPy arrays or
Dr.Jit arrays of type ``Float`` or ``Complex2f``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution import Differentiable
from polywigner.execution.choice import Plan
from polywigner.geometry import Aperture, Polyhedron, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_wavelength
from polywigner.kernels import is_separable
from polywigner.optics import FirstOrder
from polywigner.source import Array
from polywigner.transforms.checked_calls import (
    PhaseSpaceSource,
    Values,
    broadcast_shape,
    checked_points,
    empty_result,
    in_plane,
    kernel_of,
)
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import (
    chirp_transform,
    coherent_source,
    degree_of_coherence,
    mean_over_tilts,
    principal_axes,
    wigner_at_any_width,
)
from polywigner.transforms.xarray_arguments import content_units, takes_xarray

_EXPLAINED = (
    "wigner", "ambiguity", "autocorrelation", "fourier", "position_marginal", "lag_marginal",
)  # fmt: skip

Points = Mapping[str, Any]
Options = tuple[str | None, str]
"""The options ``precision`` and ``engine`` of a call."""
F = TypeVar("F", bound=Callable[..., object])


@final
@dataclass(frozen=True)
class Transform:
    """A public transform: its arguments, its unit, and its relation to other transforms."""

    points: tuple[str, ...]
    title: str
    units: Any = content_units
    is_real: bool = False
    plane: tuple[str, ...] = ()
    """Names of the two arguments, position or lag and frequency, that an optical system maps."""
    full: str | None = None
    """For a marginal, the transform that equals the marginal if its other argument is zero."""
    takes_degree: bool = False
    """Whether partial coherence adds the degree of coherence at the last argument as a factor."""


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
    "position_marginal": Transform(("x",), "position marginal R_x(x)", is_real=True, full="wigner"),
    "lag_marginal": Transform(
        ("xi",), "lag marginal R_xi(xi)", full="ambiguity", takes_degree=True
    ),
    "fourier of waves": Transform(("nu",), "Fourier transform of a product of waves"),
    "array factor": Transform(("nu",), "array factor"),
}


def public(function: F) -> F:
    """Decorate a public transform so that it accepts DataArrays as points."""
    declared = TRANSFORMS[function.__name__]
    return takes_xarray(*declared.points, units=declared.units, long_name=declared.title)(function)


def compute(
    name: str,
    source: Any,
    points: Points,
    precision: str | None = None,
    engine: str = "auto",
    *,
    through: FirstOrder | None = None,
    wavelength: float | None = None,
) -> Values:
    """Return a public transform of a source at NumPy points or Dr.Jit points.

    ``points``: arguments of the transform, with their names as keys. The Fourier transform of
    arrays and of sources with several waves is computed by :func:`polywigner.fourier`. ``through``
    and ``wavelength`` [m] must be specified together. The points are then points behind the optical
    system.
    """
    how, restored = (precision, engine), None
    is_differentiable = isinstance(source, Differentiable)
    if is_differentiable or execution.has_drjit(points.values()):
        numbers = source.numbers if is_differentiable else {}
        points, restored = execution.component_arrays(points, numbers, precision, engine)
    if through is not None or wavelength is not None:
        points = _mapped_points(name, source, through, wavelength, points)
        source = source if is_differentiable else source.at_wavelength(wavelength)
    transform: Callable[..., Values] = _of_flat_wave
    if isinstance(source, Wavefront):
        transform = _of_curved_wave if source.is_coherent else _of_partly_coherent_wave
    value = transform(name, source, points, how)
    return value if restored is None else restored(value)


def _as_full_transform(name: str, source: Any, points: Points) -> tuple[bool, str, Points]:
    """Replace a marginal by a transform with one argument of zero, which has the same values.

    Returns whether the values are real, the name of the transform, and its points. The lag
    marginal of a uniform aperture is not replaced at NumPy points.
    """
    declared = TRANSFORMS[name]
    assert declared.full is not None
    # The lag marginal of a uniform source is real.
    is_array = isinstance(source, Array)
    is_uniform = not is_array and getattr(source, "illumination", None) is None
    flat = source.source if isinstance(source, Wavefront) else source
    zero: Values = np.zeros(kernel_of(declared.full, flat, None, "auto").dimension)
    (point,) = points.values()
    if execution.is_drjit(point):
        zero = 0.0 * point
    elif name == "lag_marginal" and is_uniform and isinstance(source, Aperture):
        # The lag marginal of a uniform aperture is an area, which requires no sines.
        return True, name, points
    full = {label: points.get(label, zero) for label in TRANSFORMS[declared.full].points}
    return declared.is_real or is_uniform, declared.full, full


def _of_flat_wave(
    name: str, source: Any, points: Points, how: Options, shear: execution.Shear | None = None
) -> Values:
    """Return a transform of a source with a flat wave. ``shear`` maps the components of points."""
    is_traced, is_real = execution.has_drjit(points.values()), TRANSFORMS[name].is_real
    if isinstance(source, Differentiable):
        # The special kernels of arrays have no derivatives.
        kernels_of_all = {"wigner": kernels.WIGNER, "ambiguity": kernels.AMBIGUITY}
        if name not in kernels_of_all:
            raise ArgumentError(
                f"expected an Aperture or Array for {name}, got a Differentiable, which only "
                "fourier, wigner and ambiguity accept"
            )
        kernel = kernels_of_all[name]
    else:
        if TRANSFORMS[name].full is not None:
            is_real, name, points = _as_full_transform(name, source, points)
        kernel = kernel_of(name, source, *how)
    if is_traced:
        return execution.evaluate_traced(
            kernel, source, points, complex_result=not is_real, shear=shear
        )
    precision, engine = how
    arrays = [
        checked_points(label, value, kernel.dimension, keep_single=True)
        for label, value in points.items()
    ]
    result, parts = empty_result(broadcast_shape(arrays), precision, 1 if is_real else 2)
    execution.evaluate(
        kernel,
        source,
        [array[..., k] for array in arrays for k in range(kernel.dimension)],
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

    The choice depends only on the sizes of the source and the arguments (docs/performance.md).
    Repeated calls therefore use the same strategy.

    Parameters
    ----------
    source : Aperture, Slits, Array, Wavefront or Polyhedron
        The source of the call. If the call consists of several evaluations, such as an average over
        tilts, the strategy of the first evaluation is returned.
    arguments : array_like
        The points of the function as NumPy arrays: x and nu for ``"wigner"``.
    function : str, default "wigner"
        "wigner", "ambiguity", "autocorrelation", "fourier", "position_marginal" or
        "lag_marginal".
    engine, precision : str, optional
        See :func:`fourier`.

    Returns
    -------
    Plan
        Object with the strings ``strategy``, ``engine`` and ``reason``. The ``str()`` of this
        object has three lines.

    Raises
    ------
    ArgumentError
        For an unknown function, for Dr.Jit arrays, for the Fourier transform of an Array or a
        curved wave, and for arguments for which the function itself raises an ArgumentError.
    EngineError
        If the engine is not available.

    Examples
    --------
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
    if execution.has_drjit(arguments):
        raise ArgumentError(
            "expected NumPy arrays, got Dr.Jit arrays, which are always evaluated by their "
            "own backend, so there is no choice of engine to explain"
        )
    if function == "fourier" and isinstance(source, Array):
        raise ArgumentError(
            "fourier of an Array consists of several calls and has no single plan; pass one "
            "element of the Array"
        )
    name = function
    if function == "fourier" and isinstance(source, Aperture):
        arguments = (in_plane(arguments[0]),)
        name = "fourier of waves" if is_separable(source) else name
    points = dict(zip(names, arguments, strict=True))
    plan = execution.explained(lambda: compute(name, source, points, precision, engine))
    if plan is None:
        raise ArgumentError(
            "fourier of a curved wave is always computed by NumPy, so there is no choice to explain"
        )
    return plan


def _mapped_points(name: str, source: Any, through: Any, wavelength: Any, points: Points) -> Points:
    """Map points behind an optical system to points in front of it, equations (O2) and (O3).

    Raises ArgumentError if the system or the wavelength is missing or invalid.
    """
    if through is None:
        raise ArgumentError(
            f"wavelength={wavelength!r} requires an optical system (through=), got none; omit the "
            "wavelength, or pass through=FirstOrder(...)"
        )
    if not isinstance(through, FirstOrder):
        raise ArgumentError(
            f"expected through to be a polywigner.FirstOrder, got {type(through).__name__}"
        )
    if wavelength is None:
        raise ArgumentError("through= requires a wavelength; pass wavelength=...")
    length = checked_wavelength(wavelength)
    flat = source.source if isinstance(source, Differentiable | Wavefront) else source
    dimension = kernels.kernel_for(name, flat).dimension
    a, b, c, d = _blocks_for(through, dimension)
    position, frequency = TRANSFORMS[name].plane
    checked = _checked_components(points, dimension)
    if not execution.has_drjit(checked.values()):
        broadcast_shape(list(checked.values()))
    components = [*execution.split(checked[position]), *execution.split(checked[frequency])]
    mapped = {
        position: execution.matrix_times(np.hstack([d.T, -length * b.T]), components),
        frequency: execution.matrix_times(np.hstack([-c.T / length, a.T]), components),
    }
    return {label: execution.joined(mapped[label]) for label in points}


def _blocks_for(system: FirstOrder, dimension: int) -> tuple[NDArray[np.float64], ...]:
    """Return the blocks A, B, C and D of a ray transfer matrix, each of shape (d, d).

    Raises ArgumentError for d = 1 if the system couples x and y.
    """
    blocks = (system.A, system.B, system.C, system.D)
    if dimension == 2:
        return blocks
    if any(block[0, 1] or block[1, 0] for block in blocks):
        raise ArgumentError(
            "slits require an optical system that does not couple x and y, got a system that "
            f"couples them: {system!r}"
        )
    return tuple(block[:1, :1] for block in blocks)


def _of_partly_coherent_wave(name: str, wave: Wavefront, points: Points, how: Options) -> Values:
    """Return a transform of a source with a finite coherence width.

    The methods are equations (PC2), (PC3) and (I5). Raises IlluminationError for the Fourier
    transform, and ArgumentError for Dr.Jit points if there is no closed form.
    """
    if name == "fourier":
        raise IlluminationError(
            f"expected a coherent source for {name}, got one with a coherence width of "
            f"{wave.coherence_width:g} m, whose spectrum has no phase; use "
            "polywigner.radiant_intensity, or wigner and ambiguity"
        )
    takes_degree = TRANSFORMS[name].takes_degree
    has_closed_form = not takes_degree and kernels.partly_coherent_kernel(wave) is not None
    traced = [label for label, value in points.items() if execution.is_drjit(value)]
    if traced and not has_closed_form:
        raise ArgumentError(
            f"expected {traced[0]} to be a NumPy array for a partially coherent source, got a "
            f"Dr.Jit array; use {traced[0]}.numpy()"
        )
    points, coherent = _checked_components(points, wave.dimension), coherent_source(wave)
    if takes_degree:
        values = compute(name, coherent, points, *how)
        degree = degree_of_coherence(wave, list(points.values())[-1])
        return values * degree.astype(np.asarray(values).real.dtype)
    if TRANSFORMS[name].full is not None:
        _, name, points = _as_full_transform(name, wave, points)
    x, nu = points.values()
    if traced:
        double = type(execution.split(points[traced[0]])[0]).__name__.endswith("64")
    else:
        double = execution.checked_precision(how[0]) != "single"

    def of_coherent(x: Values, nu: Values) -> Values:
        """Return the Wigner function of the coherent source."""
        return compute("wigner", coherent, {"x": x, "nu": nu}, *how)

    if not has_closed_form:
        return mean_over_tilts(of_coherent, wave, nu, x, double=double)

    def closed_form(limited: Wavefront, x: Values, nu: Values) -> Values:
        """Return the Wigner function of a source for which the closed form is accurate."""
        return _of_curved_wave("wigner", limited, {"x": x, "nu": nu}, how)

    return wigner_at_any_width(closed_form, of_coherent, wave, x, nu, double)


def _checked_components(points: Points, dimension: int) -> dict[str, Values]:
    """Return points as float64 arrays, or as Dr.Jit arrays with ``dimension`` components."""
    return {
        label: execution.joined(execution.components_of(label, value, dimension))
        if execution.is_drjit(value)
        else checked_points(label, value, dimension)
        for label, value in points.items()
    }


def _of_curved_wave(name: str, wave: Wavefront, points: Points, how: Options) -> Values:
    """Return a transform of a curved wave from the flat wave, by equations (Q1) to (Q5)."""
    if name == "fourier":
        return _curved_spectrum(wave, points["nu"], how)
    d, q = wave.dimension, wave.curvature
    if TRANSFORMS[name].full is not None:
        _, name, points = _as_full_transform(name, wave, points)
    points, flat = _checked_components(points, wave.dimension), wave.source
    if not wave.is_coherent:
        flat = Wavefront(flat, coherence_width=wave.coherence_width)

    def slopes(x: Sequence[Any], centre: Sequence[float]) -> list[Any]:
        """Return Q (x - c), the local spatial frequency of the curved wave."""
        return execution.matrix_times(q, [p - c for p, c in zip(x, centre, strict=True)])

    centre = wave.centre.tolist()
    if name == "autocorrelation":
        value = _of_flat_wave(name, flat, points, how)
        x, xi = (execution.split(p) for p in points.values())
        return _with_phase(value, zip(slopes(x, centre), xi, strict=True))
    first, second = TRANSFORMS[name].plane == ("x", "nu"), slice(d, 2 * d)
    about = centre if first else [0.0] * d

    def shear(components: Sequence[Any]) -> Sequence[Any]:
        """Return the components of the points at which the flat wave is evaluated."""
        groups = list(components[:d]), list(components[second])
        position, frequency = groups if first else groups[::-1]
        moved = [n - s for n, s in zip(frequency, slopes(position, about), strict=True)]
        return [*position, *moved] if first else [*moved, *position]

    value = _of_flat_wave(name, flat, points, how, shear)
    slope = (q @ wave.centre).tolist()
    if first or not any(slope):
        return value
    xi = execution.split(points["xi"])
    return _with_phase(value, zip([-s for s in slope], xi, strict=True))


def _with_phase(value: Values, factors: Iterable[tuple[Any, Any]]) -> Values:
    """Return a value times exp(2 pi i sum p q) over the pairs (p, q) in ``factors``."""
    phase = execution.unit_wave(sum(p * q for p, q in factors))
    if execution.is_drjit(value):
        return phase * value
    return (value * phase).astype(np.asarray(value).dtype)[()]


def _curved_spectrum(wave: Wavefront, nu: Any, how: Options) -> NDArray[np.complexfloating[Any]]:
    """Return the Fourier transform of a curved wave, computed by Fresnel integrals."""
    dimension = kernels.kernel_for("wigner", wave.source).dimension
    check_no_drjit(nu=nu)
    execution.checked_engine(how[1])
    single = execution.checked_precision(how[0]) == "single"
    points = in_plane(nu) if dimension == 2 else nu
    points = checked_points("nu", points, dimension)
    q, axes = principal_axes(wave.curvature)
    flat = points.reshape(-1, dimension)
    values = chirp_transform(wave.source, q, axes, wave.centre, flat).reshape(points.shape[:-1])
    return values.astype(np.complex64)[()] if single else values[()]
