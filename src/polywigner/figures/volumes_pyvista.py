"""Isosurfaces as layers of normals, by pyvista in a process of its own.

VTK ends the process where it finds no OpenGL that works (no libEGL, a broken driver): only a
child can find out. The parent gets normals and nothing else, so that surfaces look the same
whoever finds them.
"""

from __future__ import annotations

import importlib.util
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.apart import ChildError, run_apart
from polywigner.errors import EngineError, missing_extra
from polywigner.figures.volumes_layers import Layers, View

Floats = NDArray[np.float64]

_PATIENCE = 100.0
"""Seconds of the processor that a child may take; a first start of Mesa takes some."""


def pyvista_layers(
    levels: NDArray[np.float32],
    lower: Floats,
    spacing: Floats,
    surfaces: tuple[float, ...],
    view: View,
    pixel: float,
) -> Layers:
    """The layers of :func:`.volumes_layers.cast_layers`, from contoured meshes."""
    if importlib.util.find_spec("pyvista") is None:
        raise missing_extra("pyvista", "volume", "draws isosurfaces")
    upper = lower + spacing * (np.array(levels.shape) - 1)
    page = view.corners(lower, upper)
    middle = (page.min(axis=0) + page.max(axis=0)) / 2
    columns, rows = np.ceil(np.ptp(page, axis=0) / pixel).astype(int) + 2
    settings = {
        "levels": levels,
        "origin": lower * view.stretch,
        "spacing": spacing * view.stretch,
        "surfaces": surfaces,
        "towards": view.towards,
        "up": view.up,
        "middle": middle[0] * view.right + middle[1] * view.up,
        "size": (int(columns), int(rows)),
        "height": rows * pixel,
        "far": float(np.linalg.norm((upper - lower) * view.stretch)),
    }
    try:
        normals = run_apart(partial(_drawn, settings), _PATIENCE, None)
    except ChildError as error:
        raise EngineError(
            f"expected pyvista to draw, {str(error).partition(', ')[2]}; install the system's "
            "libEGL (Debian, Ubuntu: libegl1), or use the renderer matplotlib"
        ) from None
    origin = middle + pixel * np.array([-(columns - 1) / 2, (rows - 1) / 2])
    return Layers(normals, origin, np.array([0.0, -pixel]), np.array([pixel, 0.0]))


def _drawn(settings: dict[str, Any]) -> NDArray[np.float32]:
    """The normals of each surface (n, rows, columns, 3)."""
    import pyvista

    levels = settings["levels"]
    grid = pyvista.ImageData(
        dimensions=levels.shape, spacing=settings["spacing"], origin=settings["origin"]
    )
    grid["level"] = levels.ravel(order="F")
    plotter = pyvista.Plotter(off_screen=True, window_size=settings["size"], lighting="none")
    plotter.enable_parallel_projection()
    camera = plotter.camera
    camera.focal_point = settings["middle"]
    camera.position = settings["middle"] + 4 * settings["far"] * settings["towards"]
    camera.up = settings["up"]
    layers = []
    for surface in settings["surfaces"]:
        mesh = grid.contour([surface], "level", compute_normals=True)
        layers.append(_normals_of(plotter, mesh, settings))
    return np.stack(layers)


def _normals_of(plotter: Any, mesh: Any, settings: dict[str, Any]) -> NDArray[np.float32]:
    """The normals of a mesh as the plotter's camera sees them: drawn as unlit colours."""
    normals = np.zeros((*settings["size"][::-1], 3), dtype=np.float32)
    if mesh.n_points == 0:
        return normals
    # VTK's normals of contours follow the gradient downwards: out of what is enclosed.
    out = np.asarray(mesh.point_data["Normals"])
    colours = np.round((out + 1) * 127.5).astype(np.uint8)
    actor = plotter.add_mesh(mesh, scalars=colours, rgb=True, lighting=False, reset_camera=False)
    camera = plotter.camera
    camera.parallel_scale = settings["height"] / 2
    camera.clipping_range = (settings["far"], 8 * settings["far"])
    picture = plotter.screenshot(None, return_img=True, transparent_background=True)
    plotter.remove_actor(actor)
    seen = picture[..., 3] == 255
    found = picture[seen][:, :3].astype(np.float32) / 127.5 - 1
    normals[seen] = found / np.linalg.norm(found, axis=-1, keepdims=True)
    return normals
