"""The coupling of two sources, each in its own plane: what one receives of the other."""

from __future__ import annotations

import math
from functools import lru_cache, partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_number
from polywigner.geometry.array_types import DrJitArray
from polywigner.geometry.frequency import takes_frequency
from polywigner.illumination import Array
from polywigner.illumination.obliquities import SHARES
from polywigner.illumination.support import moved_source
from polywigner.kernels.boundary.distances import distance_of, point_in_wavelengths
from polywigner.numerics.phases import reduced
from polywigner.propagation.far_fields import far_field
from polywigner.propagation.places import checked_method, checked_wavelength, warn_of_missed
from polywigner.radiometry.directions import checked_source
from polywigner.reception.cell_pairs import Links
from polywigner.reception.cells import Cells, cells_of
from polywigner.reception.link_sums import link_slopes_of, link_sums
from polywigner.reception.overlaps import overlap
from polywigner.reception.poses import check_facing, checked_poses
from polywigner.transforms import Differentiable, lag_marginal

__all__ = ["LinkMethod", "coupling"]

LinkMethod = Literal[
    "rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff", "fraunhofer", "wigner"
]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_OPS = execution.NumpyOperations(double=True)
# Least tolerance: some hundred roundings of the sums.
_LEAST = 1e-12
# Below this fraction of the largest coupling that sources of these areas can have, errors count
# relative to that: in a null of a pattern no digits are left.
_FLOOR = 1e-3
# Poses at a time: their pairs of cells are raised together.
_BLOCK = 64
# int |u|^2 of a source that cancels itself, relative to that of its parts.
_DARK = 1e-12
# Nodes along a side of a cell for 1e-6, and more for each digit.
_NODES, _NODES_PER_DIGIT = 4.0, 0.5


@takes_frequency
def coupling(
    transmitter: Aperture | Array,
    receiver: Aperture | Array,
    to_transmitter: ArrayLike | DrJitArray,
    wavelength: float,
    method: LinkMethod = "rayleigh-sommerfeld-1",
    tolerance: float = 1e-6,
    *,
    return_error: bool = False,
) -> Any:
    """Amplitude b that one source receives of another, |b|^2 = received/transmitted power.

    Both are counted as int |u|^2. The overlap of what the transmitter radiates with the field of
    the receiver, without a conjugate, so that it is the same in both directions (docs/links.md,
    (RX1) to (RX3)):

        b = 1/sqrt(N_t N_r) int int u_t(x) K(x, y) u_r(y) dx dy,    N = int |u|^2

    with exp(ikR)/(i wavelength R) for K ("rayleigh-sommerfeld-2"), or this with the cosines at both
    ends ("rayleigh-sommerfeld-1"), or the mean of both at each end ("kirchhoff"), near terms
    included. It is a sum over pairs of parts of both sources, whose number grows as they come
    nearer: of links far away there is one, however large the sources are.

    Parameters
    ----------
    transmitter, receiver : Apertures, or Arrays of apertures in the plane z = 0, with any
        illuminations. Each radiates along the +z of its own frame.
    to_transmitter : (..., 4, 4) rigid poses, in m, that map the receiver's frame into the
        transmitter's; or a Dr.Jit tensor of them, for a tensor with derivatives in the pose
        (closed forms; of rigid motions: a pose is taken as the nearest rigid one).
    wavelength : in m; or ``frequency=`` in Hz.
    method : "rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff"; or "fraunhofer", Friis'
        formula with the phase, of the Rayleigh-Sommerfeld I patterns; or "wigner", the overlap of
        both Wigner functions along rays, which is |b|^2 of Fresnel's approximation: for parallel
        planes alone, and not for large tables, since each pair of places counts.
    tolerance : error allowed, from 1e-12 to 0.1, relative to |b| ("wigner": to |b|^2) or, where b
        is less, to a thousandth of the largest that sources of these areas can have at that
        distance, min(1, sqrt(A_t A_r)/(wavelength R)). Not for "fraunhofer".
    return_error : also return the estimated error of each value, |.|; "fraunhofer": rounding only.

    Returns
    -------
    (...) complex; of "wigner" float, |b|^2. With ``return_error`` a pair of that and (...) of
    floats. For Dr.Jit poses a tensor (..., 2), real and imaginary part last ("wigner": (...)).

    Warns
    -----
    PolywignerWarning where the estimated error exceeds the tolerance.

    Raises
    ------
    ArgumentError for arguments of the wrong type or range, sources with derivatives in their own
    numbers (:func:`differentiable`), planes that are not parallel with "wigner", and links of more
    than some minutes' work. GeometryError for poses that are not rigid, for sources of which a part
    lies behind the plane of the other, or in it, and for an Array with elements outside its plane.
    IlluminationError for a source that cancels itself.

    Source: J. H. Richmond, "A reaction theorem and its application to antenna impedance
    calculations", IRE Trans. Antennas Propag. 9, 515 (1961); the kernels are derived in
    docs/links.md. The paper has no links.

    >>> import numpy as np
    >>> import polywigner as pw
    >>> facing = np.diag([-1.0, 1.0, -1.0, 1.0])
    >>> facing[2, 3] = 1.0  # a metre in front of the transmitter
    >>> square = pw.shapes.square(10e-3)
    >>> b = pw.coupling(square, square, facing, frequency=94e9)
    >>> round(20 * np.log10(abs(b)), 6)
    np.float64(-30.077568)
    """
    name = checked_method(method, get_args(LinkMethod))
    pair = tuple(_checked_source(source) for source in (transmitter, receiver))
    length, allowed = checked_wavelength(wavelength), _checked_tolerance(tolerance)
    find = partial(_found, pair, length, name, allowed)
    if execution.is_drjit(to_transmitter):
        if return_error:
            raise ArgumentError("expected no return_error with Dr.Jit poses; pass NumPy's")

        def compute(poses: Floats, wanted: bool) -> tuple[NDArray[Any], Complex | None]:
            values, _, slopes = find(poses, wanted)
            return values, slopes

        return execution.hosted_poses(compute, "to_transmitter", to_transmitter)
    values, errors, _ = find(to_transmitter, False)
    return (values[()], errors[()]) if return_error else values[()]


