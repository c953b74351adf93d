"""Options of commands on scenes: checks of the file, ranges, and versions for records."""

from __future__ import annotations

import os
import platform
import shlex
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from polywigner.cli.output import check_text, targets
from polywigner.errors import ArgumentError, SceneError
from polywigner.quantities import parse_coordinate

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


_NO_SCENES = (".csv", ".wkt", ".geojson", ".json", ".svg", ".dxf", ".gds", ".toml")


def check_scene_file(scene: str) -> None:
    """Raise SceneError unless a path leads to a scene, before Mitsuba takes its second to load.

    For the file of an aperture it names the command that reads it.
    """
    check_text("the scene file", scene)
    if not os.path.isfile(scene):  # noqa: PTH113 (pathlib raises for a name too long)
        raise SceneError(f"expected a Mitsuba scene file, got {scene!r}, which is not a file")
    suffix = Path(scene).suffix.lower()
    if suffix in _NO_SCENES:
        kind = "a source file" if suffix == ".toml" else "an aperture"
        raise SceneError(
            f"expected a scene, which is Mitsuba XML, got {scene!r}, which is {kind}; "
            f"see its transforms by `polywigner transform {shlex.quote(scene)}`, or name it in "
            'the <shape type="wigner"> of a scene'
        )


@contextmanager
def messages_as_warnings() -> Iterator[None]:
    """Within, messages of Mitsuba are collected; they are warnings at the end of the block."""
    from polywigner.mitsuba.plugins.films import to_list

    with to_list() as messages:
        yield
    for message in messages:
        warnings.warn(f"Mitsuba: {message}", RuntimeWarning, stacklevel=3)


def store_of_parts(stem: Path, resumable: bool, scheduler: str | None) -> Path | None:
    """The store for finished parts of a run that goes on after its end; None of other runs."""
    if not resumable and scheduler is None:
        return None
    from polywigner.propagation.stores import require_stores

    require_stores(scheduler)
    return targets(stem, (".parts.zarr",))[0]


def versions_of(variant: str) -> dict[str, str | None]:
    """Versions of all programs that take part in a render, for records."""
    from importlib.metadata import version

    from polywigner.toolchain.llvm import prepare

    packages = ("polywigner", "mitsuba", "drjit", "numpy")
    found: dict[str, str | None] = {name: version(name) for name in packages}
    found["llvm"] = prepare().version if variant.startswith("llvm_") else None
    found["python"] = platform.python_version()
    found["machine"] = f"{platform.system()} {platform.machine()}"
    return found


def parse_ranges(text: str | None, bins: int | None, default: int) -> NDArray[np.float64] | None:
    """Return the edges in m of equal bins of a text such as "0 m to 60 m", or None."""
    import numpy as np

    if text is None:
        if bins is not None:
            raise ArgumentError("--bins: expected with a range of lengths; add a --range")
        return None
    ends = [parse_coordinate(end.strip()) for end in text.split(" to ")]
    if len(ends) != 2 or not 0 <= ends[0] < ends[1]:
        raise ArgumentError(
            f"expected --range as two rising lengths, got {text!r}; write such as '0 m to 60 m'"
        )
    return np.linspace(ends[0], ends[1], (bins or default) + 1)


def prepare_ranges(variant: str) -> None:
    """Set the variant and load the library for ranges, before scenes that name its integrators."""
    from polywigner.mitsuba.radar.range_film import require_transients
    from polywigner.propagation.stores import required

    for module in ("h5netcdf", "dask"):
        required(module)
    require_transients(variant)
