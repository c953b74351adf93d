"""The Fourier transform of sources in one, two and three dimensions."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Differentiable, Drjit, Engine, Precision
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Wavefront
from polywigner.geometry.arguments import Points
from polywigner.kernels import is_separable
from polywigner.source import Array
from polywigner.source.lattices import Sites, checked_sites
from polywigner.source.waves import exact_turns
from polywigner.transforms.calls import Values, compute, public
from polywigner.transforms.checked_calls import (
    Source,
    array_on_grid,
    checked_points,
    in_blocks,
    in_plane,
)
from polywigner.transforms.traced_sources import fourier_of
from polywigner.transforms.xarray_arguments import takes_xarray


@public
def fourier(
    source: Source | Differentiable,
    nu: Points,
    *,
    obliquity: Literal["paper"] | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Fourier transform (SFT) of a source: F(nu) = integral of u(x) exp(-2 pi i nu.x) over it.

    Closed form, at any nu, zero included (docs/theory.md, (F2), (F3), (F5), (S1), (C1), (I1)).
    Accurate to 1e-13 of the content (2e-6 in single precision) for any size and direction of nu,
    needles and far places included; for complex nu, of the content times the largest wave in the
    source's box, and infinite where a float cannot hold it; less for bodies with thin walls, and
    for lattices of many cycles, |nu| times their diameter above 100 (docs/accuracy.md). Differs
    from the paper's eq. (FVT), which prints the exp(+) kernel and is singular at nu = 0; its
    factor (nu/|nu|).n for collections is an obliquity and not part of the transform. Cost: linear
    in the edges, or in the triangles of a polyhedron's faces; times the waves of an illumination,
    or where they are a product along the sides of a rectangle (I4), those along either one after
    the other; that of its elements for an Array.
    A grid of frequencies, (n, m, 2) from ``numpy.meshgrid``, costs a fraction of as many points
    elsewhere where edges are parallel and of equal length, or along the axes (F4).

    Parameters
    ----------
    source : Aperture, Slits or placed aperture, uniform (u = 1) or with an illumination; or a
        Polyhedron; or an Array of them; or what :func:`differentiable` makes of one.
    nu : (..., d) spatial frequencies in 1/m, real or complex (evanescent or absorbed waves). d = 1
        for Slits, 3 for polyhedra and placed apertures, 2 for an Aperture, or 3, of which the last
        component does not matter: without a pose it lies in the plane z = 0.
    obliquity : None, or "paper": the transform of every plane element times (conj(nu)/|nu|).n, n
        its normal, the cosine at which a wave leaves it. Needs nu as a NumPy array of three
        components, and is NaN at nu = 0, which has no direction.
    precision : "double", "single", or None: double for NumPy input, its own for Dr.Jit input.
    engine : "auto", "numpy", "llvm" or "cuda".

    Returns
    -------
    (...) complex, in m^d; complex64 for single precision. Dr.Jit input gives ``Complex2f``, or
    for tensors a tensor (..., 2) of real and imaginary parts.
    An ``xarray.DataArray``, components along its last dimension, gives one over its other
    dimensions, broadcast by name, with their coordinates, a unit and a name; a chunked one stays
    lazy (docs/howto/notebook.md).

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape, and an obliquity of slits or bodies,
    which have no normal; EngineError without the engine.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> round(float(pw.fourier(square, (0.25, 0.0)).real), 6)  # 4 sinc(0.5)
    2.546479
    """
    if isinstance(source, Wavefront):
        if obliquity is not None and source.is_coherent:
            raise ArgumentError(f"expected no obliquity for a curved wave, got {obliquity!r}")
        return compute("fourier", source, {"nu": nu}, precision, engine)
    if obliquity is not None and (not isinstance(obliquity, str) or obliquity != "paper"):
        raise ArgumentError(f"expected obliquity=None or 'paper', got {obliquity!r}")
    if isinstance(source, Differentiable):
        if obliquity is not None:
            raise ArgumentError("expected no obliquity for a differentiable source")
        plain = partial(fourier, precision=precision, engine=engine)

        def of_components(points: dict[str, Drjit]) -> Drjit:
            return fourier_of(source, in_plane(points["nu"]), plain)

        numbers = source.numbers
        return execution.on_components(of_components, {"nu": nu}, numbers, precision, engine)
    how: dict[str, Any] = {"obliquity": obliquity, "precision": precision, "engine": engine}
    if execution.is_drjit(nu):
        call = partial(_on_components, source, how)
        return execution.on_components(call, {"nu": nu}, {}, precision, engine)
    with np.errstate(invalid="ignore", over="ignore"):  # waves of complex nu may overflow
        return _fourier(source, nu, how)


