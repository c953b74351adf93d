"""``polywigner rays``: rays of a source, weighted by its Wigner function, for ray optics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from polywigner.cli.fields import format_suffixes
from polywigner.cli.options import BoundaryCondition, Out, Seed
from polywigner.cli.output import files_to_write, writing
from polywigner.cli.sources import MixedSourceOptions
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_angle, parse_power

_FORMATS = ("npz", "csv", "nc", "dat")


def rays(
    *,
    count: Annotated[int, "Number of rays."] = 100_000,
    seed: Seed = 0,
    sampling: Annotated[
        str, "Distribution of positions: uniform, marginal or quasi-random."
    ] = "uniform",
    directions: Annotated[
        str, "beam (most of them near the normal, or along the wave), or uniform."
    ] = "beam",
    cone: Annotated[
        str | None, "Half angle about the normal, such as '2 deg' (default: hemisphere)."
    ] = None,
    obliquity: BoundaryCondition = "rayleigh-sommerfeld-1",
    power: Annotated[
        str | None, "Power radiated in all directions, such as '1 mW' (default: the field's own)."
    ] = None,
    source: MixedSourceOptions,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            help="Format: npz, csv, nc, or dat (source file of OpticStudio); several times for "
            "several of them (default: that of --out, or npz).",
        ),
    ] = None,
    split: Annotated[
        bool, "With dat: positive and negative rays, by modulus, in a file each."
    ] = False,
    out: Out = None,
) -> None:
    """Draw rays that carry the Wigner function of a source, for any program that traces rays.

    A ray has a position (m), a direction and a power (W), negative where W is: only sums over rays
    mean something. Prints the power and writes NAME_rays.npz. Of a steered source say --directions
    uniform.
    """
    source.check()
    kinds = _formats(formats or [], out)
    if split and kinds != ["dat"]:
        raise ArgumentError(
            f"expected --split with --format dat alone, got {', '.join(kinds)}; other formats hold "
            "signed powers"
        )
    angle = None if cone is None else parse_angle(cone)
    watts = None if power is None else parse_power(power)
    parts = ("_positive.dat", "_negative.dat")
    suffixes = parts if split else [f".{kind}" for kind in kinds]
    files = files_to_write(out, Path(source.source).stem + "_rays", suffixes)

    import polywigner as pw
    from polywigner.propagation.stores_checks import required
    from polywigner.rays.files import write_to

    if "nc" in kinds:
        required("h5netcdf")  # now rather than after the work
    radiator, length = source.read_with_wavelength()
    how: dict[str, Any] = {"cone": angle, "power": watts, "sampling": sampling}
    how |= {"directions": directions, "obliquity": obliquity}
    drawn = pw.sample_rays(radiator, length, count, seed, **how)
    with writing(files) as partials:
        if split:
            write_to(drawn, partials, files)
        else:
            for partial, path in zip(partials, files, strict=True):
                write_to(drawn, [partial], [path])
        print(_summary(drawn))


def _formats(formats: Sequence[str], out: str | None) -> list[str]:
    """Formats of the options, else of the suffix of --out, else npz."""
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
