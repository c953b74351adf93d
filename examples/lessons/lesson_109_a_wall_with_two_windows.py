r"""
109: A wall with two windows
============================

Young let light through two openings and saw fringes. This lesson cuts two windows into a wall, puts
the wall before a source as an *obstacle*, and looks at the light behind it: where the fringes come
from, what they have to do with the field of two apertures, and how they fade when the lamp grows or
the wall comes nearer to it.
"""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

WAVELENGTH = 299_792_458 / 94e9
WIDTH, HEIGHT, APART = 8e-3, 30e-3, 30e-3
"""Each window's sides, and the distance of their centres, in m."""
BEFORE, BEHIND = 0.5, 0.3
"""Distances of the lamp and of the plane that we look at from the wall, in m."""

# %%
# The wall
# --------
# An obstacle is an outline in a pose, holes and all. The wall stands at z = 0, and its windows are
# the part that is cut out of it. ``pw.PointSource`` radiates :math:`e^{ikR}/R`.

windows = pw.shapes.double_slit(WIDTH, HEIGHT, (-APART / 2, APART / 2))
solid = pw.shapes.square(1.6)
AT_ORIGIN = np.eye(4)


def behind(wall: pw.Aperture, points: Any, source: pw.PointSource) -> Any:
    """Field at points behind a wall at z = 0."""
    obstacle = wall.placed(AT_ORIGIN)
    return pw.amplitude(source, points, WAVELENGTH, "kirchhoff", obstacles=obstacle)


def lamp(x: float = 0.0, distance: float = BEFORE) -> pw.PointSource:
    """A point of the lamp, of amplitude 1 at the middle of the wall."""
    return pw.PointSource((x, 0.0, -distance), distance)


axis = np.linspace(-0.12, 0.12, 121)
plane = np.stack([*np.meshgrid(axis, axis), np.full((121, 121), BEHIND)], axis=-1)
free = BEFORE / (BEFORE + BEHIND)
field = behind(solid - windows, plane, lamp())

figure, axes = plt.subplots(figsize=(5.6, 4.4), layout="constrained")
picture = axes.imshow(
    20 * np.log10(np.maximum(np.abs(field) / free, 1e-2)),
    "inferno",
    origin="lower",
    extent=(-120, 120, -120, 120),
    vmin=-40,
    vmax=0,
)
axes.set(xlabel="x (mm)", ylabel="y (mm)", title="0.3 m behind a wall with two windows")
figure.colorbar(picture, label=r"$|U|^2$ (dB rel. to the field without a wall; floor $-40$ dB)")

# %%
# The windows' edges send waves, and so does the rim of the wall. Babinet tells them apart: the
# field behind the wall with windows is the sum of two, the field of the windows in an endless wall
# (``pw.Screen``) and the field behind the wall without windows. The second part is a disturbance
# of 1 % here.

line = np.linspace(-0.12, 0.12, 481)
points = np.column_stack([line, 0 * line, 0 * line + BEHIND])
through_windows = pw.amplitude(
    pw.Screen(windows, lamp(), kind="opening"), points, WAVELENGTH, "kirchhoff"
)
whole, rim = (behind(wall, points, lamp()) for wall in (solid - windows, solid))
peak = np.abs(whole).max()
print(f"Babinet: {np.abs(whole - rim - through_windows).max() / peak:.0e} of the peak")
print(f"the wall's rim: {np.abs(rim).max() / peak:.3f} of the peak")
assert np.abs(whole - rim - through_windows).max() < 1e-6 * peak
assert np.abs(rim).max() < 0.015 * peak

# %%
# Fringes
# -------
# The ways from the lamp through both windows differ by a wavelength from one bright fringe to the
# next: :math:`\lambda z/d` apart, z behind windows that are d from each other, whatever the
# distance of the lamp. One window alone makes a broad patch of light; where the two patches
# overlap, the irradiance swings between nothing and four times that of one.

one = pw.Aperture(windows.rings[1])
alone = np.abs(behind(solid - one, points, lamp())) ** 2
level = np.abs(whole) ** 2
bright = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:]) & (level[1:-1] > level.max() / 2)
spacing = np.diff(line[1:-1][bright]).mean()
predicted = WAVELENGTH * BEHIND / APART
print(f"fringes {1e3 * spacing:.1f} mm apart, by the rule {1e3 * predicted:.1f} mm")
assert abs(spacing / predicted - 1) < 0.05
middle = len(line) // 2
print(f"in the middle {level[middle] / alone[middle]:.2f} times the light of one window")
assert abs(level[middle] / alone[middle] - 4) < 0.3

# %%
# Two apertures
# -------------
# An aperture in polywigner *is* an opening in a black plane, lit by a plane wave. Move the lamp far
# away, and the wall with windows becomes the pair of apertures whose transforms the first lessons
# draw. What is left is the rim of the wall, 6 % of the peak now that all of it is lit as brightly.

FAR = 300_000 * WAVELENGTH  # whole wavelengths: the phase at the wall is that of the apertures
two_apertures = pw.amplitude(windows, points, WAVELENGTH, "kirchhoff")
distant, rim = (behind(wall, points, lamp(distance=FAR)) for wall in (solid - windows, solid))
for name, values in (("wall", distant), ("wall less rim", distant - rim)):
    difference = np.abs(values - two_apertures).max() / np.abs(two_apertures).max()
    print(f"{name} before a distant lamp, against two apertures: {difference:.4f} of the peak")
