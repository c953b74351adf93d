r"""
108: A radar looks down the street
==================================

From the drawing of an antenna to a map of a street in range and angle, in watts. A radar at 77 GHz
sends by a column of patches, and twelve such columns receive. The street is a Mitsuba scene with
posts, a wall and a car. How much power comes from which range? The lesson finds it by two routes.
Then the covariance of the twelve columns shows where things stand, and how sharply an array of this
size can tell.
"""

# Before anything else loads Dr.Jit: it looks for an LLVM library that works.
import polywigner.mitsuba  # isort: skip

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
import shapely

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
# The drawing
# -----------
# Seven patches in a row, fed in phase, narrower towards the ends, which lowers sidelobes. Twelve
# rows stand half a wavelength apart. A drawing in a file serves as well: ``pw.read_aperture`` reads
# GeoJSON, WKT, SVG, DXF and Gerber.

WIDTHS = np.array([0.8, 1.1, 1.4, 1.4, 1.4, 1.1, 0.8]) * 1e-3
LENGTH, PITCH, ELEMENTS = 1.2e-3, 2.5e-3, 12
heights = (np.arange(7) - 3) * PITCH
column = pw.Aperture(
    shapely.MultiPolygon(
        [
            shapely.box(-width / 2, y - LENGTH / 2, width / 2, y + LENGTH / 2)
            for y, width in zip(heights, WIDTHS, strict=True)
        ]
    )
)
across = (np.arange(ELEMENTS) - (ELEMENTS - 1) / 2) * WAVELENGTH / 2
array = pw.Array([column.moved((x, 0)) for x in across])

# %%
# What does a column see? Its far pattern along both axes: narrow in elevation, wide in azimuth.

angle = np.radians(np.linspace(-90, 90, 1441))
nu = np.sin(angle) / WAVELENGTH
zero = np.zeros_like(nu)
patterns = {
    "azimuth": np.abs(pw.fourier(column, np.stack([nu, zero], axis=-1))) ** 2,
    "elevation": np.abs(pw.fourier(column, np.stack([zero, nu], axis=-1))) ** 2,
}
figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for element in array.elements_in_plane:
    for patch in element.polygons.geoms:
        panels[0].fill(*(1e3 * np.array(patch.exterior.xy)), "C1")
panels[0].set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)", title="Twelve columns of patches")
for name, power in patterns.items():
    panels[1].plot(
        np.degrees(angle), decibels(np.cos(angle) ** 2 * power / power.max()), label=name
    )
panels[1].set(
    xlabel="angle (degrees)",
    ylabel="dB below the peak",
    xlim=(-90, 90),
    ylim=(-40, 1),
    title="Pattern of one column",
)
panels[1].legend()
above = np.degrees(angle[patterns["elevation"] > 0.5 * patterns["elevation"].max()])
beamwidth = above.max() - above.min()
print(f"half-power beamwidth in elevation {beamwidth:.1f} degrees")
assert abs(beamwidth - 12.5) < 0.2

# %%
# The street
# ----------
# The radar stands 0.7 m above the road and looks along x. Four posts of 0.1 m radius stand at
# known places, a wall runs along the left side, a car stands ahead. All surfaces scatter
# diffusely. The transmitter is one column; the receiver in the scene is one column as well: what it
# does not see, its eleven neighbours do not see either. ``optimize=False`` leaves each shape
# its name.

HEIGHT, RADIUS = 0.7, 0.1
POSTS = np.array([(9.0, 2.0), (16.0, -3.5), (24.0, 3.0), (33.0, -3.0)])
transform = mi.ScalarTransform4f
look = transform().look_at([0, 0, HEIGHT], [10, 0, HEIGHT], [0, 0, 1])


def rough(albedo):
    """A surface that scatters this share of what meets it, in all directions alike."""
    reflectance = {"type": "spectrum", "value": albedo}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def post(x, y):
    """An upright cylinder, 3 m high."""
    return {"type": "cylinder", "p0": [x, y, 0], "p1": [x, y, 3], "radius": RADIUS}


scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},  # one reflection
        "transmitter": polywigner.mitsuba.aperture(
            column, WAVELENGTH, to_world=look, power=10e-3, estimator="exact"
        ),
        "receiver": polywigner.mitsuba.receiver(
            column,
            WAVELENGTH,
            to_world=look,
            bandwidth=300e6,
            temperature=290.0,
            noise_figure=12.0,
        ),
        "road": {
            "type": "rectangle",
            "to_world": transform().translate([22, 0, 0]).scale([22, 5, 1]),
            "bsdf": rough(0.2),
        },
        "wall": {
            "type": "rectangle",
            "to_world": transform().translate([22, 6, 2]).rotate([1, 0, 0], 90).scale([22, 2, 1]),
            "bsdf": rough(0.3),
        },
        "car": {
            "type": "cube",
            "to_world": transform().translate([20, -0.8, 0.7]).scale([2, 0.9, 0.6]),
            "bsdf": rough(0.9),
        },
        **{f"post {k + 1}": post(*place) | {"bsdf": rough(0.9)} for k, place in enumerate(POSTS)},
    },
    optimize=False,
)
received = polywigner.mitsuba.received_power(scene, spp=1 << 18)
print(received)

# %%
# Five picowatts for each milliwatt, from all ranges together: 4 dB above the noise in 300 MHz. A
# radar lives on adding up: 128 samples of 64 chirps here, which takes 39 dB off the noise.
#
# The scene as scatterers
# -----------------------
# ``scatterers`` gives the same power as a cloud of places. Each has a position, a power in W, and
# the length of its whole path. All have nearly the same power: where more comes from, there are
# more of them.

cloud = polywigner.mitsuba.scatterers(scene, 30_000, rays=600_000)
power, path = cloud["power"].values, cloud["path_length"].values
place = cloud["position"].values
error = np.hypot(cloud.attrs["standard_error"], received.standard_error)
print(f"{len(power)} scatterers, {power.sum():.3e} W; received {received.scattered:.3e} W")
assert abs(power.sum() - received.scattered) < 4 * error
assert error < 0.006 * received.scattered

cells = [np.arange(0, 44.5, 0.5), np.arange(-6, 7, 0.5)]
seen, _, _ = np.histogram2d(place[:, 0], place[:, 1], bins=cells, weights=power)
figure, axes = plt.subplots(figsize=(9, 3.2), layout="constrained")
level = np.ma.masked_less(dbm(seen.T), dbm(seen.max()) - 35)
shown = axes.pcolormesh(*cells, level, cmap="viridis")
axes.plot(*POSTS.T, "o", mfc="none", mec="red", ms=12, label="posts")
axes.plot(0, 0, "k>", label="radar")
axes.set(
    aspect="equal",
    xlabel="x (m)",
    ylabel="y (m)",
    title="Where received power comes from, seen from above",
)
axes.legend(loc="lower right", ncols=2)
figure.colorbar(shown, label="dBm in a cell; 35 dB shown")

# %%
# By range
# --------
# Range is half of the path. A chirp of bandwidth B resolves :math:`c/(2B)`, 0.5 m for 300 MHz. The
# cloud is sorted into such bins by ``np.histogram``. The second route, ``range_profile``,
# knows nothing of clouds: it sorts the samples of a render by the lengths of their paths.

BANDWIDTH = 300e6
edges = np.arange(89) * LIGHT / (2 * BANDWIDTH)
sorted_cloud, _ = np.histogram(path / 2, bins=edges, weights=power)
profile = polywigner.mitsuba.range_profile(scene, edges, spp=1 << 19)
scattered = profile["scattered_power"].values
ways = np.array([[*xy, 0] for xy in POSTS])
distances = np.linalg.norm(ways, axis=1) - RADIUS

