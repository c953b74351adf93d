"""Scene files: permitted plugins and files, parameters, includes and damaged meshes."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from cli_scenes import scene
from polywigner.errors import PolywignerError, SceneError

pytestmark = pytest.mark.drjit
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

from polywigner.mitsuba.plugins.films import threads_for_openexr  # noqa: E402

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()


def named(kind: str, file: str) -> str:
    """Return a mesh, image, volume or spectrum element with a file name."""
    name = f'<string name="filename" value="{file}"/>'
    if kind in ("obj", "ply", "serialized", "stl"):
        return f'<shape type="{kind}">{name}</shape>'
    if kind == "vol":
        volume = f'<volume type="gridvolume" name="sigma_t">{name}</volume>'
        medium = f'<medium name="interior" type="heterogeneous">{volume}</medium>'
        return f'<shape type="cube">{medium}</shape>'
    value = f'<texture type="bitmap" name="reflectance">{name}</texture>'
    if kind == "spd":
        value = f'<spectrum name="reflectance" filename="{file}"/>'
    return f'<shape type="sphere"><bsdf type="diffuse">{value}</bsdf></shape>'


def load(folder: Path, inside: str, **parameters: object) -> object:
    path = folder / "scene.xml"
    path.write_text(scene(inside))
    return pm.load_scene(path, "scalar_rgb", **parameters)


REFUSED = {
    "unknown type": ('<shape type="ball"/>', "plugin type 'ball', which is unknown"),
    "type from a parameter": (
        '<default name="t" value="ball"/><shape type="$t"/>',
        "plugin type 'ball'",
    ),
    "type from an include": ('<include filename="ball.xml"/>', "plugin type 'ball'"),
    "type that is a path": ('<shape type="../plugins/ball"/>', "plugin type"),
    "memory addresses": ('<shape type="blender"/>', "plugin type 'blender'"),
    "mesh above the folder": (named("obj", "../outside.obj"), "outside its folder"),
    "mesh behind a link": (named("obj", "link.obj"), "outside its folder"),
    "file from a parameter": (
        '<default name="f" value="../outside"/>' + named("obj", "$f.obj"),
        "outside its folder",
    ),
    "spectrum above the folder": (named("spd", "../outside.obj"), "outside its folder"),
    "outline above the folder": (
        '<shape type="wigner"><string name="aperture" value="../outside.obj"/></shape>',
        "outside its folder",
    ),
    "include above the folder": ('<include filename="../outside.xml"/>', "outside its folder"),
    "include of itself": ('<include filename="scene.xml"/>', "in a cycle"),
    "search path": ('<path value="sub"/>', "<path> is not supported"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_scene_that_is_not_permitted_is_refused(tmp_path: Path, name: str) -> None:
    inside, words = REFUSED[name]
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "outside.obj").write_text(TRIANGLE)
    (tmp_path / "outside.xml").write_text(scene(""))
    (folder / "link.obj").symlink_to(tmp_path / "outside.obj")
    (folder / "ball.xml").write_text(scene('<shape type="ball"/>'))
    with pytest.raises(SceneError, match=words):
        load(folder, inside)


XML = {
    "doctype": ("<!DOCTYPE scene>" + scene(""), "DOCTYPE are not supported"),
    "entity": ('<!DOCTYPE a [<!ENTITY e "e">]>' + scene("&e;"), "DOCTYPE are not supported"),
    "text": ("a scene", "XML error in line 1"),
    "cut short": (scene("")[:-3], "XML error in line 1"),
    "empty": ("", "empty"),
    "too large": (scene(" " * 9 * 2**20), "at most 8 MiB"),
    "not a scene": ('<shape version="3.0.0" type="sphere"/>', "scene"),
}


@pytest.mark.parametrize("name", XML)
def test_only_plain_xml_is_read(tmp_path: Path, name: str) -> None:
    text, words = XML[name]
    path = tmp_path / "scene.xml"
    path.write_text(text)
    with pytest.raises(SceneError, match=words):
        pm.load_scene(path, "scalar_rgb")


def test_no_library_beside_a_scene_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A perspective camera uses a film and a sampler that the scene does not contain."""
    (tmp_path / "plugins").mkdir()
    for name in ("hdrfilm", "independent", "perspective", "ball"):
        for suffix in (".so", ".dylib", ".dll"):
            (tmp_path / "plugins" / f"{name}{suffix}").write_bytes(b"no library")
    monkeypatch.chdir(tmp_path)
    assert load(tmp_path, '<sensor type="perspective"/>').sensors()
    with pytest.raises(SceneError, match="plugin type 'ball'"):
        load(tmp_path, '<shape type="ball"/>')


