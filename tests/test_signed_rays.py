"""Rays that carry W: power, reconstructed irradiance and errors for all kinds of sources."""

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, GeometryError, IlluminationError

pytest.importorskip("xarray")

WAVELENGTH = 3.2e-3
SQUARE = pw.shapes.square(10e-3)
STEERED = SQUARE.with_illumination(pw.steering((0.3, 0.2), WAVELENGTH))
SOURCES: dict[str, Any] = {
    "square": SQUARE,
    "steered": STEERED,
    "chevrons": pw.shapes.chevron_pair(12e-3, 8e-3, 3e-3),
    "tapered": pw.shapes.rectangle(12e-3, 6e-3).with_illumination(pw.te_mode(12e-3, 6e-3, 1, 0)),
    "array": pw.phased_array(
        pw.shapes.square(2e-3), pw.arrays.grid_positions(3, 2, 4e-3), np.exp(1j * np.arange(6))
    ),
    "converging": SQUARE.curved((-0.02, 0.03), WAVELENGTH, centre=(1e-3, 2e-3)),
    "partly coherent": SQUARE.partially_coherent(4e-3),
}
# The power is a slow sum over tilts and nodes along edges.
MIXED = {"both": STEERED.curved(0.05, WAVELENGTH).partially_coherent(8e-3)}
# Each kind of source, and each sampling with flat, curved and partially coherent sources.
DRAWN = [("square", "uniform"), ("steered", "quasi-random"), ("chevrons", "uniform")]
DRAWN += [("tapered", "uniform"), ("array", "quasi-random"), ("converging", "uniform")]
DRAWN += [("partly coherent", "quasi-random"), ("both", "uniform")]

# Limit in standard deviations for Student's and normal distributions, exceeded with a probability
# of 1e-4.
UNLIKELY = 4.5
ROUNDING = 1e-12

# Wavelength and focal length for narrow pupils, whose rays are paraxial: tan and sin differ by 1e-5
# of a spot.
LIGHT, FOCAL_LENGTH = 0.6e-6, 1.0
PUPIL = pw.shapes.regular_polygon(6, 2.5e-3)
LENS = PUPIL.curved(-FOCAL_LENGTH, LIGHT)
CURVED = SOURCES["converging"]

# Pixels in front of the square and off the axis.
GRID = Z, BOUNDS, SHAPE = 0.03, (-0.03, -0.02, 0.05, 0.02), (4, 2)


def gauss(low, high, cells, order=5):
    """Return Gauss points and weights along an axis, ordered by cells."""
    t, w = np.polynomial.legendre.leggauss(order)
    edges = np.linspace(low, high, cells + 1)
    half = (edges[1] - edges[0]) / 2
    return ((edges[1:] + edges[:-1])[:, None] / 2 + half * t).ravel(), w / 2


def across(rays):
    """Return rays whose sums are |U|^2 instead of the power per area of a plane."""
    weight = rays.weight / rays.direction[:, 2]
    return pw.rays.traced(rays, rays.position, rays.direction, weight)


def mean_irradiance(source, obliquity=None):
    """Return the means over the pixels of |U|^2 of Wigner rays, by quadrature."""
    (x, w), (y, _) = gauss(BOUNDS[0], BOUNDS[2], 4), gauss(BOUNDS[1], BOUNDS[3], 2)
    points = np.stack(np.meshgrid(x, y, [Z], indexing="ij"), axis=-1)[..., 0, :]
    result = pw.irradiance(source, points, WAVELENGTH, method="wigner", obliquity=obliquity)
    return np.einsum("iajb,a,b->ji", result.reshape(4, 5, 2, 5), w, w)


def rebuilt(source, seeds, **how):
    """Return irradiances and standard errors (seeds, 2, 4)."""
    pictures = [
        pw.rays.rebuild(across(pw.sample_rays(source, WAVELENGTH, 2048, k, **how)), *GRID)
        for k in range(seeds)
    ]
    return tuple(
        np.array([p[name].values for p in pictures]) for name in ("irradiance", "standard_error")
    )


