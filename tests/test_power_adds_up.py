"""Power balances of emitters and receivers: detector spheres, furnaces and reciprocity.

An emitter of 1 W sends 1 W into a closed sphere. A receiver in a furnace of radiance L receives
lambda^2 L. The power through a scene is equal in both directions.
"""

import drjit as dr
import numpy as np
import pytest

import polywigner as pw
import polywigner.mitsuba as pwm
from mitsuba_scenes import KEPT, WAVELENGTH, emitter_of, use

pytestmark = [pytest.mark.drjit, pytest.mark.llvm]

# Number of renders that are averaged, and limit in standard errors, which is exceeded once in 100
# tests (Student's t with 15 degrees of freedom).
RENDERS, ERRORS = 16, 3.0
# Allowed bias by estimator. Exact light has errors of 1e-4 of its peak. Signed weights have rare
# large values, so that their errors have another distribution (12 million samples: 4e-4 +- 1e-3).
BIAS = {"exact": 1e-3, "wigner": 1e-2}
# Largest noise of a test that must detect errors of a few per cent.
NOISE = {"exact": 1e-3, "wigner": 1e-2}

VARIANT = "llvm_ad_mono"
SITES = 0.5 * WAVELENGTH * (np.argwhere(np.ones((4, 3))) - [1.5, 1.0])
STEERED = pw.phased_array(
    pw.shapes.square(0.4 * WAVELENGTH), SITES, np.exp(2j * np.pi * SITES @ [0.5, 0.0] / WAVELENGTH)
)
SQUARES = {f"{side} wavelengths": pw.shapes.square(side * WAVELENGTH) for side in (0.3, 1, 3, 10)}
HORN = pw.shapes.rectangle(3 * WAVELENGTH, 2 * WAVELENGTH)
# These sources have waves in many directions, so their normal derivative is not defined.
BENT = {
    "curved": HORN.curved(5 * WAVELENGTH, WAVELENGTH),
    "partly coherent": HORN.partially_coherent(WAVELENGTH),
}
SOURCES = {**SQUARES, "steered array": STEERED, **BENT}
BOTH = ("exact", "wigner")
CASES = [
    pytest.param(name, obliquity, estimator, marks=marks)
    for name, obliquity, estimators, marks in (
        ("steered array", "rayleigh-sommerfeld-1", ("exact",), []),
        ("1 wavelengths", "kirchhoff", ("wigner",), []),
        ("0.3 wavelengths", "rayleigh-sommerfeld-2", ("exact",), []),
        ("curved", "paper", ("wigner",), []),
        ("3 wavelengths", "rayleigh-sommerfeld-1", BOTH, pytest.mark.slow),
        ("10 wavelengths", "rayleigh-sommerfeld-2", BOTH, pytest.mark.slow),
        ("steered array", "kirchhoff", BOTH, pytest.mark.slow),
        ("partly coherent", "rayleigh-sommerfeld-1", ("wigner",), pytest.mark.slow),
    )
    for estimator in estimators
]


def detectors(radius, count):
    """Return points (n, 3) on a hemisphere, inward normals, and areas of a Gauss rule."""
    node, weight = np.polynomial.legendre.leggauss(count)
    theta, phi = np.pi / 4 * (node + 1), 2 * np.pi * (np.arange(2 * count) + 0.5) / (2 * count)
    solid = (np.pi / 4 * weight * np.sin(theta))[:, None] * np.full(2 * count, np.pi / count)
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    s = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), cosine), axis=-1)
    s, solid = s.reshape(-1, 3), solid.ravel()
    return radius * s, -s, radius**2 * solid


def collected(entry, radius, samples):
    """Return the power in W at detectors around an emitter, and its standard error."""
    mi = use(VARIANT)
    emitter = emitter_of(entry)
    places, normals, areas = (np.concatenate([a] * samples) for a in detectors(radius, 48))
    rng = mi.PCG32(len(places))
    points = dr.zeros(mi.SurfaceInteraction3f, len(places))
    points.p, points.n = mi.Point3f(places.T), mi.Normal3f(normals.T)
    totals = []
    for _ in range(RENDERS):
        draw = mi.Point2f(rng.next_float32(), rng.next_float32())
        seen, weight = emitter.sample_direction(points, draw, True)
        irradiance = weight[0] * dr.abs(dr.dot(seen.d, points.n))
        dr.eval(irradiance, rng)
        totals.append(float(np.array(irradiance) @ areas) / samples)
    return float(np.mean(totals)), float(np.std(totals, ddof=1) / np.sqrt(RENDERS))