def _found(
    sources: tuple[Any, ...],
    wavelength: float,
    method: str,
    tolerance: float,
    to_transmitter: Any,
    with_slopes: bool,
) -> tuple[NDArray[Any], Floats, Complex | None]:
    """Couplings (...), their errors and, if wanted, derivatives (..., 3, 4) in the poses."""
    if with_slopes and method not in SHARES:
        raise ArgumentError(
            f'expected one of {", ".join(SHARES)} with derivatives, got "{method}"; pass '
            "drjit.detach(to_transmitter)"
        )
    poses = checked_poses(to_transmitter)
    shape = poses.shape[:-2]
    flat = poses.reshape(-1, 4, 4)
    cells = [cells_of(source, wavelength) for source in sources]
    check_facing(flat, cells[0].corners, cells[1].corners)
    if method == "wigner":
        values, errors, limits = overlap(sources, flat, wavelength, tolerance, _FLOOR)
    else:
        values, errors = np.zeros(len(flat), np.complex128), np.zeros(len(flat))
        limits = np.full(len(flat), np.inf)
    slopes = np.zeros((len(flat), 3, 4), np.complex128) if with_slopes else None
    for start in range(0, 0 if method == "wigner" else len(flat), _BLOCK):
        some = slice(start, start + _BLOCK)
        if method == "fraunhofer":
            values[some] = _far(sources, cells, flat[some], wavelength)
            errors[some] = _DARK * np.abs(values[some])
            continue
        found = _near(sources, cells, flat[some], wavelength, method, tolerance, with_slopes)
        values[some], errors[some], limits[some] = found[:3]
        if slopes is not None:
            slopes[some] = found[3]
    warn_of_missed(errors, limits, "couplings", stacklevel=5)
    whole = None if slopes is None else slopes.reshape(*shape, 3, 4)
    return values.reshape(shape), errors.reshape(shape), whole


