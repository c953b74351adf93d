r"""
101: One aperture
=================

The first lesson takes one aperture through everything that a far field is: an outline, its
Fourier transform :math:`F`, the same in decibels over directions, and a first look at its Wigner
function :math:`W`. You need no more than Fraunhofer diffraction. At the end you can

* give polywigner an outline, from vertices, from its catalogue, or from a file;
* turn a direction into a spatial frequency, and back;
* read a picture in dB, and say what its zero and its floor are;
* read one slice of a Wigner function, signs included.
"""

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

# %%
# An outline
# ----------
# An aperture is a polygon: vertices in metres, in the plane :math:`z = 0`, radiating to
# :math:`+z`. There are three ways to one. A ring of vertices, in either order; the catalogue; and
# a file.

ell = pw.Aperture([(0, 0), (12e-3, 0), (12e-3, 4e-3), (4e-3, 4e-3), (4e-3, 12e-3), (0, 12e-3)])
chevron = pw.shapes.chevron(width=20e-3, height=12e-3, thickness=4e-3)
pair = pw.read_aperture("../two_chevrons/chevrons.geojson", unit="mm")

figure, panels = plt.subplots(1, 3, figsize=(9, 3), layout="constrained")
for axes, source, title in zip(
    panels, (ell, chevron, pair), ("vertices", "catalogue", "file"), strict=True
):
    for ring in source.rings:
        axes.fill(*ring.T * 1e3, color="#1f3b57")
    axes.set(title=f"{title}: {source.area * 1e6:.0f} mm²", xlabel="mm", aspect="equal")

# %%
# Apertures do not change, and two of the same outline are equal. Their area is exact.

assert ell == pw.Aperture(ell.rings[0][::-1])  # the other way round
assert np.isclose(ell.area, (12 * 4 + 4 * 8) * 1e-6, rtol=1e-14)

# %%
# Its Fourier transform
# ---------------------
# For a field :math:`u = 1` in the aperture :math:`G`,
#
# .. math:: F(\nu) = \int_G e^{-2\pi i\,\nu\cdot x}\,dx ,
#
# with :math:`\nu` in cycles per metre (never radians per metre). polywigner has it in closed
# form: a sum over edges, exact at any point, without a grid behind it. At :math:`\nu = 0` it is
# the area.

assert np.isclose(pw.fourier(ell, (0, 0)), ell.area, rtol=1e-14)

# %%
# For a rectangle the sum over edges has to be a product of two sincs. It is, to the last digits:

square = pw.shapes.square(10e-3)
rng = np.random.default_rng(101)
nu = rng.uniform(-2000, 2000, (1000, 2))  # points, (..., 2); values come back as (...)
product = np.prod(10e-3 * np.sinc(10e-3 * nu), axis=-1)
largest = np.abs(pw.fourier(square, nu) - product).max() / square.area
print(f"largest difference over the area: {largest:.1e}")
assert largest < 1e-14

# %%
# From frequencies to directions
# ------------------------------
# A wave that leaves along the unit vector :math:`s` has the spatial frequency
# :math:`\nu = (s_x, s_y)/\lambda` in the aperture. So a picture of :math:`F` is a map of
# directions: :math:`|\nu| = 1/\lambda` is the horizon, and what lies beyond is evanescent.
#
# The far field spans many orders of magnitude, so it is drawn in decibels. Three things have to
# be said with every dB: **ten** times the logarithm of a power, :math:`10\log_{10}|F|^2`;
# **relative to what**, here the peak, which for a uniform field is always
# :math:`|F(0)|^2 = \mathrm{area}^2`; and **where the floor is**, because a null is
# :math:`-\infty`.

FREQUENCY = 94e9
WAVELENGTH = 299_792_458 / FREQUENCY
FLOOR = -40.0


def level(source, nu):
    """|F|² in dB relative to its peak, cut off at the floor."""
    power = np.abs(pw.fourier(source, nu)) ** 2 / source.area**2
    return 10 * np.log10(np.maximum(power, 10 ** (FLOOR / 10)))


axis = np.linspace(-1.25, 1.25, 301)  # nu lambda = s_x and s_y
grid = np.stack(np.meshgrid(axis, axis), axis=-1) / WAVELENGTH

figure, panels = plt.subplots(1, 2, figsize=(9, 3.9), layout="constrained", sharey=True)
for axes, source, title in zip(panels, (square, chevron), ("square", "chevron"), strict=True):
    picture = axes.imshow(
        level(source, grid), "inferno", origin="lower", extent=2 * [axis[0], axis[-1]], vmin=FLOOR
    )
    axes.add_patch(plt.Circle((0, 0), 1, fill=False, color="white", linestyle=":"))
    axes.set(title=title, xlabel=r"$s_x = \lambda\nu_x$")
