"""``polywigner transform``: one figure and one file of values for an aperture or source file."""

from __future__ import annotations

import json
import math
import re
import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli.options import DbFloor, Out, Text, files_to_write, parse_numbers, write
from polywigner.cli.sources import SourceOptions, frequency_text, short_name
from polywigner.errors import QuantityError
from polywigner.quantities import parse_angle, parse_coordinate, parse_point

if TYPE_CHECKING:
    from polywigner import Aperture, FirstOrder
    from polywigner import Array as ApertureArray
    from polywigner.figures import SystemSlices, TransformSlices


_EXAMPLE = "space 50 mm, lens 50 mm, space 50 mm"
_FEWEST = 257
_MOST_BY_DEFAULT = 513  # some ten seconds for an aperture of a hundred edges


def system_from(text: str) -> FirstOrder:
    """Return the first-order system of a text, whose parts are in the order of the light.

    Parts, separated by commas, are ``space z``, ``lens f``, ``lens fx fy`` (``inf`` for no power),
    ``magnifier m``, ``fourier f``, ``fractional order f`` and ``turn angle``. Other texts raise a
    QuantityError.
    """
    import polywigner as pw

    system = pw.FirstOrder.magnifier(1.0)
    for part in text.split(","):
        system = _part(part.strip()) @ system
    return system


def _part(text: str) -> FirstOrder:
    from polywigner import FirstOrder

    kind, _, value = text.partition(" ")
    value = value.strip()
    match kind:
        case "space":
            return FirstOrder.free_space(parse_coordinate(value))
        case "lens":
            parts = re.split(r"\s+(?=[-+.\d]|inf)", value)
            focal = tuple(math.inf if part == "inf" else parse_coordinate(part) for part in parts)
            return FirstOrder.lens(focal[0] if len(focal) == 1 else focal)  # type: ignore[arg-type]
        case "magnifier":
            return FirstOrder.magnifier(parse_numbers("magnifier", value, "-2")[0])
        case "fourier":
            return FirstOrder.fourier(parse_coordinate(value))
        case "fractional":
            order, _, scale = value.partition(" ")
            (number, *_) = parse_numbers("fractional", order, "0.5")
            return FirstOrder.fractional(number, parse_coordinate(scale))
        case "turn":
            return FirstOrder.rotation(parse_angle(value))
    raise QuantityError(
        f"expected a system such as {_EXAMPLE!r}, of space, lens, magnifier, fourier, fractional "
        f"and turn, got {text[:40]!r}"
    )


def transform(
    source: SourceOptions,
    x: Annotated[Text, "Position of the Wigner slice: '0 mm,2 mm' (default: centre)."] = None,
    xi: Annotated[Text, "Lag of the ambiguity slice: '2 mm,0 mm' (default: by size)."] = None,
    through: Annotated[Text, f"Lenses behind the source, in order: '{_EXAMPLE}'."] = None,
    samples: Annotated[
        int | None,
        typer.Option(min=2, max=4096, help="Samples along an axis (default: 257 to 513)."),
    ] = None,
    floor_db: DbFloor = -40.0,
    out: Out = None,
) -> None:
    """Draw and save the transforms of an aperture or an array.

    Writes a figure NAME.png (Fourier transform, automean, a Wigner and an ambiguity slice) and
    the values NAME.npz. With --through, both show W and |U|^2 behind the lenses.
    """
    source.check()
    position = None if x is None else parse_point(x)
    lag = None if xi is None else parse_point(xi)
    system = None if through is None else system_from(through)
    if system is not None and (position or lag):
        raise QuantityError("expected no --x and no --xi with --through; leave them out")
    files = files_to_write(out, Path(source.source).stem, (".png", ".npz"))

    from polywigner.figures import draw_transforms, system_slices, transform_slices

    radiator, length = source.read()
    name = short_name(source.source)
    slices: TransformSlices | SystemSlices
    if system is None:
        count, zoomed = _samples(samples, radiator, length)
        slices = transform_slices(radiator, position, lag, length, count, zoomed)
    elif length is None:
        raise QuantityError("expected a --frequency or --wavelength with --through, got none")
    else:
        slices = system_slices(radiator, system, length, samples or _FEWEST)
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


def _write_values(slices: TransformSlices | SystemSlices, path: Path) -> None:
    """Write arrays as .npz under their names, and a JSON text ``metadata`` with axes and units."""
    import numpy as np
    from shapely import to_geojson  # all digits; GEOS writes WKT with 16 decimals only

    import polywigner as pw
    from polywigner.figures import TransformSlices

    arrays: dict[str, Any] = {"aperture_geojson": to_geojson(slices.aperture.polygons)}
    if isinstance(slices, TransformSlices):
        units = {"x": "m", "xi": "m", "frequency": "1/m"}
        units |= dict.fromkeys(("fourier", "wigner", "ambiguity"), "m^2")
        arrays["automean_geojson"] = to_geojson(slices.support.polygons)
        about = {
            "axes": "fourier[j, i] and wigner[j, i] at nu = (frequency[i], frequency[j]); "
            "ambiguity[j, i] at upsilon = (frequency[i], frequency[j])",
            "convention": "F(nu) = int u exp(-2 pi i nu.x) dx",
        }
    else:
        units = dict.fromkeys(("x", "x_out", "across", "up"), "m")
        units |= dict.fromkeys(("nu", "nu_out"), "1/m")
        units |= dict.fromkeys(("before", "behind"), "m^2")
        arrays |= {"matrix": slices.system.matrix, "light": slices.light}
        about = {
            "axes": "before[j, i] at (x[i], nu[j]), behind[j, i] at (x_out[i], nu_out[j]): W; "
            "light[j, i] at (across[i], up[j]): |U|^2 behind"
        }
    arrays |= {name: getattr(slices, name) for name in units}
    units |= {"wavelength": "m (nan: not given)"}
    units |= {name: "m" for name in arrays if name.endswith("geojson")}
    arrays["wavelength"] = np.nan if slices.wavelength is None else slices.wavelength
    metadata = json.dumps({**about, "units": units, "polywigner": pw.__version__})
    np.savez_compressed(path, metadata=metadata, **arrays)
