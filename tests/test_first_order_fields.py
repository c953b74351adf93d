"""Fields behind first-order systems: Collins' integral against references, quadrature and W."""

import math

import numpy as np
import pytest
import shapely
from scipy.special import sici

import polywigner as pw
from oracles.quadrature import nodes_on
from oracles.references import read_json
from polywigner.errors import ArgumentError

REFERENCE = read_json("curved")
WAVELENGTH = REFERENCE["wavelength"]
SQUARE = pw.shapes.square(10e-3)
SHAPES = {
    "square": SQUARE,
    "L": pw.Aperture(
        [(-6e-3, -6e-3), (6e-3, -6e-3), (6e-3, -2e-3), (-2e-3, -2e-3), (-2e-3, 6e-3), (-6e-3, 6e-3)]
    ),
    "TE10 square": SQUARE.with_illumination(pw.cosine_taper(10e-3)),
}
# Error relative to the reference values.
REFERENCED = 1e-10
# Quadrature error relative to the largest field.
QUADRATURE = 1e-11
SEED = 5

TAPERED = SHAPES["L"].with_illumination(
    pw.Illumination([1.0, 0.4 - 0.3j], [(20.0, -10.0), (-60.0, 35.0)])
)
HOLED = pw.Aperture(
    shapely.Polygon(
        [(-6e-3, -5e-3), (5e-3, -4e-3), (4e-3, 6e-3)],
        [[(-1e-3, -1e-3), (1e-3, -1e-3), (1e-3, 1e-3)]],
    )
)
PAIR = pw.phased_array(pw.shapes.square(2e-3), [(-2e-3, 0.0), (2e-3, 1e-3)], [1.0, 0.5j])
MIXED = pw.Array([pw.shapes.triangle(3e-3, 4e-3), SQUARE.moved((0.02, 0.01))], [1.0 - 0.5j, 0.3])
CURVED = TAPERED.curved(0.2, WAVELENGTH)
SOURCES = {"waves": TAPERED, "hole": HOLED, "lattice": PAIR, "two outlines": MIXED}

SPACE = pw.FirstOrder.free_space(0.05)
ASTIGMATIC = {
    "both curved one way": SPACE @ pw.FirstOrder.lens((0.2, -0.3), 0.4),
    "curved both ways": SPACE @ pw.FirstOrder.lens((0.03, 0.2), 0.4),
    "curved the other way": SPACE @ pw.FirstOrder.lens((0.02, 0.03), -1.0),
    "a line focus": SPACE @ pw.FirstOrder.lens((0.05, math.inf), 0.7),
    "nearly a line focus": SPACE @ pw.FirstOrder.lens((0.05 + 1e-13, 0.2)),
    "an oblique one": pw.FirstOrder.lens((0.1, 0.2), 0.3)
    @ SPACE
    @ pw.FirstOrder.rotation(0.5)
    @ pw.FirstOrder.lens((0.06, 0.11), 1.2)
    @ SPACE,
    "a mirror": pw.FirstOrder.magnifier((-1.0, 1.0)) @ SPACE @ pw.FirstOrder.lens((0.1, 0.2)),
}
LINE = SPACE @ SPACE @ pw.FirstOrder.lens((0.1, 0.05)) @ SPACE @ SPACE
SYMMETRIC = {
    "free space": SPACE,
    "converging": SPACE @ pw.FirstOrder.lens(0.03),
    "turned": SPACE @ pw.FirstOrder.rotation(0.4) @ pw.FirstOrder.lens(0.2),
    "focus": SPACE @ pw.FirstOrder.lens(0.05),
    "back": pw.FirstOrder.free_space(-0.06),
}


def points(count, size, seed=SEED):
    return np.random.default_rng(seed).uniform(-size, size, (count, 2))


