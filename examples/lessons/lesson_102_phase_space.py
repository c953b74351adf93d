r"""
102: Phase space
================

:math:`W` and :math:`A` are functions of position *and* frequency. This lesson is about reading
them: what a slice shows, where the negative values come from and what they are for, and which
sums of them are things one can measure. It begins on a line, where a Wigner function fits into
one picture, and then goes back to the plane.
"""

import matplotlib.pyplot as plt
import numpy as np
import shapely

import polywigner as pw

ROUNDING = 1e-12  # of the energy: these are identities, not approximations

# %%
# One slit
# --------
# A slit of width :math:`a` in one dimension has the Wigner function
# :math:`W(x, \nu) = 2L\,\mathrm{sinc}(2L\nu)` with :math:`L = a - 2|x|`: in the middle of the
# slit all lags up to :math:`\pm a` fit in, and the pattern is narrow; towards the rims fewer and
# fewer do, and it widens. This is the uncertainty relation at every place: what is near an edge
# has no sharp direction.

WIDTH, DISTANCE = 1.0, 4.0  # in any unit; frequencies are then cycles per unit
slit = pw.shapes.slit(WIDTH)
x = np.linspace(-0.6, 0.6, 241)[:, None, None]  # (..., 1): one component
nu = np.linspace(-4, 4, 321)[:, None]
w = pw.wigner(slit, x, nu)  # x along the first axis, nu along the second

lag = 2 * np.maximum(0, WIDTH - 2 * np.abs(x[..., 0]))
assert np.abs(w - lag * np.sinc(lag * nu[:, 0])).max() < ROUNDING


def draw(axes, w, x, nu, title, unit=""):
    """W over position (to the right) and frequency (upwards): red is positive, blue negative."""
    limit = np.abs(w).max()
    box = [x.min(), x.max(), nu.min(), nu.max()]
    picture = axes.imshow(
        w.T, "RdBu_r", vmin=-limit, vmax=limit, origin="lower", extent=box, aspect="auto"
    )
    axes.set(title=title, xlabel=f"x{unit}", ylabel=r"$\nu$")
    return picture


# %%
# Two slits, and what is between them
# -----------------------------------
# Two slits a distance :math:`d` apart are the *cat state* of this trade. Their Wigner function
# has three parts: one at each slit, which would be there without the other, and one in the middle
# between them, :math:`2 W_1(x, \nu)\cos(2\pi\nu d)`, where there is no slit at all.

slits = pw.shapes.slit_pair((WIDTH, WIDTH), (-DISTANCE / 2, DISTANCE / 2))
x_two = np.linspace(-2.8, 2.8, 561)[:, None, None]
w_two = pw.wigner(slits, x_two, nu)

figure, (left, right) = plt.subplots(
    1, 2, figsize=(9, 3.6), layout="constrained", gridspec_kw={"width_ratios": [1, 2]}
)
draw(left, w, x, nu, "one slit")
figure.colorbar(draw(right, w_two, x_two, nu, "two slits"), label="W")

middle = pw.wigner(slits, x, nu)
expected = 2 * w * np.cos(2 * np.pi * nu[:, 0] * DISTANCE)
assert np.abs(middle - expected).max() < ROUNDING

# %%
# At its peak the middle part is twice as strong as either slit, and it is negative half of the
# time. It is the *interference* of the slits, sitting where the middle of a pair of points is. A
# double slit that is lit incoherently has the two outer parts and nothing between them.
#
# What can be measured: sums along the axes
# -----------------------------------------
# Sum over positions, and :math:`\int W\,dx = |F(\nu)|^2` remains: the far field. Here in numbers,
# with a midpoint rule over x (the slices are straight lines and sines, so that a few thousand
# points do):


def midpoints(low, high, count):
    step = (high - low) / count
    return (low + step * (np.arange(count) + 0.5))[:, None, None], step


places, step = midpoints(-3, 3, 6000)
far = pw.wigner(slits, places, nu).sum(axis=0) * step
measured = np.abs(pw.fourier(slits, nu)) ** 2
print(f"int W dx against |F|²: {np.abs(far - measured).max():.1e} of {measured.max():.1f}")
assert np.abs(far - measured).max() < 1e-5  # midpoints: the square of the step
assert far.min() > -1e-5  # W is negative in places; what is measured is not

# %%
# Sum over frequencies, and :math:`\int W\,d\nu = |u(x)|^2` remains: the light in the opening.
# :math:`W` of sharp edges falls off as :math:`1/\nu` only, so the sum is taken with a slowly
# falling weight (Fejér's), which does not change its limit. In the middle, between the slits, the
# fringes have to cancel, and they do:

