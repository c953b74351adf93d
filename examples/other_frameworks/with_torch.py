"""A polygon's vertices as a parameter of PyTorch: ``python with_torch.py``, with PyTorch installed.

`dr.wrap` converts a function of Dr.Jit tensors to a function of PyTorch tensors with gradients. An
optimiser of PyTorch widens the main lobe of a hexagon at constant area.
"""

from __future__ import annotations

from typing import Any

import torch

import polywigner as pw
from polywigner.llvm import require

require()  # before Dr.Jit, which loads its LLVM library once

import drjit as dr  # noqa: E402


@dr.wrap(source="torch", target="drjit")
def far_field(vertices: Any, nu: Any) -> Any:
    """Return |F|^2 at nu (m, 2) of the polygon with vertices (n, 2)."""
    value = pw.fourier(pw.differentiable(vertices=vertices), nu)
    return dr.square(value[:, 0]) + dr.square(value[:, 1])


def widened(steps: int = 30) -> tuple[torch.Tensor, list[float]]:
    """Return the vertices and the losses of all steps."""
    angle = torch.arange(6, dtype=torch.float64) * torch.pi / 3
    vertices = torch.stack([torch.cos(angle), torch.sin(angle)], dim=-1).requires_grad_()
    nu = torch.tensor([[0.0, 0.0], [0.45, 0.0]], dtype=torch.float64)
    optimiser = torch.optim.Adam([vertices], lr=0.01)
    losses = []
    for _ in range(steps):
        optimiser.zero_grad()
        ahead, aside = far_field(vertices, nu)
        loss = -aside / ahead + (ahead - 27 / 4) ** 2  # |F(0)|^2 is the area squared
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    return vertices.detach(), losses


if __name__ == "__main__":
    result, history = widened()
    print(f"loss {history[0]:.4f} -> {history[-1]:.4f}, vertices\n{result.numpy().round(3)}")
