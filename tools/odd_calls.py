#!/usr/bin/env python3
"""Odd values for every argument of all public functions: a result, or one error of the package.

    python tools/odd_calls.py [--count N] [--seed S] [--only TEXT]
    python tools/odd_calls.py --each [--only TEXT]       every argument with every odd value

The functions are those of tools/public_names.py, methods and constructors included. Each call is a
plain one in which one or two arguments are replaced by chance, or one after the other. It runs in a
process that is begun anew when it dies; an exception that is not the package's own (TypeError for a
wrong number of arguments is Python's), a warning of NumPy's or the end of the process is a fault.
Prints counts by outcome, the longest call and the largest memory; the exit status is 1 if there was
a fault.
"""

from __future__ import annotations

import argparse
import functools
import inspect
import multiprocessing
import os
import pickle
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import datetime
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.errors import PolywignerError, PolywignerWarning
from public_names import MODULES, OPERATORS, module_of

COUNT, BATCH = 10_000, 200
LONGEST = 60.0
"""Seconds for a call, on a machine that does other work as well."""

MEMORY = 8 << 30
"""Bytes of address space beyond which a call is a fault; the kernels' compiler takes some."""

SQUARE, SLITS = pw.shapes.square(0.01), pw.Slits([[0.0, 0.01]])
ARRAY = pw.phased_array(SQUARE, [[0.0, 0.0], [0.02, 0.0]])
X, NU, XYZ = np.zeros((3, 2)), np.full((3, 2), 40.0), np.full((3, 3), 0.1)
FACING = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.2], [0, 0, 0, 1]]
CUBE = pw.Polyhedron(
    [[x, y, z] for x in (0, 0.01) for y in (0, 0.01) for z in (0, 0.01)],
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]],
)

PLAIN: dict[str, Any] = {
    "a": 0.01, "angle": 0.3, "aperture": SQUARE, "array": ARRAY, "azimuth": [0.0, 0.1],
    "amplitudes": [1.0], "base": 0.01, "body": CUBE,
    "b": 0.02, "bounds": [[-0.01, -0.01], [0.01, 0.01]],
    "box": [[-0.01, -0.01, 0.1], [0.01, 0.01, 0.2]], "coefficients": [0.2], "count": 4,
    "counts": [4], "direction": [0.3, 0.1], "element": SQUARE, "elements": [SQUARE],
    "elevation": [0.0], "ends": [[0, 0, 0.1], [0, 0, 0.2]], "f": 0.5, "factor": 2.0,
    "faces": [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], "fill": 0.5, "flat_to_flat": 0.01,
    "floor_db": -40.0, "focal_length": 0.1, "frequencies": [[0.0, 0.0]], "frequency": 5.0,
    "height": 0.01, "illumination": pw.cosine_taper(0.01, 0.01), "inner": 0.005,
    "condenser": pw.shapes.square(1e-3), "distance": 0.01, "mask": pw.shapes.square(2e-6),
    "period": [6e-6, 6e-6], "polarisation": "x", "pupil": pw.shapes.square(5e-3),
    "receive": [[0.0, 0.0]], "transmit": [[0.0, 0.0]], "xi_1": [1e-3, 0.0], "xi_2": [0.0, 1e-3],
    "stokes": np.ones((4, 3, 3)),
    "intervals": [[0.0, 0.01]], "lit_by": pw.PointSource([0.0, 0.0, -0.1]), "m": 2.0,
    "matrix": [[1.0, 0.1], [0.0, 1.0]], "n": 6, "nu": NU, "nx": 2, "offsets": [-0.01, 0.01],
    "ny": 2, "order": 0.5, "other": SQUARE, "outer": 0.01, "outline": SQUARE,
    "length": 0.01, "phi": [0.0, 0.5],
    "pitch": 0.02, "pitch_x": 0.02, "plane": 0.1, "point": [0.0, 0.0, 0.1], "points": XYZ,
    "position": [0.0, 0.0, -0.1], "positions": [[0.0, 0.0], [0.05, 0.0]], "radii": [0.02],
    "radius": 0.01, "radius_x": 0.1, "radius_y": 0.1, "ranges": [0.0, 0.5, 1.0],
    "receiver": SQUARE, "reference": 1.0, "ring": [[0, 0], [1, 0], [0, 1]], "s": [0.0, 0.1],
    "samples": 8, "seed": 0, "shape": (3, 3), "shift": [0.1, 0.0], "source": SQUARE,
    "theta": [0.0, 0.2], "thickness": 0.002, "to_radar": [0.0, 0.0, 1.0],
    "to_transmitter": FACING, "to_world": FACING, "transmitter": SQUARE, "upsilon": NU,
    "upsilon_x": [0.0, 1.0], "upsilon_y": [0.0], "values": np.ones((3, 3)),
    "vertices": [[0, 0], [1, 0], [0, 1]], "wavelength": 0.003, "weights": [1.0, 1.0],
    "where": [[-0.01, -0.01, 0.1], [0.01, 0.01, 0.1]], "width": 0.01, "widths": [0.004, 0.004],
    "window": "taylor", "x": X, "xi": X, "y": [0.0], "nu_x": [0.0, 1.0], "nu_y": [0.0],
    "xi_x": [0.0, 1.0], "xi_y": [0.0], "z": 0.1,
}  # fmt: skip
"""Values for arguments without a default, by the argument's name."""