def quadrature(source, system, y):
    """Integrate Collins' formula numerically, up to the sign of the root of det B."""
    x, field = nodes_on(source, 36)
    inverse = np.linalg.inv(system.B)
    form = ((x @ (inverse @ system.A)) * x).sum(axis=1) - 2 * (y @ inverse.T) @ x.T
    form = form + (((y @ (system.D @ inverse)) * y).sum(axis=1))[:, None]
    value = np.exp(1j * np.pi / WAVELENGTH * form) @ field
    return value / (1j * WAVELENGTH * np.sqrt(complex(np.linalg.det(system.B))))


@pytest.mark.parametrize("case", REFERENCE["collins"], ids=lambda c: f"{c['shape']} A={c['A']}")
def test_collins_integral_of_the_references(case):
    a, b, d = case["A"], case["B"], case["D"]
    system = pw.FirstOrder([[a, b], [(a * d - 1) / b, d]])
    source, expected = SHAPES[case["shape"]], complex(*case["value"])
    field = pw.amplitude(source, case["y"], WAVELENGTH, through=system)
    assert abs(field - expected) < REFERENCED
    light = pw.irradiance(source, case["y"], WAVELENGTH, through=system)
    assert light == pytest.approx(abs(expected) ** 2, abs=REFERENCED)


@pytest.mark.parametrize("case", REFERENCE["curved_fourier"], ids=lambda c: c["shape"])
def test_a_lens_and_its_focal_plane_give_the_transform_of_a_curved_wave(case):
    """A curved wave before a Fourier transform is equivalent to a lens of f = -radius."""
    system = pw.FirstOrder.fourier(1.0) @ pw.FirstOrder.lens(-case["radius"])
    nu, source = np.array(case["nu"]), SHAPES[case["shape"]]
    field = pw.amplitude(source, WAVELENGTH * nu, WAVELENGTH, through=system, tolerance=1e-12)
    result = 1j * WAVELENGTH * field
    assert abs(result - complex(*case["value"])) < 1e-11 * source.area


SYSTEMS = {**ASTIGMATIC, **SYMMETRIC}
CASES = [("waves", name) for name in SYSTEMS]
CASES += [(s, n) for s in SOURCES for n in ("curved both ways", "turned") if s != "waves"]


@pytest.mark.parametrize(("source", "system"), CASES)
def test_collins_integral_is_that_of_quadrature(source, system):
    source, system = SOURCES[source], SYSTEMS[system]
    y = points(4, 0.01)
    result, error = pw.amplitude_with_error(source, y, WAVELENGTH, through=system, tolerance=1e-12)
    expected = quadrature(source, system, y)
    largest = abs(expected).max()
    turn = np.sign((result / expected).real.sum())  # sign of the root
    assert abs(result - turn * expected).max() < QUADRATURE * largest
    assert error.max() < QUADRATURE * max(largest, 1.0)


def test_an_image_is_the_source_magnified_with_the_phase_of_a_lens():
    image = pw.FirstOrder.lens(0.3) @ pw.FirstOrder.magnifier((-2.0, -2.0))
    y = points(50, 0.01)
    inside = shapely.contains_xy(SHAPES["L"].polygons, *(y.T / -2))
    expected = TAPERED.illumination(y / -2) * inside / -2.0
    expected = expected * np.exp(-1j * np.pi * (y**2).sum(axis=1) / (WAVELENGTH * 0.3))
    assert pw.amplitude(TAPERED, y, WAVELENGTH, through=image) == pytest.approx(expected, abs=1e-12)
    pair = pw.amplitude(MIXED, y, WAVELENGTH, through=pw.FirstOrder.magnifier(1.0))
    assert set(np.round(pair, 12)) <= {0.0, 1.0 - 0.5j, 0.3}


