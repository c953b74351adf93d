r"""
105: The near field
===================

How near is near? This lesson looks at the same square with four methods at once: exactly, along
its edges; with Wigner rays; with parabolic waves (Fresnel); and as a far field (Fraunhofer). It
shows where each holds, and in which power of the distance each begins to. The grids require
``pip install "polywigner[volume]"``.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw
from polywigner.errors import PolywignerWarning

WAVELENGTH = 299_792_458 / 94e9
SIDE = 10e-3
square = pw.shapes.square(SIDE)

# Rays warn where they do not hold, which is what this lesson wants to see.
warnings.simplefilter("ignore", PolywignerWarning)

# %%
# The exact field
# ---------------
# In front of an opening in a screen, the field is a diffraction integral over the opening. For a
# polygon and plane waves that integral is one along the *edges*, exactly: nothing is sampled in
# the area, and points may lie anywhere. There are three boundary conditions to choose from, two
# of Rayleigh and Sommerfeld's and Kirchhoff's mean of the two; they differ near the screen and
# aslant, and which one is right is a question to the screen.
#
# ``pw.plane`` takes a box without thickness: here the plane y = 0, up to 80 mm, which is the far
# field's beginning.

box = ((-40e-3, 0, 0.5e-3), (40e-3, 0, 80e-3))
field = pw.plane(square, box, (241, 241), WAVELENGTH, method="kirchhoff")["kirchhoff"]

figure, axes = plt.subplots(figsize=(7, 3.9), layout="constrained")
picture = axes.imshow(
    10 * np.log10(np.maximum(field.transpose("z", "x").values, 1e-4)),
    "inferno",
    origin="lower",
    extent=(-40, 40, 0.5, 80),
    vmin=-35,
    vmax=3,
    aspect="auto",
)
axes.plot([-5, 5], [0.5, 0.5], color="white", linewidth=4)
axes.set(xlabel="x (mm)", ylabel="z (mm)", title="Kirchhoff's field of a 10 mm square at 94 GHz")
figure.colorbar(picture, label="$|U|^2$ (dB rel. to the incident wave)")

# %%
# A check that needs no other program. On the axis, one Fresnel zone after the other comes into
# the opening as z shrinks, so that the field swings. Its exact values on the axis of a *disc* are
# known in closed form, :math:`U = e^{ikz} - (z/R)\,e^{ikR}` with :math:`R^2 = z^2 + a^2` for the
# first integral, and a polygon of many sides is a disc to the fourth order in the number of
# sides:

RADIUS = 5e-3
z = np.linspace(1, 20, 200) * WAVELENGTH
axis = np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=-1)
k, rim = 2 * np.pi / WAVELENGTH, np.sqrt(z**2 + RADIUS**2)
closed = np.exp(1j * k * z) - z / rim * np.exp(1j * k * rim)
for sides in (16, 32, 64):
    disc = pw.shapes.disc(RADIUS, n=sides)
    error = np.abs(pw.amplitude(disc, axis, WAVELENGTH) - closed).max()
    print(f"{sides} sides: {error:.1e} of the incident wave")
assert error < 3e-6  # and 16 times less for twice the sides

# %%
# Rays
# ----
# A renderer has no fields, only rays: from each place on the aperture to the point, with the
# radiance :math:`W/\lambda^2`. That is the exact integral with the lag between two points of the
# aperture kept to its first power in the phase. On boresight, against Kirchhoff:

distance = np.geomspace(0.7, 60, 240) * WAVELENGTH
points = np.stack([0 * distance, 0 * distance, distance], axis=-1)
exact = pw.irradiance(square, points, WAVELENGTH, "kirchhoff")
methods: dict[str, dict] = {
    "rays": {"method": "wigner", "obliquity": "kirchhoff"},
    "Fresnel": {"method": "fresnel"},
    "Fraunhofer": {"method": "fraunhofer"},
}
result = {name: pw.irradiance(square, points, WAVELENGTH, **how) for name, how in methods.items()}

figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 6), layout="constrained", sharex=True)
waves = distance / WAVELENGTH
upper.semilogx(
    waves, 10 * np.log10(exact), color="black", linewidth=3, alpha=0.3, label="Kirchhoff"
)
error = {}
for (name, values), colour in zip(result.items(), ("C0", "C2", "C3"), strict=True):
    with np.errstate(invalid="ignore", divide="ignore"):
        upper.semilogx(waves, 10 * np.log10(values), color=colour, label=name, linewidth=1)
        error[name] = np.abs(10 * np.log10(np.abs(values / exact)))
    lower.loglog(waves, error[name], color=colour)
upper.set(ylabel="$|U|^2$ (dB rel. to incident)", ylim=(-20, 8))
upper.legend()
lower.set(ylabel="difference from Kirchhoff (dB)", xlabel="distance (wavelengths)", ylim=(1e-6, 20))
lower.axhline(0.1, color="black", linewidth=0.6)

# %%
# The far field, Fraunhofer's, knows nothing of the swings, and is a tenth of a decibel off up to
# 24 wavelengths. Fresnel sees the swings, but in the wrong places where waves are not parabolas.
# Rays are good from three wavelengths on.
#
# What is claimed, in numbers:

beyond = waves >= 3
for name in methods:
    print(f"{name:20} from 3 wavelengths on: at most {error[name][beyond].max():.3f} dB")
assert error["rays"][beyond].max() < 0.15
assert error["Fraunhofer"][beyond].max() > 1

# %%
# The order of convergence is the sharper test. Twice the distance has to divide an error of the
# order :math:`r^{-2}` by four. (The sums have more digits here than by the default of 1e-3.)


def error_at(multiple):
    """Relative error of rays along a slanted line, at a number of wavelengths."""
    point = multiple * WAVELENGTH * np.array([np.sin(0.3), 0.0, np.cos(0.3)])
    ray = pw.irradiance(square, point, WAVELENGTH, "wigner", tolerance=1e-8)
    true = pw.irradiance(square, point, WAVELENGTH, "rayleigh-sommerfeld-1")
    return abs(ray / true - 1)


errors = np.array([error_at(m) for m in (40, 80, 160)])
powers = np.log2(errors[:-1] / errors[1:])
print(f"errors {errors}, falling with the powers {np.round(powers, 2)}")
assert abs(powers[-1] - 2) < 0.15

# %%
# Off the axis
# ------------
# Rays have directions, and so an *obliquity*: a factor of the cosine that says which of the
# boundary conditions they stand for. The paper's cosine belongs to none of them. On an arc at 10
# wavelengths:

theta = np.radians(np.linspace(-85, 85, 171))
arc = 10 * WAVELENGTH * np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
exact = pw.irradiance(square, arc, WAVELENGTH, "kirchhoff")
rays: dict[str, dict] = {
    "paper's cosine": {"obliquity": "paper"},
    "Kirchhoff's factor": {"obliquity": "kirchhoff"},
}
figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
axes.plot(
    np.degrees(theta), 10 * np.log10(exact), color="black", linewidth=4, alpha=0.25, label="exact"
)
strong = exact > exact.max() * 1e-3
rms = {}
for name, how in rays.items():
    values = pw.irradiance(square, arc, WAVELENGTH, "wigner", **how)
    db = 10 * np.log10(np.maximum(values, 1e-9))
    axes.plot(np.degrees(theta), db, linewidth=1, label=name)
    rms[name] = np.sqrt(np.mean((db - 10 * np.log10(exact))[strong] ** 2))
    print(f"{name:20} rms difference above -30 dB: {rms[name]:.3f} dB")
axes.set(xlabel="angle (degrees)", ylabel="$|U|^2$ (dB rel. to incident)", ylim=(-45, 1))
axes.legend(loc="lower center")
assert rms["Kirchhoff's factor"] < rms["paper's cosine"]

# %%
# When to use which
# -----------------
# ================  ================================================  ========================
# method            holds                                             for
# ================  ================================================  ========================
# ``amplitude``     everywhere, to a tolerance                        fields in free space
# rays              from some wavelengths on                          scenes: they render this
# ``"fresnel"``     near the axis                                     textbooks
# ``"fraunhofer"``  far beyond :math:`L^2/\lambda`, here 31 mm        patterns
# ================  ================================================  ========================
#
# Exercises
# ---------
# 1. Put a point 0.01 wavelengths in front of an edge. What do the three boundary conditions say
#    there, and why does their mean make sense?
# 2. Give the square a TE10 field (``pw.te_mode``). Where do the swings on boresight go, and why?
# 3. Steer the square by 30 degrees, and plot the irradiance along the beam rather than along the
#    axis. Which power of the distance do rays have now for Kirchhoff? (Hint: the page
#    on propagation says when it is only the first.)
