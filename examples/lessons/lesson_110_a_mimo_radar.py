r"""
110: A MIMO radar
=================

Three transmitters and four receivers at 77 GHz: seven antennas that see as sharply as twelve. This
lesson goes from the drawing of one antenna to a target that is found. It draws the arrays and their
virtual array, gives them errors, weighs a corner reflector, sets up the link budget, and ends
with signals in noise: at which angle does the reflector stand, and how far out of the noise?
"""

# Before anything else loads Dr.Jit: it looks for an LLVM library that works.
import polywigner.mitsuba  # isort: skip

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
from scipy.stats import ncx2

import polywigner as pw
from polywigner.figures import draw_radar_map

mi.set_variant(polywigner.mitsuba.choose_variant())

LIGHT = 299_792_458
WAVELENGTH = LIGHT / 77e9


def decibels(power):
    """10 log10 of a ratio of powers."""
    return 10 * np.log10(np.maximum(power, 1e-40))


def dbm(power):
    """A power in W as dBm."""
    return decibels(power) + 30


# %%
# The drawing of an antenna
# -------------------------
# Eight patches in a column, each with an inset for its feed line from below; patches at the ends
# are narrower, which lowers sidelobes. The drawing is an SVG file in mm, such as drawing programs
# write. Its filled shapes are the aperture. The field is the same all over them, since all are fed
# in phase.

WIDTHS = [0.7, 1.0, 1.3, 1.4, 1.4, 1.3, 1.0, 0.7]
shapes = "".join(
    f'<path d="M {1 - w / 2} {1.6 + 2.4 * k} h {w} v 1.1 h {-(w / 2 - 0.2)} v -0.3 h -0.1 v 0.3 '
    f'h -0.2 v -0.3 h -0.1 v 0.3 h {-(w / 2 - 0.2)} z"/>'
    for k, w in enumerate(WIDTHS)
)
svg = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="2mm" height="20mm" viewBox="0 0 2 20">'
    f"{shapes}</svg>"
)
with tempfile.TemporaryDirectory() as folder:
    drawing = Path(folder) / "column.svg"
    drawing.write_text(svg)
    read = pw.read_aperture(drawing)
column = read.moved(-read.centre)
print(f"{len(column.polygons.geoms)} patches, {1e6 * column.area:.2f} mm²")
assert len(column.polygons.geoms) == 8

# %%
# The data sheet of this column, for 10 mW:

POWER = 10e-3
theta = np.radians(np.arange(-90, 90.1, 0.25))
pattern = pw.radiation_pattern(column, WAVELENGTH, theta, np.radians([0, 90]))
metrics = pw.beam_metrics(pattern, power=POWER)
print(metrics)
assert abs(metrics.directivity - 16.1) < 0.1
assert abs(np.degrees(metrics.principal_cuts[1].half_power_beamwidth) - 11.8) < 0.1

# %%
# Two arrays and a third
# ----------------------
# Four receivers stand half a wavelength apart. Three transmitters stand four times as far apart,
# which is the length of the row of receivers. A target far away sees the path of transmitter j and
# receiver k as the path of *one* antenna at :math:`x_j + y_k`. There are twelve such places, half a
# wavelength apart: the virtual array. The transmitters send one after the other, so that
# the receivers know whose echo they hear.

HALF = WAVELENGTH / 2
offset = np.array([[7.5e-3, 0.0]])
receive = pw.arrays.grid_positions(4, 1, HALF) - offset
transmit = pw.arrays.grid_positions(3, 1, 4 * HALF) + offset
virtual, _ = pw.arrays.virtual_array(transmit, receive)
assert len(virtual) == 12 and np.allclose(np.diff(virtual[:, 0]), HALF)
transmitter, receiver = (pw.phased_array(column, places) for places in (transmit, receive))

