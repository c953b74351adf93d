"""Curved waves in the transforms against references, quadrature, closed forms and lenses."""

import pickle

import numpy as np
import pytest

import polywigner as pw
from oracles.quadrature import triangle_nodes
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry.aperture import triangulate

WAVELENGTH = 3.2e-3
SQUARE = pw.shapes.square(10e-3)
ELL = pw.Aperture(1e-3 * np.array([(0, 0), (12, 0), (12, 4), (4, 4), (4, 12), (0, 12)]) - 6e-3)
SHAPES = {
    "square": SQUARE,
    "L": ELL,
    "TE10 square": SQUARE.with_illumination(pw.cosine_taper(10e-3)),
}
WAVES = ELL.with_illumination(pw.Illumination([1.0, 0.5j], [(30.0, 10.0), (-50.0, 20.0)]))
SITES = [(0.0, 0.0), (5e-3, 0.0), (1e-3, 6e-3)]
ARRAY = pw.phased_array(pw.shapes.square(3e-3), SITES, [1.0, 0.5j, -0.7])
SOURCES = {"L": ELL, "waves": WAVES, "array": ARRAY}
# Spherical, converging, astigmatic, saddle-shaped, cylindrical, nearly flat and flat waves.
RADII = {
    "spherical": 0.02,
    "converging": -0.05,
    "astigmatic": (0.02, 0.3),
    "saddle": (0.02, -0.03),
    "cylinder": (np.inf, -0.02),
    "nearly flat": (30.0, 2e3),
    "flatter": (1e9, np.inf),
}
CENTRE = (5e-4, -1e-3)

# Rounding error of values and phases, relative to the area.
ROUNDING = 1e-14
# Error of identities of W and A, relative to the area.
IDENTITY = 1e-12


def quadrature(source, field):
    """Integrate over an outline with about ten Gauss nodes per cycle on triangles."""
    corners, numbers = triangulate(source)
    places, weights = triangle_nodes(corners[numbers], 50)
    return complex(weights @ field(places))


def field_of(source, wave):
    def field(x):
        inner = x - wave.centre
        own = 1.0 if source.illumination is None else source.illumination(x)
        return own * np.exp(1j * np.pi * ((inner @ wave.curvature) * inner).sum(axis=-1))

    return field


