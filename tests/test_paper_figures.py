"""``make paper-figures``: the numbers behind figures are those of the public functions."""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from string import ascii_lowercase

import matplotlib.pyplot as plt
import numpy as np
import pytest
import shapely

import polywigner as pw

sys.path.append(str(Path(__file__).parents[1]))

from paper.figures import FIGURES, make_figure
from paper.figures.__main__ import write
from paper.figures.sampling import POSITION, dense_samples
from paper.figures.scenes import intensity_by_fft
from paper.figures.sources import WAVELENGTH, chevrons, square, triangle, triangles

Values = dict[str, np.ndarray]

# Of values that are computed in another way or order than those in the file.
ROUNDING = 1e-12


def frequencies(axis):
    return np.stack(np.meshgrid(axis, axis), axis=-1)


def shape(values, name):
    return shapely.from_geojson(str(values[name]))


def check_amp_spec(values):
    """The transform is that of both chevrons together, each by itself from its own edges."""
    assert values["frequency"][-1] == 1 / WAVELENGTH
    nu = frequencies(values["frequency"])[::8, ::8]
    parts = [pw.fourier(pw.Aperture(part), nu) for part in chevrons().polygons.geoms]
    apart = np.abs(values["fourier"][::8, ::8] - sum(parts)).max()
    assert apart < ROUNDING * chevrons().area


def check_indmk(values):
    """The automean is where the position marginal is not zero; it lies inside the hull."""
    elements, automean, hull = (shape(values, name) for name in ("elements", "automean", "hull"))
    assert elements.equals(triangles().polygons)
    xmin, ymin, xmax, ymax = hull.bounds
    places = np.random.default_rng(1).uniform((xmin, ymin), (xmax, ymax), (2000, 2))
    inside = shapely.contains_xy(automean, places)
    assert np.array_equal(inside, pw.position_marginal(triangles(), places) > 0)
    assert values["areas"][0] < values["areas"][1] < values["areas"][2]
    assert automean.difference(hull).area < ROUNDING * hull.area


def check_marginals(values):
    """Both integrate to the square of the area: a sum over samples does to their distance."""
    for name, x, y in (("position", "x", "y"), ("lag", "xi_x", "xi_y")):
        cell = (values[x][1] - values[x][0]) * (values[y][1] - values[y][0])
        total = values[f"{name}_marginal"].sum() * cell
        assert total == pytest.approx(triangles().area ** 2, rel=1e-3)


def check_xforms(values):
    """Slices are overlaps of the two outlines drawn; their areas are the marginals."""
    for first, second, found, area in (
        ("doubled", "mirrored", "lag_slice", pw.position_marginal(triangle(), values["x"])),
        ("behind", "ahead", "position_slice", pw.lag_marginal(triangle(), values["xi"])),
    ):
        overlap = shape(values, first).intersection(shape(values, second))
        assert shape(values, found).symmetric_difference(overlap).area < ROUNDING * area
        assert shape(values, found).area == pytest.approx(area, rel=ROUNDING)


def check_projs(values):
    """Diagonal tiles are known: R_x, |F|^2, and for A the product of two transforms."""
    x = np.stack(np.meshgrid(values["x"], values["y"], indexing="ij"), axis=-1)
    close(values["autocorrelation_x_y"], pw.position_marginal(chevrons(), x))
    nu = np.stack(np.meshgrid(values["nu_x"], values["nu_y"], indexing="ij"), axis=-1)
    close(values["wigner_nu_x_nu_y"], np.abs(pw.fourier(chevrons(), nu)) ** 2)
    half = np.stack(np.meshgrid(values["upsilon_x"], values["upsilon_y"], indexing="ij"), -1) / 2
    product = pw.fourier(chevrons(), half) * pw.fourier(chevrons(), -half).conj()
    close(values["ambiguity_upsilon_x_upsilon_y"], product)


def close(found, expected):
    assert np.abs(found - expected).max() < ROUNDING * np.abs(expected).max()


def check_volrender(values):
    """Exact values are those of Wigner rays, another theory, far from the plane."""
    axes = [values[name][::step] for name, step in (("x", 10), ("y", 10), ("z", 5))]
    far = axes[2] > 20 * WAVELENGTH  # nearer, rays of first order are a few per cent off
    points = np.stack(np.meshgrid(axes[0], axes[1], axes[2][far], indexing="ij"), axis=-1)
    rays = pw.irradiance(chevrons(), points, WAVELENGTH, tolerance=1e-2)
    exact = values["irradiance"][::10, ::10, ::5][..., far]
    assert np.abs(rays - exact).max() < 0.02 * exact.max()


