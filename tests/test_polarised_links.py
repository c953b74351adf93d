"""Couplings of polarised sources: reciprocity, Friis' formula with mismatch, and near fields.

Lengths are in wavelengths.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.poses import pose

MODELS: tuple[Any, ...] = ("huygens", "magnetic", "electric")
models = pytest.mark.parametrize("model", MODELS)
DUAL: dict[Any, Any] = {"huygens": "huygens", "magnetic": "electric", "electric": "magnetic"}
SENDER = pw.shapes.rectangle(1.3, 0.9).with_illumination(pw.cosine_taper(1.3))
TAKER = pw.shapes.rectangle(0.9, 1.5)
TIGHT = 1e-10
"""Tolerance asked for, and errors of values against sums of fields at Gauss nodes."""


def link(at: Any, *pair: Any, **how: Any) -> Any:
    return pw.coupling(SENDER, TAKER, at, 1.0, polarisation=pair, **how)


@models
@pytest.mark.parametrize("pair", [("x", "30 deg"), ("right", (1, 0.5j))])
def test_links_are_the_same_both_ways(model: Any, pair: Any) -> None:
    at = pose(0.4, 0.0, 3.0, 0.3, 0.5)
    there = link(at, *pair, method=model)
    back = pw.coupling(TAKER, SENDER, np.linalg.inv(at), 1.0, model, polarisation=pair[::-1])
    assert back == pytest.approx(there, rel=1e-12)


@models
def test_a_receiver_weighs_the_near_fields_that_arrive(model: Any) -> None:
    """The receiver's electric currents in E and magnetic currents in H of the transmitter, at Gauss
    nodes; H is E of the dual currents.
    """
    at, sent, taken = pose(0.3, 0.0, 1.2, 0.2, 0.4), np.array([0.6, 0.8j]), np.array([0.8, -0.6])
    node, weight = np.polynomial.legendre.leggauss(20)
    x, y = np.meshgrid(node * 0.45, node * 0.75, indexing="ij")
    places = np.stack([x, y, 0 * x], axis=-1) @ at[:3, :3].T + at[:3, 3]
    weights = np.multiply.outer(weight * 0.45, weight * 0.75)
    electric = pw.field(SENDER, places, 1.0, sent, model, tolerance=1e-12)
    magnetic = pw.field(SENDER, places, 1.0, (-sent[1], sent[0]), DUAL[model], tolerance=1e-12)
    along = at[:3, :2] @ taken
    turned = at[:3, :2] @ (-taken[1], taken[0])
    of_electric, of_magnetic = (
        (weights * (electric @ along)).sum(),
        -(weights * (magnetic @ turned)).sum(),
    )
    share = {"huygens": (0.5, 0.5), "magnetic": (1.0, 0.0), "electric": (0.0, 1.0)}[model]
    expected = share[1] * of_electric + share[0] * of_magnetic
    expected /= math.sqrt(1.3 * 0.9 / 2 * TAKER.area)  # int |u|^2 of the taper
    result = link(at, sent, taken, method=model, tolerance=TIGHT, normalise="aperture")
    assert result == pytest.approx(expected, abs=TIGHT)


@models
def test_friis_holds_with_the_directivities_of_the_patterns(model: Any) -> None:
    """The far power is both mismatches times both directivities times (lambda/4 pi r)^2."""
    distance = 1e4
    gains = [
        10 ** (pw.radiation_pattern(source, 1.0, 0.0, 0.0, polarisation="x", method=model)
               .attrs["largest_directivity"] / 10)
        for source in (SENDER, TAKER)
    ]  # fmt: skip
    friis = gains[0] * gains[1] / (4 * math.pi * distance) ** 2
    at = pose(0.0, 0.0, distance)
    for angle in (0.0, 30.0, 60.0):
        result = np.abs(link(at, "x", f"{angle} deg", method=model)) ** 2
        same = pw.radiation_pattern(
            TAKER, 1.0, 0.0, 0.0, polarisation=f"{angle} deg", method=model
        ).attrs["largest_directivity"]
        mismatch = math.cos(math.radians(angle)) ** 2 * 10 ** (same / 10) / gains[1]
        assert result == pytest.approx(friis * mismatch, rel=1e-4)


def test_crossed_and_circular_links_match_as_antennas_do() -> None:
    """Linear to circular loses half, equal hands match face to face, and opposite hands do not."""
    at = pose(0.0, 0.0, 300.0)
    whole = np.abs(link(at, "y", "y")) ** 2
    power = {
        pair: np.abs(link(at, *pair)) ** 2 / whole
        for pair in [("x", "x"), ("x", "y"), ("y", "right"), ("right", "right"), ("right", "left")]
    }
    assert power["x", "x"] == pytest.approx(1.0, rel=1e-4)
    assert power["y", "right"] == pytest.approx(0.5, rel=1e-4)
    assert power["right", "right"] == pytest.approx(1.0, rel=1e-4)
    assert max(power["x", "y"], power["right", "left"]) < 1e-12


def test_elements_of_an_array_may_be_crossed() -> None:
    """Two elements in quadrature along x and y receive circular polarisation."""
    speck = pw.shapes.square(0.2)
    pair = pw.Array([speck, speck], [1, 1j])
    at = pose(0.1, 0.0, 3.0, 0.1)
    result = pw.coupling(pair, TAKER, at, 1.0, polarisation=(["x", "y"], "left"))
    expected = pw.coupling(speck, TAKER, at, 1.0, polarisation=("right", "left"))
    assert result == pytest.approx(expected, abs=1e-9)


def test_several_poses_and_errors_come_as_of_scalar_links() -> None:
    poses = np.stack([pose(0.0, 0.0, 2.0), pose(0.5, 0.0, 4.0)])
    values, errors = link(poses, "x", "x", return_error=True, tolerance=1e-8)
    assert values.shape == errors.shape == (2,)
    tight = [link(at, "x", "x", tolerance=1e-12) for at in poses]
    assert (np.abs(values - tight) <= 1e-8 * np.abs(tight)).all()
    for one in ("x", (2.0, 0.0)):  # for both
        both = pw.coupling(SENDER, TAKER, poses[0], 1.0, polarisation=one)
        assert both == pytest.approx(values[0], rel=1e-7)
