"""Figures of rendered rooms: render, emitters."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from paper.figures.sources import WAVELENGTH, Made, Quality, square
from polywigner.figures import style
from polywigner.figures.levels import image_peak, level_db
from polywigner.figures.scene_plots import draw_scene
from polywigner.interruption import temporary_folder

POSE = '<lookat origin="0, -0.45, 0.16" target="0, -0.05, 0.02" up="0, 0, 1"/>'
"""Pose of the source: its normal points 19 degrees down. Seen along the normal, up is up."""

_ORIGIN = "0, -0.45, 0.16"

_CELLS_PER_WAVELENGTH = 8
_PADDED = 1024
_TANGENT = 12.0  # of the largest angle of the projected pattern, 85 degrees


class Film(NamedTuple):
    """Pixels of an image, and samples per pixel."""

    width: int
    height: int
    samples: int


def render_room(
    source: str, film: Film, images: Mapping[str, NDArray[np.float32]] | None = None
) -> NDArray[np.float64]:
    """Return the radiance (height, width) in W m^-2 sr^-1 of the room with a source."""
    from polywigner.mitsuba import load_scene, render
    from polywigner.mitsuba.plugins.films import mean_of_colours, write_exr

    text = files(__package__).joinpath("room.xml").read_text(encoding="utf-8")
    with temporary_folder() as folder:
        scene = Path(folder) / "room.xml"
        scene.write_text(text.replace("<!-- source -->", source), encoding="utf-8")
        for name, image in (images or {}).items():
            write_exr(Path(folder) / name, image)
        Path(folder, "square.wkt").write_text(square().polygons.wkt, encoding="utf-8")
        loaded = load_scene(scene, width=film.width, height=film.height)
        image = render(loaded, spp=film.samples)
    return mean_of_colours(image)


def wigner_source() -> str:
    """Return the square as a coherent aperture: |u|^2 = 1 W/m^2, with the paper's radiance."""
    return f"""
    <shape type="wigner">
        <string name="aperture" value="square.wkt"/>
        <string name="unit" value="m"/>
        <float name="wavelength" value="{float(WAVELENGTH)!r}"/>
        <string name="obliquity" value="paper"/>
        <transform name="to_world">{POSE}</transform>
    </shape>"""


def uniform_source(power: float) -> str:
    """Return an isotropic point source with the axial intensity of the square."""
    return f"""
    <emitter type="point">
        <point name="position" value="{_ORIGIN}"/>
        <spectrum name="intensity" value="{float(power / (2 * np.pi))!r}"/>
    </emitter>"""


def cosine_source(power: float) -> str:
    """Return the square as an incoherent surface of constant radiance."""
    half = float(np.sqrt(square().area)) / 2
    return f"""
    <shape type="rectangle">
        <transform name="to_world"><scale x="{half!r}" y="{half!r}"/>{POSE}</transform>
        <bsdf type="null"/>
        <emitter type="area">
            <spectrum name="radiance" value="{float(power / (np.pi * square().area))!r}"/>
        </emitter>
    </shape>"""


def intensity_by_fft(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the radiant intensity |F|^2 cos(theta)/wavelength^2 of the square by an FFT."""
    cell = WAVELENGTH / _CELLS_PER_WAVELENGTH
    middles = (np.arange(_PADDED) - _PADDED // 2) * cell
    points = np.stack(np.meshgrid(middles, middles), axis=-1)
    raster = pw.autocorrelation(square(), points, np.zeros(2)).real  # |u|^2 = u
    transform = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(raster))) * cell**2
    places = directions[..., :2] / WAVELENGTH * _PADDED * cell + _PADDED // 2
    low = np.floor(places).astype(int)
    across, up = np.moveaxis(places - low, -1, 0)
    i, j = np.moveaxis(low, -1, 0)
    power = np.abs(transform) ** 2
    below = (1 - across) * power[j, i] + across * power[j, i + 1]
    above = (1 - across) * power[j + 1, i] + across * power[j + 1, i + 1]
    return np.asarray(((1 - up) * below + up * above) * directions[..., 2] / WAVELENGTH**2)


def fft_source(quality: Quality) -> tuple[str, dict[str, NDArray[np.float32]]]:
    """Return a projector with the square's far-field pattern as its image.

    The projector's irradiance E gives the intensity pi E/cos^3(theta).
    """
    count = 1025 if quality == "draft" else 2049
    tangents = ((np.arange(count) + 0.5) / count * 2 - 1) * _TANGENT
    x, y = np.meshgrid(tangents, tangents)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    slide = intensity_by_fft(rays) * rays[..., 2] ** 3 / np.pi
    fov = float(np.degrees(2 * np.arctan(_TANGENT)))
    text = f"""
    <emitter type="projector">
        <texture type="bitmap" name="irradiance">
            <string name="filename" value="slide.exr"/>
            <boolean name="raw" value="true"/>
        </texture>
        <float name="fov" value="{fov!r}"/>
        <transform name="to_world">{POSE}</transform>
    </emitter>"""
    return text, {"slide.exr": slide[..., None].astype(np.float32)}


_FLOOR_DB = -40.0
_FILMS = {"draft": Film(270, 225, 36), "print": Film(720, 600, 784)}


def draw_render(quality: Quality) -> Made:
    """Draw the 10 mm square at 94 GHz above a floor."""
    radiance = render_room(wigner_source(), _FILMS[quality])
    figure = draw_scene(radiance, image_peak(radiance), _FLOOR_DB)
    about = "W m^-2 sr^-1 for |u|^2 = 1 W/m^2; rows from the top; signed"
    return Made({"": figure}, {"radiance": (radiance, about)})


_FILMS_OF_SOURCES = {"draft": Film(270, 225, 36), "print": Film(480, 400, 784)}
_OTHERS = {"draft": 16, "print": 100}  # samples of sources with little noise
_UNIT = "W/(m² sr)"


@style.typeset
def draw_emitters(quality: Quality) -> Made:
    """Draw a scene with four sources of equal power; 0 dB is the peak for the Wigner source."""
    power = pw.power(square(), WAVELENGTH)
    film = _FILMS_OF_SOURCES[quality]
    quiet = film._replace(samples=_OTHERS[quality])
    projector, slide = fft_source(quality)
    pictures = {
        "wigner": render_room(wigner_source(), film),
        "fft": render_room(projector, quiet, slide),
        "uniform": render_room(uniform_source(power), quiet),
        "cosine": render_room(cosine_source(power), quiet),
    }
    titles = ("Wigner, coherent aperture", "far field by FFT, from a point",
              "uniform, from a point", "cosine, incoherent surface")  # fmt: skip
    zero = image_peak(pictures["wigner"])
    figure = style.new_figure(8.4, 6.6, is_compressed=True)
    panels = figure.subplots(2, 2).ravel()
    for axes, picture, title in zip(panels, pictures.values(), titles, strict=True):
        levels = level_db(picture, zero, _FLOOR_DB)
        shown = style.draw_levels(axes, levels, low=_FLOOR_DB)
        axes.set(xticks=[], yticks=[])
        axes.set_title(title)
    bar = figure.colorbar(shown, ax=panels, shrink=0.7, pad=0.02, extend="max")
    against = "nothing lit" if zero is None else style.quantity_text(zero, _UNIT)
    bar.set_label(f"radiance, dB relative to {against}; {style.floor_text(_FLOOR_DB)}")
    style.letter_panels(panels)
    about = "W m^-2 sr^-1; rows from the top; signed"
    values = {name: (picture, about) for name, picture in pictures.items()}
    return Made({"": figure}, {**values, "power": (np.asarray(power), "W, of each source")})
