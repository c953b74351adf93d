"""The comparison behind ``make bench``: contenders agree, missing peers are said to be missing."""

from __future__ import annotations

import json
import platform
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw

sys.path.append(str(Path(__file__).parents[1]))

from benchmarks import fdtd_screens, machine, plots, report, timing
from benchmarks.lines import Figure, Line
from benchmarks.peers import cpp, jax_kernel, libformfactor
from benchmarks.questions import NAMES, module_of, otf, polyhedra, tasks, wigner

pytestmark = pytest.mark.slow  # kernels of peers are compiled

TINY = timing.Effort(rounds=2, seconds=1e-4, most=1 << 8, checked=3, quick=True)
# Of the area. Float32 has 6e-8, times some tens of turns of phase; float64 likewise.
SINGLE, DOUBLE = 5e-6, 1e-13
# Of the volume: libformfactor's series and closed forms meet there.
PEER_OF_BODIES = 1e-10
# Of the largest field: a lattice of ten cells a wavelength, (2 pi/10)^2/4.
LATTICE = 0.1


def a_line(**changes: Any) -> Line:
    labels: dict[str, Any] = {"question": "wigner", "case": "square", "precision": "single"}
    labels |= {"threads": 1, "unit": "M samples/s", "peer": "C++"}
    figures = {"ours": Figure(4.0, 3.0, 1e-7), "theirs": Figure(2.0, 2.0, 1e-7)}
    return Line(**(labels | figures | {"ratio": 2.0, "ratio_median": 1.5} | changes))


@pytest.mark.skipif(cpp.compiler() is None, reason="no C++ compiler here")
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("case", ["chevron", "18 hexagons"])  # unrolled; loops over tables
def test_the_kernel_in_cpp_gives_the_wigner_function(case: str, precision: str) -> None:
    source = wigner.SOURCES[case]()
    x, nu = wigner.points(source, 203)  # no whole number of vectors
    found = wigner.in_cpp(source, precision, 1)(x, nu)()
    expected = pw.wigner(source, x, nu, engine="numpy")
    error = np.abs(found - expected).max() / source.area
    assert error < (SINGLE if precision == "single" else DOUBLE)


@pytest.mark.skipif(cpp.compiler() is None, reason="no C++ compiler here")
def test_threads_of_the_kernel_in_cpp_share_the_samples() -> None:
    source = wigner.SOURCES["square"]()
    x, nu = wigner.points(source, 1001)
    one, two = (wigner.in_cpp(source, "double", threads)(x, nu)() for threads in (1, 2))
    assert np.array_equal(one, two)


