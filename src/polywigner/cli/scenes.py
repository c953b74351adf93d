"""What commands on scenes share: checks of the file, a bar on long work, versions for records."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from polywigner.cli.output import check_text
from polywigner.errors import ArgumentError, SceneError

__all__ = [
    "check_is_file",
    "check_is_no_aperture",
    "check_samples",
    "check_threads",
    "counted_bar",
    "scene_definition",
    "versions_of",
]

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


def check_samples(spp: int | None, seed: int) -> None:
    """Raise ArgumentError for less than one sample, and for a seed below zero."""
    if spp is not None and spp < 1:
        raise ArgumentError(f"expected --spp of at least 1, got {spp}")
    if seed < 0:
        raise ArgumentError(f"expected --seed of zero or more, got {seed}")


def check_threads(threads: int | None) -> None:
    """Raise ArgumentError for a number of threads that no machine has."""
    if threads is not None:
        from polywigner.execution import MOST_THREADS
        from polywigner.geometry.arguments import checked_count

        checked_count(threads, "--threads", 1, MOST_THREADS)


def scene_definition(text: str) -> tuple[str, str]:
    """Name and value of ``--define``; ArgumentError for other texts."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise ArgumentError(
            f"expected --define as NAME=VALUE of a $parameter of the scene, got {text!r}"
        )
    return name, value


@contextmanager
def counted_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A function to call after each part with the numbers of parts done, and of all of them.

    From the first one on there is a bar on a terminal, and nothing elsewhere.
    """
    from polywigner.radiometry.progress import progress_bar

    with ExitStack() as stack:
        bars: list[Callable[..., None]] = []

        def tell(done: int, total: int) -> None:
            if not bars:
                bars.append(stack.enter_context(progress_bar(title, total)))
            bars[0]()

        yield tell


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