def test_fields_close_to_an_image_and_to_a_focus_pass_over_into_them():
    image = pw.FirstOrder.rotation(0.4) @ pw.FirstOrder.magnifier(-1.5)
    y = np.array([[-4e-3, -4.2e-3], [1e-3, -5e-3]]) @ image.A.T
    at_image = pw.amplitude(TAPERED, y, WAVELENGTH, through=image)
    near = pw.amplitude(TAPERED, y, WAVELENGTH, through=image @ pw.FirstOrder.free_space(2e-6))
    # Edges at hundreds of Fresnel zones cause ripples of a few per cent.
    assert near == pytest.approx(at_image, abs=0.05)
    y = points(5, 1e-3)
    focus = pw.amplitude(TAPERED, y, WAVELENGTH, through=SYMMETRIC["focus"])
    for excess in (1e-16, 1e-14, -1e-12, 1e-10):
        lens = pw.FirstOrder.lens(0.05 * (1 + excess))
        near = pw.amplitude(TAPERED, y, WAVELENGTH, through=SPACE @ lens)
        assert near == pytest.approx(focus, abs=1e-9 + 10 * abs(excess))
        crossed = pw.FirstOrder.lens((0.05 * (1 + excess), 0.05 * (1 - 2e-9)))
        near = pw.amplitude(TAPERED, y, WAVELENGTH, through=SPACE @ crossed)
        assert near == pytest.approx(focus, abs=1e-7)


@pytest.mark.parametrize("through", [ASTIGMATIC["curved both ways"], SYMMETRIC["converging"]])
def test_irradiance_is_the_wigner_functions_marginal(through):
    """int W dnu along the ray from each x of the source, with nu from y = A x + lambda B nu."""
    source, y = SQUARE, points(4, 6e-3)
    # For a square, W has kinks only at x = 0 and y = 0, so each quadrant has its own Gauss rule.
    at, weights = np.polynomial.legendre.leggauss(70)
    side = np.concatenate([(at - 1), (at + 1)]) * 2.5e-3
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    area = np.outer(*2 * [np.tile(weights, 2)]).ravel() * 2.5e-3**2
    nu = (y[:, None] - grid @ through.A.T) @ np.linalg.inv(through.B).T / WAVELENGTH
    x_out = np.broadcast_to(y[:, None], nu.shape)
    nu_out = grid @ through.C.T / WAVELENGTH + nu @ through.D.T
    w = pw.wigner(source, x_out, nu_out, through=through, wavelength=WAVELENGTH)
    marginal = (w @ area) / (WAVELENGTH**2 * abs(np.linalg.det(through.B)))
    light = pw.irradiance(source, y, WAVELENGTH, through=through, tolerance=1e-11)
    assert light == pytest.approx(marginal, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"points": (0.0, 0.0, 0.1)}, r"with through=, .*\(\.\.\., 2\)"),
        ({"points": (0.0, math.nan)}, "must be finite"),
        ({"method": "kirchhoff"}, "method='kirchhoff' cannot be combined with through="),
        ({"obliquity": "kirchhoff"}, "obliquity='kirchhoff' cannot be combined with through="),
        ({"through": "lens"}, "polywigner.FirstOrder.* of type str"),
        ({"through": [SPACE, SQUARE.placed(np.eye(4))]}, "of type PlacedAperture"),
        ({"through": [SQUARE.moved((0.1, 0.0)), SPACE]}, "stop transmits no light"),
        ({"through": [TAPERED, SPACE]}, "Aperture without a field"),
        ({"through": [LINE, SQUARE, SPACE]}, "along both axes; move the stop"),
        ({"through": [SPACE, SQUARE, LINE]}, "along one axis.*move the points"),
        (
            {"through": [SPACE, pw.shapes.square(1e3), SPACE]},
            "pairs of a quadrature node on the stop and a point",
        ),
        ({"source": pw.Slits([(0.0, 1.0)])}, "Slits"),
        (
            {"through": pw.FirstOrder.free_space(1e-9) @ pw.FirstOrder.lens((0.1, 0.2))},
            "phase of the curved wave",
        ),
    ],
)
def test_what_cannot_be_had_is_refused_in_one_sentence(call, message):
    given = {
        "source": SQUARE,
        "points": (0.0, 0.0),
        "wavelength": WAVELENGTH,
        "through": SPACE,
    } | call
    with pytest.raises(ArgumentError, match=message):
        pw.amplitude(**given)


