"""Sources and wavelengths as commands are given them."""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polywigner.cli.output import check_text
from polywigner.cli.reading import Reading
from polywigner.errors import ArgumentError, FileFormatError, IlluminationError
from polywigner.quantities import SPEED_OF_LIGHT, parse_frequency, parse_length, wavelength_of

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray

__all__ = [
    "check_is_coherent",
    "check_source_file",
    "field_title",
    "frequency_text",
    "read_fed_source",
    "required_wavelength",
    "short_name",
    "wavelength_from",
]

_FREQUENCIES = (("THz", 1e12), ("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0))
_LONGEST_NAME = 32

# A frequency and the wavelength typed for it, with a few digits.
_SAME_WAVELENGTH = 1e-3


def check_is_coherent(source: Any, command: str) -> None:
    """IlluminationError for a partly coherent source, of which a command has nothing to draw."""
    width = getattr(source, "coherence_width", math.inf)
    if width < math.inf:
        raise IlluminationError(
            f"expected a coherent source for {command}, got one that is coherent over {width:g} m; "
            "propagate, volume and rays take it"
        )


def check_source_file(path: str, reading: Reading) -> None:
    """That it can be a file at all, before anything heavy is imported to read it.

    Raises
    ------
    ArgumentError for a name that is not text, FileFormatError where there is no such file,
    QuantityError for a tolerance that is no length.
    """
    reading.of_aperture()
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


def required_wavelength(wavelength: float | None) -> float:
    """The wavelength itself; ArgumentError where neither the options nor the file say one."""
    if wavelength is None:
        raise ArgumentError(
            'expected --frequency or --wavelength, got neither; give for example --frequency "94 '
            'GHz"'
        )
    return wavelength


def field_title(path: str, wavelength: float) -> str:
    """Above the figure of a field: the source's file, frequency and wavelength."""
    from polywigner.figures.style import length_unit

    unit = length_unit(wavelength)
    printed = f"{wavelength / unit.metres:.4g} {unit.name}"
    return f"{short_name(path)}, {frequency_text(wavelength)} (wavelength {printed})"


def short_name(path: str) -> str:
    """A file's name as a picture's title shows it: as text, and the ends of a long one."""
    name = Path(path).name
    if len(name) > _LONGEST_NAME:
        name = f"{name[:20]}…{name[-11:]}"
    return name.replace("$", r"\$")  # no formula of Matplotlib


def frequency_text(wavelength: float) -> str:
    """The frequency of a wavelength in metres, as it is printed."""
    frequency = SPEED_OF_LIGHT / wavelength
    named = [(name, size) for name, size in _FREQUENCIES if frequency >= 0.9995 * size]
    name, size = named[0] if named else _FREQUENCIES[-1]
    return f"{frequency / size:.4g} {name}"


def read_fed_source(
    path: str,
    reading: Reading,
    feeding: Mapping[str, str | None],
    wavelength: float | None,
) -> tuple[Aperture | ApertureArray, float | None]:
    """The source of an aperture or source file, with its tapers, copies and steering.

    Parameters
    ----------
    reading : of aperture files.
    feeding : texts by their option, of :data:`polywigner.illumination.texts.FEEDING`.
    wavelength : in metres, for steering and focus; None: that of the file, if it has one.

    Returns
    -------
    The source, and the wavelength, None where neither says one.

    Raises
    ------
    PolywignerError for what cannot be read or fed so.
    """
    import polywigner as pw
    from polywigner.illumination.texts import fed

    source: Aperture | ApertureArray
    if _is_source_file(path):
        for name, given in reading._asdict().items():
            if given and name != "allow_outside":
                raise ArgumentError(
                    f"expected no --{name} with a source file, got {given!r}; the file says its own"
                )
        source, wavelength = _read_source(path, wavelength, reading.allow_outside)
    else:
        source = pw.read_aperture(path, **reading.of_aperture())
    texts = {name: text for name, text in feeding.items() if text is not None}
    return fed(source, texts, wavelength), wavelength


def _read_source(
    path: str, wavelength: float | None, allow_outside: bool
) -> tuple[Any, float | None]:
    """The source, and the wavelength that was asked for, or else its own."""
    from polywigner.illumination.source_files import read_with_wavelength

    source, own = read_with_wavelength(path, allow_outside)
    if wavelength is None or own is None:
        return source, own if wavelength is None else wavelength
    if abs(wavelength - own) > _SAME_WAVELENGTH * own:
        warnings.warn(
            f"the phases in {Path(path).name} are set for its own wavelength of {own:.6g} m, and "
            f"its beam is shown at {wavelength:.6g} m, where it squints; leave --frequency and "
            "--wavelength out to see it at its own",
            RuntimeWarning,
            stacklevel=2,
        )
    return source, wavelength


def _is_source_file(path: str) -> bool:
    """TOML; or JSON whose outermost table has a kind, which GeoJSON has not."""
    from polywigner.geometry.formats.content import bytes_of, text_of
    from polywigner.geometry.formats.limits import check_values

    suffix = Path(path).suffix.lower()
    if suffix != ".json":
        return suffix == ".toml"
    try:
        text = text_of(bytes_of(Path(path)))
        check_values(text)
        content = json.loads(text) if '"kind"' in text else None
    except (ValueError, RecursionError, OSError):
        return False  # the reader of apertures says what is wrong with it
    return isinstance(content, dict) and "kind" in content and "type" not in content
