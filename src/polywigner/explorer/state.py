"""State of the explorer: outline, illumination and selected point, independent of the page."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

import polywigner as pw
from polywigner import errors
from polywigner.geometry import Aperture, shapes
from polywigner.geometry.arguments import check_most
from polywigner.geometry.io.outlines import nested
from polywigner.geometry.parts import polygons_in
from polywigner.geometry.rings import rings_of_polygon
from polywigner.quantities import parse_frequency, parse_length, wavelength_of

Part = Literal["level", "real", "phase"]
Point = tuple[float, float]
Ring = tuple[Point, ...]
Rings = tuple[Ring, ...]
Source = pw.Aperture | pw.Array

# Number of units per metre.
UNITS: Mapping[str, int] = {"m": 1, "cm": 100, "mm": 1000, "µm": 10**6, "nm": 10**9}
TAPERS = {"uniform": None, "cosine": "cosine_taper", "Taylor 30 dB": "taylor_taper"}
CATALOGUE: Mapping[str, Callable[[], Aperture]] = {
    "chevron": lambda: shapes.chevron(20, 12, 4),
    "square": lambda: shapes.square(10),
    "rectangle": lambda: shapes.rectangle(12, 8),
    "triangle": lambda: shapes.triangle(12, 10),
    "hexagon": lambda: shapes.regular_polygon(6, 6),
    "disc": lambda: shapes.disc(5, 32),
    "ring": lambda: shapes.ring(6, 3, 24),
    "star": lambda: shapes.star(5, 7, 3),
    "two chevrons": lambda: shapes.chevron_pair(20, 12, 4),
    "vee": lambda: shapes.vee(12, 10, 2),
    "u shape": lambda: shapes.u_shape(12, 10, 3),
    "bow tie": lambda: shapes.bow_tie(14, 8, 1),
    "double slit": lambda: shapes.double_slit(2, 12, (-4, 4)),
    "18 hexagons": lambda: shapes.hexagonal_segments(2.5, 0.1),
}
# Largest number of vertices; a transform of 1,000 edges takes several seconds.
MAX_VERTICES = 1000
MAX_ELEMENTS = 256  # largest number of elements of an array


def rings_of(aperture: Aperture, per_metre: float = 1) -> Rings:
    """Return the outlines of an aperture, rounded to a millionth of its diameter.

    The aperture is in metres, and the outlines are in units of 1/``per_metre`` metre, without
    repeated first vertices.
    """
    size = aperture.diameter * per_metre
    digits = max(0, 5 - math.floor(math.log10(size)))
    rings = [np.round(np.asarray(ring) * per_metre, digits) + 0.0 for ring in aperture.rings]
    return tuple(tuple(map(tuple, ring.tolist())) for ring in rings)


_CHEVRON = rings_of(CATALOGUE["chevron"]())


@dataclass(frozen=True)
class State:
    """Aperture, illumination and settings of the views; lengths are in ``unit``."""

    rings: Rings = _CHEVRON  # an outline inside another outline is a hole
    unit: str = "mm"
    wave: str = "94 GHz"  # a frequency or a wavelength
    taper: str = "uniform"  # a key of TAPERS
    theta: float = 0.0  # angle of the steered beam from the normal [degrees]
    phi: float = 0.0  # azimuth of the steered beam and of the first cut of the far field [degrees]
    columns: int = 1
    rows: int = 1
    pitch: float = 12.0  # distance between neighbouring array elements
    x: Point = (0.0, 0.0)  # selected position
    nu: Point = (0.0, 0.0)  # selected spatial frequency [cycles per unit]
    defocus: float = 0.0  # W20 at the farthest vertex [waves]
    distance: float = 50.0  # distance of the near-field plane
    # largest direction cosine on frequency axes; 0 selects eight lobes of the source
    reach: float = 0.0
    part: Part = "level"  # part of the Fourier transform that is displayed

    def __post_init__(self) -> None:
        rings = tuple(tuple((float(x), float(y)) for x, y in ring) for ring in self.rings)
        object.__setattr__(self, "rings", rings)
        remedy = "use the command `polywigner transform`"
        check_most(sum(map(len, rings)), MAX_VERTICES, "vertices on the page", remedy)
        self.wavelength  # noqa: B018 (raises an error if the wave cannot be parsed)

    @property
    def wavelength(self) -> float:
        """Wavelength in metres."""
        with suppress(errors.PolywignerError):
            return wavelength_of(parse_frequency(self.wave))
        with suppress(errors.PolywignerError):
            return parse_length(self.wave)
        raise errors.ArgumentError(
            f"the frequency or wavelength {errors.value_text(self.wave)} cannot be parsed; write "
            'for example "94 GHz" or "3.19 mm"'
        )

    @property
    def per_metre(self) -> int:
        """Number of units of the page per metre."""
        return UNITS[self.unit]

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Bounds (xmin, ymin, xmax, ymax) in the unit of the page; zeros if there are none."""
        points = np.array([p for ring in self.rings for p in ring]).reshape(-1, 2)
        if not len(points):
            return 0.0, 0.0, 0.0, 0.0
        return (*map(float, points.min(0)), *map(float, points.max(0)))  # type: ignore[return-value]

    def with_width(self, width: float) -> State:
        """Return the state with the outlines scaled about their centre to a width in page units.

        Without outlines, and for widths of zero or less, the state is unchanged.
        """
        x0, y0, x1, y1 = self.box
        if not (x1 > x0 and width > 0):
            return self
        factor, centre = width / (x1 - x0), np.array([x0 + x1, y0 + y1]) / 2
        scaled = [(np.array(ring) - centre) * factor + centre for ring in self.rings]
        digits = max(0, 8 - math.floor(math.log10(width)))
        rings = (np.round(ring, digits).tolist() for ring in scaled)
        return replace(self, rings=tuple(tuple(map(tuple, ring)) for ring in rings))