def test_frequencies_and_labels_are_taken():
    xarray = pytest.importorskip("xarray")
    y = points(6, 5e-3)
    fields = pw.amplitude(TAPERED, y, WAVELENGTH, through=SPACE)
    labelled = xarray.DataArray(y, dims=("place", "xy"))
    result = pw.irradiance(TAPERED, labelled, WAVELENGTH, through=SPACE)
    assert result.dims == ("place",) and result.values == pytest.approx(abs(fields) ** 2, abs=1e-9)
    hertz = pw.SPEED_OF_LIGHT / WAVELENGTH
    assert pw.amplitude(TAPERED, y, frequency=hertz, through=SPACE) == pytest.approx(fields)


FOURIER = pw.FirstOrder.fourier(0.1)
SHORT = 550e-9


def band_limited(y, half, pupil):
    """Return an image along one axis of the slit [-half, half] through a pupil."""
    scale = 2 * np.pi * pupil / (SHORT * 0.1)
    return (sici(scale * (y + half))[0] - sici(scale * (y - half))[0]) / np.pi


def test_a_square_behind_a_square_pupil_is_a_product_of_sine_integrals():
    source, pupil = pw.shapes.square(2e-4), pw.shapes.square(1e-3)
    y = points(40, 3e-4)
    way = [FOURIER, pupil, FOURIER]
    result, error = pw.amplitude_with_error(source, y, SHORT, through=way)
    expected = -band_limited(y, 1e-4, 5e-4).prod(axis=1)
    assert abs(result - expected).max() < 1e-8 and error.max() < 1e-8
    light = pw.irradiance(source, y, SHORT, through=way)
    assert light == pytest.approx(expected**2, abs=1e-8)
    # Single lenses and distances are equivalent.
    space, lens = pw.FirstOrder.free_space(0.1), pw.FirstOrder.lens(0.1)
    parts = [space, lens, space, pupil, space, lens, space]
    assert abs(pw.amplitude(source, y, SHORT, through=parts) - expected).max() < 1e-8


STOP = pw.Aperture([(-4e-3, -3e-3), (5e-3, -2e-3), (1e-3, 6e-3)])
STEERED = pw.phased_array(pw.shapes.square(3e-3), [(-3e-3, 0.0), (2e-3, 1e-3)], [0.8, -0.6j])


@pytest.mark.parametrize(
    ("source", "stop"),
    [("waves", STOP), ("hole", TAPERED), ("lattice", HOLED), ("two outlines", STEERED)],
    ids=["triangle", "waves", "hole", "array"],
)
def test_a_stop_can_be_integrated_over_first(source, stop):
    """In the other order of integration, each source node has a chirp transform of the stop."""
    source = SOURCES[source]
    first = pw.FirstOrder.free_space(0.04) @ pw.FirstOrder.lens(0.1)
    last = pw.FirstOrder.free_space(0.06)
    y = points(5, 0.01)
    result, error = pw.amplitude_with_error(source, y, WAVELENGTH, through=[first, stop, last])
    x, field = nodes_on(source, 36)
    (b1, b2), k = (first.B[0, 0], last.B[0, 0]), np.pi / WAVELENGTH
    lens = pw.FirstOrder.lens(-1 / (first.D[0, 0] / b1 + last.A[0, 0] / b2))
    # The inner integral is F of the stop times a chirp, at (x/b1 + y/b2)/lambda.
    inner = pw.FirstOrder.fourier(1.0) @ lens
    waves = pw.amplitude(stop, x[:, None] / b1 + y / b2, WAVELENGTH, through=inner)
    ends = first.A[0, 0] / b1 * (x * x).sum(axis=1)[:, None]
    ends = ends + last.D[0, 0] / b2 * (y * y).sum(axis=1)
    expected = field @ (np.exp(1j * k * ends) * waves) / (1j * WAVELENGTH * b1 * b2)
    assert abs(result - expected).max() < 1e-7 * abs(expected).max()
    assert (abs(result - expected) < np.maximum(error, 1e-9)).all()


