"""``polywigner volume``: the irradiance in a box, written chunk by chunk, and its picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from polywigner.cli import field_options as fields
from polywigner.cli import options, output
from polywigner.cli.sources import MixedSourceOptions, ObstacleOptions, field_title
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_frequency

_DEFAULT = ("wigner",)
_BEHIND_OBSTACLES = ("rayleigh-sommerfeld-1",)


def volume(
    *,
    box: Annotated[str, "Three ranges: '-30 mm to 30 mm, -30 mm to 30 mm, 2 mm to 120 mm'."],
    shape: Annotated[
        str | None,
        "Samples along x, y and z, such as '64 x 64 x 96' (default: enough, from 64 to "
        "101 along each).",
    ] = None,
    method: Annotated[
        list[str] | None,
        "wigner (default), rayleigh-sommerfeld-1 (behind obstacles), rayleigh-sommerfeld-2, "
        "kirchhoff, fresnel or fraunhofer; several times to compare them.",
    ] = None,
    obliquity: options.Obliquity = None,
    against: options.Against = None,
    accuracy: options.Accuracy = None,
    source: MixedSourceOptions,
    obstacles: ObstacleOptions,
    bandwidth: options.Bandwidth = None,
    chunks: Annotated[str | None, "Samples of a chunk, such as '32 x 32 x 32'."] = None,
    threads: options.Threads = None,
    scheduler: options.Scheduler = None,
    engine: options.EngineName = "auto",
    precision: options.Precision = None,
    surfaces: Annotated[
        str | None, "Levels of the isosurfaces, dB, such as '-6, -12, -18' (default: four)."
    ] = None,
    projection: Annotated[str, "Projection on the walls: maximum, or mean."] = "maximum",
    floor_db: options.DbFloor = -40.0,
    formats: options.Formats = None,
    out: options.Out = None,
) -> None:
    """Compute the irradiance of a source in a box, chunk by chunk, and draw it.

    Writes NAME.zarr and a figure NAME.png, and with --format vti or --format nc the values also for
    ParaView, or as NetCDF. The same command continues an interrupted run.
    With several methods, each method has its files, NAME-METHOD.zarr and so on.
    """
    source.check()
    obstacles.check()
    corners = fields.parse_box(box)
    count = None if shape is None else fields.parse_shape("--shape", shape, 3)
    if count is not None and min(count) < 2:
        raise ArgumentError(
            f"--shape: expected two or more samples along each axis, got "
            f"{shape!r}; draw one layer by `polywigner propagate --plane`"
        )
    sizes = None if chunks is None else fields.parse_shape("--chunks", chunks, 3)
    levels = None if surfaces is None else fields.parse_levels("--surfaces", surfaces)
    band = None if bandwidth is None else parse_frequency(bandwidth)
    stem = output.output_stem(out, Path(source.source).stem)
    # the store is written in any case
    suffixes = tuple(suffix for suffix in fields.suffixes_of(formats or []) if suffix != ".zarr")
    output.check_writable(output.targets(stem, (".png", *suffixes)))

    import polywigner as pw
    from polywigner.figures import draw_volume
    from polywigner.figures.levels import label_of
    from polywigner.figures.volumes import check_volume_options

    drawn: dict[str, Any] = {
        "surfaces": levels,
        "floor_db": floor_db,
        "projection": projection,
    }
    check_volume_options(**drawn)
    default = _BEHIND_OBSTACLES if obstacles.obstacle else _DEFAULT
    wanted = fields.parse_methods(method or default, obliquity)
    reference = fields.compared_with(wanted, against)
    radiator, length = source.read_with_wavelength()
    bodies = obstacles.read() or None
    how: dict[str, Any] = {"engine": engine, "precision": precision, "tolerance": accuracy}
    how |= {"bandwidth": band, "obstacles": bodies}
    nx, ny, nz = count or fields.samples_of_box(radiator, corners, length)
    by_method = {}
    for one in wanted:
        name = stem if len(wanted) == 1 else stem.with_name(f"{stem.name}-{one.name}")
        store, *files = output.targets(name, (".zarr", ".png", *suffixes))
        found = pw.volume(
            radiator,
            corners,
            (nx, ny, nz),
            length,
            chunks=sizes,
            out=store,
            threads=threads,
            scheduler=scheduler,
            **how,
            **one.options,
        )
        by_method[one.name] = found[one.method]
        title = f"{label_of(found[one.method], one.method)}: {field_title(source.source, length)}"
        print(store)
        figure = draw_volume(found, radiator, title=title, obstacles=bodies or (), **drawn)
        output.write(files, [figure, *(found for _ in suffixes)])
    if len(wanted) > 1:
        fields.print_differences(by_method, reference)
