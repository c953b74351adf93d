"""Coupling of two sources in any relative pose, and the powers that normalise it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from typing import Any, Literal, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, GeometryError, IlluminationError
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import (
    checked_choice,
    checked_flag,
    checked_wavelength,
    rigid_poses,
    takes_frequency,
    warn_of_distance,
)
from polywigner.kernels.boundary.integrals import distance_of, point_in_wavelengths
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.phases import reduced
from polywigner.propagation.far_fields import far_field, powers_of
from polywigner.propagation.point_grids import tolerance_from, warn_of_missed
from polywigner.propagation.vector_fields import polarised_parts, vector_powers
from polywigner.radiometry.directions import checked_radiator, directions_and_weights, largest_lag
from polywigner.reception.cell_pairs import Links, Sight, cells_of, link_sums
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import CONDITIONS, DEFAULT, BoundaryCondition, Obliquity
from polywigner.source.polarisation import MODELS, CurrentModel, Currents, checked_pair
from polywigner.transforms import fourier
from polywigner.transforms.public_transforms import energy_of
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.wavefronts import flat_source

LinkMethod = Literal[BoundaryCondition, "fraunhofer", CurrentModel]

_OPS = execution.NumpyOperations()
# Default tolerance, and smallest tolerance, which is hundreds of times the rounding error.
_TOLERANCE, _LEAST = 1e-6, 1e-12
# Fraction of the largest coupling below which the tolerance is absolute rather than relative, for
# example in pattern nulls.
_FLOOR = 1e-3
# Number of poses per block.
_BLOCK = 64
# Relative rounding error of Friis' formula with phase, equation (RX4).
_ROUNDING = 1e-12
# Number of additional nodes along each side of a cell for a tolerance of 1e-6, and additional
# number of nodes for each further digit.
_NODES, _NODES_PER_DIGIT = 4.0, 0.5


@overload
def coupling(
    transmitter: Aperture | Array | Wavefront,
    receiver: Aperture | Array | Wavefront,
    to_transmitter: ArrayLike,
    wavelength: float = ...,
    method: LinkMethod | None = ...,
    tolerance: float = ...,
    *,
    polarisation: str | Sequence[str | ArrayLike] | None = ...,
    return_error: Literal[False] = ...,
    normalise: Literal["radiated", "aperture"] = ...,
    frequency: float = ...,
) -> Complex: ...


@overload
def coupling(
    transmitter: Aperture | Array | Wavefront,
    receiver: Aperture | Array | Wavefront,
    to_transmitter: ArrayLike,
    wavelength: float = ...,
    method: LinkMethod | None = ...,
    tolerance: float = ...,
    *,
    polarisation: str | Sequence[str | ArrayLike] | None = ...,
    return_error: Literal[True],
    normalise: Literal["radiated", "aperture"] = ...,
    frequency: float = ...,
) -> tuple[Complex, Floats]: ...


@takes_frequency
def coupling(
    transmitter: Aperture | Array | Wavefront,
    receiver: Aperture | Array | Wavefront,
    to_transmitter: ArrayLike,
    wavelength: float,
    method: LinkMethod | None = None,
    tolerance: float = _TOLERANCE,
    *,
    polarisation: str | Sequence[str | ArrayLike] | None = None,
    return_error: bool = False,
    normalise: Literal["radiated", "aperture"] = "radiated",
) -> Any:
    """Return the complex coupling of two sources.

    The squared modulus |b|^2 of the coupling is the ratio of received to transmitted power. The
    transmitted power is the power that the transmitter radiates. At large distances, |b|^2 is
    therefore given by Friis' formula with directivities. The coupling b is the overlap, without a
    complex conjugate, of the transmitter's field with the field that the receiver would transmit.
    It is therefore unchanged if transmitter and receiver are exchanged (docs/links.md, (RX1) to
    (RX3)):

        b = 1/sqrt(N_t N_r) int int u_t(x) K(x, y) u_r(y) dx dy,   N = int g |F|^2 dOmega/lambda^2

    Here u_t and u_r are the source fields, and F is the Fourier transform of u_t or u_r. The
    obliquity factor is g, and R is the distance between the points x and y. For
    "rayleigh-sommerfeld-2" the kernel K is exp(ikR)/(i wavelength R). For "rayleigh-sommerfeld-1" K
    is multiplied by the cosines at both ends, and for "kirchhoff" by (1 + cosine)/2 at each end.
    Both kernels include near-field terms. The computing time increases at short distances, where
    the sources are divided into more cells.

    Parameters
    ----------
    transmitter, receiver : Aperture, Array or Wavefront
        Sources in the plane z = 0 of their frames, with any illumination or curved wavefront. Each
        source radiates along +z of its frame.
    to_transmitter : array_like, shape (..., 4, 4)
        Rigid poses that map the receiver's frame into the transmitter's frame, with translations in
        m. Small deviations from a rigid pose are corrected.
    wavelength : float
        Wavelength in m, or ``frequency=`` in Hz.
    method : str, optional
        Boundary condition: "rayleigh-sommerfeld-1" (default), "rayleigh-sommerfeld-2" or
        "kirchhoff". "fraunhofer" is Friis' formula with phase, for the far-field patterns of
        "rayleigh-sommerfeld-1". For polarised sources, the equivalent currents: "huygens"
        (default), "magnetic" or "electric", as in :func:`polywigner.field`, with the kernel of
        equation (RX9).
    tolerance : float, default 1e-6
        Allowed relative error, from 1e-12 to 0.1. The error is relative to |b| or to a thousandth
        of ``min(1, sqrt(A_t A_r)/(wavelength R))``, whichever is larger. This minimum is the
        largest coupling of two sources with the areas A_t and A_r at the distance R. The method
        "fraunhofer" ignores the tolerance.
    polarisation : str, array_like or pair, optional
        Polarisations of transmitter and receiver, or one polarisation for both, as in
        :func:`polywigner.field`. Each polarisation refers to the axes of the frame of its source.
        Specify the polarisation of the receiver as if it transmitted. By default fields are scalar.
    return_error : bool, default False
        Whether to also return the estimated absolute error of each value. For "fraunhofer" this
        is the rounding error only.
    normalise : {"radiated", "aperture"}, default "radiated"
        Power N of a source. "radiated": the power radiated with the boundary condition of the
        method. "aperture": the integral of |u|^2, which exceeds the radiated power of small
        sources.

    Returns
    -------
    b : complex or ndarray of complex, shape (...)
        Coupling for each pose. With ``return_error``, a pair of couplings and errors.

    Warns
    -----
    PolywignerWarning
        If the estimated error exceeds the tolerance.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or range or is a Dr.Jit array, or if the sum would take
        longer than several minutes.
    GeometryError
        If a pose is not rigid, if part of a source is behind the plane of the other source, or if
        an Array has elements outside its plane.
    IlluminationError
        If the elements of a source cancel.

    Notes
    -----
    Source: J. H. Richmond, IRE Trans. Antennas Propag. 9, 515 (1961). Links are not part of the
    paper of polywigner.

    Examples
    --------
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
    counted = checked_choice(normalise, "normalise", NORMALISATIONS)
    checked_flag(return_error, "return_error")
    jones = None if polarisation is None else checked_pair(polarisation, *sources)
    poses = rigid_poses(to_transmitter, "to_transmitter")
    flat = poses.reshape(-1, 4, 4)
    _check_facing(flat, *(cells_of(source, length).corners for source in sources))
    warn_of_distance(sources, flat[:, :3, 3], length)
    terms = _Link(sources, length, name, allowed, counted, jones).evaluate(flat)
    warn_of_missed(*terms[1:], "couplings")
    values, errors = (part.reshape(poses.shape[:-2])[()] for part in terms[:2])
    return (values, errors) if return_error else values


