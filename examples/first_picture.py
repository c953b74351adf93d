"""The Wigner function W(x, nu) of a chevron at one position.

The five lines of the README, with the chevron and axis labels. Writes wigner.png into the current
folder.
"""

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

chevron = pw.shapes.chevron(20e-3, 12e-3, 4e-3)  # metres
x = np.array([0, 1e-3])
axis = np.linspace(-600, 600, 401)  # cycles per metre
nu = np.stack(np.meshgrid(axis, axis), axis=-1)
w = pw.wigner(chevron, x, nu)

figure, (left, right) = plt.subplots(1, 2, figsize=(8.4, 3.8), layout="constrained")
left.fill(*chevron.rings[0].T * 1e3, color="#1f3b57")
left.plot(*x * 1e3, "+", color="#c1440e", markersize=10, markeredgewidth=2)
left.set(title="aperture, and x", xlabel="$x_x$ (mm)", ylabel="$x_y$ (mm)", aspect="equal")
picture = right.imshow(
    w * 1e6, "RdBu_r", vmin=-20, vmax=20, origin="lower", extent=[-600, 600, -600, 600]
)
right.set(title="W(x, ν)", xlabel=r"$\nu_x$ (1/m)", ylabel=r"$\nu_y$ (1/m)")
figure.colorbar(picture, label="W (mm²)", extend="both")
figure.savefig("wigner.png", dpi=110)
