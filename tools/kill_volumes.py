#!/usr/bin/env python3
"""A volume that is killed again and again must end as if nothing had happened.

    python tools/kill_volumes.py [--kills 50] [--seed 0]

Starts a small volume, ends it by SIGKILL at a random moment, flips a byte of a chunk in every
second case, and starts it again until it is complete; then the next one, until there have been
that many kills. Every store that is complete is compared, file by file, with that of a run that
nothing happened to. The exit status is 1 where one differs, a run fails, or anything is left beside
a store.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

KILLS_OF_A_STORE = 6
"""After so many a store is completed and compared, and the next one begun."""

RUN = """
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


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        return kill_all(Path(folder), options.kills, random.Random(options.seed))


def kill_all(folder: Path, kills: int, dice: random.Random) -> int:
    undisturbed, store = folder / "undisturbed.zarr", folder / "killed" / "field.zarr"
    seconds, _ = run(undisturbed)
    expected, counts, slowest = digests(undisturbed), Counter[str](), 0.0
    print(f"undisturbed: {len(expected)} files, {seconds:.2f} s")
    since = 0
    while True:
        soon = dice.uniform(0.0, seconds) * dice.choice((0.5, 1.0))  # or while a store is made
        is_last = counts["kills"] >= kills
        limit = None if is_last or counts["kills"] - since >= KILLS_OF_A_STORE else soon
        took, was_killed = run(store, limit)
        if was_killed:
            counts["kills"] += 1
            count_what_is_left(store, counts)
            if counts["kills"] % 2:
                counts["bytes flipped"] += flip_a_byte(store, dice)
            continue
        slowest = max(slowest, took)
        counts["complete runs"] += 1
        if digests(store) != expected or [path.name for path in store.parent.iterdir()] != [
            store.name
        ]:
            print(f"FAIL after {dict(counts)}: {sorted(store.parent.iterdir())}")
            return 1
        if is_last:
            break
        since = counts["kills"]
        shutil.rmtree(store)
    print(", ".join(f"{count} {name}" for name, count in sorted(counts.items())))
    print(
        f"every complete store is that of the undisturbed run; slowest to complete {slowest:.2f} s"
    )
    return 0


def run(store: Path, limit: float | None = None) -> tuple[float, bool]:
    """Seconds from the call of `volume` to its end, and whether the run was killed at the limit."""
    command = [sys.executable, "-W", "ignore", "-c", RUN, str(store)]
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


def files_of(store: Path) -> list[Path]:
    return sorted(path for path in store.rglob("*") if path.is_file())


def digests(store: Path) -> dict[str, str]:
    return {
        str(file.relative_to(store)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files_of(store)
    }


def count_what_is_left(store: Path, counts: Counter[str]) -> None:
    kinds: dict[str, Callable[[], bool]] = {
        "killed before the store was there": lambda: not store.exists(),
        "locks left": store.with_name(f"{store.name}.lock").exists,
        "half-made stores left": store.with_name(f"{store.name}.partial").exists,
        "with half-written chunks": lambda: any(store.rglob("*.partial")),
    }
    for name, is_so in kinds.items():
        counts[name] += is_so()


def flip_a_byte(store: Path, dice: random.Random) -> int:
    """Of a chunk, if there is one; the number of bytes flipped."""
    chunks = [file for file in files_of(store / "kirchhoff" / "c") if file.suffix != ".partial"]
    if not chunks:
        return 0
    content = bytearray((file := dice.choice(chunks)).read_bytes())
    content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
    file.write_bytes(content)
    return 1


if __name__ == "__main__":
    sys.exit(main())