def significance(values, expected):
    """Return the deviation of means over seeds in standard deviations."""
    error = values.std(axis=0, ddof=1) / math.sqrt(len(values))
    return abs(values.mean(axis=0) - expected) / error


def check_sum(weights, expected, scatter):
    """Check sums of 32 independent sets of rays; ``scatter`` is their largest relative error."""
    sums = 32 * weights.reshape(32, -1).sum(axis=1)
    assert significance(sums, expected) < UNLIKELY
    assert sums.std() / math.sqrt(32) < scatter


@pytest.mark.parametrize("name", ["square", "array", "converging", "partly coherent"])
def test_weights_add_up_to_the_radiated_power(name):
    source = SOURCES[name]
    how: Any = {"directions": "beam" if name == "square" else "uniform"}
    rays = pw.sample_rays(source, WAVELENGTH, 24 << 14, **how)
    power = pw.radiated_power(source, WAVELENGTH)
    check_sum(rays.weight.values, power, 0.015 * power)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "sampling"), DRAWN)
def test_rebuilt_irradiance_is_unbiased_and_knows_its_error(name, sampling):
    source = (SOURCES | MIXED)[name]
    values, errors = rebuilt(source, 64, sampling=sampling)
    assert significance(values, mean_irradiance(source)).max() < UNLIKELY
    # With 64 seeds, a standard deviation is known to a tenth, and the pixels differ.
    ratio = np.sqrt((errors**2).mean(axis=0)) / values.std(axis=0, ddof=1)
    assert ratio == pytest.approx(1.0, abs=0.45)
    assert ratio.mean() == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("obliquity", [None, "kirchhoff"])
def test_obliquities_are_those_of_wigner_rays(obliquity):
    rays = pw.sample_rays(STEERED, WAVELENGTH, 1 << 18, cone=1.4, obliquity=obliquity)
    result = pw.rays.rebuild(across(rays), *GRID)
    error = abs(result.irradiance.values - mean_irradiance(STEERED, obliquity))
    assert (error / result.standard_error.values).max() < UNLIKELY


@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_far_away_a_plane_receives_the_exact_density_of_power_times_its_cosine(angle):
    """The test uses a pixel in the beam at 300 mm, and the same pixel on a tilted plane."""
    axis, half = np.array([0.3, 0.2, math.sqrt(0.87)]), 4e-3
    rays = pw.sample_rays(STEERED, WAVELENGTH, 1 << 18, cone=0.05, axis=axis)
    sine, cosine = math.sin(angle), math.cos(angle)
    plane = np.eye(4)
    plane[:3, :3] = [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]
    plane[:3, 3] = 0.3 * axis
    result = pw.rays.rebuild(rays, plane, (-half, -half, half, half), (1, 1))
    t, w = gauss(-half, half, 1)
    x, y = np.meshgrid(t, t, indexing="ij")
    points = np.stack([x, y], axis=-1) @ plane[:3, :2].T + plane[:3, 3]
    towards = points / np.linalg.norm(points, axis=-1, keepdims=True)
    received = pw.irradiance(STEERED, points, WAVELENGTH) * (towards @ plane[:3, 2])
    expected, error = w @ received @ w, result.standard_error.item()
    assert abs(result.irradiance.item() - expected) < UNLIKELY * error
    assert error < 0.01 * expected


def check_focus(rays, pupil, light, focal_length, half):
    """Check |F|^2/(lambda f)^2 of the flat source in the focal plane."""
    result = pw.rays.rebuild(rays, focal_length, (-half, -half, half, half), (5, 5))
    x, w = gauss(-half, half, 5)
    nu = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1) / (light * focal_length)
    exact = np.abs(pw.fourier(pupil, nu)) ** 2 / (light * focal_length) ** 2
    mean = np.einsum("iajb,a,b->ji", exact.reshape(5, 5, 5, 5), w, w)
    error = result.standard_error.values
    # Student's t with 15 degrees of freedom exceeds 5 once in 1e4.
    assert (abs(result.irradiance.values - mean) / error).max() < 5
    assert error.max() < 0.04 * mean.max()


