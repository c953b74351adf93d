"""Suggested grids determine the values between their points; coarser grids do not."""

import math

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli.propagate import Region, parse_region, samples_of_region
from polywigner.errors import ArgumentError

WAVELENGTH = 299_792_458 / 94e9

# Number of neighbours on each side for interpolation with a Kaiser window. At twice the Nyquist
# rate, the error is exp(-12 pi/2) = 7e-9.
TAPS = 12
BAND_LIMITED = 1e-6
# Error of fields, which have weak waves beyond their bands, from points that are not stationary.
ASYMPTOTIC = 3e-3
# Relative error next to a kink of W or A with slope 4, where half a step of 1/(8 N) changes values
# of 1/(pi N) by some tenths.
BESIDE_KINKS = 0.2
# Factor of the step that gives 1.5 Nyquist steps, for which a third of the band is aliased.
TOO_COARSE = 1.5 * 2
MISSED = 5e-3


STEERED = pw.shapes.rectangle(9e-3, 5e-3).with_illumination(
    pw.cosine_taper(9e-3, 5e-3) * pw.steering((0.4, 0.2, math.sqrt(0.8)), WAVELENGTH)
)
SOURCES = {
    "square off centre": pw.shapes.square(10e-3).moved((20e-3, -7e-3)),
    "chevron": pw.shapes.chevron(20e-3, 12e-3, 4e-3),
    "steered taper": STEERED,
    "array": pw.phased_array(
        pw.shapes.rectangle(1e-3, 2e-3),
        pw.arrays.grid_positions(4, 3, 2.3e-3, 3e-3),
        np.exp(1j * np.arange(12)),
    ),
}
SLITS = pw.Slits([[-4e-3, -1e-3], [2e-3, 2.5e-3]])


def between(f, points, steps):
    """Interpolate f at points (n, d) from samples at multiples of the steps."""
    beta = np.pi * TAPS / 2
    rows, weights = [], []
    for k, step in enumerate(steps):
        cells = np.floor(points[:, k] / step)[:, None] + np.arange(1 - TAPS, TAPS + 1)
        t = points[:, k, None] / step - cells
        window = np.i0(beta * np.sqrt(np.maximum(0, 1 - (t / TAPS) ** 2))) / np.i0(beta)
        rows.append(cells * step)
        weights.append(np.sinc(t) * window)
    if len(steps) == 1:
        return np.einsum("na,na->n", f(rows[0][..., None]), weights[0])
    grid = np.broadcast_arrays(rows[0][:, :, None], rows[1][:, None, :])
    return np.einsum("nab,na,nb->n", f(np.stack(grid, axis=-1)), *weights)


def worst(f, points, steps, coarser=1.0):
    """Return the error between samples relative to the largest value."""
    values = f(points)
    result = between(f, points, [coarser * step for step in steps])
    return float(np.abs(result - values).max() / np.abs(values).max())


def box_of(source):
    bounds = np.array([element.bounds for element in source.elements_in_plane])
    half = bounds.shape[1] // 2
    return bounds[:, :half].min(axis=0), bounds[:, half:].max(axis=0)


def transform(source, quantity):
    """Return a band-limited function and the name of its axes."""
    low, high = box_of(source)
    centre, lag = (low + high) / 2, (high - low) / 20

    def without_carrier(values, nu):
        return values * np.exp(2j * np.pi * (nu @ centre))

    return {
        "fourier": (lambda nu: without_carrier(pw.fourier(source, nu), nu), "nu"),
        "intensity": (lambda nu: np.abs(pw.fourier(source, nu)) ** 2, "nu"),
        "wigner": (lambda nu: pw.wigner(source, centre, nu), "nu"),
        "ambiguity": (lambda v: without_carrier(pw.ambiguity(source, v, lag), v), "upsilon"),
    }[quantity]