figure, axes = plt.subplots(figsize=(8, 3.8), layout="constrained")
axes.stairs(dbm(scattered), edges, label="range_profile", baseline=None)
axes.stairs(dbm(sorted_cloud), edges, label="scatterers", ls="--", baseline=None)
noise = (received.noise_power or 0) / (128 * 64)
axes.axhline(dbm(noise), color="0.4", ls=":", label="noise after 128 x 64 samples")
for k, distance in enumerate(distances):
    axes.axvline(distance, color="red", lw=0.6)
    axes.text(distance + 0.3, -76, f"post {k + 1}", color="red")
axes.set(xlabel="range (m)", ylabel="received power in a bin (dBm)", ylim=(-130, -62), xlim=(0, 44))
axes.legend(loc="upper right", ncols=3)

# %%
# Both routes agree within their errors, those of the cloud from the number of scatterers in a bin.

counts, _ = np.histogram(path / 2, bins=edges)
of_cloud = sorted_cloud / np.sqrt(np.maximum(counts, 1))
of_profile = profile["standard_error"].values
strong = counts > 30
off = (sorted_cloud - scattered)[strong] / np.hypot(of_cloud, of_profile)[strong]
print(f"{len(off)} bins, off by {off.std():.2f} standard errors")
assert np.abs(off).max() < 5
total = float(profile["scattered"].values)
assert abs(power.sum() - total) < 4 * np.hypot(error, float(profile["scattered_error"].values))

# %%
# Four posts stand out where they should, 0.1 m before their axes: the bin of each is compared with
# those two and three bins away.

bins = np.searchsorted(edges, distances) - 1
for k, index in enumerate(bins):
    around = sorted_cloud[[index - 3, index - 2, index + 2, index + 3]]
    rise = decibels(sorted_cloud[index] / np.median(around))
    print(f"post {k + 1}: range {distances[k]:.2f} m, {rise:.1f} dB above its surroundings")
    assert rise > 6

# %%
# Angle: the covariance of twelve columns
# ---------------------------------------
# What one column receives of scatterer n is :math:`a_{kn} = z_n\sqrt{I_n}\,e_{kn}`. The intensity
# I comes with the cloud, and :math:`e_{kn}` is the exact field of the column there, with its phase.
# The z are random numbers of variance 1, the speckle of a rough surface. One draw of them is
# what one measurement shows. Its mean over all draws needs no draws:
#
# .. math:: R_{kl} = \langle a_k a_l^*\rangle = \sum_n I_n e_{kn} e_{ln}^*
#
# ``covariance`` adds it up, a matrix for each range bin. Its diagonal is the power of each column.

matrices = polywigner.mitsuba.covariance(cloud, array, ranges=edges)
trace = np.trace(matrices, axis1=1, axis2=2).real
print(f"trace / 12: {trace.sum() / ELEMENTS:.4e} W, received {received.scattered:.4e} W")
assert abs(trace.sum() / ELEMENTS - received.scattered) < 4 * error
assert np.allclose(trace / ELEMENTS, sorted_cloud, rtol=0.01)

# %%
# A beam towards the direction cosine :math:`\alpha` weighs the columns by
# :math:`w_k = \exp(2\pi i x_k\alpha/\lambda)` and gives :math:`w^T R\,w^*/12`: each column has a
# receiver of its own, and this leaves their noise as it is. A taper lowers its sidelobes (left).
# Capon's beam takes for each direction and range the weights that let through all of that direction
# and as little as possible of the rest, noise included, which sharpens the picture (right).

cosines = np.linspace(-0.8, 0.8, 161)
steering = np.exp(2j * np.pi * np.outer(cosines, across) / WAVELENGTH)
taper = np.hanning(ELEMENTS + 2)[1:-1]
tapered = steering * taper / np.sqrt(np.sum(taper**2))
beams = np.einsum("ak,rkl,al->ra", tapered, matrices, tapered.conj()).real
loaded = matrices + noise * np.eye(ELEMENTS)
inverse = np.linalg.inv(loaded)
capon = ELEMENTS / np.einsum("ak,rkl,al->ra", steering, inverse, steering.conj()).real

