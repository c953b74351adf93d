"""Layouts and weights of arrays for :func:`polywigner.phased_array`, and tables of elements."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, FileFormatError, at_key, require, value_text
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import (
    check_most,
    checked_choice,
    checked_count,
    checked_length,
    checked_number,
    checked_path,
    checked_type,
    finite_array,
    takes_frequency,
)
from polywigner.geometry.io.limits import bytes_of, text_of
from polywigner.geometry.io.readers import table_rows
from polywigner.numerics import Complex, Floats, cluster_indices
from polywigner.quantities import parse_unit
from polywigner.source.array import Array, repeated_element, warn_of_overlaps
from polywigner.source.lattices import checked_positions, checked_weights
from polywigner.source.tapers import checked_sidelobes, transverse, unit_vector

__all__ = [
    "focusing_weights",
    "grid_positions",
    "read_elements",
    "ring_positions",
    "steering_weights",
    "thinned",
    "triangular_positions",
    "virtual_array",
    "window_weights",
]

MOST_ELEMENTS = 2**20
"""Largest number of elements in a layout; their positions take 16 MiB."""


def grid_positions(nx: int, ny: int, pitch_x: float, pitch_y: float | None = None) -> Floats:
    """Return the positions of a rectangular lattice, (nx ny, 2), with y varying fastest.

    The element `grid_positions(nx, ny, ...).reshape(nx, ny, 2)[i, j]` is at ((i - (nx - 1)/2)
    pitch_x, (j - (ny - 1)/2) pitch_y). For slits, pass the x values of one row,
    `grid_positions(n, 1, pitch)[:, 0]`.

    Parameters
    ----------
    nx, ny : int
        Number of elements along x and y.
    pitch_x : float
        Distance between neighbours along x in m.
    pitch_y : float, optional
        Distance between neighbours along y in m; default: ``pitch_x``.

    Returns
    -------
    ndarray of float, shape (nx ny, 2)
        Positions in m.

    Raises
    ------
    ArgumentError
        If a count is below 1, a pitch is not above zero, or there are more than 2^20 elements.
    """
    return _lattice_positions(nx, ny, pitch_x, pitch_y, 1.0, False)


def triangular_positions(nx: int, ny: int, pitch_x: float, pitch_y: float | None = None) -> Floats:
    """Return a triangular lattice: ny rows of nx elements, alternately shifted by half a pitch.

    Compared with :func:`grid_positions`, even rows are shifted to the left and odd rows to the
    right, by a quarter of pitch_x.

    Parameters
    ----------
    nx, ny : int
        Number of elements in a row, and number of rows.
    pitch_x : float
        Distance between neighbours in a row in m.
    pitch_y : float, optional
        Distance between rows in m; default: sqrt(3)/2 pitch_x, for equilateral triangles.

    Returns
    -------
    ndarray of float, shape (nx ny, 2)
        Positions in m, with y varying fastest.

    Raises
    ------
    ArgumentError
        For the same arguments as in :func:`grid_positions`.
    """
    return _lattice_positions(nx, ny, pitch_x, pitch_y, math.sqrt(0.75), True)


def _lattice_positions(
    nx: int, ny: int, pitch_x: float, pitch_y: float | None, stretch: float, is_staggered: bool
) -> Floats:
    """Return positions (nx ny, 2) in m of a rectangular lattice, optionally with staggered rows.

    ``stretch``: default value of ``pitch_y`` as a multiple of ``pitch_x``.
    """
    columns, rows = checked_count(nx, "nx", 1), checked_count(ny, "ny", 1)
    check_most(columns * rows, MOST_ELEMENTS, "elements", "use fewer elements")
    across = checked_length(pitch_x, "pitch_x")
    up = across * stretch if pitch_y is None else checked_length(pitch_y, "pitch_y")
    side = 2 * (np.arange(rows) % 2) - 1 if is_staggered and rows > 1 else np.zeros(rows, np.int64)
    along_x = (2 * _centred_steps(columns)[:, None] + side) * (across / 4)
    along_y = np.broadcast_to(_centred_steps(rows) * (up / 2), along_x.shape)
    return np.stack([along_x, along_y], axis=-1).reshape(-1, 2)


def ring_positions(radii: ArrayLike, counts: ArrayLike) -> Floats:
    """Return concentric rings: counts[k] elements at equal angles on a circle of radius radii[k].

    Parameters
    ----------
    radii : float or array_like, shape (k,)
        Radii of the rings in m. A radius of 0 with a count of 1 is an element at the centre.
    counts : int or array_like, shape (k,)
        Number of elements in each ring.

    Returns
    -------
    ndarray of float, shape (sum of counts, 2)
        Positions in m, sorted by ring, and counter-clockwise from the x axis within each ring.

    Raises
    ------
    ArgumentError
        If a radius is below zero, a count is below 1, several elements are at the centre, the
        numbers of counts and radii differ, or there are more than 2^20 elements.
    """
    sizes = [checked_length(r, "each of the radii", zero=True) for r in _as_list(radii)]
    numbers = [checked_count(n, "each of the counts", 1, MOST_ELEMENTS) for n in _as_list(counts)]
    if len(sizes) != len(numbers) or not sizes:
        raise ArgumentError(
            f"expected as many radii as counts, got {len(sizes)} radii and {len(numbers)} counts"
        )
    check_most(sum(numbers), MOST_ELEMENTS, "elements", "use fewer elements")
    if any(size == 0 and number > 1 for size, number in zip(sizes, numbers, strict=True)):
        raise ArgumentError(
            "expected at most one element at radius 0, got several; use the count 1"
        )
    angles = [2 * np.pi * np.arange(n) / n for n in numbers]
    rings = [r * np.stack([np.cos(a), np.sin(a)], 1) for r, a in zip(sizes, angles, strict=True)]
    return np.concatenate(rings) + 0.0


def thinned(positions: ArrayLike, fill: float, seed: int, taper: ArrayLike | None = None) -> Floats:
    """Return positions drawn at random from a full layout (statistical thinning).

    Each element is drawn independently with a probability p_k proportional to the taper. The mean
    number of drawn elements is fill times n. With weights of 1, the mean pattern is the pattern of
    the tapered full array plus a floor:

        <|AF|^2> = |sum_k p_k exp(-2 pi i nu.x_k)|^2 + sum_k p_k (1 - p_k)

    Parameters
    ----------
    positions : array_like, shape (n, 2) or (n, 3)
        Full layout in m, of shape (n,) or (n, 1) for slits.
    fill : float
        Mean fraction of drawn elements, above 0 and up to 1, or up to mean/peak of the taper.
    seed : int
        Seed of NumPy's default generator: equal seeds draw the same elements.
    taper : array_like, shape (n,), optional
        Non-negative real weights of the full array; default: all equal.

    Returns
    -------
    ndarray of float, shape (m, d)
        The m drawn positions in their original order.

    Raises
    ------
    ArgumentError
        If an argument has the wrong shape or range.

    References
    ----------
    M. I. Skolnik, J. W. Sherman, F. C. Ogg, IEEE Trans. Antennas Propag. 12 (1964) 408-417.
    """
    layout = checked_positions(positions, (1, 2, 3))
    expected = f"expected a taper of {len(layout)} real weights of zero or more"
    density = np.ones(len(layout))
    if taper is not None:
        density = finite_array(taper, expected, layout.shape[:1])
    if not (density >= 0).all() or not density.any():
        raise ArgumentError(f"{expected}, got {value_text(taper)}")
    most = float(density.mean() / density.max())
    meaning = f"above 0 and up to {most:.6g}, the mean of the taper divided by its peak"
    fraction = checked_number(fill, "fill", meaning, lambda x: 0 < x <= most)
    random = np.random.default_rng(checked_count(seed, "seed", 0))
    is_drawn = random.random(len(layout)) < density * (fraction / density.mean())
    if not is_drawn.any():
        raise ArgumentError(
            "no element was drawn with this seed; use another seed, or a larger fill"
        )
    return layout[is_drawn]


def _as_list(values: Any) -> list[Any]:
    """Return several values as a list, and a single value as a list with one entry."""
    return list(values) if np.iterable(values) else [values]


def _centred_steps(count: int) -> NDArray[np.int64]:
    """Return the positions -(n - 1), -(n - 3), ..., n - 1 of n elements, in half pitches."""
    return 2 * np.arange(count) - (count - 1)


# Largest difference between coordinates that count as equal, as a fraction of the largest one.
_EQUAL_POSITIONS = 1e-12


def virtual_array(
    transmit: ArrayLike,
    receive: ArrayLike,
    transmit_weights: ArrayLike | None = None,
    receive_weights: ArrayLike | None = None,
) -> tuple[Floats, Complex]:
    """Return positions and weights of the virtual array of a transmitter and a receiver.

    Far from a radar, the path from transmitting element j to receiving element k is equivalent to
    one element at x_j + y_k with the weight v_j w_k. The array factor is therefore the product of
    the array factors of transmitter and receiver. Elements at equal positions are merged, and their
    weights are added.

    Parameters
    ----------
    transmit, receive : array_like, shape (n, d) and (m, d)
        Positions in m, with d = 2. The shape is (n,) or (n, 1) for slits, and (n, 3) in space.
    transmit_weights, receive_weights : array_like, shape (n,) and (m,), optional
        Complex weights; default: all 1.

    Returns
    -------
    positions : ndarray of float, shape (p, d)
        Positions in m, with p <= n m, sorted by x, then y, then z.
    weights : ndarray of complex, shape (p,)
        Weights of the virtual elements.

    Raises
    ------
    ArgumentError
        If positions have the wrong shape or different dimensions, or there are more than 2^20
        products.
    IlluminationError
        If weights are not n finite complex numbers, or are all zero.

    Examples
    --------
    >>> import polywigner as pw
    >>> positions, weights = pw.arrays.virtual_array([0.0, 2e-3], [0.0, 1e-3])
    >>> positions[:, 0].tolist(), weights.real.tolist()
    ([0.0, 0.001, 0.002, 0.003], [1.0, 1.0, 1.0, 1.0])
    """
    sent, received = (checked_positions(p, (1, 2, 3)) for p in (transmit, receive))
    if sent.shape[1] != received.shape[1]:
        raise ArgumentError(
            "expected transmit and receive positions with the same number of components, got "
            f"{sent.shape[1]} and {received.shape[1]}"
        )
    check_most(len(sent) * len(received), MOST_ELEMENTS, "elements", "use fewer elements")
    v = checked_weights(transmit_weights, len(sent))
    w = checked_weights(receive_weights, len(received))
    positions = (sent[:, None] + received).reshape(-1, sent.shape[1])
    near = _EQUAL_POSITIONS * float(max(np.abs(sent).max(), np.abs(received).max()))
    cluster = cluster_indices(positions, near)
    _, first = np.unique(cluster, return_index=True)
    weights = np.zeros(len(first), np.complex128)
    np.add.at(weights, cluster, np.multiply.outer(v, w).ravel())
    return positions[first] + 0.0, weights


WINDOWS = ("uniform", "taylor", "chebyshev", "hamming")
"""Names of the windows of :func:`window_weights`."""


@takes_frequency
def steering_weights(positions: ArrayLike, direction: ArrayLike, wavelength: float) -> Complex:
    """Return weights (n,) that steer an array: w_k = exp(2 pi i s.x_k/wavelength).

    The array factor peaks towards `direction`. The fields of the elements do not change; see
    :func:`polywigner.steering` for fields.

    Parameters
    ----------
    positions : array_like, shape (n, 2) or (n, 3)
        Positions in m, of shape (n,) or (n, 1) for slits. Positions in space require a direction
        (3,).
    direction : array_like, shape (3,) or (2,)
        Unit vector with a positive z, or its components along the array, or the sine of the angle
        for slits.
    wavelength : float
        Wavelength in m.

    Returns
    -------
    ndarray of complex, shape (n,)
        Weights of modulus 1.

    Raises
    ------
    ArgumentError
        If positions have the wrong shape, the direction does not fit them or is not part of a unit
        vector, or the wavelength is not above zero.
    """
    positions = checked_positions(positions, (1, 2, 3))
    towards = unit_vector(direction) if positions.shape[1] == 3 else transverse(direction)
    if len(towards) != positions.shape[1]:
        raise ArgumentError(
            f"expected a direction with {positions.shape[1]} components, like the positions, "
            f"got {len(towards)}"
        )
    return np.exp(2j * np.pi * (positions @ (towards / checked_length(wavelength, "wavelength"))))


@takes_frequency
def focusing_weights(positions: ArrayLike, point: ArrayLike, wavelength: float) -> Complex:
    """Return weights (n,) that focus an array: w_k = exp(-2 pi i (R_k - R)/wavelength).

    R_k and R are the distances of the point from element k and from the origin. The waves
    exp(2 pi i R_k/wavelength)/R_k of all elements arrive in phase. For a distant point, the weights
    are the :func:`steering_weights` towards the point.

    Parameters
    ----------
    positions : array_like, shape (n, 2)
        Positions in m in the plane z = 0.
    point : array_like, shape (3,)
        Focus (x, y, z) in m, z > 0.
    wavelength : float
        Wavelength in m.

    Returns
    -------
    ndarray of complex, shape (n,)
        Weights of modulus 1.

    Raises
    ------
    ArgumentError
        If positions or the point have the wrong shape, the point is not in front of the array, or
        the wavelength is not above zero.
    """
    positions = checked_positions(positions, (2,))
    expected = "expected a point (x, y, z) with z above zero"
    focus = finite_array(point, expected, (3,))
    if not focus[2] > 0:
        raise ArgumentError(f"{expected}, got {value_text(point)}")
    rays = focus - np.pad(positions, ((0, 0), (0, 1)))
    # Sum R_k + R of the distances of the focus from element k and from the origin.
    total = np.linalg.norm(rays, axis=1) + np.linalg.norm(focus)
    # The path difference R_k - R equals (R_k^2 - R^2)/(R_k + R), which avoids cancellation.
    path = ((positions - 2 * focus[:2]) * positions).sum(axis=1) / total
    return np.exp(-2j * np.pi * path / checked_length(wavelength, "wavelength"))


def window_weights(
    shape: int | Sequence[int], window: str | Sequence[str], sll: float = 30.0, nbar: int = 4
) -> Floats:
    """Return real amplitudes of a taper over a row or a grid of elements, with a maximum of 1.

    Parameters
    ----------
    shape : int or (int, int)
        n elements in a row, or (nx, ny) in a grid.
    window : str or sequence of str
        "uniform", "taylor", "chebyshev" (Dolph) or "hamming", or one name for each axis. "taylor"
        and "chebyshev" require scipy, which the extra `arrays` installs.
    sll : float, default 30
        Sidelobe suppression in dB for "taylor" and "chebyshev", above 0 and up to 200.
    nbar : int, default 4
        One more than the number of sidelobes of "taylor" at about this level.

    Returns
    -------
    ndarray of float, shape (n,) or (nx ny,)
        Amplitudes with y varying fastest, in the order of :func:`grid_positions`.

    Raises
    ------
    ArgumentError
        If a shape, window or option is out of range.
    MissingExtraError
        If scipy is not installed.
    """
    sizes = tuple(shape) if isinstance(shape, Sequence) else (shape,)
    if len(sizes) not in (1, 2):
        raise ArgumentError(
            "expected shape to be a number of elements n, or a pair (nx, ny), got "
            f"{value_text(shape)}"
        )
    names = (window,) * len(sizes) if isinstance(window, str) else window
    if not isinstance(names, Sequence) or len(names) != len(sizes):
        raise ArgumentError(
            f"expected the name of a window, or {len(sizes)} names, one for each axis, got "
            f"{value_text(window)}"
        )
    decibels, zeros = checked_sidelobes(sll, nbar)
    elements = math.prod(checked_count(n, "shape", 1) for n in sizes)
    check_most(elements, MOST_ELEMENTS, "elements", "use fewer elements")
    along = [_window(n, name, decibels, zeros) for n, name in zip(sizes, names, strict=True)]
    weights = along[0] if len(along) == 1 else np.multiply.outer(*along).ravel()
    # For a small sll (1 dB), the Taylor weight of largest magnitude may be negative.
    return np.asarray(weights / weights[np.abs(weights).argmax()])


def _window(count: int, name: str, sll: float, nbar: int) -> Floats:
    """Return the unnormalised amplitudes (count,) of a window; ``sll`` is in dB."""
    checked_choice(name, "window", WINDOWS)
    if name == "uniform" or count == 1:
        return np.ones(count)
    if name == "hamming":
        return np.hamming(count)
    windows = require("scipy.signal.windows", "arrays", f"has the window {name!r}")
    if name == "taylor":
        return np.asarray(windows.taylor(count, nbar=nbar, sll=sll, norm=True, sym=True))
    with warnings.catch_warnings():
        # Below 45 dB, scipy warns about spectral analysis, which does not concern arrays.
        warnings.simplefilter("ignore")
        return np.asarray(windows.chebwin(count, at=sll))


_COLUMNS = ("x", "y", "amplitude", "phase", "re", "im", "angle")


def read_elements(
    path: str | os.PathLike[str], element: Aperture, unit: str | float = "mm"
) -> Array:
    """Read an array from a table with one row for each element.

    The first line names the columns, in any order: ``x`` and ``y``; the weight as ``amplitude``
    (linear) and ``phase`` in degrees, or as ``re`` and ``im``; and ``angle`` in degrees,
    counter-clockwise, by which the element with its field is rotated about its origin. Missing
    amplitudes are 1, other missing columns are 0. Without a line of names, the columns are x and y.
    Semicolons, commas or blanks separate the columns; # begins a comment.

    Parameters
    ----------
    path : str or path
        The table, a text file.
    element : Aperture
        The element that is repeated at each row's position, with its field.
    unit : str or float, default "mm"
        Unit of x and y: a name, or a length in metres.

    Returns
    -------
    Array
        A :func:`polywigner.phased_array` if all angles are equal.

    Raises
    ------
    FileFormatError
        If the file is missing, larger than 64 MiB, or not a table of finite numbers with these
        columns.
    ArgumentError
        If the element is not an Aperture.
    IlluminationError
        If the weights are all zero.
    QuantityError
        If the unit is invalid.

    Warns
    -----
    PolywignerWarning
        If elements overlap.

    Examples
    --------
    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "array.csv"
    >>> _ = path.write_text("x, y, amplitude, phase\\n-1, 0, 1, 0\\n1, 0, 0.5, 90\\n")
    >>> pw.arrays.read_elements(path, pw.shapes.square(1e-3)).weights.round(3)
    array([1. +0.j , 0. +0.5j])
    """
    checked_type(element, "an Aperture as the element", Aperture)
    file, metres = checked_path(path), parse_unit(unit)
    with at_key(str(file)):
        table = _table_columns(text_of(bytes_of(file)))
        zero = np.zeros(len(table["x"]))
        if not {"amplitude", "re", "im"} & set(table):
            table["amplitude"] = zero + 1
        x, y, size, phase, re, im, angle = (table.get(name, zero) for name in _COLUMNS)
        weights = size * np.exp(1j * np.radians(phase)) + re + 1j * im
        positions, angles = metres * np.stack([x, y], axis=1), np.radians(angle).tolist()
        rotated = {angle: element.turned(angle) for angle in set(angles)}
        if len(rotated) == 1:
            array = repeated_element(rotated[angles[0]], positions, weights)
        else:
            pairs = zip(angles, positions, strict=True)
            array = Array([rotated[angle].moved(position) for angle, position in pairs], weights)
    warn_of_overlaps(array)
    return array


def _table_columns(text: str) -> dict[str, Floats]:
    """Return the columns of a text table by name; without a line of names, they are x and y."""
    rows = table_rows(text)
    names = [name.lower() for name in rows[0][1]] if rows else []
    has_names = len(names) != 2 or set(names) & set(_COLUMNS)
    names, rows = (names, rows[1:]) if has_names else (["x", "y"], rows)
    has_both = {"re", "im"} & set(names) and {"amplitude", "phase"} & set(names)
    if len({"x", "y", *names}) != len(names) or not set(names) <= set(_COLUMNS) or has_both:
        raise FileFormatError(
            "expected the columns x and y, optionally amplitude and phase, or re and im, and "
            f"optionally angle, each only once; got {value_text(', '.join(names))}"
        )
    values = []
    for number, fields in rows:
        try:
            values.append([float(field) for field in fields])
        except ValueError:
            values.append([])
        if len(values[-1]) != len(names) or not np.isfinite(values[-1]).all():
            raise FileFormatError(
                f"expected {len(names)} numbers ({', '.join(names)}) in line {number}, got "
                f"{value_text(', '.join(fields))}"
            )
    if not rows:
        raise FileFormatError("expected one row of numbers for each element, got no rows")
    return dict(zip(names, np.array(values).T, strict=True))
