"""Power by range: texts to edges of bins, and profiles as tables, records and pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from polywigner.cli.sources import frequency_text, short_name
from polywigner.errors import ArgumentError
from polywigner.quantities import parse_coordinate

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["draw_ranges", "parse_ranges", "prepare_ranges", "ranges_record", "ranges_text"]

_BINS = {"receive": 256, "render": 64}
# Of frames, what write_range_animation draws.
_MOST_BINS = {"receive": 2**16, "render": 2**10}


def parse_ranges(text: str | None, bins: int | None, command: str) -> NDArray[np.float64] | None:
    """Edges in m of bins of one width, of a text such as "0 m to 60 m"; None without one.

    ``command``: "receive" or "render", which have other numbers of bins by default.

    Raises
    ------
    ArgumentError, QuantityError : another text, too few or too many bins, bins without a range.
    """
    import numpy as np

    if text is None:
        if bins is not None:
            raise ArgumentError("expected --bins with --range, got it alone; add a --range")
        return None
    count = _BINS[command] if bins is None else bins
    if not 1 <= count <= _MOST_BINS[command]:
        raise ArgumentError(f"expected --bins from 1 to {_MOST_BINS[command]}, got {count}")
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
    """Set the variant, and load what ranges take; before the scene, which may name its integrators.

    Raises
    ------
    MissingExtraError without it; EngineError for a variant that has no ranges.
    """
    from polywigner.mitsuba.transients import require_transients
    from polywigner.propagation.stores_files import required

    for module in ("xarray", "h5netcdf", "dask"):
        required(module)
    require_transients(variant)


def _of(profile: Any, name: str, receiver: int, count: int) -> Any:
    """Values of one receiver."""
    values = profile[name].values
    return values if count == 1 else values[receiver]


def ranges_record(profile: Any, count: int) -> dict[str, Any]:
    """All of a profile but its powers by emitter, for JSON."""
    names = ("power", "standard_error", "before", "after")
    return {
        "edges_m": profile["range_edge"].values.tolist(),
        "receivers": [
            {f"{name}_w": _of(profile, name, k, count).tolist() for name in names}
            for k in range(count)
        ],
    }


def ranges_text(profile: Any, found: list[Any]) -> str:
    """The strongest bin of each receiver, and what lies outside of all."""
    import numpy as np

    from polywigner.mitsuba.received import dbm_text

    edges = profile["range_edge"].values
    lines = []
    for number, each in enumerate(found):
        power, error, before, after = (
            _of(profile, name, number, len(found))
            for name in ("power", "standard_error", "before", "after")
        )
        k = int(np.argmax(power))
        lines.append(
            f"receiver {each.receiver}: most from {edges[k]:.6g} m to {edges[k + 1]:.6g} m, "
            f"{power[k]:.4g} W +- {error[k]:.4g} W ({dbm_text(float(power[k]))}); "
            f"nearer than all bins {before:.4g} W, farther {after:.4g} W"
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
