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
distances = np.geomspace(1.5, 100, 41)
straight = np.stack([0 * distances, 0 * distances, distances], axis=-1)
exact = POWER * pw.rcs(metal, straight, WAVELENGTH, source=column, return_power=True)[1]
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
# The reflector stands in a yard, 24 m away and 14 degrees to one side. The rest of the yard is a
# scene in Mitsuba, of rough things: a board of 0.4 m, which faces the radar 12 m away on the other
# side, a wall at 32 m, and the ground. The reflector is a mirror too small for rays, which know
# no diffraction, and comes in later. ``range_profile`` sorts what one receiver gets by
# range, in the bins of the chirp, :math:`c/(2B)` = 0.25 m wide.

HEIGHT, BOARD, BOARD_SIDE, BOARD_ALBEDO = 0.8, 12.0, 0.4, 0.5
BOARD_AZIMUTH = np.radians(-20.0)
transform = mi.ScalarTransform4f
look = transform().look_at([0, 0, HEIGHT], [10, 0, HEIGHT], [0, 0, 1])
frame = np.array(look.matrix)[:3, :3]  # columns: the radar's x, y and z in the yard


def at(distance, azimuth):
    """A point as high as the radar, in the yard."""
    x, y, z = distance * (np.sin(azimuth) * frame[:, 0] + np.cos(azimuth) * frame[:, 2])
    return [x, y, z + HEIGHT]


def rough(albedo):
    """A surface that scatters this share of what meets it, in all directions alike."""
    reflectance = {"type": "spectrum", "value": albedo}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


facing = transform().look_at(at(BOARD, BOARD_AZIMUTH), [0, 0, HEIGHT], [0, 0, 1])
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},  # one reflection
        "transmitter": polywigner.mitsuba.aperture(
            column, WAVELENGTH, to_world=look, power=POWER, estimator="exact"
        ),
        "receiver": polywigner.mitsuba.receiver(
            column,
            WAVELENGTH,
            to_world=look,
            bandwidth=RATE,
            temperature=TEMPERATURE,
            noise_figure=NOISE_FIGURE,
        ),
        "board": {
            "type": "rectangle",
            "to_world": facing.scale(BOARD_SIDE / 2),
            "bsdf": rough(BOARD_ALBEDO),
        },
        "wall": {
            "type": "rectangle",
            "to_world": transform().translate([32, 0, 2]).rotate([0, 1, 0], -90).scale([2, 10, 1]),
            "bsdf": rough(0.3),
        },
        "ground": {
            "type": "rectangle",
            "to_world": transform().translate([16, 0, 0]).scale([16, 10, 1]),
            "bsdf": rough(0.03),
        },
    },
    optimize=False,
)
CELL = LIGHT / (2 * SWEEP)
edges = (np.arange(160) + 0.5) * CELL  # middles are whole numbers of cells
profile = polywigner.mitsuba.range_profile(scene, edges, spp=1 << 20)
middles, power = profile["range"].values, profile["scattered_power"].values
assert np.isclose(float(profile["noise_power"]), noise_per_sample, rtol=1e-9)

# %%
# A rough surface of the albedo :math:`\varrho` and the area A that faces the radar has the mean
# cross section :math:`4\varrho A`. For the board the radar equation holds. The wall is no point:
# its ends are farther away, seen aslant, and out of the beam. As a point at its middle it would
# send back 2 dB more.

at_board = np.abs(middles - BOARD) < 1.5 * CELL
ground = np.median(power[(np.abs(middles - BOARD) < 6 * CELL) & ~at_board])
by_rays = power[at_board].sum() - ground * at_board.sum()
by_equation = radar_equation(4 * BOARD_ALBEDO * BOARD_SIDE**2, BOARD, BOARD_AZIMUTH)
ratios = [decibels(one / noise_per_sample) for one in (by_rays, by_equation)]
print(f"board: signal to noise of a sample {ratios[0]:.2f} dB, radar equation {ratios[1]:.2f} dB")
assert abs(ratios[0] - ratios[1]) < 0.2
behind = power[middles > 31.9].sum()
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
# ``scatterers`` turns the yard into a cloud of places with the intensity I that they send back, and
# ``element_responses`` gives the exact fields e of all seven antennas at each of them, with their
# phases. The path from transmitter j by scatterer n to receiver k has the amplitude
#
# .. math:: z_n\,\sqrt{I_n}\,\frac{e_{jn}}{|e_{0n}|}\,e_{kn}
#
# where z is a random number, the speckle of a rough surface, and :math:`e_0` belongs to the
# transmitter of the scene. The reflector has :math:`e_j\,e_k\sqrt{P\sigma/4\pi}/\lambda`, with the
# fields at its place. As a chirp rises, each path turns by :math:`2\pi B/c` times its length.
#
# The cloud keeps what all rays find. Fewer of the same power each would do for the wall, and leave
# one or none for the weak ground in the bin of the reflector: no speckle.