figure, (left, right) = plt.subplots(
    1, 2, figsize=(10, 4), layout="constrained", width_ratios=(1.1, 1)
)
for places, colour, name in ((transmit, "C0", "transmit"), (receive, "C3", "receive")):
    for k, spot in enumerate(places):
        for i, patch in enumerate(column.moved(spot).polygons.geoms):
            label = name if k == i == 0 else None
            left.fill(*(1e3 * np.array(patch.exterior.xy)), colour, label=label)
left.plot(1e3 * virtual[:, 0], np.full(12, -12.0), "s", color="C2", ms=4, label="virtual")
left.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)", xlim=(-18, 18), ylim=(-15, 16))
left.set_title("The board, and places of the virtual array")
left.legend(loc="upper center", ncols=3, fontsize="small")
for k, name in enumerate(("azimuth", "elevation")):
    right.plot(np.degrees(theta), pattern["directivity"].values[:, k], label=name)
right.set(
    xlabel="angle from the normal (degrees)",
    ylabel="directivity (dBi)",
    xlim=(-90, 90),
    ylim=(-30, 20),
    title="One column",
)
right.legend(loc="lower center", ncols=2, fontsize="small")

# %%
# Both ways
# ---------
# ``pw.two_way_pattern`` multiplies the patterns of both arrays. The transmitters, two wavelengths
# apart, have grating lobes at :math:`\sin\theta = \pm 1/2`, where the receivers have nulls. What is
# left is the pattern of twelve elements, exactly: the squared field of a column times the array
# factor of the virtual array.

two_way = pw.two_way_pattern(transmitter, receiver, WAVELENGTH, theta, 0.0)
nu = np.stack([np.sin(theta), 0 * theta], axis=-1) / WAVELENGTH
product = pattern["field"].values[:, 0] ** 2 * pw.array_factor(virtual, np.ones(12), nu)
error = np.abs(two_way["field"].values[:, 0] - product).max() / np.abs(product).max()
print(f"both ways against the virtual array: {error:.0e} of the peak")
assert error < 1e-12

figure, axes = plt.subplots(figsize=(8, 3.8), layout="constrained")
for part, label, colour, width in (
    ("transmit", "transmitters", "C0", 1),
    ("receive", "receivers", "C3", 1),
    ("two_way", "both ways", "C2", 2),
):
    level = two_way[part].values[:, 0]
    axes.plot(np.degrees(theta), level - level.max(), colour, lw=width, label=label)
axes.set(
    xlabel="azimuth (degrees)",
    ylabel="level relative to the peak (dB)",
    xlim=(-90, 90),
    ylim=(-50, 10),
    title="3 transmitters, 4 receivers",
)
axes.legend(ncols=3, loc="upper center", fontsize="small")

# %%
# The beam of twelve elements at a pitch d is :math:`0.886\,\lambda/(12\,d)` wide.

fine = np.radians(np.arange(-20, 20, 0.01))
level = pw.two_way_pattern(transmitter, receiver, WAVELENGTH, fine, 0.0)["two_way"].values[:, 0]
beam = np.degrees(np.ptp(fine[level > level.max() - decibels(2)]))
rule = np.degrees(0.886 * WAVELENGTH / (12 * HALF))
print(f"beam {beam:.2f} degrees wide, by the rule {rule:.2f}")
assert abs(beam / rule - 1) < 0.02

# %%
# Errors
# ------
# Chips and feed lines have errors, here of 0.5 dB and 6 degrees rms. ``pw.array_tolerance`` knows
# the mean over all arrays with such errors in closed form. Errors of transmitters and receivers are
# independent, so means multiply: the expected levels of both arrays add up in dB. Dots in the
# picture are means of 4000 draws.
#
# A radar has *seven* errors, not twelve. The error of a transmitter is common to four virtual
# elements, and it does not average out where these four are in phase. At its grating lobes, 30
# degrees aside, mean sidelobes are three times as strong as twelve independent errors would
# make them.

