r"""
106: OTF and defocus of a telescope pupil
=========================================

A pupil is an aperture too. Its autocorrelation is the optical transfer function, its Fourier
transform squared the point-spread function, and its ambiguity function holds the OTF for *every*
defocus at once. The pupil of this lesson has 18 hexagons, as that of the James Webb Space
Telescope has. (Its struts and its obscured middle are left out, except for the missing segment.)
All of it is closed form; sums appear only as a check.
"""

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

WAVELENGTH = 2e-6
pupil = pw.shapes.hexagonal_segments(flat_to_flat=1.32, gap=7e-3, rings=2, centre=False)
RADIUS = np.hypot(*np.concatenate(pupil.rings).T).max()
print(f"{len(pupil.rings)} segments, {pupil.area:.2f} m², {2 * RADIUS:.2f} m from vertex to vertex")
assert len(pupil.rings) == 18
assert np.isclose(pupil.area, 18 * np.sqrt(3) / 2 * 1.32**2, rtol=1e-12)

# %%
# The point-spread function
# -------------------------
# Light of a star comes out of the pupil as :math:`|F(\nu)|^2` with :math:`\nu = \theta/\lambda`.
# Dividing by :math:`\mathrm{area}^2` makes it 1 at the peak. The six spikes are at right angles
# to the three directions that the sides of the segments have; the fainter structure is the gaps'
# and the segments' own.

ARCSECOND = np.pi / 180 / 3600


def psf(angle):
    """Point-spread function at angles (..., 2) in arcseconds, relative to its peak."""
    return np.abs(pw.fourier(pupil, angle * ARCSECOND / WAVELENGTH)) ** 2 / pupil.area**2


axis = np.linspace(-1.2, 1.2, 401)
field = np.stack(np.meshgrid(axis, axis), axis=-1)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.9), layout="compressed")
for ring in pupil.rings:
    left.fill(*ring.T, color="#b8860b", edgecolor="white", linewidth=0.3)
left.set(title="pupil", xlabel="m", ylabel="m", aspect="equal")
picture = right.imshow(
    np.maximum(10 * np.log10(np.maximum(psf(field), 1e-6)), -50),
    "inferno",
    origin="lower",
    extent=2 * [-1.2, 1.2],
)
right.set(title="PSF at 2 µm", xlabel="arcsec")
figure.colorbar(picture, label="dB rel. to the peak; floor $-50$ dB")

radial = np.linspace(0, 0.2, 4001)
width = 2 * radial[np.argmax(psf(np.stack([radial, 0 * radial], axis=-1)) < 0.5)]
print(f"full width at half maximum: {width * 1e3:.0f} milliarcsec")
assert 0.055 < width < 0.075  # about lambda/D: 0.064 arcsec for 6.5 m

# %%
# The OTF
# -------
# ``pw.otf`` takes the lag in the pupil: the lag :math:`\xi` passes the spatial frequency
# :math:`\xi/\lambda` (cycles per radian on the sky). First a pupil whose OTF is known: a full
# disc, :math:`\frac{2}{\pi}\left(\arccos s - s\sqrt{1 - s^2}\right)` with :math:`s = |\xi|/2R`.
# The polygon of the disc's area has it to the third order in the number of its sides:

s = np.linspace(0, 1.1, 111)
inside = np.minimum(s, 1)
analytic = 2 / np.pi * (np.arccos(inside) - inside * np.sqrt(1 - inside**2))
for sides in (32, 64, 128, 256):
    disc = pw.shapes.disc(RADIUS, n=sides)
    error = np.abs(pw.otf(disc, np.stack([2 * RADIUS * s, 0 * s], axis=-1)) - analytic).max()
    print(f"{sides} sides: {error:.1e}")
assert error < 1e-6

# %%
# The segments' OTF falls faster at first, since their outline is long for their area: the gaps
# and the missing middle count. It ends where the pupil does, along x earlier than along y. What
# is exact about any pupil: 1 at zero, symmetric, and a slope at zero that is half of the length
# of all edges, as seen along the lag, over the area.

along_x, along_y = (
    np.stack([2 * RADIUS * s * c, 2 * RADIUS * s * (1 - c)], axis=-1) for c in (1, 0)
)
figure, axes = plt.subplots(figsize=(7.5, 3.6), layout="constrained")
axes.plot(s, analytic, color="black", label="disc of the same reach")
axes.plot(s, pw.otf(pupil, along_x).real, label="18 segments, along x")
axes.plot(s, pw.otf(pupil, along_y).real, label="18 segments, along y")
axes.set(xlabel=r"$|\xi|/2R$", ylabel="OTF", xlim=(0, 1.1))
axes.legend()

assert np.isclose(pw.otf(pupil, (0, 0)).real, 1, rtol=1e-14)
lengths = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in pupil.rings])
slope = np.abs(lengths[:, 1]).sum() / 2 / pupil.area  # along x an edge has the length of its y
tiny = 1e-4  # m, far less than the gaps
assert np.isclose((1 - pw.otf(pupil, (tiny, 0)).real) / tiny, slope, rtol=1e-3)

some = np.random.default_rng(106).uniform(-3, 3, (50, 2))
assert np.allclose(pw.otf(pupil, -some), np.conj(pw.otf(pupil, some)), rtol=0, atol=1e-13)

