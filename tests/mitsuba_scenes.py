"""Scenes for the tests of Mitsuba, such as an aperture above a white floor."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.quantities import wavelength_of

# Benchmarks also use these reference integrals.
sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

WAVELENGTH = wavelength_of(94e9)
SQUARE = pw.shapes.square(0.01)
CHEVRON = pw.shapes.chevron(0.01, 0.01, 0.004)
MILLIMETRE = 1e-3
# Neither the aperture nor its field is mirror symmetric.
HANDED = pw.Aperture([(0, 0), (9e-3, 0), (9e-3, 2e-3), (2e-3, 2e-3), (2e-3, 6e-3), (0, 6e-3)])
HANDED = HANDED.with_illumination(pw.Illumination([1.0, 0.4j], [(40.0, 15.0), (-20.0, 0.0)]))

MONO = pytest.param("llvm_ad_mono", marks=pytest.mark.llvm)
SPECTRAL = pytest.param("llvm_ad_spectral", marks=pytest.mark.llvm)
CUDA = pytest.param("cuda_ad_mono", marks=pytest.mark.cuda)
# |W| is at most 4 areas; float32 kernels have errors of 5e-6 areas, and float32 frequencies change
# phases of tens of cycles by 1e-7.
RADIANCE_ERROR = 2e-5
# Scenes of single emitters, which conftest.py frees after each test. Every kernel of Dr.Jit
# contains all emitters in memory, and an emitter that refers to its own scene would never be freed.
KEPT: list[Any] = []

VARIANTS = ["scalar_rgb", MONO, SPECTRAL, CUDA]

MIRROR = {"type": "conductor", "material": "none"}
METAL = {"type": "twosided", "bsdf": MIRROR}
BLACK = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
WHITE = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 1.0}}


def use(variant: str) -> Any:
    """Set a variant of Mitsuba without log messages, and return the module."""
    import mitsuba as mi

    import polywigner.mitsuba  # noqa: F401 (registers the plugin)

    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def pose(translation: Any = (0.0, 0.0, 0.0), about_x: float = 0.0) -> np.ndarray:
    """Return a rotation about x by an angle in radians, then a translation."""
    c, s = np.cos(about_x), np.sin(about_x)
    result = np.eye(4)
    result[1:3, 1:3] = [[c, -s], [s, c]]
    result[:3, 3] = translation
    return result


def shifted(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return pose((x, y, z))


def facing(distance: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """Return a pose at z = distance that points back to the plane of the origin."""
    result = np.diag([-1.0, 1.0, -1.0, 1.0])
    result[:3, 3] = x, y, distance
    return result


def looking(position: Any, direction: Any, up: Any = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Return a pose that points along a direction, with y close to ``up``."""
    z = np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    result = np.eye(4)
    result[:3] = np.stack([x, np.cross(z, x), z, np.asarray(position, float)], axis=-1)
    return result


def spectrum(value: float) -> dict[str, Any]:
    return {"type": "spectrum", "value": value}


def emitter(source: Any = SQUARE, pose: Any = None, **options: Any) -> dict[str, Any]:
    """Return a source of 1 W in a scene in metres."""
    import polywigner.mitsuba as pwm

    return pwm.aperture(source, WAVELENGTH, to_world=pose, power=1.0, **options)


def receiver(source: Any = SQUARE, pose: Any = None, **options: Any) -> dict[str, Any]:
    import polywigner.mitsuba as pwm

    return pwm.receiver(source, WAVELENGTH, to_world=pose, **options)


def film(width: int, height: int | None = None) -> dict[str, Any]:
    box = {"type": "box"}
    return {"type": "hdrfilm", "width": width, "height": height or width, "rfilter": box}


def camera(
    position: Any, target: Any, pixels: int, half: float | None = None, up: Any = (0, 1, 0)
) -> dict[str, Any]:
    """Return a perspective camera, or an orthographic camera with the half width ``half``."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at(*(list(map(float, v)) for v in (position, target, up)))
    if half is None:
        return {"type": "perspective", "to_world": look, "film": film(pixels), "fov": 40}
    scaled = look.scale([half, half, 1])
    return {"type": "orthographic", "near_clip": 1e-4, "to_world": scaled, "film": film(pixels)}


def rectangle(
    position: Any, axis: Any, degrees: float, half: float = 1.0, bsdf: Any = None
) -> dict[str, Any]:
    """Return a rectangle with its normal along z, then rotated."""
    import mitsuba as mi

    pose = mi.ScalarTransform4f().translate(list(position)).rotate(list(axis), degrees)
    return {"type": "rectangle", "to_world": pose.scale(half), **({"bsdf": bsdf} if bsdf else {})}


def scene_of(**parts: Any) -> Any:
    import mitsuba as mi

    return mi.load_dict({"type": "scene", **parts})


def coupled(
    one: Any, pose: Any, other: Any, other_pose: Any, wavelength: float = WAVELENGTH, **how: Any
) -> complex:
    """Return the coupling b of two placed sources."""
    return complex(pw.coupling(one, other, np.linalg.inv(pose) @ other_pose, wavelength, **how))


def nodes(half: float, pose: Any, count: int = 10) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Gauss points (n, 3) of a square plate, its normal, and areas (n,)."""
    x, weight = np.polynomial.legendre.leggauss(count)
    u, v = np.meshgrid(half * x, half * x)
    own = np.stack([u, v, 0 * u, 1 + 0 * u], axis=-1).reshape(-1, 4)
    matrix = np.array(pose.matrix)
    return (own @ matrix.T)[:, :3], matrix[:3, 2], half**2 * np.outer(weight, weight).ravel()