@dataclass(frozen=True, eq=False)
class _Link:
    """Two sources, and the settings of their coupling."""

    sources: tuple[Any, Any]
    wavelength: float
    method: str
    tolerance: float
    normalise: str
    jones: tuple[Complex, Complex] | None
    """Jones vectors of the transmitter and the receiver; None for scalar fields."""

    def norm(self, normalise: str) -> float:
        """Return sqrt(N_t N_r) in W, by which couplings are divided."""
        vectors = self.jones or (None, None)
        return math.prod(
            root_of_norm(source, self.wavelength, self.method, normalise, jones)
            for source, jones in zip(self.sources, vectors, strict=True)
        )

    def evaluate(self, poses: Floats) -> tuple[Complex, Floats, Floats]:
        """Return normalised couplings, estimated errors and allowed errors for poses (n, 4, 4)."""
        values: Complex = np.zeros(len(poses), np.complex128)
        errors, limits = np.zeros((2, len(poses)))
        parts: list[Any] = [[(source, None)] for source in self.sources]
        if self.jones is not None:
            parts = list(map(polarised_parts, self.sources, self.jones))
        floor = 0.0 if self.method == "fraunhofer" else _FLOOR * self.norm("aperture")
        for sent, received in product(*parts):
            with with_progress("links", index_blocks(len(poses), _BLOCK)) as blocks:
                for block in blocks:
                    terms = self._between(sent, received, poses[block], floor)
                    values[block] += terms[0]
                    errors[block] += terms[1]
                    limits[block] += terms[2]
        # The normalisation is computed last, because couplings that would take too long raise an
        # error.
        norm = self.norm(self.normalise)
        return values / norm, errors / norm, limits / norm

    def _between(
        self, sent: Any, received: Any, poses: Floats, floor: float
    ) -> tuple[Complex, Floats, Floats | float]:
        """Return unnormalised couplings of a part of each source, with errors.

        ``sent`` and ``received``: a source and its polarisation vector (None for scalar fields).
        The couplings, the estimated errors and the allowed errors (n,) are in W. ``floor`` is in W:
        couplings below ``floor`` times :meth:`_largest` have an absolute allowed error.
        """
        sources = sent[0], received[0]
        cells = [cells_of(source, self.wavelength) for source in sources]
        offset = poses[:, :3, 3] + poses[:, :3, :2] @ cells[1].centre
        offset[:, :2] -= cells[0].centre
        point = point_in_wavelengths(_OPS, (0.0, 0.0), self.wavelength, *offset.T)
        phase = np.exp(2j * np.pi * reduced(_OPS, distance_of(_OPS, point)))
        if self.method == "fraunhofer":
            values = phase * self._far(sources, [c.centre for c in cells], poses, offset)
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
        floors = floor * self._largest(sources, offset) / scale
        values, errors, allowed = link_sums(links, self.tolerance, floors)
        return scale * phase * values, scale * errors, scale * allowed

    def _far(
        self, sources: tuple[Any, ...], centres: list[Floats], poses: Floats, offset: Floats
    ) -> Complex:
        """Return unnormalised far-field couplings without the phase due to the distance.

        ``offset`` (n, 3): vectors in m from the transmitter's centre to the receiver's centre, in
        the transmitter's frame. The result (n,) is in W, equation (RX4).
        """
        distance = np.linalg.norm(offset, axis=1)
        towards = offset / distance[:, None]
        back = -np.einsum("nji,nj->ni", poses[:, :3, :3], towards)
        result = 1j * self.wavelength / distance
        for source, centre, directions in zip(sources, centres, (towards, back), strict=True):
            centred = normal_form(source).moved(-centre).public
            result = result * far_field(centred, directions, self.wavelength, DEFAULT)
        return result

    def _largest(self, sources: tuple[Any, ...], offset: Floats) -> Floats:
        """Return the largest coupling (at most 1) that the source areas allow at each distance."""
        areas = [sum(e.area for e in flat_source(source).elements_in_plane) for source in sources]
        size = math.sqrt(areas[0]) * math.sqrt(areas[1]) / self.wavelength
        return np.minimum(1.0, size / np.linalg.norm(offset, axis=1))


