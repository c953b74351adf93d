"""Apertures as pupils of optical systems."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, IlluminationError, value_text
from polywigner.execution import Engine, Precision
from polywigner.geometry import Slits
from polywigner.geometry.arguments import (
    checked_length,
    checked_number,
    checked_row,
    checked_wavelength,
    warn_of_lens,
)
from polywigner.source import Array
from polywigner.transforms.checked_calls import PhaseSpaceSource, checked_points
from polywigner.transforms.phase_space import ambiguity, energy_of, lag_marginal
from polywigner.transforms.wavefronts import flat_of, is_partly_coherent
from polywigner.transforms.xarray_arguments import takes_xarray

# Least energy over that of the elements one by one: rounding leaves 1e-15 of it where their fields
# cancel, and a value normalised by a hundred times that has hardly a digit.
_DARK = 1e-13


@takes_xarray("xi", units="1", long_name="optical transfer function")
def otf(
    source: PhaseSpaceSource,
    xi: ArrayLike,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[Any]:
    """Optical transfer function of a pupil of this shape, in or out of focus, 1 at xi = 0.

    ``OTF(xi; w) = A(-2 w xi/a^2, xi)/A(0, 0)`` with the ambiguity function of the pupil in focus:
    the aberration exp(2 pi i w |x|^2/a^2) is linear in x on both copies. Source: K.-H. Brenner,
    A. W. Lohmann, J. Ojeda-Castaneda, Opt. Commun. 44, 323 (1983).

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), or an Array of either with the field in the pupil;
        the axis passes through the origin. With a curved wave, which is defocus as well: w of it is
        a^2/(2 wavelength radius).
    xi : (..., d) lags in the pupil in m; at the image distance z, the frequency xi/(lambda z).
    defocus : w, the wavefront aberration W20 at ``pupil_radius``, in waves.
    pupil_radius : a in m; default: the largest distance of a vertex from the origin. For a disc of
        radius R give R: ``otf(shapes.disc(R), xi, defocus, R)``. The vertices of its n-gon, which
        has the disc's area, lie farther out; for them and one wave of defocus the OTF errs by up to
        1.3e-3 (n = 64; with R by 1e-5) and 2e-2 (n = 16; 1.4e-3).
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) complex, without unit. NumPy arrays only.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; IlluminationError for an Array
    whose fields cancel everywhere, and for partly coherent light, in which images are no linear
    function of what they show; EngineError without the engine.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(2.0)
    >>> float(pw.otf(square, (0.5, 0.0)).real)
    0.75
    """
    kernel = kernels.kernel_for("ambiguity", flat_of(_checked_pupil(source)))
    radius = checked_pupil_radius(source, pupil_radius)
    waves = checked_waves(defocus)
    slope = -2.0 * waves / radius**2
    if execution.is_drjit(xi):
        raise ArgumentError("expected xi as a NumPy array, got a Dr.Jit array; use xi.numpy()")
    lags = checked_points("xi", xi, kernel.dimension, complex_allowed=False)
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    if slope == 0.0:  # in focus it is an area, which takes no sines
        return (lag_marginal(source, lags, **how) + 0j) / checked_energy(source)
    return ambiguity(source, slope * lags, lags, **how) / checked_energy(source)


@takes_xarray("frequency", units="1", long_name="modulation transfer function")
def mtf(
    source: PhaseSpaceSource,
    frequency: ArrayLike,
    wavelength: ArrayLike,
    focal_length: float,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    weights: ArrayLike | None = None,
    pixel: float | ArrayLike = 0.0,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[Any]:
    """Modulation transfer function of a lens with a pupil of this shape, |OTF| in the focal plane.

    The lag in the pupil is wavelength times focal length times frequency. Of several wavelengths it
    is the modulus of the mean OTF, as of a detector that sees them all.

    Parameters
    ----------
    source : Aperture (d = 2) or Slits (d = 1), or an Array of either with the field in the pupil;
        or one with a curved wave, as of :func:`otf`.
    frequency : (..., d) in the image, in cycles per metre: 50e3 for 50 cycles per mm.
    wavelength : in m, or (k,) of a polychromatic source.
    focal_length : in m, or the distance of the image from the pupil.
    defocus : the wavefront aberration W20 at ``pupil_radius``, in waves of the mean wavelength; the
        aberration in m is that of all wavelengths.
    pupil_radius : see :func:`otf`.
    weights : (k,) of the wavelengths, zero or more; None: all the same.
    pixel : side in m of a detector's square pixels, or one along each axis: sin(pi f p)/(pi f p) of
        them multiplies the lens.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) float64 from 0 to 1, 1 at frequency 0.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; and as :func:`otf` does.

    >>> import polywigner as pw
    >>> pupil = pw.shapes.square(10e-3)  # cut-off at 10 mm/(0.5 um 100 mm) = 200 cycles/mm
    >>> round(float(pw.mtf(pupil, (50e3, 0.0), 0.5e-6, 0.1)), 3)
    0.75
    """
    lengths = checked_row(wavelength, "expected a wavelength in m or (k,) of them")
    for length in lengths.tolist():
        checked_wavelength(length)
    distance = checked_length(focal_length, "focal_length")
    share = shares_of(weights, lengths.size)
    warn_of_lens(source, float(lengths.max()), distance)
    dimension = kernels.kernel_for("ambiguity", flat_of(_checked_pupil(source))).dimension
    cycles = checked_points("frequency", frequency, dimension, complex_allowed=False)
    sides = checked_row(pixel, "expected pixel in m")
    if sides.size not in (1, dimension) or not (np.isfinite(sides) & (sides >= 0)).all():
        raise ArgumentError(
            f"expected pixel as lengths of zero or more in m, got {value_text(pixel)}"
        )
    how: dict[str, Any] = {"precision": precision, "engine": engine}
    aberration = checked_waves(defocus) * float(share @ lengths)
    total: Any = 0.0
    for part, length in zip(share, lengths.tolist(), strict=True):
        lags = np.asarray(cycles) * (length * distance)
        pupil = source.at_wavelength(length)
        total = total + part * otf(pupil, lags, aberration / length, pupil_radius, **how)
    seen = np.sinc(np.asarray(cycles) * sides).prod(axis=-1)
    return np.abs(total * seen).astype(np.float64)[()]


def _checked_pupil(source: Any) -> PhaseSpaceSource:
    """Return the source. Raises IlluminationError if it is partly coherent."""
    pupil: PhaseSpaceSource = source
    if is_partly_coherent(source):
        raise IlluminationError(
            "expected a pupil in coherent light, got one that is coherent over "
            f"{source.coherence_width:g} m: there is no transfer function of images in partly "
            "coherent light; use its .coherent, or polywigner.lag_marginal for the degree of "
            "coherence"
        )
    return pupil


def shares_of(weights: Any, count: int) -> NDArray[np.float64]:
    """Weights (count,) as shares of their sum."""
    given = (
        np.ones(count) if weights is None else checked_row(weights, f"expected weights ({count},)")
    )
    finite = given.shape == (count,) and np.isfinite(given).all() and (given >= 0).all()
    if not finite or not given.any():
        raise ArgumentError(
            f"expected weights ({count},), one for each wavelength, of zero or more and not all "
            f"zero, got {value_text(weights)}"
        )
    return np.asarray(given / given.sum())


def checked_waves(defocus: float) -> float:
    """Return a defocus in waves. Raises ArgumentError if it is not a finite number."""
    return checked_number(defocus, "defocus", "a finite defocus in waves")


def checked_pupil_radius(source: PhaseSpaceSource, given: Any) -> float:
    """Return the given radius, or the largest distance of a vertex from the origin."""
    if given is None:
        return max(float(np.linalg.norm(points, axis=1).max()) for points in _vertices(source))
    return checked_length(given, "pupil_radius")


def _vertices(source: PhaseSpaceSource) -> Iterator[NDArray[np.float64]]:
    """Yield the vertices (n, 2) of each ring, or the ends (n, 1) of slits."""
    flat: Any = flat_of(source)
    for element in flat.elements_in_plane:
        if isinstance(element, Slits):
            yield element.intervals.reshape(-1, 1)
        else:
            yield from element.rings


def checked_energy(source: PhaseSpaceSource) -> float:
    """The integral of |u|^2, A(0, 0); IlluminationError if it is zero."""
    source = flat_of(source)
    energy = apart = energy_of(source)
    if isinstance(source, Array):
        contents = [checked_energy(element) for element in source.elements_in_plane]
        apart = float(abs(source.weights) ** 2 @ contents)
    if energy > _DARK * apart and energy > 0.0:
        return energy
    raise IlluminationError("expected a pupil with light in it, got fields that cancel everywhere")