def draws(count, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(-5e-3, 5e-3, (count, 2)), rng.uniform(-300, 300, (count, 2))


@pytest.mark.parametrize("radius", RADII.values(), ids=RADII)
def test_the_spectrum_is_that_of_quadrature(radius):
    wave = WAVES.curved(radius, WAVELENGTH, CENTRE).turned(0.4)
    turned = wave.source
    for nu in [(0.0, 0.0), (1e-3, 1e-4), (-300.0, 650.0)]:
        field = field_of(turned, wave)
        expected = quadrature(turned, lambda x: field(x) * np.exp(-2j * np.pi * (x @ nu)))  # noqa: B023
        assert abs(pw.fourier(wave, nu) - expected) < ROUNDING * ELL.area


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_a_curved_wave_is_a_lens_directly_behind(source):
    x, nu = draws(30)
    behind = pw.FirstOrder.free_space(0.04)
    for radius in RADII.values():
        lens = pw.FirstOrder.lens(tuple((-np.broadcast_to(radius, 2)).tolist()))
        wave, through = source.curved(radius, WAVELENGTH), {"wavelength": WAVELENGTH}
        for function, points in ((pw.wigner, (x, nu)), (pw.ambiguity, (nu, x))):
            expected = function(source, *points, through=lens, **through)
            assert np.abs(function(wave, *points) - expected).max() < IDENTITY * ELL.area
            system = behind @ lens
            expected = function(source, *points, through=system, **through)
            result = function(wave, *points, through=behind, **through)
            assert np.abs(result - expected).max() < IDENTITY * ELL.area


def test_defocus_of_a_pupil_is_a_curved_wave():
    xi, _ = draws(40)
    radius, pupil = 0.02, 7e-3
    waves = pupil**2 / (2 * WAVELENGTH * radius)
    curved = ELL.curved(radius, WAVELENGTH)
    defocused = pw.otf(ELL, xi, waves, pupil)
    assert np.abs(pw.otf(curved, xi) - defocused).max() < IDENTITY
    assert np.abs(pw.otf(curved, xi, -waves, pupil) - pw.otf(ELL, xi)).max() < IDENTITY
    frequency = xi / (WAVELENGTH * 0.1)
    result = pw.mtf(curved, frequency, WAVELENGTH, 0.1)
    assert np.abs(result - np.abs(defocused)).max() < IDENTITY


def test_arrays_of_curved_elements_add_up():
    element = SHAPES["TE10 square"].scaled(0.3).curved((0.01, -0.02), WAVELENGTH, (1e-4, 2e-4))
    weights = np.array([1.0, 0.5j, -0.7])
    x, nu = draws(10)
    phases = np.exp(-2j * np.pi * (nu @ np.transpose(SITES)))
    expected = (weights * phases).sum(axis=1) * pw.fourier(element, nu)
    for array in (
        pw.phased_array(element, SITES, weights),
        pw.Array([element.moved(site) for site in SITES], weights),
    ):
        assert isinstance(array, pw.Wavefront)
        assert np.abs(pw.fourier(array, nu) - expected).max() < ROUNDING * ELL.area
        energy = pw.lag_marginal(element, (0.0, 0.0)).real * (abs(weights) ** 2).sum()
        assert pw.lag_marginal(array, (0.0, 0.0)) == pytest.approx(energy, rel=1e-12)
        assert np.array_equal(pw.wigner(array, x, nu).imag, np.zeros(10))
    with pytest.raises(IlluminationError, match="equal curvature"):
        pw.Array([SQUARE.curved(0.02, WAVELENGTH), SQUARE.moved((0.02, 0.0))])


def test_sources_with_curved_waves_are_values():
    wave = WAVES.curved((0.02, np.inf), WAVELENGTH, CENTRE)
    assert pickle.loads(pickle.dumps(wave)) == wave
    assert wave.curved((-0.02, np.inf), WAVELENGTH).is_flat
    assert wave.area == WAVES.area
    assert wave.diameter == WAVES.diameter
    nu, larger = (30.0, -20.0), wave.scaled(2.5)  # F of u(x/s) is s^2 F(s nu)
    scaled = 6.25 * pw.fourier(wave, 2.5 * np.array(nu))
    assert pw.fourier(larger, nu) == pytest.approx(scaled, abs=IDENTITY * ELL.area)
    assert "curvature" in repr(wave)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda wave: pw.fourier(wave, [1j, 0]), "real numbers .*, got complex numbers"),
        (lambda wave: pw.fourier(wave, [0, 1e9]), "phase of the curved wave"),
        (
            lambda wave: pw.amplitude(wave, [0, 0, 1e-9], WAVELENGTH, "fresnel"),
            "phase of the curved wave",
        ),
        (lambda wave: pw.projections(wave), "projections require a source with a flat"),
        (lambda wave: pw.suggest_sampling(wave, "wigner"), "a flat, coherent wave"),
        (lambda wave: pw.wigner(wave, [0, 0, 0], [0, 0]), r"x of shape \(\.\.\., 2\)"),
    ],
)
def test_what_a_curved_wave_has_not_is_refused(call, message):
    with pytest.raises(ArgumentError, match=message):
        call(SQUARE.curved(0.02, WAVELENGTH))


def test_a_wave_needs_a_flat_source_and_a_symmetric_matrix():
    for source in (None, [SQUARE], SQUARE.curved(0.05, WAVELENGTH), SQUARE.placed(np.eye(4))):
        with pytest.raises(ArgumentError, match="expected an Aperture, Slits or an Array"):
            pw.Wavefront(source, np.eye(2))
    for curvature in ("a", 1.0, [[1, 2], [3, 4]]):
        with pytest.raises(IlluminationError, match="symmetric matrix"):
            pw.Wavefront(SQUARE, curvature)


def test_flat_waves_have_no_centre():
    shift = (3e-3, 1e-3)
    wave = SQUARE.curved(0.05, WAVELENGTH, shift).curved(-0.05, WAVELENGTH)
    assert wave == pw.Wavefront(SQUARE)
    first = SQUARE.partially_coherent(2e-3).moved(shift).curved(0.1, WAVELENGTH)
    assert first == SQUARE.moved(shift).partially_coherent(2e-3).curved(0.1, WAVELENGTH)


@pytest.mark.parametrize("name", ["moved", "turned", "scaled", "plot"])
def test_a_wave_on_an_array_says_what_arrays_do_not_have(name):
    wave = pw.phased_array(SQUARE, [(0.0, 0.0), (0.02, 0.0)]).curved(0.05, WAVELENGTH)
    argument = {"moved": (1e-3, 0.0), "turned": 0.3, "scaled": 2.0, "plot": None}[name]
    with pytest.raises(ArgumentError, match=f"an Aperture for {name}"):
        getattr(wave, name)(argument)


@pytest.mark.parametrize("quantity", ["irradiance", "amplitude", "pattern"])
def test_fields_of_all_waves_need_the_samples_of_the_box(quantity):
    place = {} if quantity == "pattern" else {"line": ((-0.02, 0.0, 0.1), (0.02, 0.0, 0.1))}
    flat = pw.suggest_sampling(SQUARE, WAVELENGTH, quantity, **place)
    for wave in (SQUARE.curved(0.05, WAVELENGTH), SQUARE.partially_coherent(4e-3)):
        assert pw.suggest_sampling(wave, WAVELENGTH, quantity, **place) == flat
