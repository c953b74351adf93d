"""The examples of derivatives."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw

pytestmark = [pytest.mark.llvm, pytest.mark.slow]  # complete optimisations

EXAMPLES = Path(__file__).parent.parent / "examples"
# Largest difference between float32 gradients and float64 differences, relative to the largest
# component.
DIFFERENCES = 1e-4


def _example(*path):
    return runpy.run_path(str(EXAMPLES.joinpath(*path)))


def test_the_outline_of_the_design_has_lower_sidelobes_than_a_disc():
    """The NumPy transform is independent of the loss."""
    example = _example("inverse_design", "inverse_design.py")
    rings, history = example["shaped_aperture"](steps=40)
    angle = np.radians(np.linspace(9, 80, 500))
    nu = np.stack([np.sin(angle), 0 * angle], axis=-1) / example["WAVELENGTH"]
    levels = []
    for ring in rings:
        source = pw.Aperture(ring)
        power = abs(pw.fourier(source, nu) / pw.fourier(source, (0.0, 0.0))) ** 2
        levels.append(10 * np.log10(power.max()))
    assert levels[1] < levels[0] - 5
    assert history[-1] < history[0] - 5


def test_the_weights_of_the_design_have_lower_sidelobes_than_equal_ones():
    example = _example("inverse_design", "inverse_design.py")
    weights, _ = example["designed_weights"]()
    angle = np.radians(np.linspace(-90, 90, 1001))
    nu = np.stack([np.sin(angle), 0 * angle], axis=-1) / example["WAVELENGTH"]
    outside = abs(np.sin(angle) - np.sin(example["STEERED"])) > 0.1
    levels = []
    for values in weights:
        power = abs(pw.fourier(pw.Array(example["elements"]().elements, values), nu)) ** 2
        steered = np.degrees(angle[power.argmax()])
        assert abs(steered - np.degrees(example["STEERED"])) < 1
        levels.append(10 * np.log10(power[outside].max() / power.max()))
    assert levels[1] < levels[0] - 10


def test_pytorch_differentiates_through_the_transform():
    pytest.importorskip("torch")
    example = _example("other_frameworks", "with_torch.py")
    vertices, losses = example["widened"](steps=10)
    assert losses[-1] < losses[0]
    assert abs(pw.Aperture(vertices.numpy()).area - 1.5 * np.sqrt(3)) < 0.1


def test_a_loss_in_jax_has_the_gradient_of_differences():
    pytest.importorskip("jax")
    example = _example("other_frameworks", "with_jax.py")
    square, step = example["SQUARE"], 1e-4
    _, gradient = example["loss_and_gradient"](square)
    change = np.random.default_rng(0).normal(size=square.shape)
    values = [
        np.mean(
            pw.wigner(pw.Aperture(square + s * step * change), example["X"], example["NU"]) ** 2
        )
        for s in (1, -1)
    ]
    expected = (values[0] - values[1]) / (2 * step)
    assert abs((gradient * change).sum() - expected) < DIFFERENCES * abs(gradient).max()
