"""The commands ``polywigner psf`` and ``mtf``: spots and transfer functions of lenses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from polywigner.cli.options import (
    DbFloor,
    Out,
    Text,
    files_to_write,
    parse_coefficients,
    parse_numbers,
    write,
)
from polywigner.cli.sources import SourceOptions, short_name
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_length

if TYPE_CHECKING:
    from polywigner import Aberration, Aperture
    from polywigner import Array as ApertureArray

# Smallest magnitude of a negative contrast that the figure marks.
_FAINT = 1e-3
Samples = Annotated[int, typer.Option(min=2, max=2001, help="Samples along each axis.")]


@dataclass(frozen=True, kw_only=True)
class LensOptions(SourceOptions):
    """Options for a lens with its pupil: focal length, wavelengths, defocus and aberrations."""

    focal_length: Annotated[Text, "Focal length, or image distance, such as '100 mm'."] = None
    numerical_aperture: Annotated[
        float | None, "Numerical aperture, instead of the focal length, for this pupil radius."
    ] = None
    wavelengths: Annotated[Text, "Several wavelengths: '450 nm, 550 nm, 650 nm'."] = None
    defocus: Annotated[str, "Defocus W20 in waves at the pupil's edge: '-1, 0, 1'."] = "0"
    pupil_radius: Annotated[Text, "Radius of the pupil's edge (default: farthest vertex)."] = None
    zernike: Annotated[
        Text, "Noll coefficients in waves rms of the mean wavelength: '4: 0.05, 11: 0.1'."
    ] = None

    def series(self) -> list[float]:
        """Return the values of ``--defocus``, W20 in waves at the pupil's edge."""
        return list(parse_numbers("--defocus", self.defocus, "-1, 0, 1"))

    def read_lens(self) -> Lens:
        """Return the lens with its pupil; raise errors in the options that describe the lens."""
        if self.wavelengths is None:
            pupil, length = self.read_with_wavelength()
            lengths = [length]
        else:
            if self.wavelength is not None or self.frequency is not None:
                raise ArgumentError(
                    "expected --wavelengths without --wavelength and --frequency, got several of "
                    "these options; omit one of them"
                )
            lengths = [parse_length(part) for part in self.wavelengths.split(",")]
            pupil, _ = self.read()
        import polywigner as pw
        from polywigner.transforms.pupil import checked_pupil_radius, image_distance

        given = None if self.pupil_radius is None else parse_length(self.pupil_radius)
        radius = checked_pupil_radius(pupil, given)
        focal_length = None if self.focal_length is None else parse_length(self.focal_length)
        distance = image_distance(focal_length, self.numerical_aperture, radius)
        aberration = None
        if self.zernike is not None:
            mean = sum(lengths) / len(lengths)
            waves = parse_coefficients(self.zernike)
            aberration = pw.zernike({j: mean * value for j, value in waves.items()}, radius)
        return Lens(pupil, lengths, distance, radius, aberration)


class Lens(NamedTuple):
    """A lens with its pupil; lengths are in metres."""

    pupil: Aperture | ApertureArray
    wavelengths: list[float]
    distance: float  # distance from the pupil to the image
    radius: float  # radius at which the defocus is specified
    aberration: Aberration | None

    def settings(self, options: LensOptions) -> dict[str, Any]:
        """Return the attributes of the output: file, wavelengths, focal length, Zernike terms."""
        about: dict[str, Any] = {"source": Path(options.source).name}
        about |= {"wavelengths": self.wavelengths, "focal_length": self.distance}
        return about if options.zernike is None else {**about, "zernike": options.zernike}

    def title(self, options: LensOptions) -> str:
        """Return the title of a figure: file name, wavelengths, focal length and aberrations."""
        from polywigner.quantities import length_text, length_unit

        unit = length_unit(max(self.wavelengths))
        waves = ", ".join(f"{length / unit.metres:.4g}" for length in self.wavelengths)
        about = f"{waves} {unit.name}, focal length {length_text(self.distance)}"
        if options.zernike is not None:
            about += f", Zernike {options.zernike}"
        return f"{short_name(options.source)}, {about}"


