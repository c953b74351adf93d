"""Sources and wavelengths as commands are given them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from polywigner.cli.output import check_text
from polywigner.errors import ArgumentError, FileFormatError
from polywigner.quantities import parse_frequency, parse_length, wavelength_of

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray

__all__ = [
    "check_source_file",
    "field_title",
    "read_fed_source",
    "required_wavelength",
    "wavelength_from",
]


def check_source_file(path: str) -> None:
    """That it can be a file at all, before anything heavy is imported to read it.

    Raises
    ------
    ArgumentError for a name that is not text, FileFormatError where there is no such file.
    """
    check_text("the aperture file", path)
    if not os.path.isfile(path):  # noqa: PTH113 (pathlib raises for a name too long)
        raise FileFormatError(
            f"expected an aperture file, got {path!r}, which is not a file; check its path"
        )


def wavelength_from(frequency: str | None, wavelength: str | None) -> float | None:
    """In metres, from the text of either option; None without both.

    Raises
    ------
    QuantityError for a text that is none, ArgumentError for both.
    """
    if frequency is not None and wavelength is not None:
        raise ArgumentError("expected --frequency or --wavelength, got both; drop one of them")
    if frequency is not None:
        return wavelength_of(parse_frequency(frequency))
    return None if wavelength is None else parse_length(wavelength)


def required_wavelength(frequency: str | None, wavelength: str | None) -> float:
    """As :func:`wavelength_from`; ArgumentError without either option."""
    length = wavelength_from(frequency, wavelength)
    if length is None:
        raise ArgumentError(
            'expected --frequency or --wavelength, got neither; give for example --frequency "94 '
            'GHz"'
        )
    return length


def field_title(path: str, wavelength: float) -> str:
    """Above the figure of a field: the source's file and the wavelength."""
    from polywigner.figures.style import length_unit

    unit = length_unit(wavelength)
    return f"{Path(path).name}, wavelength {wavelength / unit.metres:.4g} {unit.name}"


def read_fed_source(
    path: str,
    unit: str | None,
    tolerance: float | None,
    feeding: Mapping[str, str | None],
    wavelength: float | None,
) -> Aperture | ApertureArray:
    """The source of an aperture or source file, with its tapers, copies and steering.

    Parameters
    ----------
    unit, tolerance : of aperture files; None: mm, and the reader's own.
    feeding : texts by their option, of :data:`polywigner.illumination.texts.FEEDING`.
    wavelength : in metres, for steering and focus.

    Raises
    ------
    PolywignerError for what cannot be read or fed so.
    """
    import polywigner as pw
    from polywigner.illumination.texts import fed

    if _is_source_file(path):
        for name, given in (("--unit", unit), ("--tolerance", tolerance)):
            if given is not None:
                raise ArgumentError(
                    f"expected no {name} with a source file, got {given!r}; the file says its own"
                )
        source = pw.read_source(path)
    else:
        source = pw.read_aperture(path, unit=unit or "mm", tolerance=tolerance)
    texts = {name: text for name, text in feeding.items() if text is not None}
    fed_source: Aperture | ApertureArray = fed(source, texts, wavelength)
    return fed_source


def _is_source_file(path: str) -> bool:
    """TOML; or JSON whose outermost table has a kind, which GeoJSON has not."""
    suffix = Path(path).suffix.lower()
    if suffix != ".json":
        return suffix == ".toml"
    try:
        with open(path, encoding="utf-8-sig") as file:  # noqa: PTH123
            content = json.load(file)
    except (ValueError, RecursionError, OSError):
        return False  # the reader of apertures says what is wrong with it
    return isinstance(content, dict) and "kind" in content and "type" not in content
