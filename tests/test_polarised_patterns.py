"""Patterns of polarised sources against textbooks and closed forms, and their files."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw

MODELS: tuple[Any, ...] = ("huygens", "magnetic", "electric")
models = pytest.mark.parametrize("model", MODELS)
THETA = np.radians(np.arange(-80, 81, 2.0))
PRINCIPAL = np.array([0.0, math.pi / 2])
SMALL = 1e-3
"""Width of what textbooks take as thin, in wavelengths."""
TEXTBOOK = 0.01
"""dB."""
HORN = pw.shapes.rectangle(3.0, 2.0).with_illumination(pw.te_mode(3.0, 2.0, 1, 0))


def pattern(source: Any, theta: Any = THETA, phi: Any = PRINCIPAL, **how: Any) -> Any:
    return pw.radiation_pattern(source, 1.0, theta, phi, **how)


def relative(result: Any) -> np.ndarray:
    """Return cuts in dB relative to the axis."""
    levels = result["directivity"].values
    return levels - levels[len(levels) // 2]


def decibels(field: Any) -> np.ndarray:
    return np.asarray(20 * np.log10(np.abs(field)))


def test_a_half_wave_dipole_and_slot_have_their_textbook_patterns() -> None:
    """cos(pi/2 cos psi)/sin psi with psi from the dipole; the directivity of 2.151 dBi increases by
    3.010 dB in a half space.
    """
    thin = pw.shapes.rectangle(0.5, SMALL).with_illumination(pw.cosine_taper(0.5))
    along = decibels(np.cos(math.pi / 2 * np.sin(THETA)) / np.cos(THETA))
    for jones, method, planes in (("x", "electric", (0, 1)), ("y", "magnetic", (0, 1))):
        result = pattern(thin, polarisation=jones, method=method)
        dipole, across = (relative(result)[:, plane] for plane in planes)
        assert dipole == pytest.approx(along, abs=TEXTBOOK)
        assert across == pytest.approx(np.zeros(len(THETA)), abs=TEXTBOOK)
        assert result.attrs["peak_directivity"] == pytest.approx(2.151 + 3.010, abs=TEXTBOOK)


def test_a_horn_has_its_textbook_cuts() -> None:
    """The cuts are those of Balanis for a TE10 mode in free space, with E-plane y and H-plane x."""
    result = relative(pattern(HORN, polarisation="y", method="huygens"))
    s, lean = np.sin(THETA), (1 + np.cos(THETA)) / 2
    h_plane = np.cos(math.pi * 3.0 * s) / (1 - (2 * 3.0 * s) ** 2) * lean
    e_plane = np.sinc(2.0 * s) * lean
    for plane, expected in enumerate((h_plane, e_plane)):
        lit = np.abs(expected) > 1e-3
        assert result[lit, plane] == pytest.approx(decibels(expected[lit]), abs=TEXTBOOK)


def test_a_patch_has_its_textbook_cuts() -> None:
    """The patch is two slots of magnetic current on a ground plane (Balanis, sec. 14.2)."""
    width, length, height = 0.4, 0.33, 0.02
    slot = pw.shapes.rectangle(height, width)
    slots = pw.phased_array(slot, [(-length / 2, 0), (length / 2, 0)])
    result = relative(pattern(slots, polarisation="x", method="magnetic"))
    s = np.sin(THETA)
    e_plane = np.sinc(height * s) * np.cos(math.pi * length * s)
    h_plane = np.cos(THETA) * np.sinc(width * s)
    for plane, expected in enumerate((e_plane, h_plane)):
        assert result[:, plane] == pytest.approx(decibels(expected), abs=TEXTBOOK)


def test_the_scalar_conditions_are_cuts_of_the_vector_patterns() -> None:
    """RS-II and RS-I are the E- and H-plane of the magnetic model, and the H- and E-plane of the
    electric model; Kirchhoff equals Huygens.
    """
    source = pw.shapes.rectangle(1.3, 0.8)
    scalar = {
        n: pattern(source, obliquity=f"rayleigh-sommerfeld-{n}")["field"].values for n in (1, 2)
    }
    for method, (first, second) in {"magnetic": (2, 1), "electric": (1, 2)}.items():
        vector = pattern(source, polarisation="x", method=method)["field"].values
        assert vector[:, 0] == pytest.approx(scalar[first][:, 0], abs=1e-12)
        assert vector[:, 1] == pytest.approx(scalar[second][:, 1], abs=1e-12)
    around = np.linspace(0, 6, 7)
    kirchhoff = pattern(source, phi=around, obliquity="kirchhoff")
    huygens = pattern(source, phi=around, polarisation="right")
    assert huygens["field"].values == pytest.approx(kirchhoff["field"].values, abs=1e-12)
    assert huygens["directivity"].values == pytest.approx(kirchhoff["directivity"].values, abs=1e-9)


def test_a_linear_polarisation_crosses_between_the_principal_planes() -> None:
    """Magnetic currents: E_theta ~ cos(phi), E_phi ~ cos(theta) sin(phi). On the diagonal, the
    ratio of co- to cross-polar fields is (1 + cos)/(1 - cos). Huygens sources have no cross-polar
    field.
    """
    theta, diagonal = np.radians([10.0, 35.0, 70.0]), math.pi / 4
    c = np.cos(theta)
    for method in ("magnetic", "electric"):
        result = pattern(HORN, theta, diagonal, polarisation="x", method=method)
        ratio = result["cross_polar_discrimination"].values[:, 0]
        assert ratio == pytest.approx(decibels((1 + c) / (1 - c)), abs=1e-9)
        assert (result["axial_ratio"].values > 200).all()
    huygens = pattern(HORN, theta, np.linspace(0, 6, 5), polarisation="20 deg")
    assert np.abs(huygens["cross_field"]).max() < 1e-14 * np.abs(huygens["field"]).max()


def test_circular_waves_are_ellipses_of_the_cosine_beside_the_axis() -> None:
    theta = np.radians([0.0, 20.0, 50.0])
    result = pattern(HORN, theta, 0.3, polarisation="left", method="magnetic")
    assert result["axial_ratio"].values[:, 0] == pytest.approx(-decibels(np.cos(theta)), abs=1e-9)
    metrics = pw.beam_metrics(pattern(HORN, polarisation="left", method="magnetic"))
    assert metrics.axial_ratio == pytest.approx(0.0, abs=1e-9)
    assert metrics.cross_polar_discrimination is not None
    assert metrics.cross_polar_discrimination > 200
    assert "axial ratio       0.00 dB" in str(metrics)
    assert pw.beam_metrics(pattern(HORN)).axial_ratio is None


@models
def test_directivity_counts_all_of_the_field(model: Any) -> None:
    """The mean of the directivity over all directions is 1, by an independent quadrature."""
    source = pw.shapes.triangle(1.1, 0.9).with_illumination(pw.steering((0.6, 0, 0.8), 1.0))
    node, weight = np.polynomial.legendre.leggauss(40)
    phi = 2 * np.pi * np.arange(60) / 60
    result = pattern(source, np.arccos((node + 1) / 2), phi, polarisation=(1, 0.5j), method=model)
    gain = 10 ** (result["directivity"].values / 10)
    assert (gain.mean(axis=1) @ weight) / 4 == pytest.approx(1.0, abs=1e-9)
    parts = np.abs(result["field"].values) ** 2 + np.abs(result["cross_field"].values) ** 2
    expected = 4 * math.pi * parts / result.attrs["radiated_power"]
    assert gain == pytest.approx(expected, rel=1e-9)
    assert result.attrs["aperture_power"] == pytest.approx(source.area)  # |u p|^2 = 1


def test_a_far_point_has_the_field_of_the_pattern() -> None:
    """A steered array with a polarisation for each element."""
    row = pw.phased_array(
        pw.shapes.square(0.4), [(0.5 * k, 0.0) for k in range(4)], np.exp(-1j * np.arange(4))
    )
    theta, phi, distance = 0.4, 0.7, 1e7
    result = pattern(row, theta, phi, polarisation=["x", "y", "x", "right"], method="magnetic")
    s = (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))
    far = pw.field(row, distance * np.array(s), 1.0, ["x", "y", "x", "right"], "magnetic")
    power = abs(result["field"].item()) ** 2 + abs(result["cross_field"].item()) ** 2
    assert distance**2 * np.square(np.abs(far)).sum() == pytest.approx(power, rel=1e-5)
    beam = result.attrs["peak_theta"], result.attrs["peak_phi"]
    there = pattern(row, *beam, polarisation=["x", "y", "x", "right"], method="magnetic")
    assert there["cross_field"].item() == pytest.approx(0.0, abs=1e-6)
    assert there.attrs["peak_cross_polar_discrimination"] > 200


def test_a_curved_wave_has_a_vector_pattern_as_well() -> None:
    """A curved wave along x is a product, and equals a flat horn for an infinite radius."""
    model = "huygens"
    flat = pattern(HORN, polarisation="y", method=model)
    curved = pattern(HORN.curved(1e9, 1.0), polarisation="y", method=model)
    assert curved["field"].values == pytest.approx(flat["field"].values, abs=1e-6)
    bent = pattern(HORN.curved(4.0, 1.0), polarisation="y", method=model)
    assert bent.attrs["peak_directivity"] < flat.attrs["peak_directivity"] - 0.5
