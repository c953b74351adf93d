"""Send SIGINT to every command at many moments, and report how each of them answers.

    python tools/interruptions.py [--only volume] [--times 0.1 0.5 2] [--fresh] [--last 6]

Each run has a folder and a session of its own. Half of the runs get the signal as from `kill -INT`,
the other half as from a terminal, which sends it to all processes of the group. Right is an end
within 2 s, with code 130, one line on stderr (after warnings), and nothing unfinished left behind.
The last column counts the runs in which Python itself had not got as far as the command line: it
then ends by the signal. `explore` has code 0 once it serves, since Ctrl-C is how one stops it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
CHEVRONS = str(EXAMPLES / "two_chevrons" / "chevrons.geojson")
BOX = "-40 mm to 40 mm, -40 mm to 40 mm, 2 mm to 120 mm"
PLANE = "-40 mm to 40 mm, 0 mm, 2 mm to 120 mm"
AT = ["--frequency", "94 GHz"]
COMMANDS = {
    "render": ["render", str(EXAMPLES / "street_77ghz" / "scene.xml"), "--spp", "4096"],
    "render-scalar": [
        *("render", str(EXAMPLES / "two_chevrons" / "scene.xml")),
        *("--variant", "scalar_rgb", "--spp", "64"),
    ],
    "receive": ["receive", str(EXAMPLES / "link_77ghz" / "link.xml"), "--spp", "67108864"],
    "receive-scalar": [
        *("receive", str(EXAMPLES / "link_77ghz" / "link.xml")),
        *("--variant", "scalar_rgb", "--spp", "16384"),
    ],
    "transform": ["transform", CHEVRONS, *AT, "--samples", "1025"],
    "propagate": [
        *("propagate", CHEVRONS, *AT, "--method", "kirchhoff", "--accuracy", "1e-4"),
        *("--plane", PLANE, "--samples", "961 x 1401"),
    ],
    "pattern": ["pattern", CHEVRONS, *AT],
    "volume": ["volume", CHEVRONS, *AT, "--box", BOX, "--shape", "200 x 200 x 200"],
    "volume-numpy": [
        *("volume", CHEVRONS, *AT, "--box", BOX, "--shape", "200 x 200 x 200"),
        *("--engine", "numpy", "--method", "rayleigh-sommerfeld-1"),
    ],
    "figures": ["figures", "--quality", "print"],
    "explore": ["explore", "--no-browser", "--port", "0"],
    "doctor": ["doctor"],
}
LONGEST = 60.0  # seconds to wait for an end
ALLOWED = 2.0  # seconds that an answer may take


@dataclass(frozen=True)
class Answer:
    """How a command ended after a signal."""

    moment: float
    to_group: bool
    seconds: float
    code: int
    errors: list[str]
    left: list[str]

    @property
    def was_too_early(self) -> bool:
        """Python was still starting: no line of polywigner had run."""
        return self.code in (-signal.SIGINT, 1) and not any(
            "polywigner:" in line for line in self.errors
        )

    def is_right(self, serves: bool) -> bool:
        told = [line for line in self.errors if not line.startswith("polywigner: warning: ")]
        ended = self.code == 130 and told == ["polywigner: interrupted"]
        ended |= serves and self.code == 0 and not told
        return ended and self.seconds <= ALLOWED and not self.left


def interrupted(words: list[str], moment: float, to_group: bool, fresh: bool) -> Answer | None:
    """The answer of a command to a signal some seconds after its start; None if it ended before."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        temporary, work = folder / "tmp", folder / "work"
        temporary.mkdir()
        work.mkdir()
        environment = {**os.environ, "TMPDIR": str(temporary)}
        if fresh:  # as on the first run: libraries are tried out, fonts looked for
            environment |= {"XDG_CACHE_HOME": str(folder / "cache"), "MPLCONFIGDIR": name}
        with subprocess.Popen(
            [sys.executable, "-m", "polywigner", *words],
            cwd=work,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=(folder / "stderr").open("wb"),
            start_new_session=True,
        ) as run:
            try:
                run.wait(moment)
                return None
            except subprocess.TimeoutExpired:
                start = time.perf_counter()
                (os.killpg if to_group else os.kill)(run.pid, signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                run.wait(LONGEST)
            seconds = time.perf_counter() - start
            left = [f"process {pid}" for pid in session(run.pid)]
            if run.poll() is None or left:
                os.killpg(run.pid, signal.SIGKILL)
            code = run.wait()
        left += [str(p.relative_to(folder)) for p in unfinished(work, temporary)]
        errors = (folder / "stderr").read_text(errors="replace").splitlines()
        return Answer(moment, to_group, seconds, code, errors, left)


def session(leader: int) -> Iterator[int]:
    """The other processes of a session that live."""
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, number = entry.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(number) == leader and state != "Z" and int(entry.parent.name) != leader:
            yield int(entry.parent.name)


def unfinished(work: Path, temporary: Path) -> Iterator[Path]:
    """What a command should not have left: scratch files, stores without a chunk."""
    yield from (p for p in work.rglob("*") if ".partial" in p.name)
    yield from (store for store in work.glob("*.zarr") if not list(store.glob("*/c/**/*")))
    yield from temporary.iterdir()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(COMMANDS), default=list(COMMANDS))
    parser.add_argument("--times", nargs="+", type=float, help="in s; else --first, --last, --step")
    parser.add_argument("--first", type=float, default=0.05)
    parser.add_argument("--last", type=float, default=6.0)
    parser.add_argument("--factor", type=float, default=1.4, help="of each moment to the next")
    parser.add_argument("--fresh", action="store_true", help="with empty caches")
    parser.add_argument("--details", action="store_true", help="show what is wrong")
    options = parser.parse_args()
    times = options.times or [options.first]
    while not options.times and times[-1] * options.factor <= options.last:
        times.append(times[-1] * options.factor)
    print(f"{'command':15}{'signals':>8}{'right':>7}{'slowest':>9}{'median':>8}{'too early':>11}")
    for name in options.only:
        found = []
        for number, moment in enumerate(times):
            answer = interrupted(COMMANDS[name], moment, number % 2 == 1, options.fresh)
            if answer is None:
                break
            found.append(answer)
            if options.details and not answer.is_right(name == "explore"):
                print("   ", answer)
        report(name, found)


def report(name: str, found: list[Answer]) -> None:
    if not found:
        return
    early = [answer for answer in found if answer.was_too_early]
    seconds = sorted(answer.seconds for answer in found)
    right = sum(answer.is_right(name == "explore") for answer in found)
    print(
        f"{name:15}{len(found):8}{right:7}{seconds[-1]:8.2f}s{seconds[len(seconds) // 2]:7.2f}s"
        f"{len(early):11}",
        flush=True,
    )


if __name__ == "__main__":
    main()
