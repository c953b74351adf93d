"""Partially coherent sources and finite bands against quadrature and closed forms."""

import itertools
import math
from functools import partial
from typing import Any

import numpy as np
import pytest
import shapely
from shapely.affinity import scale as scaled
from shapely.affinity import translate as translated
from shapely.geometry.polygon import orient as oriented

import polywigner as pw
from polywigner.cli import main
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.quantities import SPEED_OF_LIGHT

WAVELENGTH = 3.2e-3
SIDE = 10e-3
SQUARE = pw.shapes.square(SIDE)
CHEVRONS = pw.shapes.chevron_pair(SIDE, 6e-3, 2e-3)
SLITS = pw.Slits([(0.0, 3e-3), (5e-3, 9e-3)])
WAVES = pw.Illumination([1.0, 0.5j], [(150.0, 80.0), (-90.0, 30.0)])
STEERED = pw.shapes.regular_polygon(6, SIDE / 2).with_illumination(WAVES)
# Source whose field is a product of fields along both sides.
TAPERED = SQUARE.turned(0.4).with_illumination(pw.cosine_taper(SIDE, SIDE).turned(0.4))
# Coherent light is summed over elements, partially coherent light over tilts.
LATTICE = pw.phased_array(pw.shapes.square(3e-3), 4e-3 * np.indices((2, 3)).reshape(2, -1).T)
LARGE_LATTICE = pw.phased_array(pw.shapes.square(3e-3), 4e-3 * np.indices((3, 6)).reshape(2, -1).T)
# Sources with separate parts, and slits of equal width.
DISTANT = pw.Aperture([shift + np.array([(0, 0), (1e-3, 0), (0, 1e-3)]) for shift in (0, 0.5)])
ARRAY = pw.phased_array(
    pw.shapes.square(3e-3), [(0, 0), (4e-3, 0), (0, 4e-3)], np.array([1, 1j, 0.5])
)

# Error of the closed form (1e-12) and of the quadrature, relative to the integral of |u|^2.
BY_QUADRATURE = 1e-10
# Error in single precision, relative to the integral of |u|^2.
IN_SINGLE = 2e-6
# Relative rounding error of a product of two floats.
CLOSED_FORM = 1e-13
VISIBILITY = 1e-6
# Error in nulls [dB]; the reference for the mean over the band has 2000 terms.
NULLS_DB = 0.02


