"""CONTRIBUTING.md: its walk, layout, targets and hooks."""

import json
import os
import re
import sys
from pathlib import Path

import polywigner
from polywigner.cli import main

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = Path(polywigner.__file__).resolve().parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def section(title):
    return TEXT.split(f"## {title}", 1)[1].split("\n## ", 1)[0]


def rooms_of_the_walk():
    rows = re.findall(r"^\| `(\w+)(?:/|\.py)` \|", section("A walk"), flags=re.MULTILINE)
    return [str(room) for room in rows]


def test_the_walk_from_file_to_picture_goes_through_its_rooms(tmp_path, unrendered_figures):
    entered: list[str] = []
    inside = f"{PACKAGE}{os.sep}"

    def seen(frame, event, _):
        file = frame.f_code.co_filename
        if event == "call" and file.startswith(inside):
            room = Path(file.removeprefix(inside)).parts[0].removesuffix(".py")
            if not entered or entered[-1] != room:
                entered.append(room)

    # The source is new, because tables of earlier sources are cached.
    aperture = tmp_path / "chevron.geojson"
    ring = [[-10.1, -6.2], [-10.1, -2.3], [0.4, 6.5], [10.6, -2.7], [10.6, -6.8], [0.4, 2.9]]
    geometry = {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
    aperture.write_text(json.dumps(geometry), encoding="utf-8")
    command = ["transform", str(aperture), "--frequency", "94 GHz", "--samples", "9"]
    before = sys.getprofile()
    sys.setprofile(seen)
    try:
        assert main([*command, "--out", str(tmp_path / "out")]) == 0
    finally:
        sys.setprofile(before)
    assert len(rooms_of_the_walk()) >= 10
    later = iter(entered)
    for room in rooms_of_the_walk():
        assert room in later, room  # subpackages up to this row


def test_the_map_has_every_room():
    rooms = {path.stem for path in PACKAGE.iterdir() if not path.name.startswith("_")}
    rooms -= {"py", "references"}  # type marker and data
    assert set(re.findall(r"^\| `(\w+)` \|", section("Layout"), flags=re.MULTILINE)) == rooms


def test_every_target_of_make_is_explained_and_every_one_explained_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([\w-]+):.* ## ", makefile, flags=re.MULTILINE)) - {"help"}
    explained = set(re.findall(r"`make ([\w-]+)`", section("Start")))
    assert targets <= explained | {"help"} and explained <= targets | {"help"}


def test_hooks_run_what_make_runs_and_fetch_nothing(leave_out):
    if not (ROOT / ".pre-commit-config.yaml").exists():
        leave_out("the hooks, which only a clone has")
    hooks = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.findall(r"repo: (\S+)", hooks) == ["local"]
    entries = re.findall(r"entry: \.venv/bin/(.+)", hooks)
    assert len(entries) == hooks.count("- id:") == 4
    for entry in entries:
        assert f"$(BIN)/{entry.removesuffix(' --force-exclude')}" in makefile
