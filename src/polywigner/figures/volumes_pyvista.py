"""Isosurfaces as layers of normals, by pyvista in a process of its own.

VTK ends the process where it finds no OpenGL that works (no libEGL, a broken driver): only a
child can find out. The parent gets normals and nothing else, so that surfaces look the same
whoever finds them. ``python -m polywigner.figures.volumes_pyvista IN.npz OUT.npz`` is the child.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import EngineError, missing_extra
from polywigner.figures.volumes_layers import Layers, View
from polywigner.interruption import temporary_folder

Floats = NDArray[np.float64]

_PATIENCE = 300.0
"""Seconds after which the child counts as hanging; a first start of Mesa takes some seconds."""


def pyvista_layers(
    levels: NDArray[np.float32],
    lower: Floats,
    spacing: Floats,
    surfaces: tuple[float, ...],
    view: View,
    pixel: float,
) -> Layers:
    """The layers of :func:`polywigner.figures.volumes_layers.cast_layers`, from contoured meshes.

    Raises
    ------
    MissingExtraError : pyvista is not installed.
    EngineError : it is, but cannot draw on this machine.
    """
    if importlib.util.find_spec("pyvista") is None:
        raise missing_extra("pyvista", "volume", "draws isosurfaces")
    upper = lower + spacing * (np.array(levels.shape) - 1)
    page = view.corners(lower, upper)
    middle = (page.min(axis=0) + page.max(axis=0)) / 2
    columns, rows = np.ceil(np.ptp(page, axis=0) / pixel).astype(int) + 2
    with temporary_folder() as folder:
        given, made = Path(folder) / "given.npz", Path(folder) / "made.npz"
        np.savez(
            given,
            levels=levels,
            origin=lower * view.stretch,
            spacing=spacing * view.stretch,
            surfaces=np.array(surfaces),
            towards=view.towards,
            up=view.up,
            middle=middle[0] * view.right + middle[1] * view.up,
            size=np.array([columns, rows]),
            height=rows * pixel,
            far=float(np.linalg.norm((upper - lower) * view.stretch)),
        )
        _run_child(given, made)
        with np.load(made) as found:
            normals = found["normals"]
    origin = middle + pixel * np.array([-(columns - 1) / 2, (rows - 1) / 2])
    return Layers(normals, origin, np.array([0.0, -pixel]), np.array([pixel, 0.0]))


def _run_child(given: Path, made: Path) -> None:
    command = [sys.executable, "-m", __name__, str(given), str(made)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_PATIENCE
        )
    except subprocess.TimeoutExpired:
        raise EngineError(
            f"expected pyvista to draw, got nothing within {_PATIENCE:g} s; use the renderer "
            "matplotlib"
        ) from None
    if done.returncode != 0 or not made.is_file():
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise EngineError(
            f"expected pyvista to draw, got a process that ended with {done.returncode} ({last}); "
            "install the system's libEGL (Debian, Ubuntu: libegl1), or use the renderer matplotlib"
        )


def _draw(given: Path, made: Path) -> None:
    import pyvista

    with np.load(given) as file:
        settings = dict(file)
    levels = settings["levels"]
    grid = pyvista.ImageData(
        dimensions=levels.shape, spacing=settings["spacing"], origin=settings["origin"]
    )
    grid["level"] = levels.ravel(order="F")
    columns, rows = map(int, settings["size"])
    plotter = pyvista.Plotter(off_screen=True, window_size=[columns, rows], lighting="none")
    plotter.enable_parallel_projection()
    camera = plotter.camera
    camera.focal_point = settings["middle"]
    camera.position = settings["middle"] + 4 * settings["far"] * settings["towards"]
    camera.up = settings["up"]
    layers = []
    for surface in settings["surfaces"]:
        mesh = grid.contour([float(surface)], "level", compute_normals=True)
        layers.append(_normals_of(plotter, mesh, settings, rows, columns))
    np.savez(made, normals=np.stack(layers))


def _normals_of(
    plotter: object, mesh: object, settings: dict[str, NDArray[np.float64]], rows: int, columns: int
) -> NDArray[np.float32]:
    """The normals of a mesh as the plotter's camera sees them: drawn as unlit colours."""
    normals = np.zeros((rows, columns, 3), dtype=np.float32)
    if mesh.n_points == 0:  # type: ignore[attr-defined]
        return normals
    # VTK's normals of contours follow the gradient downwards: out of what is enclosed.
    out = np.asarray(mesh.point_data["Normals"])  # type: ignore[attr-defined]
    colours = np.round((out + 1) * 127.5).astype(np.uint8)
    actor = plotter.add_mesh(  # type: ignore[attr-defined]
        mesh, scalars=colours, rgb=True, lighting=False, reset_camera=False
    )
    camera = plotter.camera  # type: ignore[attr-defined]
    camera.parallel_scale = float(settings["height"]) / 2
    camera.clipping_range = (float(settings["far"]), 8 * float(settings["far"]))
    picture = plotter.screenshot(None, return_img=True, transparent_background=True)  # type: ignore[attr-defined]
    plotter.remove_actor(actor)  # type: ignore[attr-defined]
    seen = picture[..., 3] == 255
    found = picture[seen][:, :3].astype(np.float32) / 127.5 - 1
    normals[seen] = found / np.linalg.norm(found, axis=-1, keepdims=True)
    return normals


if __name__ == "__main__":
    _draw(Path(sys.argv[1]), Path(sys.argv[2]))
