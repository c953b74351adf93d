"""``polywigner propagate``: fields in front of a source by several methods, and how they differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from polywigner.cli import field_options as fields
from polywigner.cli import options
from polywigner.cli.field_options import Place
from polywigner.cli.output import output_stem, targets, write
from polywigner.cli.sources import MixedSourceOptions, ObstacleOptions, field_title
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_frequency

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray


_DEFAULT = ("wigner", "rayleigh-sommerfeld-1")
_BEHIND_OBSTACLES = ("rayleigh-sommerfeld-1",)


def propagate(
    *,
    line: Annotated[str | None, "Two points: '0 mm, 0 mm, 2 mm to 0 mm, 0 mm, 150 mm'."] = None,
    arc: Annotated[
        str | None,
        "A cut at one distance: '50 mm', or '50 mm, 45 deg, 80 deg' with the angle of "
        "the cut from x, and the largest from the axis.",
    ] = None,
    plane: Annotated[
        str | None, "Ranges of two coordinates: '-30 mm to 30 mm, -30 mm to 30 mm, 90 mm'."
    ] = None,
    hemisphere: Annotated[str | None, "Radius of a hemisphere, such as '50 mm'."] = None,
    samples: Annotated[
        str | None, "'201' on lines and arcs, '101 x 81' elsewhere (default: enough)."
    ] = None,
    method: Annotated[
        list[str] | None,
        "wigner, rayleigh-sommerfeld-1, rayleigh-sommerfeld-2, kirchhoff, fresnel or fraunhofer; "
        "several times to compare them (default: the first two; behind obstacles the second). "
        "wigner with its own obliquity: 'wigner paper', 'wigner kirchhoff'.",
    ] = None,
    obliquity: options.Obliquity = None,
    amplitude: Annotated[bool, "Complex fields, with phases; not by wigner."] = False,
    against: options.Against = None,
    accuracy: options.Accuracy = None,
    source: MixedSourceOptions,
    obstacles: ObstacleOptions,
    bandwidth: options.Bandwidth = None,
    engine: options.EngineName = "auto",
    precision: options.Precision = None,
    floor_db: options.DbFloorOfFields = None,
    linear: Annotated[bool, "Linear scale instead of decibels; not on hemispheres."] = False,
    formats: options.Formats = None,
    out: options.Out = None,
) -> None:
    """Compute the field of a source in front of it, by several methods side by side.

    On a line, an arc, a plane or a hemisphere. Writes a figure NAME.png and the values NAME.nc
    (or what --format says: nc, zarr, and of planes vti, for ParaView), and prints how far the
    methods are apart. For volumes, see `polywigner volume`.
    """
    source.check()
    obstacles.check()
    where = {"line": line, "arc": arc, "plane": plane, "hemisphere": hemisphere}
    place = fields.parse_place(where, samples)
    if linear and place.kind == "hemisphere":
        raise ArgumentError("--linear: hemispheres are shown in decibels; leave it out")
    suffixes = fields.suffixes_of(formats or ["nc"])
    if ".vti" in suffixes and place.kind != "plane":
        raise ArgumentError(
            f"--format: expected vti, an image, with --plane, got it with --{place.kind}; use nc "
            "or zarr"
        )
    files = targets(output_stem(out, Path(source.source).stem), (".png", *suffixes))
    fields.check_files(files)

    from polywigner.figures import draw_hemispheres, draw_lines, draw_planes
    from polywigner.propagation.stores import required

    default = _BEHIND_OBSTACLES if obstacles.obstacle else _DEFAULT
    wanted = fields.parse_methods(method or default, obliquity)
    reference = fields.compared_with(wanted, against)
    for suffix, module in ((".nc", "h5netcdf"), (".zarr", "zarr")):
        if suffix in suffixes:
            required(module)  # now rather than after the work
    radiator, length = source.read_with_wavelength()
    bodies = obstacles.read()
    place = place._replace(shape=fields.samples_of_place(radiator, place, length, amplitude))
    how = {
        "quantity": "amplitude" if amplitude else "irradiance",
        "bandwidth": None if bandwidth is None else parse_frequency(bandwidth),
        "tolerance": accuracy,
        "obstacles": bodies or None,
        "engine": engine,
        "precision": precision,
    }
    found = _fields(radiator, place, wanted, length, how)
    title = f"{field_title(source.source, length)}\n{fields.place_text(place)}"
    drawn: dict[str, Any] = {"against": reference, "title": title}
    if floor_db is not None:
        drawn["floor_db"] = floor_db
    if place.kind != "hemisphere":
        drawn["linear"] = linear
    if place.kind == "plane":
        drawn["obstacles"] = bodies
    draw = {"plane": draw_planes, "hemisphere": draw_hemispheres}.get(place.kind, draw_lines)
    figure = draw(found, **drawn)
    if len(wanted) > 1:
        fields.print_differences(found.data_vars, reference)
    write(files, [figure, *(found for _ in suffixes)])


def _fields(
    source: Aperture | ApertureArray,
    place: Place,
    wanted: Sequence[fields.MethodText],
    wavelength: float,
    how: Mapping[str, Any],
) -> Any:
    """A dataset with one variable for each method, named after it."""
    found = None
    for method in wanted:
        one = _field(source, place, wavelength, {**how, **method.options})
        one = one.rename({method.method: method.name})
        found = one if found is None else found.assign({method.name: one[method.name]})
    return found


def _field(
    source: Aperture | ApertureArray, place: Place, wavelength: float, how: dict[str, Any]
) -> Any:
    import numpy as np

    import polywigner as pw

    first, *more = place.shape
    if place.kind == "line":
        return pw.line(source, place.points, first, wavelength, **how)
    if place.kind == "plane":
        return pw.plane(source, place.points, (first, more[0]), wavelength, **how)
    if place.kind == "arc":
        theta = np.linspace(-place.reach, place.reach, first)
        phi = np.array([place.phi])
    else:
        theta = np.linspace(0.0, place.reach, first)
        phi = np.arange(more[0]) * (2 * math.pi / more[0])
    return pw.hemisphere(source, place.radius, theta, phi, wavelength, **how)
