"""Arrays from tables with a row for each element: position, weight and orientation."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError, PolywignerError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_path
from polywigner.geometry.io.limits import (
    LONGEST_LINE,
    MOST_LISTED,
    bytes_of,
    check_coordinates,
    check_most,
    text_of,
    token,
)
from polywigner.geometry.io.text import NUMBER, fields_of
from polywigner.illumination.array import Array, repeated_element
from polywigner.illumination.overlaps import warn_of_overlaps
from polywigner.quantities import parse_unit

_COLUMNS = ("x", "y", "amplitude", "phase", "re", "im", "angle")
_MOST_ROWS = 2**20

Table = dict[str, NDArray[np.float64]]


def read_elements(
    path: str | os.PathLike[str], element: Aperture, unit: str | float = "mm"
) -> Array:
    """Read an array from a table with one row for each element.

    The first line names the columns, in any order: ``x`` and ``y``; the weight as ``amplitude``
    (linear) and ``phase`` in degrees, or as ``re`` and ``im``; and ``angle`` in degrees,
    counter-clockwise, by which the element with its field is turned about its origin. Missing
    columns are 1 for amplitudes and 0 for the rest; without names the columns are x and y.
    Semicolons, commas or blanks separate them; lines that begin with # are comments.

    Parameters
    ----------
    path : the table, as text.
    element : the Aperture that stands in each row, with its own field.
    unit : of x and y, such as "mm" or a number of metres.

    Returns
    -------
    An :class:`polywigner.Array`: a :func:`polywigner.phased_array` where all angles are equal.

    Raises FileFormatError for a file that is missing, over 64 MiB, no table of finite numbers with
    these columns, of more than 2^20 elements, or of more than 10,000 with different angles;
    ArgumentError for an element that is no Aperture; IlluminationError for weights all zero;
    QuantityError for a unit that does not parse. Warns (PolywignerWarning) where elements overlap.

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
    try:
        array = _array_of(_table(file), element, metres)
    except PolywignerError as error:
        raise type(error)(f"{file}: {error}") from None
    warn_of_overlaps(array)
    return array


def _array_of(table: Table, element: Aperture, metres: float) -> Array:
    places = metres * np.stack([table["x"], table["y"]], axis=1)
    zero = np.zeros(len(places))
    if "re" in table or "im" in table:
        weights = table.get("re", zero) + 1j * table.get("im", zero)
    else:
        phases = np.radians(table.get("phase", zero))
        weights = table.get("amplitude", zero + 1) * np.exp(1j * phases)
    angles = np.radians(table.get("angle", zero))
    if (angles == angles[0]).all():
        return repeated_element(element.turned(angles[0]), places, weights)
    check_most(len(places), MOST_LISTED, "elements with angles of their own", "use fewer")
    turned = {angle: element.turned(angle) for angle in set(angles.tolist())}
    return Array(
        [turned[angle].moved(at) for angle, at in zip(angles.tolist(), places, strict=True)],
        weights,
    )


def _table(file: Path) -> Table:
    """The columns of a file by name; FileFormatError for anything else."""
    names: list[str] = []
    rows: list[list[float]] = []
    text = text_of(bytes_of(file))
    check_most(text.count("\n"), 2 * _MOST_ROWS, "lines", "use fewer elements")
    for number, line in enumerate(text.splitlines(), start=1):
        if len(line) > LONGEST_LINE:
            raise FileFormatError(
                f"expected lines of at most {LONGEST_LINE} characters, got more in line {number}"
            )
        fields = fields_of(line.split("#", 1)[0])
        if not fields:
            continue
        if not names:
            names = _names(fields, number)
            if not NUMBER.fullmatch(fields[0]):
                continue
        if len(fields) != len(names) or not all(NUMBER.fullmatch(field) for field in fields):
            wrong = [field for field in fields if not NUMBER.fullmatch(field)]
            got = token(wrong[0]) if wrong else f"{len(fields)} numbers"
            raise FileFormatError(
                f"expected {len(names)} numbers, {', '.join(names)}, got {got} in line {number}"
            )
        rows.append([float(field) for field in fields])
    if not rows:
        raise FileFormatError("expected a row for each element, got none")
    check_most(len(rows), _MOST_ROWS, "elements", "use fewer")
    values = np.array(rows)
    check_coordinates(values)
    return dict(zip(names, values.T, strict=True))


def _names(fields: list[str], number: int) -> list[str]:
    """The names of columns in the first line; x and y where it has two numbers."""
    if len(fields) == 2 and all(NUMBER.fullmatch(field) for field in fields):
        return ["x", "y"]
    names = [field.lower() for field in fields]
    both = {"re", "im"} & set(names) and {"amplitude", "phase"} & set(names)
    if not set(names) <= set(_COLUMNS) or len(set(names)) < len(names) or both:
        wrong = [token(name, _COLUMNS) for name in names if name not in _COLUMNS]
        got = ", ".join(wrong[:3]) or ", ".join(names)
        raise FileFormatError(
            f"expected the columns x, y, and amplitude, phase or re, im, and angle, each once, got "
            f"{got} in line {number}"
        )
    if not {"x", "y"} <= set(names):
        raise FileFormatError(f"expected the columns x and y, got {', '.join(names)}")
    return names