def test_rays_through_a_thin_lens_focus_to_the_fourier_transform():
    """At the focus, a ray is at f times its slope for any position."""
    rays = pw.sample_rays(PUPIL, LIGHT, 1 << 15, sampling="quasi-random", cone=8e-4)
    slope = rays.direction.values[:, :2] / rays.direction.values[:, 2:]
    place = np.column_stack([0.1 * slope, np.full(len(slope), 0.1)])
    check_focus(pw.rays.traced(rays, place, rays.direction), PUPIL, LIGHT, 0.1, 30e-6)


def test_a_converging_wave_has_its_focus_where_a_lens_has():
    rays = pw.sample_rays(LENS, LIGHT, 1 << 15, cone=4e-3)
    check_focus(rays, PUPIL, LIGHT, FOCAL_LENGTH, 300e-6)


def test_a_pose_moves_rays_and_the_plane_that_meets_them():
    turn = np.eye(4)
    c, s = math.cos(0.7), math.sin(0.7)
    turn[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    turn[:3, 3] = 0.1, -0.2, 0.3
    here = pw.sample_rays(SQUARE, WAVELENGTH, 256)
    there = pw.sample_rays(SQUARE, WAVELENGTH, 256, to_world=turn)
    placed = pw.sample_rays(SQUARE.placed(turn), WAVELENGTH, 256)
    assert placed.equals(there)
    moved = here.position.values @ turn[:3, :3].T + turn[:3, 3]
    assert there.position.values == pytest.approx(moved, abs=ROUNDING)
    screen = np.eye(4)
    screen[2, 3] = Z
    expected = pw.rays.rebuild(here, Z, BOUNDS, SHAPE).irradiance.values
    for rays, plane in ((here, screen), (there, turn @ screen)):
        result = pw.rays.rebuild(rays, plane, BOUNDS, SHAPE).irradiance.values
        assert result == pytest.approx(expected, rel=1e-9)


EVERYWHERE = (-1e9, -1e9, 1e9, 1e9)


def by_hand(position, direction, weight):
    rays = pw.sample_rays(SQUARE, WAVELENGTH, len(weight))
    return pw.rays.traced(rays, position, direction, weight)


def test_rays_are_counted_where_they_meet_the_plane():
    x = [0.1, 0.9, 1.5, 0.1, np.nan, 0.1]
    position = np.column_stack([x, np.full(6, 0.6), np.zeros(6)])
    direction = np.tile([0.0, 0.0, 1.0], (6, 1))
    direction[3] = 0.0, 0.0, -1.0  # away from the plane
    direction[5] = 1.0, 0.0, 0.0  # along the plane
    rays = by_hand(position, direction, [1.0, -2.0, 4.0, 8.0, 16.0, 32.0])
    result = pw.rays.rebuild(rays, 1.0, (0, 0, 1, 1), (2, 4))
    assert result.irradiance.values.T.tolist() == [[0, 0, 8, 0], [0, 0, -16, 0]]
    assert (result.power, result.lost, result.missed) == (-1.0, 1, 3)
    # One of six rays ends in this pixel, so the variance is 6/5 (w^2 - w^2/6).
    assert result.standard_error.values[2, 0] == pytest.approx(8.0)
    virtual = pw.rays.rebuild(rays, 1.0, (0, 0, 1, 1), (2, 4), virtual=True)
    assert virtual.irradiance.values[2, 0] == 8 * 9
    # Rays that end on the plane up to rounding are included.
    ended = by_hand(position[:3] + np.array([0, 0, 1e-12]), direction[:3], [1.0, 1.0, 1.0])
    assert pw.rays.rebuild(ended, 0.0, (0, 0, 1, 1), (1, 1)).power == 2.0


def test_pictures_of_rays_have_y_upwards_and_x_to_the_right():
    """Rows are along x, and the first row is at the bottom (``origin="lower"``)."""
    rays = by_hand([[0.3, 0.8, 0.0]], [[0.0, 0.0, 1.0]], [1.0])
    result = pw.rays.rebuild(rays, 0.0, (-1, -1, 1, 1), (10, 5))
    for name in ("irradiance", "standard_error"):
        assert result[name].dims == ("y", "x")
        assert result[name].shape == (5, 10)
    assert np.argwhere(result.irradiance.values).tolist() == [[4, 6]]
    assert (np.diff(result.x) > 0).all() and (np.diff(result.y) > 0).all()
    assert float(result.irradiance.sel(x=0.3, y=0.8, method="nearest")) > 0


def test_a_selection_of_batches_keeps_its_own_error():
    rays = pw.sample_rays(SQUARE, WAVELENGTH, 1 << 12, sampling="quasi-random")
    batch = rays["batch"].values
    some = rays.isel(ray=(batch == 3) | (batch == 11))
    sums = [rays["weight"].values[batch == k].sum() for k in (3, 11)]
    result = pw.rays.rebuild(some, 0.0, EVERYWHERE, (1, 1))
    assert result.power == pytest.approx(sum(sums))
    assert result.power_error == pytest.approx(abs(sums[0] - sums[1]))  # sqrt(2) of two rays
    # A single ray counts as independent rays.
    one = rays.isel(ray=batch == 3)
    alone = pw.rays.rebuild(one, 0.0, EVERYWHERE, (1, 1))
    apart = pw.rays.rebuild(one.drop_vars("batch"), 0.0, EVERYWHERE, (1, 1))
    assert alone.power_error == apart.power_error > 0


DARK = pw.Array([SQUARE, SQUARE], [1.0, -1.0])
SAMPLED: list[tuple[dict[str, Any], str]] = [
    ({"count": 0}, "count"),
    ({"count": 16, "sampling": "quasi-random"}, "32"),
    ({"sampling": "sobol"}, "quasi-random"),
    ({"directions": "all"}, "beam"),
    ({"cone": 2.0}, "half angle"),
    ({"cone": 0.5, "axis": (1.0, 0.0, 0.0)}, "narrower cone"),
    ({"axis": (0.0, 0.0, 2.0)}, "unit vector"),
    ({"obliquity": "lambert"}, "obliquity"),
    ({"power": -1.0}, "expected power to be"),
    ({"wavelength": 0.0}, "wavelength"),
    ({"source": pw.Slits([[0.0, 1.0]])}, "Aperture"),
    ({"source": SQUARE.placed(np.eye(4)), "to_world": np.eye(4)}, "to_world must be omitted"),
    ({"source": DARK, "power": 1.0}, "source radiates only"),
    ({"to_world": np.diag([2.0, 2.0, 2.0, 1.0])}, "scales"),
    *(
        ({"source": source, "obliquity": name}, "curved waves and partially coherent")
        for source in (CURVED, SQUARE.partially_coherent(4e-3))
        for name in ("kirchhoff", "rayleigh-sommerfeld-2")
    ),
]


@pytest.mark.parametrize(("change", "said"), SAMPLED)
def test_arguments_of_sample_rays_are_checked(change, said):
    call: dict[str, Any] = {"source": SQUARE, "wavelength": WAVELENGTH, "count": 64, **change}
    with pytest.raises((ArgumentError, IlluminationError, GeometryError), match=said):
        pw.sample_rays(**call)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda rays: pw.rays.rebuild(3, 0.1, BOUNDS, SHAPE), "sample_rays"),
        (lambda rays: pw.rays.rebuild(rays, 0.1, (0, 0, 0, 1), SHAPE), "bounds"),
        (lambda rays: pw.rays.rebuild(rays, 0.1, BOUNDS, (0, 5)), "shape"),
        (lambda rays: pw.rays.rebuild(rays, 0.1, BOUNDS, (1 << 14, 1 << 14)), "pixels, got"),
        (lambda rays: pw.rays.traced(rays, rays.position, 2 * rays.direction), "unit vectors"),
        (lambda rays: pw.rays.traced(rays, rays.position[:3], rays.direction), "shape"),
    ],
)
def test_arguments_of_rebuild_and_traced_are_checked(call, said):
    rays = pw.sample_rays(SQUARE, WAVELENGTH, 8)
    with pytest.raises((ArgumentError, GeometryError), match=said):
        call(rays)