SPECIAL: dict[str, dict[str, Any]] = {
    "polywigner.Aperture.__sub__": {"other": SQUARE.moved([0.005, 0.0])},
    "polywigner.differentiable": {"source": SQUARE},
    "polywigner.fourier_taper": {"coefficients": [0.1, 1.0, 0.1]},
    "polywigner.mtf": {"frequency": X},
    "polywigner.suggest_sampling": {"wavelength": 0.003},
    "polywigner.rays.rebuild": {"bounds": (-0.01, -0.01, 0.01, 0.01)},
    "polywigner.Array.__init__": {"elements": [SQUARE, SQUARE.moved([0.02, 0.0])]},
    "polywigner.testing.check": {"points": 8},
    "polywigner.FirstOrder.rays": {"x": [0.0, 0.1]},
    "polywigner.Illumination.__add__": {"other": pw.uniform()},
    "polywigner.Illumination.__sub__": {"other": pw.uniform()},
    "polywigner.PlaneWave.__init__": {"direction": [0.0, 0.0, 1.0]},
    "polywigner.Polyhedron.__init__": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]},
    "polywigner.Slits.moved": {"shift": 0.1},
    "polywigner.Slits.with_illumination": {"illumination": pw.cosine_taper(0.01, dimension=1)},
    "polywigner.Wavefront.on": {"source": SQUARE},
    "polywigner.array_factor": {"weights": None},
    "polywigner.fit_illumination": {"points": X[:, :2] + np.eye(3, 2), "values": [1.0, 1.0, 1.0]},
    "polywigner.flux_vector": {"x": X},
    "polywigner.hemisphere": {"radius": 0.2, "theta": [0.1, 0.2], "phi": [0.0, 1.0]},
    "polywigner.lag_slice": {"x": [0.0, 0.0]},
    "polywigner.position_slice": {"xi": [0.0, 0.0]},
    "polywigner.partially_coherent_image": {"wavelength": 550e-9, "points": X},
    "polywigner.segmented_pupil": {"pupil": [SQUARE]},
    "polywigner.psf": {"points": X},
    "polywigner.radiance": {"direction": [0.0, 0.0, 1.0]},
    "polywigner.radiant_intensity": {"direction": [0.0, 0.0, 1.0]},
    "polywigner.rcs": {"wavelength": 0.003},
    "polywigner.volume": {"shape": (2, 2, 2)},
    "polywigner.wigner_table": {"x": [0.0, 0.001]},
    "polywigner.shapes.hexagonal_segments": {},
    "polywigner.shapes.star": {"points": 5},
    "polywigner.shapes.slit_pair": {"offsets": [-0.01, 0.01]},
    "polywigner.rays.traced": {"position": np.zeros((4, 3)), "direction": [[0.0, 0.0, 1.0]] * 4},
    "polywigner.figures.draw_arrivals": {"power": np.ones((4, 4))},
    "polywigner.figures.draw_scene": {"radiance": np.ones((3, 3))},
    "polywigner.figures.level_db": {"values": [1.0, 0.5]},
    "polywigner.figures.picture_peak": {"values": np.ones((4, 4))},
    "polywigner.mitsuba.received_power": {"spp": 16},
    "polywigner.mitsuba.received_powers": {"spp": 16},
    "polywigner.mitsuba.range_profile": {"spp": 16},
    "polywigner.mitsuba.range_frames": {"spp": 4},
    "polywigner.mitsuba.render": {"spp": 4},
    "polywigner.mitsuba.render_file": {"spp": 4},
}  # fmt: skip
"""Values of arguments in which a function differs from `PLAIN`, or that keep it short."""

