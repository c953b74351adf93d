"""How accurate is the power of receivers in rendered scenes, compared with quadrature?

Square sources at 94 GHz, some 10 mm wide, of unit field, in scenes of diffuse surfaces, a fog and
an obstacle. Powers are radiated powers. For each case: the mean of 16 renders with equal numbers of
samples, the quadrature of module `receive_reference`, the difference in dB, and the standard error
of the mean.

    python benchmarks/receive_scene.py [--samples 4194304] [--only floor]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import polywigner.mitsuba as pwm  # before Mitsuba: selects the LLVM library

# isort: split
import mitsuba as mi

from receive_reference import (
    WAVELENGTH,
    End,
    grid,
    of_ball,
    of_fog,
    of_surface,
    radiated,
)

MILLIMETRE = 1e-3
OBLIQUITIES = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2")
RENDERS = 16


@dataclass(frozen=True)
class Case:
    """A scene with one receiver, and its expected power."""

    scene: Callable[[], dict[str, Any]]
    power: Callable[[], float]


def pose(
    origin: Any = (0.0, 0.0, 0.0), target: Any = (0.0, 0.0, 1.0), about: float = 0.0
) -> npt.NDArray[np.float64]:
    """Return a frame (4, 4) whose +z points from an origin to a target, in metres."""
    z = np.subtract(target, origin)
    z = z / np.linalg.norm(z)
    x = np.cross([np.sin(about), np.cos(about), 0.0], z)
    x = x / np.linalg.norm(x)
    result = np.eye(4)
    result[:3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    result[:3, 3] = origin
    return result


def in_scene(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Convert a pose from metres to millimetres."""
    result = matrix.copy()
    result[:3, 3] /= MILLIMETRE
    return result


def sender(end: End) -> dict[str, Any]:
    """Return the entry of an exact source without a surface, so that only reflections count."""
    return pwm.aperture(
        end.source,
        WAVELENGTH,
        to_world=in_scene(end.pose),
        scene_unit=MILLIMETRE,
        estimator="exact",
        visible=False,
    )


def reader(end: End, estimator: str = "exact", **more: Any) -> dict[str, Any]:
    """Return the entry of a receiver of one pixel."""
    return pwm.receiver(
        end.source,
        WAVELENGTH,
        to_world=in_scene(end.pose),
        scene_unit=MILLIMETRE,
        estimator=estimator,
        **more,
    )


def white(value: float = 1.0) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "spectrum", "value": value}}


def plate(centre: Any, towards: Any, half: float, reflectance: float = 1.0) -> dict[str, Any]:
    """Return a square with this half width in metres, its normal towards a target."""
    matrix = in_scene(pose(centre, towards))
    matrix[:3, :2] *= half / MILLIMETRE
    transform = mi.ScalarTransform4f(matrix)
    return {"type": "rectangle", "to_world": transform, "bsdf": white(reflectance)}


def on_plate(centre: Any, towards: Any, half: float, panels: int = 12) -> tuple[Any, Any, Any]:
    """Return points, normals and areas of the plate."""
    flat, areas = grid((-half, -half), (half, half), (panels, panels))
    frame = pose(centre, towards)
    return flat @ frame[:3, :2].T + frame[:3, 3], frame[:3, 2], areas


def on_ball(centre: Any, radius: float) -> tuple[Any, Any, Any]:
    """Return points, normals and areas of the hemisphere that faces the plane z = 0."""
    t, w = np.polynomial.legendre.leggauss(60)
    azimuth = np.arange(32) * (2 * np.pi / 32)
    cosine, phi = np.meshgrid((t + 1) / 2, azimuth, indexing="ij")
    sine = np.sqrt(1 - cosine**2)
    normals = np.stack([sine * np.cos(phi), sine * np.sin(phi), -cosine], axis=-1)
    areas = radius**2 * np.pi / 32 * w[:, None] * np.ones(32)
    return radius * normals + centre, normals, areas


def scene_of(*entries: dict[str, Any], depth: int = 2, fog: Any = None) -> dict[str, Any]:
    """Return a scene of a receiver, sources and objects."""
    integrator = {"type": "volpath" if fog else "path", "max_depth": depth}
    result: dict[str, Any] = {"type": "scene", "integrator": integrator}
    return {**result, **{f"part_{number}": entry for number, entry in enumerate(entries)}}


HEIGHT, HALF = 0.3, 0.6
FLOOR = ((0.0, 0.0, HEIGHT), (0.0, 0.0, 0.0), HALF)
SENDS = End(0.010, pose())
BESIDE = End(0.010, pose((0.1, 0.02, 0.0), (0.1, 0.02, 1.0)))
TILTED = End(0.012, pose((0.1, 0.02, 0.0), (-0.07, 0.02, 0.3)))


