"""Moments of lag slices: against quadrature of the slice, and the Bessel functions behind them."""

import numpy as np
import pytest

import polywigner as pw
from oracles.quadrature import triangle_nodes
from oracles.references import numpy_and_few
from polywigner import execution, kernels
from polywigner.geometry.aperture import triangulate

# Of area times diameter^2 and turns^3: some roundings of each term; in float32 with phases of some
# turns, which are rounded as well.
DOUBLE, SINGLE = 5e-15, 5e-6

WAVES = pw.Illumination([1, 0.5j, 0.3], [(0.3, 0.1), (-0.2, 0.9), (1.3, -0.5)])
L_SHAPE = pw.Aperture(
    [(-1.5, -1.5), (1.5, -1.5), (1.5, -0.5), (-0.4, -0.5), (-0.4, 1.5), (-1.5, 1.5)]
)
SOURCES = {
    "rectangle": pw.shapes.rectangle(1.0, 0.7),
    "L": L_SHAPE,
    "ring": pw.shapes.ring(1.0, 0.5, n=8),
    "needle": pw.Aperture([(0, 0), (1, 0.3), (0.99, 0.31)]),
    "cosine": pw.shapes.rectangle(1.0, 0.7).with_illumination(pw.cosine_taper(1.0, 0.7)),
    "steered": L_SHAPE.with_illumination(pw.Illumination([1j], [(0.7, 0.2)])),
    "three waves": L_SHAPE.with_illumination(WAVES),
    "needle with waves": pw.Aperture([(0, 0), (1, 0.3), (0.99, 0.31)]).with_illumination(WAVES),
}


def moments(source, x, nu, engine="numpy", double=True):
    kernel = kernels.kernel_for("lag moments", source)
    components = [np.asarray(a[..., k], np.float64) for a in (x, nu) for k in (0, 1)]
    found = execution.evaluate(kernel, source, components, double=double, engine=engine, outputs=6)
    return np.stack(found, axis=-1)


def moments_by_quadrature(source, x, nu):
    outline = source.with_illumination(None)
    region = pw.lag_slice(outline, x)
    if region.is_empty:
        return np.zeros(6)
    vertices, triangles = triangulate(pw.Aperture(region))
    xi, weights = triangle_nodes(vertices[triangles], 30)
    field = source.illumination or pw.uniform()
    tau, square = xi @ nu, (xi**2).sum(-1)
    product = weights * field(x + xi / 2) * np.conj(field(x - xi / 2)) * np.exp(-2j * np.pi * tau)
    functions = [1, 1j * tau, tau**2, square, 1j * tau * square, 1j * tau**3]
    return np.array([(product * f).sum().real for f in functions])


def places(source, count):
    """Positions, and frequencies from none at all to two cycles over the source."""
    x, _ = pw.sample_automean(source.with_illumination(None), count, seed=4)
    sizes = np.resize([0.0, 1e-9, 1e-3, 0.3, 1.0, 2.0], count) / source.diameter
    return x, np.random.default_rng(2).normal(size=(count, 2)) * sizes[:, None]


def scale(source, nu):
    size = source.diameter
    turns = 2 * size * (np.linalg.norm(nu, axis=-1) + 1 / size)
    field = source.illumination
    power = 1.0 if field is None else abs(field.amplitudes).sum() ** 2
    one = np.ones_like(turns)
    columns = [one, turns, turns**2, 4 * size**2 * one, 4 * size**2 * turns, turns**3]
    return 4 * power * source.area * np.stack(columns, axis=-1)


@pytest.mark.parametrize(
    ("name", "engine"), numpy_and_few(SOURCES, ["needle with waves"], slow=["L"])
)
def test_moments_are_integrals_over_the_lag_slice(name, engine):
    source = SOURCES[name]
    x, nu = places(source, 12)
    expected = np.array(
        [moments_by_quadrature(source, *place) for place in zip(x, nu, strict=True)]
    )
    for double, allowed in ((True, DOUBLE), (False, SINGLE)):
        errors = abs(moments(source, x, nu, engine, double) - expected) / scale(source, nu)
        assert errors.max() < allowed


def test_complex_weights_turn_moments_as_steering_does():
    """Elements with the phases of a beam, and the beam's own wave on them, at their centres."""
    kappa = np.array([0.4, 0.0])
    narrow = pw.shapes.rectangle(1e-4, 1.0)
    positions = [np.array([0.0, 0.0]), np.array([1.0, 0.1])]
    weights = [np.exp(2j * np.pi * kappa @ p) for p in positions]
    by_weights = pw.Array([narrow.moved(p) for p in positions], weights)
    wave = pw.Illumination([1], [kappa])
    by_waves = pw.Array([narrow.moved(p).with_illumination(wave) for p in positions])
    x = np.array([[0.5, 0.05], [0.50001, 0.2], [0.49999, -0.1], [0.0, 0.1]])
    nu = np.array([[0.3, 0.2]])
    one, other = moments(by_weights, x, nu), moments(by_waves, x, nu)
    # across an element the wave turns by 4e-5 of a turn
    assert abs(one - other).max() < 1e-3 * abs(one).max()