cloud = polywigner.mitsuba.scatterers(scene, 60_000, rays=60_000)
sent, heard, middle = (
    polywigner.mitsuba.element_responses(cloud, antennas)
    for antennas in (transmitter, receiver, pw.Array([column]))
)
order = np.argsort(np.add.outer(transmit[:, 0], receive[:, 0]).ravel())


def channels(there, back):
    """(12, n) of (3, n) and (4, n), in the order of the virtual array."""
    return (there[:, None] * back).reshape(12, -1)[order]


def sweep(length):
    """(n, 256): how paths of these lengths turn as the frequency rises."""
    turns = SWEEP / LIGHT * np.multiply.outer(length, np.arange(SAMPLES) / SAMPLES)
    return np.exp(2j * np.pi * turns)


def gaussian(*shape):
    """Independent circular Gaussian numbers of variance 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


intensity = cloud["intensity"].values
in_bin = int(np.sum(np.abs(cloud["path_length"].values / 2 - RANGE) < CELL / 2))
yard = channels(sent / np.abs(middle), heard)
mean = np.mean(np.abs(yard) ** 2 @ intensity)
print(f"yard {dbm(mean):.2f} dBm by scatterers, {dbm(float(profile['scattered'])):.2f} dBm by rays")
print(f"{len(intensity)} scatterers, {in_bin} of them in the bin of the reflector")
assert in_bin > 15
assert abs(decibels(mean / float(profile["scattered"]))) < 0.1

corner = RANGE * np.array([np.sin(AZIMUTH), 0, np.cos(AZIMUTH)])  # in the radar's frame
sites = np.concatenate([transmit, receive])
fields = pw.amplitude(column, corner - np.pad(sites, ((0, 0), (0, 1))), WAVELENGTH)
e = WAVELENGTH / np.sqrt(pw.radiated_power(column, WAVELENGTH)) * fields[:, None]
echo = np.sqrt(POWER * sigma / (4 * np.pi)) / WAVELENGTH * channels(e[:3], e[3:])
off = decibels(np.mean(np.abs(echo) ** 2) / expected)
print(f"echo of the reflector against the radar equation: {off:+.4f} dB")
assert abs(off) < 0.01

signal = yard * np.sqrt(intensity) * gaussian(len(intensity)) @ sweep(cloud["path_length"].values)
signal = signal + echo * sweep(2 * RANGE)
received = signal + np.sqrt(noise_per_sample / CHIRPS) * gaussian(12, SAMPLES)  # mean of chirps

# %%
# A map
# -----
# A Fourier transform over the samples sorts by range. Hann's window keeps strong echoes out of
# other ranges, and costs 1.76 dB. Then a beam towards :math:`u = \sin\theta` is the sum of the
# twelve channels with the phases :math:`2\pi x u/\lambda`, with a taper of -30 dB for the map.

window = np.hanning(SAMPLES + 2)[1:-1]
window = window / np.sqrt(np.mean(window**2))  # noise stays as it is
hann = decibels(np.mean(window) ** 2)
cosines = np.linspace(-0.8, 0.8, 801)
degrees = np.degrees(np.arcsin(cosines))
steering = np.exp(2j * np.pi / WAVELENGTH * np.outer(cosines, virtual[:, 0]))
taper = pw.arrays.window_weights((12,), "taylor", sll=30)
taper = taper / np.sqrt(np.mean(np.abs(taper) ** 2))


def by_range(samples):
    """Spectra of samples over the range bins."""
    return np.fft.fft(samples * window) / SAMPLES


cells = by_range(received)
picture = np.abs((steering * taper) @ cells) ** 2 / 12  # noise is as strong as in one channel
figure, axes = plt.subplots(figsize=(8.5, 4.2), layout="constrained")
shown = axes.pcolormesh(
    np.arange(161) * CELL,
    degrees,
    decibels(picture[:, :161] / noise),
    cmap="inferno",
    vmin=0,
    rasterized=True,
)
for distance, azimuth in ((RANGE, AZIMUTH), (BOARD, BOARD_AZIMUTH)):
    axes.plot(distance, np.degrees(azimuth), "o", mfc="none", mec="white", ms=15)
axes.set(
    xlabel="range (m)",
    ylabel="azimuth (degrees)",
    title="One draw of speckle and noise; rings: the board and the reflector",
)
figure.colorbar(shown, label="signal to noise (dB); floor 0 dB")

# %%
# Detection
# ---------
# Does the reflector stand as far out of the noise as the budget says? Now beams have no taper,
# which would cost more of it. Cells beyond the wall have nothing but noise. The draw of noise and
# the ground, 31 dB below the reflector in one channel, may part both numbers by some tenths of a
# decibel.

bin_of = round(RANGE / CELL)
beams = np.abs(steering @ cells) ** 2 / 12
floor = beams[:, 145:250].mean()
spectrum = beams[:, bin_of]
result = decibels(spectrum.max() / floor)
clutter = decibels(expected / power[bin_of - 1])
print(f"noise {dbm(floor):.2f} dBm, by kTBF {dbm(noise):.2f} dBm; ground {clutter:.1f} dB below")
print(f"signal to noise {result:.2f} dB, by the budget {decibels(budget) + hann:.2f} dB")
assert abs(decibels(floor / noise)) < 0.5 and abs(clutter - 31) < 1
assert abs(result - decibels(budget) - hann) < 1

figure, axes = plt.subplots(figsize=(8, 3.8), layout="constrained")
one = np.abs(steering[:, 4:8] @ cells[4:8, bin_of]) ** 2 / 4
axes.plot(degrees, decibels(spectrum / noise), label="three transmitters, 12 channels")
axes.plot(degrees, decibels(one / noise), lw=1, label="one transmitter, 4 channels")
axes.axvline(np.degrees(AZIMUTH), color="C3", lw=0.8, label="true azimuth")
axes.axhline(decibels(np.log(1e6)), color="0.5", ls=":", label="threshold, a false alarm in 1e6")
axes.set(
    xlabel="azimuth (degrees)",
    ylabel="signal to noise (dB)",
    xlim=(-53, 53),
    ylim=(-5, 58),
    title=f"Beams in the range bin at {bin_of * CELL:.1f} m",
)
axes.legend(fontsize="small", loc="upper left", ncols=2)

# %%
# And at which angle? A parabola through the highest three values finds the peak between
# the steps. The bound of Cramér and Rao says how far noise moves it: with N channels half a
# wavelength apart and the signal-to-noise ratio S after all sums,
# :math:`\delta u = \sqrt{6/(S\,(N^2-1))}/\pi`, here 250 times less than the beam is wide. 500 draws
# of noise spread just so. The reflector has to be found within 0.2 degrees; the ground
# moves it too.


def azimuths(spectra):
    """Degrees at the peaks of spectra (cosines, n), between the samples."""
    k = spectra.argmax(axis=0)
    low, top, high = (np.take_along_axis(spectra, (k + s)[None], 0)[0] for s in (-1, 0, 1))
    step = cosines[1] - cosines[0]
    return np.degrees(np.arcsin(cosines[k] + step / 2 * (low - high) / (low - 2 * top + high)))


angle = azimuths(spectrum[:, None])[0]
S = budget * np.mean(window) ** 2
bound = np.degrees(np.sqrt(6 / (S * (12**2 - 1))) / np.pi / np.cos(AZIMUTH))
many = by_range(signal)[:, [bin_of]] + np.sqrt(noise) * gaussian(12, 500)
spread = azimuths(np.abs(steering @ many) ** 2).std()
print(f"azimuth {angle:.3f} degrees, true {np.degrees(AZIMUTH):.3f}")
print(f"noise spreads it by {spread:.4f} degrees, bound {bound:.4f}")
assert abs(angle - np.degrees(AZIMUTH)) < 0.2
assert abs(spread / bound - 1) < 0.15

# %%
# How far?
# --------
# A cell above a threshold counts as a detection. Noise alone exceeds T times its mean with the
# probability :math:`e^{-T}`: one false alarm in a million cells makes T = 13.8, or 11.4 dB. A
# steady target with noise exceeds it with the probability of Marcum's Q function, 90 % at 13.2 dB.
# Power falls with the fourth power of the range, so the 28 dB of the budget above that carry the
# reflector five times as far. (256 bins end at 64 m: the chirp would have to sweep less.)

threshold = np.log(1e6)
levels = np.arange(8, 17, 0.25)
needed = np.interp(0.9, ncx2.sf(2 * threshold, 2, 2 * 10 ** (levels / 10)), levels)
seen = np.mean(np.abs(10 ** (needed / 20) + gaussian(200_000)) ** 2 > threshold)
reach = RANGE * 10 ** ((decibels(budget) + hann - needed) / 40)
print(f"{needed:.2f} dB for 90 %, in draws {100 * seen:.1f} %; enough up to {reach:.0f} m")
assert abs(needed - 13.2) < 0.1 and abs(seen - 0.9) < 0.005
assert abs(reach - 119) < 3

# %%
# What this radar leaves out
# --------------------------
# - The field of a patch is that of an opening, the same all over it. A far field from a solver
#   takes its place in ``pw.radiation_pattern(element=)``.
# - Antennas do not couple with each other, and the channels of the last cells have no errors but
#   noise.
# - Nothing moves. A target that moves turns its phase from transmitter to transmitter, which looks
#   like an angle.
# - Echoes by two reflections, between wall and ground say, are left out (``max_depth``).
#
# Exercises
# ---------
# 1. Give the channels the errors of above, 0.5 dB and 6 degrees. What happens to the angle, and to
#    sidelobes? How does one measurement of a corner reflector at a known place put it right?
# 2. Put a second reflector beside the first, at the same range. How near may it come, with twelve
#    channels and with four?
# 3. Raise the middle transmitter by half a wavelength. Which phase now tells the height of a
#    target?
# 4. Turn the reflector by 30 degrees about a vertical axis. How far does the radar see it now?
