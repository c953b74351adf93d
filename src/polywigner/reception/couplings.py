"""Coupling of two sources, each in the plane z = 0 of its frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, GeometryError, value_text
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import (
    checked_flag,
    checked_number,
    checked_wavelength,
    rigid_poses,
    takes_frequency,
    warn_of_distance,
)
from polywigner.kernels.boundary.integrals import distance_of, point_in_wavelengths
from polywigner.numerics.phases import reduced
from polywigner.propagation.far_fields import far_field
from polywigner.propagation.point_grids import checked_method, warn_of_missed
from polywigner.propagation.quadrature import (
    gauss_rule,
    has_few_kinks,
    node_count,
    smooth_triangles,
)
from polywigner.propagation.vector_fields import polarised_parts
from polywigner.radiometry.directions import checked_radiator
from polywigner.reception.cell_pairs import (
    Links,
    cells_of,
    link_kernel,
    link_sums,
    polarised_kernel,
)
from polywigner.reception.norms import checked_normalise, root_of_norm
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import CONDITIONS, DEFAULT, BoundaryCondition
from polywigner.source.polarisation import MODELS, CurrentModel, checked_pair
from polywigner.transforms import wigner
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import flat_source

Floats = NDArray[np.float64]

# Largest sine of the angle between parallel planes: the rounding error of poses.
_PARALLEL = 1e-9
# Nodes along a side of a triangle in addition to the nodes for the phase, for each rule.
_LEVELS = (2.0, 3.0, 5.0, 7.0, 10.0, 14.0)
# Pairs of points: limit, a minute's work; number in one step.
_MOST_PAIRS, _PAIRS_AT_ONCE = 1 << 24, 1 << 18


def overlap(
    sources: tuple[Any, ...], poses: Floats, wavelength: float, tolerance: float, floor: float
) -> tuple[Floats, Floats, Floats]:
    """Return |b|^2 of poses (n, 4, 4) by Wigner functions, errors and allowed errors, (n,) each.

    Raises ArgumentError for planes that are not parallel, and for too many pairs of points.
    """
    values, errors, limits = (np.empty(len(poses)) for _ in range(3))
    for source in sources:
        if not has_few_kinks(source):
            raise ArgumentError(
                'expected sources of few edges with "wigner", got a source whose Wigner function '
                f"has too many kinks; use {DEFAULT!r}"
            )
    norm = math.prod(map(energy_of, sources))
    for k, pose in enumerate(poses):
        lean = float(np.hypot(*pose[:2, 2]))
        if lean > _PARALLEL:
            raise ArgumentError(
                'expected parallel planes with "wigner", which uses the Fresnel approximation, got '
                f"an angle of {math.degrees(math.asin(lean)):.3g} degrees; use {DEFAULT!r}"
            )
        values[k], errors[k] = _adapted(sources, pose, wavelength, tolerance, floor, norm)
        limits[k] = tolerance * max(abs(values[k]), floor**2)
    return values, errors, limits


def _adapted(
    sources: tuple[Any, ...],
    pose: Floats,
    wavelength: float,
    tolerance: float,
    floor: float,
    norm: float,
) -> tuple[float, float]:
    """Refine the rules on both sources until the overlap changes by less than the tolerance."""
    spread = wavelength * float(pose[2, 3])
    rate = _rate(sources, pose, spread)
    triangles = [smooth_triangles(source) for source in sources]
    value, error = math.nan, math.inf
    for extra in _LEVELS:
        count = math.prod(node_count(part, rate, extra) for part in triangles)
        if count > _MOST_PAIRS:
            if math.isnan(value):
                raise ArgumentError(
                    f'too many pairs of points for "wigner", {count:.2g}; use {DEFAULT!r}, which '
                    "sums fields"
                )
            break
        rules = [gauss_rule(part, rate, extra) for part in triangles]
        before, value = value, _summed(sources, rules, pose, spread) / (norm * spread**2)
        error = abs(value - before)
        if error <= tolerance * max(abs(value), floor**2):
            break
    return value, error if math.isfinite(error) else math.inf


def _rate(sources: tuple[Aperture | Array, ...], pose: Floats, spread: float) -> float:
    """Return the largest |nu - kappa| of rays between both sources, in cycles per metre."""
    here, there = (np.array(list(product(*np.reshape(s.bounds, (2, 2)).T))) for s in sources)
    there = there @ pose[:2, :2].T + pose[:2, 3]
    nu = ((there[:, None] - here) / spread).reshape(-1, 2)
    rates = [
        np.linalg.norm(frequencies[:, None] - normal_form(source).frequencies, axis=-1).max()
        for source, frequencies in zip(sources, (nu, -nu @ pose[:2, :2]), strict=True)
    ]
    return float(max(rates))


def _summed(
    sources: tuple[Any, ...], rules: list[tuple[Floats, Floats]], pose: Floats, spread: float
) -> float:
    """Return int int W_t(x, nu) W_r(y, -R^T nu) dx dy with nu = (y' - x)/(wavelength z)."""
    (x, x_weights), (y, y_weights) = rules
    turn = pose[:2, :2]
    there = y @ turn.T + pose[:2, 3]
    total = 0.0
    step = max(1, _PAIRS_AT_ONCE // len(y))
    for start in range(0, len(x), step):
        some = slice(start, start + step)
        nu = (there[None] - x[some, None]) / spread
        sent = wigner(sources[0], x[some, None], nu)
        taken = wigner(sources[1], y[None], -nu @ turn)
        total += float(x_weights[some] @ (sent * taken) @ y_weights)
    return total


LinkMethod = Literal[BoundaryCondition, "fraunhofer", "wigner", CurrentModel]

Complex = NDArray[np.complex128]

_OPS = execution.NumpyOperations()
# Smallest tolerance: some hundred rounding errors of the sums.
_LEAST = 1e-12
# Errors are relative to at least this fraction of the largest coupling of sources of these areas:
# no digits are left in a null of a pattern.
_FLOOR = 1e-3
# Poses of one step: their pairs of cells are refined together.
_BLOCK = 64
# Relative error of closed forms.
_ROUNDING = 1e-12
# Nodes along a side of a cell for a tolerance of 1e-6, and additional nodes for each digit.
_NODES, _NODES_PER_DIGIT = 4.0, 0.5


@takes_frequency
def coupling(
    transmitter: Aperture | Array | Wavefront,
    receiver: Aperture | Array | Wavefront,
    to_transmitter: ArrayLike,
    wavelength: float,
    method: LinkMethod | None = None,
    tolerance: float = 1e-6,
    *,
    polarisation: str | Sequence[str | ArrayLike] | None = None,
    return_error: bool = False,
    normalise: Literal["radiated", "aperture"] = "radiated",
) -> Any:
    """Return the amplitude b received from a source, |b|^2 = received/transmitted power.

    Both are radiated powers, so that far away Friis' formula holds with directivities. b is the
    overlap of the transmitter's field with the field that the receiver would transmit, without a
    conjugate, so it is the same in both directions (docs/links.md, (RX1) to (RX3)):

        b = 1/sqrt(N_t N_r) int int u_t(x) K(x, y) u_r(y) dx dy,   N = int g |F|^2 dOmega/lambda^2

    K is exp(ikR)/(i wavelength R) ("rayleigh-sommerfeld-2"), or this times the cosines at both
    ends ("rayleigh-sommerfeld-1"), or the mean of both at each end ("kirchhoff"), with near-field
    terms. The integral is a sum over pairs of cells, whose number grows at short distances.

    Parameters
    ----------
    transmitter, receiver : Apertures, or Arrays of apertures in the plane z = 0, with any
        illumination or curved wavefront. Each radiates along +z of its frame.
    to_transmitter : (..., 4, 4) rigid poses, in m, that map the receiver's frame into the
        transmitter's frame. The nearest rigid pose is used.
    wavelength : in m; or ``frequency=`` in Hz.
    method : "rayleigh-sommerfeld-1" (None), "rayleigh-sommerfeld-2" or "kirchhoff"; "fraunhofer",
        Friis' formula with phase and the Rayleigh-Sommerfeld I patterns; or "wigner", the overlap
        of both Wigner functions along rays, which is |b|^2 in the Fresnel approximation, for
        parallel planes; its cost grows with the number of pairs of points.
        For polarised sources "huygens" (None), "magnetic" or "electric", as in
        :func:`polywigner.field`, with the kernel (RX9).
    tolerance : error allowed, from 1e-12 to 0.1, relative to |b| ("wigner": to |b|^2), or to a
        thousandth of the largest coupling of sources of these areas at that distance,
        min(1, sqrt(A_t A_r)/(wavelength R)), if that is larger. Not used by "fraunhofer".
    polarisation : a pair for transmitter and receiver, each as in :func:`polywigner.field` along
        the axes of its frame, and as if it transmitted; or one polarisation for both; None: scalar
        fields.
    return_error : also return the estimated absolute error of each value; "fraunhofer": rounding
        only.
    normalise : "radiated": N as above, with the boundary condition ("fraunhofer" and "wigner":
        Rayleigh-Sommerfeld I); "aperture": N = int |u|^2, which exceeds the radiated power of
        small sources.

    Returns
    -------
    (...) complex; for "wigner" float, |b|^2. With ``return_error`` a pair of values and (...)
    floats.

    Warns
    -----
    PolywignerWarning if the estimated error exceeds the tolerance.

    Raises
    ------
    ArgumentError : arguments of the wrong type or range, Dr.Jit arrays, planes that are not
        parallel with "wigner", links that take longer than minutes. GeometryError : poses that are
        not rigid, sources that are not in front of each other's plane, an Array with elements
        outside its plane. IlluminationError : a source that cancels itself.

    Source: J. H. Richmond, IRE Trans. Antennas Propag. 9, 515 (1961). The paper has no links.

    >>> import numpy as np
    >>> import polywigner as pw
    >>> facing = np.diag([-1.0, 1.0, -1.0, 1.0])
    >>> facing[2, 3] = 1.0  # a metre in front of the transmitter
    >>> square = pw.shapes.square(10e-3)
    >>> b = pw.coupling(square, square, facing, frequency=94e9)
    >>> round(20 * np.log10(abs(b)), 6)
    np.float64(-29.16531)
    """
    check_no_drjit(transmitter=transmitter, receiver=receiver, to_transmitter=to_transmitter)
    name = _checked_method(method, polarisation is not None)
    sources = transmitter, receiver
    for source in sources:
        checked_radiator(source)
    length, allowed = checked_wavelength(wavelength), checked_tolerance(tolerance)
    counted = checked_normalise(normalise)
    checked_flag(return_error, "return_error")
    jones = None if polarisation is None else checked_pair(polarisation, *sources)
    link = _Link(sources, length, name, allowed, counted, jones)
    values, errors = link.couplings(to_transmitter)
    return (values[()], errors[()]) if return_error else values[()]


@dataclass(frozen=True, eq=False)
class _Link:
    """Two sources and the method of their coupling."""

    sources: tuple[Any, Any]
    wavelength: float
    method: str
    tolerance: float
    normalise: str
    jones: tuple[Complex, Complex] | None
    """Jones vectors of both; None: fields are scalar."""

    def norm(self, normalise: str) -> float:
        """Return the square root of the product of both powers."""
        vectors = self.jones or (None, None)
        return math.prod(
            root_of_norm(source, self.wavelength, self.method, normalise, jones)
            for source, jones in zip(self.sources, vectors, strict=True)
        )

    def couplings(self, to_transmitter: Any) -> tuple[Floats | Complex, Floats]:
        """Return couplings (...) and their errors."""
        poses = rigid_poses(to_transmitter, "to_transmitter")
        flat = poses.reshape(-1, 4, 4)
        _check_facing(flat, *(cells_of(s, self.wavelength).corners for s in self.sources))
        warn_of_distance(self.sources, flat[:, :3, 3], self.wavelength)
        compute = self._overlap if self.method == "wigner" else self._summed
        values, errors, limits = compute(flat)
        warn_of_missed(errors, limits, "couplings")
        return values.reshape(poses.shape[:-2]), errors.reshape(poses.shape[:-2])

    def _overlap(self, poses: Floats) -> tuple[Floats, Floats, Floats]:
        if any(isinstance(source, Wavefront) for source in self.sources):
            raise ArgumentError(
                'expected a flat wave with method="wigner", got a curved wave; use '
                f"{DEFAULT!r}, which supports both"
            )
        results = overlap(self.sources, poses, self.wavelength, self.tolerance, _FLOOR)
        scale = (self.norm("aperture") / self.norm(self.normalise)) ** 2
        values, errors, limits = (scale * part for part in results)
        return values, errors, limits

    def _summed(self, poses: Floats) -> tuple[Complex, Floats, Floats]:
        """Return couplings (n,), errors and allowed errors: sums over parts of both sources.

        Parts are the sources, or their elements of one polarisation each.
        """
        values: Complex = np.zeros(len(poses), np.complex128)
        errors, limits = np.zeros((2, len(poses)))
        parts: list[Any] = [[(source, None)] for source in self.sources]
        if self.jones is not None:
            parts = list(map(polarised_parts, self.sources, self.jones))
        floor = 0.0 if self.method == "fraunhofer" else _FLOOR * self.norm("aperture")
        for sent, received in product(*parts):
            with with_progress("links", range(0, len(poses), _BLOCK)) as starts:
                for start in starts:
                    some = slice(start, start + _BLOCK)
                    terms = self._between(sent, received, poses[some], floor)
                    values[some] += terms[0]
                    errors[some] += terms[1]
                    limits[some] += terms[2]
        # after the sums, which raise at once if they would take too long
        norm = self.norm(self.normalise)
        return values / norm, errors / norm, limits / norm

    def _between(
        self, sent: Any, received: Any, poses: Floats, floor: float
    ) -> tuple[Complex, Floats, Floats | float]:
        """Return couplings of two sources with their polarisations, before both norms."""
        sources = sent[0], received[0]
        cells = [cells_of(source, self.wavelength) for source in sources]
        # from the transmitter's centre to the receiver's centre
        offset = poses[:, :3, 3] + poses[:, :3, :2] @ cells[1].centre
        offset[:, :2] -= cells[0].centre
        point = point_in_wavelengths(_OPS, (0.0, 0.0), self.wavelength, *offset.T)
        turn = np.exp(2j * np.pi * reduced(_OPS, distance_of(_OPS, point)))
        if self.method == "fraunhofer":
            values = turn * self._far(sources, [c.centre for c in cells], poses, offset)
            return values, _ROUNDING * np.abs(values), np.inf
        if self.jones is None:
            kernel: Any = partial(link_kernel, CONDITIONS[self.method])
        else:
            kernel = partial(polarised_kernel, MODELS[self.method], sent[1], received[1])
        digits = max(0.0, -math.log10(self.tolerance) - 6)
        links = Links(
            cells[0],
            cells[1],
            poses[:, :3, :3],
            offset / self.wavelength,
            kernel,
            _NODES + _NODES_PER_DIGIT * digits,
        )
        scale = self.wavelength**2
        sums = link_sums(links, self.tolerance, floor * self._largest(sources, offset) / scale)
        return scale * turn * sums.values, scale * sums.errors, scale * sums.allowed

    def _far(
        self, sources: tuple[Any, ...], centres: list[Floats], poses: Floats, offset: Floats
    ) -> Complex:
        """Return Friis' formula (RX4) without the phase of the distance of the centres."""
        distance = np.linalg.norm(offset, axis=1)
        towards = offset / distance[:, None]
        back = -np.einsum("nji,nj->ni", poses[:, :3, :3], towards)
        result = 1j * self.wavelength / distance
        for source, centre, directions in zip(sources, centres, (towards, back), strict=True):
            centred = normal_form(source).moved(-centre).public
            result = result * far_field(centred, directions, self.wavelength, DEFAULT)
        return result

    def _largest(self, sources: tuple[Any, ...], offset: Floats) -> Floats:
        """Return the largest coupling (n,) of sources of these areas at their distances."""
        areas = [sum(e.area for e in flat_source(source).elements_in_plane) for source in sources]
        size = math.sqrt(areas[0]) * math.sqrt(areas[1]) / self.wavelength
        return np.minimum(1.0, size / np.linalg.norm(offset, axis=1))


def _check_facing(poses: Floats, transmitter: Floats, receiver: Floats) -> None:
    """Check that both sources, with hulls (k, 2), are in front of each other's plane.

    All lines between them then leave and arrive on the front sides. Raises GeometryError otherwise.
    """
    turned = poses[:, :3, :3]
    faces = turned[:, 2, 2] < 0.0
    there = np.einsum("nj,kj->nk", turned[:, 2, :2], receiver) + poses[:, 2, 3, None]
    _check_heights(there, faces, receiver, "receiver", "transmitter")
    height = np.einsum("ni,ni->n", turned[:, :, 2], poses[:, :3, 3])
    here = np.einsum("nj,kj->nk", turned[:, :2, 2], transmitter) - height[:, None]
    _check_heights(here, faces, transmitter, "transmitter", "receiver")


def _check_heights(
    heights: Floats, faces: NDArray[np.bool_], corners: Floats, one: str, other: str
) -> None:
    """Check heights (n, k) of corners above the other's plane; ``faces``: axes are opposed."""
    behind = ~(heights > 0)
    if not behind.any():
        return
    pose = int(behind.any(axis=1).argmax())
    lowest = int(heights[pose].argmin())
    x, y = corners[lowest].tolist()
    z = float(heights[pose, lowest])
    if not behind[pose].all():
        advice = "move it forwards, or cut off the part behind the plane"
    elif not heights[pose].any() and faces[pose]:
        advice = "both lie in one plane; add a distance along z to the pose"
    elif faces[pose]:
        advice = "the axes are opposed already; change the sign of the distance along z"
    else:
        advice = (
            "both radiate along their own +z; rotate one of them by 180 degrees about its x or y "
            "axis"
        )
    number = f" in pose {pose}" if len(heights) > 1 else ""
    raise GeometryError(
        f"expected all of the {one} in front of the {other}'s plane, got its point ({x:.6g}, "
        f"{y:.6g}) at z = {z:.6g} m of the {other}'s frame{number}; {advice}"
    )


def _checked_method(method: Any, is_polarised: bool) -> str:
    allowed = [name for name in get_args(LinkMethod) if (name in MODELS) == is_polarised]
    if method is None:
        return "huygens" if is_polarised else DEFAULT
    if not is_polarised and isinstance(method, str) and method in MODELS:
        raise ArgumentError(f"expected a polarisation with method={method!r}, got none; give one")
    return checked_method(method, allowed)


def checked_tolerance(tolerance: Any) -> float:
    meaning = f"a number from {_LEAST:g} to 0.1"
    number = checked_number(tolerance, "tolerance", meaning)
    if not _LEAST <= number <= 0.1:
        raise ArgumentError(f"expected tolerance as {meaning}, got {value_text(tolerance)}")
    return number