def _check_facing(poses: Floats, transmitter: Floats, receiver: Floats) -> None:
    """Raise GeometryError unless the convex hull of each source is in front of the other source.

    ``transmitter`` and ``receiver`` (k, 2): corners of the hulls in m, in the frames of the
    sources.
    """
    rotation = poses[:, :3, :3]
    faces = rotation[:, 2, 2] < 0.0
    there = np.einsum("nj,kj->nk", rotation[:, 2, :2], receiver) + poses[:, 2, 3, None]
    _check_heights(there, faces, receiver, "receiver", "transmitter")
    height = np.einsum("ni,ni->n", rotation[:, :, 2], poses[:, :3, 3])
    here = np.einsum("nj,kj->nk", rotation[:, :2, 2], transmitter) - height[:, None]
    _check_heights(here, faces, transmitter, "transmitter", "receiver")


def _check_heights(
    heights: Floats, faces: NDArray[np.bool_], corners: Floats, name: str, other: str
) -> None:
    """Raise GeometryError unless all heights (n, k) of ``corners`` (k, 2) are positive.

    ``faces``: whether the z axes are opposed in each pose; determines the advice in the message.
    """
    behind = ~(heights > 0)
    if not behind.any():
        return
    pose = int(behind.any(axis=1).argmax())
    lowest = int(heights[pose].argmin())
    x, y = corners[lowest].tolist()
    z = float(heights[pose, lowest])
    if not behind[pose].all():
        advice = "move it forwards, or cut off the part behind the plane"
    elif not faces[pose]:
        advice = (
            "sources radiate along +z of their frames; rotate one source by 180 degrees about "
            "its x or y axis"
        )
    elif heights[pose].any():
        advice = "the z axes are already opposed; change the sign of the distance along z"
    else:
        advice = "both sources lie in the same plane; add a distance along z to the pose"
    number = f" in pose {pose}" if len(heights) > 1 else ""
    raise GeometryError(
        f"the entire {name} must be in front of the plane of the {other}, got its point ({x:.6g}, "
        f"{y:.6g}) at z = {z:.6g} m in the frame of the {other}{number}; {advice}"
    )