@pytest.mark.parametrize("width", [1.5e-3, 3e-3, math.inf])
def test_fringes_of_two_slits_have_the_visibility_of_the_degree_of_coherence(width):
    """In directions of equal intensity of each slit, fringes are 1 + |mu| cos(2 pi d nu)."""
    distance = 3e-3
    across = distance / 20  # 1 % non-uniform at the edge of the cone
    slits = pw.shapes.double_slit(across, across, (-distance / 2, distance / 2))
    light = slits.partially_coherent(width)
    cone = LIGHT / distance
    rays = pw.sample_rays(light, LIGHT, 1 << 14, cone=cone, directions="uniform")
    fringe = np.cos(2 * math.pi * distance * rays.direction.values[:, 0] / LIGHT)
    # The visibility follows from sums of 1 and of the fringe over a disc.
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 401)])
    inside = np.cos(2 * math.pi * x[x**2 + y**2 < 1])
    first, second = inside.mean(), (inside**2).mean()
    visibility = math.exp(-((distance / width) ** 2) / 2)
    share = (first + visibility * second) / (1 + visibility * first)
    excess = rays.weight.values * (fringe - share)
    check_sum(excess, 0.0, 0.05 * second * rays.weight.values.sum())


@pytest.mark.parametrize(
    "source", [CURVED, CURVED.partially_coherent(8e-3)], ids=["curved", "partly coherent"]
)
def test_the_power_in_a_narrow_cone_is_that_of_the_radiant_intensity(source):
    """Many positions have their beam outside of the cone."""
    axis, half = np.array([0.3, 0.2, math.sqrt(0.87)]), 0.1
    rays = pw.sample_rays(source, WAVELENGTH, 1 << 17, cone=half, axis=axis)
    assert (rays.direction.values @ axis).min() > math.cos(half) - ROUNDING
    t, w = np.polynomial.legendre.leggauss(4)
    theta, phi = half * (t + 1) / 2, np.arange(12) * math.pi / 6
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    around = np.cos(phi)[:, None] * across + np.sin(phi)[:, None] * np.cross(axis, across)
    s = np.cos(theta)[:, None, None] * axis + np.sin(theta)[:, None, None] * around
    # Rayleigh-Sommerfeld I has one cosine more than the paper.
    intensity = (s[..., 2] * pw.radiant_intensity(source, s, WAVELENGTH)).mean(axis=1)
    power = math.pi * half * float(w @ (intensity * np.sin(theta)))
    check_sum(rays.weight.values, power, 0.06 * power)


