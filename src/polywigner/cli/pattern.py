"""``polywigner pattern``: the far field of a source as a data sheet, with files for other tools."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from polywigner.cli import options
from polywigner.cli.options import DbFloor, Out, files_to_write, parse_step, suffixes_of, write
from polywigner.cli.sources import SourceOptions, field_title
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_power

_Format = StrEnum("_Format", "csv txt ffd cut msi pln")
# A lobe of a source D across is lambda/D wide; so many steps across it draw it smoothly.
_STEPS_PER_LOBE = 8
# Steps of the cuts: between nulls, levels fall to some -30 dB of a lobe on samples beside them.
_CUT_STEPS_PER_LOBE, _MOST_OF_A_CUT = 64, 32769
# Degrees, unasked: the finest makes 361 x 1440 directions, a second or two for most sources.
_FINEST, _COARSEST = 0.25, 1.0
# Directions in front: 0.2 GB.
_MOST = 4_000_000


def pattern(
    *,
    obliquity: Annotated[
        str | None,
        f"Boundary condition of a scalar field (default: the first): {options.OBLIQUITIES}.",
    ] = None,
    power: Annotated[
        str | None,
        "Power that the antenna accepts, such as '10 dBm' or '10 mW'; without it, no EIRP.",
    ] = None,
    efficiency: Annotated[float, "Radiated over accepted power, up to 1 for no losses."] = 1.0,
    polarisation: Annotated[
        str | None,
        "Polarisation of the field on the aperture: x, y, right, left, or a slant such as "
        "'45 deg' (default: the source file's; without one the field is scalar). With "
        "--obliquity x or y, for the files alone.",
    ] = None,
    method: Annotated[
        str | None,
        "Currents that stand for a polarised field: huygens (default), magnetic (an "
        "opening in a metal screen) or electric.",
    ] = None,
    step: Annotated[
        str | None, "Step of the angles, such as '0.5 deg' (default: fine enough for the lobes)."
    ] = None,
    element: Annotated[
        str | None,
        "Far field of each element of a phased array, in place of its aperture: a .csv, "
        ".txt (CST), .ffd (HFSS), .ffe (FEKO) or .cut (GRASP) file.",
    ] = None,
    cuts: Annotated[
        Literal["beam", "principal"] | None,
        "Cuts of figure and table: beam, two great circles through the beam (default), or "
        "principal, the planes phi = 0 and 90 degrees.",
    ] = None,
    source: SourceOptions,
    floor_db: DbFloor = -40.0,
    formats: Annotated[
        list[_Format] | None,
        "Format of the values: csv (default), txt (CST), ffd (HFSS), cut (GRASP), msi or pln; "
        "several times for more.",
    ] = None,
    out: Out = None,
) -> None:
    """Compute the radiation pattern of a source, and the numbers of its data sheet.

    Prints directivity, gain, EIRP, beam direction, half-power widths, nulls and sidelobes. Writes a
    figure NAME_pattern.png (cuts, polar plot, u-v map, the numbers) and the values.
    """
    source.check()
    if obliquity is not None and method is not None:
        raise ArgumentError(
            f"expected --obliquity or --method, got {obliquity} and {method}; the first is of "
            "scalar fields, the second of polarised ones"
        )
    watts = None if power is None else parse_power(power)
    asked = None if step is None else parse_step(step, 15.0, _MOST)
    suffixes = suffixes_of(formats or ["csv"])
    files = files_to_write(out, Path(source.source).stem + "_pattern", (".png", *suffixes))

    import numpy as np

    import polywigner as pw
    from polywigner.figures import draw_pattern, outline_of
    from polywigner.propagation.pattern_files import read_nearest_pattern
    from polywigner.source.source_tables import direction_angles

    radiator, length = source.read_with_wavelength()
    wavelengths = outline_of(radiator).diameter / length
    degrees = asked or _degrees(wavelengths)
    quarter = round(90.0 / degrees)
    # nothing goes backwards, but HFSS wants to read it
    reach_of_theta = 2 * quarter if ".ffd" in suffixes else quarter
    theta = np.radians(np.arange(reach_of_theta + 1) * 90.0 / quarter)
    phi = np.radians(np.arange(4 * quarter) * 90.0 / quarter)
    how: dict[str, Any] = {"obliquity": obliquity}
    if obliquity is None:
        jones = source.polarisation() if polarisation is None else polarisation
        if jones is None and method is not None and element is None:
            jones = "y"
        how = {"polarisation": jones, "method": method}
    if element is not None:
        how["element"] = read_nearest_pattern(element, pw.SPEED_OF_LIGHT / length)
    found = pw.radiation_pattern(radiator, length, theta, phi, **how)
    along = (
        pw.radiation_pattern(radiator, length, _fine(wavelengths), [0.0, math.pi / 2], **how)
        if cuts == "principal"
        else pw.beam_cuts(radiator, length, **how)
    )
    metrics = pw.beam_metrics(along, power=watts, efficiency=efficiency)
    if source.steering is not None:  # it may point a grating lobe elsewhere
        metrics = replace(metrics, steering=direction_angles(source.steering))
    figure = draw_pattern(
        found,
        cuts=[along],
        metrics=metrics,
        floor_db=floor_db,
        title=field_title(source.source, length),
    )
    in_files = None if obliquity is None else cast(Any, polarisation)
    values = partial(pw.write_pattern, found, polarisation=in_files, efficiency=efficiency)
    write(files, [figure, *(values for _ in suffixes)], str(metrics))


def _fine(wavelengths: float) -> Any:
    """Angles from -90 to 90 degrees in rad, fine enough to draw the nulls of a source so wide."""
    import numpy as np

    half = math.ceil(min(_CUT_STEPS_PER_LOBE * math.pi / 2 * wavelengths, _MOST_OF_A_CUT // 2))
    return np.linspace(-math.pi / 2, math.pi / 2, 2 * max(half, 180) + 1)


def _degrees(wavelengths: float) -> float:
    """The step for a source so many wavelengths across; a warning where lobes are finer."""
    wanted = math.degrees(1.0 / wavelengths) / _STEPS_PER_LOBE
    if 4 * wanted < _FINEST:
        warnings.warn(
            f"steps of {_FINEST:g} degrees are coarse for the lobes of a source "
            f"{wavelengths:.4g} wavelengths across, and miss some; give --step, or use "
            "polywigner.radiation_pattern on angles about the beam",
            RuntimeWarning,
            stacklevel=2,
        )
    return max(step for step in (_FINEST, 0.5, _COARSEST) if step <= max(wanted, _FINEST))