def psf(
    *,
    options: LensOptions,
    width: Annotated[Text, "Side of the image: '50 um' (default: about 12 spots)."] = None,
    samples: Samples = 201,
    linear: Annotated[bool, "Draw the figure on a linear scale."] = False,
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

    lens = options.read_lens()
    pupil, lengths, distance, radius, aberration = lens
    if side is None:
        side = 12.0 * max(lengths) * distance / outline_of(pupil).diameter
    x = np.linspace(-side / 2, side / 2, samples)
    points = np.stack(np.meshgrid(x, x), axis=-1)
    spots = [
        pw.psf(pupil, points, lengths, distance, waves, radius, aberration=aberration)
        for waves in series
    ]
    values = xr.Dataset(
        {"psf": (("defocus", "y", "x"), np.array(spots), {"units": "m-2"})},
        {"defocus": series, "y": ("y", x, {"units": "m"}), "x": ("x", x, {"units": "m"})},
        lens.settings(options),
    )
    floor = None if linear else floor_db
    write(files, [draw_psf(values, floor, lens.title(options)), values])


def mtf(
    *,
    options: LensOptions,
    pixel: Annotated[str, "Side of the detector's square pixels, such as '4 um'."] = "0 m",
    samples: Samples = 201,
    out: Out = None,
) -> None:
    """Compute the modulation transfer function of a lens with a pupil, along x and y.

    Writes a figure NAME_mtf.png and a table NAME_mtf.csv in cycles/mm, up to the cutoff of the
    shortest wavelength. In the figure, the MTF without aberrations is dashed, and frequencies of
    reversed contrast are marked.
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

    lens = options.read_lens()
    pupil, lengths, distance, radius, aberration = lens
    west, south, east, north = outline_of(pupil).bounds
    cutoff = max(east - west, north - south) / (min(lengths) * distance) * 1e-3
    frequency = np.linspace(0.0, cutoff, samples)
    lines = 1e3 * frequency[:, None] * np.eye(2)[:, None]
    pixels = np.sinc(lines * side).prod(axis=-1)
    mean = sum(lengths) / len(lengths)

    def transfer(waves: float, path: Any) -> Any:
        """Return the complex transfer function (direction, frequency).

        ``waves`` is the defocus at the mean wavelength, and ``path`` the aberration.
        """
        parts = [
            pw.otf(
                pupil, lines * (length * distance), waves * mean / length, radius,
                aberration=path, wavelength=length,
            )
            for length in lengths
        ]  # fmt: skip
        return np.mean(parts, axis=0) * pixels

    functions = np.array([transfer(waves, aberration) for waves in series])
    curves = np.abs(functions)
    dims = ("defocus", "direction", "frequency")
    is_reversed = (functions.real < 0) & (curves > _FAINT)
    variables: dict[str, Any] = {"mtf": (dims, curves), "reversed": (dims, is_reversed)}
    if aberration is not None or any(series):
        variables["limit"] = (dims[1:], np.abs(transfer(0.0, None)))
    values = xr.Dataset(
        variables,
        {"defocus": series, "direction": ["x", "y"], "frequency": frequency},
        {**lens.settings(options), "pixel": side},
    )
    detector = f", pixels of {length_text(side)}" if side else ""
    names = [f"mtf_{axis}_defocus_{waves:g}" for waves in series for axis in "xy"]
    columns = np.column_stack([frequency, np.reshape(curves, (-1, samples)).T])
    header = ",".join(["frequency_per_mm", *names])
    table = partial(np.savetxt, X=columns, fmt="%.15g", delimiter=",", header=header, comments="")
    write(files, [draw_mtf(values, lens.title(options) + detector), table])