def _checked_method(method: Any, is_polarised: bool) -> str:
    """Return the name of a method, or the default; raise ArgumentError for other values."""
    allowed = [name for name in get_args(LinkMethod) if (name in MODELS) == is_polarised]
    if method is None:
        return "huygens" if is_polarised else DEFAULT
    if not is_polarised and isinstance(method, str) and method in MODELS:
        raise ArgumentError(
            f"method={method!r} requires a polarisation; pass the argument polarisation"
        )
    return checked_choice(method, "method", allowed)


def checked_tolerance(tolerance: Any) -> float:
    """Return the tolerance of a coupling; raise ArgumentError for other values."""
    return tolerance_from(tolerance, _TOLERANCE, _LEAST)


def link_kernel(condition: Obliquity, sight: Sight) -> tuple[Floats, Floats]:
    """Return the real and imaginary part of the scalar kernel K, equation (RX1), shape (n, i, j).

    The axes are pairs of cells, nodes of the transmitter and nodes of the receiver. Lengths are in
    wavelengths, and the phase due to the distance of the centres is omitted.
    """
    cosine, sine = sight.wave
    nr, mr, nm = sight.rise, sight.away, sight.lean
    # Real arrays are several times faster than complex arrays.
    a, b = condition.field, condition.slope
    inverse = 1.0 / sight.distance
    near = inverse * (0.5 / math.pi)
    both = inverse * ((a * a) * nr) * inverse * mr
    imag = ((a * a) * nm - 3.0 * both) * near
    real = b * b - (imag * near + both)
    if a * b:
        mixed = inverse * ((a * b) * (nr - mr))
        real, imag = real + mixed, imag + mixed * near
    # The kernel is multiplied by -i exp(ikR)/R.
    real, imag = real * inverse, imag * inverse
    return real * sine + imag * cosine, imag * sine - real * cosine