ERRORS = {"amplitude": 0.5, "phase": np.radians(6)}
angles = np.radians(np.arange(-90, 90.1, 0.5))
runs = [
    pw.array_tolerance(array, WAVELENGTH, angles, 0.0, **ERRORS, count=100, seed=1)
    for array in (transmitter, receiver, pw.phased_array(column, virtual))
]
levels = {
    kind: [run[kind].values[:, 0] - run["nominal"].values.max() for run in runs]
    for kind in ("nominal", "expected")
}
of_column = np.interp(angles, theta, pattern["directivity"].values[:, 0] - metrics.directivity)
nominal = levels["nominal"][0] + levels["nominal"][1]
seven = levels["expected"][0] + levels["expected"][1]
twelve = levels["expected"][2] + of_column

rng = np.random.default_rng(110)
factors = [
    10 ** (ERRORS["amplitude"] / 20 * rng.standard_normal((4000, n)))
    * np.exp(1j * ERRORS["phase"] * rng.standard_normal((4000, n)))
    for n in (3, 4)
]
waves = [
    np.exp(-2j * np.pi / WAVELENGTH * np.outer(places[:, 0], np.sin(angles)))
    for places in (transmit, receive)
]
draws = np.abs((factors[0] @ waves[0]) * (factors[1] @ waves[1])) ** 2
mean_of_draws = decibels(draws.mean(axis=0) / 144) + 2 * of_column
strong = seven > -50
rise = np.interp(np.radians(30), angles, seven - twelve)
print(f"draws off by {np.abs(mean_of_draws - seven)[strong].max():.2f} dB at most")
print(f"at 30 degrees {rise:.2f} dB above twelve independent errors")
assert np.abs(mean_of_draws - seven)[strong].max() < 0.5
assert abs(rise - decibels(3)) < 0.1

figure, axes = plt.subplots(figsize=(8, 3.8), layout="constrained")
axes.plot(np.degrees(angles), nominal, "0.6", lw=1, label="no errors")
axes.plot(np.degrees(angles), twelve, "C1--", label="mean, 12 independent errors")
axes.plot(np.degrees(angles), seven, "C0", label="mean, errors of 3 + 4 antennas")
axes.plot(np.degrees(angles[::10]), mean_of_draws[::10], "C0.", label="mean of 4000 draws")
axes.set(
    xlabel="azimuth (degrees)",
    ylabel="two-way level (dB rel. to the peak)",
    xlim=(-90, 90),
    ylim=(-55, 2),
    title="Errors of 0.5 dB and 6° rms",
)
axes.legend(loc="upper left", fontsize="small")

# %%
# A corner reflector
# ------------------
# The target is a corner reflector with legs of 40 mm, ten wavelengths. Its echo comes by three
# reflections, and ``pw.rcs`` follows them as polygons of physical optics. Textbooks have
# :math:`4\pi a^4/(3\lambda^2)` on the axis; echoes of one and two reflections add 0.3 dB here. At
# 39 degrees the radar looks along one face, and the other two are a corner of their own.

LEG = 40e-3
triangle = pw.Aperture(np.array([[0, 0], [LEG, 0], [0, LEG]]))
poses = np.tile(np.eye(4), (3, 1, 1))
for k, pose in enumerate(poses):
    pose[:3, :3] = np.roll(np.eye(3), k, axis=0)  # x and y of a plate become two of the axes
