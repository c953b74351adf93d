"""Damaged files of every format raise one error that contains the name of the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import FileFormatError

DATA = Path(__file__).parent / "data"
SQUARE = pw.shapes.square(1.0)
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def write_dxf(path: Path) -> None:
    document = pytest.importorskip("ezdxf").new()
    document.modelspace().add_circle((0, 0), 1)
    document.saveas(path)


def write_gds(path: Path) -> None:
    gdstk = pytest.importorskip("gdstk")
    library = gdstk.Library()
    library.new_cell("top").add(gdstk.rectangle((0, 0), (1, 1)))
    library.write_gds(path)


def write_rays(path: Path) -> None:
    rays = pw.sample_rays(SQUARE, 0.1, 20)
    pw.rays.save(rays.assign(weight=abs(rays.weight)), path)


def write_pattern(path: Path) -> None:
    angles = np.radians(np.arange(0, 91, 5)), np.radians(np.arange(0, 360, 20))
    pattern = pw.radiation_pattern(SQUARE, 0.5, *angles, polarisation="x")
    pw.write_pattern(pattern, path)


def written(text: str) -> Callable[[Path], Any]:
    return lambda path: path.write_text(text)


# suffix -> (reader, writer of a valid file)
FORMATS: dict[str, tuple[Callable[[Path], Any], Callable[[Path], Any]]] = {
    ".geojson": (
        pw.read_aperture,
        written('{"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 0]]]}'),
    ),
    ".wkt": (pw.read_aperture, written("POLYGON ((0 0, 1 0, 1 1, 0 0))")),
    ".svg": (pw.read_aperture, written('<svg><rect width="1" height="1"/></svg>')),
    ".dxf": (pw.read_aperture, write_dxf),
    ".gds": (pw.read_aperture, write_gds),
    ".gbr": (
        pw.read_aperture,
        written("%FSLAX36Y36*%\n%MOMM*%\n%ADD10C,1*%\nD10*\nX0Y0D03*\nM02*\n"),
    ),
    ".stl": (
        pw.read_sheets,
        written(
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
            "endloop\nendfacet\nendsolid a\n"
        ),
    ),
    ".ply": (
        pw.read_sheets,
        written(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
            "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
        ),
    ),
    ".obj": (pw.read_polyhedron, written(TETRAHEDRON)),
    ".toml": (pw.read_source, lambda path: pw.write_source(SQUARE, path)),
    ".json": (pw.read_source, lambda path: pw.write_source(SQUARE, path)),
    ".dat": (pw.rays.load, write_rays),
    ".ffd": (pw.read_pattern, write_pattern),
    ".txt": (pw.read_pattern, write_pattern),
    ".cut": (pw.read_pattern, write_pattern),
}


def make_large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(65 << 20)


def cut(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: 2 * len(content) // 3])


DAMAGE: dict[str, tuple[Callable[[Path], Any], str | None]] = {
    "missing": (Path.unlink, "path that does not exist"),
    "a directory": (lambda path: [path.unlink(), path.mkdir()], "got a directory"),
    "empty": (lambda path: path.write_bytes(b""), None),
    "too large": (make_large, "at most 64 MiB"),
    "binary": (lambda path: path.write_bytes(bytes(range(256)) * 8), None),
    "cut short": (cut, None),
    "another format": (lambda path: path.write_text("Dear reader,\nnot a drawing\n"), None),
}


@pytest.mark.filterwarnings("ignore:got negative powers")
@pytest.mark.parametrize("suffix", FORMATS)
def test_a_bad_file_gives_one_error_with_its_name(tmp_path: Path, suffix: str) -> None:
    read, write = FORMATS[suffix]
    path = tmp_path / f"name{suffix}"
    for kind, (damage, words) in DAMAGE.items():
        write(path)
        if kind == "missing":
            read(path)
        if kind == "too large" and suffix == ".dat":  # ray files may have any size
            continue
        damage(path)
        with pytest.raises(FileFormatError, match=words) as caught:
            read(path)
        message = str(caught.value)
        assert f"name{suffix}" in message, kind
        assert len(message) < 600 and "\n" not in message, kind
        if kind == "a directory":
            path.rmdir()


@pytest.mark.parametrize("suffix", [".wkt", ".svg", ".gbr", ".obj", ".toml"])
def test_errors_do_not_quote_a_file_of_another_kind(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"name{suffix}"
    path.write_text("root:hunter2hash:0:0\nuser = hunter2hash\n")
    with pytest.raises(FileFormatError) as caught:
        FORMATS[suffix][0](path)
    assert "hunter2" not in str(caught.value)
