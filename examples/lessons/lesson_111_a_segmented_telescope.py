r"""
111: A segmented telescope
==========================

From the drawing of a mirror to the contrast of a test chart. This lesson reads the primary of a
telescope from an SVG file: 18 hexagons behind the vanes of a spider. It looks at a star, moves the
segments out of place, weighs what colours, focus and pixels leave of the contrast, and ends on a
test bench, where a small copy of the pupil images a chart under a condenser.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import shapely

import polywigner as pw

WAVELENGTH = 2e-6
FOCAL_LENGTH = 131.4
SEGMENT, GAP, VANE = 1.32, 7e-3, 0.1


def decibels(power, floor=-60.0):
    """10 log10 of a ratio of powers, above a floor."""
    return 10 * np.log10(np.maximum(power, 10 ** (floor / 10)))


# %%
# The drawing of the primary
# --------------------------
# A drawing program writes what light can pass: each hexagon, less the three vanes that hold the
# secondary mirror. Here the lesson writes the file itself, in mm, one path for each piece.

hexagons = pw.shapes.hexagonal_segments(SEGMENT, GAP, rings=2)
vanes = shapely.union_all(
    [
        shapely.affinity.rotate(shapely.box(-VANE / 2, 0, VANE / 2, 4), angle, origin=(0, 0))
        for angle in (0, 120, 240)
    ]
)
clear = shapely.difference(hexagons.polygons, vanes)
paths = "".join(
    '<path d="M '
    + " L ".join(
        f"{1e3 * x + 4000:.6f} {4000 - 1e3 * y:.6f}" for x, y in piece.exterior.coords[:-1]
    )
    + ' z"/>'
    for piece in shapely.get_parts(clear)
)
with tempfile.TemporaryDirectory() as folder:
    drawing = Path(folder) / "primary.svg"
    drawing.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="8000mm" height="8000mm" '
        f'viewBox="0 0 8000 8000">{paths}</svg>'
    )
    read = pw.read_aperture(drawing)

# %%
# The reader puts the origin at the drawing's corner, with y upwards; the axis of the telescope
# goes through its middle. The shadow of the vanes takes 0.8 m² of the mirror.

pupil = read.moved(-np.reshape(read.bounds, (2, 2)).mean(axis=0))
RADIUS = float(np.hypot(*np.concatenate(pupil.rings).T).max())
print(f"{len(pupil.rings)} pieces, {pupil.area:.2f} of {hexagons.area:.2f} m²")
assert len(pupil.rings) == 24
assert np.isclose(pupil.area, clear.area, rtol=1e-9)
assert 0.7 < hexagons.area - pupil.area < 0.9

# %%
# A star
# ------
# ``pw.psf`` is the irradiance in the focal plane of a star with a power of 1 through the pupil.
# At the peak that is :math:`A/(\lambda f)^2`. The smooth spikes are those of the vanes, at
# right angles to them; a vane is narrow, so they go on to :math:`\lambda f/0.1\,\mathrm{m}`,
# 2.6 mm. The beaded ones are at right angles to the sides of the hexagons.

RESOLVED = WAVELENGTH * FOCAL_LENGTH / (2 * RADIUS)
half = 40 * RESOLVED
axis = np.linspace(-half, half, 401)
places = np.stack(np.meshgrid(axis, axis), axis=-1)
star = pw.psf(pupil, places, WAVELENGTH, FOCAL_LENGTH)
PEAK = pupil.area / (WAVELENGTH * FOCAL_LENGTH) ** 2
assert np.isclose(star[200, 200], PEAK, rtol=1e-12)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.9), layout="compressed")
for ring in pupil.rings:
    left.fill(*ring.T, color="#b8860b", edgecolor="white", linewidth=0.3)
left.set(title="clear pupil", xlabel="x (m)", ylabel="y (m)", aspect="equal")
picture = right.imshow(
    decibels(star / PEAK), "inferno", origin="lower", extent=[-half * 1e3, half * 1e3] * 2
)
right.set(title="a star at 2 µm", xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(picture, label="PSF (dB below the peak, floor −60 dB)")

# %%
# Another way to the same numbers: a grid of places over the pupil, 5 mm apart, and a sum over
# all of them. It costs a million waves for each point. Amplitudes agree to 3e-6 of the peak.

step = 5e-3
lattice = np.arange(-RADIUS, RADIUS, step) + step / 2
x, y = np.meshgrid(lattice, lattice)
inside = shapely.contains_xy(pupil.polygons, x, y)
some = places[200, 200:260:6]
turns = np.outer(some[:, 0], x[inside]) + np.outer(some[:, 1], y[inside])
sums = np.exp(-2j * np.pi / (WAVELENGTH * FOCAL_LENGTH) * turns).sum(axis=1) * step**2
error = np.abs(np.abs(sums) / pupil.area - np.sqrt(star[200, 200:260:6] / PEAK)).max()
print(f"{inside.sum()} places; largest difference of amplitudes {error:.1e} of the peak")
assert error < 1e-5

# %%
# Segments out of place
# ---------------------
# A segment that is out by a step, or leans, sends a wave with a phase that is linear in x:
# exactly a weight and a plane wave. ``pw.segmented_pupil`` builds the array. For N equal
# segments whose wavefronts are off by independent pistons of the standard deviation
# :math:`\sigma`, with :math:`\phi = 2\pi\sigma/\lambda`, the mean Strehl ratio is
#
# .. math:: \langle S\rangle = e^{-\phi^2} + \frac{1 - e^{-\phi^2}}{N},
#
# Maréchal's exponential, and what N waves without any order still have at the peak. Segments
# behind vanes have less area; 1/N becomes the sum of squared areas over the square of the sum.
# At the peak the PSF is :math:`|F(0)|^2`, which takes 15 ms for each draw.

segments = [
    pw.Aperture(shapely.intersection(pupil.polygons, shapely.buffer(hexagon, GAP / 4)))
    for hexagon in shapely.get_parts(hexagons.polygons)
]
areas = np.array([segment.area for segment in segments])
assert len(segments) == 18 and np.isclose(areas.sum(), pupil.area, rtol=1e-9)

dice = np.random.default_rng(111)
origin = (0.0, 0.0)
strehl = {}
for sigma in (50e-9, 100e-9, 200e-9, 400e-9):
    mirrors = (
        pw.segmented_pupil(segments, WAVELENGTH, dice.normal(0, sigma, 18)) for _ in range(100)
    )
    draws = [abs(pw.fourier(mirror, origin)) ** 2 / pupil.area**2 for mirror in mirrors]
    decay = np.exp(-((2 * np.pi * sigma / WAVELENGTH) ** 2))
    expected = decay + (1 - decay) * (areas**2).sum() / areas.sum() ** 2
    strehl[sigma] = (np.mean(draws), np.std(draws) / np.sqrt(len(draws)), expected)
    print(f"{sigma * 1e9:4.0f} nm: {strehl[sigma][0]:.3f} ± {strehl[sigma][1]:.3f}, {expected:.3f}")
    assert abs(strehl[sigma][0] - expected) < 4 * strehl[sigma][1]

# %%
# Tilts spread the spots of single segments. Each segment resolves five times less than the
# telescope, so its spot of :math:`\lambda f/1.32\,\mathrm{m}` is wide, and tilts of 0.1 µrad
# matter less than pistons of 200 nm. One draw of both:

piston, tilt = dice.normal(0, 100e-9, 18), dice.normal(0, 0.1e-6, (18, 2))
mirror = pw.segmented_pupil(segments, WAVELENGTH, piston, tilt)
spot = np.linspace(-12 * RESOLVED, 12 * RESOLVED, 241)
close = np.stack(np.meshgrid(spot, spot), axis=-1)
figure, panels = plt.subplots(1, 2, figsize=(9, 3.9), layout="compressed", sharey=True)
sources: dict[str, pw.Aperture | pw.Array] = {"in place": pupil, "out of place": mirror}
for panel, (name, source) in zip(panels, sources.items(), strict=True):
    seen = pw.psf(source, close, WAVELENGTH, FOCAL_LENGTH) / PEAK
    picture = panel.imshow(
        decibels(seen, -40), "inferno", origin="lower", extent=[spot[0] * 1e6, spot[-1] * 1e6] * 2,
        vmin=-40, vmax=0,
    )  # fmt: skip
    panel.set(title=f"{name}, Strehl ratio {seen[120, 120]:.2f}", xlabel="x (µm)")
panels[0].set_ylabel("y (µm)")
figure.colorbar(picture, ax=panels, label="PSF (dB below the ideal peak, floor −40 dB)")

# %%
# A segment that is bent
# ----------------------
# Errors within segments are aberrations: path lengths in m on the pupil. One segment gets 150 nm
# rms of astigmatism, by the Zernike polynomial that is orthogonal on a hexagon. The function is
# zero on all other segments. It jumps within the gaps only, so it is smooth on every segment.

glass = shapely.get_parts(hexagons.polygons)
centres = np.array([hexagon.centroid.coords[0] for hexagon in glass])
hexagon = pw.Aperture(glass[0]).moved(-centres[0])
BENT, RMS = 7, 150e-9
bending = pw.zernike({6: RMS}, SEGMENT / np.sqrt(3), orthogonal_on=hexagon)
assert np.isclose(pw.wavefront_error(hexagon, bending), RMS)


def bent_segment(x, y):
    """Path length of the wavefront in m."""
    away = np.stack([x, y], axis=-1)[..., None, :] - centres
    is_bent = np.hypot(away[..., 0], away[..., 1]).argmin(axis=-1) == BENT
    return is_bent * bending(x - centres[BENT, 0], y - centres[BENT, 1])


bent = pw.Aberration(bent_segment, RADIUS)
fraction = areas[BENT] / areas.sum()
loss = fraction * (2 * np.pi * RMS / WAVELENGTH) ** 2  # Marechal, for one segment of 18
ratio = pw.strehl(pupil, WAVELENGTH, bent)
print(f"rms {pw.wavefront_error(pupil, bent) * 1e9:.0f} nm, Strehl ratio {ratio:.4f}")
assert abs(ratio - (1 - loss)) < 0.2 * loss

# %%
# Colours, focus and pixels
# -------------------------
# A detector sees a band of wavelengths at once. ``pw.mtf`` takes several: it averages their
# transfer functions, since each wavelength has a scale of its own. Frequencies are in cycles
# per metre in the image, 1000 times those in cycles per mm. A wavelength passes nothing beyond
# :math:`D/(\lambda f)`, with D the reach of the pupil along this direction. Pixels multiply by a
# sinc.

band = np.linspace(1.5e-6, 2.5e-6, 5)
PIXEL = 18e-6
cycles = np.linspace(0, 36, 73)
along = 1e3 * np.stack([cycles, 0 * cycles], axis=-1)
curves = {
    "2 µm": pw.mtf(pupil, along, WAVELENGTH, FOCAL_LENGTH),
    "1.5 to 2.5 µm": pw.mtf(pupil, along, band, FOCAL_LENGTH),
    "the same, a quarter wave out of focus": pw.mtf(pupil, along, band, FOCAL_LENGTH, 0.25),
    "the same, segments out of place": pw.mtf(mirror, along, band, FOCAL_LENGTH),
    "in place, pixels of 18 µm": pw.mtf(pupil, along, band, FOCAL_LENGTH, pixel=PIXEL),
}
reach = pupil.bounds[2] - pupil.bounds[0]
cut_off = reach / (WAVELENGTH * FOCAL_LENGTH) * 1e-3
print(f"cut-off at 2 µm: {cut_off:.1f} cycles/mm; pixels sample {0.5e-3 / PIXEL:.1f} cycles/mm")
assert curves["2 µm"][cycles > cut_off].max() < 1e-12
assert curves["2 µm"][cycles < 0.99 * cut_off].min() > 0

mean = np.mean([pw.otf(pupil, along * length * FOCAL_LENGTH) for length in band], axis=0)
assert np.allclose(curves["1.5 to 2.5 µm"], np.abs(mean), atol=1e-12)
pixels = np.abs(np.sinc(cycles * 1e3 * PIXEL))
assert np.allclose(
    curves["in place, pixels of 18 µm"], curves["1.5 to 2.5 µm"] * pixels, atol=1e-12
)

figure, axes = plt.subplots(figsize=(7.5, 3.9), layout="constrained")
for name, curve in curves.items():
    axes.plot(cycles, curve, label=name)
axes.axvline(0.5e-3 / PIXEL, color="black", linewidth=0.7, linestyle=":")
axes.text(0.5e-3 / PIXEL - 0.4, 0.97, "Nyquist frequency", rotation=90, ha="right", va="top")
axes.set(
    xlabel="spatial frequency along x (cycles per mm)", ylabel="MTF", xlim=(0, 36), ylim=(0, 1)
)
axes.grid(alpha=0.3)
axes.legend(frameon=False)

# %%
# Pistons and tilts are path lengths. ``pw.mtf`` uses their phases at each wavelength, so the
# array for 2 µm serves the band. The longest wavelength shows it. The phases of 2 µm at all
# wavelengths, as phase shifters would have them, give another curve:

longest = band[-1]
own = pw.otf(pw.segmented_pupil(segments, longest, piston, tilt), along * longest * FOCAL_LENGTH)
assert np.allclose(pw.mtf(mirror, along, longest, FOCAL_LENGTH), np.abs(own), atol=1e-12)
fixed = [pw.otf(mirror, along * length * FOCAL_LENGTH) for length in band]
apart = np.abs(np.abs(np.mean(fixed, axis=0)) - curves["the same, segments out of place"]).max()
print(f"with the phases of 2 µm the MTF would change by up to {apart:.3f}")
assert 0.001 < apart < 0.05

# %%
# On the test bench
# -----------------
# In the laboratory a stop with the pupil's shape, a thousand times smaller, stands 100 mm
# behind a chart of bars. A lamp lights the chart through a condenser, whose size decides how
# coherent the light is. ``pw.partially_coherent_image`` is closed form: orders of the chart,
# and areas of intersections of the condenser with two copies of the stop.

SHORT, DISTANCE = 550e-9, 0.1
stop = pw.Aperture(shapely.affinity.scale(pupil.polygons, 1e-3, 1e-3, origin=(0, 0)))
limit = (stop.bounds[2] - stop.bounds[0]) / (SHORT * DISTANCE) * 1e-3
PERIOD = 2e-3 / limit  # half of the cut-off
bars = pw.shapes.rectangle(PERIOD / 2, PERIOD)
across = np.linspace(-PERIOD, PERIOD, 161)
line = np.stack([across, 0 * across], axis=-1)
images = {
    size: pw.partially_coherent_image(
        bars,
        (PERIOD, PERIOD),
        stop,
        pw.shapes.disc(size * RADIUS * 1e-3, 48),
        line,
        SHORT,
        DISTANCE,
    )
    for size in (0.3, 1.0, 3.0)
}
figure, axes = plt.subplots(figsize=(7.5, 3.6), layout="constrained")
for k in (-1, 0, 1):
    axes.axvspan((k - 0.25) * PERIOD * 1e6, (k + 0.25) * PERIOD * 1e6, color="0.92")
contrasts = {}
for size, image in images.items():
    relative = image / image.mean()
    contrasts[size] = (image.max() - image.min()) / (image.max() + image.min())
    axes.plot(across * 1e6, relative / 2, label=f"condenser of {size:g} pupils")
axes.set(
    xlabel="x (µm)",
    ylabel="irradiance over twice the mean",
    xlim=(across[0] * 1e6, across[-1] * 1e6),
    ylim=(0, 1.05),
    title=f"clear bars of {PERIOD * 5e5:.2f} µm (grey), at half of the cut-off",
)
axes.legend(loc="upper center", ncols=3, frameon=False)

# %%
# In incoherent light the chart's first harmonic would have the amplitude :math:`\frac{2}{\pi}`
# times the MTF, beside a mean of 1/2; the second is missing, and the third passes no more. The
# condenser of three pupils makes that amplitude already, times the share of its light that the
# clear stop would pass. Its contrast is higher all the same: the chart's high orders, which a
# wider condenser would send through the stop from its rim, are missing in the mean.

transfer = float(pw.mtf(stop, [0.5e3 * limit, 0.0], SHORT, DISTANCE))
for size, contrast in contrasts.items():
    print(f"condenser of {size:g} pupils: contrast {contrast:.3f}")
print(f"incoherent light: {4 / np.pi * transfer:.3f}")
share = stop.area / pw.shapes.disc(3 * RADIUS * 1e-3, 48).area
assert np.isclose(np.ptp(images[3.0]), 2 * 2 / np.pi * transfer * share, rtol=1e-6)
assert 1 < contrasts[3.0] / (4 / np.pi * transfer) < 1.1

# %%
# What is not in it
# -----------------
# Light has no polarisation here, and turbulence is no part of the package.
#
# Exercises
# ---------
#
# 1. Turn the vanes by 30 degrees. Which spikes move?
# 2. How many nanometres of piston cost 20 % of the peak at 2 µm, and how many at 1.5 µm?
# 3. Plot the MTF along y. Where is its cut-off, and why is it another one?
# 4. Let one segment be dead: leave it out of the list. How far does the contrast fall at 10 cycles
#    per mm?
# 5. Take bars of a quarter of the cut-off. Which harmonics pass now, and which condenser gives the
#    highest contrast?
