"""Files of commands for fields: a picture, and the values in formats that others read."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polywigner.cli.output import check_writable, writing
from polywigner.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["check_files", "format_suffixes", "write_field"]

_FORMATS = ("nc", "zarr", "vti")


def format_suffixes(formats: Sequence[str], known: Sequence[str] = _FORMATS) -> tuple[str, ...]:
    """Suffixes of the files of values, each once; by default those of fields.

    Raises
    ------
    ArgumentError for a format that there is not.
    """
    for name in formats:
        if name not in known:
            raise ArgumentError(f"--format: expected one of {', '.join(known)}, got {name!r}")
    return tuple(f".{name}" for name in dict.fromkeys(formats))


# Attributes of a store of fields.
_OF_FIELDS = {"wavelength", "frequency", "source"}


def check_files(files: Sequence[Path]) -> None:
    """Fail before the long work rather than after it: where one of the files cannot be written.

    A store of an earlier run is replaced, as a file is; one that `polywigner volume` fills chunk by
    chunk is not, for it may have taken hours.

    Raises
    ------
    ArgumentError : as of ``check_writable``, and for a .zarr that is something else.
    """
    check_writable([path for path in files if not (path.suffix == ".zarr" and path.is_dir())])
    for path in files:
        if path.suffix == ".zarr" and os.path.lexists(path) and not _is_written_whole(path):
            raise ArgumentError(
                f"expected {path} to be free, or a store that an earlier `polywigner propagate` "
                "wrote, got something else there; choose another name with --out"
            )


def _is_written_whole(store: Path) -> bool:
    try:
        attrs = json.loads((store / "zarr.json").read_bytes())["attributes"]
        return attrs.keys() >= _OF_FIELDS and "polywigner_fingerprint" not in attrs
    except (OSError, ValueError, KeyError, TypeError):
        return False


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
    from polywigner.propagation.exports import write_netcdf, write_vti, write_zarr

    write = {".nc": write_netcdf, ".vti": write_vti, ".zarr": write_zarr}
    with writing(files) as (picture, *values):
        figure.savefig(picture, format="png")
        for path, partial in zip(files[1:], values, strict=True):
            write[path.suffix](found, partial)
