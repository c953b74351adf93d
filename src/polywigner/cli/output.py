"""Where a command writes, and how: whole files or none."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from polywigner.errors import ArgumentError
from polywigner.interruption import atomic_path, scratch_of

_KNOWN_SUFFIXES = (
    ".png", ".exr", ".json", ".npz", ".nc", ".vti", ".vtp", ".zarr",
    ".csv", ".txt", ".ffd", ".cut", ".msi", ".pln", ".dat",
)  # fmt: skip


def check_text(name: str, path: str) -> None:
    """Refuse a path that is not text: figures and Mitsuba cannot be told of it."""
    whole = os.path.abspath(path)  # noqa: PTH100 (a pathlib path would not drop the "..")
    try:
        whole.encode()
    except UnicodeEncodeError:
        raise ArgumentError(
            f"expected {name} to be a path in UTF-8, got {whole!a}; rename it"
        ) from None


def output_stem(out: str | None, name: str) -> Path:
    """The path, without suffix, of the files a command writes."""
    if out is None:
        return Path(name)
    if not out.strip():
        raise ArgumentError(
            "expected --out to name a folder or files, got nothing; leave it out to write here"
        )
    check_text("--out", out)
    path = Path(out)
    if os.path.isdir(out) or out.endswith(("/", os.sep)):  # noqa: PTH112 (see check_writable)
        return path / name
    if path.name.lower() in _KNOWN_SUFFIXES:
        raise ArgumentError(
            f"expected --out to name a folder or files, got {out!r}, a suffix alone; write a name "
            "before it, or a slash after the folder"
        )
    return path.with_suffix("") if path.suffix.lower() in _KNOWN_SUFFIXES else path


def targets(stem: Path, suffixes: Sequence[str]) -> tuple[Path, ...]:
    """``stem`` with each of the suffixes (dots in the stem's own name are kept)."""
    return tuple(stem.with_name(stem.name + suffix) for suffix in suffixes)


def files_to_write(out: str | None, name: str, suffixes: Sequence[str]) -> tuple[Path, ...]:
    """Return the files of :func:`output_stem` with each suffix, which can be written."""
    files = targets(output_stem(out, name), suffixes)
    check_writable(files)
    return files


def check_writable(paths: Sequence[Path]) -> None:
    """Fail before the long work rather than after it."""
    for path in paths:
        # In os.path a name that is too long is no folder; in pathlib it raises.
        if os.path.isdir(path):  # noqa: PTH112
            raise ArgumentError(f"expected --out to name a file, got the folder {path}; rename it")
        absolute = path.absolute()
        parents = absolute.parents
        folder = next(parent for parent in parents if os.path.exists(parent))  # noqa: PTH110
        try:
            _try_to_write(scratch_of(absolute), folder)
        except OSError as error:
            raise ArgumentError(
                f"expected a folder that can be written to for {path}, got {folder}: "
                f"{error.strerror}; choose another with --out"
            ) from error


def _try_to_write(scratch: Path, folder: Path) -> None:
    """Make and remove a file in the folder, the first one there is above ``scratch``."""
    for path in (scratch, *(folder / part for part in scratch.relative_to(folder).parts)):
        with suppress(FileNotFoundError):
            path.lstat()  # a path, or a part of it, may be too long
    probe = folder / scratch.name
    probe.touch(exist_ok=False)
    probe.unlink()


def missing_folders(paths: Sequence[Path]) -> list[Path]:
    """The folders of these files that are not there yet."""
    return [folder for folder in {path.parent: None for path in paths} if not folder.is_dir()]


def say_made(folders: Sequence[Path]) -> None:
    """Name folders that were made, on stderr."""
    for folder in folders:
        sys.stderr.write(f"polywigner: made the folder {folder}\n")


@contextmanager
def writing(paths: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Give a scratch path beside each target; put all of them in place once the block is done.

    Folders are created, and named on stderr. A target may be a folder itself, as stores are. A
    block that raises leaves neither targets nor scratch files; targets of an earlier run stay as
    they were. The targets are printed at last."""
    try:
        new = missing_folders(paths)
        for folder in new:
            folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            partials = tuple(stack.enter_context(atomic_path(path)) for path in paths)
            yield partials
            for partial in partials:
                partial.stat()  # all are there before the first takes its place
        say_made(new)
        print(*paths, sep="\n", flush=True)
    except OSError as error:
        raise ArgumentError(
            f"expected to write {', '.join(map(str, paths))}, got {error}; "
            "choose another place with --out"
        ) from error


def write(paths: Sequence[Path], contents: Sequence[Any], said: str = "") -> None:
    """Write all of the files, or none, and print ``said`` before their names.

    A content is a figure, a dataset (in memory or on disk), a record for JSON, or a function that
    takes the path.
    """
    with writing(paths) as partials:
        for partial, content in zip(partials, contents, strict=True):
            if callable(content):
                content(partial)
            elif hasattr(content, "savefig"):
                content.savefig(partial, format="png")
            elif hasattr(content, "data_vars"):
                from polywigner.propagation import exports

                writers = {".nc": exports.write_netcdf, ".vti": exports.write_vti}
                writers.get(partial.suffix, exports.write_zarr)(content, partial)
            else:
                text = json.dumps(content, indent=2, allow_nan=False) + "\n"
                partial.write_text(text, encoding="utf-8")
        if said:
            print(said)


def write_arrays(path: Path, arrays: Mapping[str, Any], metadata: Mapping[str, Any]) -> None:
    """Write arrays as .npz under their names, and a JSON text ``metadata`` with their units."""
    import numpy as np

    import polywigner as pw

    about = json.dumps({**metadata, "polywigner": pw.__version__})
    with path.open("wb") as file:
        np.savez_compressed(file, **dict(arrays), metadata=np.asarray(about))
