"""The pattern of a pyramidal horn and its near field.

Writes curved_horn.png into the current folder.
"""

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

wavelength = pw.SPEED_OF_LIGHT / 11e9
width, height, radius_x, radius_y = 163.70e-3, 128.59e-3, 327.53e-3, 303.16e-3
horn = pw.horns.pyramidal(width, height, radius_x, radius_y, wavelength)
flat = horn.source
print(f"{10 * np.log10(pw.horns.directivity(horn, wavelength)):.2f} dB with the curved wave")
print(f"{10 * np.log10(pw.horns.directivity(flat, wavelength)):.2f} dB without")

figure, axes = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
theta = np.radians(np.linspace(0, 60, 241))
for ax, name, phi in ((axes[0], "E plane", 90.0), (axes[1], "H plane", 0.0)):
    for source, style in ((horn, "-"), (flat, ":")):
        pattern = pw.radiation_pattern(source, wavelength, theta, np.radians(phi))
        label = "curved wave" if source is horn else "flat"
        levels = pattern["directivity"].values[:, 0]
        ax.plot(np.degrees(theta), levels, style, color="#1f3b57", label=label)
    ax.set(title=name, xlabel="angle from the axis (deg)", ylabel="directivity (dBi)")
    ax.set(ylim=(-20, 27), xlim=(0, 60))
    ax.legend()

y, z = np.linspace(-0.3, 0.3, 241), np.linspace(0.1, 1.2, 221)
points = np.stack(np.broadcast_arrays(0.0, *np.meshgrid(y, z)), axis=-1)
near = pw.irradiance(horn, points, wavelength, "fresnel")
levels = 10 * np.log10(np.maximum(near, 1e-6))
picture = axes[2].pcolormesh(z, y * 1e3, levels.T, vmin=-30, vmax=0, cmap="magma", shading="auto")
for side in (-1, 1):
    edge = side * height / 2 * (1 + z / radius_y)
    axes[2].plot(z, edge * 1e3, "--", color="white", linewidth=0.8)
axes[2].set(title="near field in the E plane", xlabel="distance z (m)", ylabel="y (mm)")
axes[2].set(ylim=(-300, 300))
figure.colorbar(picture, label="irradiance (dB of that in the mouth)")
along = np.linspace(0.1, 1.2, 20)
axis = np.stack([0 * along, 0 * along, along], axis=-1)
exact = pw.irradiance(horn, axis, wavelength, "rayleigh-sommerfeld-1")
parabolic = pw.irradiance(horn, axis, wavelength, "fresnel")
worst = 10 * np.abs(np.log10(parabolic / exact)).max()
print(f"Fresnel on the axis: within {worst:.2f} dB from 100 mm")

figure.savefig("curved_horn.png", dpi=110)
