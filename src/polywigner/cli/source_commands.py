"""The commands ``polywigner transform`` and ``polywigner pattern``: transforms and far fields."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli import options
from polywigner.cli.options import DbFloor, Out, Text, files_to_write, write
from polywigner.cli.sources import SourceOptions, field_title, frequency_text, short_name
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_point, parse_power

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray
    from polywigner.figures import TransformSlices

_FEWEST = 257
# Largest default number of samples along an axis. This number takes about 10 s for an aperture with
# 100 edges.
_MOST_BY_DEFAULT = 513


def transform(
    source: SourceOptions,
    x: Annotated[Text, "Position of the Wigner slice: '0 mm,2 mm' (default: centre)."] = None,
    xi: Annotated[Text, "Lag of the ambiguity slice: '2 mm,0 mm' (default: automatic)."] = None,
    samples: Annotated[
        int | None,
        typer.Option(min=2, max=4096, help="Samples along an axis (default: 257 to 513)."),
    ] = None,
    floor_db: DbFloor = -40.0,
    out: Out = None,
) -> None:
    """Draw and save the transforms of an aperture or an array.

    Writes a figure NAME.png (Fourier transform, automean, a Wigner and an ambiguity slice) and
    the values NAME.npz.
    """
    source.check()
    position = None if x is None else parse_point(x)
    lag = None if xi is None else parse_point(xi)
    files = files_to_write(out, Path(source.source).stem, (".png", ".npz"))

    from polywigner.figures import draw_transforms, transform_slices

    radiator, length = source.read()
    name = short_name(source.source)
    count, zoomed = _sample_count(samples, radiator, length)
    slices = transform_slices(radiator, position, lag, length, count, zoomed)
    title = name if length is None else f"{name}, {frequency_text(length)}"
    figure = draw_transforms(slices, floor_db, title=title)
    write(files, [figure, partial(_write_values, slices)])


def _sample_count(
    requested: int | None, source: Aperture | ApertureArray, wavelength: float | None
) -> tuple[int, bool]:
    """Return the number of samples along an axis, and whether the frequency axes are cropped."""
    from polywigner.figures import LARGEST_SAMPLES, outline_of, samples_needed

    aperture = outline_of(source)
    needed = samples_needed(aperture, wavelength)
    if requested is None and needed > LARGEST_SAMPLES:
        typer.echo(
            "polywigner: the plot is cropped to the centre; all directions would require "
            f"{needed} samples along an axis",
            err=True,
        )
        return max(samples_needed(aperture, None), _FEWEST), True
    samples = requested or min(max(needed, _FEWEST), _MOST_BY_DEFAULT)
    if samples < needed:
        warnings.warn(
            f"{samples} samples along an axis are too few for the lobes of the transforms of an "
            f"aperture of {aperture.diameter:.3g} m; use --samples {needed}",
            RuntimeWarning,
            stacklevel=2,
        )
    return samples, False


def _write_values(slices: TransformSlices, path: Path) -> None:
    """Write the slices as .npz with a JSON string ``metadata``, which describes axes and units."""
    import numpy as np

    # GEOS writes WKT with only 16 decimals; GeoJSON contains all digits.
    from shapely import to_geojson

    import polywigner as pw

    units = {"x": "m", "xi": "m", "frequency": "1/m"}
    units |= dict.fromkeys(("fourier", "wigner", "ambiguity"), "m^2")
    arrays: dict[str, Any] = {name: getattr(slices, name) for name in units}
    arrays["aperture_geojson"] = to_geojson(slices.aperture.polygons)
    arrays["automean_geojson"] = to_geojson(slices.support.polygons)
    arrays["wavelength"] = np.nan if slices.wavelength is None else slices.wavelength
    units |= {"aperture_geojson": "m", "automean_geojson": "m", "wavelength": "m (nan: not given)"}
    metadata = {
        "axes": "fourier[j, i] and wigner[j, i] at nu = (frequency[i], frequency[j]); "
        "ambiguity[j, i] at upsilon = (frequency[i], frequency[j])",
        "convention": "F(nu) = int u exp(-2 pi i nu.x) dx",
        "units": units,
        "polywigner": pw.__version__,
    }
    np.savez_compressed(path, metadata=json.dumps(metadata), **arrays)


_Format = StrEnum("_Format", "csv txt ffd cut msi pln")
# Number of steps of the map per lobe; lobes of a source of diameter D are lambda/D wide.
_STEPS_PER_LOBE = 8
# Finest and coarsest default step [degrees]; the finest step takes 1 to 2 s.
_FINEST, _COARSEST = 0.25, 1.0
# Smallest step [degrees]. The values at the resulting 4,000,000 directions take 0.2 GB.
_SMALLEST = 0.09


def pattern(
    *,
    obliquity: Annotated[
        Text, f"Obliquity of a scalar field: {options.OBLIQUITY_HELP} (default: first)."
    ] = None,
    power: Annotated[Text, "Accepted power, such as '10 dBm' (default: none, no EIRP)."] = None,
    efficiency: Annotated[float, "Ratio of radiated to accepted power, up to 1."] = 1.0,
    polarisation: Annotated[Text, "x, y, right, left or '45 deg' (default: the file's)."] = None,
    method: Annotated[Text, "Currents: huygens (default), magnetic or electric."] = None,
    step: Annotated[Text, "Step of the angles: '0.5 deg' (default: automatic)."] = None,
    element: Annotated[Text, "Far-field file of each element (.csv .txt .ffd .ffe .cut)."] = None,
    source: SourceOptions,
    floor_db: DbFloor = -40.0,
    formats: Annotated[
        list[_Format] | None, "csv, txt, ffd, cut, msi or pln (repeatable; default: csv)."
    ] = None,
    out: Out = None,
) -> None:
    """Compute the radiation pattern of a source and its data sheet.

    Prints directivity, gain, EIRP, beam direction, half-power widths, nulls and sidelobes. Writes a
    figure NAME_pattern.png (cuts, polar plot, u-v map, data sheet) and the values.
    """
    source.check()
    if obliquity is not None and method is not None:
        raise ArgumentError(
            f"expected either --obliquity or --method, got {obliquity} and {method}; scalar "
            "fields have an obliquity, polarised fields have a method"
        )
    watts = None if power is None else parse_power(power)
    degrees = None if step is None else options.parse_step(step, _SMALLEST, 15.0)
    suffixes = options.suffixes_of(formats or ["csv"])
    files = files_to_write(out, Path(source.source).stem + "_pattern", (".png", *suffixes))

    import numpy as np

    import polywigner as pw
    from polywigner.figures import draw_pattern, outline_of
    from polywigner.propagation.pattern_files import read_nearest_pattern
    from polywigner.source.source_tables import parse_direction

    radiator, length = source.read_with_wavelength()
    wavelengths = outline_of(radiator).diameter / length
    quarter = round(90.0 / (degrees or _default_step(wavelengths)))
    # HFSS requires all directions, although the field behind the source is zero.
    theta_steps = 2 * quarter if ".ffd" in suffixes else quarter
    theta = np.radians(np.arange(theta_steps + 1) * 90.0 / quarter)
    phi = np.radians(np.arange(4 * quarter) * 90.0 / quarter)
    settings: dict[str, Any] = {"obliquity": obliquity}
    if obliquity is None:
        jones: Any = source.polarisation() if polarisation is None else polarisation
        if jones is None and method is not None and element is None:
            jones = "y"
        settings = {"polarisation": jones, "method": method}
    if element is not None:
        settings["element"] = read_nearest_pattern(element, pw.SPEED_OF_LIGHT / length)
    values = pw.radiation_pattern(radiator, length, theta, phi, **settings)
    along = pw.beam_cuts(radiator, length, **settings)
    metrics = pw.beam_metrics(along, power=watts, efficiency=efficiency)
    if source.steering is not None:  # A grating lobe may be larger than the steered beam.
        metrics = replace(metrics, steering=parse_direction(source.steering))
    title = field_title(source.source, length)
    figure = draw_pattern(values, cuts=[along], metrics=metrics, floor_db=floor_db, title=title)
    in_files: Any = None if obliquity is None else polarisation
    export = partial(pw.write_pattern, values, polarisation=in_files, efficiency=efficiency)
    write(files, [figure, *(export for _ in suffixes)], str(metrics))


def _default_step(diameter_in_wavelengths: float) -> float:
    """Return the default step in degrees; warn if lobes are narrower than the finest step."""
    needed = math.degrees(1.0 / diameter_in_wavelengths) / _STEPS_PER_LOBE
    if 4 * needed < _FINEST:
        warnings.warn(
            f"steps of {_FINEST:g} degrees are too coarse for some lobes of a source "
            f"{diameter_in_wavelengths:.4g} wavelengths across; specify --step, or use "
            "polywigner.radiation_pattern for angles close to the beam",
            RuntimeWarning,
            stacklevel=2,
        )
    return max(step for step in (_FINEST, 0.5, _COARSEST) if step <= max(needed, _FINEST))
