"""``polywigner rays``: rays of a source, weighted by its Wigner function, for ray optics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from polywigner.cli.fields import format_suffixes
from polywigner.cli.output import check_writable, output_stem, targets, writing
from polywigner.cli.reading import Reading, check_wavelength
from polywigner.cli.sources import (
    check_source_file,
    read_fed_source,
    required_wavelength,
    wavelength_from,
)
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_angle, parse_power

__all__ = ["run_rays"]

_FORMATS = ("npz", "csv", "nc", "dat")


def run_rays(
    source: str,
    *,
    count: int,
    seed: int,
    drawing: Mapping[str, Any],
    cone: str | None,
    power: str | None,
    split: bool,
    frequency: str | None,
    wavelength: str | None,
    reading: Reading,
    feeding: Mapping[str, str | None],
    formats: Sequence[str],
    out: str | None,
) -> None:
    """Write the rays; print their power, its error, and the files' paths.

    Raises
    ------
    PolywignerError : input that cannot be used; nothing is written then.
    """
    check_source_file(source, reading)
    asked = wavelength_from(frequency, wavelength)
    kinds = _formats(formats, out)
    if split and kinds != ["dat"]:
        raise ArgumentError(
            f"expected --split with --format dat alone, got {', '.join(kinds)}; other formats hold "
            "signed powers"
        )
    angle = None if cone is None else parse_angle(cone)
    watts = None if power is None else parse_power(power)
    stem = output_stem(out, Path(source).stem + "_rays")
    parts = ("_positive.dat", "_negative.dat")
    files = targets(stem, parts if split else [f".{kind}" for kind in kinds])
    check_writable(files)

    # Everything cheap has been checked: only now the libraries that take a second to import.
    import polywigner as pw
    from polywigner.figures import outline_of
    from polywigner.propagation.stores_files import required
    from polywigner.rays.files import write_to

    for module in ("xarray", *(["h5netcdf"] if "nc" in kinds else [])):
        required(module)  # now rather than after the work
    radiator, said = read_fed_source(source, reading, feeding, asked)
    length = required_wavelength(said)
    check_wavelength(length, outline_of(radiator).diameter)
    rays = pw.sample_rays(
        cast(Any, radiator), length, count, seed, cone=angle, power=watts, **drawing
    )
    with writing(files) as partials:
        if split:
            write_to(rays, partials, files)
        else:
            for partial, path in zip(partials, files, strict=True):
                write_to(rays, [partial], [path])
    print(_summary(rays))
    for path in files:
        print(path)


def _formats(formats: Sequence[str], out: str | None) -> list[str]:
    """Those asked for, or that of the suffix of --out, or npz."""
    asked = [suffix.removeprefix(".") for suffix in format_suffixes(formats, _FORMATS)]
    suffix = Path(out or "").suffix.lower().removeprefix(".")
    return asked or [suffix if suffix in _FORMATS else "npz"]


def _summary(rays: Any) -> str:
    weight = rays["weight"].values
    total = float(weight.sum())
    below = float(-weight[weight < 0].sum())
    text = f"rays          {len(weight)}\npower         {total:.6g} W"
    if "batch" not in rays.coords:  # of others the error is less than that of independent rays
        scatter = float(weight @ weight) - total**2 / len(weight)
        text += f" +- {math.sqrt(max(0.0, scatter)):.2g} W"
    return f"{text}\nnegative      {below:.6g} W, which is part of it"