def polarised_kernel(
    currents: Currents, sent: Complex, received: Complex, sight: Sight
) -> tuple[Floats, Floats]:
    """Return the real and imaginary part of the kernel of polarised sources, equation (RX9).

    ``sent`` and ``received`` (3,) are polarisation vectors in the frames of their sources.
    ``received`` is not conjugated: it is the polarisation that the receiver would transmit. Units,
    shape and phase are as in `link_kernel`.
    """
    rotation = sight.rotation
    received, normal = rotation @ received, rotation[:, :, 2]
    m, e = currents
    inverse = 1.0 / sight.distance
    a = 0.5j / math.pi * inverse
    r = sight.r

    def along(v: Complex) -> Complex:
        """Return the component of vectors v along the lines between nodes."""
        v = np.broadcast_to(v, received.shape)
        return np.asarray(sum(v[:, k, None, None] * r[k] for k in range(3)) * inverse)

    def dyad(first: Complex, second: Complex) -> Complex:
        """Return the electric field of a dipole along ``first``, projected onto ``second``.

        The field is relative to the spherical wave exp(ikR)/(i R).
        """
        product = np.broadcast_to(first * second, received.shape).sum(axis=1)[:, None, None]
        transverse = (1 + a * (1 + a)) * product
        return np.asarray(transverse - (1 + 3 * a * (1 + a)) * along(first) * along(second))

    dual, received_dual = np.cross([0.0, 0.0, 1.0], sent), np.cross(normal, received)
    total: Any = 0.0
    if e:
        total = e * e * dyad(sent, received)
    if m:
        total = total - m * m * dyad(dual, received_dual)
    if e and m:
        mixed = np.cross(received, dual) - np.cross(sent, received_dual)
        total = total + e * m * (1 + a) * along(mixed)
    wave = sight.wave[0] + 1j * sight.wave[1]
    values = np.asarray(total * wave * inverse / 1j)
    return values.real, values.imag


NORMALISATIONS = ("radiated", "aperture")
"""Definitions of a source's power: radiated into the half space, or int |u|^2 over the aperture."""

# Ratio of the power to the sum of the elements' powers below which the fields count as cancelled.
_DARK = 1e-12


def root_of_norm(
    source: Any, wavelength: float, method: str, normalise: str, jones: Complex | None = None
) -> float:
    """Return the square root of a source's power in W^0.5, which normalises couplings.

    ``jones``: polarisation for equivalent currents, None for scalar fields.
    """
    # The key contains bytes, because NumPy arrays are not hashable.
    key = None if jones is None else (jones.tobytes(), jones.shape)
    return _root_of_norm(source, wavelength, method, normalise, key)


@lru_cache(maxsize=128)
def _root_of_norm(source: Any, wavelength: float, method: str, normalise: str, jones: Any) -> float:
    """Return the cached :func:`root_of_norm`; bytes and shape specify the polarisation."""
    if jones is not None:
        parts = polarised_parts(source, np.frombuffer(jones[0], complex).reshape(jones[1]))
        if normalise == "aperture":
            return math.sqrt(sum(energy_of(part) for part, _ in parts))
        return math.sqrt(vector_powers(parts, wavelength, method)[0])
    _check_sum(source)
    if normalise == "aperture":
        return math.sqrt(energy_of(source))
    condition = CONDITIONS[method if method in CONDITIONS else DEFAULT]
    form = normal_form(source)
    if not condition.needs_normal_derivative or (form.is_flat and not form.frequencies.any()):
        return math.sqrt(powers_of(source, wavelength, condition.name)[0])
    return math.sqrt(_radiated(source, wavelength, condition))


def _check_sum(source: Any) -> None:
    """Raise IlluminationError if the fields of the elements of a source cancel."""
    norm = energy_of(flat_source(source))
    parts: float = sum(
        (abs(e.weight) * float(np.abs(e.amplitudes).max())) ** 2 * e.shape.area
        for e in normal_form(source).in_plane.elements
    )
    if not norm > _DARK * parts:
        raise IlluminationError(
            f"the fields of the elements of a source cancel, so that int |u|^2 is {norm:.3g}; "
            "change the weights of the elements"
        )


def _radiated(source: Any, wavelength: float, condition: Obliquity) -> float:
    """Return the radiated power in W, for an obliquity factor that depends on the direction."""
    power = 0.0
    for directions, solid_angle in directions_and_weights(largest_lag(source), wavelength):
        factor = condition.amplitude(directions[:, 2]) ** 2 * solid_angle / wavelength**2
        power += float(np.square(np.abs(fourier(source, directions[:, :2] / wavelength))) @ factor)
    return power
