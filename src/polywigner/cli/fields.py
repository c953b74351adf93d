"""Files of commands for fields: a picture, and the values in formats that others read."""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from polywigner.cli.output import check_writable, writing
from polywigner.cli.where import shown
from polywigner.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
        return attrs.keys() >= _OF_FIELDS and "polywigner_settings" not in attrs
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
        for partial in values:
            write[partial.suffix](found, partial)


if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray
    from polywigner.cli.where import Place, Point


# Fewest samples, for a smooth picture, and most, for a short wait: a factor of four in time.
_FEWEST = {"line": (401,), "arc": (321,), "plane": (129, 129), "hemisphere": (61, 120)}
_MOST = {"line": (1601,), "arc": (1281,), "plane": (257, 257), "hemisphere": (121, 240)}
_FEWEST_OF_BOX, _MOST_OF_BOX = (64,) * 3, (101,) * 3


def samples_of_place(
    source: Aperture | ApertureArray, place: Place, wavelength: float, amplitude: bool
) -> tuple[int, ...]:
    """Samples along each axis of a place: as given, else as many as its field needs, within bounds.

    A warning says where the bounds are too narrow.
    """
    if place.shape:
        return place.shape
    quantity = "amplitude" if amplitude else "irradiance"
    needed = _needed(source, place, wavelength, quantity)
    return _within("--samples", needed, _FEWEST[place.kind], _MOST[place.kind])


def samples_of_box(
    source: Aperture | ApertureArray, corners: tuple[Point, Point], wavelength: float
) -> tuple[int, ...]:
    """Along x, y and z of a box, as many as the irradiance needs, within bounds."""
    import polywigner as pw

    axes = pw.suggest_sampling(source, wavelength, "irradiance", box=corners).axes
    return _within("--shape", [axis.count for axis in axes], _FEWEST_OF_BOX, _MOST_OF_BOX)


def _needed(source: Any, place: Place, wavelength: float, quantity: Any) -> list[int]:
    import polywigner as pw

    if place.kind == "line":
        return [
            axis.count
            for axis in pw.suggest_sampling(source, wavelength, quantity, line=place.points).axes
        ]
    if place.kind == "plane":
        axes = pw.suggest_sampling(source, wavelength, quantity, box=place.points).axes
        return [axis.count for axis in axes if axis.high > axis.low]
    theta, phi = pw.suggest_sampling(source, wavelength, quantity, radius=place.radius).axes
    share = place.reach / theta.high
    if place.kind == "arc":
        return [math.ceil(2 * share * (theta.count - 1)) + 1]
    return [math.ceil(share * (theta.count - 1)) + 1, phi.count - 1]


def _within(
    option: str, needed: list[int], fewest: tuple[int, ...], most: tuple[int, ...]
) -> tuple[int, ...]:
    chosen = tuple(
        min(max(n, low), high) for n, low, high in zip(needed, fewest, most, strict=True)
    )
    if any(n > high for n, high in zip(needed, most, strict=True)):
        text = " x ".join(map(str, map(max, needed, chosen)))
        warnings.warn(
            f"{' x '.join(map(str, chosen))} samples miss fringes of this field: "
            f'{option} "{text}" would show all, or look at a smaller region',
            RuntimeWarning,
            stacklevel=3,
        )
    return chosen


_ORDERS = {"1": 1, "3": 3}


class MethodText(NamedTuple):
    """A method with its settings; ``name`` tells it from the others of a run."""

    name: str
    method: str
    obliquity: str | None
    order: int

    @property
    def options(self) -> dict[str, Any]:
        """The argument that :func:`polywigner.line` and its like take for it."""
        if self.method != "wigner":
            return {"method": self.method}
        return {"method": self.method, "obliquity": self.obliquity, "order": self.order}


def parse_methods(
    texts: Sequence[str], obliquity: str | None, order: int
) -> tuple[MethodText, ...]:
    """Methods, of wigner rays perhaps with an obliquity and an order: ``"wigner kirchhoff 3"``.

    Parameters
    ----------
    texts : one or several.
    obliquity, order : of rays where a text says none.

    Raises
    ------
    ArgumentError for other names, and for one method twice.
    """
    from polywigner.illumination.obliquities import OBLIQUITIES
    from polywigner.propagation import METHODS

    known = ("wigner", *METHODS)
    methods = tuple(_method(text, known, tuple(OBLIQUITIES), obliquity, order) for text in texts)
    names = [method.name for method in methods]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ArgumentError(f"--method: expected different methods, got {twice[0]!r} twice")
    return methods


def _method(
    text: str, methods: Sequence[str], obliquities: Sequence[str], obliquity: str | None, order: int
) -> MethodText:
    words = text.split()
    method = words[0] if words else ""
    if method not in methods:
        raise ArgumentError(f"--method: expected one of {', '.join(methods)}, got {shown(text)}")
    for word in words[1:]:
        if method != "wigner" or word not in (*obliquities, *_ORDERS):
            raise ArgumentError(
                "--method: expected words after wigner only, an obliquity "
                f"({', '.join(obliquities)}) or an order (1, 3), got {shown(text)}"
            )
        if word in _ORDERS:
            order = _ORDERS[word]
        else:
            obliquity = word
    return MethodText("-".join(words), method, obliquity, order)


def compared_with(wanted: Sequence[MethodText], against: str | None) -> str:
    """The name of the method that the others are compared with: by default the last exact one.

    Raises
    ------
    ArgumentError for one that is not among them.
    """
    names = [method.name for method in wanted]
    if against is not None:
        name = "-".join(against.split())
        if name not in names:
            raise ArgumentError(
                f"--against: expected one of the methods, {', '.join(names)}, got {against!r}"
            )
        return name
    exact = [m.name for m in wanted if m.method not in ("wigner", "fresnel", "fraunhofer")]
    return (exact or names)[-1]


def print_differences(fields: Mapping[str, Any], reference: str) -> None:
    """One line for each method, of its largest and its rms difference from the reference.

    ``fields`` : name -> xarray.DataArray, all over the same points; lazy ones are read by chunks.
    """
    from polywigner.figures.levels import COMPARED_DB, summary

    print(f"Differences from {reference}, where it is above {COMPARED_DB:g} dB of its peak, in dB:")
    width = max(len(name) for name in fields)
    print(f"  {'method':{width}}  largest      rms  points")
    for name, field in fields.items():
        if name == reference:
            continue
        apart = summary(field, fields[reference])
        left = f", {apart.negative} not above zero left out" if apart.negative else ""
        print(
            f"  {name:{width}}  {apart.largest:+7.3f}  {apart.rms:7.4f}  "
            f"{apart.points} of {field.size}{left}"
        )
