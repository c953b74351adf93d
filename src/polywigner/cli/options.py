"""Options that several commands have, each written once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any, get_type_hints

import typer

SourceFile = Annotated[
    str,
    typer.Argument(
        help="Aperture file: GeoJSON, WKT, SVG, DXF, GDSII, or CSV with one ring; or a source "
        "file: TOML or JSON."
    ),
]
Unit = Annotated[
    str | None,
    typer.Option(help="Unit of an aperture file, where it does not say (default: mm)."),
]
Tolerance = Annotated[
    str | None,
    typer.Option(help="Such as '1 um': how far chords may lie from curves (SVG, DXF)."),
]
Layer = Annotated[
    list[str] | None,
    typer.Option(help="Of a drawing: a layer or group to read alone; several times for more."),
]
Union = Annotated[
    bool, typer.Option("--union", help="Join shapes of an aperture file that overlap.")
]
AllowOutside = Annotated[
    bool,
    typer.Option(
        "--allow-outside", help="Read files that a source file names outside of its folder."
    ),
]
Taper = Annotated[
    str | None,
    typer.Option(help="Of the aperture: 'cosine', 'cosine 2 x', 'te10', 'taylor 30 dB 4'."),
]
Array = Annotated[str | None, typer.Option(help="Copies of the aperture, such as '12 x 16, 2 mm'.")]
Window = Annotated[
    str | None,
    typer.Option(help="Of the array: 'taylor 25 dB', 'chebyshev 30 dB', 'hamming'."),
]
Steering = Annotated[
    str | None, typer.Option(help="A beam towards theta, phi, such as '20 deg, 90 deg'.")
]
Focus = Annotated[
    str | None, typer.Option(help="Of the array: a point, such as '0 mm, 0 mm, 80 mm'.")
]
Curved = Annotated[
    str | None,
    typer.Option(
        help="Radius of a curved wave, or one along x and one along y: '60 mm', '60 mm, inf'."
    ),
]
Coherence = Annotated[
    str | None,
    typer.Option(help="Width over which the source is coherent, such as '0.5 mm'."),
]
Bandwidth = Annotated[
    str | None,
    typer.Option(help="Of the light, such as '4 GHz': the mean over a flat band around it."),
]
Frequency = Annotated[str | None, typer.Option(help="Such as '94 GHz'.")]
Wavelength = Annotated[str | None, typer.Option(help="Such as '3.19 mm', instead of --frequency.")]
DbFloor = Annotated[
    float, typer.Option("--db-floor", help="Lowest level of the picture, dB below its peak.")
]
Out = Annotated[
    str | None,
    typer.Option(help="Folder, or path without suffix, of the files written (default: here)."),
]

Order = Annotated[int, typer.Option(help="Of wigner rays: 1, or 3 for cubic lags as well.")]
Obliquity = Annotated[
    str | None,
    typer.Option(
        help="Boundary condition of wigner rays: rayleigh-sommerfeld-1 (default), "
        "rayleigh-sommerfeld-2, kirchhoff, or paper."
    ),
]
BoundaryCondition = Annotated[
    str,
    typer.Option(
        help="Boundary condition: rayleigh-sommerfeld-1, rayleigh-sommerfeld-2, kirchhoff, or "
        "paper."
    ),
]
Accuracy = Annotated[
    float | None,
    typer.Option(help="Relative error allowed, such as 1e-3 (default: each method's)."),
]
Against = Annotated[
    str | None,
    typer.Option(help="Method that the others are compared with (default: the last exact one)."),
]
EngineName = Annotated[str, typer.Option("--engine", help="auto, numpy, llvm or cuda.")]
Precision = Annotated[str | None, typer.Option(help="double (default) or single.")]
Formats = Annotated[
    list[str] | None,
    typer.Option(
        "--format", help="Of the values: nc, zarr, vti; several times for several of them."
    ),
]
Threads = Annotated[
    int | None, typer.Option(help="Of this machine (default: all), or of each worker.")
]
Resumable = Annotated[
    bool,
    typer.Option(
        "--resumable",
        help="Keep finished parts in NAME.parts.zarr until the result is done, so that the "
        "same command goes on after an end before its time (extra: volume).",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Address of a dask.distributed scheduler that you trust, such as tcp://host:8786."
    ),
]


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
    missing = default is MISSING or default is Parameter.empty
    default = Parameter.empty if missing else default
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)
