"""Arrays from tables with a row for each element: position, weight and orientation."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError, at_key, value_text
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_path
from polywigner.geometry.io.limits import bytes_of, text_of
from polywigner.geometry.io.text import fields_of
from polywigner.illumination.array import Array, repeated_element
from polywigner.illumination.overlaps import warn_of_overlaps
from polywigner.quantities import parse_unit

_COLUMNS = ("x", "y", "amplitude", "phase", "re", "im", "angle")


def read_elements(
    path: str | os.PathLike[str], element: Aperture, unit: str | float = "mm"
) -> Array:
    """Read an array from a table with one row for each element.

    The first line names the columns, in any order: ``x`` and ``y``; the weight as ``amplitude``
    (linear) and ``phase`` in degrees, or as ``re`` and ``im``; and ``angle`` in degrees,
    counter-clockwise, by which the element with its field is turned about its origin. Missing
    columns are 1 for amplitudes and 0 for the rest; without names the columns are x and y.
    Semicolons, commas or blanks separate them; # begins a comment.

    Parameters
    ----------
    path : the table, as text.
    element : the Aperture that each row places, with its own field.
    unit : of x and y, such as "mm" or a number of metres.

    Returns
    -------
    An :class:`polywigner.Array`: a :func:`polywigner.phased_array` where all angles are equal.

    Raises FileFormatError for a file that is missing, larger than 64 MiB, or not a table of finite
    numbers with these columns; ArgumentError for an element that is not an Aperture;
    IlluminationError for weights that are all zero; QuantityError for an invalid unit. Warns
    (PolywignerWarning) if elements overlap.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "array.csv"
    >>> _ = path.write_text("x, y, amplitude, phase\\n-1, 0, 1, 0\\n1, 0, 0.5, 90\\n")
    >>> pw.arrays.read_elements(path, pw.shapes.square(1e-3)).weights.round(3)
    array([1. +0.j , 0. +0.5j])
    """
    if not isinstance(element, Aperture):
        raise ArgumentError(
            f"expected an Aperture as the element, got {type(element).__name__}; a curved wave "
            "goes on the whole array, by its curved()"
        )
    file, metres = checked_path(path), parse_unit(unit)
    with at_key(str(file)):
        array = _array_of(_columns(file), element, metres)
    warn_of_overlaps(array)
    return array


def _array_of(table: dict[str, NDArray[np.float64]], element: Aperture, metres: float) -> Array:
    positions = metres * np.stack([table["x"], table["y"]], axis=1)
    zero = np.zeros(len(positions))
    if "re" in table or "im" in table:
        weights = table.get("re", zero) + 1j * table.get("im", zero)
    else:
        phases = np.radians(table.get("phase", zero))
        weights = table.get("amplitude", zero + 1) * np.exp(1j * phases)
    angles = np.radians(table.get("angle", zero))
    if (angles == angles[0]).all():
        return repeated_element(element.turned(angles[0]), positions, weights)
    turned = {angle: element.turned(angle) for angle in set(angles.tolist())}
    elements = [turned[a].moved(x) for a, x in zip(angles.tolist(), positions, strict=True)]
    return Array(elements, weights)


def _columns(file: Path) -> dict[str, NDArray[np.float64]]:
    """The columns of a file by name; x and y without a line of names."""
    lines = enumerate(text_of(bytes_of(file)).splitlines(), start=1)
    rows = [(n, fields) for n, line in lines if (fields := fields_of(line.split("#")[0]))]
    names = [name.lower() for name in rows[0][1]] if rows else []
    if len(names) == 2 and not set(names) & set(_COLUMNS):
        names = ["x", "y"]
    else:
        rows = rows[1:]
    has_both = {"re", "im"} & set(names) and {"amplitude", "phase"} & set(names)
    if len({"x", "y", *names}) != len(names) or not set(names) <= set(_COLUMNS) or has_both:
        raise FileFormatError(
            "expected the columns x, y, and amplitude, phase or re, im, and angle, each once, got "
            f"{value_text(', '.join(names))}"
        )
    values = []
    for number, fields in rows:
        try:
            values.append([float(field) for field in fields])
        except ValueError:
            values.append([])
        if len(values[-1]) != len(names) or not np.isfinite(values[-1]).all():
            raise FileFormatError(
                f"expected {len(names)} numbers, {', '.join(names)}, got "
                f"{value_text(', '.join(fields))} in line {number}"
            )
    if not rows:
        raise FileFormatError("expected a row for each element, got none")
    return dict(zip(names, np.array(values).T, strict=True))