LARGEST = 400.0
fine, step = np.linspace(-LARGEST, LARGEST, 160_001, retstep=True)
weight = 1 - np.abs(fine) / LARGEST
for place, there in ((-2.0, 1.0), (2.2, 1.0), (0.0, 0.0), (0.2, 0.0)):
    total = np.sum(weight * pw.wigner(slits, [place], fine[:, None])) * step
    print(f"x = {place:4}: int W dnu = {total:6.3f}, |u|² = {there:.0f}")
    assert abs(total - there) < 2e-3  # 1/(pi² LARGEST L) of the weight

# %%
# Summed over both, all of it is the energy :math:`E = \int|u|^2\,dx`, here the width of both
# slits. And Moyal's formula, :math:`\iint W^2\,dx\,d\nu = E^2`, says that a Wigner function
# cannot be a spike: :math:`W` has to be spread over as much of phase space, whatever the shape of
# the aperture. (Over frequencies a sum with a spacing :math:`\delta` is exact up to copies at
# lags :math:`1/\delta`, here 20, and slits have no lags beyond 5.)

energy = pw.lag_marginal(slits, [0.0]).real
assert np.isclose(energy, 2 * WIDTH, rtol=1e-14)

spaced = np.arange(-4000, 4001) * 0.05
places, step = midpoints(-3, 3, 1200)
table = pw.wigner(slits, places, spaced[:, None])
square = np.sum(table**2) * step * 0.05
print(f"int int W² = {square:.3f}, energy² = {energy**2:.3f}")
assert abs(square / energy**2 - 1) < 2e-3  # what lies beyond |nu| = 200

# %%
# The ambiguity function: the same, seen from the origin
# ------------------------------------------------------
# :math:`A(\upsilon, \xi) = \int u(x + \xi/2)\,u^*(x - \xi/2)\,e^{-2\pi i\,\upsilon\cdot x}\,dx`
# is the Fourier transform of :math:`W` over both arguments. There, every part is judged by
# *differences*: what each slit has with itself lies around :math:`\xi = 0`, on top of each other,
# and the interference lies at :math:`\xi = \pm d`, aside. In :math:`W` interference is what
# oscillates; in :math:`A` it is what is away from the origin. A filter is easy to see in
# :math:`A`, a place in :math:`W`.

xi = np.linspace(-5.5, 5.5, 441)[:, None, None]
upsilon = np.linspace(-4, 4, 321)[:, None]
a = np.abs(pw.ambiguity(slits, upsilon, xi))

figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
picture = axes.imshow(
    a.T,
    "viridis",
    origin="lower",
    extent=(-5.5, 5.5, -4, 4),
    aspect="auto",
    interpolation="nearest",
)
axes.set(xlabel=r"$\xi$", ylabel=r"$\upsilon$", title="|A| of two slits")
figure.colorbar(picture, label="|A|")

assert a.max() <= energy * (1 + 1e-14)  # and the largest value is at the origin
assert np.isclose(pw.ambiguity(slits, [0.0], [0.0]).real, energy, rtol=1e-14)
one = pw.ambiguity(
    slits, [0.7], [DISTANCE]
).real  # at the lag d only one pair is left: slit on slit
assert np.isclose(one, WIDTH * np.sinc(WIDTH * 0.7), rtol=1e-12)

# %%
# That :math:`A` is the transform of :math:`W` is a check by itself. Both are known exactly, so
# the table above has to reproduce a value of :math:`A` (mind the signs: :math:`\upsilon\cdot x`
# and :math:`-\nu\cdot\xi`):

shift, lag_point = 0.3, 0.45
weight = 1 - np.abs(spaced) / 200.05
phase = np.exp(-2j * np.pi * (shift * places[..., 0] - spaced * lag_point))
result = np.sum(table * phase * weight) * step * 0.05
there = pw.ambiguity(slits, [shift], [lag_point])
print(f"A from W: {result:.4f}; A: {there:.4f}")
assert abs(result - there) < 5e-3 * energy

# %%
# Back to the plane
# -----------------
# With two coordinates of each kind a picture is a slice: all positions for one direction, or all
# directions at one position. Two chevrons, at 94 GHz:

chevrons = pw.read_aperture("../two_chevrons/chevrons.geojson", unit="mm")
support = pw.automean(chevrons)
WAVELENGTH = 299_792_458 / 94e9

axis = np.linspace(-13e-3, 13e-3, 261)
positions = np.stack(np.meshgrid(axis, axis), axis=-1)
angles = np.linspace(-1, 1, 241)
directions = np.stack(np.meshgrid(angles, angles), axis=-1) / WAVELENGTH

