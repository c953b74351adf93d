"""Options that several commands have, each written once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from enum import StrEnum
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any, get_args, get_type_hints

import typer

from polywigner.errors import ArgumentError
from polywigner.quantities import parse_angle

Unit = Annotated[str | None, "Unit of an aperture file, where it does not say (default: mm)."]
Tolerance = Annotated[
    str | None, "Largest distance of chords from curves (SVG, DXF), such as '1 um'."
]
Layer = Annotated[
    list[str] | None, "Layer or group of a drawing to read alone; several times for more."
]
Union = Annotated[bool, "Join shapes of an aperture file that overlap."]
Bandwidth = Annotated[str | None, "Width of a flat band of light to average over, such as '4 GHz'."]
Frequency = Annotated[str | None, "Frequency, such as '94 GHz'."]
Wavelength = Annotated[str | None, "Wavelength, such as '3.19 mm', instead of --frequency."]
_FLOOR: dict[str, Any] = {"min": -300.0, "max": -1.0}
DbFloor = Annotated[
    float,
    typer.Option("--db-floor", help="Lowest level of the figure, dB below its peak.", **_FLOOR),
]
DbFloorOfFields = Annotated[
    float | None,
    typer.Option(
        "--db-floor",
        help="Lowest level of the figure, dB below its peak (default: -40; on planes, the level "
        "below which 1 % of the power lies).",
        **_FLOOR,
    ),
]
Out = Annotated[str | None, "Folder, or path without suffix, of the files written (default: here)."]

Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]
Variant = Annotated[
    str | None, "Mitsuba variant (default: the fastest monochromatic one that works)."
]
Diffraction = Annotated[
    bool,
    "Let shadows of opaque surfaces diffract: all sources and receivers with the "
    "estimator 'exact' (docs/shadows.md).",
]
Define = Annotated[
    list[str] | None,
    typer.Option(
        "--define", help="NAME=VALUE of a $parameter of the scene; several times for more."
    ),
]
Obliquity = Annotated[
    str | None,
    "Boundary condition of wigner rays: rayleigh-sommerfeld-1 (default), "
    "rayleigh-sommerfeld-2, kirchhoff, or paper.",
]
BoundaryCondition = Annotated[
    str, "Boundary condition: rayleigh-sommerfeld-1, rayleigh-sommerfeld-2, kirchhoff, or paper."
]
Accuracy = Annotated[float | None, "Relative error allowed, such as 1e-3 (default: each method's)."]
Against = Annotated[
    str | None, "Method that the others are compared with (default: the last exact one)."
]
EngineName = Annotated[str, typer.Option("--engine", help="auto, numpy, llvm or cuda.")]
Precision = Annotated[str | None, "double (default) or single."]
FieldFormat = StrEnum("FieldFormat", "nc zarr vti")
Formats = Annotated[
    list[FieldFormat] | None,
    typer.Option(
        "--format", help="Format of the values: nc, zarr, vti; several times for several of them."
    ),
]
Threads = Annotated[
    int | None,
    typer.Option(min=1, help="Threads of this machine (default: all), or of each worker."),
]
Resumable = Annotated[
    bool,
    "Write finished parts to NAME.parts.zarr until the result is complete, so that the same "
    "command continues an interrupted run (extra: datasets).",
]
Scheduler = Annotated[
    str | None, "Address of a dask.distributed scheduler that you trust, such as tcp://host:8786."
]


def parse_step(text: str, largest: float, most: int) -> float:
    """Degrees of a step of angles, from a text: up to ``largest``, and not too fine."""
    step = math.degrees(parse_angle(text))
    if not 0 < step <= largest:
        raise ArgumentError(
            f"--step: expected an angle above 0 and up to {largest:g} deg, got {text!r}"
        )
    least = 180 / math.sqrt(most)
    if step < least:
        raise ArgumentError(f"--step: expected {least:.2g} deg or more, got {text!r}")
    return step


def with_options(function: Callable[..., Any]) -> Callable[..., None]:
    """Return a command whose options are the function's own and the fields of its dataclasses.

    A parameter that is annotated by a dataclass stands for an option for each of its fields, as
    they are annotated and with their defaults; the function gets the dataclass made of them.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    options: list[Parameter] = []
    for name, own in signature(function).parameters.items():
        if name in groups:
            kinds = get_type_hints(groups[name], include_extras=True)
            options += [_option(f.name, f.default, kinds[f.name]) for f in fields(groups[name])]
        else:
            options.append(_option(name, own.default, hints[name]))

    @wraps(function)
    def command(**given: Any) -> None:
        made = {
            name: kind(**{part.name: given.pop(part.name) for part in fields(kind)})
            for name, kind in groups.items()
        }
        function(**made, **given)

    command.__signature__ = Signature(options)  # type: ignore[attr-defined]
    command.__annotations__ = {option.name: option.annotation for option in options}
    return command


def _option(name: str, default: Any, kind: Any) -> Parameter:
    """Return an option: a text beside its type is its help, and False by default makes a flag."""
    match get_args(kind):
        case (plain, str(text)):
            flag = [f"--{name.replace('_', '-')}"] if default is False else []
            kind = Annotated[plain, typer.Option(*flag, help=text)]
    missing = default is MISSING or default is Parameter.empty
    default = Parameter.empty if missing else default
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)