plates = [triangle.placed(pose) for pose in poses]
turn = np.radians(np.arange(-45, 45.1, 0.5))
axis, aside = np.array([1, 1, 1]) / np.sqrt(3), np.array([-1, 1, 0]) / np.sqrt(2)
towards = np.cos(turn)[:, None] * axis + np.sin(turn)[:, None] * aside
sections = {n: pw.rcs(plates, towards, WAVELENGTH, bounces=n) for n in (2, 3)}
closed = 4 * np.pi * LEG**4 / (3 * WAVELENGTH**2)
sigma = sections[3][len(turn) // 2]
print(f"on its axis {decibels(sigma):.2f} dBsm, textbooks {decibels(closed):.2f} dBsm")
assert abs(decibels(sigma / closed)) < 0.3

figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for n, label in ((3, "up to three reflections"), (2, "up to two")):
    axes.plot(np.degrees(turn), decibels(sections[n]), label=label)
axes.axhline(decibels(closed), color="black", lw=0.7, ls=":", label=r"$4\pi a^4/(3\lambda^2)$")
axes.set(
    xlabel="angle from its axis (degrees)",
    ylabel="radar cross section (dBsm)",
    xlim=(-45, 45),
    ylim=(-55, 5),
    title="Corner reflector with legs of 40 mm at 77 GHz",
)
axes.legend(fontsize="small", loc="center", bbox_to_anchor=(0.5, 0.58))

# %%
# The link budget
# ---------------
# From one transmitter by a target at the distance R to one receiver, with the directivity G of a
# column, the *radar equation* is
#
# .. math:: P_r = P\,\frac{G^2\,\lambda^2\,\sigma}{(4\pi)^3 R^4}
#
# Noise has :math:`kTF` for each hertz. A chirp sweeps 600 MHz in 25.6 microseconds and gives 256
# complex samples at 10 MHz; each transmitter sends 16 chirps. The sum over all samples of a
# channel takes 36 dB off the noise, the sum over twelve channels 11 dB more.

SWEEP, RATE, SAMPLES, CHIRPS = 600e6, 10e6, 256, 16
TEMPERATURE, NOISE_FIGURE = 290.0, 12.0
BOLTZMANN = 1.380649e-23
noise_per_sample = BOLTZMANN * TEMPERATURE * RATE * 10 ** (NOISE_FIGURE / 10)
noise = noise_per_sample / (SAMPLES * CHIRPS)


def gain(azimuth):
    """Directivity of a column in the horizontal plane, as a factor."""
    level = pw.radiation_pattern(column, WAVELENGTH, azimuth, 0.0)["directivity"].values
    return 10 ** (level[0, 0] / 10)


def radar_equation(section, distance, azimuth=0.0):
    """Received power in W of one transmitter and one receiver."""
    share = WAVELENGTH**2 * section / ((4 * np.pi) ** 3 * distance**4)
    return POWER * gain(azimuth) ** 2 * share


RANGE, AZIMUTH = 24.0, np.radians(14.0)
expected = radar_equation(sigma, RANGE, AZIMUTH)
budget = expected / noise * 12
for name, value in (
    ("power sent", f"{dbm(POWER):8.1f} dBm"),
    ("directivity, twice", f"{2 * decibels(gain(AZIMUTH)):8.1f} dBi"),
    ("cross section", f"{decibels(sigma):8.1f} dBsm"),
    ("power received at 24 m", f"{dbm(expected):8.1f} dBm"),
    ("noise of a sample", f"{dbm(noise_per_sample):8.1f} dBm"),
    ("256 x 16 samples", f"{decibels(SAMPLES * CHIRPS):8.1f} dB"),
    ("12 channels", f"{decibels(12):8.1f} dB"),
    ("signal to noise", f"{decibels(budget):8.1f} dB"),
):
    print(f"{name:24}{value}")
assert abs(decibels(budget) - 42.8) < 0.2

# %%
# Where does the equation hold? It takes the target as a point. A metal plate of D = 0.2 m that
# faces the radar is one beyond :math:`2D^2/\lambda`, 21 m. Next to the radar it is a mirror, which
# shows the radar itself at twice the distance. ``pw.rcs(source=)`` integrates the exact
# field of the antenna over the plate and knows all between. The equation promises 24 dB too much
# at 1.5 m. About the mirror's law the echo swings by 5 dB, as Fresnel zones come and go.

SIDE = 0.2
metal = pw.shapes.square(SIDE)
border = 2 * SIDE**2 / WAVELENGTH
distances = 1 / np.linspace(1 / 1.5, 1 / 100, 20)  # even steps in Fresnel zones
straight = np.stack([0 * distances, 0 * distances, distances], axis=-1)
exact = (
    POWER * pw.rcs(metal, straight, WAVELENGTH, source=column, return_power=True, tolerance=1e-2)[1]
)
far = radar_equation(4 * np.pi * SIDE**4 / WAVELENGTH**2, distances)
image = POWER * (gain(0.0) * WAVELENGTH / (8 * np.pi * distances)) ** 2
print(f"radar equation: {decibels(far / exact)[0]:.1f} dB too much at 1.5 m,")
print(f"{decibels(far / exact)[distances > border].max():.2f} dB at most beyond {border:.0f} m")
assert decibels(far / exact)[0] > 20
assert np.abs(decibels(far / exact))[distances > border].max() < 0.6
assert np.abs(decibels(exact / image))[distances < border / 2].max() < 6

figure, axes = plt.subplots(figsize=(9.5, 4), layout="constrained")
axes.semilogx(distances, dbm(exact), "C0", label="metal plate, exact")
axes.semilogx(distances, dbm(far), "C0--", lw=1, label="metal plate, radar equation")
axes.semilogx(distances, dbm(image), "C0:", lw=1, label="the radar's image in a mirror")
axes.semilogx(distances, dbm(radar_equation(sigma, distances)), "C1", label="corner reflector")
axes.axhline(dbm(noise_per_sample), color="0.5", lw=1, label="noise of a sample")
axes.axhline(dbm(noise / 12), color="0.5", lw=1, ls="--", label="noise after all sums")
axes.axvline(border, color="black", lw=0.6)
axes.text(border * 1.04, -28, r"$2D^2/\lambda$ of the plate")
axes.set(
    xlabel="distance (m)",
    ylabel="received power (dBm)",
    xlim=(1.5, 100),
    ylim=(-145, -20),
    title="Two targets on the normal, 10 mW",
)
figure.legend(loc="outside right upper", fontsize="small")

# %%
# The yard
# --------
# The reflector stands in a yard, 24 m from the radar and 14 degrees to one side. The yard is a
# scene in Mitsuba with rough surfaces: a board of 0.4 m, which faces the radar 12 m away on the
# other side, a wall at 32 m, and the ground. The reflector is only ten wavelengths in size, so rays
# cannot give its echo. It is no part of the scene and is added as a conducting body below.

BOARD, BOARD_AZIMUTH, BOARD_SIDE, BOARD_ALBEDO = 12.0, np.radians(-18.0), 0.4, 0.3
HEIGHT = 1.0
transform = mi.ScalarTransform4f
look = transform().look_at([0, 0, HEIGHT], [1, 0, HEIGHT], [0, 0, 1])
frame = np.array(look.matrix)[:3, :3]  # columns: the radar's x, y and z in the yard


def at(distance, azimuth):
    """Return a point in the yard at the height of the radar."""
    x, y, z = distance * (np.sin(azimuth) * frame[:, 0] + np.cos(azimuth) * frame[:, 2])
    return [x, y, z + HEIGHT]


def rough(albedo):
    """Return a diffuse surface."""
    reflectance = {"type": "spectrum", "value": albedo}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def yard(transmitters, receiving):
    """Return the scene with a column at each position in m, and one receiver."""
    emitters = {
        f"tx{k}": polywigner.mitsuba.aperture(
            column.moved(position), WAVELENGTH, to_world=look, power=POWER, estimator="exact"
        )
        for k, position in enumerate(transmitters)
    }
    receiver = polywigner.mitsuba.receiver(
        receiving, WAVELENGTH, to_world=look, bandwidth=RATE, temperature=TEMPERATURE,
        noise_figure=NOISE_FIGURE,
    )  # fmt: skip
    facing = transform().look_at(at(BOARD, BOARD_AZIMUTH), [0, 0, HEIGHT], [0, 0, 1])
    board, wall, ground = (
        {"type": "rectangle", "to_world": to_world, "bsdf": rough(albedo)}
        for to_world, albedo in (
            (facing.scale(BOARD_SIDE / 2), BOARD_ALBEDO),
            (transform().translate([32, 0, 2]).rotate([0, 1, 0], -90).scale([2, 10, 1]), 0.3),
            (transform().translate([16, 0, 0]).scale([16, 10, 1]), 0.03),
        )
    )
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},  # one reflection
            **emitters,
            "rx": receiver,
            "board": board,
            "wall": wall,
            "ground": ground,
        },
        optimize=False,
    )