def test_stops_in_images_cut_outlines():
    """The stops are in the plane of the points, in the plane of the source, and in its image."""
    image = FOURIER @ FOURIER @ pw.FirstOrder.magnifier(0.5)
    y, window = points(30, 6e-3), pw.shapes.rectangle(2e-3, 3e-3)
    cases = [(source, [image], window) for source in (TAPERED, PAIR, MIXED, CURVED)]
    for source, before, stop in [*cases, (SQUARE, [SPACE, STOP, SPACE], TAPERED)]:
        alone = pw.amplitude(source, y, WAVELENGTH, through=before)
        masked = pw.amplitude(source, y, WAVELENGTH, through=[*before, stop])
        inside = shapely.intersects_xy(stop.polygons, *y.T)
        waves = 1.0 if stop.illumination is None else stop.illumination(y)
        assert 0 < inside.sum() < len(y)
        assert masked == pytest.approx(np.where(inside, alone * waves, 0.0), abs=1e-9)
    for before in (pw.FirstOrder.magnifier(1.0), image):
        larger = pw.Aperture(STOP.rings[0] @ before.A.T)
        result = pw.amplitude(HOLED, y, WAVELENGTH, through=[before, larger, SPACE])
        expected = pw.amplitude(HOLED & STOP, y, WAVELENGTH, through=[before, SPACE])
        assert abs(result - expected).max() < 1e-8


def test_two_stops_pass_the_power_that_lands_in_them():
    """The power in a wide last plane equals the power through the second stop."""
    second = pw.shapes.square(4e-3).moved((1e-3, 0.0))
    at, weights = np.polynomial.legendre.leggauss(24)
    on_stop = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2) * 2e-3 + (1e-3, 0.0)
    share = np.outer(weights, weights).ravel() * 2e-3**2
    before = [SPACE, STOP, SPACE]
    passed = share @ pw.irradiance(SQUARE, on_stop, WAVELENGTH, through=before)
    at, weights = np.polynomial.legendre.leggauss(50)
    far = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2) * 0.5
    behind = [*before, second, pw.FirstOrder.fourier(0.05)]
    light = pw.irradiance(SQUARE, far, WAVELENGTH, through=behind, tolerance=1e-4)
    assert np.outer(weights, weights).ravel() * 0.25 @ light == pytest.approx(passed, rel=0.02)


def test_a_mixture_passes_stops_wave_by_wave():
    """The field is a mean over tilts with the standard deviation 1/(2 pi width) along each axis."""
    y, width = points(4, 2e-4), 3e-4
    square, way = pw.shapes.square(2e-4), [FOURIER, pw.shapes.square(5e-4), FOURIER]
    result = pw.irradiance(square.partially_coherent(width), y, SHORT, through=way, tolerance=1e-5)
    at, weights = np.polynomial.hermite_e.hermegauss(6)
    weights = weights / weights.sum()
    tilts = [
        pw.Illumination([1.0], [k / (2 * np.pi * width)])
        for k in np.dstack(np.meshgrid(at, at)).reshape(-1, 2)
    ]
    light = [pw.irradiance(square.with_illumination(t), y, SHORT, through=way) for t in tilts]
    assert result == pytest.approx(np.outer(weights, weights).ravel() @ light, rel=1e-3, abs=1e-6)


@pytest.mark.filterwarnings("error")
def test_estimates_behind_stops_are_no_false_alarms():
    through = [SPACE, pw.shapes.square(4e-3), SPACE, STOP.moved((2e-3, 0.0)), SPACE]
    tilted = SQUARE.with_illumination(pw.Illumination([1.0], [(150.0, -80.0)]))
    for source, count in ((TAPERED.curved(0.06, WAVELENGTH), 1), (tilted, 2)):
        y = points(count, 0.01)
        fine = pw.amplitude(source, y, WAVELENGTH, through=through)
        coarse, error = pw.amplitude_with_error(
            source, y, WAVELENGTH, through=through, tolerance=1e-5
        )
        off = abs(coarse - fine)
        assert (off <= error).all() and error.max() < 1e-4
    pw.irradiance(SQUARE.partially_coherent(5e-3), y[:2], WAVELENGTH, through=through[:3])
