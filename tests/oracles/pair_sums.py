"""Transforms of several waves on one outline, and of copies of one element, as sums over pairs.

Each pair is a transform of the plain outline, or of the element alone, elsewhere (docs/theory.md,
(I1), (L1), (L2)). Phases are reduced in rational arithmetic, so that places far from the origin
cost no digits.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np

import polywigner as pw

__all__ = [
    "ambiguity_of_copies",
    "ambiguity_of_waves",
    "fourier_of_waves",
    "wigner_of_copies",
    "wigner_of_waves",
]

Values = np.ndarray
Transform = Callable[[pw.Aperture, Values, Values], Values]


def fourier_of_waves(source: pw.Aperture, nu: Values) -> Values:
    """(...,) F(nu) = sum over waves of c F0(nu - kappa)."""
    outline, centre, c, kappa = _at_the_centre(source)
    apart = pw.fourier(outline, nu[..., None, :] - kappa, engine="numpy")
    found: Values = _wave(-nu, centre) * (apart @ c)
    return found


def wigner_of_waves(source: pw.Aperture, x: Values, nu: Values) -> Values:
    """(n,) W: c_m c_n* exp(2 pi i (kappa_m - kappa_n).x) W0(x, nu - (kappa_m + kappa_n)/2)."""
    outline, centre, c, kappa = _at_the_centre(source)
    x, total = x - centre, np.zeros(len(x))
    for amplitude, wave in zip(c, kappa, strict=True):
        apart = x @ (wave - kappa).T
        middle = nu[:, None] - (wave + kappa) / 2
        plain = pw.wigner(outline, x[:, None], middle, engine="numpy")
        total += (plain * np.exp(2j * np.pi * apart) @ (amplitude * c.conj())).real
    return total


def ambiguity_of_waves(source: pw.Aperture, upsilon: Values, xi: Values) -> Values:
    """(n,) A: c_m c_n* exp(pi i (kappa_m + kappa_n).xi) A0(upsilon - kappa_m + kappa_n, xi)."""
    outline, centre, c, kappa = _at_the_centre(source)
    total = np.zeros(len(xi), complex)
    for amplitude, wave in zip(c, kappa, strict=True):
        middle = xi @ (wave + kappa).T / 2
        apart = upsilon[:, None] - (wave - kappa)
        plain = pw.ambiguity(outline, apart, xi[:, None], engine="numpy")
        total += plain * np.exp(2j * np.pi * middle) @ (amplitude * c.conj())
    return total * _wave(-upsilon, centre)


def wigner_of_copies(
    array: pw.Array, x: Values, nu: Values, wigner: Transform | None = None
) -> Values:
    """(n,) W of one element at many places: w_j w_k* exp(-2 pi i nu.(p_j - p_k)) W(x - p, nu).

    p is the middle of p_j and p_k; ``wigner`` that of the element, if not :func:`pw.wigner`.
    """
    element, places, half = _copies(array)
    middles = (places[:, None] + places) / 2
    near = np.abs(x[:, None, None] - middles - element.centre) <= half
    n, j, k = np.nonzero(near.all(axis=-1))
    weight = array.weights[j] * array.weights[k].conj()
    turns = (nu[n] * (places[j] - places[k])).sum(axis=-1)
    values = (wigner or _wigner)(element, x[n] - middles[j, k], nu[n])
    return np.bincount(n, (weight * np.exp(-2j * np.pi * turns)).real * values, len(x))


def ambiguity_of_copies(
    array: pw.Array, upsilon: Values, xi: Values, ambiguity: Transform | None = None
) -> Values:
    """(n,) A of one element at many places: w_j w_k* exp(-2 pi i upsilon.p) A(upsilon, xi - d).

    p is the middle of p_j and p_k, and d their difference p_j - p_k.
    """
    element, places, half = _copies(array)
    apart = places[:, None] - places
    n, j, k = np.nonzero((np.abs(xi[:, None, None] - apart) <= 2 * half).all(axis=-1))
    weight = array.weights[j] * array.weights[k].conj()
    turns = (upsilon[n] * (places[j] + places[k])).sum(axis=-1) / 2
    values = (ambiguity or _ambiguity)(element, upsilon[n], xi[n] - apart[j, k])
    terms = weight * np.exp(-2j * np.pi * turns) * values
    real, imag = (np.bincount(n, part, len(xi)) for part in (terms.real, terms.imag))
    return real + 1j * imag


def _wigner(element: pw.Aperture, x: Values, nu: Values) -> Values:
    return np.asarray(pw.wigner(element, x, nu, engine="numpy"))


def _ambiguity(element: pw.Aperture, upsilon: Values, xi: Values) -> Values:
    return np.asarray(pw.ambiguity(element, upsilon, xi, engine="numpy"))


def _copies(array: pw.Array) -> tuple[pw.Aperture, Values, Values]:
    """The element, the places of its copies (n, 2), and half of its sides (2,)."""
    assert array.repeated is not None
    element, places = array.repeated
    low, high = np.reshape(element.bounds, (2, 2))
    return element, places, (high - low) / 2


def _at_the_centre(source: pw.Aperture) -> tuple[pw.Aperture, Values, Values, Values]:
    """The plain outline about the origin, where its centre was, and the waves seen from there."""
    field, centre = source.illumination, source.centre
    assert field is not None
    outline = source.with_illumination(None).moved(-centre)
    return outline, centre, field.amplitudes * _wave(field.frequencies, centre), field.frequencies


def _wave(frequencies: Values, place: Values) -> Values:
    """exp(2 pi i frequency.place) for each of the frequencies (n, 2)."""
    exact = [Fraction(p) for p in place.tolist()]
    turns = [
        float(sum((Fraction(f) * p for f, p in zip(row, exact, strict=True)), Fraction()) % 1)
        for row in frequencies.tolist()
    ]
    return np.exp(2j * np.pi * np.array(turns))
