"""Options that several commands have, and the files that they write: all of them or none."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer

from polywigner.errors import ArgumentError, QuantityError, value_text
from polywigner.interruption import atomic_path, scratch_of
from polywigner.quantities import parse_angle

CONDITIONS = "rayleigh-sommerfeld-1, rayleigh-sommerfeld-2, kirchhoff"
METHODS = f"wigner, {CONDITIONS}, fresnel or fraunhofer"
OBLIQUITIES = f"{CONDITIONS} or paper"
EXACT = "rayleigh-sommerfeld-1"
"""Default method of exact fields."""
FLOOR: dict[str, Any] = {"min": -300.0, "max": -1.0}
DbFloor = Annotated[
    float,
    typer.Option("--db-floor", help="Lowest level of the figure, dB below its peak.", **FLOOR),
]
Out = Annotated[str | None, "Folder, or path without suffix, of the files written (default: here)."]
Threads = Annotated[
    int | None,
    typer.Option(min=1, help="Threads of this machine (default: all), or of each worker."),
]
Resumable = Annotated[
    bool,
    "Write finished parts to NAME.parts.zarr until the result is complete, so that the same "
    "command continues an interrupted run (extra: datasets).",
]
Scheduler = Annotated[
    str | None, "Address of a dask.distributed scheduler that you trust, such as tcp://host:8786."
]


def parse_step(text: str, largest: float, most: int) -> float:
    """Degrees of a step of angles, from a text: up to ``largest``, and not too fine."""
    step = math.degrees(parse_angle(text))
    if not 0 < step <= largest:
        raise ArgumentError(
            f"--step: expected an angle above 0 and up to {largest:g} deg, got {text!r}"
        )
    least = 180 / math.sqrt(most)
    if step < least:
        raise ArgumentError(f"--step: expected {least:.2g} deg or more, got {text!r}")
    return step


def parse_numbers(option: str, text: str, example: str) -> tuple[float, ...]:
    """Parse finite numbers, separated by commas, with or without "dB"."""
    try:
        numbers = tuple(float(part.strip().removesuffix("dB")) for part in text.split(","))
        if all(map(math.isfinite, numbers)):
            return numbers
    except ValueError:
        pass
    raise QuantityError(f"{option}: expected numbers such as {example!r}, got {value_text(text)}")


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


# options whose parameters have other names
_FLAGS = {"formats": "--format", "range_text": "--range", "defined": "--define"}


def _option(name: str, default: Any, kind: Any) -> Parameter:
    """Return an option: a text beside its type is its help, and False by default makes a flag."""
    match get_args(kind):
        case (plain, str(text)):
            flag = [f"--{name.replace('_', '-')}"] if default is False else []
            flag = [_FLAGS[name]] if name in _FLAGS else flag
            kind = Annotated[plain, typer.Option(*flag, help=text)]
    missing = default is MISSING or default is Parameter.empty
    default = Parameter.empty if missing else default
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


_KNOWN_SUFFIXES = (
    ".png", ".exr", ".json", ".npz", ".nc", ".vti", ".vtp", ".zarr",
    ".csv", ".txt", ".ffd", ".cut", ".msi", ".pln", ".dat",
)  # fmt: skip


def output_stem(out: str | None, name: str) -> Path:
    """Return the path, without suffix, of the files a command writes."""
    if out is None:
        return Path(name)
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


def suffixes_of(formats: Sequence[str]) -> tuple[str, ...]:
    """Return the suffixes of the files of values, each once."""
    return tuple(f".{name}" for name in dict.fromkeys(formats))


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
                from polywigner.propagation import stores

                writers = {".nc": stores.write_netcdf, ".vti": stores.write_vti}
                writers.get(partial.suffix, stores.write_zarr)(content, partial)
            else:
                text = json.dumps(content, indent=2, allow_nan=False) + "\n"
                partial.write_text(text, encoding="utf-8")
        if said:
            print(said)