@pytest.mark.parametrize("quantity", ["fourier", "intensity", "wigner", "ambiguity"])
@pytest.mark.parametrize("name", [*SOURCES, "slits"])
def test_values_between_follow_from_the_suggested_grid_and_not_from_a_coarser_one(name, quantity):
    source = SLITS if name == "slits" else SOURCES[name]
    f, kind = transform(source, quantity)
    sampling = pw.suggest_sampling(source, WAVELENGTH, quantity)
    axes = [axis for axis in sampling.axes if axis.name.startswith(kind)]
    assert all(axis.band_limited for axis in axes)
    points = np.random.default_rng(3).uniform(-0.4, 0.4, (24, len(axes))) / WAVELENGTH
    steps = [axis.nyquist / 2 for axis in axes]
    assert worst(f, points, steps) < BAND_LIMITED
    assert worst(f, points, steps, TOO_COARSE) > MISSED


@pytest.mark.parametrize("name", SOURCES)
def test_fringes_over_position_and_lag_are_resolved(name):
    source = SOURCES[name]
    low, high = box_of(source)
    rng = np.random.default_rng(4)
    nu, v = np.array([0.7, 0.5]) / WAVELENGTH, np.array([1.1, 0.9]) / WAVELENGTH
    for quantity, f, kinds, points in (
        ("wigner", lambda x: pw.wigner(source, x, nu), "xy", rng.uniform(low, high, (60, 2))),
        (
            "ambiguity",
            lambda xi: pw.ambiguity(source, v, xi),
            ("xi_x", "xi_y"),
            rng.uniform(low - high, high - low, (60, 2)) / 2,
        ),
    ):
        sampling = pw.suggest_sampling(source, WAVELENGTH, quantity)
        steps = [sampling[k].nyquist / 2 for k in kinds]
        assert not sampling[kinds[0]].band_limited
        error = worst(f, points, steps)
        assert error < BESIDE_KINKS
        assert worst(f, points, steps, TOO_COARSE) > 2 * error