assert difference < 1e-2

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.plot(1e3 * line, level / free**2, label="two windows")
left.plot(1e3 * line, alone / free**2, label="the right one alone", linestyle="--")
left.set(title=f"lamp {BEFORE:g} m before the wall", xlabel="x (mm)")
left.set_ylabel("irradiance over the free one")
left.set_ylim(-0.02, 0.66)
left.legend()
right.plot(1e3 * line, np.abs(distant) ** 2, label="wall before a distant lamp")
right.plot(1e3 * line, np.abs(two_apertures) ** 2, label="two apertures", linestyle="--")
right.set(title="lamp far away", xlabel="x (mm)", ylabel="irradiance over the incident one")
right.set_ylim(-0.01, 0.32)
right.legend()

# %%
# A lamp that grows
# -----------------
# The points of a lamp radiate independently of each other, and their *irradiances* add. Each has
# fringes of its own, which lie aside by as much as the point is off the axis. With
# :math:`w` the width of the lamp and :math:`L` its distance from the wall, the contrast falls to
#
# .. math:: V = \mathrm{sinc}\frac{w\,d}{\lambda L}
#
# (van Cittert and Zernike), vanishes as soon as the lamp covers a whole fringe, and comes back
# with bright and dark exchanged. In the middle :math:`V = I/2I_1 - 1` with the irradiance
# :math:`I_1` of one window. The dots are off by up to 0.07, which the rim does again.


def light_of_lamp(
    wall: pw.Aperture, points: Any, width: float, distance: float = BEFORE, nodes: int = 8
) -> Any:
    """Irradiance behind a wall before a lamp: a line of points along x."""
    places, weights = np.polynomial.legendre.leggauss(nodes)
    return sum(
        weight / 2 * np.abs(behind(wall, points, lamp(width / 2 * place, distance))) ** 2
        for place, weight in zip(places, weights, strict=True)
    )


def contrast(width: float, distance: float) -> float:
    """The visibility of fringes, negative where bright and dark are exchanged."""
    spot = np.array([[0.0, 0.0, BEHIND]])
    both, single = (
        light_of_lamp(wall, spot, width, distance) for wall in (solid - windows, solid - one)
    )
    return both[0] / (2 * single[0]) - 1


widths = 1e-3 * np.array([1, 10, 20, 30, 40, 53, 65, 80, 100])
result = {L: np.array([contrast(w, L) for w in widths]) for L in (BEFORE, 2 * BEFORE)}
for L, values in result.items():
    off = np.abs(values - np.sinc(widths * APART / (WAVELENGTH * L))).max()
    print(f"{L:g} m before the wall: at most {off:.2f} from van Cittert's and Zernike's theorem")
    assert off < 0.1

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for width in (1e-3, 30e-3, 53e-3, 80e-3):
    seen = light_of_lamp(solid - windows, points[::4], width)
    left.plot(1e3 * line[::4], seen / free**2, label=f"{1e3 * width:.0f} mm")
left.set(title=f"lamp {BEFORE:g} m before the wall", xlabel="x (mm)")
left.set_ylabel("irradiance over the free one")
left.legend(title="width of the lamp")
fine = np.linspace(0, 0.1, 201)
for L, values in result.items():
    curve = right.plot(1e3 * fine, np.sinc(fine * APART / (WAVELENGTH * L)), label=f"{L:g} m")
    right.plot(1e3 * widths, values, "o", color=curve[0].get_color())
right.axhline(0, color="black", linewidth=0.6)
right.set(title="fringes fade", xlabel="width of the lamp (mm)", ylabel="visibility V")
right.legend(title="lamp to wall")

# %%
# Move the wall away from the lamp, and the fringes come back: at 1 m the same lamp covers half of a
# fringe. A *coherent* source does not fade. A patch as wide as the lamp that killed all fringes
# radiates one wave, whose parts have fixed phases, and its windows interfere fully:

patch = pw.shapes.rectangle(53e-3, 3e-3)
pose = np.eye(4)
pose[2, 3] = BEFORE
wall = (solid - windows).placed(pose)
places = points[::8] + np.array([0.0, 0.0, BEFORE])
waves = (
    np.abs(pw.amplitude(patch, places, WAVELENGTH, "kirchhoff", obstacles=wall, tolerance=1e-3))
    ** 2
)
near = np.abs(line[::8]) < predicted
visibility = (waves[near].max() - waves[near].min()) / (waves[near].max() + waves[near].min())
print(f"a patch 53 mm wide: V = {visibility:.2f}; a lamp as wide: {result[BEFORE][5]:.2f}")
assert visibility > 0.9 and abs(result[BEFORE][5]) < 0.1

# %%
# What this wall leaves out
# -------------------------
# - It is **thin**. The sides of windows in a thick wall are second edges, and light that passes two
#   edges is left out of silhouettes.
# - It is **black**. Metal reflects, and the light behind it depends on the polarisation, at large
#   angles by many decibels.
# - Nothing returns from the plane that we look at.
#
# Exercises
# ---------
# 1. Close one window halfway. How do the dark fringes change? Predict V from the two irradiances.
# 2. Turn the wall by 30° about the y axis (``pose``). Do the fringes keep their distance?
# 3. Put a plate of 10 mm behind one window. When do the fringes vanish, and what remains of them?
# 4. Give the lamp two narrow lines, 53 mm apart, instead of one broad line. What is V now, and why?