def check_volrender_fdtd(values):
    """Behind a black screen Kirchhoff's integral is exact: what differs is the lattice."""
    axes = [values["x"][35::7], values["y"][35::7], values["z"][::6]]  # from the middle outwards
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    exact = pw.irradiance(square(), points, WAVELENGTH, "kirchhoff")
    peak = values["fdtd"].max()
    assert np.abs(values["fdtd"][35::7, 35::7, ::6] - exact).max() < 0.06 * peak
    assert np.abs(values["rays"] - values["fdtd"]).max() < 0.16 * peak
    assert np.array_equal(values["fdtd"], values["fdtd"][::-1, ::-1])


def check_render(values):
    """Where the axis meets the floor, radiance is that of a diffuse floor in the exact field."""
    position, target = np.array([0, -0.45, 0.16]), np.array([0, -0.05, 0.02])
    axis = (target - position) / np.linalg.norm(target - position)
    distance = -position[2] / axis[2]
    on_floor = position + distance * axis
    field = pw.irradiance(square(), (0, 0, distance), WAVELENGTH, method="rayleigh-sommerfeld-1")
    expected = 0.5 / np.pi * field * -axis[2]  # reflectance, and the floor's own cosine
    rows, columns = (slice(k - 2, k + 3) for k in pixel(on_floor, values["radiance"].shape))
    # 25 pixels of 36 samples, and a per cent from the walls.
    assert values["radiance"][rows, columns].mean() == pytest.approx(expected, rel=0.05)
    assert values["radiance"].min() < 0


def pixel(point, shape):
    """Row and column at which the camera of the room sees a point."""
    origin, target = np.array([0, -1.25, 1.45]), np.array([0, 0.06, 0.05])
    ahead = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross([0, 0, 1], ahead) / np.linalg.norm(np.cross([0, 0, 1], ahead))
    to = (point - origin) / ((point - origin) @ ahead)
    scale = shape[1] / 2 / np.tan(np.radians(40 / 2))
    column = shape[1] / 2 - scale * (to @ left)
    return int(shape[0] / 2 - scale * (to @ np.cross(ahead, left))), int(column)


def levels_apart(first, second):
    """dB between the means over the beam, where the second is above -10 dB of its peak."""
    beam = second > 0.1 * np.quantile(second, 0.999)
    return abs(10 * np.log10(first[beam].mean() / second[beam].mean()))


def check_emitters(values):
    """Of equal power: near the axis a cosine source is twice as bright as a uniform one."""
    assert levels_apart(values["wigner"], values["fft"]) < 0.1
    ratio = values["cosine"] / np.where(values["uniform"] > 0, values["uniform"], np.inf)
    beam = values["fft"] > 0.5 * np.quantile(values["fft"], 0.999)
    assert 1.9 < np.median(ratio[beam]) < 2.0
    theta = np.radians([0.0, 5, 12, 27, 40])
    sines = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    exact = pw.radiant_intensity(square(), sines, WAVELENGTH)
    # A raster of 25 cells and straight lines between frequencies.
    assert np.abs(intensity_by_fft(sines) - exact).max() < 0.02 * exact.max()


def check_compar(values):
    """What the caption says of boresight: rays converge to Kirchhoff after two wavelengths."""
    z = values["boresight_z"]
    kirchhoff = values["boresight_kirchhoff"]
    points = np.stack([0 * z, 0 * z, z], axis=-1)[::100]
    exact = pw.irradiance(square(), points, WAVELENGTH, method="kirchhoff")
    np.testing.assert_allclose(kirchhoff[::100], exact, rtol=1e-6)  # its own tolerance and grids
    apart = 10 * np.log10(values["boresight_paper"] / kirchhoff)
    assert np.abs(apart[z > 2 * WAVELENGTH]).max() < 1.0
    assert np.abs(apart[z > 3 * WAVELENGTH]).max() < 0.15
    shape = len(values["plane_x"]), len(values["plane_z"])
    assert values["plane_fraunhofer"].shape == shape
    x, z = values["plane_x"][::30], values["plane_z"][5::30]
    points = np.stack(np.broadcast_arrays(x[:, None], 0.0, z), axis=-1)
    rays = pw.irradiance(square(), points, WAVELENGTH, obliquity="paper")
    assert np.abs(values["plane_paper"][::30, 5::30] - rays).max() < 1e-3 * rays.max()