# %%
# ``range_profile`` gives the mean power that one receiver gets from one transmitter, by range, in
# the bins of the chirp, which are :math:`c/(2B)` = 0.25 m wide. A rough surface of the albedo
# :math:`\varrho` and the area A that faces the radar has the mean cross section
# :math:`4\varrho A`. The radar equation holds for the board. The wall is too wide for it: its ends
# are farther away, seen at an angle, and out of the beam. As a point, it would return 2 dB more.

CELL = LIGHT / (2 * SWEEP)
edges = (np.arange(160) + 0.5) * CELL  # bin centres are whole numbers of cells
profile = polywigner.mitsuba.range_profile(yard([[0, 0]], column), edges, spp=1 << 20)
distance, power = profile["range"].values, profile["scattered_power"].values
assert np.isclose(float(profile["noise_power"]), noise_per_sample, rtol=1e-9)

at_board = np.abs(distance - BOARD) < 1.5 * CELL
ground = np.median(power[(np.abs(distance - BOARD) < 6 * CELL) & ~at_board])
by_rays = power[at_board].sum() - ground * at_board.sum()
by_equation = radar_equation(4 * BOARD_ALBEDO * BOARD_SIDE**2, BOARD, BOARD_AZIMUTH)
ratios = [decibels(each / noise_per_sample) for each in (by_rays, by_equation)]
print(f"board: signal to noise of a sample {ratios[0]:.2f} dB, radar equation {ratios[1]:.2f} dB")
assert abs(ratios[0] - ratios[1]) < 0.2
behind = power[distance > 31.9].sum()
as_point = radar_equation(4 * 0.3 * 4 * 20, 32.0)
print(f"wall: {dbm(behind):.2f} dBm, as a point {dbm(as_point):.2f} dBm")
assert 1.5 < decibels(as_point / behind) < 2.5