def _on_components(source: Source, how: dict[str, Any], points: dict[str, Drjit]) -> Drjit:
    return _fourier(source, points["nu"], how)


def _fourier(source: Source, nu: Any, how: dict[str, Any]) -> Values:
    """Return F; NaN or inf where parts of it overflow."""
    obliquity, precision, engine = how["obliquity"], how["precision"], how["engine"]
    if isinstance(source, Array):
        by_elements = partial(in_blocks, partial(_coherent_sum, source, how=how))
        found = None
        if obliquity is None and source.repeated is None and not _has_fields(source):
            found = array_on_grid(source, nu, precision, engine, by_elements)
        return by_elements(nu) if found is None else found
    if obliquity is not None:
        return _towards_normal(source, nu) * fourier(source, nu, **{**how, "obliquity": None})
    if isinstance(source, Aperture):
        nu = in_plane(nu)
        if is_separable(source) and not _is_complex(nu):
            return compute("fourier of waves", source, {"nu": nu}, precision, engine)
    if not isinstance(source, Polyhedron) and _field_of(source) is not None:
        return in_blocks(lambda some: _sum_of_waves(source, some, how), nu)
    return compute("fourier", source, {"nu": nu}, precision, engine)


def _is_complex(nu: Any) -> bool:
    return not execution.is_drjit(nu) and np.iscomplexobj(nu)


def _field_of(source: Any) -> Any:
    if isinstance(source, PlacedAperture):
        return source.aperture.illumination
    return getattr(source, "illumination", None)


def _has_fields(array: Array) -> bool:
    return any(_field_of(element) is not None for element in array.elements)


def _sum_of_waves(source: Any, nu: Any, how: dict[str, Any]) -> Any:
    """sum_m c_m F(nu - kappa_m) of the uniform source, (I1)."""
    if isinstance(source, PlacedAperture):
        uniform: Any = source.aperture.with_illumination(None).placed(source.pose)
        rotation, shift = source.pose[:3, :2], source.pose[:3, 3]
        kappas = _field_of(source).frequencies @ rotation.T
        centre = rotation @ source.aperture.centre + shift
    else:
        uniform, kappas = source.with_illumination(None), source.illumination.frequencies
        centre = np.atleast_1d(source.centre)
        shift = np.zeros(len(centre))
    total: Any = None
    for amplitude, kappa in zip(_field_of(source).amplitudes, kappas, strict=True):
        # a wave on a placed aperture has its phase from there, not from the world's origin
        phase = np.exp(-2j * np.pi * exact_turns(kappa.tolist(), shift.tolist()))
        shifted, lost = _less(nu, kappa)
        term = execution.times_complex(fourier(uniform, shifted, **how), complex(amplitude * phase))
        if lost is not None:
            term = term * np.exp(-2j * np.pi * (lost @ centre)).astype(term.dtype)
        total = term if total is None else total + term
    return total


def _less(nu: Any, kappa: Any) -> tuple[Any, Any]:
    """nu - kappa and its rounding error, which matters to sources far off the origin."""
    if execution.is_drjit(nu):
        return execution.shifted(nu, -kappa), None
    array = checked_points("nu", nu, len(kappa), complex_allowed=True)
    difference = array - kappa
    real = array.real
    virtual = difference.real - real
    lost = (real - (difference.real - virtual)) - (kappa + virtual)
    return difference, np.where(np.isfinite(lost), lost, 0.0)


