"""Array factors of lattices far from the origin, where positions are rounded."""

from fractions import Fraction

import numpy as np
import pytest

import polywigner as pw
from oracles.references import ENGINES

# Accuracy stated in docs/accuracy.md, relative to the sum of the weights.
PROMISED = 1e-13
DECADES = (1, 10, 100, 1000)
PITCH = np.array([0.0123, 0.0171])


def exact_factor(sites, weights, nu):
    """Return the array factor with exact phases."""
    values = []
    for p, q in nu.tolist():
        turns = [Fraction(p) * Fraction(x) + Fraction(q) * Fraction(y) for x, y in sites.tolist()]
        phases = np.array([float(t - round(t)) for t in turns])
        values.append((weights * np.exp(-2j * np.pi * phases)).sum())
    return np.array(values)


def frequencies(extent, turned):
    """Return frequencies near grating lobes, in each decade of |nu| times the extent."""
    rng = np.random.default_rng(5)
    nu = rng.normal(size=(3, 2)) / extent
    nu = np.concatenate([decade * nu for decade in DECADES])
    lobes = (np.round(nu @ turned.T * PITCH) / PITCH) @ turned
    return lobes + 0.1 * rng.normal(size=lobes.shape) / extent


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("turn", [0.0, 0.3])
@pytest.mark.parametrize("tapered", [False, True])
@pytest.mark.parametrize("diameters", [0, 10, 1e4])
def test_array_factors_are_those_of_the_given_positions(diameters, tapered, turn, engine):
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    i, j = np.indices((12, 9))
    sites = np.column_stack([(i - 5.5).ravel() * PITCH[0], (j - 4.0).ravel() * PITCH[1]]) @ turned
    extent = float(np.hypot(*np.ptp(sites, axis=0)))
    sites = sites + diameters * extent * np.array([0.6, 0.8])
    weights = np.ones(len(sites), complex)
    if tapered:
        weights = (np.cos(0.2 * (i - 5.5)) * np.exp(0.4j * j)).ravel()
    nu = frequencies(extent, turned)
    if diameters == 0:  # rounding moves elements off the lattice: 5e-16 |nu| D
        nu = nu[np.hypot(*nu.T) * extent < 150]
    got = pw.array_factor(sites, weights, nu, engine=engine)
    error = np.abs(got - exact_factor(sites, weights, nu)).max() / np.abs(weights).sum()
    assert error < PROMISED


def test_phased_arrays_far_off_are_the_sums_of_their_elements():
    element = pw.shapes.square(0.01)
    i, j = np.indices((12, 9))
    places = np.column_stack([150.0 + i.ravel() * PITCH[0], j.ravel() * PITCH[1] - 90.0])
    nu = frequencies(float(np.hypot(*np.ptp(places, axis=0))), np.eye(2))
    got = pw.fourier(pw.phased_array(element, places), nu)
    expected = pw.fourier(element, nu) * exact_factor(places, np.ones(len(places)), nu)
    assert np.abs(got - expected).max() < PROMISED * len(places) * element.area