figure, axes = plt.subplots(figsize=(8.5, 3.8), layout="constrained")
axes.stairs(dbm(power), edges, label="board, wall and ground by rays", baseline=None)
axes.plot(BOARD, dbm(by_equation), "o", mfc="none", mec="C3", ms=10, label="board, radar equation")
axes.plot(RANGE, dbm(expected), "v", color="C1", label="corner reflector, radar equation")
axes.axhline(dbm(noise_per_sample), color="0.5", label="noise of a sample")
axes.axhline(dbm(noise), color="0.5", ls=":", label="noise after 256 x 16 samples")
axes.set(
    xlabel="range (m)",
    ylabel="received power in a bin (dBm)",
    xlim=(0, 40),
    ylim=(-140, -65),
    title="One transmitter, one receiver, 10 mW",
)
axes.legend(fontsize="small", loc="upper right", ncols=2)

# %%
# Signals
# -------
# ``radar_cube`` computes the complex samples of all antennas: the leakage, the echo of the
# reflector with its phase at each antenna, the rough surfaces as speckle, and noise. The
# transmitters take turns. ``elements=True`` records each column of the receiving row. Signals add
# up, so the echo of the reflector is computed once, without noise, and is used again below.

waveform = pw.radar.FMCW(
    77e9 - SWEEP / 2, SWEEP, samples=SAMPLES, sample_rate=RATE, chirps=CHIRPS, interval=30e-6
)


def triad(third, up):
    """Return a rotation whose third column is a direction."""
    first = np.cross(up, third) / np.linalg.norm(np.cross(up, third))
    return np.stack([first, np.cross(third, first), third], axis=1)


