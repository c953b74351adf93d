"""Paths of the files that a command writes, and their writing: all of them or none."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
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
    """Return the path, without suffix, of the files a command writes."""
    if out is None:
        return Path(name)
    check_text("--out", out)
    path = Path(out)
    if not out.strip() or path.name.lower() in _KNOWN_SUFFIXES:
        raise ArgumentError(
            f"expected --out to name a folder or files, got {out!r}; write a name before the "
            "suffix, or a slash after the folder"
        )
    if os.path.isdir(out) or out.endswith(("/", os.sep)):  # noqa: PTH112 (see check_writable)
        return path / name
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
    """Raise ArgumentError before the long work if one of the files cannot be written."""
    for path in paths:
        # os.path returns False for a name that is too long; pathlib raises OSError.
        if os.path.isdir(path):  # noqa: PTH112
            raise ArgumentError(f"expected --out to name a file, got the folder {path}; rename it")
        parents = path.absolute().parents
        folder = next(parent for parent in parents if os.path.exists(parent))  # noqa: PTH110
        probe = folder / scratch_of(path).name
        try:
            probe.touch(exist_ok=False)
            probe.unlink()
        except OSError as error:
            raise ArgumentError(
                f"expected a folder that can be written to for {path}, got {folder}: "
                f"{error.strerror}; choose another with --out"
            ) from error


@contextmanager
def writing(paths: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Give a scratch path beside each target; rename all of them once the block has ended.

    Missing folders are created. A target may be a folder, as a store is. If the block raises an
    exception, there are no new files, and targets of an earlier run stay unchanged. At the end the
    targets are printed.
    """
    try:
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            partials = tuple(stack.enter_context(atomic_path(path)) for path in paths)
            yield partials
            for partial in partials:
                partial.stat()  # all exist before the first is renamed
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