frame = np.reshape(cloud.attrs["to_world"], (4, 4))
towards = ways @ frame[:3, 0] / np.linalg.norm(ways, axis=1)
figure, panels = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
for axes, picture, title in (
    (panels[0], beams, "Tapered beams"),
    (panels[1], capon, "Capon's beams"),
):
    level = dbm(picture.T)
    shown = axes.pcolormesh(
        (edges[1:] + edges[:-1]) / 2,
        cosines,
        level,
        cmap="inferno",
        vmin=level.max() - 45,
        rasterized=True,
    )
    axes.plot(distances, towards, "o", mfc="none", mec="white", ms=11)
    axes.set(xlabel="range (m)", xlim=(0, 44), title=title)
    figure.colorbar(shown, label="dBm; floor 45 dB below the peak")
panels[0].set(ylabel="direction cosine along the array")

# %%
# Rings mark where the posts stand. Each has its peak within one range bin and within one beam,
# :math:`\lambda/D = 1/6` for twelve columns half a wavelength apart; in Capon's map within 0.03.

centres = (edges[1:] + edges[:-1]) / 2
for k in range(len(POSTS)):
    window = np.abs(cosines - towards[k]) < 1 / 6
    for picture, within in ((beams, 1 / 12), (capon, 0.03)):
        part = np.where(window, picture[bins[k] - 1 : bins[k] + 2], 0)
        row, result = np.unravel_index(part.argmax(), part.shape)
        assert abs(row - 1) <= 1
        assert abs(cosines[result] - towards[k]) < within
    print(f"post {k + 1}: cosine {towards[k]:+.3f}, Capon's peak {cosines[result]:+.3f}")

# %%
# How alike are two columns?
# --------------------------
# Power that comes from many directions makes columns differ. Van Cittert and Zernike's theorem: the
# correlation of two columns is the Fourier transform of the power over direction cosines. A
# post is narrow, and all columns receive the same of it; what is left of a fringe is the wall, in
# the same range bin. The road nearby is wide: columns a wavelength apart have little in common.

figure, axes = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
coherence = {}
for name, index in (("post 3", bins[2]), ("road at 4 m", np.searchsorted(edges, 4.0))):
    diagonal = np.sqrt(np.diag(matrices[index]).real)
    degree = np.abs(matrices[index] / np.outer(diagonal, diagonal))
    coherence[name] = [np.diagonal(degree, lag).mean() for lag in range(ELEMENTS)]
    axes.plot(np.arange(ELEMENTS) / 2, coherence[name], "o-", label=name)
axes.set(
    xlabel="distance of two columns (wavelengths)",
    ylabel="modulus of the correlation",
    ylim=(0, 1.05),
)
axes.legend()
print({name: round(float(values[6]), 3) for name, values in coherence.items()})
assert min(coherence["post 3"]) > 0.8
assert max(coherence["road at 4 m"][2:]) < 0.15

# %%
# A radar measures one draw of speckle after the other. The example ``examples/radar_77ghz`` draws
# it, makes the beat signal of a chirp for each column, and finds range, angle and speed by two
# Fourier transforms.
#
# Exercises
# ---------
# 1. Let light bounce twice (``max_depth`` 3). What appears behind the car, and how strong is it?
# 2. Give the car a speed (``velocities={"car": (-8, 0, 0)}``). Which paths change fastest, those
#    by the car alone or those by car and wall?
# 3. Make the road smoother: a ``roughconductor`` instead of a diffuse surface. What happens to the
#    profile between the posts?
# 4. Take eight columns 0.75 wavelengths apart. Where does a post appear twice?
