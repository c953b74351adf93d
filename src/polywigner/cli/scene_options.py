"""Options of commands on scenes: the file, the variant, ranges and cluster, and their records."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli import options
from polywigner.errors import ArgumentError, SceneError, value_text
from polywigner.quantities import parse_coordinate

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_NO_SCENES = (".csv", ".wkt", ".geojson", ".json", ".svg", ".dxf", ".gds", ".toml")


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options of one run, as they are recorded; None: the scene's own."""

    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0
    variant: Annotated[
        str | None, "Mitsuba variant (default: the fastest monochromatic one that works)."
    ] = None
    diffraction: Annotated[
        bool,
        "Let shadows of opaque surfaces diffract: all sources and receivers with the "
        "estimator 'exact' (docs/shadows.md).",
    ] = False
    range_text: Annotated[
        str | None, "Sort the power by range as well, such as '0 m to 60 m' (docs/range.md)."
    ] = None
    resumable: options.Resumable = False
    threads: options.Threads = None
    scheduler: options.Scheduler = None
    floor_db: options.DbFloor = -40.0

    def edges(self, bins: int | None, default: int) -> NDArray[np.float64] | None:
        """Return the edges in m of equal bins of a text such as "0 m to 60 m", or None."""
        import numpy as np

        if self.range_text is None:
            if bins is not None:
                raise ArgumentError("--bins: expected with a range of lengths; add a --range")
            return None
        ends = [parse_coordinate(end.strip()) for end in self.range_text.split(" to ")]
        if len(ends) != 2 or not 0 <= ends[0] < ends[1]:
            raise ArgumentError(
                f"expected --range as two rising lengths, got {value_text(self.range_text)}; "
                "write such as '0 m to 60 m'"
            )
        return np.linspace(ends[0], ends[1], (bins or default) + 1)

    @contextmanager
    def parts(self, stem: Path) -> Iterator[Path | None]:
        """Give the store for finished parts of a resumable run, which is removed after it."""
        if not self.resumable and self.scheduler is None:
            yield None
            return
        from polywigner.propagation.stores import require_stores

        require_stores(self.scheduler)
        (store,) = options.targets(stem, (".parts.zarr",))
        yield store
        shutil.rmtree(store, ignore_errors=True)

    def record(self, variant: str) -> dict[str, Any]:
        """Return the settings, the variant and the versions of all programs of a run."""
        from importlib.metadata import version

        from polywigner.toolchain.llvm import prepare

        versions: dict[str, str | None] = {
            name: version(name) for name in ("polywigner", "mitsuba", "drjit", "numpy")
        }
        versions["llvm"] = prepare().version if variant.startswith("llvm_") else None
        versions["python"] = platform.python_version()
        versions["machine"] = f"{platform.system()} {platform.machine()}"
        return {"settings": asdict(self), "used": {"variant": variant}, "versions": versions}


def check_scene_file(scene: str) -> None:
    """Raise SceneError unless a path leads to a scene, before Mitsuba takes its second to load.

    For the file of an aperture it names the command that reads it.
    """
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


def prepare_ranges(variant: str) -> None:
    """Set the variant and load the library for ranges, before scenes that name its integrators."""
    from polywigner.mitsuba.radar.range_film import require_transients
    from polywigner.propagation.stores import required

    for module in ("h5netcdf", "dask"):
        required(module)
    require_transients(variant)
