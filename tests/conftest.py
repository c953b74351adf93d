"""Fixtures and markers of all tests.

LLVM is prepared before Dr.Jit is imported. Tests that a machine cannot run are skipped, counted,
and listed at the end of the run.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NoReturn

import pytest
from hypothesis import settings

from polywigner import llvm as _llvm

# Test workers occupy all cores. Further threads of OpenBLAS and Dr.Jit would wait actively and slow
# the workers down. The variable must be set before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# LLVM is prepared before test modules are imported, because Dr.Jit loads its LLVM library only
# once.
STATUS = _llvm.prepare()

# There is no deadline, because a shared machine can delay any example by seconds.
settings.register_profile("without deadline", deadline=None)
settings.load_profile("without deadline")

_MARKERS = {
    "llvm": "compiles kernels with LLVM (the variants llvm_*, the engine 'llvm')",
    "cuda": "compiles kernels for an NVIDIA GPU (the variants cuda_*, the engine 'cuda')",
    "drjit": "imports drjit or mitsuba, be it for scalar variants only",
}
_LEFT_OUT = pytest.StashKey[Counter[str]]()
# Test files with more than 4 s of processor time, in descending order.
_LONGEST = """
shadows_in_scenes laws radar_cubes coincident_edges partial_coherence range_profile channel
shadows default_polarisation element_patterns visibility first_order_fields mitsuba_exact stores
signed_rays thin_panes polarised_scenes power_adds_up shadow_sources rcs_near_fields imaging
cli_propagate exact_fields beams scatterers received_power cli_radar scene_stores cli_receive memory
""".split()  # noqa: SIM905


def pytest_configure(config: pytest.Config) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs ignore it
    config.stash[_LEFT_OUT] = Counter()
    for name, meaning in _MARKERS.items():
        config.addinivalue_line("markers", f"{name}: {meaning}")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort the longest files first, then files by their number of tests."""
    if not hasattr(config, "workerinput"):
        return  # one process, which keeps the given order
    count = Counter(item.path for item in items)
    place = {f"test_{name}.py": number for number, name in enumerate(_LONGEST)}

    def order(item: pytest.Item) -> tuple[int, int, str]:
        name = item.path.name
        return place.get(name, len(place)), -count[item.path], name

    items.sort(key=order)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Exclude modules and tests from later garbage collections, which visit all objects."""
    if hasattr(session.config, "workerinput") and STATUS.usable:
        import drjit

        drjit.set_thread_count(1)
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    for name in _MARKERS:
        if item.get_closest_marker(name):
            _need(name, item.config)


@pytest.fixture(autouse=True)
def _scenes_end_with_their_test() -> Iterator[None]:
    yield
    if scenes := sys.modules.get("mitsuba_scenes"):
        scenes.KEPT.clear()


@pytest.fixture
def llvm(request: pytest.FixtureRequest) -> _llvm.LLVMStatus:
    """Return the status of a usable LLVM library, or skip the test."""
    _need("llvm", request.config)
    return STATUS


@pytest.fixture
def plain() -> None:
    """Set the scalar variant."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")


@pytest.fixture
def few_rays(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trace 64 rays along each path unless the test also uses ``many_rays``.

    Scalar variants trace single rays. A few rays are sufficient if no obstacle blocks part of a
    path.
    """
    import polywigner.mitsuba  # noqa: F401 (chooses the LLVM library)

    if "many_rays" not in request.fixturenames:
        monkeypatch.setattr("polywigner.mitsuba.receive.specular_paths._ray_count", lambda: 64)


@pytest.fixture
def many_rays() -> None:
    """Trace as many rays as the package does, for tests of mean transmissions."""


@pytest.fixture
def few_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sample scattered light in 2 batches instead of 16, for tests without standard errors.

    Scalar variants trace each batch again in Python.
    """
    import polywigner.mitsuba  # noqa: F401 (chooses the LLVM library)

    for module in (
        "radar.scatterers", "receive.received_power", "receive.scattered", "scenes.scene_renders"
    ):  # fmt: skip
        monkeypatch.setattr(f"polywigner.mitsuba.{module}.BATCHES", 2)


@pytest.fixture
def unrendered_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write empty figures, because rendering takes half a second for each figure."""
    from matplotlib.figure import Figure

    def written(_: Figure, path: Path, **__: object) -> None:
        Path(path).write_bytes(b"\x89PNG")

    monkeypatch.setattr(Figure, "savefig", written)


@pytest.fixture
def bad_llvm(request: pytest.FixtureRequest) -> str:
    """Return the path of LLVM 15 or 16, which crashes the process."""
    for path in _llvm.libraries():
        if (_llvm.version_of_name(path) or (0,))[0] in (15, 16):
            return path
    _leave_out("a bad LLVM library (15 or 16), to see it refused.", request.config)


@pytest.fixture(scope="session")
def leave_out(pytestconfig: pytest.Config) -> Callable[[str], NoReturn]:
    """Return a function that skips the test with a reason."""
    return partial(_leave_out, config=pytestconfig)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    left_out = terminalreporter.config.stash[_LEFT_OUT]
    for reason, count in sorted(left_out.items()):
        tests = "1 test needs" if count == 1 else f"{count} tests need"
        terminalreporter.write_line(f"left out: {tests} {reason}")


def _need(what: str, config: pytest.Config) -> None:
    reason = _lacking(what)
    if reason is not None:
        _leave_out(reason, config)


def _leave_out(reason: str, config: pytest.Config) -> NoReturn:
    config.stash[_LEFT_OUT][reason] += 1
    pytest.skip(f"needs {reason.split('. ')[0]}")  # the summary contains the complete reason


def _lacking(what: str) -> str | None:
    """Return why this machine cannot run tests with a marker, or None."""
    if not STATUS.drjit_imports:
        return f"a Dr.Jit that can be imported. {STATUS.problem} {STATUS.remedy}"
    if what == "llvm" and not STATUS.usable:
        return f"an LLVM library. {STATUS.problem} {STATUS.remedy}"
    if what == "cuda" and not _has_gpu():
        return "an NVIDIA GPU and its driver."
    return None


def _has_gpu() -> bool:
    import drjit

    return bool(drjit.has_backend(drjit.JitBackend.CUDA))


@pytest.fixture(scope="module", autouse=True)
def _scenes_are_freed() -> Iterator[None]:
    """Free the scenes of a test module, because every kernel contains all emitters in memory."""
    yield
    if "mitsuba" in sys.modules:
        gc.collect()
