"""What commands on scenes share: checks of the file, a bar on long work, versions for records."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from polywigner.cli.output import check_text
from polywigner.errors import SceneError

__all__ = ["check_is_file", "check_is_no_aperture", "progress_bar", "versions_of"]

_NO_SCENES = (".csv", ".wkt", ".geojson", ".json", ".svg", ".dxf", ".gds", ".toml")


def check_is_file(scene: str) -> None:
    """Raise SceneError for what is no file, before Mitsuba takes its second to load."""
    check_text("the scene file", scene)
    if not os.path.isfile(scene):  # noqa: PTH113 (pathlib raises for a name too long)
        raise SceneError(f"expected a Mitsuba scene file, got {scene!r}, which is not a file")


def check_is_no_aperture(scene: str) -> None:
    """Raise SceneError for the file of an aperture, and name what reads it."""
    suffix = Path(scene).suffix.lower()
    if suffix in _NO_SCENES:
        kind = "a source file" if suffix == ".toml" else "an aperture"
        raise SceneError(
            f"expected a scene, which is Mitsuba XML, got {scene!r}, which is {kind}; "
            f"see its transforms by `polywigner transform {shlex.quote(scene)}`, or name it in "
            'the <shape type="wigner"> of a scene'
        )


@contextmanager
def progress_bar() -> Iterator[Callable[[int, int], None]]:
    """A function to call after each part: moves a bar on a terminal, does nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("rendering"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def versions_of(variant: str) -> dict[str, str | None]:
    """Of all that takes part in a render, for records."""
    from importlib.metadata import version

    from polywigner.toolchain.llvm import prepare

    packages = ("polywigner", "mitsuba", "drjit", "numpy")
    found: dict[str, str | None] = {name: version(name) for name in packages}
    found["llvm"] = prepare().version if variant.startswith("llvm_") else None
    found["python"] = platform.python_version()
    found["machine"] = f"{platform.system()} {platform.machine()}"
    return found