RECORDS = {
    "AxisSampling", "BeamMetrics", "CutMetrics", "EnergyBudget", "Sampling", "Contribution",
    "DirectPath", "ReceivedPower", "SystemSlices", "TransformSlices", "DirectArrival",
}  # fmt: skip
"""Classes of results, which the package makes and users read."""

CONTEXTS = {"exclusive", "receiving", "translate_error"}
"""Functions that do nothing until a block ends, or that take exceptions."""

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
OUT = Path("written")


@functools.cache
def small_scene(name: str) -> Path:
    """File of an example's scene with a picture of 8 x 8 pixels of signed rays."""
    text = next((EXAMPLES / name).glob("*.xml")).read_text(encoding="utf-8").replace('"480"', '"8"')
    text = text.replace('name="estimator" value="exact"', 'name="estimator" value="wigner"')
    for outline in (EXAMPLES / name).glob("*.*"):
        text = text.replace(f'"{outline.name}"', f'"{outline}"')
    file = Path(f"{name}.xml").resolve()
    file.write_text(text, encoding="utf-8")
    return file


@functools.cache
def loaded(name: str, variant: str = "llvm_ad_mono") -> Any:
    """Scene of an example, small enough for hundreds of calls."""
    import mitsuba as mi

    import polywigner.mitsuba as pm

    mi.set_log_level(mi.LogLevel.Error)
    return pm.load_scene(
        small_scene(name), variant, **{"spp": "16"} if name == "link_77ghz" else {}
    )


def scene_of(function: str) -> Any:
    """Scene with a receiver for functions that receive, and without one for those that render."""
    links = ("received_power", "received_powers", "range_profile", "receiving", "scatterers",
             "channel")  # fmt: skip
    return loaded("link_77ghz" if function.endswith(links) else "patch_above_floor")


@functools.cache
def frames() -> Any:
    import polywigner.mitsuba as pm

    return pm.range_frames(loaded("patch_above_floor"), PLAIN["ranges"], spp=4)


@functools.cache
def plane() -> Any:
    return pw.plane(SQUARE, PLAIN["where"], (3, 3), 0.003)


@functools.cache
def stored() -> Path:
    pw.volume(SQUARE, PLAIN["box"], (2, 2, 2), 0.003, out="volume.zarr")
    return Path("volume.zarr").resolve()


def spots(name: str, dims: tuple[str, ...]) -> Any:
    import xarray

    return xarray.Dataset(
        {name: (dims, np.ones((1, 2, 3)))},
        {dim: np.arange(size) * 1e-6 for dim, size in zip(dims, (1, 2, 3), strict=True)},
    )


def seen() -> Any:
    return pw.radiation_pattern(SQUARE, 0.003, [0.0, 0.1, 0.2], [0.0, np.pi / 2])


@functools.cache
def polarised() -> Any:
    angles = np.radians(np.arange(0, 91, 5)), np.radians(np.arange(0, 360, 10))
    return pw.radiation_pattern(SQUARE, 0.003, *angles, polarisation="x")


@functools.cache
def cloud() -> Any:
    import polywigner.mitsuba as pm

    return pm.scatterers(loaded("link_77ghz"), 8)