def _near(
    sources: tuple[Any, ...],
    cells: list[Cells],
    poses: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    with_slopes: bool,
) -> tuple[Any, ...]:
    """Couplings (n,), their errors, what was allowed, and derivatives (n, 3, 4) or None."""
    offset = _offset(cells, poses)
    extra = _NODES + _NODES_PER_DIGIT * max(0.0, -math.log10(tolerance) - 6)
    rotation = poses[:, :3, :3]
    links = Links(cells[0], cells[1], rotation, offset / wavelength, SHARES[method], extra)
    norm = math.prod(_root_of_norm(source) / wavelength for source in sources)
    largest = _largest(sources, wavelength, offset)
    sums = link_sums(links, tolerance, norm * _FLOOR * largest)
    turn = np.exp(2j * np.pi * _turns(offset, wavelength)) / norm
    slopes = None
    if with_slopes:
        slopes = link_slopes_of(links, sums) * turn[:, None, None]
        slopes[..., 3] /= wavelength
    return sums.values * turn, sums.errors / norm, sums.allowed / norm, slopes


def _far(sources: tuple[Any, ...], cells: list[Cells], poses: Floats, wavelength: float) -> Complex:
    """Friis' formula (RX4), with the phase of the distance of the centres."""
    offset = _offset(cells, poses)
    distance = np.linalg.norm(offset, axis=1)
    towards = offset / distance[:, None]
    back = -np.einsum("nji,nj->ni", poses[:, :3, :3], towards)
    result: Complex = 1j * wavelength / distance * np.exp(2j * np.pi * _turns(offset, wavelength))
    for source, own, directions in zip(sources, cells, (towards, back), strict=True):
        centred = moved_source(source, -own.centre)
        pattern = far_field(centred, directions, wavelength, "rayleigh-sommerfeld-1")
        result *= pattern / _root_of_norm(source)
    return result


def _offset(cells: list[Cells], poses: Floats) -> Floats:
    """From the centre of the transmitter to that of the receiver, (n, 3) in m."""
    offset: Floats = poses[:, :3, 3] + poses[:, :3, :2] @ cells[1].centre
    offset[:, :2] -= cells[0].centre
    return offset


def _turns(offset: Floats, wavelength: float) -> Floats:
    """Turns of phase over distances, less whole ones."""
    point = point_in_wavelengths(_OPS, (0.0, 0.0), wavelength, *offset.T)
    turns: Floats = reduced(_OPS, distance_of(_OPS, point))
    return turns


def _largest(sources: tuple[Any, ...], wavelength: float, offset: Floats) -> Floats:
    """The largest coupling that sources of these areas can have there, (n,)."""
    areas = [sum(e.area for e in source.elements_in_plane) for source in sources]
    size = math.sqrt(areas[0]) * math.sqrt(areas[1]) / wavelength
    result: Floats = np.minimum(1.0, size / np.linalg.norm(offset, axis=1))
    return result


@lru_cache(maxsize=16)
def _root_of_norm(source: Aperture | Array) -> float:
    """sqrt(int |u|^2), in m times the unit of the field."""
    norm = float(np.real(lag_marginal(source, (0.0, 0.0), engine="numpy")))
    weights = [1.0] if isinstance(source, Aperture) else np.abs(source.weights).tolist()
    parts = 0.0
    for weight, element in zip(weights, source.elements_in_plane, strict=True):
        field = element.illumination
        peak = 1.0 if field is None else float(np.abs(field.amplitudes).max())
        parts += (weight * peak) ** 2 * element.area
    if not norm > _DARK * parts:
        raise IlluminationError(
            f"expected a source with a field on it, got one whose elements cancel, int |u|^2 = "
            f"{norm:.3g}"
        )
    return math.sqrt(norm)


def _checked_source(source: Any) -> Aperture | Array:
    if isinstance(source, Differentiable):
        raise ArgumentError(
            "expected sources without derivatives in their own numbers, got a differentiable one; "
            "a coupling has derivatives in to_transmitter only: pass its .source"
        )
    return checked_source(source)


def _checked_tolerance(tolerance: Any) -> float:
    meaning = f"a number from {_LEAST:g} to 0.1"
    number = checked_number(tolerance, "tolerance", meaning)
    if not _LEAST <= number <= 0.1:
        raise ArgumentError(f"expected tolerance as {meaning}, got {tolerance!r}")
    return number