@pytest.mark.parametrize("command", ["no-such-compiler", "false", "'"])
def test_a_compiler_that_does_not_work_is_none(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CXX", command)
    cpp.compiler.cache_clear()
    try:
        assert cpp.compiler() is None and cpp.compiler_version() is None
        peers = wigner._peers(wigner.SOURCES["square"](), "single", 1)
        assert "CXX" in str(peers[wigner.CPP]) and callable(peers[wigner.SHAPELY])
    finally:
        cpp.compiler.cache_clear()


@pytest.mark.skipif(not jax_kernel.available(), reason="JAX is not installed")
def test_the_kernel_traced_by_jax_gives_the_wigner_function() -> None:
    source = wigner.SOURCES["chevron"]()
    x, nu = wigner.points(source, 1000)  # more than NumPy takes as they come
    found = np.asarray(wigner.in_jax(source, "double")(x, nu)())
    expected = pw.wigner(source, x, nu, engine="numpy")
    assert np.abs(found - expected).max() < DOUBLE * source.area


@pytest.fixture
def own_threads() -> Iterator[None]:
    """What is measured here in the tests' own process leaves it as many threads as it had."""
    drjit = pytest.importorskip("drjit")
    before = drjit.thread_count()
    yield
    drjit.set_thread_count(before)


@pytest.mark.usefixtures("own_threads")
@pytest.mark.parametrize("case", ["square", "two chevrons"])
def test_all_contenders_for_w_meet_the_exact_values(
    case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jax_kernel, "available", lambda: False)
    monkeypatch.setattr(cpp, "compiler", lambda: None)
    lines = wigner.measure(case, 1, TINY)
    assert {line.precision for line in lines} == {"single", "double"}
    for line in lines:
        for figure in filter(None, (line.ours, line.theirs)):
            assert figure.error is not None
            assert figure.error < (SINGLE if line.precision == "single" else DOUBLE)
            assert 0 < figure.median <= figure.best
    missing = {line.peer: line.note for line in lines if line.theirs is None}
    assert "pip install jax" in missing["JAX"] and "compiler" in missing["C++"]


def test_the_array_of_a_thousand_elements_is_checked_by_its_pairs() -> None:
    source = wigner.SOURCES["1024 elements"]()
    x, nu = wigner.checked_points(source, 3)
    found = pw.wigner(source, x, nu, engine="numpy")
    exact = wigner.exact_values(source, x, nu)
    assert exact is not None
    assert np.abs(found - exact).max() < DOUBLE * len(source)


def test_the_otf_is_measured_against_overlaps_of_polygons() -> None:
    for line in otf.measure("square", 1, TINY):
        assert line.ours is not None and line.theirs is not None
        assert line.ours.error is not None and line.theirs.error is not None
        assert max(line.ours.error, line.theirs.error) < DOUBLE


def test_bodies_have_the_volumes_that_books_give() -> None:
    root = np.sqrt(2)
    volumes = {
        "square pyramid": 4 / 3, "cube": 1.0, "tetrahedron": root / 12, "octahedron": root / 3,
        "hexagonal prism": 0.7 * 1.5 * np.sqrt(3), "truncated cube": 1 - 8 * 0.25**3 / 6,
    }  # fmt: skip
    found = {name: make().source.volume for name, make in polyhedra.BODIES.items()}
    assert found == pytest.approx(volumes, rel=DOUBLE)


def test_f_of_a_body_is_measured_against_exact_values(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(libformfactor, "available", lambda: False)
    lines = polyhedra.measure("tetrahedron", 1, TINY)
    assert all(line.ours and line.ours.error is not None for line in lines)
    assert max(line.ours.error for line in lines if line.ours) < DOUBLE  # type: ignore[type-var]
    missing = [line.note for line in lines if line.theirs is None]
    assert missing and all("pip install bornagain" in note for note in missing)


@pytest.mark.skipif(not libformfactor.available(), reason="BornAgain is not installed")
@pytest.mark.parametrize("case", polyhedra.CASES)
def test_libformfactor_has_the_same_bodies(case: str) -> None:
    body = polyhedra.BODIES[case]()
    source, shape = body.source, libformfactor.body(body.name, *body.sizes)
    nu = np.random.default_rng(0).normal(size=(50, 3))
    expected = pw.fourier(source, nu, engine="numpy")
    found = [libformfactor.from_python(shape, nu)]
    if cpp.compiler() is not None:
        found.append(libformfactor.from_cpp(shape, polyhedra.centre(source))(nu))
    assert np.abs(np.array(found) - expected).max() < PEER_OF_BODIES * source.volume


@pytest.mark.parametrize("screen", ["soft", "hard", "given field", "given slope"])
def test_the_field_behind_a_screen_follows_from_that_in_the_hole(
    screen: fdtd_screens.Screen,
) -> None:
    """By Rayleigh-Sommerfeld I from u, where that is 0 on the screen; else II from du/dz."""
    field = fdtd_screens.field_behind(screen, 10, width=1.0, reach=1.5)
    k, spacing, u = 2 * np.pi, field.spacing, field.values
    x, z, found = field.plane(1.4)
    whole = np.abs(np.arange(1 - len(x), len(x)))  # nodes on both sides of the axis
    places = spacing * np.arange(1 - len(x), len(x))
    plane, next_plane = (u[:, :, n][np.ix_(whole, whole)] for n in (0, 1))
    # what flows through the half cells between the plane and the screen
    sides = sum(np.roll(plane, n, axis) for n in (1, -1) for axis in (0, 1)) - 4 * plane
    slope = (next_plane - plane + (sides + (k * spacing) ** 2 * plane) / 2) / spacing
    hole = np.maximum(*np.meshgrid(np.abs(places), np.abs(places))) < 0.5 + spacing
    expected = []
    for point in x:
        r = np.hypot(np.hypot(places[:, None] - point, places), z)
        wave = spacing**2 / k * np.exp(1j * k * r) / r
        kernel = plane * z / r * (1 / r - 1j * k) if screen in ("soft", "given field") else -slope
        expected.append((hole * kernel * wave).sum())
    assert np.abs(found[:, 0] - expected).max() < LATTICE * np.abs(expected).max()


def test_a_slow_contender_sits_out_after_a_few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "LONG", 0.0)
    times = timing.in_turns({"one": lambda: None}, rounds=9)
    assert len(times["one"]) == timing.FEW_ROUNDS


def test_a_contender_gets_as_many_samples_as_take_the_wanted_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [0.0]
    monkeypatch.setattr(timing, "clock_for", lambda threads: lambda: now[0])

    def make(size: int) -> timing.Action:
        def action() -> None:
            now[0] += 1e-4 + 1e-5 * size

        return action

    effort = timing.Effort(rounds=1, seconds=4e-3, most=1 << 14, checked=1)
    _, count = timing.fitting(make, effort)
    assert 1 << 8 <= count <= 1 << 9  # 400, if nothing else


def test_what_a_call_costs_by_itself_becomes_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A call may take the wanted time for the few first samples, and hardly more for many."""
    now = [0.0]
    monkeypatch.setattr(timing, "clock_for", lambda threads: lambda: now[0])

    def make(size: int) -> timing.Action:
        def action() -> None:
            now[0] += 1e-2 + 1e-6 * size

        return action

    effort = timing.Effort(rounds=1, seconds=4e-3, most=1 << 20, checked=1)
    _, count = timing.fitting(make, effort)
    assert 1e-6 * count > 1e-2


def test_lines_survive_json_and_another_schema_is_refused() -> None:
    lines = [a_line(target=0.85), a_line(theirs=None, ratio=None, ratio_median=None, note="gone")]
    facts = {"date": "2026-01-01", "machine": {}, "libraries": []}
    found = json.loads(json.dumps(report.as_json(lines, facts)))
    assert report.from_json(found) == lines
    assert [line["reached"] for line in found["lines"]] == [True, None]
    with pytest.raises(ValueError, match="expected schema"):
        report.from_json(found | {"schema": 0})


@pytest.mark.parametrize(
    ("median", "reached"), [(0.9, True), (0.8, False)], ids=["both reach it", "the median not"]
)
def test_a_target_is_reached_by_best_and_median(median: float, reached: bool) -> None:
    assert a_line(ratio=1.0, ratio_median=median, target=0.85).reached is reached


@pytest.mark.parametrize(("enough", "reached"), [(1e-3, True), (1e9, False)])
def test_a_rate_of_our_own_may_do_as_well_as_the_ratio(enough: float, reached: bool) -> None:
    line = a_line(ratio=1.0, ratio_median=1.0, target=10.0, enough=enough)
    assert line.reached is reached
    assert f"asked: 10 or {enough:,.3g} M samples/s" in report.table([line])


def test_a_report_has_a_row_for_each_line_and_pictures(tmp_path: Path) -> None:
    absent = a_line(theirs=None, ratio=None, ratio_median=None, note="no C++ compiler found")
    lines = [a_line(target=3.0), absent, a_line(question="memory", unit="MiB")]
    facts = {"date": "2026-01-01", "machine": machine.facts(), "libraries": machine.LIBRARIES}
    paths = report.written(tmp_path, lines, facts) + plots.drawn(tmp_path, lines)
    assert {path.name for path in paths} == {
        "comparison.json", "comparison.md", "rates.png", "ratios.png",
    }  # fmt: skip
    text = (tmp_path / "comparison.md").read_text()
    assert text.count("| C++ |") == 3 and "| / C++ |" in text and "no C++ compiler found" in text
    assert "missed" in text and "0 of 1 targets" in text and "quick run" not in text
    assert "A quick run" in report.markdown(lines, facts | {"quick": True})
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(p.name for p in paths)


def test_facts_do_not_tell_whose_machine_it_is() -> None:
    facts = machine.facts()
    assert facts["cores"] and facts["processor"]
    told = json.dumps(facts)
    assert str(Path.home()) not in told or str(Path.home()) == "/"
    assert len(platform.node()) < 4 or platform.node() not in told


def test_a_quick_run_asks_each_question_once() -> None:
    assert [task.question for task in tasks(NAMES, cores=2, quick=True)] == list(NAMES)
    whole = tasks(NAMES, cores=2)
    assert {(t.question, t.case) for t in whole} == {
        (name, case) for name in NAMES for case in module_of(name).CASES
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--case", "dodecagon"], "'dodecagon'; see --list"),
        (["--out", "{file}/results"], "folder to write into, got .*results"),
        (["--only", "speed"], "invalid choice: 'speed'"),
    ],
)
def test_what_cannot_be_measured_or_written_is_told_before_anything_is_measured(
    options: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from benchmarks import __main__ as bench

    (tmp_path / "file").write_text("")
    monkeypatch.setattr(bench, "_measured", lambda *of: pytest.fail("it measured"))
    monkeypatch.setattr(bench, "RESULTS", tmp_path)
    with pytest.raises(SystemExit) as ended:
        bench.main([option.replace("{file}", str(tmp_path / "file")) for option in options])
    assert ended.value.code == 2
    assert re.search(message, capsys.readouterr().err)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
