"""``polywigner transform``: one figure and one file of values for an aperture or source file."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polywigner.cli.output import check_text, check_writable, output_stem, targets, writing
from polywigner.cli.plausibility import check_wavelength
from polywigner.errors import ArgumentError, FileFormatError
from polywigner.quantities import parse_frequency, parse_length, parse_point, wavelength_of

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner.figures import TransformSlices

__all__ = ["run_transform"]

_FEWEST = 257
# A frequency and the wavelength typed for it, with a few digits.
_SAME_WAVELENGTH = 1e-3
_MOST_UNASKED = 513  # some ten seconds for an aperture of a hundred edges


def run_transform(
    aperture: str,
    *,
    unit: str | None,
    tolerance: str | None,
    feeding: Mapping[str, str | None],
    frequency: str | None,
    wavelength: str | None,
    x: str | None,
    xi: str | None,
    samples: int | None,
    floor_db: float,
    out: str | None,
) -> None:
    """Write NAME.png and NAME.npz for an aperture or source file and print their paths.

    Quantities are texts with units, such as ``"94 GHz"`` and ``"0 mm,2 mm"``; ``feeding`` holds
    those of tapers, layouts and steering. ``samples`` None: 257, or as many as the lobes of the
    transform need, up to 513.

    Raises
    ------
    PolywignerError : input that cannot be used; nothing is written then.
    """
    _check_file(aperture)
    reach = None if tolerance is None else parse_length(tolerance)
    length = _wavelength(frequency, wavelength)
    position = None if x is None else parse_point(x)
    lag = None if xi is None else parse_point(xi)
    files = targets(output_stem(out, Path(aperture).stem), (".png", ".npz"))
    check_writable(files)

    # Everything cheap has been checked: only now the libraries that take a second to import.
    import polywigner as pw
    from polywigner.figures import draw_transforms, outline_of, transform_slices
    from polywigner.figures.levels import check_floor
    from polywigner.illumination.texts import fed

    check_floor(floor_db)
    if _is_source_file(aperture):
        for name, given in (("--unit", unit), ("--tolerance", tolerance)):
            if given is not None:
                raise ArgumentError(
                    f"expected no {name} with a source file, got {given!r}; the file says its own"
                )
        source, length = _read_source(aperture, length)
    else:
        source = pw.read_aperture(aperture, unit=unit or "mm", tolerance=reach)
    texts = {name: text for name, text in feeding.items() if text is not None}
    source = fed(source, texts, length)
    outline = outline_of(source)
    if length is not None:
        check_wavelength(length, outline.diameter)
    slices = transform_slices(source, position, lag, length, _samples(samples, outline, length))
    figure = draw_transforms(slices, floor_db, title=Path(aperture).name)
    with writing(files) as (picture, values):
        figure.savefig(picture, format="png")
        with values.open("wb") as file:
            _save_values(file, slices)
    for path in files:
        print(path)


def _read_source(path: str, wavelength: float | None) -> tuple[Any, float | None]:
    """The source, and the wavelength that was asked for, or else its own."""
    from polywigner.illumination.files.reading import read_with_wavelength

    source, own = read_with_wavelength(path)
    if wavelength is None or own is None:
        return source, own if wavelength is None else wavelength
    if abs(wavelength - own) > _SAME_WAVELENGTH * own:
        warnings.warn(
            f"the phases in {Path(path).name} are set for its own wavelength of {own:.6g} m, and "
            f"its beam is shown at {wavelength:.6g} m, where it squints; leave --frequency and "
            "--wavelength out to see it at its own",
            RuntimeWarning,
            stacklevel=2,
        )
    return source, wavelength


def _is_source_file(path: str) -> bool:
    """TOML; or JSON whose outermost table has a kind, which GeoJSON has not."""
    suffix = Path(path).suffix.lower()
    if suffix != ".json":
        return suffix == ".toml"
    try:
        with open(path, encoding="utf-8-sig") as file:  # noqa: PTH123
            content = json.load(file)
    except (ValueError, RecursionError, OSError):
        return False  # the reader of apertures says what is wrong with it
    return isinstance(content, dict) and "kind" in content and "type" not in content


def _check_file(aperture: str) -> None:
    check_text("the aperture file", aperture)
    if not os.path.isfile(aperture):  # noqa: PTH113 (pathlib raises for a name too long)
        raise FileFormatError(
            f"expected an aperture file, got {aperture!r}, which is not a file; check its path"
        )


def _wavelength(frequency: str | None, wavelength: str | None) -> float | None:
    if frequency is not None and wavelength is not None:
        raise ArgumentError("expected --frequency or --wavelength, got both; drop one of them")
    if frequency is not None:
        return wavelength_of(parse_frequency(frequency))
    return None if wavelength is None else parse_length(wavelength)


def _samples(given: int | None, aperture: Aperture, wavelength: float | None) -> int:
    """What was asked for, else as many as are needed within bounds; a warning of too few."""
    from polywigner.figures import LARGEST_SAMPLES, samples_needed

    needed = samples_needed(aperture, wavelength)
    samples = min(max(needed, _FEWEST), _MOST_UNASKED) if given is None else given
    if 2 <= samples < needed:
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
    return samples


def _save_values(file: Any, slices: TransformSlices) -> None:
    """The arrays under their names, and a JSON text ``metadata`` with units and settings."""
    import numpy as np

    import polywigner as pw

    metadata = {
        "axes": "fourier[j, i] and wigner[j, i] at nu = (frequency[i], frequency[j]); "
        "ambiguity[j, i] at upsilon = (frequency[i], frequency[j])",
        "convention": "F(nu) = int u exp(-2 pi i nu.x) dx",
        "units": {
            "frequency": "1/m",
            "fourier": "m^2",
            "wigner": "m^2",
            "ambiguity": "m^2",
            "x": "m",
            "xi": "m",
            "wavelength": "m (nan: not given)",
            "aperture_geojson": "m",
            "automean_geojson": "m",
        },
        "polywigner": pw.__version__,
    }
    np.savez(
        file,
        frequency=slices.frequency,
        fourier=slices.fourier,
        wigner=slices.wigner,
        ambiguity=slices.ambiguity,
        x=np.asarray(slices.x),
        xi=np.asarray(slices.xi),
        wavelength=np.asarray(np.nan if slices.wavelength is None else slices.wavelength),
        aperture_geojson=np.asarray(_geojson(slices.aperture)),
        automean_geojson=np.asarray(_geojson(slices.support)),
        metadata=np.asarray(json.dumps(metadata)),
    )


def _geojson(aperture: Any) -> str:
    import shapely

    # GeoJSON rather than WKT: GEOS writes all digits of it.
    return str(shapely.to_geojson(aperture.polygons))
