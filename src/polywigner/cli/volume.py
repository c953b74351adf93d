"""``polywigner volume``: the irradiance in a box, written chunk by chunk, and its picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from polywigner.cli.output import check_writable, output_stem, targets, writing
from polywigner.cli.plausibility import check_wavelength
from polywigner.cli.sources import (
    check_source_file,
    field_title,
    read_fed_source,
    required_wavelength,
    wavelength_from,
)
from polywigner.cli.where import parse_box, parse_levels, parse_method, parse_shape
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_length

__all__ = ["run_volume"]

_FORMATS = ("nc", "vti")


def run_volume(
    source: str,
    *,
    box: str,
    shape: str,
    method: str,
    order: int,
    obliquity: str | None,
    accuracy: float | None,
    frequency: str | None,
    wavelength: str | None,
    unit: str | None,
    tolerance: str | None,
    feeding: Mapping[str, str | None],
    chunks: str | None,
    threads: int | None,
    scheduler: str | None,
    engine: str,
    precision: str | None,
    surfaces: str | None,
    projection: str,
    renderer: str,
    floor_db: float,
    formats: Sequence[str],
    out: str | None,
) -> None:
    """Write NAME.zarr, NAME.png and what ``formats`` asks for, and print their paths.

    The store grows chunk by chunk; a run that was killed leaves the finished ones, with which the
    next run of the same settings goes on. Everything else is written whole or not at all.

    Raises
    ------
    PolywignerError : input that cannot be used; nothing is written then.
    """
    check_source_file(source)
    corners, count = parse_box(box), parse_shape("--shape", shape, 3)
    sizes = None if chunks is None else parse_shape("--chunks", chunks, 3)
    levels = None if surfaces is None else parse_levels("--surfaces", surfaces)
    asked = wavelength_from(frequency, wavelength)
    reach = None if tolerance is None else parse_length(tolerance)
    store, *files = targets(
        output_stem(out, Path(source).stem), (".zarr", ".png", *_suffixes(formats))
    )
    check_writable(files)

    # Everything cheap has been checked: only now the libraries that take a second to import.
    import polywigner as pw
    from polywigner.figures import draw_volume, outline_of
    from polywigner.figures.fields import label_of
    from polywigner.figures.volumes import check_volume_options
    from polywigner.propagation import METHODS
    from polywigner.propagation.obliquities import Obliquity

    drawn: dict[str, Any] = {
        "surfaces": levels,
        "floor_db": floor_db,
        "projection": projection,
        "renderer": renderer,
    }
    check_volume_options(**drawn)
    wanted = parse_method(method, ("wigner", *METHODS), get_args(Obliquity), obliquity, order)
    options: dict[str, Any] = {
        "method": wanted.method,
        "tolerance": accuracy,
        "engine": engine,
        "precision": precision,
    }
    if wanted.method == "wigner":
        options |= {"obliquity": wanted.obliquity, "order": wanted.order}
    radiator, said = read_fed_source(source, unit, reach, feeding, asked)
    length = required_wavelength(said)
    check_wavelength(length, outline_of(radiator).diameter)
    nx, ny, nz = count
    found = pw.volume(
        radiator,
        corners,
        (nx, ny, nz),
        length,
        chunks=sizes,
        out=store,
        threads=threads,
        scheduler=scheduler,
        **options,
    )
    title = f"{label_of(found[wanted.method], wanted.method)}: {field_title(source, length)}"
    figure = draw_volume(found, radiator, title=title, **drawn)
    with writing(files) as (picture, *others):
        figure.savefig(picture, format="png")
        for suffix, path in zip(_suffixes(formats), others, strict=True):
            (pw.write_vti if suffix == ".vti" else pw.write_netcdf)(found, path)
    for path in (store, *files):
        print(path)


def _suffixes(formats: Sequence[str]) -> tuple[str, ...]:
    """Of the files beside the store and the picture, each once."""
    for name in formats:
        if name not in _FORMATS:
            raise ArgumentError(
                f"--format: expected one of {', '.join(_FORMATS)}, got {name!r}; a zarr store is "
                "written in any case"
            )
    return tuple(f".{name}" for name in dict.fromkeys(formats))
