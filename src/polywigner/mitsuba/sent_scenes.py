"""Scene files that workers of a cluster load anew, after a check that they have the same ones."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from polywigner.errors import SceneError, StoreError
from polywigner.mitsuba.given import is_key, register_source, registered_source
from polywigner.mitsuba.scene_files import digest_of_file, digests_of
from polywigner.mitsuba.scenes import choose_variant, load_scene
from polywigner.propagation.stores import one_run, source_settings
from polywigner.propagation.stores_checks import with_digest

__all__ = ["SceneFile", "SentScene", "check_is_whole", "remove_store"]


@dataclass(frozen=True)
class SceneFile:
    """What a scene is loaded from, here or by a worker."""

    path: Path
    variant: str
    sampler: str | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def load(self) -> Any:
        """The ``mi.Scene``; raises what :func:`load_scene` does."""
        return load_scene(self.path, self.variant, self.sampler, **self.parameters)


class SentScene:
    """A scene file, with all that tells whether a worker has the same."""

    def __init__(self, file: SceneFile) -> None:
        self.file = replace(file, path=file.path.absolute(), parameters=dict(file.parameters))
        self.digests, self.sources = _digests(file), _sources(file)
        self.mitsuba = _version()

    def load(self) -> Any:
        """The scene, on a worker."""
        choose_variant(self.file.variant)
        for source in self.sources:
            register_source(source)
        return self.file.load()

    def check(self) -> None:
        """Raises StoreError where this process has another Mitsuba, or other files."""
        where = platform.node()
        if _version() != self.mitsuba:
            raise StoreError(
                f"expected mitsuba {self.mitsuba} on every worker, got {_version()} on {where}; "
                "install the same everywhere"
            )
        for path, digest in self.digests.items():
            found = digest_of_file(Path(path)) if Path(path).is_file() else None
            if found != digest:
                raise StoreError(
                    f"expected every worker to see the scene's file {path}, got "
                    f"{'none' if found is None else 'another one'} on {where}; put the scene's "
                    "folder on a file system that all workers share"
                )

    def settings(self) -> dict[str, Any]:
        """All that values of this scene depend on, but for how they are rendered."""
        folder = self.file.path.resolve().parent
        named = {os.path.relpath(path, folder): digest for path, digest in self.digests.items()}
        told = [with_digest(source_settings(source)) for source in self.sources]
        return {
            "mitsuba": self.mitsuba,
            "variant": self.file.variant,
            "sampler": self.file.sampler,
            "parameters": {name: str(value) for name, value in self.file.parameters.items()},
            **{f"file {name}": digest for name, digest in named.items()},
            **{f"source {k}": source["source_sha256"] for k, source in enumerate(told)},
        }


def check_is_whole(integrator: Any) -> None:
    """StoreError for a render that ended before its time.

    Mitsuba answers Ctrl-C itself, by giving back what it has.
    """
    if integrator.should_stop():
        raise StoreError(
            "expected a part that is rendered to its end, got one that Ctrl-C or a timeout of "
            "the integrator has cut short; start the same run again, without a timeout"
        )


def remove_store(path: str | Path) -> None:
    """Remove a store of parts whose result is done, unless another run goes on with it."""
    with suppress(StoreError), one_run(Path(path)):
        shutil.rmtree(path, ignore_errors=True)


def _digests(file: SceneFile) -> dict[str, str]:
    try:
        return digests_of(file.path, file.parameters)
    except OSError as error:
        raise SceneError(f"expected to read the files of {file.path}, got: {error}") from error


def _sources(file: SceneFile) -> list[Any]:
    """Sources in this process's memory whose keys the parameters hold."""
    texts = [value for value in file.parameters.values() if isinstance(value, str)]
    return [registered_source(text) for text in texts if is_key(text)]


def _version() -> str:
    return importlib.metadata.version("mitsuba")