# In the far field, the phase varies fast only at the edge of a plane.
PLANES = [
    ("irradiance", "chevron", 2.0),
    ("irradiance", "array", 40.0),
    ("amplitude", "square off centre", 5.0),
    ("amplitude", "steered taper", 5.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("quantity", "name", "distance"), PLANES)
def test_fields_between_follow_from_the_suggested_plane_and_not_from_a_coarser_one(
    quantity, name, distance
):
    source, z = SOURCES[name], distance * WAVELENGTH
    field, around = getattr(pw, quantity), max(5e-3, z)
    low, high = (np.append(corner, z) for corner in box_of(source))
    points = np.random.default_rng(6).uniform(low[:2] - 5e-3, high[:2] + 5e-3, (12, 2))
    low[:2] -= around  # neighbours may be that far outside
    high[:2] += around

    def on_plane(places):
        full = np.append(places, np.full((*places.shape[:-1], 1), z), axis=-1)
        return field(source, full, WAVELENGTH, method="kirchhoff")

    plane = pw.suggest_sampling(source, WAVELENGTH, quantity, box=(low, high))
    assert plane["z"].count == 1 and plane["z"].step == 0
    steps = [axis.nyquist / 2 for axis in plane.axes[:2]]
    assert worst(on_plane, points, steps) < ASYMPTOTIC
    assert worst(on_plane, points, steps, TOO_COARSE) > 10 * ASYMPTOTIC


def test_axes_cover_the_waves_that_propagate_and_have_zero_among_them():
    sampling = pw.suggest_sampling(SOURCES["chevron"], WAVELENGTH, "wigner")
    nu, x = sampling["nu_x"], sampling["x"]
    assert (nu.low, nu.high) == (-1 / WAVELENGTH, 1 / WAVELENGTH)
    assert nu.values[nu.count // 2] == 0 and len(nu.values) == nu.count
    assert (x.low, x.high) == SOURCES["chevron"].bounds[::2]
    assert sampling.samples == math.prod(axis.count for axis in sampling.axes)
    for axis in sampling.axes:
        assert axis.step <= axis.nyquist / 2 < 1.2 * axis.step
        np.testing.assert_allclose(np.diff(axis.values), axis.step)
    shift = pw.suggest_sampling(SOURCES["chevron"], reach=100.0, quantity="ambiguity")["upsilon_y"]
    assert shift.high == 200.0


WRONG = {
    "an unknown quantity": ({"quantity": "radiance"}, "one of"),
    "no wavelength": ({"wavelength": None, "quantity": "wigner"}, "neither"),
    "no place": ({"quantity": "irradiance"}, "box, line, radius"),
    "two places": (
        {"quantity": "amplitude", "box": [[0] * 3] * 2, "radius": 1.0},
        "box and radius",
    ),
    "a box behind": ({"quantity": "irradiance", "box": ((0, 0, -1), (1, 1, 1))}, "in front"),
    "too few": ({"oversampling": 0.5}, "at least 1"),
    "frequencies beyond floats": ({"reach": 1e308, "quantity": "wigner"}, "units"),
    "a place for a pattern": (
        {"quantity": "pattern", "radius": 1.0},
        '"pattern" does not use radius',
    ),
    "another unit": ({"wavelength": 1e-30}, "units"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_suggested_for_is_refused(case):
    options, message = WRONG[case]
    with pytest.raises(ArgumentError, match=message):
        pw.suggest_sampling(SOURCES["chevron"], **{"wavelength": WAVELENGTH, **options})


def test_fields_of_slits_are_refused_and_axes_asked_for_by_wrong_names():
    with pytest.raises(ArgumentError, match="Aperture"):
        pw.suggest_sampling(SLITS, WAVELENGTH, "irradiance", radius=1.0)
    with pytest.raises(ArgumentError, match="nu"):
        pw.suggest_sampling(SLITS, WAVELENGTH)["nu_x"]


PLACES = {
    "arc": ("2 m, 0 deg, 60 deg", (321,), {"radius": 2.0}, 60),
    "hemisphere": ("2 m", (61, 120), {"radius": 2.0}, 6),
    "plane": (
        "-0.6 m to 0.6 m, 0 mm, 0.5 m to 2 m",
        (129, 129),
        {"box": ((-0.6, 0, 0.5), (0.6, 0, 2.0))},
        25,
    ),
}


@pytest.mark.parametrize("kind", PLACES)
def test_every_place_of_the_command_line_gets_what_its_field_needs(kind):
    text, fewest, options, size = PLACES[kind]
    place = parse_region({kind: text}, None)
    small, wide = (pw.shapes.square(n * WAVELENGTH) for n in (2, size))
    assert samples_of_region(small, place, WAVELENGTH) == fewest
    chosen = samples_of_region(wide, place, WAVELENGTH)
    assert max(np.array(chosen) / fewest) > 1
    axes = pw.suggest_sampling(wide, WAVELENGTH, "irradiance", **options).axes
    for count, axis in zip(chosen, [axis for axis in axes if axis.step], strict=False):
        extent = axis.high - axis.low if kind != "arc" else 2 * place.largest_theta
        assert extent / count <= axis.nyquist / 2


def test_a_box_is_as_fine_as_its_field_up_to_a_million_samples_and_then_says_so():
    square = pw.shapes.square(10e-3)
    far = Region("box", (), ((-0.02, -0.02, 0.3), (0.02, 0.02, 0.4)))
    assert samples_of_region(square, far, WAVELENGTH) == (64, 64, 64)
    near = Region("box", (), ((-0.02, -0.02, 0.01), (0.02, 0.02, 0.12)))
    wanted = [axis.count for axis in pw.suggest_sampling(square, WAVELENGTH, "irradiance",
                                                         box=near.points).axes]  # fmt: skip
    assert samples_of_region(square, near, WAVELENGTH) == tuple(max(64, n) for n in wanted)
    large = Region("box", (), ((-0.5, -0.5, 0.01), (0.5, 0.5, 1.0)))
    with pytest.warns(RuntimeWarning, match="--shape"):
        assert max(samples_of_region(square, large, WAVELENGTH)) == 101