class History:
    """The last 200 states; ``position`` is the index of the current state."""

    def __init__(self, state: State) -> None:
        self.states, self.position, self.gesture = [state], 0, ""

    @property
    def present(self) -> State:
        """Current state."""
        return self.states[self.position]

    def add(self, state: State, gesture: str = "") -> None:
        """Add a state; successive states of a gesture, such as a drag, form one undo step.

        States that were undone are dropped. A state equal to the current state is not added.
        """
        if state == self.present:
            return
        first = self.position + (not gesture or gesture != self.gesture)
        self.states = [*self.states[:first], state][-200:]
        self.position, self.gesture = len(self.states) - 1, gesture

    def can_move(self, steps: int) -> bool:
        """Return whether there is a state ``steps`` steps later (earlier if negative)."""
        return 0 <= self.position + steps < len(self.states)

    def move(self, steps: int) -> None:
        """Move by ``steps`` states (backwards if negative), if there is such a state."""
        if self.can_move(steps):
            self.position, self.gesture = self.position + steps, ""


def with_vertex(rings: Rings, point: Point) -> Rings:
    """Return the outlines with a new vertex, inserted into the nearest edge."""
    edges = [(k, j) for k, ring in enumerate(rings) for j in range(len(ring))]
    if not edges:
        return rings
    lines = [(rings[k][j], rings[k][(j + 1) % len(rings[k])]) for k, j in edges]
    k, j = edges[int(np.argmin(shapely.distance(shapely.linestrings(lines), shapely.Point(point))))]
    return (*rings[:k], (*rings[k][: j + 1], point, *rings[k][j + 1 :]), *rings[k + 1 :])


def rings_of_rows(rows: Sequence[tuple[int, float, float]]) -> Rings:
    """Return the outlines with three or more vertices, from rows (outline index, x, y)."""
    numbers = dict.fromkeys(number for number, _, _ in rows)
    rings = (tuple((x, y) for n, x, y in rows if n == k) for k in numbers)
    return tuple(ring for ring in rings if len(ring) >= 3)


