r"""
104: Arrays
===========

A phased array is one element, many places, and as many complex weights. This lesson builds one at
77 GHz, steers it, gives it a taper, drives it into grating lobes, weighs its directivity, and
ends with what phase space says about it: why half of the rays of an array come from where there
is no element.
"""

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

WAVELENGTH = 299_792_458 / 77e9
element = pw.shapes.rectangle(1.2e-3, 1.0e-3)
print(f"wavelength {WAVELENGTH * 1e3:.2f} mm")

# %%
# Element times factor
# --------------------
# 12 x 16 patches at a pitch of 1.9 mm, a little under half a wavelength. The field of an array is
# that of one element times the *array factor* :math:`\sum_k w_k\,e^{-2\pi i\,\nu\cdot p_k}`, as
# long as all elements are alike.

places = pw.arrays.grid_positions(12, 16, 1.9e-3)
uniform = pw.phased_array(element, places)

rng = np.random.default_rng(104)
nu = rng.uniform(-1, 1, (500, 2)) / WAVELENGTH
product = pw.fourier(element, nu) * pw.array_factor(places, np.ones(len(places)), nu)
assert np.allclose(pw.fourier(uniform, nu), product, rtol=0, atol=1e-12 * 192 * element.area)

# %%
# Steering and taper
# ------------------
# A beam towards the unit vector :math:`s` needs the phases :math:`2\pi\,s\cdot p_k/\lambda`,
# which is what ``steering_weights`` are. A window lowers the sidelobes; Taylor's lets you say by
# how much. Weights multiply.

THETA = np.radians(20)
beam = np.array([0, np.sin(THETA), np.cos(THETA)])
steer = pw.arrays.steering_weights(places, beam, WAVELENGTH)
window = pw.arrays.window_weights((12, 16), "taylor", sll=25)
steered = pw.phased_array(element, places, steer)
tapered = pw.phased_array(element, places, steer * window)


def db(values, reference=None, floor=-50.0):
    """Ten times the logarithm, relative to the peak unless told, and no lower than the floor."""
    reference = values.max() if reference is None else reference
    return 10 * np.log10(np.maximum(values / reference, 10 ** (floor / 10)))


theta = np.radians(np.linspace(-90, 90, 3601))
cut = np.stack([np.zeros_like(theta), np.sin(theta)], axis=-1) / WAVELENGTH

figure, axes = plt.subplots(figsize=(8.4, 3.6), layout="constrained")
for source, label in ((uniform, "uniform"), (steered, "steered"), (tapered, "steered, Taylor")):
    axes.plot(np.degrees(theta), db(np.abs(pw.fourier(source, cut)) ** 2), label=label)
axes.axhline(-25, color="black", linewidth=0.6)
axes.set(
    xlabel="angle in the yz-plane (degrees)", ylabel="$|F|^2$ (dB)", ylim=(-50, 1), xlim=(-90, 90)
)
axes.legend(loc="upper left")

level = db(np.abs(pw.fourier(tapered, cut)) ** 2)
peak = np.degrees(theta[np.argmax(level)])
maxima = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:]) & (level[1:-1] < -1)
sidelobe = level[1:-1][maxima].max()
print(f"beam at {peak:.2f} degrees, largest sidelobe {sidelobe:.1f} dB")
assert abs(peak - 20) < 0.2  # the element's own pattern pulls it a little towards the normal
assert -26.5 < sidelobe < -24

# %%
# Grating lobes
# -------------
# Phases are known up to whole turns only. So the array factor is periodic: beside the beam at
# :math:`\nu = s/\lambda` it has copies at :math:`s/\lambda + (i/p_x, j/p_y)`, which radiate if
# they lie within the horizon. The same aperture with a pitch of 3.8 mm, nearly a wavelength, has
# one:

sparse_places = pw.arrays.grid_positions(6, 8, 3.8e-3)
sparse = pw.phased_array(
    element, sparse_places, pw.arrays.steering_weights(sparse_places, beam, WAVELENGTH)
)

axis = np.linspace(-1.1, 1.1, 331)
grid = np.stack(np.meshgrid(axis, axis), axis=-1) / WAVELENGTH
figure, panels = plt.subplots(1, 2, figsize=(9, 3.9), layout="compressed", sharey=True)
for axes, source, title in zip(
    panels, (tapered, sparse), ("pitch 1.9 mm, Taylor", "pitch 3.8 mm"), strict=True
):
    picture = axes.imshow(
        db(np.abs(pw.fourier(source, grid)) ** 2, floor=-40),
        "inferno",
        origin="lower",
        extent=2 * [-1.1, 1.1],
    )
    axes.add_patch(plt.Circle((0, 0), 1, fill=False, color="white", linestyle=":"))
    axes.set(title=title, xlabel="$s_x$")
panels[0].set_ylabel("$s_y$")
figure.colorbar(picture, ax=panels, label="$|F|^2$ (dB)")

lobe = np.sin(THETA) - WAVELENGTH / 3.8e-3
print(f"grating lobe at s_y = {lobe:.3f}, {np.degrees(np.arcsin(lobe)):.1f} degrees")
near = np.abs(np.sin(theta) - lobe) < 0.1
power = np.abs(pw.fourier(sparse, cut)) ** 2
result = np.sin(theta[near][np.argmax(power[near])])
assert abs(result - lobe) < 0.01
factor = np.abs(pw.array_factor(sparse_places, sparse.weights, [[0, lobe / WAVELENGTH]])) ** 2
assert np.isclose(factor[0], 48**2, rtol=1e-9)  # as strong as the beam: only the element weakens it

