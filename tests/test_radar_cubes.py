"""Data cubes of radars against the radar equation, received power and scene geometry."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import diric

import polywigner as pw
from mitsuba_scenes import rectangle, shifted, spectrum
from polywigner import radar
from polywigner.errors import ArgumentError, QuantityError, SceneError

pytestmark = [
    pytest.mark.drjit,
    pytest.mark.llvm,
    pytest.mark.usefixtures("few_batches"),
]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

CENTRE = 76.5e9
WAVELENGTH = pw.SPEED_OF_LIGHT / CENTRE
PATCH = pw.shapes.rectangle(1.5e-3, 8e-3)
CHIRPS = radar.FMCW(76e9, 1e9, 256, 20e6, 64, 60e-6)
SHORT = radar.FMCW(76e9, 1e9, 128, 20e6, 4)
POWER = 0.01
LEG = 40e-3


@pytest.fixture(autouse=True)
def _variant():
    mi.set_variant(pm.choose_variant())


def row(count, spacing=WAVELENGTH / 2):
    return pw.phased_array(PATCH, pw.arrays.grid_positions(count, 1, spacing))


def scene_of(source=PATCH, emitters=((0.0, 0.0, 0.0),), receiver_at=(0.02, 0.0, 0.0), **things):
    """Return a scene of emitters next to a receiver, which all point along z."""
    entries = {"type": "scene", "integrator": {"type": "path", "max_depth": 2}}
    for k, place in enumerate(emitters):
        entries[f"tx{k}"] = pm.aperture(
            PATCH, WAVELENGTH, to_world=shifted(*place), power=POWER, estimator="exact"
        )
    entries["rx"] = pm.receiver(
        source, WAVELENGTH, to_world=shifted(*receiver_at), temperature=290.0, noise_figure=12.0,
        bandwidth=20e6, estimator="exact",
    )  # fmt: skip
    return mi.load_dict(entries | things, optimize=False)


ROUGH = {"type": "diffuse", "reflectance": spectrum(0.5)}


def plate(distance, size, x=0.0):
    """Return a rough plate that faces the radar."""
    return rectangle([x, 0, distance], [0, 1, 0], 180, size, ROUGH)


def trihedral(position):
    """Return a corner reflector that faces the origin, as plates in the frame of the scene."""
    triangle = pw.Aperture(np.array([[0, 0], [LEG, 0], [0, LEG]]))
    away = np.asarray(position, float) / np.linalg.norm(position)
    x = np.cross([0.0, 1.0, 0.0], away)
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(away, x), away], axis=1)
    # Axes of the frame in which (1, 1, 1) points back to the radar.
    first = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    back = -np.ones(3) / np.sqrt(3)
    local = np.stack([first, np.cross(back, first), back])
    plates = []
    for k in range(3):
        pose = np.eye(4)
        pose[:3, :3] = axes @ local @ np.roll(np.eye(3), k, axis=0)
        pose[:3, 3] = position
        plates.append(triangle.placed(pose))
    return plates


def peak_of(image, nearest=1.0):
    """Return the rate in m/s, range in m and power in W of the largest peak beyond a distance."""
    values = image.where(image["range"] > nearest, 0.0).values
    row, column = np.unravel_index(values.argmax(), values.shape)

    def vertex(levels, axis, k):
        a, b, c = np.sqrt(levels[k - 1 : k + 2])
        return axis[k] + (a - c) / (2 * (a - 2 * b + c)) * (axis[1] - axis[0])

    rate = vertex(values[:, column], image["range_rate"].values, row)
    return rate, vertex(values[row], image["range"].values, column), values[row, column]


def gain(direction):
    theta = np.arccos(direction[2] / np.linalg.norm(direction))
    level = pw.radiation_pattern(PATCH, WAVELENGTH, theta, 0.0)["directivity"]
    return 10 ** (float(level[0, 0]) / 10)


@pytest.fixture(scope="module")
def corner():
    """Return the cube of a receding corner reflector at 12.34 m and 10 degrees."""
    mi.set_variant(pm.choose_variant())
    position = 12.34 * np.array([np.sin(np.radians(10)), 0.0, np.cos(np.radians(10))])
    cube = pm.radar_cube(
        scene_of(row(2)), CHIRPS, bodies={"corner": (trihedral(position), 3)}, elements=True,
        velocities={"corner": 3.1 * position / 12.34}, points=0, noise=False,
    )  # fmt: skip
    return position, cube


def test_a_corner_reflector_appears_at_its_range_rate_and_level(corner):
    position, cube = corner
    image = radar.range_doppler(cube, pad=8).isel(draw=0, receiver=0, emitter=0)
    rate, distance, level = peak_of(image)
    middle = (CHIRPS.chirps - 1) / 2 * CHIRPS.interval
    element = np.array([0.02, 0, 0]) + cube["receiver_position"].values[0]
    moved = position * (1 + 3.1 * middle / 12.34)
    expected = (np.linalg.norm(moved) + np.linalg.norm(moved - element)) / 2
    assert abs(rate - 3.1) < 0.02 * CHIRPS.rate_step
    assert abs(distance - expected) < 0.01 * CHIRPS.range_step
    section = pw.rcs(trihedral(position), -position / 12.34, WAVELENGTH, bounces=3)
    equation = POWER * gain(position) ** 2 * WAVELENGTH**2 * section
    equation /= (4 * np.pi) ** 3 * 12.34**4
    assert abs(10 * np.log10(level / equation)) < 0.1


def test_phases_across_elements_follow_the_direction(corner):
    position, cube = corner
    spectra = np.fft.fft(cube["signal"].values[0, :, 0, 0] * np.hanning(256))
    column = np.abs(spectra[0, 10:]).argmax() + 10
    steps = np.angle(spectra[1:, column] / spectra[:-1, column], deg=True)
    away = position - [0.02, 0, 0]
    sine = away[0] / np.linalg.norm(away)
    assert np.abs(steps + 360 * sine * WAVELENGTH / 2 / CHIRPS.wavelength).max() < 0.5


def test_four_virtual_elements_resolve_the_angle():
    """The array factor (sin(2 p)/(4 sin(p/2)))^2 is 1/2 at p = pi sin(theta) = 0.715."""
    emitters = [(2e-2 + 2 * k * WAVELENGTH / 2, 0.0, 0.0) for k in range(2)]
    sine, cosine = np.sin(np.radians(10)), np.cos(np.radians(10))
    position = 50.0 * np.array([sine, 0.0, cosine])
    facing = np.eye(4)
    facing[:3] = np.c_[[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine], position]
    waveform = replace(CHIRPS, chirps=8)
    rate = waveform.rate_step / 2  # centre of a bin, for two emitters
    cube = pm.radar_cube(
        scene_of(row(2), emitters, (0.0, 0.0, 0.0)), waveform, elements=True, points=0, noise=False,
        bodies={"plate": pw.shapes.square(LEG).placed(facing)},
        velocities={"plate": (0.0, 0.0, rate)},
    )  # fmt: skip
    assert cube["start_time"].values == pytest.approx([0.0, waveform.interval])
    image = radar.range_angle(cube, window="boxcar", directions=2001).isel(draw=0)
    cut = image.where(image["range"] > 20.0, 0.0).max("range")
    angles = np.degrees(np.arcsin(cut["direction_cosine"].values))
    centre = np.mean(emitters, axis=0)[0] / 2
    seen = np.degrees(np.arctan2(position[0] - centre, position[2]))
    assert abs(angles[int(cut.values.argmax())] - seen) < 0.1
    lit = np.sin(np.radians(angles[cut.values > cut.values.max() / 2]))
    assert np.ptp(lit) == pytest.approx(2 * 0.715 / np.pi, rel=0.02)


def test_mean_range_bins_are_the_range_profile():
    """Without a window, a bin contains the profile times the squared Dirichlet kernel."""
    pytest.importorskip("mitransient")
    scene = scene_of(
        board=plate(3.0, 0.4), wall=rectangle([1.5, 0, 5.0], [0, 1, 0], 200, 1.0, ROUGH)
    )
    waveform = radar.FMCW(76e9, 1e9, 64, 20e6)
    cube = pm.radar_cube(scene, waveform, points=4000, draws=200, noise=False)
    values = radar.range_doppler(cube, "boxcar").values[:, 0, 0, 0]
    edges = np.linspace(0, 64 * waveform.range_step, 2049)
    profile = pm.range_profile(scene, edges, spp=1 << 15)
    offset = np.subtract.outer(np.arange(64), profile["range"].values / waveform.range_step)
    kernel = diric(2 * np.pi / 64 * offset, 64) ** 2
    expected = kernel @ profile["scattered_power"].values
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    strong = expected > 1e-3 * expected.max()
    assert strong.sum() > 10
    deviation = (values.mean(axis=0) - expected)[strong]
    assert (np.abs(deviation) < 4 * error[strong] + 0.02 * expected[strong]).all()


def test_large_cubes_are_lazy(monkeypatch):
    scene, options = scene_of(row(2), board=plate(3.0, 0.4)), {"points": 500, "draws": 2}
    complete = pm.radar_cube(scene, SHORT, elements=True, **options)
    monkeypatch.setattr("polywigner.mitsuba.radar.radar_cubes._MOST_BYTES", 0)
    lazy = pm.radar_cube(scene, SHORT, elements=True, **options)
    assert lazy["signal"].chunks[:2] == ((1, 1), (2,))
    assert np.array_equal(lazy["signal"].values, complete["signal"].values)


@pytest.mark.parametrize("spread", [0.01, 0.4])
def test_sums_over_scatterers_equal_the_plain_sum(spread):
    """Elements over 40 cm and points at up to 60 m/s keep the tolerance of 1e-6."""
    from polywigner.mitsuba.radar import radar_cubes

    rng = np.random.default_rng(0)
    waveform = radar.FMCW(76e9, 1e9, 64, 5e6, 3, 60e-6)
    count = 300
    delays, excess = rng.uniform(6e-8, 9e-7, count), rng.uniform(-1, 1, (3, count)) * spread / 3e8
    rates = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(-4e-7, 4e-7, count))
    responses = rng.normal(size=(3, count)) + 1j * rng.normal(size=(3, count))
    times = 1e-5 + 60e-6 * np.arange(4)[None]
    ends = radar_cubes._Radar(waveform, [], [], np.empty(0), times, CENTRE)
    cloud = radar_cubes._Cloud(responses, np.ones((1, count)), delays[None], rates, excess)
    result = radar_cubes._scattered_signal(ends, cloud, np.ones(count), 0)
    f = waveform.frequencies
    for m in range(3):
        tau = delays[:, None] + rates[:, None] * (times[0, m] + waveform.times)
        for k in range(3):
            turns = f * tau - CENTRE * delays[:, None] + (f - CENTRE) * excess[k][:, None]
            expected = responses[k] @ np.exp(2j * np.pi * turns)
            assert np.abs(result[k, m] - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.slow
def test_elements_receive_the_power_of_single_receivers():
    scene = scene_of(row(3), board=plate(3.0, 0.4))
    cube = pm.radar_cube(scene, SHORT, points=4000, draws=100, noise=False, elements=True)
    draws = (np.abs(cube["signal"].values) ** 2).mean(axis=(2, 3, 4))
    single = float(pm.received_power(scene_of(board=plate(3.0, 0.4)), spp=1 << 16))
    error = draws.std(axis=0, ddof=1) / np.sqrt(len(draws))
    assert (np.abs(draws.mean(axis=0) - single) < 3 * error + 0.01 * single).all()


def test_emitters_are_coherent_at_shared_scatterers():
    """A small plate has a single phase, so emitters differ only in their path lengths."""
    emitters = [(0.0, 0.0, 0.0), (0.03, 0.0, 0.0)]
    target = np.array([0.5, 0.0, 4.0])
    scene = scene_of(emitters=emitters, dot=plate(4.0, 0.002, x=0.5))
    cube = pm.radar_cube(scene, SHORT, points=2000, draws=50, noise=False, multiplexing="none")
    first, second = np.moveaxis(cube["signal"].values[:, 0, :, 0], 1, 0)
    ratio = (second * first.conj()).sum() / (np.abs(first) ** 2).sum()
    lengths = [np.linalg.norm(target - e) for e in emitters]
    expected = 2 * np.pi * (lengths[1] - lengths[0]) / SHORT.wavelength
    assert abs(np.angle(ratio * np.exp(-1j * expected))) < 0.1
    assert abs(ratio) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("mover", ["tx0", "rx", "board"])
def test_motion_of_any_part_gives_its_rate(mover):
    speed = 5.0
    cube = pm.radar_cube(
        scene_of(board=plate(6.0, 0.05)), CHIRPS, points=2000, noise=False,
        velocities={mover: (0.0, 0.0, speed)},
    )  # fmt: skip
    image = radar.range_doppler(cube, pad=4).isel(draw=0, receiver=0, emitter=0)
    rate, distance, _ = peak_of(image)
    expected = speed if mover == "board" else -speed / 2
    assert rate == pytest.approx(expected, abs=0.02 * CHIRPS.rate_step)
    assert distance == pytest.approx(6.0, abs=0.1 * CHIRPS.range_step)


def test_a_fast_target_crosses_range_bins_within_the_frame():
    waveform = radar.FMCW(76e9, 1e9, 256, 20e6, 64, 100e-6)
    speed = 2.5 * waveform.range_step / (63 * waveform.interval)
    cube = pm.radar_cube(
        scene_of(board=plate(6.0, 0.05)), waveform, points=2000, noise=False,
        velocities={"board": (0.0, 0.0, speed)},
    )  # fmt: skip
    profiles = np.abs(np.fft.fft(cube["signal"].values[0, 0, 0] * np.hanning(256), 4096))
    bins = profiles[[0, -1], :2048].argmax(axis=1) / 16
    assert np.diff(bins) == pytest.approx(2.5, abs=0.1)


def test_noise_has_the_power_of_the_sampling_rate():
    cube = pm.radar_cube(scene_of(), CHIRPS, points=0, draws=4, reflections=0)
    power = (np.abs(cube["signal"].values) ** 2).mean()
    assert power == pytest.approx(1.380649e-23 * 290 * 20e6 * 10**1.2, rel=0.01)
    image = radar.range_doppler(cube)
    assert float(image.mean()) == pytest.approx(image.attrs["noise_floor"][0], rel=0.02)
    expected = 1e-4
    alarms = float(radar.detections(image, false_alarm=expected).mean())
    assert alarms == pytest.approx(expected, rel=0.7)


@pytest.mark.parametrize(
    "kind", [radar.FMCW, radar.SteppedFrequency, radar.Pulse], ids=lambda kind: kind.__name__
)
def test_all_waveforms_show_a_target_in_the_same_bin(kind):
    rate = 1e9 if kind is radar.Pulse else 1e6
    waveform = kind(76e9, 1e9, 64, rate, 8, 1e-3)
    distance = 20 * waveform.range_step
    cube = pm.radar_cube(scene_of(board=plate(distance, 0.02)), waveform, points=500, noise=False)
    image = radar.range_doppler(cube).isel(draw=0, receiver=0, emitter=0)
    row, column = np.unravel_index(image.values.argmax(), image.shape)
    assert (image["range_rate"].values[row], column) == (0.0, 20)
    if kind is radar.Pulse:  # the cube of a pulse is its range profile
        assert np.abs(cube["signal"].values[0, 0, 0, 0]).argmax() == 20


def test_text_defines_a_waveform():
    text = "76 GHz + 1 GHz, 256 samples at 20 MHz, 64 chirps every 60 us"
    assert radar.parse_waveform(text) == CHIRPS
    pulses = radar.parse_waveform("9.5 GHz + 100 MHz, 512 samples, 16 pulses every 1 ms")
    assert pulses == radar.Pulse(9.5e9, 100e6, 512, 100e6, 16, 1e-3)


@pytest.mark.parametrize(
    ("waveform", "error", "words"),
    [
        ("76 GHz, 64 chirps", ArgumentError, "such as"),
        ("76 GHz + 1 m, 8 samples at 1 MHz, 2 chirps", QuantityError, "GHz"),
        ("90 GHz + 1 GHz, 8 samples at 1 MHz, 2 chirps", SceneError, "band"),
        ("76 GHz + 1 GHz, 8 samples at 1 MHz, 2 chirps every 1 us", ArgumentError, "interval"),
        (3.0, ArgumentError, "such as"),
    ],
)
def test_waveforms_that_do_not_fit_are_errors(waveform, error, words):
    with pytest.raises(error, match=words):
        pm.radar_cube(scene_of(), waveform, points=0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"velocities": {"moon": (0, 0, 1)}}, "moon"),
        ({"points": -1}, "points"),
        ({"draws": 0}, "draws"),
        ({"multiplexing": "code"}, "multiplexing"),
    ],
)
def test_arguments_out_of_range_are_errors(options, words):
    with pytest.raises(ArgumentError, match=words):
        pm.radar_cube(scene_of(board=plate(3.0, 0.4)), SHORT, **{"points": 100, **options})


def test_objects_too_fast_for_the_sums_are_refused():
    """A target at 90 km/s crosses eight range bins within a chirp of 12.8 us."""
    waveform = radar.FMCW(76e9, 1e9, 64, 5e6)
    with pytest.raises(ArgumentError, match="range bins of motion within a repetition"):
        pm.radar_cube(
            scene_of(board=plate(3.0, 0.4)), waveform, velocities={"board": (0, 0, 9e4)}, points=50
        )


@pytest.mark.parametrize("arguments", [(np.zeros((50, 50)),), (None, (2, 2), (80, 8))], ids=str)
def test_maps_and_bins_of_detections_are_checked(corner, arguments):
    image = radar.range_doppler(corner[1])
    with pytest.raises(ArgumentError):
        radar.detections(image if arguments[0] is None else arguments[0], *arguments[1:])