@functools.cache
def profile() -> Any:
    import polywigner.mitsuba as pm

    return pm.range_profile(loaded("link_77ghz"), [0.0, 2.0, 4.0], spp=16)


@functools.cache
def heard() -> Any:
    import polywigner.mitsuba as pm

    return pm.channel(loaded("link_77ghz"), 77e9, 0)


MADE: dict[str, Callable[[str], Any]] = {
    "channel": lambda _: heard(),
    "image": lambda _: np.ones((3, 3, 13)),
    "tolerance": lambda _: pw.array_tolerance(ARRAY, 0.003, [0.0, 0.1], 0.0, phase=0.1, count=4),
    "scene": scene_of,
    "dataset": lambda _: plane(),
    "cloud": lambda _: cloud(),
    "profile": lambda _: profile(),
    "frames": lambda _: frames(),
    "power": lambda _: np.ones((4, 4)),
    "rays": lambda _: pw.sample_rays(SQUARE, 0.003, 4),
    "system": lambda _: pw.FirstOrder.free_space(0.1),
    "pattern": lambda name: (
        pw.rcs_pattern(CUBE, 0.003, [0.0, 0.1], [0.0, 0.1])
        if name.endswith("rcs")
        else polarised()
        if name.endswith("fit_pattern")
        else seen()
    ),
    "found": lambda name: {
        "draw_lines": lambda: pw.line(SQUARE, PLAIN["ends"], 3, 0.003),
        "draw_hemispheres": lambda: pw.hemisphere(SQUARE, 0.2, [0.1, 0.2], [0.0, 1.0], 0.003),
        "draw_projections": lambda: pw.projections(SQUARE, samples=9),
        "draw_psf": lambda: spots("psf", ("defocus", "y", "x")),
        "draw_mtf": lambda: spots("mtf", ("defocus", "direction", "frequency")),
        "draw_volume": lambda: pw.volume(SQUARE, PLAIN["box"], (2, 2, 2), 0.003),
    }.get(name.rpartition(".")[2], plane)(),
    "slices": lambda _: pw.figures.transform_slices(SQUARE, samples=17),
    "path": lambda name: path_of(name.rpartition(".")[2]),
}
"""Values that take a moment, made when a function asks for them by the argument's name."""


def path_of(function: str) -> Path:
    """File that a function reads, or a place to write to."""
    if function in ("load_scene", "render_file"):
        return small_scene("patch_above_floor")
    if function == "read_aperture":
        return EXAMPLES / "two_chevrons" / "chevrons.geojson"
    if function == "read_polyhedron":
        Path("cube.stl").write_text(TETRAHEDRON)
        return Path("cube.stl")
    if function == "read_source":
        pw.write_source(ARRAY, "array.json")
        return Path("array.json")
    if function == "load":
        return pw.rays.save(pw.sample_rays(SQUARE, 0.003, 4), "rays.csv")[0]
    if function == "verify_store":
        return stored()
    suffixes = {"write_netcdf": ".nc", "write_vti": ".vti", "write_pattern": ".csv", "save": ".csv",
                "write_source": ".json", "write_range_animation": ".gif"}  # fmt: skip
    return OUT.with_suffix(suffixes.get(function, ".nc"))


TETRAHEDRON = "solid s\n{}endsolid s\n".format(
    "".join(
        "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n".format(
            "".join("vertex {} {} {}\n".format(*((0.0, 0.0, 0.0), *np.eye(3))[k]) for k in face)
        )
        for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    )
)

INSTANCES: dict[str, Callable[[], Any]] = {
    "Aperture": lambda: SQUARE,
    "Array": lambda: ARRAY,
    "FirstOrder": lambda: pw.FirstOrder.free_space(0.1),
    "Illumination": lambda: pw.cosine_taper(0.01, 0.01),
    "Slits": lambda: SLITS,
    "Wavefront": lambda: SQUARE.curved(0.1, 0.003),
}