def test_types_that_python_code_has_registered_are_permitted(tmp_path: Path) -> None:
    mi.set_variant("scalar_rgb")

    class Grey(mi.BSDF):
        def __init__(self, props: mi.Properties) -> None:
            mi.BSDF.__init__(self, props)

        def to_string(self) -> str:
            return "Grey"

    mi.register_bsdf("grey_of_a_user", Grey)
    inside = '<shape type="sphere"><bsdf type="grey_of_a_user"/></shape>'
    assert "Grey" in str(load(tmp_path, inside).shapes()[0].bsdf())


def test_files_below_the_folder_are_read_by_includes_and_parameters(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a.obj").write_text(TRIANGLE)
    (tmp_path / "part.xml").write_text(
        scene('<default name="mesh" value="b"/>' + named("obj", "meshes/$mesh.obj"))
    )
    inside = '<default name="part" value="part"/><include filename="$part.xml"/>'
    for given in ({"mesh": "a"}, {"mesh": "a", "part": str(tmp_path / "part")}):
        assert len(load(tmp_path, inside, **given).shapes()) == 1
    with pytest.raises(SceneError, match=r"b\.obj"):
        load(tmp_path, inside)


def test_the_caller_may_pass_files_and_folders_elsewhere(tmp_path: Path) -> None:
    folder, other = tmp_path / "scene", tmp_path / "meshes"
    folder.mkdir()
    other.mkdir()
    (other / "a.obj").write_text(TRIANGLE)
    assert load(folder, named("obj", "$file"), file=str(other / "a.obj")).shapes()
    assert load(folder, named("obj", "$meshes/a.obj"), meshes="../meshes").shapes()
    with pytest.raises(SceneError, match="pass its path as a parameter"):
        load(folder, named("obj", "../meshes/a.obj"))


def write_named(path: Path) -> None:
    """Write a valid file of the format of the suffix."""
    kind = path.suffix[1:]
    if kind == "obj":
        path.write_text(TRIANGLE)
    elif kind == "stl":
        path.write_text(
            "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
            "endloop\nendfacet\nendsolid\n"
        )
    elif kind == "ply":
        mi.load_dict({"type": "cube"}).write_ply(str(path))
    elif kind == "serialized":
        mesh = struct.pack("<I", 0x1000) + b"a\0" + struct.pack("<QQ", 3, 1) + VERTICES
        packed = zlib.compress(mesh + struct.pack("<3I", 0, 1, 2))
        path.write_bytes(struct.pack("<HH", 0x041C, 4) + packed + struct.pack("<QI", 0, 1))
    elif kind == "vol":
        mi.VolumeGrid(np.ones((3, 4, 5, 1), np.float32)).write(str(path))
    elif kind == "spd":
        path.write_text("400 0.1\n500 0.1\n")
    else:
        bitmap = mi.Bitmap(np.full((16, 16, 3), 0.5, np.float32))
        if kind in ("png", "jpg"):
            bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True)
        with threads_for_openexr():
            bitmap.write(str(path))


NAMED = ("obj", "ply", "serialized", "stl", "vol", "spd", "exr", "pfm", "hdr", "png", "jpg")
# A truncated OpenEXR image can crash the process (docs/safety.md); truncated JPEG is accepted.
NOT_CUT = ("exr", "jpg")


@pytest.mark.parametrize("kind", NAMED)
def test_damaged_meshes_and_images_raise_one_error_that_names_them(
    tmp_path: Path, kind: str
) -> None:
    mi.set_variant("scalar_rgb")
    path = tmp_path / f"given.{kind}"
    write_named(path)
    load(tmp_path, named(kind, path.name))
    good = path.read_bytes()
    contents = {"empty": b"", "binary": bytes(range(256)) * 4, "missing": None}
    if kind not in NOT_CUT:
        contents["cut"] = good[: len(good) // 2]
    for content in contents.values():
        path.unlink()
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(PolywignerError, match=rf"given\.{kind}") as caught:
            load(tmp_path, named(kind, path.name))
        assert "\n" not in str(caught.value)
        path.write_bytes(good)