# %%
# Defocus
# -------
# A defocus of :math:`w` waves at the pupil's rim is the phase :math:`e^{2\pi i\,w\,|x|^2/a^2}`.
# On the two copies of the pupil in the autocorrelation it differs by a *linear* phase, so the OTF
# out of focus is a slanted line through the ambiguity function of the pupil in focus:
#
# .. math:: \mathrm{OTF}(\xi; w) = A(-2w\,\xi/a^2,\ \xi)/A(0, 0) .
#
# One function holds all of them; nothing is transformed again. With a quarter of a wave the
# contrast drops, and with one wave it is reversed in bands.

line = np.linspace(0, 2 * RADIUS, 301)
lags = np.stack([line, 0 * line], axis=-1)
figure, axes = plt.subplots(figsize=(7.5, 3.6), layout="constrained")
for waves in (0.0, 0.25, 0.5, 1.0):
    otf = pw.otf(pupil, lags, defocus=waves)
    axes.plot(line / WAVELENGTH * ARCSECOND, otf.real, label=f"{waves} waves")
    slope = -2 * waves / RADIUS**2
    by_hand = pw.ambiguity(pupil, slope * lags, lags) / pupil.area
    assert np.abs(otf - by_hand).max() < 1e-13
axes.axhline(0, color="black", linewidth=0.6)
axes.set(xlabel="spatial frequency (cycles per arcsec)", ylabel="OTF", title="W20 at the rim")
axes.legend()
assert pw.otf(pupil, lags, defocus=1.0).real.min() < -0.01

# %%
# The PSF out of focus, and the Strehl ratio
# ------------------------------------------
# The PSF is the Fourier transform of the OTF. A sum over a grid of lags does it: the OTF has a
# finite support, so that the spacing alone decides, and only about how far out copies of the PSF
# lie. The Strehl ratio, the peak compared with that in focus, is the mean of the OTF relative to
# that in focus.

COUNT = 96
cells = (np.arange(COUNT) - COUNT // 2) * (4 * RADIUS * 1.05 / COUNT)
grid = np.stack(np.meshgrid(cells, cells), axis=-1)
window = np.linspace(-0.5, 0.5, 161)
waves_of = np.exp(2j * np.pi * np.outer(window * ARCSECOND / WAVELENGTH, cells))
otfs = {waves: pw.otf(pupil, grid, defocus=waves) for waves in (0.0, 0.25, 0.5, 1.0)}
total = np.sum(otfs[0.0]).real

figure, panels = plt.subplots(1, 3, figsize=(10, 3.3), layout="compressed")
for axes, waves in zip(panels, (0.0, 0.5, 1.0), strict=True):
    image = (waves_of @ otfs[waves] @ waves_of.T).real / total
    if waves == 0:
        inner = np.stack(np.meshgrid(window, window), axis=-1)
        print(f"PSF from the OTF against |F|²: {np.abs(image - psf(inner)).max():.1e}")
        assert np.abs(image - psf(inner)).max() < 1e-3
    picture = axes.imshow(
        10 * np.log10(np.maximum(image, 1e-4)),
        "inferno",
        extent=2 * [-0.5, 0.5],
        vmin=-40,
        vmax=0,
        origin="lower",
    )
    axes.set(title=f"{waves} waves", xlabel="arcsec")
figure.colorbar(picture, ax=panels, label="dB rel. to the peak in focus")

# %%
# The second way to the Strehl ratio does not know of the OTF:
# :math:`\left|\int_G e^{2\pi i w |x|^2/a^2}\,dx\right|^2 / \mathrm{area}^2`, over triangles with
# a rule of Gauss's. For a full disc it is :math:`\mathrm{sinc}^2 w`.


def over_polygons(aperture, function, nodes=8):
    """Integral of a function of x over convex parts, by Gauss rules on their triangles."""
    t, weight = np.polynomial.legendre.leggauss(nodes)
    t, weight = (t + 1) / 2, weight / 2
    total = 0.0
    for ring in aperture.rings:
        middle = ring.mean(axis=0)
        for first, second in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            a, b = first - middle, second - middle
            r, q = np.meshgrid(t, t)  # Duffy's square: x = middle + r (a + q (b - a))
            x = middle + r[..., None] * (a + q[..., None] * (b - a))
            area = abs(a[0] * b[1] - a[1] * b[0])
            total += area * np.sum(np.outer(weight, weight * t) * function(x))
    return total


assert np.isclose(over_polygons(pupil, lambda x: np.ones(x.shape[:-1])), pupil.area, rtol=1e-12)
for waves in (0.25, 0.5, 1.0):
    direct = abs(
        over_polygons(
            pupil, lambda x, w=waves: np.exp(2j * np.pi * w * np.sum(x**2, axis=-1) / RADIUS**2)
        )
        / pupil.area
    )
    from_otf = np.sum(otfs[waves]).real / total
    print(f"{waves} waves: {from_otf:.4f} from the OTF, {direct**2:.4f} over the pupil; ", end="")
    print(f"a disc has {np.sinc(waves) ** 2:.4f}")
    assert abs(from_otf - direct**2) < 2e-3

# %%
# Exercises
# ---------
# 1. Close the gaps (``gap=0``). Which part of the PSF changes, and by how much? Do the spikes come
#    from the gaps or from the outline?
# 2. Draw :math:`A(\upsilon_x, \xi_x)` with :math:`\upsilon_y = \xi_y = 0` (``pw.projections``
#    does it), and find the OTFs of this lesson in it as lines through the origin.
# 3. A tilt of one segment by a tenth of a wave: make a ``pw.Array`` of ``pw.Aperture(ring)`` for
#    each ring, give one its own ``pw.Illumination``, and compute the Strehl ratio from ``pw.otf``
#    of the array.
# 4. Why does the Strehl ratio of the segments at one wave not vanish, as it does for the disc?
