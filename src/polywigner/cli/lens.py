"""``polywigner psf`` and ``polywigner mtf``: spots and transfer functions of a lens."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated, Any

from polywigner.cli.options import DbFloor, Out
from polywigner.cli.output import files_to_write, writing
from polywigner.cli.sources import SourceOptions, check_is_coherent, short_name
from polywigner.errors import ArgumentError, QuantityError
from polywigner.quantities import parse_length

_MOST_SAMPLES = 2001
_MOST_DEFOCUS = 12

FocalLength = Annotated[str, "Focal length, or distance of the image, such as '100 mm'."]
Wavelengths = Annotated[
    str | None,
    "Several wavelengths instead of one, all the same, such as '450 nm, 550 nm, 650 nm'.",
]
Defocus = Annotated[
    str,
    "Defocus W20 in waves at the edge of the pupil, one or a series through focus: "
    "'-1, -0.5, 0, 0.5, 1'.",
]
PupilRadius = Annotated[
    str | None, "Radius of the edge of the pupil (default: that of its farthest vertex)."
]
Samples = Annotated[int, "Samples along each axis."]


def psf(
    source: SourceOptions,
    focal_length: FocalLength,
    wavelengths: Wavelengths = None,
    defocus: Defocus = "0",
    pupil_radius: PupilRadius = None,
    width: Annotated[
        str | None, "Side of the picture, such as '50 um' (default: some 12 spots)."
    ] = None,
    samples: Samples = 201,
    floor_db: DbFloor = -40.0,
    out: Out = None,
) -> None:
    """Compute the spot that a lens with a pupil makes of a star, through focus.

    Writes a figure NAME_psf.png and the values NAME_psf.nc, in 1/m^2 of an integral of one.
    """
    source.check()
    series = _series(defocus)
    _check_samples(samples)
    side = None if width is None else parse_length(width)
    files = files_to_write(out, Path(source.source).stem + "_psf", (".png", ".nc"))

    import numpy as np
    import xarray as xr

    import polywigner as pw
    from polywigner.figures import draw_psf, outline_of
    from polywigner.figures.levels import check_floor

    check_floor(floor_db)
    pupil, lengths = _read(source, wavelengths, "psf")
    distance, radius = parse_length(focal_length), _radius(pupil_radius)
    if side is None:
        side = 12.0 * max(lengths) * distance / outline_of(pupil).diameter
    x = np.linspace(-side / 2, side / 2, samples)
    points = np.stack(np.meshgrid(x, x), axis=-1)
    spots = [pw.psf(pupil, points, lengths, distance, waves, radius) for waves in series]
    found = xr.Dataset(
        {"psf": (("defocus", "y", "x"), np.array(spots), {"units": "m-2"})},
        {"defocus": series, "y": ("y", x, {"units": "m"}), "x": ("x", x, {"units": "m"})},
        _settings(source, lengths, distance),
    )
    figure = draw_psf(found, floor_db, _title(source, lengths, distance))
    with writing(files) as (picture, values):
        figure.savefig(picture, format="png")
        pw.write_netcdf(found, values)


def mtf(
    source: SourceOptions,
    focal_length: FocalLength,
    wavelengths: Wavelengths = None,
    defocus: Defocus = "0",
    pupil_radius: PupilRadius = None,
    pixel: Annotated[str, "Side of the detector's square pixels, such as '4 um'."] = "0 m",
    highest: Annotated[
        float | None, "Highest frequency in cycles/mm (default: where the lens ends)."
    ] = None,
    samples: Samples = 201,
    out: Out = None,
) -> None:
    """Compute the modulation transfer function of a lens with a pupil, along x and y.

    Writes a figure NAME_mtf.png and a table NAME_mtf.csv, frequencies in cycles/mm.
    """
    source.check()
    series = _series(defocus)
    _check_samples(samples)
    if highest is not None and not 0.0 < highest < 1e9:
        raise ArgumentError(f"expected --highest above zero, in cycles/mm, got {highest:g}")
    side = 0.0 if pixel.split()[:1] == ["0"] else parse_length(pixel)
    files = files_to_write(out, Path(source.source).stem + "_mtf", (".png", ".csv"))

    import numpy as np
    import xarray as xr

    import polywigner as pw
    from polywigner.figures import draw_mtf, outline_of
    from polywigner.geometry.display import length_text

    pupil, lengths = _read(source, wavelengths, "mtf")
    distance, radius = parse_length(focal_length), _radius(pupil_radius)
    west, south, east, north = outline_of(pupil).bounds
    reach = max(east - west, north - south)
    end = highest or reach / (min(lengths) * distance) * 1e-3
    frequency = np.linspace(0.0, end, samples)
    lines = frequency[:, None] * np.eye(2)[:, None]
    curves = [
        pw.mtf(pupil, lines, lengths, distance, waves, radius, pixel=side) for waves in series
    ]
    found = xr.Dataset(
        {"mtf": (("defocus", "direction", "frequency"), np.array(curves))},
        {"defocus": series, "direction": ["x", "y"], "frequency": frequency},
        {**_settings(source, lengths, distance), "pixel": side},
    )
    detector = f", pixels of {length_text(side)}" if side else ""
    figure = draw_mtf(found, _title(source, lengths, distance) + detector)
    with writing(files) as (picture, values):
        figure.savefig(picture, format="png")
        with Path(values).open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(
                ["frequency_per_mm"]
                + [f"mtf_{axis}_defocus_{waves:g}" for waves in series for axis in "xy"]
            )
            rows.writerows(
                np.column_stack([frequency, np.reshape(curves, (-1, samples)).T]).tolist()
            )


def _series(text: str) -> list[float]:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not 1 <= len(found) <= _MOST_DEFOCUS or not all(abs(waves) < 1e6 for waves in found):
        raise QuantityError(
            f"expected --defocus as up to {_MOST_DEFOCUS} numbers of waves, such as '-1, 0, 1', "
            f"got {text[:40]!r}"
        )
    return found


def _check_samples(samples: int) -> None:
    if not 2 <= samples <= _MOST_SAMPLES:
        raise ArgumentError(f"expected --samples from 2 to {_MOST_SAMPLES}, got {samples}")


def _radius(text: str | None) -> float | None:
    return None if text is None else parse_length(text)


def _read(source: SourceOptions, wavelengths: str | None, command: str) -> tuple[Any, list[float]]:
    """The pupil, and wavelengths in m."""
    if wavelengths is None:
        pupil, length = source.read_with_wavelength()
        lengths = [length]
    else:
        if source.wavelength is not None or source.frequency is not None:
            raise ArgumentError(
                "expected --wavelengths or one of --wavelength and --frequency, got both"
            )
        lengths = [parse_length(part) for part in wavelengths.split(",")]
        pupil, _ = source.read()
    check_is_coherent(pupil, command)
    return pupil, lengths


def _settings(source: SourceOptions, lengths: list[float], distance: float) -> dict[str, Any]:
    return {
        "source": Path(source.source).name,
        "wavelengths": lengths,
        "focal_length": distance,
    }


def _title(source: SourceOptions, lengths: list[float], distance: float) -> str:
    from polywigner.geometry.display import length_unit

    unit, far = length_unit(max(lengths)), length_unit(distance)
    waves = ", ".join(f"{length / unit.metres:.4g}" for length in lengths)
    return (
        f"{short_name(source.source)}, {waves} {unit.name}, focal length "
        f"{distance / far.metres:.4g} {far.name}"
    )
