"""A slice of the Wigner function of a chevron, W(x, nu) at one position: the README's five lines
with labelled axes. Writes wigner.png into the current folder."""

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

chevron = pw.shapes.chevron(10e-3, 12e-3, 4e-3)  # metres
axis = np.linspace(-300, 300, 301)  # cycles per metre
nu = np.stack(np.meshgrid(axis, axis), axis=-1)
w = pw.wigner(chevron, (0, 2e-3), nu)

figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
limit = 0.3 * abs(w).max()
picture = axes.imshow(
    w * 1e6, "RdBu_r", vmin=-limit * 1e6, vmax=limit * 1e6, origin="lower", extent=[-300, 300] * 2
)
axes.set(title="Chevron, x = (0, 2) mm", xlabel=r"$\nu_x$ (1/m)", ylabel=r"$\nu_y$ (1/m)")
figure.colorbar(picture, label="W(x, ν) (mm²)", extend="both")
figure.savefig("wigner.png", dpi=150)