def test_a_wave_that_is_flat_and_coherent_has_the_rays_of_its_source():
    for wave in (SQUARE.curved(math.inf, WAVELENGTH), SQUARE.partially_coherent(math.inf)):
        result = pw.sample_rays(wave, WAVELENGTH, 512, cone=0.7)
        expected = pw.sample_rays(SQUARE, WAVELENGTH, 512, cone=0.7)
        for name in ("position", "direction", "weight"):
            scale = float(abs(expected[name]).max())
            assert result[name].values == pytest.approx(expected[name].values, abs=1e-12 * scale)


@pytest.mark.parametrize("obliquity", ["rayleigh-sommerfeld-1", "paper"])
def test_a_power_scales_the_weights(obliquity):
    for source in (SQUARE, CURVED, SQUARE.partially_coherent(4e-3)):
        how: Any = {"count": 64, "obliquity": obliquity}
        rays = pw.sample_rays(source, WAVELENGTH, **how)
        watt = pw.sample_rays(source, WAVELENGTH, **how, power=1.0)
        total = pw.radiated_power(source, WAVELENGTH, obliquity)
        assert watt.weight.values == pytest.approx(rays.weight.values / total, rel=ROUNDING)


@pytest.mark.parametrize("source", [CURVED, SQUARE.partially_coherent(4e-3)])
def test_the_paper_s_obliquity_is_a_cosine_less(source):
    plain, paper = (
        pw.sample_rays(source, WAVELENGTH, 64, obliquity=name) for name in (None, "paper")
    )
    expected = plain.weight.values / plain.direction.values[:, 2]
    assert paper.weight.values == pytest.approx(expected, rel=ROUNDING)
