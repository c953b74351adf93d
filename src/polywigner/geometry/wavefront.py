"""Sources with curved or partially coherent waves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError, value_text
from polywigner.geometry.arguments import (
    Immutable,
    checked_length,
    checked_row,
    checked_wavelength,
    finite_array,
)
from polywigner.geometry.illumination import checked_shift, turned_points


class TakesWaves(Immutable):
    """Base class of all sources, with methods for curved and partially coherent waves."""

    def at_wavelength(self, wavelength: float) -> Any:
        """Return this source at another wavelength, with the phases of its path lengths converted.

        Curved waves made by ``curved`` and the pistons and tilts of
        :func:`polywigner.segmented_pupil` are path lengths: their phases grow with the frequency.
        All other phases (weights, illuminations, ``Wavefront(curvature=)``) stay constant, as
        behind phase shifters. Functions that take a wavelength call this method.

        Parameters
        ----------
        wavelength : float
            Wavelength in metres.

        Returns
        -------
        Aperture, Slits, Array or Wavefront
            The source at this wavelength; the same object if no phase changes.

        Raises
        ------
        ArgumentError
            If the wavelength is not a number above zero.

        Examples
        --------
        >>> import polywigner as pw
        >>> wave = pw.shapes.square(0.01).curved(0.05, 4e-3)
        >>> wave.at_wavelength(2e-3).curvature.diagonal().tolist()
        [10000.0, 10000.0]
        """
        checked_wavelength(wavelength)
        return self

    def curved(
        self, radius: float | Sequence[float], wavelength: float, centre: ArrayLike | None = None
    ) -> Wavefront:
        """Return this source with its field times exp(i pi |x - c|^2 / (wavelength R)).

        This quadratic phase describes the wave in the aperture of a horn, or defocus. If the source
        already has a curved wave, the phases of both waves are added.

        Parameters
        ----------
        radius : float or sequence of float
            Radius of curvature R in metres, or one radius for each axis. R > 0: diverging, as from
            a point at a distance R behind the aperture; R < 0: converging; infinite: flat.
        wavelength : float
            Wavelength in metres. The radius is the same at other wavelengths, see
            :meth:`at_wavelength`.
        centre : array_like, shape (d,), optional
            Point c in metres at which the wave touches the plane. The default is the centre of the
            present curved wave, or the origin.

        Returns
        -------
        Wavefront
            The source with the curved wave.

        Raises
        ------
        ArgumentError
            If the radius is zero or NaN, or the wavelength is not a number above zero.
        IlluminationError
            If the source already has a curved wave with another centre.

        References
        ----------
        M. J. Bastiaans, "The Wigner distribution function applied to optical signals and systems",
        Optics Communications, 1978.

        Examples
        --------
        >>> import polywigner as pw
        >>> pw.shapes.square(0.01).curved(0.05, 3e-3).curvature.diagonal().round(1).tolist()
        [6666.7, 6666.7]
        """
        wave = self if isinstance(self, Wavefront) else Wavefront(self)
        q = _curvature_of(radius, wavelength, wave.dimension)
        if wave.is_flat:
            wave = wave._with(wavelength=float(wavelength))
        elif wave.wavelength is not None:
            wave = wave.at_wavelength(wavelength)
        if not wave.is_flat and centre is not None and not np.array_equal(wave.centre, centre):
            raise IlluminationError(
                "expected curved waves with the same centre, got two different centres; omit "
                "the second centre"
            )
        c = wave.centre if centre is None else centre
        return wave._with(curvature=wave.curvature + q, centre=c)

    def partially_coherent(self, width: float) -> Wavefront:
        """Return this source as a Gaussian Schell-model source.

        The degree of coherence of two points a distance xi apart is exp(-xi^2 / (2 width^2)).

        Parameters
        ----------
        width : float
            Coherence width in metres, at which the degree of coherence is exp(-1/2); inf for full
            coherence.

        Returns
        -------
        Wavefront
            The partially coherent source. The degrees of coherence of repeated calls multiply.

        Raises
        ------
        ArgumentError
            If the width is not a length above zero.

        References
        ----------
        L. Mandel and E. Wolf, "Optical Coherence and Quantum Optics", section 5.2, 1995.

        Examples
        --------
        >>> import polywigner as pw
        >>> pw.shapes.square(0.01).partially_coherent(2e-3).coherence_width
        0.002
        """
        wave = self if isinstance(self, Wavefront) else Wavefront(self)
        least, most = sorted((_checked_width(width, "width"), wave.coherence_width))
        if least == np.inf:
            return wave
        # The new width is 1/sqrt(1/least^2 + 1/most^2), computed without squares that could
        # overflow.
        return wave._with(coherence_width=least / math.hypot(1.0, least / most))


@final
class Wavefront(TakesWaves):
    """A source with a curved or partially coherent wave.

    The methods ``curved`` and ``partially_coherent`` of sources make wavefronts. The field of
    ``source`` is multiplied by exp(i pi (x - c)^T Q (x - c)), and the mutual coherence of two
    points a distance xi apart is multiplied by exp(-xi^2 / (2 width^2)).

    Parameters
    ----------
    source : Aperture, Slits or Array
        The flat and coherent source in one plane, in d dimensions.
    curvature : array_like, shape (d, d), optional
        Symmetric matrix Q in 1/m^2; by default zero, a flat wave.
    centre : array_like, shape (d,), optional
        Point c in metres; by default the origin.
    coherence_width : float, default inf
        Coherence width in metres, inf for full coherence.
    wavelength : float, optional
        Wavelength in metres at which the curvature applies. The curvature is inversely proportional
        to the wavelength. By default, the curvature is the same at all wavelengths.

    Raises
    ------
    ArgumentError
        If the source has an unsupported type, the centre is not d finite numbers, or the width is
        not above zero.
    IlluminationError
        If the curvature is not a symmetric matrix of finite numbers.

    Examples
    --------
    >>> import polywigner as pw
    >>> wave = pw.shapes.square(10e-3).curved((0.05, float("inf")), 3.2e-3)
    >>> round(float(abs(pw.fourier(wave, (0.0, 0.0)))) * 1e6, 3)  # mm^2; flat: 100
    98.933
    """

    source: Any
    """Flat, coherent source that carries the wave: an Aperture, Slits, or an Array in one plane."""
    curvature: NDArray[np.float64]
    """Matrix Q in 1/m^2, shape (d, d), read-only, with diagonal 1/(wavelength radius)."""
    centre: NDArray[np.float64]
    """Point c in metres, shape (d,), read-only, where a curved wave touches the plane."""
    coherence_width: float
    """Coherence width in m (standard deviation of the degree of coherence), inf if coherent."""
    wavelength: float | None
    """Wavelength in metres at which the curvature holds; None if it holds at all wavelengths."""

    def __init__(
        self,
        source: Any,
        curvature: ArrayLike | None = None,
        centre: ArrayLike | None = None,
        coherence_width: float = np.inf,
        wavelength: float | None = None,
    ) -> None:
        if isinstance(source, Wavefront) or not hasattr(type(source), "curved"):
            raise ArgumentError(
                f"expected an Aperture, Slits or an Array, got {type(source).__name__}; to change "
                "a Wavefront, call its methods curved and partially_coherent"
            )
        d = len(source.bounds) // 2
        expected = f"expected a curvature as a symmetric matrix of shape {(d, d)} in 1/m^2"
        q = np.zeros((d, d))
        if curvature is not None:
            q = finite_array(curvature, expected, (d, d), error=IlluminationError)
        c = np.zeros(d) if centre is None else checked_shift(centre, d, "a centre")
        if not np.array_equal(q, q.T):
            raise IlluminationError(f"{expected}, got {value_text(curvature)}")
        c = c.copy() if q.any() else np.zeros(d)
        width = _checked_width(coherence_width, "coherence_width")
        length = None if wavelength is None else checked_wavelength(wavelength)
        self._set(source=source, curvature=q, centre=c, coherence_width=width, wavelength=length)

    def at_wavelength(self, wavelength: float) -> Wavefront:
        """Convert the source and the curvature of its wave to another wavelength in m."""
        length = checked_wavelength(wavelength)
        source = self.source.at_wavelength(length)
        if self.wavelength in (None, length):
            return self if source is self.source else self._with(source=source)
        q = self.curvature * (self.wavelength / length)
        return self._with(source=source, curvature=q, wavelength=length)

    def _with(self, **changes: Any) -> Wavefront:
        """Return a copy of the wavefront with other values of some constructor arguments."""
        return Wavefront(**{**self.__getstate__(), **changes})

    @property
    def dimension(self) -> int:
        """Number d of components of a position: 2 for apertures, 1 for slits."""
        return len(self.centre)

    @property
    def is_flat(self) -> bool:
        """Whether the curvature is zero."""
        return not self.curvature.any()

    @property
    def is_coherent(self) -> bool:
        """Whether all points of the source are coherent with one another."""
        return self.coherence_width == np.inf

    @property
    def coherent(self) -> Any:
        """The fully coherent source, with its curved wave if there is one."""
        if self.is_flat:
            return self.source
        return self._with(coherence_width=np.inf)

    @property
    def bounds(self) -> tuple[float, ...]:
        """Bounds of the source in m: (xmin, ymin, xmax, ymax), or (start, end) for slits."""
        bounds: tuple[float, ...] = self.source.bounds
        return bounds

    @property
    def area(self) -> float:
        """Area of an aperture in m^2."""
        return float(self.source.area)

    @property
    def diameter(self) -> float:
        """Largest distance between two points of the source in metres."""
        return float(self.source.diameter)

    def plot(self, ax: Any = None, unit: str = "mm") -> Any:
        """Plot the outline of an aperture, see :meth:`Aperture.plot`."""
        return self._source_method("plot")(ax, unit)

    def _source_method(self, name: str) -> Any:
        """Return a method of the flat source; raise ArgumentError if the source has none."""
        method = getattr(self.source, name, None)
        if method is None:
            kind = type(self.source).__name__
            raise ArgumentError(
                f"expected a wave on an Aperture for {name}, got a wave on {kind}; for an "
                f"array, apply {name} to each element with its wave, and pass the results to Array"
            )
        return method

    def on(self, source: Any, shift: ArrayLike | None = None) -> Wavefront:
        """Apply this wave, translated by ``shift`` in metres, shape (d,), to another source.

        The other source is not translated.
        """
        moved = 0.0 if shift is None else checked_shift(shift, self.dimension)
        return self._with(source=source, centre=self.centre + moved)

    def moved(self, shift: ArrayLike) -> Wavefront:
        """Return the source and its wave, translated by ``shift`` in metres, shape (d,).

        Raises ArgumentError if the source is an array.
        """
        offset = checked_shift(shift, self.dimension)
        return self._with(source=self._source_method("moved")(offset), centre=self.centre + offset)

    def turned(self, angle: float) -> Wavefront:
        """Return the source and its wave, rotated counter-clockwise about the origin.

        The angle is in radians. Raises IlluminationError for slits, and ArgumentError for an array.
        """
        if self.dimension != 2:
            raise IlluminationError("expected an aperture as the source to rotate, got slits")
        rotation = turned_points(np.eye(2), angle).T
        q = rotation @ self.curvature @ rotation.T
        centre = turned_points(self.centre[None], angle)[0]
        return self._with(
            source=self._source_method("turned")(angle), curvature=(q + q.T) / 2, centre=centre
        )

    def scaled(self, factor: float) -> Wavefront:
        """Return the source and its wave, scaled about the origin by a factor above zero.

        The coherence width is scaled too, and the curvature is divided by factor^2. Raises
        ArgumentError if the source has no method ``scaled``.
        """
        size = checked_length(factor, "factor")
        return self._with(
            source=self._source_method("scaled")(size),
            curvature=self.curvature / size**2,
            centre=self.centre * size,
            coherence_width=self.coherence_width * size,
        )

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        """Source and parameters of its wave, which are equal for equal wavefronts."""
        q, c = self.curvature + 0.0, self.centre + 0.0
        design = None if self.is_flat else self.wavelength
        return self.source, q.tobytes(), c.tobytes(), self.coherence_width, design

    def __repr__(self) -> str:
        properties = [] if self.is_flat else [f"curvature {self.curvature.tolist()} /m^2"]
        properties += [] if self.is_coherent else [f"coherent over {self.coherence_width:g} m"]
        return f"Wavefront({self.source!r}, {', '.join(properties) or 'flat, coherent'})"


def _curvature_of(
    radius: float | Sequence[float], wavelength: float, dimension: int
) -> NDArray[np.float64]:
    """Return the curvature matrix (d, d) in 1/m^2 for one radius, or one per axis, in m.

    The diagonal of the matrix is 1/(wavelength radius), and 0 for infinite radii. Raises
    ArgumentError for other radii and wavelengths.
    """
    length = checked_wavelength(wavelength)
    axes = "a number" if dimension == 1 else "a number or a pair (radius_x, radius_y)"
    expected = (
        f"expected radius to be {axes} in m, positive for diverging waves and inf for flat waves"
    )
    radii = checked_row(radius, expected)
    if len(radii) not in (1, dimension) or np.isnan(radii).any() or (radii == 0).any():
        raise ArgumentError(f"{expected}, got {value_text(radius)}")
    return np.diag(1.0 / (length * np.broadcast_to(radii, dimension)))


def _checked_width(value: Any, name: str) -> float:
    """Return a coherence width, which may be infinite; raise ArgumentError unless it is above 0."""
    if np.isscalar(value) and value == np.inf:
        return math.inf
    return checked_length(value, name)