@pytest.mark.parametrize(("name", "obliquity", "estimator"), CASES)
def test_detectors_all_around_an_emitter_receive_its_power(name, obliquity, estimator):
    entry = pwm.aperture(
        SOURCES[name], WAVELENGTH, obliquity=obliquity, estimator=estimator, power=2.5
    )
    result, error = collected(entry, 300 * WAVELENGTH, 2 if estimator == "exact" else 40)
    assert abs(result / 2.5 - 1) < ERRORS * error / 2.5 + BIAS[estimator]
    assert error / 2.5 < NOISE[estimator]


def received(scene, samples):
    """Return the mean power in W of some renders of the first sensor, and its standard error."""
    mi = use(VARIANT)
    loaded = mi.load_dict(scene)
    KEPT.append(loaded)
    values = [pwm.render(loaded, spp=samples // RENDERS, seed=k).sum() for k in range(RENDERS)]
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(RENDERS))


@pytest.mark.parametrize(("name", "obliquity", "estimator"), CASES)
def test_a_furnace_gives_a_wavelength_squared_of_its_radiance_to_any_receiver(
    name, obliquity, estimator
):
    use(VARIANT)
    sky = {"type": "constant", "radiance": {"type": "spectrum", "value": 3.0}}
    receiver = pwm.receiver(SOURCES[name], WAVELENGTH, obliquity=obliquity, estimator=estimator)
    scene = {"type": "scene", "integrator": {"type": "path"}, "receiver": receiver, "sky": sky}
    result, error = received(scene, 1 << (15 if estimator == "exact" else 20))
    expected = 3.0 * WAVELENGTH**2
    assert abs(result - expected) < ERRORS * error + BIAS[estimator] * expected
    assert error < NOISE[estimator] * expected


def towards(place, degrees):
    """Return a pose whose +z is rotated about y by an angle from the direction to the origin."""
    way = -np.asarray(place) / np.linalg.norm(place)
    side = np.cross([0.0, 1.0, 0.0], way)
    side /= np.linalg.norm(side)
    angle = np.radians(degrees)
    z = np.cos(angle) * way + np.sin(angle) * side
    x = np.cross([0.0, 1.0, 0.0], z)
    result = np.eye(4)
    result[:3, :3] = np.stack([x / np.linalg.norm(x), [0, 1, 0], z], axis=1)
    result[:3, 3] = place
    return result


ENDS = (
    (pw.shapes.square(0.5 * WAVELENGTH), 40 * WAVELENGTH * np.array([0.0, 0.0, 1.0])),
    (
        pw.shapes.rectangle(0.3 * WAVELENGTH, 0.6 * WAVELENGTH),
        30 * WAVELENGTH * np.array([0.5, 0, 0.8]),
    ),
)
SIDE = 12 * WAVELENGTH


def plate(mi):
    white = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 1.0}}
    pose = mi.ScalarTransform4f().scale(SIDE / 2)
    return {"type": "rectangle", "to_world": pose, "bsdf": white}


def passed(degrees, obliquity, estimator, back, samples):
    """Return the power that reaches one end via a plate if the other end radiates 1 W."""
    mi = use(VARIANT)
    ends = [
        (source, towards(place, turn))
        for (source, place), turn in zip(ENDS, (degrees, 20.0), strict=True)
    ]
    (sent, here), (taken, there) = ends[::-1] if back else ends
    how = {"obliquity": obliquity, "estimator": estimator}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "emitter": pwm.aperture(sent, WAVELENGTH, here, power=1.0, visible=False, **how),
        "receiver": pwm.receiver(taken, WAVELENGTH, there, **how),
        "target": plate(mi),
    }
    return received(scene, samples)


@pytest.mark.parametrize(
    ("obliquity", "estimator", "degrees"),
    [
        ("rayleigh-sommerfeld-1", "exact", 30.0),
        pytest.param("rayleigh-sommerfeld-1", "wigner", 60.0, marks=pytest.mark.slow),
        pytest.param("kirchhoff", "exact", 60.0, marks=pytest.mark.slow),
    ],
)
def test_what_scatters_passes_as_much_there_as_back(obliquity, estimator, degrees):
    samples = 1 << (17 if estimator == "exact" else 20)
    there, back = (passed(degrees, obliquity, estimator, back, samples) for back in (False, True))
    noise = np.hypot(there[1], back[1])
    assert abs(there[0] - back[0]) < ERRORS * noise + BIAS[estimator] * there[0]
    assert noise < 0.04 * there[0]  # exchanged cosines would be 2 at 60 degrees
