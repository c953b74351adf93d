"""The values behind the figure of ``polywigner transform``: F, and a slice each of W and A."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.illumination.support import mutual_support
from polywigner.transforms.wavefronts import flat_of

LARGEST_SAMPLES = 4096
"""Along each axis: an array of as many complex squares holds 256 MiB."""

_LOBES = 8.0
"""Half width of the frequency axes without a wavelength, in 1/diameter: five lobes of a square."""


@dataclass(frozen=True)
class TransformSlices:
    """Values of the transforms of one source; arrays are read-only, lengths in metres.

    ``fourier`` (n, n) complex, ``wigner`` (n, n) real and ``ambiguity`` (n, n) complex, all in
    m^2, with the second frequency component along the first axis: ``fourier[j, i]`` belongs to
    (frequency[i], frequency[j]). ``frequency`` (n,) in 1/m is the axis of nu and of upsilon.
    """

    source: pw.Aperture | pw.Array | pw.Wavefront
    aperture: pw.Aperture
    """The outline of the source: of an array, that of all elements."""
    support: pw.Aperture
    """The automean, or a region around it: where W may differ from zero."""
    x: tuple[float, float]
    xi: tuple[float, float]
    wavelength: float | None
    frequency: NDArray[np.float64]
    fourier: NDArray[np.complex128]
    wigner: NDArray[np.float64]
    ambiguity: NDArray[np.complex128]


def transform_slices(
    source: pw.Aperture | pw.Array | pw.Wavefront,
    x: ArrayLike | None = None,
    xi: ArrayLike | None = None,
    wavelength: float | None = None,
    samples: int = 257,
) -> TransformSlices:
    """F(nu), W(x, nu) at one position and A(upsilon, xi) at one lag, on a square of frequencies.

    Parameters
    ----------
    source : an aperture with its field, or an array of apertures in the plane z = 0; or one with a
        curved wave; metres.
    x : (2,) m, inside the automean; None: the middle of the bounds where that is inside, else a
        point inside.
    xi : (2,) m, a lag at which the aperture overlaps itself; None: a quarter of the width, or of
        the height, or a sixteenth, whichever first leaves a quarter of the area.
    wavelength : m; the axes reach to |nu| = 1/wavelength. None: to 8/diameter.
    samples : points along each axis, from 2 to 4096; an odd number has nu = 0 among them.

    Raises
    ------
    ArgumentError : anything but such a source; W vanishes at this x, or A at this xi, for every
    frequency; too few or too many samples.
    GeometryError : elements of an array that do not lie in the plane z = 0.
    """
    if samples < 2:
        raise ArgumentError(f"expected at least 2 samples along an axis, got {samples}")
    if samples > LARGEST_SAMPLES:
        raise ArgumentError(
            f"expected at most {LARGEST_SAMPLES} samples along an axis, got {samples}; use fewer"
        )
    aperture, support = outline_of(source), mutual_support(flat_of(source))
    position = default_position(support, aperture.centre) if x is None else _point(x)
    lag = _default_lag(aperture) if xi is None else _point(xi)
    _check_supports(aperture, support, position, lag)
    half = _half_width(aperture, wavelength)
    frequency = np.linspace(-half, half, samples)
    grid = np.stack(np.meshgrid(frequency, frequency), axis=-1)
    return TransformSlices(
        source,
        aperture,
        support,
        position,
        lag,
        wavelength,
        _frozen(frequency),
        _frozen(pw.fourier(_in_plane(source), grid)),
        _frozen(pw.wigner(source, position, grid)),
        _frozen(pw.ambiguity(source, grid, lag)),
    )


def outline_of(source: pw.Aperture | pw.Array | pw.Wavefront) -> pw.Aperture:
    """The aperture itself, or the union of an array's elements; ArgumentError for others.

    Of a source with a curved wave that of its flat source.
    """
    source = flat_of(source)
    if isinstance(source, pw.Aperture):
        return source
    if not isinstance(source, pw.Array) or source.dimension == 1:
        got = "slits" if isinstance(source, pw.Array) else type(source).__name__
        raise ArgumentError(f"expected an aperture, or an array of apertures, got {got}")
    return source.support


def _in_plane(source: Any) -> Any:
    """A source whose Fourier transform takes two-component nu."""
    if isinstance(source, pw.Array) and source.dimension == 3:
        return pw.Array(source.elements_in_plane, source.weights)
    return source


def samples_needed(aperture: pw.Aperture, wavelength: float | None) -> int:
    """Samples along each axis that show all of |F|^2, W and A between them.

    Parameters
    ----------
    aperture : the outline of the source.
    wavelength : as for :func:`transform_slices`.
    """
    reach = _half_width(aperture, wavelength)
    return max(axis.count for axis in pw.suggest_sampling(aperture, reach=reach).axes)


def _half_width(aperture: pw.Aperture, wavelength: float | None) -> float:
    return _LOBES / aperture.diameter if wavelength is None else 1.0 / wavelength


def _point(value: ArrayLike) -> tuple[float, float]:
    point = np.asarray(value, dtype=np.float64)
    if point.shape != (2,) or not np.all(np.isfinite(point)):
        raise ArgumentError(f"expected two finite coordinates, got {value!r}")
    return float(point[0]), float(point[1])


def _frozen(values: Any) -> NDArray[Any]:
    array = np.array(values)
    array.setflags(write=False)
    return array


def default_position(support: pw.Aperture, middle: NDArray[np.float64]) -> tuple[float, float]:
    import shapely

    centre = shapely.Point(middle)
    # A representative point keeps its distance from the boundary, where W vanishes.
    region = support.polygons
    inside = centre if region.contains(centre) else region.representative_point()
    return inside.x, inside.y


def _default_lag(aperture: pw.Aperture) -> tuple[float, float]:
    """A lag that keeps a good part of the overlap, so that A differs from F and is not small."""
    xmin, ymin, xmax, ymax = aperture.bounds
    width, height = xmax - xmin, ymax - ymin
    for lag in ((width / 4, 0.0), (0.0, height / 4), (width / 16, 0.0), (0.0, height / 16)):
        if pw.position_slice(aperture, lag).area > aperture.area / 4:
            return lag
    return 0.0, 0.0


def _check_supports(
    aperture: pw.Aperture,
    support: pw.Aperture,
    x: tuple[float, float],
    xi: tuple[float, float],
) -> None:
    if not pw.lag_slice(aperture, x).area > 0:
        bounds = ", ".join(f"{b:.4g}" for b in support.bounds)
        raise ArgumentError(
            f"expected a position x inside the automean (bounds {bounds} m), where W is not zero, "
            f"got ({x[0]:.4g}, {x[1]:.4g}) m; give another, with its unit"
        )
    if not pw.position_slice(aperture, xi).area > 0:
        raise ArgumentError(
            "expected a lag xi at which the aperture overlaps its shifted copy, got "
            f"({xi[0]:.4g}, {xi[1]:.4g}) m, where A is zero; give another, with its unit"
        )
