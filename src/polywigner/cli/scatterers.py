"""``polywigner scatterers``: a lit scene as a cloud of points, in a file."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from polywigner.cli.options import Define, Seed, Variant
from polywigner.cli.output import files_to_write, write
from polywigner.cli.scenes import check_scene_file, messages_as_warnings, scene_definition
from polywigner.errors import ArgumentError

_SUFFIXES = (".csv", ".vtp", ".nc")


def scatterers(
    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file with a <sensor type='wigner_receiver'> in it.")
    ],
    count: Annotated[int, "Scatterers wanted."] = 20_000,
    seed: Seed = 0,
    receiver: Annotated[str | None, "Id of the receiver (default: the only one)."] = None,
    max_depth: Annotated[
        int | None, "Longest path: 2 is one reflection, -1 no limit (default: the scene's)."
    ] = None,
    rays: Annotated[int | None, "Rays from the receiver (default: four times --count)."] = None,
    velocity: Annotated[
        list[str] | None,
        "ID=VX,VY,VZ in m/s of a shape, an emitter or the receiver; several times for more.",
    ] = None,
    variant: Variant = None,
    define: Define = None,
    out: Annotated[str | None, "File or folder; .csv (default), .vtp for ParaView, or .nc."] = None,
) -> None:
    """Write a receiver's light from a scene as a cloud of scatterers, for radar signal chains.

    Each has a place, a normal, a power in W, the length of its path, the ids of its shape and of
    its emitter, and with --velocity what its path grows by per second.
    """
    check_scene_file(scene)
    defined = dict(scene_definition(text) for text in define or [])
    speeds = dict(_velocity(text) for text in velocity or [])
    suffix = _suffix(out)
    files = files_to_write(out, Path(scene).stem + "_scatterers", (suffix,))

    import polywigner.mitsuba as pm
    from polywigner.mitsuba.scenes import load_file

    chosen = pm.choose_variant(variant)
    with messages_as_warnings():
        loaded = load_file(scene, chosen, None, False, False, defined)
        cloud = pm.scatterers(
            loaded,
            count,
            seed=seed,
            receiver=receiver,
            max_depth=max_depth,
            rays=rays,
            velocities=speeds or None,
        )
    write(files, [partial(pm.write_scatterers, cloud)], _summary(cloud))


def _suffix(out: str | None) -> str:
    """The format that ``--out`` asks for."""
    suffix = "" if out is None or Path(out).is_dir() else Path(out).suffix.lower()
    if suffix in _SUFFIXES:
        return suffix
    if suffix in (".png", ".json", ".txt", ".npz", ".exr", ".vti", ".zarr"):
        raise ArgumentError(f"--out: expected a file of {', '.join(_SUFFIXES)}, got {out!r}")
    return _SUFFIXES[0]


def _velocity(text: str) -> tuple[str, list[float]]:
    name, equals, value = text.partition("=")
    try:
        numbers = [float(part) for part in value.split(",")]
    except ValueError:
        numbers = []
    if not (name and equals and len(numbers) == 3 and all(map(math.isfinite, numbers))):
        raise ArgumentError(
            f"--velocity: expected ID=VX,VY,VZ in m/s, such as car=-8,0,0, got {text!r}"
        )
    return name, numbers


def _summary(cloud: Any) -> str:
    power, path = cloud["power"].values, cloud["path_length"].values
    attrs = cloud.attrs
    total = float(power.sum())
    lines = [
        f"receiver      {attrs['receiver']}",
        f"scatterers    {len(power)} of {attrs['rays']} rays",
        f"power         {total:.4g} W +- {attrs['standard_error']:.2g} W",
    ]
    near = path[path < math.inf]
    if len(near):
        lines.append(f"range         {near.min() / 2:.4g} m to {near.max() / 2:.4g} m")
    return "\n".join(lines)
