"""``polywigner transform``: one figure and one file of values for an aperture or source file."""

from __future__ import annotations

import json
import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli.options import DbFloor, Out, Text, files_to_write, write
from polywigner.cli.sources import SourceOptions, frequency_text, short_name
from polywigner.quantities import parse_point

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray
    from polywigner.figures import TransformSlices


_FEWEST = 257
_MOST_BY_DEFAULT = 513  # some ten seconds for an aperture of a hundred edges


def transform(
    source: SourceOptions,
    x: Annotated[Text, "Position of the Wigner slice: '0 mm,2 mm' (default: centre)."] = None,
    xi: Annotated[Text, "Lag of the ambiguity slice: '2 mm,0 mm' (default: by size)."] = None,
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
    count, zoomed = _samples(samples, radiator, length)
    slices = transform_slices(radiator, position, lag, length, count, zoomed)
    title = name if length is None else f"{name}, {frequency_text(length)}"
    figure = draw_transforms(slices, floor_db, title=title)
    write(files, [figure, partial(_write_values, slices)])


def _samples(
    requested: int | None, source: Aperture | ApertureArray, wavelength: float | None
) -> tuple[int, bool]:
    """Return the number of samples along an axis, and whether the frequency axes are cropped.

    The axes are cropped if a figure with all directions would be too large. Too few samples raise a
    warning.
    """
    from polywigner.figures import LARGEST_SAMPLES, outline_of, samples_needed

    aperture = outline_of(source)
    needed = samples_needed(aperture, wavelength)
    if requested is None and needed > LARGEST_SAMPLES:
        typer.echo(
            "polywigner: the plot is cropped to the centre; all directions would take "
            f"{needed} samples along an axis",
            err=True,
        )
        return max(samples_needed(aperture, None), _FEWEST), True
    samples = requested or min(max(needed, _FEWEST), _MOST_BY_DEFAULT)
    if samples < needed:
        warnings.warn(
            f"{samples} samples along an axis miss lobes of the transforms of an aperture of "
            f"{aperture.diameter:.3g} m; use --samples {needed}",
            RuntimeWarning,
            stacklevel=2,
        )
    return samples, False


def _write_values(slices: TransformSlices, path: Path) -> None:
    """Write arrays as .npz under their names, and a JSON text ``metadata`` with axes and units."""
    import numpy as np
    from shapely import to_geojson  # all digits; GEOS writes WKT with 16 decimals only

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