def by_hermite(source, x, nu, width):
    """Average W of the coherent source over tilts with 64 Gauss-Hermite nodes per axis."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(64)
    nodes, weights = nodes / (2 * math.pi * width), weights / weights.sum()
    d = x.shape[-1]
    tilts = np.stack(np.meshgrid(*[nodes] * d, indexing="ij"), -1).reshape(-1, d)
    shares = weights if d == 1 else np.outer(weights, weights).ravel()
    return np.array([pw.wigner(source, a, b - tilts) @ shares for a, b in zip(x, nu, strict=True)])


def over_lag_slice(outline, x, nu, width):
    """Integrate the Gaussian wave over triangles of the lag slice, down to 1e-17."""
    around = scaled(translated(shapely.Polygon(outline.rings[0]), *-x), 2, 2, origin=(0, 0))
    reach = 9 * width
    window = shapely.box(-reach, -reach, reach, reach)
    lags = around & scaled(around, -1, -1, origin=(0, 0)) & window
    corners = shapely.get_coordinates(oriented(lags))
    nodes, weights = np.polynomial.legendre.leggauss(90)
    s, t = np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2)
    share = np.outer(weights, weights) / 4
    total = 0.0
    for a, b in itertools.pairwise(corners):
        xi = s[..., None] * (a + t[..., None] * (b - a))
        wave = np.exp(-(xi**2).sum(-1) / (2 * width**2)) * np.cos(2 * math.pi * (xi @ nu))
        total += float((a[0] * b[1] - a[1] * b[0]) * np.sum(s * share * wave))
    return total


@pytest.mark.parametrize("share", [30.0, 1.0, 0.1, 0.003])
def test_w_is_the_integral_over_the_lag_slice(share):
    hexagon = pw.shapes.regular_polygon(6, SIDE / 2).turned(0.2)
    width = share * SIDE
    partly = hexagon.partially_coherent(width)
    draw = np.random.default_rng(8)
    x = draw.uniform(-0.45 * SIDE, 0.45 * SIDE, (12, 2))
    # Mean frequency over the coherence width, and over the source.
    spread = np.where(np.arange(12) % 2, SIDE / 2, min(width, SIDE))
    nu = draw.normal(0, 1, (12, 2)) / spread[:, None]
    expected = [over_lag_slice(hexagon, a, b, width) for a, b in zip(x, nu, strict=True)]
    assert np.abs(pw.wigner(partly, x, nu) - expected).max() <= BY_QUADRATURE * hexagon.area
    single = pw.wigner(partly, x, nu, precision="single")
    assert single.dtype == np.float32
    assert np.abs(single - expected).max() <= IN_SINGLE * hexagon.area


@pytest.mark.parametrize("width", [2e-3, 20e-3])
@pytest.mark.parametrize(
    "source",
    [CHEVRONS, ARRAY, LATTICE, LARGE_LATTICE, DISTANT, SLITS, STEERED, TAPERED,
     SQUARE.curved(60e-3, WAVELENGTH)],
)  # fmt: skip
def test_w_is_the_mean_over_tilts(source, width):
    d = len(source.bounds) // 2
    draw = np.random.default_rng(5)
    x, nu = draw.uniform(-4e-3, 6e-3, (6, d)), draw.normal(0, 200, (6, d))
    partly = source.partially_coherent(width)
    energy = float(np.real(pw.lag_marginal(source, np.zeros(d))))
    expected = by_hermite(source, x, nu, width)
    assert np.abs(pw.wigner(partly, x, nu) - expected).max() <= BY_QUADRATURE * energy


@pytest.mark.parametrize("distance", [0.5, 2.0])
def test_the_visibility_of_two_slits_is_the_degree_of_coherence(distance):
    width = 2e-3
    apart = distance * width
    pair = pw.shapes.double_slit(1e-4 * width, 1e-4 * width, (-apart / 2, apart / 2))
    partly = pair.partially_coherent(width)
    # Maximum and minimum of the fringes, at wavelength/(2 distance).
    sine = np.array([0.0, WAVELENGTH / (2 * apart)]) * 1e-3
    direction = np.stack([sine, 0 * sine, np.sqrt(1 - sine**2)], -1)
    bright, dark = pw.radiant_intensity(partly, direction, WAVELENGTH * 1e-3) / direction[:, 2]
    visibility = (bright - dark) / (bright + dark)
    assert visibility == pytest.approx(math.exp(-(distance**2) / 2), abs=VISIBILITY)


def test_a_bandwidth_fills_nulls_as_the_integral_over_wavelengths_says():
    carrier, bandwidth = 94e9, 12e9
    theta = np.linspace(0.0, 1.2, 61)
    direction = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], -1)
    length = SPEED_OF_LIGHT / carrier
    result = pw.radiant_intensity(SQUARE, direction, length, bandwidth=bandwidth)
    frequencies = carrier + bandwidth * ((np.arange(2000) + 0.5) / 2000 - 0.5)
    # F of a square in its plane is a sinc.
    sines = np.sin(theta) * (frequencies / SPEED_OF_LIGHT)[:, None]
    single = (SIDE**2 * np.sinc(SIDE * sines)) ** 2 * (frequencies / SPEED_OF_LIGHT)[:, None] ** 2
    expected = single.mean(axis=0) * np.cos(theta)
    assert np.abs(10 * np.log10(result / expected)).max() <= NULLS_DB
    alone = pw.radiant_intensity(SQUARE, direction, length)
    assert result.min() / result.max() > 8 * alone.min() / alone.max()


@pytest.mark.parametrize("pupil", [SQUARE, SQUARE.curved(0.3, WAVELENGTH)])
def test_there_is_no_transfer_function_in_partly_coherent_light(pupil):
    """The lag marginal decreases with the degree of coherence of the light."""
    partly = pupil.partially_coherent(5e-3)
    content = pw.lag_marginal(partly, (0.0, 0.0)).real
    fallen = abs(pw.lag_marginal(pupil, (5e-3, 0.0))) * math.exp(-0.5)
    assert abs(pw.lag_marginal(partly, (5e-3, 0.0))) == pytest.approx(fallen, abs=1e-12 * content)
    for ask in (
        lambda: pw.otf(partly, (5e-3, 0.0)),
        lambda: pw.mtf(partly, (10e3, 0.0), 5e-6, 0.1),
    ):
        with pytest.raises(IlluminationError, match=r"no transfer function.*lag_marginal"):
            ask()
    assert pw.otf(partly.coherent, (5e-3, 0.0)) == pw.otf(pupil, (5e-3, 0.0))


PARTLY = SQUARE.partially_coherent(4e-3)
INTENSITY = partial(pw.radiant_intensity, direction=(0, 0, 1), wavelength=WAVELENGTH)
REFUSED = [
    (lambda: pw.fourier(PARTLY, (0.0, 0.0)), "expected"),
    (lambda: pw.coupling(PARTLY, SQUARE, np.eye(4) + np.eye(4, k=3), WAVELENGTH), "expected"),
    (lambda: INTENSITY(SQUARE.partially_coherent(1e-6)), "a coherence width of at least"),
    *[(partial(INTENSITY, SQUARE, bandwidth=b), "bandwidth") for b in (0.0, 2e15, "wide")],
    *[(partial(make, width), "width to be a length above zero")
      for width in (0, -math.inf, math.nan, None, "a", True)
      for make in (SQUARE.partially_coherent, partial(pw.Wavefront, SQUARE, None, None))],
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_what_partly_coherent_light_has_not_is_refused(call, message):
    with pytest.raises((IlluminationError, ArgumentError), match=message):
        call()


@pytest.mark.parametrize(
    "wave", [SQUARE, pytest.param(SQUARE.curved(60e-3, WAVELENGTH), marks=pytest.mark.slow)]
)
def test_rays_of_partly_coherent_light_are_the_mean_over_tilts(wave):
    width = 8e-3
    points = np.array([(0.05, 0.02, 0.3), (0.1, 0.0, 0.2)])
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    nodes, weights = nodes / (2 * math.pi * width), weights / weights.sum()
    flat = pw.Wavefront(SQUARE) if wave is SQUARE else wave
    expected = sum(
        a * b * pw.irradiance(
            flat.on(SQUARE.with_illumination(pw.Illumination([1.0], [(s, t)]))).coherent,
            points, WAVELENGTH, tolerance=1e-6,
        )
        for s, a in zip(nodes, weights, strict=True)
        for t, b in zip(nodes, weights, strict=True)
    )  # fmt: skip
    partly = wave.partially_coherent(width)
    result = pw.irradiance(partly, points, WAVELENGTH, tolerance=1e-7)
    assert np.allclose(result, expected, rtol=1e-6, atol=0)
    ahead = np.array([(0.0, 0.0, 0.3)])
    paper = pw.irradiance(partly, ahead, WAVELENGTH, obliquity="paper")
    assert np.allclose(paper, pw.irradiance(partly, ahead, WAVELENGTH), rtol=1e-2)
    band = pw.irradiance(partly, points, WAVELENGTH, bandwidth=1e6)
    assert np.allclose(band, result, rtol=1e-3)


def test_a_command_computes_the_irradiance_of_a_mixture(tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    outline = tmp_path / "square.wkt"
    outline.write_text("POLYGON((-5 -5,5 -5,5 5,-5 5,-5 -5))")
    place = "-40 mm, 0 mm, 300 mm to 40 mm, 0 mm, 300 mm"
    asked = ["--coherence", "60 mm", "--bandwidth", "500 MHz", "--method", "rayleigh-sommerfeld-1"]
    asked += ["--line", place, "--samples", "3", "--wavelength", "3.2 mm", "--out", str(tmp_path)]
    assert main(["propagate", str(outline), *asked]) == 0
    x = np.linspace(-0.04, 0.04, 3)
    points = np.stack([x, 0 * x, np.full_like(x, 0.3)], axis=-1)
    with xarray.open_dataset(tmp_path / "square.nc") as result:
        values = result["rayleigh-sommerfeld-1"].values
    partly = SQUARE.partially_coherent(60e-3)
    expected = pw.irradiance(partly, points, WAVELENGTH, "rayleigh-sommerfeld-1", bandwidth=5e8)
    assert np.allclose(values, expected, rtol=1e-6)


@pytest.mark.parametrize(
    "source", [CHEVRONS, ARRAY, SLITS, SQUARE.curved(60e-3, WAVELENGTH)],
    ids=["chevrons", "array", "slits", "curved"],
)  # fmt: skip
@pytest.mark.parametrize("angle", [0.3])
def test_w_and_a_of_partly_coherent_light_are_constant_along_rays(source, angle):
    """A first-order system converts tilts of the source to shifts."""
    d = len(source.bounds) // 2
    lens = pw.FirstOrder.lens((0.1, 0.3), angle if d == 2 else 0.0)
    system = pw.FirstOrder.free_space(0.05) @ lens @ pw.FirstOrder.free_space(0.02)
    blocks = (system.A, system.B, system.C, system.D)
    a, b, c, e = (block[:d, :d] for block in blocks)
    draw = np.random.default_rng(7)
    x, nu = draw.uniform(-3e-3, 4e-3, (6, d)), draw.normal(0, 100, (6, d))
    x_behind = x @ a.T + WAVELENGTH * nu @ b.T
    nu_behind = x @ c.T / WAVELENGTH + nu @ e.T
    partly = source.partially_coherent(4e-3)
    energy = float(np.real(pw.lag_marginal(source, np.zeros(d))))
    how: Any = {"through": system, "wavelength": WAVELENGTH}
    w = pw.wigner(partly, x_behind, nu_behind, **how) - pw.wigner(partly, x, nu)
    shift = pw.ambiguity(partly, nu_behind, x_behind, **how) - pw.ambiguity(partly, nu, x)
    assert np.abs(w).max() <= CLOSED_FORM * energy
    assert np.abs(shift).max() <= CLOSED_FORM * energy


@pytest.mark.llvm
def test_a_of_drjit_arrays_is_refused_in_partly_coherent_light():
    llvm = pytest.importorskip("drjit.llvm")
    point = llvm.Array2f64([0.0], [0.0])
    with pytest.raises(ArgumentError, match=r"upsilon to be a NumPy array.*upsilon\.numpy"):
        pw.ambiguity(SQUARE.partially_coherent(4e-3), point, point)
