"""``polywigner volume``: the irradiance in a box, written chunk by chunk, and its picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from polywigner.cli.fields import (
    compared_with,
    format_suffixes,
    parse_methods,
    print_differences,
    samples_of_box,
    write_field,
)
from polywigner.cli.output import check_writable, missing_folders, output_stem, say_made, targets
from polywigner.cli.reading import Reading, check_wavelength
from polywigner.cli.sources import (
    check_source_file,
    field_title,
    read_fed_source,
    required_wavelength,
    wavelength_from,
)
from polywigner.cli.where import parse_box, parse_levels, parse_shape, shown
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_frequency

__all__ = ["run_verify", "run_volume"]

_DEFAULT = ("wigner",)


def run_verify(store: str) -> None:
    """Compare a store with its checksums, and say that all of it is whole.

    Raises
    ------
    StoreError : it is damaged, not complete, or no store; the message names the chunks.
    """
    import polywigner as pw

    count = pw.verify_store(store)
    print(f"{store}: {count} chunks, all there and as they were written")


def run_volume(
    source: str,
    *,
    box: str,
    shape: str | None,
    methods: Sequence[str],
    order: int,
    obliquity: str | None,
    against: str | None,
    accuracy: float | None,
    frequency: str | None,
    wavelength: str | None,
    reading: Reading,
    feeding: Mapping[str, str | None],
    bandwidth: str | None,
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

    Of several methods, each has its own files, NAME-METHOD.zarr and so on, and the differences are
    printed. A store grows chunk by chunk; a run that was killed leaves the finished ones, with
    which the next run of the same settings goes on. Everything else is written whole or not at all.

    Raises
    ------
    PolywignerError : input that cannot be used; nothing is written then.
    """
    check_source_file(source, reading)
    corners = parse_box(box)
    count = None if shape is None else parse_shape("--shape", shape, 3)
    if count is not None and min(count) < 2:
        raise ArgumentError(
            f"--shape: expected two or more samples along each axis, got {shown(str(shape))}; draw "
            "one layer by `polywigner propagate --plane`"
        )
    sizes = None if chunks is None else parse_shape("--chunks", chunks, 3)
    levels = None if surfaces is None else parse_levels("--surfaces", surfaces)
    asked = wavelength_from(frequency, wavelength)
    band = None if bandwidth is None else parse_frequency(bandwidth)
    stem = output_stem(out, Path(source).stem)
    # the store is written in any case
    suffixes = tuple(suffix for suffix in format_suffixes(formats) if suffix != ".zarr")
    check_writable(targets(stem, (".png", *suffixes)))

    # Everything cheap has been checked: only now the libraries that take a second to import.
    import polywigner as pw
    from polywigner.figures import draw_volume, outline_of
    from polywigner.figures.fields import label_of
    from polywigner.figures.volumes import check_volume_options
    from polywigner.propagation.datasets import FieldOptions, checked_settings

    drawn: dict[str, Any] = {
        "surfaces": levels,
        "floor_db": floor_db,
        "projection": projection,
        "renderer": renderer,
    }
    check_volume_options(**drawn)
    wanted = parse_methods(methods or _DEFAULT, obliquity, order)
    reference = compared_with(wanted, against)
    radiator, said = read_fed_source(source, reading, feeding, asked)
    length = required_wavelength(said)
    check_wavelength(length, outline_of(radiator).diameter)
    for method in wanted:  # before the first is computed
        how: dict[str, Any] = {"engine": engine, "precision": precision, "tolerance": accuracy}
        how |= {"bandwidth": band}
        checked_settings(length, cast(FieldOptions, how | method.options))
    nx, ny, nz = count or samples_of_box(radiator, corners, length)
    fields, written = {}, []
    new = missing_folders([stem])
    for method in wanted:
        name = stem if len(wanted) == 1 else stem.with_name(f"{stem.name}-{method.name}")
        store, *files = targets(name, (".zarr", ".png", *suffixes))
        options: dict[str, Any] = {"engine": engine, "precision": precision, **method.options}
        found = pw.volume(
            radiator,
            corners,
            (nx, ny, nz),
            length,
            chunks=sizes,
            out=store,
            threads=threads,
            scheduler=scheduler,
            tolerance=accuracy,
            bandwidth=band,
            **options,
        )
        fields[method.name] = found[method.method]
        title = f"{label_of(found[method.method], method.method)}: {field_title(source, length)}"
        write_field(found, draw_volume(found, radiator, title=title, **drawn), files)
        written += [store, *files]
    if len(wanted) > 1:
        print_differences(fields, reference)
    say_made(new)
    for path in written:
        print(path)