def check_error(values):
    """Rays fall with the square of the distance on the axis; beside it, the paper's obliquity stays
    wrong."""
    (paper, matched, _, fraunhofer), far = values["boresight_error"], values["distance"]
    fit = far > 20
    for errors in (matched, fraunhofer):
        slope = np.polyfit(np.log(far[fit]), np.log(np.abs(errors[fit])), 1)[0]
        assert -2.1 < slope < -1.9
    beside = values["arc_rms"][:, -1]
    assert beside[1] < beside[0] / 10
    assert np.abs(paper - matched)[far > 3].max() < 0.01


def check_sampling(values):
    """The paper's own count; and grids get better with their number of cells, to first order."""
    assert dense_samples(10e-3, WAVELENGTH, 2) == 4096
    assert tuple(values["x"]) == POSITION
    finer = values["error"] * values["cells"]
    assert values["error"][-1] < 0.01 < 0.5 < values["error"][0]
    assert finer[-1] < finer[0]


def check_appendix(values):
    """At zero the transform is the area; the circle's is Airy's to what its 64 corners leave."""
    from scipy.special import j1

    middle = len(values["nu_x"]) // 2
    assert values["rectangle"][middle, middle] == pytest.approx(12e-3 * 8e-3, rel=ROUNDING)
    nu = values["nu_x"][values["nu_x"] > 0]
    airy = 5e-3 * j1(2 * np.pi * nu * 5e-3) / nu
    assert np.abs(values["circle"][middle, middle + 1 :] - airy).max() < 1e-3 * np.pi * 5e-3**2
    slit = 10e-3 * np.sinc(values["nu"] * 10e-3)
    assert np.abs(values["single_slit_1D"] - slit).max() < ROUNDING * 10e-3


CHECKS: dict[str, Callable[[Values], None]] = {
    "amp_spec": check_amp_spec,
    "indmk": check_indmk,
    "marginals": check_marginals,
    "xforms": check_xforms,
    "projs": check_projs,
    "render": check_render,
    "volrender": check_volrender,
    "volrender_fdtd": check_volrender_fdtd,
    "emitters": check_emitters,
    "compar": check_compar,
    "error": check_error,
    "sampling": check_sampling,
    "appendix": check_appendix,
}


def test_every_figure_is_checked():
    assert set(CHECKS) == set(FIGURES)


RENDERED = {"render", "emitters"}  # minutes without LLVM
SHORT = {"indmk", "xforms"}


def marks(name):
    return [pytest.mark.llvm] * (name in RENDERED) + [pytest.mark.slow] * (name not in SHORT)


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks(name)) for name in FIGURES])
def test_the_numbers_behind_a_figure_are_those_of_the_public_functions(name, tmp_path):
    made = make_figure(name)
    write(tmp_path, name, made, 150)
    parts = FIGURES[name].parts
    stems = [f"{name}_{part}" if part else name for part in parts]
    pictures = [tmp_path / f"{stem}.png" for stem in stems]
    expected = [*pictures, *(path.with_suffix(".pdf") for path in pictures)]
    assert sorted(tmp_path.iterdir()) == sorted([*expected, tmp_path / f"{name}.npz"])
    with np.load(tmp_path / f"{name}.npz") as file:  # without pickle: plain arrays only
        values = dict(file)
    metadata = json.loads(str(values.pop("metadata")))
    assert set(metadata["about"]) == set(values)
    CHECKS[name](values)
    for picture, part, figure in zip(pictures, parts, made.figures.values(), strict=True):
        check_nothing_is_cut_off(picture)
        check_panels_have_letters(figure, part)


def check_nothing_is_cut_off(picture):
    """The outermost pixels are paper: what passes beyond the edge of a figure leaves ink there."""
    pixels = plt.imread(picture)[..., :3]
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert edge.min() == 1.0, picture.name


def check_panels_have_letters(figure, part):
    """(a), (b), ... of several panels, and (a1), (a2), ... of those of a part (a)."""
    panels = [axes for axes in figure.axes if axes.get_title() or axes.get_title(loc="left")]
    if len(panels) < 2:
        return
    letters = [re.search(r"\((\w+)\)", axes.get_title(loc="left")) for axes in panels]
    names = [f"{part}{k}" for k in range(1, 10)] if part else list(ascii_lowercase)
    assert [letter[1] for letter in letters if letter] == names[: len(panels)]
