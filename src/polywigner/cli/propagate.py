"""The commands ``polywigner propagate`` and ``polywigner volume``: fields in front of a source."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeAlias

import typer

from polywigner.cli import options
from polywigner.cli.options import Text, Texts
from polywigner.cli.sources import FieldSourceOptions, field_title
from polywigner.errors import ArgumentError, QuantityError, at_key, value_text
from polywigner.quantities import parse_angle, parse_coordinate, parse_frequency, parse_length

if TYPE_CHECKING:
    import xarray

    from polywigner import Aperture, Polyhedron
    from polywigner import Array as ApertureArray
    from polywigner.geometry import PlacedAperture

Point = tuple[float, float, float]
_Projection = Literal["maximum", "mean"]

_WIDEST = math.radians(80.0)  # default largest angle on an arc [rad]
# Largest angle on a hemisphere [rad], the limit of suggest_sampling.
_GRAZING = math.radians(89.5)
# Smallest default numbers of samples, for smooth figures.
_FEWEST = {
    "line": (401,), "arc": (321,), "plane": (129, 129), "hemisphere": (61, 120),
    "box": (64, 64, 64),
}  # fmt: skip
# Largest default numbers of samples.
_MOST = {
    "line": (1601,), "arc": (1281,), "plane": (257, 257), "hemisphere": (121, 240),
    "box": (101, 101, 101),
}  # fmt: skip
# Largest number of points in memory.
_MOST_POINTS = 1 << 26


Methods: TypeAlias = dict[str, dict[str, str | None]]
"""Arguments of each method of a run, by names such as "wigner-paper"."""


@dataclass(frozen=True, kw_only=True)
class FieldOptions(FieldSourceOptions):
    """Options of ``propagate`` and ``volume``: source, obstacles and methods."""

    method: Annotated[
        Texts,
        f"{options.METHOD_HELP}; 'wigner paper' selects an obliquity (repeatable; default: "
        f"wigner, for propagate also {options.EXACT}, behind obstacles only the latter).",
    ] = None
    obliquity: Annotated[Text, f"Obliquity of rays: {options.OBLIQUITY_HELP} (default: first)."] = (
        None
    )
    against: Annotated[Text, "Reference method (default: the last exact method)."] = None
    accuracy: Annotated[float | None, "Relative error: 1e-3 (default: depends on method)."] = None
    bandwidth: Annotated[Text, "Flat frequency band to average over, such as '4 GHz'."] = None
    edge: Annotated[Text, "Edges of obstacles: black, soft or hard (default: black)."] = None
    engine: Annotated[str, "auto, numpy, llvm or cuda."] = "auto"
    out: options.Out = None

    def methods(self, *default: str) -> tuple[Methods, str]:
        """Return the arguments of each method, and the name of the reference method."""
        from polywigner.geometry.arguments import checked_choice

        texts = self.method or ([options.EXACT] if self.obstacle else default)
        methods: Methods = {}
        for text in texts:
            method, _, obliquity = text.partition(" ")
            name = text.replace(" ", "-")
            if obliquity and method != "wigner":
                raise ArgumentError(
                    f"--method: only the method wigner accepts an obliquity, got {text!r}"
                )
            methods[name] = {"method": method}
            if method == "wigner":
                methods[name]["obliquity"] = obliquity or self.obliquity
        if self.against is not None:
            against = self.against.replace(" ", "-")
            return methods, checked_choice(against, "--against", list(methods))
        rough = "wigner", "fresnel", "fraunhofer"
        exact = [name for name, arguments in methods.items() if arguments["method"] not in rough]
        return methods, (exact or list(methods))[-1]

    def arguments(self, obstacles: Sequence[Polyhedron | PlacedAperture]) -> dict[str, Any]:
        """Return the arguments of :func:`polywigner.volume` that are the same for all methods."""
        return {
            "bandwidth": None if self.bandwidth is None else parse_frequency(self.bandwidth),
            "tolerance": self.accuracy,
            "obstacles": obstacles or None,
            "edge": self.edge,
            "engine": self.engine,
        }


def propagate(
    *,
    line: Annotated[Text, "Two points: '0 mm, 0 mm, 2 mm to 0 mm, 0 mm, 150 mm'."] = None,
    arc: Annotated[Text, "Distance, azimuth and largest angle: '50 mm, 45 deg, 80 deg'."] = None,
    plane: Annotated[Text, "Two ranges, one value: '-3 mm to 3 mm, -3 mm to 3 mm, 9 mm'."] = None,
    hemisphere: Annotated[Text, "Radius of a hemisphere, such as '50 mm'."] = None,
    samples: Annotated[Text, "Samples: '201', on surfaces '101 x 81' (default: automatic)."] = None,
    field: FieldOptions,
    amplitude: Annotated[bool, "Complex fields with phases; not for wigner."] = False,
    floor_db: Annotated[
        float | None,
        typer.Option(
            "--db-floor",
            help="Lowest level in dB below the peak (default: -40; planes: 99 % of the power).",
            **options.FLOOR,
        ),
    ] = None,
) -> None:
    """Compute the field in front of a source by several methods.

    The points lie on a line, an arc, a plane or a hemisphere. The command writes a figure
    NAME.png and the values NAME.nc, and prints the differences of the methods. For volumes,
    see `polywigner volume`.
    """
    field.check()
    regions = {"line": line, "arc": arc, "plane": plane, "hemisphere": hemisphere}
    region = parse_region(regions, samples)
    files = options.files_to_write(field.out, Path(field.source).stem, (".png", ".nc"))

    from polywigner.figures import draw_hemispheres, draw_lines, draw_planes
    from polywigner.propagation.stores import required

    methods, reference = field.methods("wigner", options.EXACT)
    required("h5netcdf")  # Raise MissingExtraError before the computation.
    source, wavelength = field.read_with_wavelength()
    obstacles = field.read_obstacles()
    region = region._replace(shape=samples_of_region(source, region, wavelength, amplitude))
    quantity = "amplitude" if amplitude else "irradiance"
    settings = {"quantity": quantity, **field.arguments(obstacles)}
    values = None
    for name, arguments in methods.items():
        dataset = _computed_field(source, region, wavelength, settings | arguments)
        dataset = dataset.rename({arguments["method"]: name})
        values = dataset if values is None else values.assign({name: dataset[name]})
    assert values is not None
    title = f"{field_title(field.source, wavelength)}\n{region.kind}: {regions[region.kind]}"
    drawn: dict[str, Any] = {"against": reference, "title": title}
    if floor_db is not None:
        drawn["floor_db"] = floor_db
    if region.kind == "plane":
        figure = draw_planes(values, obstacles=obstacles, **drawn)
    else:
        draw = draw_hemispheres if region.kind == "hemisphere" else draw_lines
        figure = draw(values, **drawn)
    print_differences(values.data_vars, reference)
    options.write(files, [figure, values])


def _computed_field(
    source: Aperture | ApertureArray, region: Region, wavelength: float, settings: Mapping[str, Any]
) -> xarray.Dataset:
    """Compute the field at the points of a region by a single method."""
    import numpy as np

    import polywigner as pw

    first, *more = region.shape
    if region.kind == "line":
        return pw.line(source, region.points, first, wavelength, **settings)
    if region.kind == "plane":
        return pw.plane(source, region.points, (first, more[0]), wavelength, **settings)
    if region.kind == "arc":
        theta = np.linspace(-region.largest_theta, region.largest_theta, first)
        phi = np.array([region.phi])
    else:
        theta = np.linspace(0.0, region.largest_theta, first)
        phi = np.arange(more[0]) * (2 * math.pi / more[0])
    return pw.hemisphere(source, region.radius, theta, phi, wavelength, **settings)


def volume(
    *,
    box: Annotated[str, "Three ranges: '-30 mm to 30 mm, -30 mm to 30 mm, 2 mm to 120 mm'."],
    shape: Annotated[Text, "Samples, such as '64 x 64 x 96' (default: 64 to 101 each)."] = None,
    field: FieldOptions,
    chunks: Annotated[Text, "Samples of a chunk, such as '32 x 32 x 32'."] = None,
    threads: options.Threads = None,
    scheduler: options.Scheduler = None,
    netcdf: Annotated[bool, "Write the values also as NAME.nc."] = False,
    surfaces: Annotated[Text, "Isosurfaces in dB, such as '-6, -12, -18' (default: four)."] = None,
    projection: Annotated[_Projection, "Projection on the walls: maximum or mean."] = "maximum",
    floor_db: options.DbFloor = -40.0,
) -> None:
    """Compute the irradiance of a source in a box, chunk by chunk, and draw it.

    Writes NAME.zarr and a figure NAME.png. With --netcdf, also writes the values as NAME.nc. The
    same command continues an interrupted run. With several methods, the files of each method are
    named NAME-METHOD.zarr and so on.
    """
    field.check()
    with at_key("--box"):
        corners = _parse_ranges(box, 3)
    count = () if shape is None else parse_shape("--shape", shape, 3, least=2)
    example = "-6, -12, -18"
    drawn: dict[str, Any] = {
        "surfaces": surfaces and options.parse_numbers("--surfaces", surfaces, example),
        "floor_db": floor_db,
        "projection": projection,
    }
    computed: dict[str, Any] = {
        "chunks": chunks and parse_shape("--chunks", chunks, 3),
        "threads": threads,
        "scheduler": scheduler,
    }
    stem = options.output_stem(field.out, Path(field.source).stem)
    suffixes = (".nc",) if netcdf else ()
    options.check_writable(options.targets(stem, (".png", *suffixes)))

    import polywigner as pw
    from polywigner.figures import draw_volume
    from polywigner.figures.levels import label_of
    from polywigner.figures.volumes import check_volume_options

    check_volume_options(**drawn)
    methods, reference = field.methods("wigner")
    source, wavelength = field.read_with_wavelength()
    obstacles = field.read_obstacles()
    computed |= field.arguments(obstacles)
    nx, ny, nz = samples_of_region(source, Region("box", count, corners), wavelength)
    by_method = {}
    for name, arguments in methods.items():
        path = stem if len(methods) == 1 else stem.with_name(f"{stem.name}-{name}")
        store, *files = options.targets(path, (".zarr", ".png", *suffixes))
        settings = computed | arguments
        values = pw.volume(source, corners, (nx, ny, nz), wavelength, out=store, **settings)
        by_method[name] = values[arguments["method"]]
        label = label_of(by_method[name], str(arguments["method"]))
        title = f"{label}: {field_title(field.source, wavelength)}"
        print(store)
        figure = draw_volume(values, source, title=title, obstacles=obstacles, **drawn)
        options.write(files, [figure, *(values for _ in suffixes)])
    print_differences(by_method, reference)


def print_differences(fields: Mapping[Any, xarray.DataArray], reference: str) -> None:
    """Print the largest and the rms level difference of each method from the reference, in dB.

    Points more than 30 dB below the peak of the reference method, and values of zero or below, are
    excluded.
    """
    from polywigner.figures.levels import COMPARED_DB, summary

    if len(fields) == 1:
        return
    print(f"Differences from {reference} in dB, at points above {COMPARED_DB:g} dB of its peak:")
    width = max(len(name) for name in fields)
    print(f"  {'method':{width}}  largest      rms  points")
    for name in (name for name in fields if name != reference):
        error = summary(fields[name], fields[reference])
        omitted = f", without {error.negative} values of zero or below" if error.negative else ""
        numbers = f"{error.largest:+7.3f}  {error.rms:7.4f}  {error.points} of {fields[name].size}"
        print(f"  {name:{width}}  {numbers}{omitted}")


def samples_of_region(
    source: Aperture | ApertureArray, region: Region, wavelength: float, amplitude: bool = False
) -> tuple[int, ...]:
    """Return the requested numbers of samples, or by default the required numbers within limits.

    Warns if the field has fringes that require more samples than the limits.
    """
    import polywigner as pw

    if region.shape:
        return region.shape
    box = {"box": region.points}
    corners = {"line": {"line": region.points}, "plane": box, "box": box}
    where: Any = corners.get(region.kind, {"radius": region.radius})
    quantity: Any = "amplitude" if amplitude else "irradiance"
    axes = pw.suggest_sampling(source, wavelength, quantity, **where).axes
    if region.kind in corners:
        needed = [axis.count for axis in axes if axis.high > axis.low]
    else:
        theta, phi = axes
        steps = region.largest_theta / theta.high * (theta.count - 1)
        is_arc = region.kind == "arc"
        needed = [math.ceil(2 * steps) + 1] if is_arc else [math.ceil(steps) + 1, phi.count - 1]
    fewest, most = _FEWEST[region.kind], _MOST[region.kind]
    chosen = tuple(map(min, map(max, needed, fewest), most))
    if any(map(int.__gt__, needed, most)):
        option = "--shape" if region.kind == "box" else "--samples"
        text = " x ".join(map(str, map(max, needed, chosen)))
        warnings.warn(
            f"{' x '.join(map(str, chosen))} samples are too few for the fringes of this field; "
            f'use {option} "{text}", or a smaller region',
            RuntimeWarning,
            stacklevel=2,
        )
    return chosen


class Region(NamedTuple):
    """Region in which a field is computed; angles are in rad, lengths in m.

    ``kind`` is "line", "arc", "plane", "hemisphere" or "box"; ``shape`` contains the requested
    numbers of samples, or is empty.
    """

    kind: str
    shape: tuple[int, ...]
    points: tuple[Point, ...] = ()
    radius: float = 0.0
    phi: float = 0.0
    largest_theta: float = _GRAZING


def parse_region(texts: Mapping[str, str | None], samples: str | None) -> Region:
    """Parse the option for a region; raise ArgumentError unless exactly one is not None."""
    regions = {name: text for name, text in texts.items() if text is not None}
    if len(regions) != 1:
        got = " and ".join(f"--{name}" for name in regions) or "none"
        raise ArgumentError(
            f"expected exactly one of {', '.join(f'--{name}' for name in texts)} to specify where "
            f"the field is computed, got {got}"
        )
    ((kind, text),) = regions.items()
    dimensions = 1 if kind in ("line", "arc") else 2
    shape = () if samples is None else parse_shape("--samples", samples, dimensions, least=2)
    if math.prod(shape) > _MOST_POINTS:
        raise ArgumentError(
            f"--samples: expected at most {_MOST_POINTS} points, got {math.prod(shape)}; use "
            "`polywigner volume`, which writes to disk"
        )
    with at_key(f"--{kind}"):
        if kind == "line":
            ends = _split_and_strip(text, r"\s+to\s+")
            if len(ends) != 2:
                raise QuantityError(
                    'expected two points such as "0 mm, 0 mm, 2 mm to 0 mm, 0 mm, 150 mm", got '
                    f"{value_text(text)}"
                )
            return Region(kind, shape, tuple(_parse_ranges(end, 0)[0] for end in ends))
        if kind == "plane":
            return Region(kind, shape, _parse_ranges(text, 2))
        if kind == "hemisphere":
            return Region(kind, shape, radius=parse_length(text))
        return _parse_arc(text, shape)


def _parse_arc(text: str, shape: tuple[int, ...]) -> Region:
    """Parse "DISTANCE, AZIMUTH, LARGEST ANGLE"; the angles are 0 and 80 degrees by default."""
    distance, *angles = _split_and_strip(text, ",")
    if len(angles) > 2:
        raise QuantityError(
            'expected a distance such as "50 mm", or a distance and one or two angles such as '
            f'"50 mm, 45 deg, 80 deg", got {value_text(text)}'
        )
    phi, largest_theta = (*map(parse_angle, angles), *(0.0, _WIDEST)[len(angles) :])
    if not 0 < largest_theta < math.pi / 2:
        raise QuantityError(
            f"expected the largest angle between 0 and 90 deg, got {text!r}; write degrees with "
            'their unit, such as "80 deg"'
        )
    return Region("arc", shape, (), parse_length(distance), phi, largest_theta)


_EXPECTED_RANGES = (
    'a point such as "0 mm, 0 mm, 80 mm"',
    "",
    'two ranges and a coordinate such as "-30 mm to 30 mm, -30 mm to 30 mm, 90 mm"',
    'three ranges such as "-30 mm to 30 mm, -30 mm to 30 mm, 2 mm to 120 mm"',
)


def _parse_ranges(text: str, count: int) -> tuple[Point, Point]:
    """Parse ``count`` ranges and 3 - ``count`` coordinates into the lowest and highest point."""
    parts = _split_and_strip(text, ",")
    ends = []
    for part in parts:
        low, *high = map(parse_coordinate, _split_and_strip(part, r"\s+to\s+"))
        if len(high) > 1 or (high and not low < high[0]):
            raise QuantityError(
                f'expected a coordinate, or an ascending range such as "-30 mm to 30 mm", '
                f"got {part!r}"
            )
        ends.append((low, *high))
    if len(ends) != 3 or sum(map(len, ends)) != 3 + count:
        raise QuantityError(f"expected {_EXPECTED_RANGES[count]}, got {value_text(text)}")
    x, y, z = ends
    return (x[0], y[0], z[0]), (x[-1], y[-1], z[-1])


def parse_shape(option: str, text: str, dimensions: int, least: int = 1) -> tuple[int, ...]:
    """Parse integers of ``least`` or more such as ``"64 x 64 x 96"``, one for each dimension."""
    parts = _split_and_strip(text, "[x×]")
    counts = tuple(int(part) for part in parts if re.fullmatch("[0-9]{1,9}", part))
    if not len(counts) == len(parts) == dimensions or min(counts) < least:
        example = " x ".join(("64", "64", "96")[:dimensions])
        expected = f'numbers of samples of at least {least}, such as "{example}"'
        raise ArgumentError(f"{option}: expected {expected}, got {text!r}")
    return counts


def _split_and_strip(text: str, pattern: str) -> list[str]:
    """Split a string at a regular expression, and strip spaces from the parts."""
    return [part.strip() for part in re.split(pattern, text)]