@functools.cache
def callables() -> dict[str, tuple[Callable[..., Any], bool]]:
    """Public functions, constructors and methods by name; True where a call needs an instance."""
    found: dict[str, tuple[Callable[..., Any], bool]] = {}
    for path in MODULES:
        if path.endswith("errors"):
            continue
        for name in sorted(module_of(path).__all__):
            value = getattr(module_of(path), name)
            if inspect.isclass(value) and name not in RECORDS:
                found.update(methods(f"{path}.{name}", value))
            elif inspect.isfunction(value) and name not in CONTEXTS:
                found[f"{path}.{name}"] = (value, False)
    return found


def methods(name: str, owner: type) -> Iterator[tuple[str, tuple[Callable[..., Any], bool]]]:
    """Constructor, class methods, methods and operators of the package's own classes."""
    for key in sorted(dir(owner)):
        if key.startswith("_") and key not in OPERATORS:
            continue
        static = inspect.getattr_static(owner, key)
        function = getattr(static, "__func__", static)
        ours = getattr(function, "__module__", "").startswith("polywigner")
        if key == "__init__":
            yield f"{name}.{key}", (owner, False)
        elif ours and isinstance(static, classmethod):
            yield f"{name}.{key}", (getattr(owner, key), False)
        elif ours and inspect.isfunction(static):
            yield f"{name}.{key}", (static, True)


@functools.cache
def parameters(name: str) -> tuple[inspect.Parameter, ...]:
    """Parameters of a function that a call may give, ``self`` left out."""
    function, bound = callables()[name]
    found = tuple(inspect.signature(function).parameters.values())
    return tuple(p for p in found[bound:] if p.kind is not p.VAR_KEYWORD)


def plain_arguments(name: str) -> dict[str, Any]:
    """Arguments without a default, as a plain call gives them."""
    special = SPECIAL.get(name, {})
    arguments = {}
    for p in parameters(name):
        if p.kind is p.VAR_POSITIONAL:
            arguments[p.name] = {"methods": (), "arguments": (X, NU)}[p.name]
        elif p.name in special:
            arguments[p.name] = special[p.name]
        elif p.default is p.empty:
            arguments[p.name] = MADE[p.name](name) if p.name in MADE else PLAIN[p.name]
    return arguments


def call(name: str, arguments: dict[str, Any]) -> Any:
    """Call a public function with arguments by name."""
    function, bound = callables()[name]
    first: list[Any] = [INSTANCES[name.split(".")[-2]]()] if bound else []
    named, rest = dict(arguments), []
    for p in parameters(name):
        if p.name in named and p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD):
            if p.default is p.empty:
                first.append(named.pop(p.name))
        elif p.kind is p.VAR_POSITIONAL:
            odd = named.pop(p.name, ())
            rest = list(odd) if isinstance(odd, tuple) else [odd]
    return function(*first, *rest, **named)


def odd_values() -> list[Any]:
    """Values that stand for no argument, or for one at the edge of what is allowed."""
    ragged: Any = [[1.0, 2.0], [3.0]]
    return [
        None, True, 0, -1, 1e-320, 1e308, np.nan, np.inf, -np.inf, 10**400, 1j, "", "junk", "1 mm",
        "a\nb", "\0", b"bytes", [], [[]], (), {}, set(), object(), lambda *_: 1,
        NotImplemented, Fraction(1, 3), Decimal("0.1"), datetime(2020, 1, 1), Path("x"), range(3),
        iter([1.0]), np.float32(0.003), SQUARE, SLITS, ARRAY, np.dtype("f8"), slice(1, 2), ragged,
        np.array([]), np.zeros((0, 2)), np.zeros((2, 0)), np.zeros((3, 5)), np.zeros((2, 2, 2, 2)),
        np.array(["a", "b"]), np.array([None, 1.0]), np.array([1, 2], "M8[s]"), np.array([1j, 2]),
        np.ma.masked_array([1.0, 2.0], [True, False]), np.matrix([[1.0, 2.0]]),
        np.full((3, 2), np.nan), np.full((3, 2), 1e300), np.zeros((3, 2), np.float16),
        np.zeros((3, 2), np.int8), np.array([True, False]),
        np.broadcast_to(np.float64(0.0), (3, 2)), np.arange(12.0).reshape(6, 2)[::-2],
    ]  # fmt: skip


