"""Options that several commands share, and atomic writing of output files."""

from __future__ import annotations

import json
import math
import os
import platform
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import MISSING, asdict, dataclass, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args, get_type_hints

import typer

from polywigner.errors import ArgumentError, QuantityError, SceneError, value_text
from polywigner.interruption import scratch_of
from polywigner.quantities import parse_angle, parse_coordinate

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Content: TypeAlias = Figure | xarray.Dataset | Mapping[str, Any] | Callable[[Path], object]

Text: TypeAlias = str | None
Texts: TypeAlias = list[str] | None
_CONDITIONS = "rayleigh-sommerfeld-1, rayleigh-sommerfeld-2, kirchhoff"
METHOD_HELP = f"wigner, {_CONDITIONS}, fresnel or fraunhofer"
OBLIQUITY_HELP = f"{_CONDITIONS} or paper"
EXACT = "rayleigh-sommerfeld-1"  # default exact method
FLOOR: dict[str, Any] = {"min": -300.0, "max": -1.0}
DbFloor = Annotated[
    float,
    typer.Option("--db-floor", help="Lowest level of the figure in dB below its peak.", **FLOOR),
]
Out = Annotated[Text, "Folder, or path without suffix, of the output files (default: here)."]
Threads = Annotated[
    int | None, typer.Option(min=1, help="Threads of this machine or each worker (default: all).")
]
Bins = Annotated[
    int | None, typer.Option(min=1, max=2**16, help="Bins of --range (render: 64, receive: 256).")
]
Resumable = Annotated[bool, "Continue an interrupted run from NAME.parts.zarr (extra: datasets)."]
Scheduler = Annotated[Text, "Address of a trusted dask scheduler, such as tcp://host:8786."]


def parse_step(text: str, least: float, largest: float) -> float:
    """Convert an angular step such as "0.5 deg" to degrees, and check its limits in degrees."""
    step = math.degrees(parse_angle(text))
    if not (1 - 1e-9) * least <= step <= largest:  # The conversion has rounding errors.
        expected = f"an angle of at least {least:.2g} deg and up to {largest:g} deg"
        raise ArgumentError(f"--step: expected {expected}, got {text!r}")
    return step


def parse_numbers(option: str, text: str, example: str) -> tuple[float, ...]:
    """Return comma-separated finite numbers, each with or without the unit "dB"."""
    try:
        numbers = tuple(float(part.strip().removesuffix("dB")) for part in text.split(","))
        if all(map(math.isfinite, numbers)):
            return numbers
    except ValueError:
        pass
    raise QuantityError(f"{option}: expected numbers such as {example!r}, got {value_text(text)}")


def parse_coefficients(text: str) -> dict[int, float]:
    """Parse the coefficients in --zernike, such as "4: 0.05, 11: 0.1"; keys are Noll indices."""
    try:
        pairs = [part.split(":") for part in text.split(",")]
        numbers = {int(index): float(value) for index, value in pairs}
        if len(numbers) == len(pairs) and all(map(math.isfinite, numbers.values())):
            return numbers
    except ValueError:
        pass
    raise QuantityError(
        "--zernike: expected coefficients with distinct indices, such as '4: 0.05, 11: 0.1', got "
        f"{value_text(text)}"
    )


