"""The public check accepts sources whose transforms obey the laws, and names a law that fails."""

import numpy as np
import pytest

import polywigner as pw
from polywigner import transforms
from polywigner.errors import ArgumentError

WAVELENGTH = 3e-3
CHEVRON = pw.shapes.chevron(8e-3, 10e-3, 3e-3)
GRID = pw.arrays.grid_positions(4, 3, 1.6e-3)
DIRECTION = (0.3, 0.2, np.sqrt(0.87))
SOURCES = {
    "chevron": CHEVRON,
    "ring": pw.shapes.ring(10e-3, 6e-3, n=24),
    "far triangle": pw.Aperture([[1000.0, 700.0], [1001.3, 700.2], [1000.4, 701.1]]),
    "strip": pw.shapes.rectangle(1.0, 1e-4),
    "steered": CHEVRON.with_illumination(pw.steering(DIRECTION, WAVELENGTH)),
    "cosine": pw.shapes.square(0.01).with_illumination(pw.cosine_taper(0.01, 0.01)),
    "slits": pw.Slits([[-1.0, -0.4], [0.1, 0.9]]),
    "steered array": pw.phased_array(
        pw.shapes.rectangle(1e-3, 1.5e-3),
        GRID,
        pw.arrays.steering_weights(GRID, DIRECTION, WAVELENGTH),
    ),
}


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_sources_pass(source):
    assert pw.testing.check(source, 30) is None


FAULTS = {
    "W is real": ("wigner", lambda value, _: value + 1e-9j * abs(value)),
    "W of another scale": ("wigner", lambda value, _: value * (1 + 1e-9)),
    "A of the other sign": ("ambiguity", lambda value, _: np.conj(value)),
    "F of another scale": ("fourier", lambda value, _: 1.01 * value),
    "F of the other sign": ("fourier", lambda value, _: np.conj(value)),
    "an empty marginal": ("position_marginal", lambda value, _: 0.0 * value),
    "NaN": ("wigner", lambda value, _: np.nan * value),
}


@pytest.mark.parametrize(("name", "change"), FAULTS.values(), ids=FAULTS)
def test_wrong_transforms_fail(monkeypatch, name, change):
    right = getattr(transforms, name)
    monkeypatch.setattr(transforms, name, lambda *given: change(right(*given), given))
    with pytest.raises(AssertionError, match="is violated at"):
        pw.testing.check(CHEVRON, 30)


def test_weights_of_arrays_count(monkeypatch):
    right = transforms.fourier
    monkeypatch.setattr(transforms, "fourier", lambda source, nu: np.abs(right(source, nu)))
    with pytest.raises(AssertionError):
        pw.testing.check(SOURCES["steered array"], 30)


def test_other_sources_are_refused():
    with pytest.raises(ArgumentError, match="got Polyhedron"):
        pw.testing.check(pw.Polyhedron(np.eye(4, 3), [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]))