panels[0].set_ylabel(r"$s_y = \lambda\nu_y$")
figure.colorbar(picture, ax=panels, label=r"$|F|^2$ (dB rel. to peak; floor $-40$ dB)")

# %%
# The dotted circle is the horizon. Every family of parallel edges throws a streak at right angles
# to itself: two for the square; three for the chevron, those of its two arms and a faint one
# along :math:`s_x` of its short, upright ends.
#
# A cut through the square's pattern gives the numbers that every antenna book has: the first
# sidelobe at -13.26 dB, and the half-power beam width :math:`2\arcsin(0.443\,\lambda/a)`.

theta = np.radians(np.linspace(-90, 90, 3601))
cut = np.stack([np.sin(theta), np.zeros_like(theta)], axis=-1) / WAVELENGTH
db = level(square, cut)

figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
axes.plot(np.degrees(theta), db, color="#1f3b57")
axes.axhline(-13.26, color="#c1440e", linewidth=0.8)
axes.set(xlabel="angle from the normal (degrees)", ylabel="dB", ylim=(FLOOR, 1), xlim=(-90, 90))
axes.set_title("10 mm square at 94 GHz")

beyond_null = np.abs(np.sin(theta)) > WAVELENGTH / 10e-3
first_sidelobe = db[beyond_null].max()
width = np.ptp(np.degrees(theta[db > 10 * np.log10(0.5)]))
print(f"first sidelobe {first_sidelobe:.2f} dB, half-power width {width:.1f} degrees")
assert abs(first_sidelobe + 13.26) < 0.01
assert abs(width - 2 * np.degrees(np.arcsin(0.4429 * WAVELENGTH / 10e-3))) < 0.1

# %%
# A first slice of the Wigner function
# ------------------------------------
# :math:`F` says how much goes in which direction, but not where it comes from. The Wigner
# function says both:
#
# .. math::
#    W(x, \nu) =
#    \int u(x + \tfrac{\xi}{2})\,u^*(x - \tfrac{\xi}{2})\,e^{-2\pi i\,\nu\cdot\xi}\,d\xi ,
#
# the strength of the ray that leaves the position :math:`x` in the direction of :math:`\nu`. It
# has four coordinates; a picture is a slice of it. Here are all directions at one position. The
# map is diverging and centred at zero, because :math:`W` is real but not positive: what is
# negative here is made up for elsewhere.

x = np.array([0.0, 1e-3])  # between the arms of the chevron, outside of it
w = pw.wigner(chevron, x, grid)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="compressed")
left.fill(*chevron.rings[0].T * 1e3, color="#1f3b57")
left.plot(*x * 1e3, "+", color="#c1440e", markersize=12, markeredgewidth=2)
left.set(title="where: x", xlabel="mm", ylabel="mm", aspect="equal")
limit = np.abs(w).max() * 1e6
picture = right.imshow(
    w * 1e6, "RdBu_r", origin="lower", extent=2 * [axis[0], axis[-1]], vmin=-limit, vmax=limit
)
right.set(title="W(x, ν)", xlabel=r"$\lambda\nu_x$", ylabel=r"$\lambda\nu_y$")
figure.colorbar(picture, label="W (mm²)")

assert w.min() < 0 < w.max()
assert pw.position_marginal(chevron, x) > 0  # the sum over all lags

# %%
# There is no material at :math:`x`, and yet :math:`W` is not zero: pairs of points on the two
# arms have their middle there, and this is their interference. What it means that a "ray" is
# negative, and how one gets from here to things that can be measured, is
# :doc:`lesson 102 <lesson_102_phase_space>`.
#
# One value is easy to check. At the centre of a convex aperture with a centre of symmetry every
# point has its mirror image inside, the set of lags is the aperture twice as large, and so
# :math:`W(0, 0) = 4\,\mathrm{area}`: as large as a Wigner function of this energy can be,
# anywhere.

assert np.isclose(pw.wigner(square, (0, 0), (0, 0)), 4 * square.area, rtol=1e-14)

# %%
# Exercises
# ---------
# 1. Turn the square by 45 degrees (``pw.shapes.regular_polygon(4, ...)``). Where does the -13.26
#    dB sidelobe go, and how high is the first sidelobe of the cut along :math:`s_x` now? (Twice
#    as many dB: why?)
# 2. Which streaks of the chevron come from which edges? Make its thickness larger and smaller,
#    and watch the distance of the nulls along each.
# 3. At which frequency does the first null of the 10 mm square reach the horizon? What does the
#    radiation pattern look like below that frequency?
# 4. Move the cross of the last picture outside the chevron's hull. What is :math:`W` there? Which
#    set are the positions at which it is not zero? (``pw.automean(chevron)``; the next lesson has
#    the answer.)
