"""All examples, and all Python blocks in the README and in docs/."""

import json
import os
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import polywigner as pw
from polywigner.cli import main

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "examples"
SCENES = sorted(EXAMPLES.glob("*/scene.xml"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES += sorted((ROOT / "docs").glob("[!_]*/*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def by_folder(path):
    return path.parent.name


@pytest.mark.parametrize(
    "page",
    [PAGES[0], *(pytest.param(page, marks=pytest.mark.slow) for page in PAGES[1:])],
    ids=lambda page: page.stem,
)
def test_the_python_of_a_page_runs(page, tmp_path, imported):
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    if any("mitsuba" in block for block in blocks):
        pytest.importorskip("mitsuba")
    script = tmp_path / "page.py"
    script.write_text("\n".join(blocks), encoding="utf-8")
    if sys.platform == "win32":
        run_script(script, tmp_path)
        return
    assert imported.stdin is not None and imported.stdout is not None
    print(script, file=imported.stdin, flush=True)
    done = imported.stdout.readline()
    assert done == "0\n", (tmp_path / "error").read_text(encoding="utf-8")
    if page == PAGES[0]:
        assert (tmp_path / "wigner.png").read_bytes().startswith(b"\x89PNG")


# A process that has imported the libraries of all pages forks a child for each script. Only the
# children import Dr.Jit, because the threads of Dr.Jit do not survive a fork.
SPLITTING = """
import os, runpy, signal, sys, traceback
import matplotlib.pyplot, numpy, shapely, polywigner
from polywigner import figures

for line in sys.stdin:
    script = line.strip()
    child = os.fork()
    if not child:
        os.chdir(os.path.dirname(script))
        for stream in (1, 2):
            os.dup2(os.open("error", os.O_WRONLY | os.O_CREAT | os.O_APPEND), stream)
        signal.alarm(300)
        code = 1
        try:
            sys.argv = [script]
            runpy.run_path(script, run_name="__main__")
            code = 0
        except BaseException:
            traceback.print_exc()
        sys.stderr.flush()
        os._exit(code)
    print(os.waitpid(child, 0)[1], flush=True)
"""


@pytest.fixture(scope="module")
def imported():
    environment = {**os.environ, "MPLBACKEND": "agg"}
    command = [sys.executable, "-c", SPLITTING]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True) as process:
        yield process
        assert process.stdin is not None
        process.stdin.close()


def run_script(script, folder, *arguments):
    """Run a script, and return its output."""
    environment = {**os.environ, "MPLBACKEND": "agg"}
    run = subprocess.run(
        [sys.executable, str(script), *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_the_readme_saves_its_first_picture_in_five_lines():
    block = BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8"))[0]
    assert len([line for line in block.splitlines() if line.strip()]) == 5
    assert "wigner.png" in block


@pytest.mark.parametrize("scene", SCENES, ids=by_folder)
def test_an_example_explains_itself_and_brings_its_files(scene):
    assert (scene.parent / "README.md").is_file()
    root = ET.parse(scene).getroot()
    shapes = root.findall("shape[@type='wigner']")
    assert shapes
    for shape in shapes:
        given = {child.get("name"): child.get("value") for child in shape.findall("string")}
        if "source" in given:
            source = pw.read_source(scene.parent / given["source"])
        else:
            source = pw.read_aperture(scene.parent / given["aperture"], given.get("unit", "mm"))
        energy = pw.lag_marginal(source, (0.0, 0.0)).real
        assert 1e-6 < energy < 1e-3  # between 1 mm^2 and 10 cm^2
    for mesh in root.findall("shape[@type='obj']/string[@name='filename']"):
        assert (scene.parent / mesh.get("value", "")).is_file()


@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.parametrize("name", ["focused_array", "te10_horn"])
def test_an_example_that_is_not_in_the_demo_renders(name, tmp_path):
    scene = EXAMPLES / name / "scene.xml"
    assert main(["render", str(scene), "--spp", "4", "--out", str(tmp_path / "a")]) == 0
    record = json.loads((tmp_path / "a.json").read_text())
    assert record["figure"]["zero_db"] > 0


def test_the_command_of_the_volume_example_is_that_of_its_picture():
    import shlex

    text = (EXAMPLES / "two_chevrons_volume" / "README.md").read_text(encoding="utf-8")
    block = re.search(r"```sh\n(.*?)```", text, re.DOTALL)
    assert block is not None
    given = set(shlex.split(block[1].replace("\\\n", " "))) - {"--out", "two_chevrons_volume"}
    made = runpy.run_path(str(ROOT / "docs" / "make_images.py"))["COMMANDS"]["two_chevrons_volume"]
    relative = [
        str(Path(word).relative_to(ROOT)) if word.startswith("/") else word for word in made
    ]
    assert given == {"polywigner", *relative}


def test_the_meshes_of_the_street_are_what_their_script_writes(tmp_path, monkeypatch):
    street = EXAMPLES / "street_77ghz"
    script = tmp_path / "make_meshes.py"
    script.write_text((street / "make_meshes.py").read_text())
    run_script(script, tmp_path)
    committed = {path.name: path.read_text() for path in (street / "meshes").glob("*.obj")}
    written = {path.name: path.read_text() for path in (tmp_path / "meshes").glob("*.obj")}
    assert committed == written
    assert len(committed) == 4


LESSONS = sorted((EXAMPLES / "lessons").glob("lesson_*.py"))


@pytest.mark.parametrize("lesson", LESSONS, ids=lambda path: path.stem[:10])
def test_a_lesson_is_listed_asserts_what_it_says_and_ends_with_exercises(lesson):
    """`make docs` runs the lessons, and fails if an assertion fails."""
    text = lesson.read_text(encoding="utf-8")
    assert f"(../examples/lessons/{lesson.name})" in (ROOT / "docs" / "lessons.md").read_text()
    assert text.count("\nassert ") + text.count("    assert ") >= 4
    assert "# Exercises\n" in text.split("# %%")[-1]