figure, panels = plt.subplots(2, 2, figsize=(9, 5.9), layout="compressed")
for axes, direction in zip(panels[0], ((0, 0), (0.35, 0)), strict=True):
    w = pw.wigner(chevrons, positions, np.array(direction) / WAVELENGTH) * 1e6
    limit = np.abs(w).max()
    picture = axes.imshow(
        w, "RdBu_r", vmin=-limit, vmax=limit, origin="lower", extent=2 * [-13, 13]
    )
    for outline, style in ((chevrons, "-"), (support, ":")):
        for ring in outline.rings:
            axes.plot(*np.vstack([ring, ring[:1]]).T * 1e3, style, color="black", linewidth=0.9)
    axes.set(title=rf"all x, at $\lambda\nu$ = {direction}", xlabel="mm", ylabel="mm", ylim=(-8, 8))
    figure.colorbar(picture, ax=axes, label="W (mm²)")
for axes, place in zip(panels[1], ((9e-3, 0), (0, 0)), strict=True):
    w = pw.wigner(chevrons, place, directions) * 1e6
    limit = np.abs(w).max()
    picture = axes.imshow(w, "RdBu_r", vmin=-limit, vmax=limit, origin="lower", extent=2 * [-1, 1])
    axes.set(
        title=f"all ν, at x = ({place[0] * 1e3:.0f}, {place[1] * 1e3:.0f}) mm",
        xlabel=r"$\lambda\nu_x$",
        ylabel=r"$\lambda\nu_y$",
    )
    figure.colorbar(picture, ax=axes, label="W (mm²)")

# %%
# Above: at :math:`\nu = 0` nothing is negative, since :math:`W(x, 0)` is an area, that of the lag
# slice :math:`2(G - x) \cap 2(x - G)`. Aslant it is. The dotted line is the *automean*, the set
# of all middles of two points of the aperture: beyond it :math:`W` is zero, whatever the
# direction. Below, on the right: the origin lies in no aperture at all, and has the strongest
# fringes of all places, as fine as the chevrons are far apart.

slice_area = pw.lag_slice(chevrons, (0, 0)).area
assert np.isclose(pw.wigner(chevrons, (0, 0), (0, 0)), slice_area, rtol=1e-12)
assert not chevrons.polygons.contains(shapely.Point(0, 0))
assert support.area > chevrons.area
print(f"aperture {chevrons.area * 1e6:.0f} mm², automean {support.area * 1e6:.0f} mm²")

outside = ~shapely.contains_xy(support.polygons.buffer(1e-9), positions[..., 0], positions[..., 1])
w = pw.wigner(chevrons, positions[outside], (100.0, 50.0))
assert np.abs(w).max() == 0

# %%
# And the marginal, in the plane as on the line: all positions together have, in any direction,
# what the far field has. The sum goes over the automean, not over the aperture. Without the
# places between the chevrons it comes out wrong.

cell = 0.05e-3
axis = np.arange(-13e-3, 13e-3, cell) + cell / 2
positions = np.stack(np.meshgrid(axis, axis), axis=-1)
in_aperture = shapely.contains_xy(chevrons.polygons, positions[..., 0], positions[..., 1])
for direction in ((0.0, 0.0), (0.25, 0.1)):
    nu = np.array(direction) / WAVELENGTH
    w = pw.wigner(chevrons, positions, nu)
    everywhere, inside = w.sum() * cell**2, w[in_aperture].sum() * cell**2
    far = abs(pw.fourier(chevrons, nu)) ** 2
    print(
        f"{direction}: automean {everywhere / far:.4f}, aperture alone {inside / far:.4f} of |F|²"
    )
    assert abs(everywhere / far - 1) < 5e-3  # squares of 0.05 mm
    assert abs(inside / far - 1) > 0.05

# %%
# Exercises
# ---------
# 1. Make the two slits of different width. Which of the three parts of W change, and why is the
#    middle one a trapezium in x at :math:`\nu = 0`?
# 2. Give the second slit a phase: ``pw.Array([slit_a, slit_b], [1, 1j])``. What moves? Show that
#    neither :math:`\int W\,d\nu` nor the outer parts know of it.
# 3. Three slits have how many interference parts, and at which positions? For equal distances two
#    of them fall on a slit.
# 4. Where is :math:`A` of the chevrons zero for every :math:`\upsilon`? Compare with the OTF of
#    the same aperture.
# 5. Moyal's formula for one slit: do both integrals by hand.
