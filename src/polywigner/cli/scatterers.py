"""``polywigner scatterers``: a lit scene as a cloud of points, in a file."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

from polywigner.cli.output import check_writable, output_stem, targets, writing
from polywigner.cli.scenes import check_is_file, check_is_no_aperture, scene_definition
from polywigner.errors import ArgumentError

__all__ = ["run_scatterers"]

_SUFFIXES = (".csv", ".vtp", ".nc")


def run_scatterers(
    scene: str,
    *,
    count: int,
    seed: int,
    receiver: str | None,
    max_depth: int | None,
    rays: int | None,
    velocities: list[str],
    variant: str | None,
    define: list[str],
    out: str | None,
) -> None:
    """Write the cloud; print what it holds and the file's path.

    Raises
    ------
    PolywignerError : input that cannot be used; nothing is written then.
    """
    check_is_file(scene)
    defined = dict(scene_definition(text) for text in define)
    speeds = dict(_velocity(text) for text in velocities)
    suffix = _suffix(out)
    (file,) = targets(output_stem(out, Path(scene).stem + "_scatterers"), (suffix,))
    check_writable([file])
    check_is_no_aperture(scene)

    from polywigner.mitsuba import choose_variant, load_scene, scatterers, write_scatterers
    from polywigner.mitsuba.images import to_list

    chosen = choose_variant(variant)
    with to_list() as messages:
        loaded = load_scene(scene, chosen, merge=False, **defined)
        cloud = scatterers(
            loaded,
            count,
            seed=seed,
            receiver=receiver,
            max_depth=max_depth,
            rays=rays,
            velocities=speeds or None,
        )
    for message in messages:
        warnings.warn(f"Mitsuba: {message}", RuntimeWarning, stacklevel=2)
    with writing([file]) as (partial,):
        named = partial.with_name(partial.name + suffix)
        write_scatterers(cloud, named)
        named.replace(partial)
    print(_summary(cloud))
    print(file)


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
