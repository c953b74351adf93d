"""An outline and array weights with low sidelobes, by gradient descent.

Run ``python inverse_design.py [FOLDER]``, which writes ``inverse_design.png`` in a few seconds.

First, a uniform aperture, a polygon of 96 vertices in a circle of 5 wavelengths, gets low sidelobes
along the horizon and within 10 degrees of it. Second, the complex weights of 32 elements at half a
wavelength, steered to 20 degrees, get low sidelobes, and 20 dB lower ones in one sector.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.llvm import require

require()  # before Dr.Jit, which loads its LLVM library once

import drjit as dr  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
from drjit.llvm.ad import Array2f64, Complex2f64, Float64, UInt32  # noqa: E402
from drjit.opt import Adam  # noqa: E402

WAVELENGTH = 3.19e-3  # 94 GHz
RADIUS, VERTICES, WAVES = 5 * WAVELENGTH, 96, 8
ELEMENTS, STEERED, LISTENER = 32, np.radians(20.0), np.radians(-37.0)


def decibel(power: Any) -> Any:
    """Return 10 log10, limited to -80 dB."""
    return 10 * np.log10(np.maximum(power, 1e-8))


def soft_maximum(power: Any, sharpness: float = 12.0) -> Any:
    """Return approximately the largest level in nepers, with gradients at all high lobes."""
    level = dr.log(power + 1e-9)
    largest = dr.detach(dr.max(level))
    return largest + dr.log(dr.mean(dr.exp(sharpness * (level - largest)))) / sharpness


def descended(
    values: dict[str, Any], loss: Callable[[Adam], Any], steps: int, rate: float
) -> tuple[Adam, list[float]]:
    """Minimise a loss with Adam; return the losses of all steps."""
    optimiser = Adam(lr=rate, params=values)
    history = []
    for step in range(steps):
        optimiser.set_learning_rate(rate * (1 - step / steps))
        value = loss(optimiser)
        dr.backward(value)
        optimiser.step()
        history.append(float(value.numpy()[0]))
    return optimiser, history


def outline_of(shape: Any) -> Any:
    """Return a smooth ring between 1/3 of the radius and the radius, symmetric about both axes."""
    angle = 2 * np.pi * np.arange(VERTICES) / VERTICES
    level: Any = 0.0
    for k in range(WAVES):
        one = dr.gather(Float64, shape, UInt32(k))
        level = level + one * Float64(np.cos(2 * k * angle).tolist())
    radius = RADIUS * (1 / 3 + 2 / 3 / (1 + dr.exp(-level)))
    return Array2f64(
        radius * Float64(np.cos(angle).tolist()), radius * Float64(np.sin(angle).tolist())
    )


def wedge() -> Any:
    """Return directions beyond the main lobe, up to 10 degrees off the horizon."""
    azimuth = np.radians(np.linspace(9, 80, 120))
    elevation = np.radians(np.linspace(0, 10, 5))
    a, e = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    return Array2f64(*(np.array([np.sin(a) * np.cos(e), np.sin(e)]) / WAVELENGTH).tolist())


def relative_power(outline: Any, nu: Any) -> Any:
    """Return |F|^2 relative to the normal direction."""
    source = pw.differentiable(vertices=outline)
    ahead = pw.fourier(source, Array2f64(0.0, 0.0))
    return dr.squared_norm(pw.fourier(source, nu)) / dr.squared_norm(ahead)


def shaped_aperture(steps: int = 120) -> tuple[list[np.ndarray], list[float]]:
    """Return the outline before and after, and the losses in dB."""
    sidelobes = wedge()
    start = Float64([1.0] + [0.0] * (WAVES - 1))

    def loss(values: Adam) -> Any:
        return soft_maximum(relative_power(outline_of(values["shape"]), sidelobes))

    result, history = descended({"shape": start}, loss, steps, rate=0.06)
    rings = [np.array(outline_of(shape)).T for shape in (start, result["shape"])]
    return rings, [10 / np.log(10) * value for value in history]


def elements() -> pw.Array:
    """Return patches in a row at half a wavelength."""
    places = (np.arange(ELEMENTS) - (ELEMENTS - 1) / 2) * WAVELENGTH / 2
    patch = pw.shapes.square(0.4 * WAVELENGTH)
    return pw.phased_array(patch, np.stack([places, 0 * places], axis=-1))


def steered(amplitudes: Any, phases: Any) -> Any:
    """Return weights with a phase towards ``STEERED`` in addition to their phases."""
    turn = np.pi * np.sin(STEERED) * (np.arange(ELEMENTS) - (ELEMENTS - 1) / 2)
    phase = phases + Float64(turn.tolist())
    return Complex2f64(amplitudes * dr.cos(phase), amplitudes * dr.sin(phase))


def directions(angle: np.ndarray) -> Any:
    sine = np.sin(np.atleast_1d(angle)) / WAVELENGTH
    return Array2f64(sine.tolist(), (0 * sine).tolist())


def designed_weights(steps: int = 200) -> tuple[list[np.ndarray], list[float]]:
    """Return weights before and after, and the losses in dB."""
    array = elements()
    angle = np.radians(np.linspace(-90, 90, 721))
    outside = directions(angle[abs(np.sin(angle) - np.sin(STEERED)) > 0.1])
    beam = directions(np.array(STEERED))
    null = directions(LISTENER + np.radians(np.linspace(-1.5, 1.5, 9)))
    start = {"amplitude": Float64([1.0] * ELEMENTS), "phase": Float64([0.0] * ELEMENTS)}

    def loss(values: Adam) -> Any:
        source = pw.differentiable(array, weights=steered(values["amplitude"], values["phase"]))
        peak = dr.squared_norm(pw.fourier(source, beam))
        lobes, hole = (dr.squared_norm(pw.fourier(source, nu)) / peak for nu in (outside, null))
        return soft_maximum(dr.concat([lobes, 100 * hole]))  # 20 dB below the lobes

    result, history = descended(start, loss, steps, rate=0.01)
    chosen = (start, {name: result[name] for name in start})
    weights = [steered(v["amplitude"], v["phase"]) for v in chosen]
    numbers = [np.array(w.real) + 1j * np.array(w.imag) for w in weights]
    return numbers, [10 / np.log(10) * value for value in history]


COLOURS, NAMES = ("0.6", "tab:blue"), ("before", "after")


def draw(folder: Path) -> Path:
    """Draw both designs, before and after, and the losses."""
    figure, axes = plt.subplots(2, 3, figsize=(11, 6.4), layout="constrained")
    angle = np.radians(np.linspace(-90, 90, 1441))
    nu = np.stack([np.sin(angle), 0 * angle], axis=-1) / WAVELENGTH

    rings, history = shaped_aperture()
    for ring, colour, name in zip(rings, COLOURS, NAMES, strict=True):
        axes[0, 0].fill(*(ring.T * 1e3), facecolor="none", edgecolor=colour, label=name, lw=1.5)
        power = abs(pw.fourier(pw.Aperture(ring), nu)) ** 2
        axes[0, 1].plot(np.degrees(angle), decibel(power / power.max()), color=colour, lw=1)
    axes[0, 0].set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)", title="outline")
    axes[0, 1].axvspan(9, 80, color="tab:orange", alpha=0.1, lw=0)
    axes[0, 1].set(title="pattern along the horizon")
    axes[0, 2].plot(history, color=COLOURS[1])

    weights, history = designed_weights()
    for values, colour, name in zip(weights, COLOURS, NAMES, strict=True):
        axes[1, 0].plot(abs(values) / abs(values).max(), ".-", color=colour, label=name, lw=1)
        array = pw.Array(elements().elements, values)
        power = abs(pw.fourier(array, nu)) ** 2
        axes[1, 1].plot(np.degrees(angle), decibel(power / power.max()), color=colour, lw=1)
    axes[1, 0].set(xlabel="element", ylabel="|weight|", ylim=(0, 1.1), title="array")
    axes[1, 1].axvline(np.degrees(LISTENER), color="tab:orange", lw=1, ls=":")
    axes[1, 1].set(title="pattern, steered to 20 degrees")
    axes[1, 2].plot(history, color=COLOURS[1])
    for row in axes:
        row[0].legend(frameon=False, loc="center" if row[0] is axes[0, 0] else "lower center")
        row[1].set(ylim=(-70, 3), xlim=(-90, 90), xlabel="azimuth (degrees)", ylabel="dB")
        row[2].set(xlabel="step", ylabel="dB", title="loss")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "inverse_design.png"
    figure.savefig(path, dpi=110)
    return path


if __name__ == "__main__":
    print(draw(Path(sys.argv[1] if len(sys.argv) > 1 else ".")))
