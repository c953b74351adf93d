"""Complex weights of the elements of arrays: steering, focusing, and windows as tapers.

Weights of one array multiply: `window_weights(...) * steering_weights(...)`.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, MissingExtraError, install_command
from polywigner.geometry.arguments import checked_count, checked_length
from polywigner.geometry.frequency import takes_frequency
from polywigner.geometry.numbers import real_numbers
from polywigner.illumination.directions import transverse, unit_vector
from polywigner.illumination.layouts import MOST_ELEMENTS, checked_positions
from polywigner.illumination.tapers import checked_sidelobes

__all__ = ["WINDOWS", "focusing_weights", "steering_weights", "window_weights"]

WINDOWS = ("uniform", "taylor", "chebyshev", "hamming")
"""Windows that :func:`window_weights` knows."""


@takes_frequency
def steering_weights(
    positions: ArrayLike, direction: ArrayLike, wavelength: float
) -> NDArray[np.complex128]:
    """Weights (n,) that steer an array: w_k = exp(2 pi i s.x_k/wavelength).

    The array factor, and what the array radiates, peaks towards `direction`. The elements' own
    fields stay as they are: for those see :func:`polywigner.steering`.

    Parameters
    ----------
    positions
        (n, 2) in metres; for slits (n,) or (n, 1); (n, 3) for elements anywhere in space, which
        need a direction (3,).
    direction
        A unit vector (3,) with a positive z; or its components (2,) along the array; or for slits
        one number, the sine of the angle.
    wavelength
        In metres.

    Raises
    ------
    ArgumentError for positions out of shape, directions that do not fit them or are of no unit
    vector (see :func:`polywigner.steering`), and wavelengths that are not above zero.
    """
    places = checked_positions(positions, (1, 2, 3))
    towards = unit_vector(direction) if places.shape[1] == 3 else transverse(direction)
    if len(towards) != places.shape[1]:
        raise ArgumentError(
            f"expected a direction for positions of {places.shape[1]} components, got one with "
            f"{len(towards)} along the array"
        )
    return _phases(lambda length: places @ (towards / length), wavelength)


@takes_frequency
def focusing_weights(
    positions: ArrayLike, point: ArrayLike, wavelength: float
) -> NDArray[np.complex128]:
    """Weights (n,) that focus an array: w_k = exp(-2 pi i (R_k - R)/wavelength).

    R_k is the distance from element k to the point, R that from the origin: the waves
    exp(2 pi i R_k/wavelength)/R_k of all elements arrive in phase. They only turn phases. Far away
    they are the :func:`steering_weights` towards the point.

    Parameters
    ----------
    positions
        (n, 2) in metres, in the plane z = 0.
    point
        (x, y, z) in metres, z > 0.
    wavelength
        In metres.

    Raises
    ------
    ArgumentError for positions or points out of shape, a point not in front of the array, and
    wavelengths that are not above zero.
    """
    places = checked_positions(positions, (2,))
    try:
        focus = real_numbers(point)
    except ValueError:
        focus = np.empty(0)
    if focus.shape != (3,) or not np.isfinite(focus).all() or not focus[2] > 0:
        raise ArgumentError(f"expected a point (x, y, z) with z above zero, got {point!r}")
    distance = np.linalg.norm(
        np.column_stack([focus[:2] - places, np.full(len(places), focus[2])]), axis=1
    )
    # R_k - R without the difference of two long distances
    path = ((places - 2 * focus[:2]) * places).sum(axis=1) / (distance + np.linalg.norm(focus))
    return _phases(lambda length: -path / length, wavelength)


def _phases(turns: Callable[[float], NDArray[np.float64]], wavelength: Any) -> Any:
    """exp(2 pi i turns) of what a wavelength makes of distances."""
    length = checked_length(wavelength, "wavelength")
    with np.errstate(over="ignore", invalid="ignore"):
        found = turns(length)
    if not np.isfinite(found).all():
        raise ArgumentError(
            f"expected a wavelength in metres for positions in metres, got {wavelength!r}, of "
            "which there are too many between them for a float; check its unit"
        )
    return np.exp(2j * np.pi * found)


def window_weights(
    shape: int | Sequence[int],
    window: str | Sequence[str],
    sll: float = 30.0,
    nbar: int = 4,
) -> NDArray[np.float64]:
    """Amplitudes of a taper over a row or a grid of elements, real, the largest in size 1.

    Parameters
    ----------
    shape
        n elements in a row, or (nx, ny) in a grid.
    window
        "uniform", "taylor", "chebyshev" (Dolph) or "hamming"; or one for each axis. Taylor and
        Chebyshev are scipy's and need the extra `arrays`.
    sll
        Of "taylor" and "chebyshev": sidelobe suppression in dB, above 0 and up to 200.
    nbar
        Of "taylor": number of sidelobes at about this level, plus one.

    Returns
    -------
    (n,), or (nx ny,) with y running fastest, as :func:`grid_positions` has the elements.

    Raises
    ------
    ArgumentError for shapes, windows and options out of range; MissingExtraError without scipy.
    """
    sizes = tuple(shape) if isinstance(shape, Sequence) else (shape,)
    if len(sizes) not in (1, 2):
        raise ArgumentError(f"expected a shape of n or (nx, ny), got {shape!r}")
    names = (window,) * len(sizes) if isinstance(window, str) else tuple(window)
    if len(names) != len(sizes):
        raise ArgumentError(f"expected {len(sizes)} windows, got {window!r}")
    decibels, zeros = checked_sidelobes(sll, nbar)
    if np.prod([checked_count(n, "shape", 1) for n in sizes], dtype=object) > MOST_ELEMENTS:
        raise ArgumentError(f"expected at most {MOST_ELEMENTS} elements, got {shape!r}")
    along = [_window(n, name, decibels, zeros) for n, name in zip(sizes, names, strict=True)]
    whole = along[0] if len(along) == 1 else np.multiply.outer(*along).ravel()
    # The largest amplitude may be negative if there are few sidelobes, which hardly fall off.
    return np.asarray(whole / whole[np.abs(whole).argmax()])


def _window(count: int, name: str, sll: float, nbar: int) -> NDArray[np.float64]:
    if name not in WINDOWS:
        raise ArgumentError(f"expected one of the windows {', '.join(WINDOWS)}, got {name!r}")
    if name == "uniform" or count == 1:
        return np.ones(count)
    if name == "hamming":
        return np.hamming(count)
    windows = _scipy_windows(name)
    if name == "taylor":
        return np.asarray(windows.taylor(count, nbar=nbar, sll=sll, norm=True, sym=True))
    with warnings.catch_warnings():
        # It warns below 45 dB that the window is a poor one for spectra of signals.
        warnings.simplefilter("ignore")
        return np.asarray(windows.chebwin(count, at=sll))


def _scipy_windows(name: str) -> Any:
    try:
        return importlib.import_module("scipy.signal.windows")
    except ImportError:
        raise MissingExtraError(
            f"expected scipy to be installed, which has the window {name!r}, got none; run "
            f"{install_command('arrays')}"
        ) from None