def by_chance(number: int, seed: int, names: list[str]) -> tuple[str, dict[str, int]]:
    """Name of a function, and the numbers of odd values by the names of one or two arguments."""
    rng = np.random.default_rng([seed, number])
    name = names[number % len(names)]
    places, count = parameters(name), len(odd_values())
    chosen = rng.permutation(len(places))[: 1 + (rng.random() < 0.3)]
    return name, {places[place].name: int(rng.integers(count)) for place in chosen}


@functools.cache
def each(names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Names of functions and arguments, to be called with every odd value."""
    return [(name, p.name) for name in names for p in parameters(name)]


def changed(number: int, seed: int | None, names: list[str]) -> tuple[str, dict[str, Any], str]:
    """Name and arguments of a call, and a sentence on its odd values; seed None: one by one."""
    values = odd_values()
    if seed is None:
        place, which = divmod(number, len(values))
        name, argument = each(tuple(names))[place]
        odd = {argument: which}
    else:
        name, odd = by_chance(number, seed, names)
    said = (f"{k}: odd value {n} ({' '.join(repr(values[n]).split()):.40})" for k, n in odd.items())
    return name, plain_arguments(name) | {k: values[n] for k, n in odd.items()}, "; ".join(said)


def work(numbers: range, seed: int | None, names: list[str], file: Path) -> None:
    """Make calls, and write their outcomes; the number of the one that is made comes first."""
    os.chdir(file.parent)
    os.environ["MPLBACKEND"] = "agg"
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    found: list[tuple[int, str, float, str]] = []
    for number in numbers:
        file.with_suffix(".now").write_text(str(number))
        name, arguments, odd = changed(number, seed, names)
        outcome, start = "result", time.monotonic()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                for kind in (PolywignerWarning, DeprecationWarning):
                    warnings.simplefilter("ignore", kind)
                warnings.filterwarnings("ignore", "the matrix subclass")
                call(name, arguments)
        except PolywignerError:
            outcome = "clear error"
        except AssertionError:
            outcome = "failed check" if ".testing." in name else "FAULT: AssertionError"
        except Exception as error:
            outcome = f"FAULT: {type(error).__name__}: {error!s:.120}"
        if sys.modules.get("matplotlib.pyplot"):
            sys.modules["matplotlib.pyplot"].close("all")
        found.append((number, outcome, time.monotonic() - start, f"{name}({odd})"))
    file.write_bytes(pickle.dumps(found))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="functions whose name contains this text")
    parser.add_argument("--each", action="store_true", help="every argument with every odd value")
    options = parser.parse_args()
    names = [name for name in callables() if options.only in name]
    if options.each:
        options.count, options.seed = len(each(tuple(names))) * len(odd_values()), None
    context, counts, faults, longest = multiprocessing.get_context("spawn"), Counter(), 0, (0.0, "")
    print(f"{len(names)} functions", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        first = 0
        while first < options.count:
            file = Path(folder) / "calls"
            file.unlink(missing_ok=True)
            numbers = range(first, min(first + BATCH, options.count))
            process = context.Process(target=work, args=(numbers, options.seed, names, file))
            process.start()
            process.join(LONGEST * 5)
            if not file.exists():  # it died, or hangs
                process.kill()
                number = int(file.with_suffix(".now").read_text())
                os.chdir(folder)
                print(f"{number}: ended the process, or does not end:", end=" ")
                print(*changed(number, options.seed, names)[::2], flush=True)
                faults += 1
                first = number + 1
                continue
            for number, outcome, seconds, odd in pickle.loads(file.read_bytes()):
                counts[outcome.partition(":")[0]] += 1
                longest = max(longest, (seconds, odd))
                if outcome.startswith("FAULT"):
                    faults += 1
                    print(f"{number}: {odd}: {outcome}", flush=True)
            first = numbers.stop
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss >> 10
    print(f"{options.count} calls: {dict(counts)}, faults {faults}")
    print(f"longest: {longest[0]:.2f} s, {longest[1]}; largest process {peak} MiB")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
