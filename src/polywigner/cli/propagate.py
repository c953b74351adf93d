"""``polywigner propagate``: fields in front of a source by several methods, and how they differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from polywigner.cli.fields import (
    MethodText,
    check_files,
    compared_with,
    format_suffixes,
    parse_methods,
    print_differences,
    samples_of_place,
    write_field,
)
from polywigner.cli.output import output_stem, targets
from polywigner.cli.reading import Reading, check_wavelength
from polywigner.cli.sources import (
    check_source_file,
    field_title,
    read_fed_source,
    required_wavelength,
    wavelength_from,
)
from polywigner.cli.where import Place, parse_place, place_text
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_frequency

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from polywigner import Aperture
    from polywigner import Array as ApertureArray

__all__ = ["run_propagate"]

_DEFAULT = ("wigner", "rayleigh-sommerfeld-1")


def run_propagate(
    source: str,
    *,
    where: Mapping[str, str | None],
    samples: str | None,
    methods: Sequence[str],
    order: int,
    obliquity: str | None,
    amplitude: bool,
    against: str | None,
    accuracy: float | None,
    frequency: str | None,
    wavelength: str | None,
    reading: Reading,
    feeding: Mapping[str, str | None],
    bandwidth: str | None,
    engine: str,
    precision: str | None,
    floor_db: float,
    formats: Sequence[str],
    out: str | None,
) -> None:
    """Write NAME.png and the values; print how far methods are apart, and the files' paths.

    ``formats`` : of the values, "nc" and "zarr", "nc" if empty; "vti" for planes.

    Raises
    ------
    PolywignerError : input that cannot be used; nothing is written then.
    """
    check_source_file(source, reading)
    place = parse_place(where, samples)
    asked = wavelength_from(frequency, wavelength)
    suffixes = format_suffixes(formats or ("nc",))
    if ".vti" in suffixes and place.kind != "plane":
        raise ArgumentError(
            f"--format: expected vti, an image, with --plane, got it with --{place.kind}; use nc "
            "or zarr"
        )
    files = targets(output_stem(out, Path(source).stem), (".png", *suffixes))
    check_files(files)

    # Everything cheap has been checked: only now the libraries that take a second to import.
    from polywigner.figures import outline_of
    from polywigner.figures.levels import check_floor
    from polywigner.propagation.stores_files import required

    check_floor(floor_db)
    wanted = parse_methods(methods or _DEFAULT, obliquity, order)
    reference = compared_with(wanted, against)
    for suffix, module in (("", "xarray"), (".nc", "h5netcdf"), (".zarr", "zarr")):
        if not suffix or suffix in suffixes:
            required(module)  # now rather than after the work
    radiator, said = read_fed_source(source, reading, feeding, asked)
    length = required_wavelength(said)
    check_wavelength(length, outline_of(radiator).diameter)
    place = place._replace(shape=samples_of_place(radiator, place, length, amplitude))
    how = {
        "quantity": "amplitude" if amplitude else "irradiance",
        "bandwidth": None if bandwidth is None else parse_frequency(bandwidth),
        "tolerance": accuracy,
        "engine": engine,
        "precision": precision,
    }
    found = _fields(radiator, place, wanted, length, how)
    figure = _figure(
        found, place, reference, floor_db, f"{field_title(source, length)}\n{place_text(place)}"
    )
    write_field(found, figure, files)
    if len(wanted) > 1:
        print_differences(found.data_vars, reference)
    for path in files:
        print(path)


def _fields(
    source: Aperture | ApertureArray,
    place: Place,
    wanted: Sequence[MethodText],
    wavelength: float,
    how: Mapping[str, Any],
) -> Any:
    """A dataset with one variable for each method, named after it."""
    from polywigner.propagation.datasets import FieldOptions, checked_settings

    for method in wanted:  # before the first is computed
        checked_settings(wavelength, cast(FieldOptions, {**how, **method.options}))
    found = None
    for method in wanted:
        one = _field(source, place, wavelength, {**how, **method.options})
        one = one.rename({method.method: method.name})
        found = one if found is None else found.assign({method.name: one[method.name]})
    return found


def _field(
    source: Aperture | ApertureArray, place: Place, wavelength: float, options: dict[str, Any]
) -> Any:
    import numpy as np

    import polywigner as pw

    first, *more = place.shape
    if place.kind == "line":
        return pw.line(source, place.points, first, wavelength, **options)
    if place.kind == "plane":
        return pw.plane(source, place.points, (first, more[0]), wavelength, **options)
    if place.kind == "arc":
        theta = np.linspace(-place.reach, place.reach, first)
        phi = np.array([place.phi])
    else:
        theta = np.linspace(0.0, place.reach, first)
        phi = np.arange(more[0]) * (2 * math.pi / more[0])
    return pw.hemisphere(source, place.radius, theta, phi, wavelength, **options)


def _figure(found: Any, place: Place, reference: str, floor_db: float, title: str) -> Figure:
    from polywigner.figures import draw_hemispheres, draw_lines, draw_planes

    if place.kind == "plane":
        return draw_planes(found, against=reference, floor_db=floor_db, title=title)
    if place.kind == "hemisphere":
        return draw_hemispheres(found, against=reference, floor_db=floor_db, title=title)
    return draw_lines(found, against=reference, floor_db=floor_db, title=title)
