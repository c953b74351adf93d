"""Commands on scenes: checks of the file, a bar on long work, versions for records."""

from __future__ import annotations

import os
import platform
import shlex
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polywigner.cli.output import check_text, targets
from polywigner.cli.sources import frequency_text, short_name
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
    from polywigner.mitsuba.films import to_list

    with to_list() as messages:
        yield
    for message in messages:
        warnings.warn(f"Mitsuba: {message}", RuntimeWarning, stacklevel=3)


def store_of_parts(stem: Path, resumable: bool, scheduler: str | None) -> Path | None:
    """Return the path of the store for finished parts; None for a run that is not resumable."""
    if not resumable and scheduler is None:
        return None
    from polywigner.propagation.stores import require_stores

    require_stores(scheduler)
    return targets(stem, (".parts.zarr",))[0]


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
    from polywigner.execution.progress import progress_bar

    with ExitStack() as stack:
        started = cache(lambda total: stack.enter_context(progress_bar(title, total)))
        yield lambda done, total: started(total)()


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


# By default, and at most; of frames, as many as write_range_animation draws.
_BINS = {"receive": (256, 2**16), "render": (64, 2**10)}


def parse_ranges(text: str | None, bins: int | None, command: str) -> NDArray[np.float64] | None:
    """Edges in m of bins of one width, of a text such as "0 m to 60 m"; None without one.

    ``command``: "receive" or "render", which have other numbers of bins by default."""
    import numpy as np

    if text is None:
        if bins is not None:
            raise ArgumentError("expected --bins with --range, got it alone; add a --range")
        return None
    usual, most = _BINS[command]
    count = usual if bins is None else bins
    if not 1 <= count <= most:
        raise ArgumentError(f"expected --bins from 1 to {most}, got {count}")
    ends = text.split(" to ")
    if len(ends) != 2:
        raise ArgumentError(
            f"expected --range as two lengths, got {text!r}; write such as '0 m to 60 m'"
        )
    first, last = (parse_coordinate(end.strip()) for end in ends)
    if not 0 <= first < last:
        raise ArgumentError(
            f"expected --range from zero or more to a larger length, got {text!r}; write such as "
            "'0 m to 60 m'"
        )
    return np.linspace(first, last, count + 1)


def prepare_ranges(variant: str) -> None:
    """Set the variant and load the library for ranges, before scenes that name its integrators."""
    from polywigner.mitsuba.range_film import require_transients
    from polywigner.propagation.stores import required

    for module in ("h5netcdf", "dask"):
        required(module)
    require_transients(variant)


def _by_receiver(profile: Any, count: int) -> list[dict[str, Any]]:
    """Powers in W of each receiver, by name."""
    names = ("power", "standard_error", "before", "after", "direct_power", "scattered_power")
    values = {name: profile[name].values for name in names}
    if count == 1:
        return [values]
    return [{name: each[k] for name, each in values.items()} for k in range(count)]


def ranges_record(profile: Any, count: int) -> dict[str, Any]:
    """All of a profile but its powers by emitter, for JSON."""
    import numpy as np

    edges, paths = profile["range_edge"].values, []
    for index in np.argwhere(np.isfinite(profile["path_range"].values)).tolist():
        *receiver, emitter, path = index
        paths.append(
            {
                "receiver": receiver[0] if receiver else 0,
                "emitter": str(profile["emitter"].values[emitter]),
                "mirrors": str(profile["mirrors"].values[path]),
                "range_m": float(profile["path_range"].values[tuple(index)]),
                "power_w": float(profile["path_power"].values[tuple(index)]),
            }
        )
    return {
        "paths": paths,
        "edges_m": edges.tolist(),
        "receivers": [
            {f"{name}_w": values.tolist() for name, values in one.items()}
            for one in _by_receiver(profile, count)
        ],
    }


def ranges_text(profile: Any, found: list[Any]) -> str:
    """Text of the strongest bin of each receiver, and of the power outside all bins."""
    import numpy as np

    from polywigner.mitsuba.received import dbm_text

    edges = profile["range_edge"].values
    lines = []
    for each, values in zip(found, _by_receiver(profile, len(found)), strict=True):
        power, error, before, after, direct, _ = values.values()
        k = int(np.argmax(power))
        lines.append(
            f"receiver {each.receiver}: most from {edges[k]:.6g} m to {edges[k + 1]:.6g} m, "
            f"{power[k]:.4g} W +- {error[k]:.4g} W ({dbm_text(float(power[k]))}), "
            f"{direct[k]:.4g} W of it direct; nearer than all bins {before:.4g} W, farther "
            f"{after:.4g} W"
        )
    return "\n".join(lines)


def draw_ranges(scene: str, profile: Any, found: list[Any], floor_db: float) -> Any:
    """A panel for each receiver."""
    from polywigner.figures import draw_range_profile
    from polywigner.figures.style import new_figure

    figure = new_figure(6.4, 3.4 * len(found), spacing=0.05)
    panels = figure.subplots(len(found), 1, squeeze=False).ravel()
    for number, (axes, each) in enumerate(zip(panels, found, strict=True)):
        title = f"{short_name(scene)}, receiver {each.receiver}, {frequency_text(each.wavelength)}"
        draw_range_profile(profile, number, floor_db=floor_db, title=title, ax=axes)
    return figure