# %%
# Directivity
# -----------
# ``radiation_pattern`` integrates the radiated power, to rounding, and gives directivities in
# dBi. The rule of thumb :math:`4\pi A/\lambda^2`, with :math:`A` the area of a cell times the
# number of cells, is good for broadside and a uniform field; this taper costs half a decibel
# along each axis, and a beam aslant loses about a cosine, as the array's own width does.

angles, planes = np.radians(np.arange(0, 91, 1.0)), np.radians(np.arange(0, 360, 15.0))
rule = 10 * np.log10(4 * np.pi * 192 * 1.9e-3**2 / WAVELENGTH**2)
print(f"4 pi A/lambda²: {rule:.2f} dBi")
result = {}
for name, source in (
    ("uniform", uniform),
    ("Taylor", pw.phased_array(element, places, window)),
    ("steered", steered),
    ("pitch 3.8 mm, steered", sparse),
):
    pattern = pw.radiation_pattern(source, WAVELENGTH, angles, planes)
    result[name] = pattern.attrs["largest_directivity"]
    print(f"{name:22} {result[name]:.2f} dBi")
assert abs(result["uniform"] - rule) < 0.5
assert 0.3 < result["uniform"] - result["Taylor"] < 1.2
assert result["pitch 3.8 mm, steered"] < result["steered"] - 2  # what the grating lobe takes

# %%
# An array in phase space
# -----------------------
# A row of eight slits is enough to see it, since a row is a line, and :math:`W(x, \nu)` of a line
# is one picture. Every pair of elements interferes at the middle between the two, and the middles
# are a lattice of *half* the pitch: those of elements an even number of places apart lie on
# elements, the others half-way between two, where there is nothing.

PITCH, WIDTH, COUNT = 1.0, 0.45, 8
row = (np.arange(COUNT) - (COUNT - 1) / 2)[:, None] * PITCH
slit = pw.shapes.slit(WIDTH)
tilt = 0.2  # cycles per pitch
in_phase = pw.phased_array(slit, row)
steered_row = pw.phased_array(slit, row, np.exp(2j * np.pi * tilt * row[:, 0]))

x = np.linspace(-4.2, 4.2, 841)[:, None, None]
nu = np.linspace(-1.6, 1.6, 257)[:, None]
figure, panels = plt.subplots(2, 1, figsize=(9, 5.6), layout="constrained", sharex=True)
for axes, source, title in zip(
    panels, (in_phase, steered_row), ("in phase", "steered"), strict=True
):
    picture = axes.imshow(
        pw.wigner(source, x, nu).T,
        "RdBu_r",
        vmin=-4,
        vmax=4,
        origin="lower",
        extent=[-4.2, 4.2, -1.6, 1.6],
        aspect="auto",
    )
    axes.set(title=title, ylabel=r"$\nu$ (cycles per pitch)")
    axes.plot(row[:, 0], np.full(COUNT, -1.48), "|", color="black", markersize=9)
panels[1].set_xlabel("x (pitches); ticks: the elements")
figure.colorbar(picture, ax=panels, label="W", extend="both")

# %%
# In the beam, at :math:`\nu = 0`, and in its copies one cycle per pitch away, all pairs are in
# phase, at all places of the lattice. Half-way to the copies, a pair has the sign of the number
# of places that it spans. So :math:`W` is as large as in the beam, positive on the elements and
# negative between them: a **ghost** of the grating lobe, at half its frequency. The far field
# there is zero. Only the sum over :math:`x` says so:

step = 1e-3
middles = (np.arange(-4200, 4200) + 0.5) * step
nearest = np.round(2 * middles / PITCH).astype(int)
for frequency in (0.0, 0.5):
    w = pw.wigner(in_phase, middles[:, None], [frequency])
    parts = np.array([w[nearest == n].sum() * step for n in range(-7, 8)])  # odd: elements
    far = abs(pw.fourier(in_phase, [frequency])) ** 2
    print(f"nu = {frequency}: {np.round(parts, 2)}")
    print(f"          sum {parts.sum():.4f}, |F|² = {far:.4f}")
    assert abs(parts.sum() - far) < 1e-4
assert np.all(parts[::2] > 0) and np.all(parts[1::2] < 0)

# %%
# This is why arrays are noisy to render: rays are drawn from places, one by one, and at the
# ghosts they cancel only when all places have been seen. The plugin's estimator ``exact`` has no
# such noise.
#
# Steering moves the beam, its copies and the ghosts along :math:`\nu`, all by the same amount,
# and nothing along :math:`x`. What it does not move is the pattern of the single element, in
# front of which all of this happens:

place, frequency = [0.5 * PITCH], np.array([[0.3], [0.45], [0.8]])
one = pw.wigner(slit, [0.0], frequency), pw.wigner(slit, [0.0], frequency - tilt)
of_steered = pw.wigner(steered_row, place, frequency) / one[0]
of_row = pw.wigner(in_phase, place, frequency - tilt) / one[1]
assert np.allclose(of_steered, of_row, rtol=1e-12)

# %%
# Exercises
# ---------
# 1. How far can the 1.9 mm array be steered along y before its first grating lobe comes over the
#    horizon? And one of 2.3 mm?
# 2. Thin the array: ``pw.arrays.thinned(places, fill=0.5, seed=1)``. What happens to the far
#    sidelobes, and what to the directivity? Where has the periodicity gone?
# 3. Focus it on a point 60 mm away (``focusing_weights``), and look at ``pw.plane`` through that
#    point.
# 4. In the picture of the row, which pairs of elements make the ghost at x = 0? Switch one of the
#    outer elements off, and find the ghosts that are gone.