site = np.array(at(RANGE, AZIMUTH))
back = np.array([0, 0, HEIGHT]) - site
corner = np.eye(4)
corner[:3, :3] = triad(back / RANGE, [0, 0, 1]) @ triad(axis, [0, 0, 1]).T
corner[:3, 3] = site
reflector = {"reflector": ([triangle.placed(corner @ pose) for pose in poses], 3)}
scene = yard(transmit, receiver)
echo = polywigner.mitsuba.radar_cube(
    scene, waveform, points=0, noise=False, bodies=reflector, elements=True
)
cube = polywigner.mitsuba.radar_cube(
    scene, waveform, points=30_000, rays=30_000, elements=True, seed=24
)
cube["signal"].values += echo["signal"].values
print(dict(cube.sizes), f"{cube.attrs['scattered_points']} scatterers")

# %%
# A map
# -----
# ``pw.radar.range_angle`` forms beams of the virtual array in each range bin. Hann's window over
# the array, the chirps and the samples keeps strong echoes out of other bins. A target in the
# centre of a bin appears with the power that one receiver gets from one transmitter, as in the
# radar equation. ``noise_floor`` is the mean noise power of a bin.

image = pw.radar.range_angle(cube, window="hann", directions=801)
figure, axes = plt.subplots(figsize=(8.5, 4.2), layout="constrained")
draw_radar_map(image, floor_db=-40.0, title="One draw of speckle and noise", ax=axes)
for distance_of, azimuth in ((RANGE, AZIMUTH), (BOARD, BOARD_AZIMUTH)):
    axes.plot(distance_of, np.sin(azimuth), "o", mfc="none", mec="white", ms=15)
axes.set(xlim=(0, 40), ylim=(-0.8, 0.8))

near = image.isel(draw=0).sel(range=RANGE, method="nearest")
level = float(near.max())
floor = float(image.sel(range=slice(36, 60)).mean())
print(f"reflector {dbm(level):.2f} dBm, by the radar equation {dbm(expected):.2f} dBm")
print(f"noise {dbm(floor):.2f} dBm, expected {dbm(image.attrs['noise_floor']):.2f} dBm")
assert abs(decibels(level / expected)) < 0.5
assert abs(decibels(floor / image.attrs["noise_floor"])) < 0.3

# %%
# Detection
# ---------
# ``pw.radar.detections`` compares each bin with the mean of the bins around it. Guard bins keep the
# beam of the target itself, 0.15 wide, out of that mean.

found = pw.radar.detections(image, guard=(100, 2), training=(60, 8)).isel(draw=0)
print(f"bins with detections: {int(found.sum())}")
assert found.sel(range=RANGE, direction_cosine=np.sin(AZIMUTH), method="nearest")
assert not found.sel(range=slice(36, 60)).any()

# %%
# At which angle does the reflector stand? A parabola through the largest three values finds the
# peak between the directions. The bound of Cramér and Rao limits how well an unbiased estimator can
# do: with N channels half a wavelength apart and the signal-to-noise ratio S after all sums,
# :math:`\delta u = \sqrt{6/(S\,(N^2-1))}/\pi`. Here it is a small fraction of the beam's width.
# The spread of 50 draws of noise agrees with it.


def azimuths(beams):
    """Return the angles in degrees at the peaks of beams (draw, direction cosine)."""
    values, cosines = beams.values, beams["direction_cosine"].values
    k = values.argmax(axis=1)
    low, top, high = (values[np.arange(len(k)), k + step] for step in (-1, 0, 1))
    step = cosines[1] - cosines[0]
    return np.degrees(np.arcsin(cosines[k] + step / 2 * (low - high) / (low - 2 * top + high)))