def _coherent_sum(array: Array, nu: Any, how: dict[str, Any]) -> Any:
    """sum_k w_k F_k(nu), (C1): each element in its own frame, with its own error-free phase.

    Elements that are shifted copies of one another are that one times an array factor, (L3).
    """
    total: Any = None
    for element, shifts, weights in _copies(array):
        term = fourier(element, nu, **how)
        if shifts is None:
            term = execution.times_complex(term, complex(weights[0]))
        else:
            plane = nu if shifts.shape[1] != 2 else in_plane(nu)
            factor = array_factor(
                shifts, weights, plane, precision=how["precision"], engine=how["engine"]
            )
            term = term * factor
        total = term if total is None else total + term
    return total


def _copies(array: Array) -> Iterator[tuple[Any, Any, Any]]:
    """Elements, shifts (n, d) of their copies and weights (n,); shifts None for a single one."""
    if array.repeated is not None:
        yield *array.repeated, array.weights
        return
    groups: dict[Any, list[int]] = {}
    for k, element in enumerate(array.elements):
        if isinstance(element, PlacedAperture):
            key: Any = (element.aperture, element.pose[:3, :3].tobytes())
        else:
            key = k
        groups.setdefault(key, []).append(k)
    for members in groups.values():
        placed = [e for e in (array.elements[k] for k in members) if isinstance(e, PlacedAperture)]
        if len(placed) < 2:
            yield array.elements[members[0]], None, array.weights[members]
            continue
        pose = placed[0].pose.copy()
        pose[:3, 3] = 0.0
        shifts = np.array([element.pose[:3, 3] for element in placed])
        yield placed[0].aperture.placed(pose), shifts, array.weights[members]


@takes_xarray("nu", units="1", long_name="array factor")
def array_factor(
    positions: ArrayLike,
    weights: ArrayLike | None,
    nu: Points,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Any:
    """Array factor sum_k w_k exp(-2 pi i nu.p_k) of isotropic sources at the positions.

    The Fourier transform of a `phased_array` is its element's times this (docs/theory.md, (L3)).
    Lattices and weights that are a product of two profiles are found out, and summed along
    their directions one after the other.

    Parameters
    ----------
    positions : (n, d) in m, d = 1, 2 or 3; or (n,) on a line.
    weights : (n,) complex, or None: all 1.
    nu : (..., d) spatial frequencies in 1/m, real or complex.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) complex, in the unit of the weights; types as in :func:`fourier`.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; IlluminationError for weights that are
    not n finite complex numbers; EngineError without the engine.

    >>> import polywigner as pw
    >>> import numpy as np
    >>> row = np.array([(-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)])
    >>> round(float(pw.array_factor(row, np.ones(3), (0.5, 0.0)).real), 6)
    -1.0
    """
    sites = Sites(*checked_sites(positions, weights))
    # phases of sites far apart are worth float64 also where the result is not
    execution.checked_precision(precision)
    rounded = precision == "single" and not execution.is_drjit(nu)
    inner = None if rounded else precision

    def factor(nu: Any) -> Any:
        found = compute("array factor", sites, {"nu": nu}, inner, engine)
        return found.astype(np.complex64) if rounded else found

    with np.errstate(invalid="ignore", over="ignore"):
        return in_blocks(factor, nu)


def _towards_normal(source: Any, nu: Any) -> Any:
    """(conj(nu)/|nu|).n, shape (...): the paper's factor of F; NaN at nu = 0, of no direction."""
    if isinstance(source, Aperture):
        normal = np.array([0.0, 0.0, 1.0])
    elif isinstance(source, PlacedAperture):
        normal = source.normal
    else:
        raise ArgumentError(
            f"expected plane elements for an obliquity, got {type(source).__name__}, which has no "
            "normal; use obliquity=None"
        )
    if execution.is_drjit(nu):
        raise ArgumentError(
            "expected nu as a NumPy array for an obliquity, got a Dr.Jit array; use nu.numpy()"
        )
    array = checked_points("nu", nu, 3, complex_allowed=True)
    # scaled first, so that no square underflows or overflows
    largest = np.maximum(np.abs(array.real), np.abs(array.imag)).max(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = array / largest
        length = np.sqrt((scaled * scaled.conj()).real.sum(axis=-1))
        return np.asarray((scaled.conj() @ normal) / length)