def lit(
    source: Any, points: np.ndarray, normal: np.ndarray, wavelength: float = WAVELENGTH
) -> np.ndarray:
    """Return the irradiance in W/m^2 of a source of 1 W at the origin, or a receiver's weight."""
    away = points / np.linalg.norm(points, axis=1)[:, None]
    density = pw.irradiance(source, points, wavelength, method="rayleigh-sommerfeld-1")
    return density / pw.radiated_power(source, wavelength) * (-away @ normal)


def floor_scene(
    lights: dict[str, Any],
    integrator: Any = None,
    distance: float = 10 * WAVELENGTH / MILLIMETRE,
    columns: int = 16,
    rows: int | None = None,
    sampler: str = "multijitter",
) -> Any:
    """Return a white floor at z = distance (mm), viewed from above over +-2 distances."""
    import mitsuba as mi

    transform = mi.ScalarTransform4f
    half = 2 * distance
    look = transform().look_at([0, 0, distance / 2], [0, 0, distance], [0, 1, 0])
    return scene_of(
        integrator=integrator or {"type": "path", "max_depth": 3},
        sensor={
            "type": "orthographic",
            "near_clip": 1e-3 * distance,
            "to_world": look.scale([half, half, 1]),
            "film": film(columns, rows),
            "sampler": {"type": sampler},
        },
        floor=rectangle((0, 0, distance), (1, 0, 0), 180, 2 * half, WHITE),
        **lights,
    )


def light(
    source: pw.Aperture | pw.Array = SQUARE, wavelength: float = WAVELENGTH, **more: Any
) -> Any:
    """Return a scene entry of a source; the scene is in millimetres."""
    import polywigner.mitsuba as pwm

    return pwm.aperture(source, wavelength, scene_unit=MILLIMETRE, **more)


def emitter_of(entry: dict[str, Any]) -> Any:
    """Load a scene entry alone, and return its emitter. The scene exists as long as the test."""

    scene = scene_of(aperture=entry)
    KEPT.append(scene)
    return scene.emitters()[0]


def draws(count: int, within: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 2) in a square, and directions (n, 3) with +z down to 80 degrees."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-within, within, (count, 2))
    cosine, azimuth = rng.uniform(0.17, 1.0, count), rng.uniform(0, 2 * np.pi, count)
    sine = np.sqrt(1 - cosine**2)
    return x, np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1)


def vectors(mi: Any, kind: str, values: np.ndarray) -> Any:
    """Return points or vectors (n, d) as an array of the variant, (d,) in scalar variants."""
    make = getattr(mi, f"{kind}{values.shape[-1]}f")
    if mi.variant().startswith("scalar"):
        return make(*values.tolist())
    return make(*(mi.Float(column.tolist()) for column in values.T))


def evaluated(mi: Any, emitter: Any, x: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the radiance (n, channels) at positions in mm for directions in the scene frame."""
    if mi.variant().startswith("scalar") and x.ndim == 2:
        rows = [evaluated(mi, emitter, a, b) for a, b in zip(x, direction, strict=True)]
        return np.concatenate(rows)
    si = mi.SurfaceInteraction3f() if x.ndim == 1 else _zeros(mi)
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    si.uv = vectors(mi, "Point", x)
    si.wi = si.sh_frame.to_local(vectors(mi, "Vector", direction))
    value = np.array(emitter.eval(si, True), dtype=float)
    return value.reshape(1, -1) if x.ndim == 1 else value.T


def _zeros(mi: Any) -> Any:
    import drjit as dr

    return dr.zeros(mi.SurfaceInteraction3f)


def uniform(mi: Any, count: int, dimensions: int, seed: int) -> Any:
    return vectors(mi, "Point", np.random.default_rng(seed).uniform(size=(count, dimensions)))