angle = azimuths(image.sel(range=RANGE, method="nearest"))[0]
noisy = polywigner.mitsuba.radar_cube(scene, waveform, points=0, draws=50, elements=True, seed=110)
noisy["signal"].values += echo["signal"].values
beams = pw.radar.range_angle(noisy, window="boxcar", directions=401)
spread = azimuths(beams.sel(range=RANGE, method="nearest")).std()
bound = np.degrees(np.sqrt(6 / (budget * (12**2 - 1))) / np.pi / np.cos(AZIMUTH))
print(f"azimuth {angle:.3f} degrees, true {np.degrees(AZIMUTH):.3f}")
print(f"noise spreads it by {spread:.4f} degrees, bound {bound:.4f}")
assert abs(angle - np.degrees(AZIMUTH)) < 0.2
assert abs(spread / bound - 1) < 0.25

figure, axes = plt.subplots(figsize=(8, 3.8), layout="constrained")
angles = np.degrees(near["angle"].values)
one = pw.radar.range_angle(cube.isel(emitter=[1]), window="hann", directions=801).isel(draw=0)
axes.plot(angles, dbm(near.values), label="three transmitters, 12 channels")
axes.plot(
    angles,
    dbm(one.sel(range=RANGE, method="nearest").values),
    lw=1,
    label="one transmitter, 4 channels",
)
axes.axvline(np.degrees(AZIMUTH), color="C3", lw=0.8, label="true azimuth")
axes.axhline(dbm(image.attrs["noise_floor"]), color="0.5", ls=":", label="noise, 12 channels")
axes.set(
    xlabel="azimuth (degrees)",
    ylabel="received power (dBm)",
    xlim=(-53, 53),
    ylim=(-130, -90),
    title=f"Beams in the range bin at {RANGE:.1f} m",
)
axes.legend(fontsize="small", loc="upper left", ncols=2)

# %%
# How far?
# --------
# Noise alone exceeds T times its mean with the probability :math:`e^{-T}`: one false alarm in a
# million bins makes T = 13.8, or 11.4 dB. A steady target with noise exceeds this threshold with
# the probability of Marcum's Q function, which is 90 % at 13.2 dB. Power falls with the fourth
# power of the range, so the remaining 30 dB of the budget suffice for a range more than five times
# as large. (256 bins end at 64 m: the chirp would have to sweep less.)

threshold = np.log(1e6)
ratios = np.arange(8, 17, 0.25)
needed = np.interp(0.9, ncx2.sf(2 * threshold, 2, 2 * 10 ** (ratios / 10)), ratios)
rng = np.random.default_rng(110)
sum_of_noise = rng.standard_normal(200_000) + 1j * rng.standard_normal(200_000)
detected = np.mean(np.abs(10 ** (needed / 20) + sum_of_noise / np.sqrt(2)) ** 2 > threshold)
reach = RANGE * 10 ** ((decibels(budget) - needed) / 40)
print(f"{needed:.2f} dB for 90 %, in draws {100 * detected:.1f} %; enough up to {reach:.0f} m")
assert abs(needed - 13.2) < 0.1 and abs(detected - 0.9) < 0.005
assert abs(reach - 132) < 3

# %%
# What this radar leaves out
# --------------------------
# - The field of a patch is that of an opening with constant amplitude. A far field from a solver
#   can replace it in ``pw.radiation_pattern(element=)``.
# - Antennas do not couple with each other, and the channels of the cube have no errors but noise.
# - Nothing moves; ``radar_cube(velocities=)`` moves bodies, shapes and antennas.
# - Scattering by two surfaces, such as the wall and the ground, is left out (``max_depth``).
#
# Exercises
# ---------
# 1. Multiply the channels by the errors of above, 0.5 dB and 6 degrees. How do the angle and the
#    sidelobes change? How does one measurement of a corner reflector at a known place put it right?
# 2. Put a second reflector beside the first, at the same range. How near may it come, with twelve
#    channels and with four?
# 3. Raise the middle transmitter by half a wavelength. Which phase now tells the height of a
#    target?
# 4. Turn the reflector by 30 degrees about a vertical axis. How far does the radar see it now?
