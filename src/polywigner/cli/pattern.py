"""``polywigner pattern``: the far field of a source as a data sheet, with files for other tools."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from polywigner.cli import options
from polywigner.cli.options import (
    DbFloor,
    Out,
    Text,
    files_to_write,
    parse_step,
    suffixes_of,
    write,
)
from polywigner.cli.sources import SourceOptions, field_title
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_power

if TYPE_CHECKING:
    pass

_Format = StrEnum("_Format", "csv txt ffd cut msi pln")
# Steps of the map per lobe, lambda/D wide for a source D across.
_STEPS_PER_LOBE = 8
# Default steps in degrees. The finest makes 361 x 1440 directions, a second or two of computation.
_FINEST, _COARSEST = 0.25, 1.0
# Directions in front: 0.2 GB.
_MOST = 4_000_000


def pattern(
    *,
    obliquity: Annotated[
        Text, f"Obliquity of a scalar field: {options.OBLIQUITY_HELP} (default: first)."
    ] = None,
    power: Annotated[Text, "Accepted power, such as '10 dBm' (default: none, no EIRP)."] = None,
    efficiency: Annotated[float, "Radiated over accepted power, up to 1."] = 1.0,
    polarisation: Annotated[Text, "x, y, right, left or '45 deg' (default: the file's)."] = None,
    method: Annotated[Text, "Currents: huygens (default), magnetic or electric."] = None,
    step: Annotated[Text, "Step of the angles: '0.5 deg' (default: by the lobes)."] = None,
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
            f"expected --obliquity or --method, got {obliquity} and {method}; obliquities belong "
            "to scalar fields, methods to polarised fields"
        )
    watts = None if power is None else parse_power(power)
    degrees = None if step is None else parse_step(step, 15.0, _MOST)
    suffixes = suffixes_of(formats or ["csv"])
    files = files_to_write(out, Path(source.source).stem + "_pattern", (".png", *suffixes))

    import numpy as np

    import polywigner as pw
    from polywigner.figures import draw_pattern, outline_of
    from polywigner.propagation.pattern_files import read_nearest_pattern
    from polywigner.source.source_tables import parse_direction

    radiator, length = source.read_with_wavelength()
    wavelengths = outline_of(radiator).diameter / length
    quarter = round(90.0 / (degrees or _degrees(wavelengths)))
    # the field behind is zero, but HFSS requires all directions
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
    if source.steering is not None:  # a grating lobe may be larger than the steered beam
        metrics = replace(metrics, steering=parse_direction(source.steering))
    title = field_title(source.source, length)
    figure = draw_pattern(values, cuts=[along], metrics=metrics, floor_db=floor_db, title=title)
    in_files: Any = None if obliquity is None else polarisation
    export = partial(pw.write_pattern, values, polarisation=in_files, efficiency=efficiency)
    write(files, [figure, *(export for _ in suffixes)], str(metrics))


def _degrees(wavelengths: float) -> float:
    """Return the default step in degrees for a source; warn if it is coarse."""
    needed = math.degrees(1.0 / wavelengths) / _STEPS_PER_LOBE
    if 4 * needed < _FINEST:
        warnings.warn(
            f"steps of {_FINEST:g} degrees are coarse for the lobes of a source "
            f"{wavelengths:.4g} wavelengths across, and miss some; give --step, or use "
            "polywigner.radiation_pattern on angles about the beam",
            RuntimeWarning,
            stacklevel=2,
        )
    return max(step for step in (_FINEST, 0.5, _COARSEST) if step <= max(needed, _FINEST))