def floor_case(
    transmitter: End, receiver: End, estimator: str = "exact", height: float = HEIGHT
) -> Case:
    """Return a white floor parallel to the transmitter."""
    floor = ((0.0, 0.0, height), (0.0, 0.0, 0.0), 2 * height)
    return Case(
        lambda: scene_of(reader(receiver, estimator), sender(transmitter), plate(*floor)),
        lambda: of_surface(transmitter, receiver, *on_plate(*floor)),
    )


BALL = 0.02


def furnaces() -> Iterator[tuple[str, Case]]:
    """Yield a sky of radiance 1, and a sphere of radiance 1 in the near field."""
    sky = {"type": "constant", "radiance": {"type": "spectrum", "value": 1.0}}
    ball = {
        "type": "sphere",
        "radius": BALL / MILLIMETRE,
        "flip_normals": True,
        "emitter": {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}},
    }
    for estimator in ("exact", "wigner"):
        for name in OBLIQUITIES:

            def everywhere() -> float:
                return WAVELENGTH**2

            def nearby(name: str = name) -> float:
                return of_ball(SENDS, name, BALL)

            # Rays carry the radiance up to the sphere.
            near = nearby if estimator == "exact" else everywhere
            for place, thing, power in (("sky", sky, everywhere), ("sphere of 20 mm", ball, near)):
                yield (
                    f"furnace, {place}, {name}, {estimator}",
                    Case(
                        lambda e=estimator, n=name, x=thing: scene_of(
                            reader(SENDS, e, obliquity=n), x
                        ),
                        power,
                    ),
                )


def floors() -> Iterator[tuple[str, Case]]:
    """Yield monostatic and bistatic floors."""
    for estimator in ("exact", "wigner"):
        yield f"floor, monostatic, {estimator}", floor_case(SENDS, SENDS, estimator)
        yield f"floor, bistatic, {estimator}", floor_case(SENDS, BESIDE, estimator)
        yield f"floor, tilted receiver, {estimator}", floor_case(SENDS, TILTED, estimator)
    yield "floor, monostatic, 20 mm away, exact", floor_case(SENDS, SENDS, height=0.02)
    two = (SENDS, End(0.008, pose((-0.15, 0.0, 0.0), (-0.15, 0.0, 1.0))))
    yield (
        "floor, two transmitters, exact",
        Case(
            lambda: scene_of(reader(BESIDE), *map(sender, two), plate(*FLOOR)),
            lambda: sum(of_surface(end, BESIDE, *on_plate(*FLOOR)) for end in two),
        ),
    )


def exchanged() -> Iterator[tuple[str, Case]]:
    """Yield a tilted plate off the axis of one end, in both directions."""
    target = (0.0, 0.0, 1.0)
    things = (target, (0.15, 0.3, 0.0), 0.05)
    for degrees in (0, 30, 60):
        angle = np.deg2rad(degrees)
        leaning = (np.sin(angle), 0.0, np.cos(angle))
        ends = [End(0.003, pose(target=leaning)), End(0.007, pose((0.5, 0.1, 0.2), target))]
        for name, (first, second) in (("there", ends), ("back", ends[::-1])):
            yield (
                f"plate, {degrees} degrees off one axis, {name}, exact",
                Case(
                    lambda a=first, b=second: scene_of(reader(b), sender(a), plate(*things)),
                    lambda a=first, b=second: of_surface(a, b, *on_plate(*things, 4)),
                ),
            )


def obstacles() -> Iterator[tuple[str, Case]]:
    """Yield a black half-plane halfway to the floor, whose shadow starts at x = 0."""
    screen = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([2000.0, 0.0, 150.0]).scale(2000.0),
        "bsdf": {"type": "twosided", "bsdf": white(0.0)},
    }

    def passes(place: Any, points: Any) -> Any:
        # visible fraction of the square
        return np.clip(0.5 - points[..., 0] / SENDS.side, 0.0, 1.0)

    def power() -> float:
        flat, areas = grid((-0.595, -0.6), (0.005, 0.6), (60, 12))
        points = np.insert(flat, 2, HEIGHT, axis=-1)
        return of_surface(SENDS, SENDS, points, np.array([0, 0, -1.0]), areas, passes=passes)

    for estimator in ("exact", "wigner"):
        yield (
            f"floor, behind a half-plane, {estimator}",
            Case(
                lambda e=estimator: scene_of(
                    reader(SENDS, e), sender(SENDS), plate(*FLOOR), screen
                ),
                power,
            ),
        )


EXTINCTION = 4.0


