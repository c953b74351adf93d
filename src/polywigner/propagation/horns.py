"""Horn apertures: the TE10 mode of a rectangular waveguide, with the phase of the flare.

The electric field is parallel to y. The mode is a cosine along x (H plane) and constant along y (E
plane). Textbooks denote the width of the mouth and the radius along x by a_1 and rho_2, and the
height and the radius along y by b_1 and rho_1.

- ``pyramidal`` : horn that flares along x and y
- ``e_plane`` : sectoral horn that flares along y
- ``h_plane`` : sectoral horn that flares along x
- ``directivity`` : textbook directivity on the axis
"""

from __future__ import annotations

import math

import numpy as np

from polywigner.geometry import Wavefront, shapes
from polywigner.geometry.arguments import checked_length, checked_wavelength, takes_frequency
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.source import te_mode
from polywigner.transforms import fourier, lag_marginal

__all__ = ["directivity", "e_plane", "h_plane", "pyramidal"]


@takes_frequency
def pyramidal(
    width: float, height: float, radius_x: float, radius_y: float, wavelength: float
) -> Wavefront:
    """Return the aperture of a pyramidal horn as a source with a curved wave.

    The field is ``cos(pi x/width)`` with the phase ``pi (x^2/radius_x + y^2/radius_y)/wavelength``,
    as in Balanis, "Antenna Theory", section 13.4. The quadratic phase differs from the phase of the
    exact path length from the apex by about x^4/(8 wavelength radius_x^3) cycles.

    Parameters
    ----------
    width, height : float
        Size of the mouth along x (H plane) and y (E plane) in m.
    radius_x, radius_y : float
        Distances in m from the mouth to the apex of the walls that flare along x and along y; inf
        for parallel walls.
    wavelength : float
        Wavelength in m.

    Returns
    -------
    Wavefront
        Source with a curved wave, centred at the origin, with a peak field of 1.

    Raises
    ------
    ArgumentError
        If a length is not above zero.

    Examples
    --------
    >>> import polywigner as pw
    >>> horn = pw.horns.pyramidal(5.5, 2.75, 6.0, 6.0, 1.0)  # in wavelengths
    >>> round(10 * float(np.log10(pw.horns.directivity(horn, 1.0))), 2)  # dB
    18.83
    """
    for name, radius in (("radius_x", radius_x), ("radius_y", radius_y)):
        if not isinstance(radius, float) or radius != math.inf:
            checked_length(radius, f"{name} of a horn")
    mouth = shapes.rectangle(width, height).with_illumination(te_mode(width, height))
    return mouth.curved((radius_x, radius_y), wavelength)


@takes_frequency
def e_plane(width: float, height: float, radius: float, wavelength: float) -> Wavefront:
    """Return the aperture of a sectoral horn that flares along y, in the E plane.

    ``width`` is the width of the waveguide in m; ``radius`` is ``radius_y`` of :func:`pyramidal`.

    Examples
    --------
    >>> import polywigner as pw
    >>> horn = pw.horns.e_plane(0.5, 2.75, 6.0, 1.0)
    >>> round(10 * float(np.log10(pw.horns.directivity(horn, 1.0))), 2)  # dB
    11.08
    """
    return pyramidal(width, height, math.inf, radius, wavelength)


@takes_frequency
def h_plane(width: float, height: float, radius: float, wavelength: float) -> Wavefront:
    """Return the aperture of a sectoral horn that flares along x, in the H plane.

    ``height`` is the height of the waveguide in m; ``radius`` is ``radius_x`` of :func:`pyramidal`.

    Examples
    --------
    >>> import polywigner as pw
    >>> horn = pw.horns.h_plane(5.5, 0.25, 6.0, 1.0)
    >>> round(10 * float(np.log10(pw.horns.directivity(horn, 1.0))), 2)  # dB
    8.79
    """
    return pyramidal(width, height, radius, math.inf, wavelength)


@takes_frequency
def directivity(source: PlaneSource | Wavefront, wavelength: float) -> float:
    """Return the textbook directivity of an aperture on its axis.

    The directivity is ``4 pi |F(0)|^2/(wavelength^2 int |u|^2)``, where F is the Fourier transform
    of the field u. For a horn this is Balanis' formula (13-52) with Fresnel integrals. The
    directivity is relative to the power in the aperture, while :func:`polywigner.radiation_pattern`
    uses the power of the far field.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    wavelength : float
        Wavelength in m.

    Returns
    -------
    float
        Directivity as a ratio to an isotropic source.

    Raises
    ------
    PolywignerError
        See :func:`polywigner.radiant_intensity`.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(pw.horns.directivity(pw.shapes.square(1.0), 1.0) / (4 * np.pi), 12)
    1.0
    """
    radiator = checked_radiator(source)
    length = checked_wavelength(wavelength)
    energy = float(np.real(lag_marginal(radiator, (0.0, 0.0))))
    return 4 * math.pi * float(abs(fourier(radiator, (0.0, 0.0))) / length) ** 2 / energy
