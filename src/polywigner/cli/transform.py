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

from polywigner.cli.options import DbFloor, Out, files_to_write, write
from polywigner.cli.sources import SourceOptions, frequency_text, short_name
from polywigner.errors import QuantityError
from polywigner.quantities import parse_angle, parse_coordinate, parse_point

if TYPE_CHECKING:
    from polywigner import Aperture, FirstOrder
    from polywigner.figures import SystemSlices, TransformSlices


_EXAMPLE = '"space 50 mm, lens 50 mm, space 50 mm"'


def system_from(text: str) -> FirstOrder:
    """The system of a text: parts with commas between them, the first is passed first.

    Parts are ``space z``, ``lens f``, ``lens fx fy`` with ``inf`` for none, ``magnifier m``,
    ``fourier f``, ``fractional order f`` and ``turn angle``. Raises QuantityError for others.
    """
    import polywigner as pw

    system = pw.FirstOrder.magnifier(1.0)
    for part in text.split(","):
        system = _part(part) @ system
    return system


def _part(text: str) -> FirstOrder:
    from polywigner import FirstOrder

    kind, _, rest = text.strip().partition(" ")
    rest = rest.strip()
    match kind:
        case "space":
            return FirstOrder.free_space(parse_coordinate(rest))
        case "lens":
            parts = re.split(r"\s+(?=[-+.\d]|inf)", rest)
            focal = tuple(math.inf if part == "inf" else parse_coordinate(part) for part in parts)
            return FirstOrder.lens(focal[0] if len(focal) == 1 else focal)  # type: ignore[arg-type]
        case "magnifier":
            return FirstOrder.magnifier(_number(rest, "magnification"))
        case "fourier":
            return FirstOrder.fourier(parse_coordinate(rest))
        case "fractional":
            order, _, scale = rest.partition(" ")
            return FirstOrder.fractional(_number(order, "order"), parse_coordinate(scale))
        case "turn":
            return FirstOrder.rotation(parse_angle(rest))
    raise QuantityError(
        f"expected a system such as {_EXAMPLE}, of space, lens, magnifier, fourier, fractional and "
        f"turn, got {text.strip()[:40]!r}"
    )


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise QuantityError(
            f"expected the {what} as a number, as in a system {_EXAMPLE}, got {text[:40]!r}"
        ) from None


_FEWEST = 257
_MOST_UNASKED = 513  # some ten seconds for an aperture of a hundred edges
_AHEAD = 0.1  # of the area that radiates in phase: cosine tapers have 0.66


def transform(
    source: SourceOptions,
    x: Annotated[
        str | None, "Position of the Wigner slice, such as '0 mm,2 mm' (default: centre)."
    ] = None,
    xi: Annotated[
        str | None, "Lag of the ambiguity slice (default: one with a good overlap)."
    ] = None,
    through: Annotated[
        str | None,
        "Lenses behind it, such as 'space 50 mm, lens 50 mm, space 50 mm', in the order "
        "of the light: shows W and the light behind them.",
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=4096,
            help="Samples along each frequency axis (default: 257, or up to 513).",
        ),
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


def _samples(given: int | None, source: Any, wavelength: float | None) -> tuple[int, bool]:
    """The number asked for, else as many as are needed within bounds; whether axes are zoomed.

    They are where no picture has room for all, and the light goes straight ahead. Warns of too few.
    """
    from polywigner.figures import LARGEST_SAMPLES, outline_of, samples_needed

    aperture = outline_of(source)
    needed = samples_needed(aperture, wavelength)
    if given is None and needed > LARGEST_SAMPLES and _goes_ahead(source, aperture):
        typer.echo(
            "polywigner: shows the middle of the pattern; all directions would take "
            f"{needed} samples along an axis",
            err=True,
        )
        return max(samples_needed(aperture, None), _FEWEST), True
    samples = min(max(needed, _FEWEST), _MOST_UNASKED) if given is None else given
    if samples < needed:
        remedy = (
            f"--samples {needed} would do"
            if needed <= LARGEST_SAMPLES
            else "give a longer wavelength, or none, to see the middle of the pattern"
        )
        warnings.warn(
            f"{samples} samples along an axis miss lobes of the transforms of an aperture of "
            f"{aperture.diameter:.3g} m: {remedy}",
            RuntimeWarning,
            stacklevel=2,
        )
    return samples, False


def _goes_ahead(source: Any, aperture: Aperture) -> bool:
    """Whether |F(0)|^2 is near the largest that a field of this power and area can have."""
    import numpy as np

    import polywigner as pw

    zero = np.zeros(2)
    ahead = abs(complex(pw.fourier(source, zero))) ** 2
    return ahead > _AHEAD * aperture.area * float(np.real(pw.lag_marginal(source, zero)))


def _write_values(slices: TransformSlices | SystemSlices, path: Path) -> None:
    """Write arrays as .npz under their names, and a JSON text ``metadata`` with axes and units."""
    import numpy as np

    import polywigner as pw
    from polywigner.figures import TransformSlices

    arrays: dict[str, Any] = {"aperture_geojson": _geojson(slices.aperture)}
    if isinstance(slices, TransformSlices):
        units = {"x": "m", "xi": "m", "frequency": "1/m"}
        units |= dict.fromkeys(("fourier", "wigner", "ambiguity"), "m^2")
        arrays["automean_geojson"] = _geojson(slices.support)
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


def _geojson(aperture: Any) -> str:
    import shapely

    # GeoJSON rather than WKT: GEOS writes all digits of it.
    return shapely.to_geojson(aperture.polygons)
