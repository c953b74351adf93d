"""Invalid input of all commands: exit code 2, one line on stderr, and no files."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import cli_scenes
from cli_scenes import receiver, source
from polywigner.cli import main

Captured = pytest.CaptureFixture[str]

CAMERA = """<sensor type="orthographic">
    <film type="hdrfilm">
        <integer name="width" value="4"/><integer name="height" value="4"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
</sensor>"""
FLOOR = cli_scenes.rectangle('<translate z="2"/>')
WHITE = '<emitter type="constant"><rgb name="radiance" value="3e38"/></emitter>'


def scene(*parts: str) -> str:
    return cli_scenes.scene('<integrator type="path"/>', *parts)


def lit(old: str, new: str) -> str:
    """Return a scene with a modified Wigner source."""
    assert old in source()
    return scene(CAMERA, source().replace(old, new), FLOOR)


def with_parameter(text: str) -> str:
    return scene(CAMERA, source(text), FLOOR)


FILES: dict[str, str | bytes] = {
    "square.wkt": "POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))",
    "empty.csv": "",
    "cut.geojson": '{"type": "Polygon", "coord',
    "words.csv": "x,y\n0,0\n1,zero\n1,1\n",
    "nan.csv": "0,0\nnan,0\n1,1\n",
    "bow.csv": "0,0\n2,2\n2,0\n0,2\n",
    "none.dxf": "0\nSECTION\n2\nENTITIES\n0\nENDSEC\n0\nEOF\n",
    "box.stl": "solid box\nendsolid box\n",
    "kind.toml": "kind = 'apertur'",
    "cut.toml": "kind = ",
    "slits.toml": "kind = 'slits'\nintervals = [[0, 1]]",
    "square.toml": "kind = 'aperture'\nshape = {name = 'square', a = 1}",
    "layered.svg": '<svg><g id="board"><rect width="9" height="9"/></g>'
    '<g id="pad"><rect x="1" y="1" width="2" height="1"/></g>'
    '<g id="feed"><rect x="2" y="1" width="3" height="1"/></g></svg>',
    "lit.xml": scene(CAMERA, source(), FLOOR),
    "link.xml": scene(receiver(), source(), FLOOR),
    "two_colours.xml": scene(receiver(), source().replace("94", "77"), FLOOR),
    "empty.xml": "",
    "dark.xml": scene(CAMERA, FLOOR),
    "absent_file.xml": lit("square.wkt", "absent.wkt"),
    "scaled.xml": with_parameter('<transform name="to_world"><scale value="2"/></transform>'),
    "blind.xml": scene(source(), FLOOR),
    "no_pixels.xml": scene(CAMERA.replace('"width" value="4"', '"width" value="0"'), source()),
    "bright.xml": scene(CAMERA, WHITE, source(), FLOOR),
}  # fmt: skip

RADAR = Path(__file__).parents[1] / "examples" / "radar_77ghz" / "radar.xml"
WAVEFORM = "--waveform '76.85 GHz + 300 MHz, 128 samples at 5 MHz, 8 chirps every 60 us'"
LINE = '--line "0 mm, 0 mm, 20 mm to 0 mm, 0 mm, 90 mm"'
BOX = '--box "-20 mm to 20 mm, -15 mm to 15 mm, 30 mm to 60 mm"'
SMALL = f'{BOX} --shape "6 x 5 x 4" --engine numpy'

# Cases by command. Each line contains the options, "=>" and parts of the message.
BAD: dict[str, str] = {
    "transform": """
        absent.geojson => absent.geojson
        folder.wkt => folder.wkt
        cut.geojson => cut.geojson
        nan.csv => two numbers | line 2
        bow.csv => cross | 1
        box.stl => box.stl | read_polyhedron
        kind.toml => kind.toml | kind
        cut.toml => cut.toml | TOML
        slits.toml => an aperture | slits
        square.toml --unit mm => --unit does not apply to a source file
        layered.svg => (--layer) | (--union)
        "" => file
        {long} => file
    """,
    "transform square.wkt": """
        --out "" => --out must be a file name
        --unit parsec => unit | parsec | mm
        --unit "-1 mm" => unit | -1 mm
        --tolerance coarse => length | coarse
        --taper gauss => taper: expected a taper | gauss
        --array "12 by 16" => array: expected an array | 12 by 16
        --array "2 x 2, 12 mm" --window boxcar => window: expected window | boxcar
        --window hamming => window: expected an array
        --steering "20 deg" => steering: expected a frequency or a wavelength
        --steering 20 --frequency "94 GHz" => steering: expected a direction | 90
        --focus "0, 0, 1" --frequency "94 GHz" => focus: expected an array
        --frequency "94 GHy" => 94 GHy | GHz
        --frequency "0 GHz" => above zero | 0 GHz
        --wavelength "0 mm" => above zero | 0 mm
        --frequency "94 GHz" --wavelength "3 mm" => both
        --x "1 mm" => two lengths | 1 mm
        --x "1 mm,2 furlong" => furlong
        --x 5,0 => inside the automean | unit
        --xi "20 mm,0 mm" => overlap
        --samples 1 => --samples | 2
        --db-floor 0 => --db-floor | -1
        --db-floor -1e308 => --db-floor | -300
        second.wkt => second.wkt
        --out out/{long} => too long
        --out square.wkt/a => square.wkt
        --out /proc/polywigner => cannot write
    """,
    f'propagate square.wkt --frequency "94 GHz" {LINE}': """
        --arc "50 mm" => --line and --arc
        --samples many => --samples | many
        --samples 1 => --samples | at least 2 | '1'
        --samples "3 x 3" => --samples | 3 x 3
        --method fdtd => method | fdtd | kirchhoff
        --method "kirchhoff 3" => only the method wigner
        --method "wigner 3" => obliquity | 3 | paper
        --obliquity lambert => obliquity | lambert
        --against kirchhoff => --against | kirchhoff
        --amplitude => phase | wigner
        --accuracy 1e-15 => tolerance | 1e-13
        --db-floor 3 => --db-floor | -1
        --taper gauss => taper | gauss
        --wavelength "3 mm" => both
        --obstacle absent.stl => absent.stl
        --obstacle empty.csv => --obstacle
        --obstacle second.wkt => second.wkt
        --obstacle "square.wkt at 1 mm, 2 mm" => --obstacle | a point
        --obstacle "square.wkt at 1 mm, 2 mm, 3 furlong" => --obstacle | furlong
        --obstacle "square.wkt at 0 mm, 0 mm, 9 mm towards 3 deg" => --obstacle | a direction
        --obstacle "square.wkt at 0 mm, 0 mm, 9 mm" --method wigner => obstacles | 'wigner'
        --obstacle "square.wkt at 0 mm, 0 mm, 9 mm" --bandwidth "1 GHz" => cannot be combined
        --obstacle "square.wkt at 0 mm, 0 mm, 9 mm" --obstacle-unit ell => ell
    """,
    'propagate square.wkt --frequency "94 GHz"': """
         => --line | --hemisphere | got none
        --line "0 mm, 0 mm, 20 mm" => --line | two points
        --line "0 mm, 20 mm to 0 mm, 90 mm" => a point | 0 mm, 20 mm
        --line "0, 0, 1 to 0, 0, 1" => two different points
        --line "0 mm, 0 mm, -2 mm to 0 mm, 0 mm, 9 mm" => z > 0
        --line "{many}" => two points
        --plane "-3 mm to 3 mm, 0 mm, 9 mm" => --plane | two ranges
        --plane "3 mm to -3 mm, -3 mm to 3 mm, 9 mm" => ascending
        --plane "-3 mm to 3 mm, 0 mm, 2 mm to 9 mm" --samples "99999 x 99999" => polywigner volume
        --arc far => --arc | length | far
        --arc "50 mm, 0 deg, 90 deg" => --arc | between 0 and 90 deg
        --hemisphere "0 mm" => --hemisphere | above zero
    """,
    f"propagate square.wkt {LINE}": "=> --frequency or --wavelength",
    'volume square.wkt --frequency "94 GHz"': f"""
        --box "-2 mm to 2 mm, 0 mm, 3 mm to 6 mm" => --box | three ranges
        --box "-2 mm to 2 mm, 3 mm to 6 mm" => --box | three ranges
        --box "0 mm to 2 mm, 0 mm to 2 mm, -3 mm to 6 mm" => z > 0
        {BOX} --shape "6 x 5" => --shape | 6 x 5
        {BOX} --shape "1 x 4 x 4" => --shape | at least 2
        {BOX} --chunks "0 x 3 x 3" => --chunks
        {SMALL} --threads 0 => threads
        {SMALL} --scheduler nowhere => scheduler | nowhere
        {SMALL} --surfaces low => --surfaces | low
        {SMALL} --surfaces "-6, -50" => floor | -50
        {SMALL} --projection sum => projection | maximum
        {SMALL} --method fdtd => method | fdtd
    """,
    "rcs square.wkt": """
        => --frequency
        --frequency "3 GHz" --step "0 deg" => --step
        --frequency "3 GHz" --step "0.01 deg" => at least
        --frequency "3 GHz" --step "31 deg" => up to 30 deg
        --frequency "3 GHz" --format zip => --format
        --frequency "3 GHz" --step "30 deg" --polarisation rr => polarisation
        --frequency "3 GHz" --bounces 4 => bounces
        --frequency "3 GHz" --cut-step "0 deg" => at least 0.001 deg
        --frequency "3 GHz" --smooth wide => angle
    """,
    'pattern square.wkt --frequency "94 GHz"': """
        --step "0 deg" => --step
        --step "16 deg" => up to 15 deg
        --step "0.01 deg" => at least
        --power "10 dB" => power
        --format zip => --format
        --polarisation up => 45 deg
        --method kirchhoff => huygens
        --method electric --obliquity kirchhoff => --obliquity or --method
    """,
    "render": """
        absent.xml => absent.xml
        "" => file
        {long} => file
        words.csv => XML file of a scene | polywigner transform
        lit.xml --out square.wkt/a => square.wkt
    """,
    "render --variant scalar_rgb": """
        empty.xml => empty.xml
        dark.xml => no <shape type="wigner">
        absent_file.xml => absent.wkt
        scaled.xml => to_world | scale
        blind.xml => no <sensor> | add
        no_pixels.xml => 0 x 4 | one pixel
        bright.xml => values of the image | finite
    """,
    "render lit.xml": """
        --spp 0 => --spp | 1
        --spp 99999999999999999999 => --spp
        --seed -1 => --seed | 0
        --variant llvm_mono_ad => variant | llvm_mono_ad | scalar_rgb
        --integrator pathfinder => --integrator | pathfinder | volpath
        --db-floor 40 => --db-floor | -1
    """,
    "receive --variant scalar_rgb": """
        link.xml --spp 0 => --spp
        link.xml --seed -1 => --seed
        link.xml --bandwidth "1 GHx" => frequency
        link.xml --temperature "-3 K" => temperature
        link.xml --noise-figure "3 m" => noise figure
        link.xml --define distance => NAME=VALUE
        link.xml --frequencies fast => frequency
        link.xml --frequencies "93 GHz to 92 GHz, 3" => two ascending frequencies
        link.xml --frequencies "93 GHz to 95 GHz" => two ascending frequencies
        link.xml --frequencies "93 GHz to 95 GHz, 1000000" => from 2 to 65536
        link.xml --polarisation x => polarisation= requires coherent=True
        link.xml --coherent --polarisation z => polarisation
        link.xml --reflections 9 => reflections
        link.xml --db-floor 3 => floor
        link.xml --variant no_such => variant
        lit.xml => wigner_receiver
        two_colours.xml => wavelengths of emitter 'tx'
        absent.xml => not a file
        square.wkt => polywigner transform
    """,
    f"radar {RADAR}": f"""
        --waveform "77 GHz" => such as
        {WAVEFORM} --velocity "car 3" => VX, VY, VZ
        {WAVEFORM} --velocity "moon = 1, 0, 0" --points 9 => moon
        {WAVEFORM} --window none --points 9 => window
        {WAVEFORM} --velocity "car = 1, 0, 0" --velocity "car = 1, 0, 0" => got several
        {WAVEFORM} --velocity "car = 4e8, 0, 0" => speed below
    """,
    "radar": f"absent.xml {WAVEFORM} => absent.xml",
    "": """
        reder => reder
        render => Missing argument
        render scene.xml --ssp 3 => --ssp
        render scene.xml --spp many => --spp
    """,
}
DRJIT = ("render --variant", "render lit.xml", "receive", "radar")


def cases() -> Iterator[object]:
    for command, lines in BAD.items():
        marks = [pytest.mark.drjit] if command.startswith(DRJIT) else []
        for line in filter(str.strip, lines.splitlines()):
            options, _, words = line.partition("=>")
            whole = f"{command} {options.strip()}".strip()
            yield pytest.param(
                whole, words.strip(), marks=marks, id=whole.replace(f"{RADAR}", "radar.xml")[:70]
            )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.wkt").mkdir()
    return tmp_path


def refusal(command: list[str], folder: Path, captured: Captured) -> str:
    """Return the error line of a command; assert exit code 2 and unchanged files."""
    for name, content in FILES.items():
        if any(name in word for word in command) or name in ("square.wkt", "bow.csv"):
            data = content if isinstance(content, bytes) else content.encode()
            (folder / name).write_bytes(data)
    before = sorted(folder.rglob("*"))
    captured.readouterr()
    code = main(command)
    stdout, stderr = captured.readouterr()
    errors = [line for line in stderr.splitlines() if "warning" not in line]
    assert code == 2, stderr
    assert stdout == "" and "Traceback" not in stderr and "encountered" not in stderr
    assert len(errors) == 1 and errors[0].startswith("polywigner: error: "), stderr
    assert sorted(folder.rglob("*")) == before
    return errors[0]


@pytest.mark.parametrize(("command", "words"), list(cases()))
def test_what_cannot_be_used_is_refused_in_one_line_before_anything_is_written(
    command: str, words: str, folder: Path, capfd: Captured
) -> None:
    text = command.format(long="a" * 300, many="0 mm, " * 1000)
    given = shlex.split(text)
    if "--out" not in given:
        given += ["--out", "out/new/"]
    line = refusal(given, folder, capfd)
    assert len(line) < 9000
    for word in words.split(" | "):
        assert word.lower() in line.lower()


FIELD = ["propagate", "square.wkt", "--frequency", "94 GHz", *shlex.split(LINE)]


@pytest.mark.parametrize(
    ("library", "extra", "command"),
    [
        ("ezdxf", "formats", ["transform", "none.dxf"]),
        ("h5netcdf", "datasets", FIELD),
        ("zarr", "datasets", ["volume", *FIELD[1:4], *shlex.split(SMALL)]),
    ],
    ids=str,
)
def test_a_library_that_is_missing_is_named_with_its_extra_before_the_work(
    library: str, extra: str, command: list[str], folder: Path, capfd: Captured,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setitem(sys.modules, library, None)
    line = refusal([*command, "--out", "out/new/"], folder, capfd)
    assert library in line and f'pip install "polywigner[{extra}]"' in line
