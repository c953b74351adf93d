#!/usr/bin/env python3
"""Runs that are killed again and again must end as if nothing had happened.

    python tools/kill_runs.py [--kills 50] [--seed 0] [--kinds volume,receive,render]

The kinds are a volume, and the commands `receive --resumable` and `render --resumable`. Starts a
small run, ends it by SIGKILL at a random moment, flips a byte of a finished part in every second
case, and starts it again until it is complete; then the next one, until there have been that many
kills. What is complete is compared with an undisturbed run: a volume file by file, a picture pixel
by pixel, received powers up to rounding. The exit status is 1 where one differs, a run is refused
or fails, a finished part that nobody damaged is lost, or anything is left beside the results.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

KILLS_OF_A_RUN = 6
"""After so many a run is completed and compared, and the next one begun."""

LAST = 1e-5
"""Of received powers: threads of the renderer add up in any order."""

VOLUME = """
import sys
import dask, xarray, zarr  # now, so that most kills meet a run at work
import polywigner as pw

box = [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
print("begins", flush=True)
pw.volume(
    pw.shapes.chevron(20e-3, 12e-3, 4e-3), box, (24, 24, 24), 3.2e-3, method="kirchhoff",
    engine="numpy", chunks=6, threads=2, out=sys.argv[1],
)
"""

COMMAND = """
import sys
import dask, xarray, zarr, matplotlib.figure
import polywigner.mitsuba
from polywigner.cli import main

print("begins", flush=True)
kind, out = sys.argv[1:]
words = [kind, out.rpartition("/")[0] + "/../scene.xml", "--resumable", "--threads", "1"]
sys.exit(main([*words, "--variant", "scalar_rgb", "--out", out]))
"""

SCENE = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="{sensor}">
        <string name="aperture" value="square.wkt"/>
        <string name="frequency" value="94 GHz"/>
        <transform name="to_world"><lookat origin="0.05, 0, 0" target="0.05, 0, 1" up="0, 1, 0"/>
        </transform>
        <sampler type="independent"><integer name="sample_count" value="{samples}"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{width}"/><integer name="height" value="{height}"/>
            <string name="pixel_format" value="luminance"/><rfilter type="box"/>
        </film>
    </sensor>
    <shape type="wigner" id="tx">
        <string name="aperture" value="square.wkt"/><string name="frequency" value="94 GHz"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="0.2"/><rotate x="1" angle="180"/>
            <translate z="0.5"/></transform>
        <bsdf type="diffuse"/>
    </shape>
</scene>
"""


@dataclass(frozen=True)
class Kind:
    """How a run is started, where its finished parts are, and what it leaves."""

    program: str
    store: str
    parts: str
    """Folder of finished parts in the store."""
    scene: str = ""
    is_command: bool = True

    def words(self, name: str, out: Path) -> list[str]:
        given = [name, str(out)] if self.is_command else [str(out)]
        return [sys.executable, "-W", "ignore", "-c", self.program, *given]


KINDS = {
    "volume": Kind(VOLUME, "run", "kirchhoff/c", is_command=False),
    "receive": Kind(
        COMMAND, "run.parts.zarr", "power/c",
        SCENE.format(sensor="wigner_receiver", samples=4096, width=1, height=1),
    ),
    "render": Kind(
        COMMAND, "run.parts.zarr", "radiance/c",
        SCENE.format(sensor="perspective", samples=8, width=8, height=2048).replace(
            '<string name="aperture" value="square.wkt"/>\n        '
            '<string name="frequency" value="94 GHz"/>\n        <tr', "<tr", 1,
        ),
    ),
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--kills", type=int, default=50, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    options = parser.parse_args()
    failures = 0
    for name in options.kinds.split(","):
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "scene.xml").write_text(KINDS[name].scene)
            (Path(folder) / "square.wkt").write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
            failures += kill_all(name, Path(folder), options.kills, random.Random(options.seed))
    return 1 if failures else 0


def kill_all(name: str, folder: Path, kills: int, dice: random.Random) -> int:
    kind, counts, slowest, since = KINDS[name], Counter[str](), 0.0, 0
    undisturbed, place = folder / "undisturbed", folder / "killed"
    seconds, _ = run(name, undisturbed)
    expected = result_of(undisturbed)
    print(f"{name}: undisturbed {seconds:.2f} s, {', '.join(sorted(expected))[:80]}", flush=True)
    finished: dict[Path, int] = {}
    damaged: set[tuple[Path, int]] = set()
    while True:
        soon = dice.uniform(0.0, seconds) * dice.choice((0.5, 1.0))  # or while a store is made
        is_last = counts["kills"] >= kills
        limit = None if is_last or counts["kills"] - since >= KILLS_OF_A_RUN else soon
        took, was_killed = run(name, place, limit)
        store = place / kind.store
        is_done = bool(
            kind.is_command and place.exists() and set(result_of(place)) == set(expected)
        )
        if not is_done:  # of a command that is done, the store goes
            now = parts_in(store / kind.parts)
            counts["lost"] += sum(now.get(part) != when for part, when in finished.items())
        if was_killed:
            counts["kills"] += 1
            count_what_is_left(store, counts)
            counts["with all results there"] += is_done
            if counts["kills"] % 2:
                damaged |= flip_a_byte(store / kind.parts, dice)
                counts["bytes flipped"] = len(damaged)
            now = parts_in(store / kind.parts)
            finished = {part: when for part, when in now.items() if (part, when) not in damaged}
            continue
        slowest = max(slowest, took)
        counts["complete runs"] += 1
        names = sorted(path.name for path in place.iterdir())
        as_one = sorted(path.name for path in undisturbed.iterdir())
        if names != as_one or counts["lost"] or not same(result_of(place), expected):
            print(f"FAIL after {dict(counts)}: {names}")
            return 1
        if is_last:
            break
        since, finished = counts["kills"], {}
        shutil.rmtree(place)
    print("    " + ", ".join(f"{count} {name}" for name, count in sorted(counts.items())))
    print(f"    complete runs are as the undisturbed one; slowest {slowest:.2f} s", flush=True)
    return 0


def run(name: str, place: Path, limit: float | None = None) -> tuple[float, bool]:
    """Seconds that a run takes at work, and whether it was killed at the limit."""
    place.mkdir(exist_ok=True)
    command = KINDS[name].words(name, place / "run")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        if process.stdout is None or process.stdout.readline() != "begins\n":
            raise SystemExit("FAIL: the run did not begin")
        start = time.monotonic()
        try:
            status = process.wait(limit)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return time.monotonic() - start, True
        if status:
            raise SystemExit(f"FAIL: the run ended with status {status}")
        return time.monotonic() - start, False


def result_of(place: Path) -> dict[str, Any]:
    """What a run leaves: digests of a volume's files; a picture; the powers of a record."""
    found: dict[str, Any] = {}
    for file in sorted(place.rglob("*")):
        name = str(file.relative_to(place))
        if not file.is_file() or ".parts.zarr" in name or file.suffix in (".lock", ".partial"):
            continue
        if file.suffix == ".exr":
            import mitsuba as mi

            mi.set_variant("scalar_rgb")
            found[name] = np.array(mi.Bitmap(str(file)))
        elif file.suffix == ".json" and place.joinpath("run.json") == file:
            found[name] = powers_in(json.loads(file.read_bytes()))
        elif file.suffix == ".png":
            found[name] = None
        else:
            found[name] = hashlib.sha256(file.read_bytes()).hexdigest()
    return found


def powers_in(record: Any) -> list[float]:
    """All numbers of a record that are scattered powers in watts."""
    if isinstance(record, dict):
        own = [v for k, v in record.items() if k == "scattered_w" and isinstance(v, float)]
        return own + [p for v in record.values() for p in powers_in(v)]
    return [p for v in record for p in powers_in(v)] if isinstance(record, list) else []


def same(found: dict[str, Any], expected: dict[str, Any]) -> bool:
    def alike(a: Any, b: Any) -> bool:
        if isinstance(b, list):
            return len(a) == len(b) and np.allclose(a, b, rtol=LAST, atol=0)
        return bool(np.array_equal(a, b)) if isinstance(b, np.ndarray) else a == b

    return found.keys() == expected.keys() and all(alike(found[k], expected[k]) for k in expected)


def parts_in(folder: Path) -> dict[Path, int]:
    """Finished parts, and when each was written."""
    files = (file for file in folder.rglob("*") if file.suffix != ".partial")
    return {file: file.stat().st_mtime_ns for file in files if file.is_file()}


def count_what_is_left(store: Path, counts: Counter[str]) -> None:
    kinds: dict[str, Callable[[], bool]] = {
        "killed without a store": lambda: not store.exists(),
        "locks left": store.with_name(f"{store.name}.lock").exists,
        "stores half made or half removed": store.with_name(f"{store.name}.partial").exists,
        "with half-written chunks": lambda: any(store.rglob("*.partial")),
    }
    for name, is_so in kinds.items():
        counts[name] += is_so()


def flip_a_byte(folder: Path, dice: random.Random) -> set[tuple[Path, int]]:
    """Of a finished part, if there is one; its file and when that was."""
    chunks = sorted(parts_in(folder))
    if not chunks:
        return set()
    content = bytearray((file := dice.choice(chunks)).read_bytes())
    content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
    file.write_bytes(content)
    return {(file, file.stat().st_mtime_ns)}


if __name__ == "__main__":
    sys.exit(main())