def fogs() -> Iterator[tuple[str, Case]]:
    """Yield fog from 0.2 to 0.3 m with single scattering, and a floor behind it."""

    def layer(albedo: float) -> dict[str, Any]:
        medium = {"type": "homogeneous", "albedo": albedo, "sigma_t": EXTINCTION * MILLIMETRE}
        return {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 250]).scale([600, 600, 50]),
            "bsdf": {"type": "null"},
            "interior": medium,
        }

    def passes(place: Any, points: Any) -> Any:
        inside = np.clip(1 - 0.2 / points[..., 2], 0.0, None) - np.clip(
            1 - 0.3 / points[..., 2], 0.0, None
        )
        return np.exp(-EXTINCTION * inside * np.linalg.norm(points - place, axis=-1))

    def scattered() -> float:
        flat, areas = grid((-0.6, -0.6), (0.6, 0.6), (10, 10))
        t, w = np.polynomial.legendre.leggauss(6)
        points = np.stack([np.insert(flat, 2, 0.25 + 0.05 * z, axis=-1) for z in t])
        volumes = 0.05 * w[:, None, None] * areas
        return of_fog(SENDS, SENDS, points, volumes, EXTINCTION, passes)

    floor = ((0.0, 0.0, 0.35), (0.0, 0.0, 0.0), 0.6)
    for e in ("exact", "wigner"):
        yield (
            f"fog, scattered once, {e}",
            Case(
                lambda e=e: scene_of(reader(SENDS, e), sender(SENDS), layer(1.0), fog=True),
                scattered,
            ),
        )
        yield (
            f"floor, through fog, {e}",
            Case(
                lambda e=e: scene_of(
                    reader(SENDS, e), sender(SENDS), layer(0.0), plate(*floor), fog=True
                ),
                lambda: of_surface(SENDS, SENDS, *on_plate(*floor), passes=passes),
            ),
        )


def by_radar_equation(cross_section: float, distance: float) -> float:
    """Return the power of a target on both axes with gains 4 pi |F|^2/(wavelength^2 N)."""
    power = radiated(SENDS.side)
    gain = 4 * np.pi * SENDS.source.area**2 / (WAVELENGTH**2 * power)
    density = power * gain / (4 * np.pi * distance**2)
    return density * cross_section / (4 * np.pi * distance**2) * gain * WAVELENGTH**2 / (4 * np.pi)


ALBEDO, TARGET = 0.7, 0.03


def leaning(distance: float) -> tuple[Any, Any, float]:
    """Return a plate on the axis, rotated by 35 degrees."""
    angle = np.deg2rad(35)
    return (0.0, 0.0, distance), (np.sin(angle), 0.0, distance - np.cos(angle)), TARGET


def targets(distance: float) -> Iterator[tuple[str, float, float]]:
    """Yield a Lambertian plate and a sphere: the radar equation, and quadrature."""
    section = 4 * ALBEDO * (2 * TARGET) ** 2 * np.cos(np.deg2rad(35)) ** 2
    surface = on_plate(*leaning(distance), 2)
    yield (
        "plate",
        by_radar_equation(section, distance),
        of_surface(SENDS, SENDS, *surface, ALBEDO),
    )
    points, normals, areas = on_ball((0.0, 0.0, distance), TARGET)
    section = 8 / 3 * np.pi * TARGET**2 * ALBEDO
    yield (
        "sphere",
        by_radar_equation(section, distance),
        of_surface(SENDS, SENDS, points, normals, areas, ALBEDO),
    )


def radar() -> Iterator[tuple[str, Case]]:
    """Yield Lambertian targets at 2 m."""
    ball = {
        "type": "sphere",
        "center": [0.0, 0.0, 2.0 / MILLIMETRE],
        "radius": TARGET / MILLIMETRE,
        "bsdf": white(ALBEDO),
    }
    things = (("plate", plate(*leaning(2.0), ALBEDO)), ("sphere", ball))
    for (name, thing), (_, _, power) in zip(things, targets(2.0), strict=True):
        yield (
            f"radar, Lambertian {name}, exact",
            Case(
                lambda x=thing: scene_of(reader(SENDS), sender(SENDS), x),
                lambda p=power: p,
            ),
        )


def cases() -> dict[str, Case]:
    makers = (furnaces, floors, exchanged, obstacles, fogs, radar)
    return {name: case for maker in makers for name, case in maker()}


def measured(case: Case, samples: int, renders: int = RENDERS) -> tuple[float, float]:
    """Return the power in W, and its standard error."""
    scene = mi.load_dict(case.scene())
    values = [pwm.render(scene, spp=samples // renders, seed=k)[0, 0, 0] for k in range(renders)]
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(renders))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1 << 22)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    mi.set_variant(pwm.choose_variant())
    mi.set_log_level(mi.LogLevel.Error)
    print("| case | read, W | quadrature, W | difference, dB | standard error, dB |")
    print("|" + "---|" * 5)
    for name, case in cases().items():
        if options.only in name:
            value, error = measured(case, options.samples)
            power = case.power()
            print(
                f"| {name} | {value:.5e} | {power:.5e} | {10 * np.log10(value / power):+.4f} | "
                f"{10 / np.log(10) * error / value:.4f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
