"""What commands write of fields: a picture, and the values in formats that others read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polywigner.cli.output import writing
from polywigner.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["format_suffixes", "write_field"]

_FORMATS = ("nc", "vti")


def format_suffixes(formats: Sequence[str]) -> tuple[str, ...]:
    """Of the files of values, each once.

    Raises
    ------
    ArgumentError for a format that there is not.
    """
    for name in formats:
        if name not in _FORMATS:
            raise ArgumentError(f"--format: expected one of {', '.join(_FORMATS)}, got {name!r}")
    return tuple(f".{name}" for name in dict.fromkeys(formats))


def write_field(found: Any, figure: Figure, files: Sequence[Path]) -> None:
    """All of the files, or none.

    Parameters
    ----------
    found : xarray.Dataset, in memory or on disk.
    files : of the picture, and of the values, whose format their suffix tells.

    Raises
    ------
    ArgumentError where the operating system refuses; MissingExtraError without what a format needs.
    """
    import polywigner as pw

    with writing(files) as (picture, *values):
        figure.savefig(picture, format="png")
        for path, partial in zip(files[1:], values, strict=True):
            (pw.write_vti if path.suffix == ".vti" else pw.write_netcdf)(found, partial)
