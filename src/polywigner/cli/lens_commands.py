"""``polywigner psf`` and ``polywigner mtf``: spots and transfer functions of a lens."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli.options import DbFloor, Out, Text, files_to_write, parse_numbers, write
from polywigner.cli.sources import SourceOptions, short_name
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_length

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray

Samples = Annotated[int, typer.Option(min=2, max=2001, help="Samples along each axis.")]


@dataclass(frozen=True, kw_only=True)
class LensOptions(SourceOptions):
    """Options of a lens and of the source in its pupil."""

    focal_length: Annotated[str, "Focal length, or image distance, such as '100 mm'."]
    wavelengths: Annotated[Text, "Several wavelengths: '450 nm, 550 nm, 650 nm'."] = None
    defocus: Annotated[str, "Defocus W20 in waves at the pupil's edge: '-1, 0, 1'."] = "0"
    pupil_radius: Annotated[Text, "Radius of the pupil's edge (default: farthest vertex)."] = None

    def series(self) -> list[float]:
        """Return the defocus values in waves."""
        return list(parse_numbers("--defocus", self.defocus, "-1, 0, 1"))

    def read_lens(self) -> tuple[Aperture | ApertureArray, list[float], float, float | None]:
        """Return the pupil, and in m the wavelengths, focal length and radius of its edge."""
        if self.wavelengths is None:
            pupil, length = self.read_with_wavelength()
            lengths = [length]
        else:
            if self.wavelength is not None or self.frequency is not None:
                raise ArgumentError(
                    "expected --wavelengths or one of --wavelength and --frequency, got both"
                )
            lengths = [parse_length(part) for part in self.wavelengths.split(",")]
            pupil, _ = self.read()
        radius = None if self.pupil_radius is None else parse_length(self.pupil_radius)
        return pupil, lengths, parse_length(self.focal_length), radius

    def settings(self, lengths: list[float], distance: float) -> dict[str, Any]:
        """Return the attributes of a dataset."""
        name = Path(self.source).name
        return {"source": name, "wavelengths": lengths, "focal_length": distance}

    def title(self, lengths: list[float], distance: float) -> str:
        """Return the title of a figure."""
        from polywigner.quantities import length_text, length_unit

        unit = length_unit(max(lengths))
        waves = ", ".join(f"{length / unit.metres:.4g}" for length in lengths)
        about = f"{waves} {unit.name}, focal length {length_text(distance)}"
        return f"{short_name(self.source)}, {about}"


def psf(
    *,
    options: LensOptions,
    width: Annotated[Text, "Side of the image: '50 um' (default: about 12 spots)."] = None,
    samples: Samples = 201,
    floor_db: DbFloor = -40.0,
    out: Out = None,
) -> None:
    """Compute the point spread function of a lens with a pupil, through focus.

    Writes a figure NAME_psf.png and the values NAME_psf.nc in 1/m^2, normalised to unit integral.
    """
    options.check()
    series = options.series()
    side = None if width is None else parse_length(width)
    files = files_to_write(out, Path(options.source).stem + "_psf", (".png", ".nc"))

    import numpy as np
    import xarray as xr

    import polywigner as pw
    from polywigner.figures import draw_psf, outline_of

    pupil, lengths, distance, radius = options.read_lens()
    if side is None:
        side = 12.0 * max(lengths) * distance / outline_of(pupil).diameter
    x = np.linspace(-side / 2, side / 2, samples)
    points = np.stack(np.meshgrid(x, x), axis=-1)
    spots = [pw.psf(pupil, points, lengths, distance, waves, radius) for waves in series]
    values = xr.Dataset(
        {"psf": (("defocus", "y", "x"), np.array(spots), {"units": "m-2"})},
        {"defocus": series, "y": ("y", x, {"units": "m"}), "x": ("x", x, {"units": "m"})},
        options.settings(lengths, distance),
    )
    write(files, [draw_psf(values, floor_db, options.title(lengths, distance)), values])


def mtf(
    *,
    options: LensOptions,
    pixel: Annotated[str, "Side of the detector's square pixels, such as '4 um'."] = "0 m",
    samples: Samples = 201,
    out: Out = None,
) -> None:
    """Compute the modulation transfer function of a lens with a pupil, along x and y.

    Writes a figure NAME_mtf.png and a table NAME_mtf.csv up to the cutoff, in cycles/mm.
    """
    options.check()
    series = options.series()
    side = 0.0 if pixel.split()[:1] == ["0"] else parse_length(pixel)
    files = files_to_write(out, Path(options.source).stem + "_mtf", (".png", ".csv"))

    import numpy as np
    import xarray as xr

    import polywigner as pw
    from polywigner.figures import draw_mtf, outline_of
    from polywigner.quantities import length_text

    pupil, lengths, distance, radius = options.read_lens()
    west, south, east, north = outline_of(pupil).bounds
    cutoff = max(east - west, north - south) / (min(lengths) * distance) * 1e-3
    frequency = np.linspace(0.0, cutoff, samples)
    lines = 1e3 * frequency[:, None] * np.eye(2)[:, None]
    curves = [
        pw.mtf(pupil, lines, lengths, distance, waves, radius, pixel=side) for waves in series
    ]
    values = xr.Dataset(
        {"mtf": (("defocus", "direction", "frequency"), np.array(curves))},
        {"defocus": series, "direction": ["x", "y"], "frequency": frequency},
        {**options.settings(lengths, distance), "pixel": side},
    )
    detector = f", pixels of {length_text(side)}" if side else ""
    names = [f"mtf_{axis}_defocus_{waves:g}" for waves in series for axis in "xy"]
    columns = np.column_stack([frequency, np.reshape(curves, (-1, samples)).T])
    header = ",".join(["frequency_per_mm", *names])
    table = partial(np.savetxt, X=columns, fmt="%.15g", delimiter=",", header=header, comments="")
    write(files, [draw_mtf(values, options.title(lengths, distance) + detector), table])