def with_options(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with one option for each parameter of a function.

    A parameter annotated with a dataclass becomes one option for each field of the dataclass.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    options: list[Parameter] = []
    for name, parameter in signature(function).parameters.items():
        if name in groups:
            kinds = get_type_hints(groups[name], include_extras=True)
            options += [_parameter(f.name, f.default, kinds[f.name]) for f in fields(groups[name])]
        else:
            options.append(_parameter(name, parameter.default, hints[name]))

    @wraps(function)
    def command(**values: Any) -> None:
        """Combine the values of options into dataclasses, and call the function with them."""
        for name, kind in groups.items():
            values[name] = kind(**{part.name: values.pop(part.name) for part in fields(kind)})
        function(**values)

    command.__signature__ = Signature(options)  # type: ignore[attr-defined]
    command.__annotations__ = {option.name: option.annotation for option in options}
    return command


# Options whose names differ from the parameter names.
_FLAGS = {"formats": "--format", "range_text": "--range", "defined": "--define"}


def _parameter(name: str, default: Any, kind: Any) -> Parameter:
    """Return a parameter that Typer converts to a command-line option."""
    match get_args(kind):
        case (plain, str(text)):
            flag = [f"--{name.replace('_', '-')}"] if default is False else []
            flag = [_FLAGS[name]] if name in _FLAGS else flag
            kind = Annotated[plain, typer.Option(*flag, help=text)]
    missing = default is MISSING or default is Parameter.empty
    default = Parameter.empty if missing else default
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


_KNOWN_SUFFIXES = (
    ".png", ".exr", ".json", ".npz", ".nc", ".zarr",
    ".csv", ".txt", ".ffd", ".cut", ".msi", ".pln", ".dat",
)  # fmt: skip


def output_stem(out: str | None, name: str) -> Path:
    """Return the path of the output files without suffix, from --out and a default name.

    If --out is a folder, the default name is appended. A known suffix of --out is removed.
    """
    if out is None:
        return Path(name)
    if not out.strip():
        raise ArgumentError("--out must be a file name or a folder, got an empty string")
    path = Path(out)
    if os.path.isdir(out) or out.endswith(("/", os.sep)):  # noqa: PTH112 (see check_writable)
        return path / name
    return path.with_suffix("") if path.suffix.lower() in _KNOWN_SUFFIXES else path


def targets(stem: Path, suffixes: Sequence[str]) -> tuple[Path, ...]:
    """Return the stem with each suffix appended; dots in the stem are kept."""
    return tuple(stem.with_name(stem.name + suffix) for suffix in suffixes)


def suffixes_of(formats: Sequence[str]) -> tuple[str, ...]:
    """Return file suffixes such as ".csv" for the names of formats, without repetitions."""
    return tuple(f".{name}" for name in dict.fromkeys(formats))


def files_to_write(out: str | None, name: str, suffixes: Sequence[str]) -> tuple[Path, ...]:
    """Return the paths of output files; raise ArgumentError if a file cannot be written."""
    files = targets(output_stem(out, name), suffixes)
    check_writable(files)
    return files


def check_writable(paths: Sequence[Path]) -> None:
    """Raise ArgumentError before the computation if a file cannot be written."""
    for path in paths:
        # pathlib raises OSError for names that are too long; os.path returns False.
        parents = path.absolute().parents
        folder = next(parent for parent in parents if os.path.exists(parent))  # noqa: PTH110
        probe = folder / scratch_of(path).name
        try:
            probe.touch(exist_ok=False)
            probe.unlink()
        except OSError as error:
            raise ArgumentError(
                f"cannot write {path} to the folder {folder}: {error.strerror}; choose another "
                "folder with --out"
            ) from error


def write(paths: Sequence[Path], contents: Sequence[Content], summary: str = "") -> None:
    """Write all files or none, then print ``summary`` and the names of the files.

    Each item of ``contents`` is a figure, a dataset, a mapping for JSON, or a function that writes
    to a path. Missing folders are created.
    """
    from polywigner.geometry.arguments import in_place

    with ExitStack() as stack:
        for path, content in zip(paths, contents, strict=True):
            _write_content(stack.enter_context(in_place(path)), content)
    print(*filter(None, [summary]), *paths, sep="\n", flush=True)


def _write_content(path: Path, content: Any) -> None:
    """Write a figure, a dataset or a mapping to a file, or call a function with the path."""
    if callable(content):
        content(path)
    elif hasattr(content, "savefig"):
        content.savefig(path, format="png")
    elif hasattr(content, "data_vars"):
        from polywigner.propagation import stores

        write = stores.write_zarr if path.suffix == ".zarr" else stores.write_netcdf
        write(content, path)
    else:
        text = json.dumps(content, indent=2, allow_nan=False) + "\n"
        path.write_text(text, encoding="utf-8")


def check_scene(path: str) -> None:
    """Raise SceneError unless a file exists and has the suffix .xml, before Mitsuba is imported."""
    if not os.path.isfile(path):  # noqa: PTH113 (pathlib raises for a name too long)
        raise SceneError(f"the scene file {path!r} does not exist or is not a file")
    if Path(path).suffix.lower() != ".xml":
        raise SceneError(
            f"expected the XML file of a scene, got {path!r}; for apertures and source files, use "
            "other commands such as `polywigner transform`"
        )


@contextmanager
def warnings_of_mitsuba() -> Iterator[None]:
    """Issue Mitsuba's log messages as warnings at the end of the block."""
    from polywigner.mitsuba.plugins.films import collected_log

    with collected_log() as messages:
        yield
    for message in messages:
        warnings.warn(f"Mitsuba: {message}", RuntimeWarning, stacklevel=4)


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options of commands that read scenes; None selects the setting of the scene."""

    scene: Annotated[str, typer.Argument(help="Mitsuba XML file of a scene with a Wigner source.")]
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0
    variant: Annotated[Text, "Mitsuba variant (default: the fastest that works)."] = None
    diffraction: Annotated[bool, "Diffraction at opaque surfaces (docs/shadows.md)."] = False
    range_text: Annotated[Text, "Range bins, such as '0 m to 60 m' (docs/range.md)."] = None
    bins: Bins = None
    resumable: Resumable = False
    threads: Threads = None
    scheduler: Scheduler = None
    floor_db: DbFloor = -40.0

    def edges(self, default_bins: int) -> NDArray[np.float64] | None:
        """Return the edges of the range bins (half path lengths in m), or None without --range."""
        import numpy as np

        if self.range_text is None:
            if self.bins is not None:
                raise ArgumentError(
                    "--bins requires --range; add --range, such as --range '0 m to 60 m'"
                )
            return None
        ends = [parse_coordinate(end.strip()) for end in self.range_text.split(" to ")]
        if len(ends) != 2 or not 0 <= ends[0] < ends[1]:
            raise ArgumentError(
                "expected --range to be two ascending lengths, such as '0 m to 60 m', got "
                f"{value_text(self.range_text)}"
            )
        return np.linspace(ends[0], ends[1], (self.bins or default_bins) + 1)

    @contextmanager
    def running(self, variant: str, file: Path) -> Iterator[Path | None]:
        """Yield the path of the zarr store of a resumable run, or None for other runs.

        The store is next to the output ``file``. After a block without errors, the store is removed
        and Mitsuba's log messages become warnings.
        Raises MissingExtraError if a required library is not installed.
        """
        from polywigner.mitsuba.radar.range_film import require_transients
        from polywigner.propagation.stores import required

        store = None
        if self.resumable or self.scheduler is not None:
            required("zarr", "dask")
            store = file.with_suffix(".parts.zarr")
        with warnings_of_mitsuba():
            if self.range_text is not None:
                required("h5netcdf", "dask")
                require_transients(variant)  # Registers integrators that the scene may use.
            yield store
        if store is not None:
            shutil.rmtree(store, ignore_errors=True)

    def record(self, variant: str) -> dict[str, Any]:
        """Return the settings, the Mitsuba variant and the versions, for a JSON file."""
        from importlib.metadata import version

        from polywigner.llvm import prepare

        versions: dict[str, str | None] = {
            name: version(name) for name in ("polywigner", "mitsuba", "drjit", "numpy")
        }
        versions["llvm"] = prepare().version if variant.startswith("llvm_") else None
        versions["python"] = platform.python_version()
        versions["machine"] = f"{platform.system()} {platform.machine()}"
        return {"settings": asdict(self), "used": {"variant": variant}, "versions": versions}