def read_upload(name: str, content: bytes, unit: str) -> Rings:
    """Return the outlines of an uploaded file in ``unit``; raise PolywignerError if it is invalid.

    Files that do not specify a unit are also read in ``unit``.
    """
    with tempfile.TemporaryDirectory(prefix="polywigner-") as folder:
        path = Path(folder) / f"aperture{Path(name).suffix}"
        path.write_bytes(content)
        try:
            aperture = pw.read_aperture(path, unit=unit)
        except errors.PolywignerError as error:
            raise errors.FileFormatError(str(error).replace(str(path), name)) from None
    rings = rings_of(aperture, UNITS[unit])
    State(rings=rings)  # State checks the number of vertices.
    return rings


def geojson(state: State) -> str:
    """Return the aperture as a GeoJSON feature in mm."""
    polygons = aperture_of(state.rings, state.per_metre).polygons
    in_mm = shapely.transform(polygons, lambda metres: np.round(metres * UNITS["mm"], 12))
    properties = {"unit": "mm", "wave": state.wave}
    geometry = shapely.geometry.mapping(in_mm)
    return json.dumps({"type": "Feature", "properties": properties, "geometry": geometry}) + "\n"


@lru_cache(maxsize=64)
def aperture_of(rings: Rings, per_metre: int) -> Aperture:
    """Return the aperture in metres for outlines in units of 1/``per_metre`` metre.

    Raises GeometryError if there are no outlines, or if outlines cross.
    """
    if not rings:
        raise errors.GeometryError("there is no outline; draw an outline or choose a shape")
    polygons = nested([np.array(ring, dtype=np.float64) for ring in rings])
    metres = [[ring / per_metre for ring in polygon] for polygon in polygons]
    return pw.Aperture([shapely.Polygon(exterior, holes) for exterior, *holes in metres])


def source_code(state: State) -> str:
    """Return the Python code, without imports, that builds ``source`` for a state.

    Raises PolywignerError if the outlines are not polygons or the array is too large.
    """
    count = state.columns * state.rows
    check_most(count, MAX_ELEMENTS, "elements of the array", "reduce its rows or columns")
    lines = [f"wavelength = {state.wavelength!r}  # m", "source = pw.Aperture([  # m"]
    for exterior, *holes in polygons_of(aperture_of(state.rings, state.per_metre).polygons):
        inner = f", {[ring.tolist() for ring in holes]}" if holes else ""
        lines.append(f"    shapely.Polygon({exterior.tolist()}{inner}),")
    lines.append("])")
    if state.taper != "uniform":
        lines += [
            "xmin, ymin, xmax, ymax = source.bounds",
            f"taper = pw.{TAPERS[state.taper]}(xmax - xmin, ymax - ymin).moved(source.centre)",
            "source = source.with_illumination(taper)",
        ]
    if state.theta > 0:
        lines += [
            f"theta, phi = np.radians([{state.theta!r}, {state.phi!r}])",
            "beam = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))",
        ]
    if count > 1:
        pitch = state.pitch / state.per_metre
        lines += [f"sites = pw.arrays.grid_positions({state.columns}, {state.rows}, {pitch!r})"]
        weights = "pw.arrays.steering_weights(sites, beam, wavelength)"
        lines += [f"source = pw.phased_array(source, sites, {weights if state.theta else None})"]
    elif state.theta > 0:
        field = "pw.steering(beam, wavelength)" + (" * taper" if state.taper != "uniform" else "")
        lines += [f"source = source.with_illumination({field})"]
    return "\n".join(lines) + "\n"


def run(code: str, **names: Any) -> dict[str, Any]:
    """Run Python code with some variables, and return all variables."""
    variables = {"np": np, "shapely": shapely, "pw": pw, **names}
    exec(code, variables)
    return variables


_variables = lru_cache(maxsize=64)(run)


def variables_of(state: State) -> dict[str, Any]:
    """Return the variables of the code that builds the source; results are cached."""
    return _variables(source_code(state))


def source_of(state: State) -> Source:
    """Return the tapered and steered aperture, or the phased array of such apertures."""
    return variables_of(state)["source"]


def polygons_of(shape: BaseGeometry) -> list[list[NDArray[np.float64]]]:
    """Return polygons as rings (n, 2) without repeated first vertices."""
    return [[ring[:-1] for ring in rings_of_polygon(polygon)] for polygon in polygons_in(shape)]
