"""How long does the explorer take to answer an edit, and does it keep what visitors leave behind?

Starts ``polywigner explore`` in a process of its own and visits it in Chromium (Debian: chromium
and chromium-driver; `pip install polywigner[browser]`). An edit moves one of eight vertices; it is
answered when all pictures, of 256 x 256, have been painted. Prints milliseconds, by the clock and
of processor time of server and browser, the parts that make them, the same with three visitors at
once, how long a near field takes and what a click waits for meanwhile, and what memory a hundred
visits leave.

    python benchmarks/explorer.py [--edits 50] [--visits 100]
"""

from __future__ import annotations

import argparse
import math
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from polywigner.explorer import views
from polywigner.explorer.state import State
from polywigner.explorer.views import shown

SECONDS = 30.0
SHOWN = ("fourier", "wigner_nu", "wigner_x", "otf")  # with the far field, what a page opens with
STAY = 1.0  # seconds
KEPT = 20.0  # seconds after which the server has forgotten a visitor


def octagon(step: int) -> tuple[tuple[float, float], ...]:
    """Eight vertices of which the first is somewhere else at each step."""
    radii = [6 + 0.02 * step, *(5 + 0.5 * (k % 3) for k in range(1, 8))]
    turns = [2 * math.pi * k / 8 for k in range(8)]
    return tuple((r * math.cos(t), r * math.sin(t)) for r, t in zip(radii, turns, strict=True))


@contextmanager
def server() -> Iterator[tuple[str, int]]:
    """The websocket address and the process id of a running explorer."""
    command = [sys.executable, "-m", "polywigner", "explore", "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = re.search(r"//(127\.0\.0\.1:\d+)/", process.stdout.readline())
        assert found
        try:
            yield f"http://{found[1]}/", process.pid
        finally:
            process.terminate()


# Runs in the page: moves a vertex, and tells the milliseconds until the last picture is painted.
EDIT = """
const [steps, done] = arguments
const all = [window, ...Array.from(document.querySelectorAll("iframe"), (f) => f.contentWindow)]
Promise.all(all.map((page, k) => new Promise((answered) => {
  const models = page.Bokeh.documents[0]
  const busy = models.get_model_by_name("busy"), outline = models.get_model_by_name("outline")
  const start = performance.now()
  busy.text = "asked"
  const look = setInterval(() => {
    if (!busy.text.includes("ready")) { return }
    clearInterval(look)
    requestAnimationFrame(() => requestAnimationFrame(() => answered(performance.now() - start)))
  }, 2)
  const data = {xs: [steps[k][0]], ys: [steps[k][1]], number: [0]}
  outline.data = page.JSON.parse(JSON.stringify(data))  // an object of that page's own
}))).then(done)
"""
READY = """
const all = [window, ...Array.from(document.querySelectorAll("iframe"), (f) => f.contentWindow)]
return all.every((page) =>
  page.Bokeh?.documents[0]?.get_model_by_name("busy")?.text.includes("ready") ?? false)
"""
NEAR = """
const views = Bokeh.documents[0].get_model_by_name("views")
views.active = [...views.active, 5]
"""
NEAR_SAMPLES = """
const figure = Bokeh.documents[0].get_model_by_name("rays_near")
const {image} = figure.renderers.find((r) => r.glyph.type === "ImageRGBA").data_source.data
return image.length === 0 ? 0 : image[0].shape[0]
"""
# Milliseconds from another position to its numbers.
CLICK = """
const [done] = arguments, models = Bokeh.documents[0]
const values = models.get_model_by_name("values"), start = performance.now(), {text} = values
const look = setInterval(() => {
  if (values.text === text) { return }
  clearInterval(look)
  done(performance.now() - start)
}, 2)
models.get_model_by_name("x").value = 0.7
"""
TWO_MORE = """
for (let k = 0; k < 2; k++) {
  const frame = document.createElement("iframe")
  frame.src = location.href
  frame.width = 1400
  frame.height = 900
  document.body.appendChild(frame)
}
"""


@contextmanager
def browser(url: str) -> Iterator[Any]:
    """Chromium without a window, at the page."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for argument in ("headless=new", "no-sandbox", "disable-gpu", "window-size=1500,1200"):
        options.add_argument(f"--{argument}")
    driver = webdriver.Chrome(
        options, service=webdriver.ChromeService(shutil.which("chromedriver"))
    )
    driver.set_script_timeout(SECONDS)
    driver.get(url)
    try:
        yield driver
    finally:
        driver.quit()


def wait_until_ready(driver: Any) -> None:
    """Until all visitors of the page have their pictures."""
    deadline = time.monotonic() + SECONDS
    while not driver.execute_script(READY):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def edit(driver: Any, step: int) -> list[float]:
    """Seconds that each visitor in the page waits for an edit, all at once."""
    steps = [list(zip(*octagon(3 * step + k), strict=True)) for k in range(3)]
    return [ms / 1e3 for ms in driver.execute_async_script(EDIT, steps)]


def visit(url: str) -> None:
    """Come, stay while pictures are computed, and leave: by the websocket, without a browser."""
    from bokeh.client import pull_session

    session = pull_session(url=url)
    time.sleep(STAY)
    session.close()


def processor_time(pid: int) -> float:
    """Seconds that a process has computed."""
    with open(f"/proc/{pid}/stat", encoding="ascii") as file:  # noqa: PTH123
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def family(pid: int) -> list[int]:
    """A process with all that it has started, and what those have."""
    children: dict[int, list[int]] = {}
    for entry in os.listdir("/proc"):  # noqa: PTH208
        if entry.isdigit():
            with suppress(OSError), open(f"/proc/{entry}/stat", encoding="ascii") as file:  # noqa: PTH123
                parent = int(file.read().rpartition(")")[2].split()[1])
                children.setdefault(parent, []).append(int(entry))
    found = [pid]
    for process in found:
        found += children.get(process, [])
    return found


def memory(pid: int) -> float:
    """MiB that a process holds, without what it shares with files."""
    with open(f"/proc/{pid}/status", encoding="ascii") as file:  # noqa: PTH123
        return int(re.search(r"RssAnon:\s+(\d+)", file.read())[1]) / 1024  # type: ignore[index]


def print_times(name: str, seconds: list[float], computed: Sequence[float]) -> None:
    """One line."""
    server, browsing = (1e3 * time / len(seconds) for time in computed)
    print(
        f"{name}: median {1e3 * statistics.median(seconds):.0f} ms, worst of {len(seconds)} "
        f"{1e3 * max(seconds):.0f} ms; processor time of the server {server:.0f} ms, of the "
        f"browser {browsing:.0f} ms each"
    )


def print_edits(url: str, pid: int, edits: int) -> None:
    """One visitor, then three at once."""
    with browser(url) as driver:
        wait_until_ready(driver)
        programs = [[pid], family(driver.service.process.pid)]

        def spent() -> list[float]:
            return [sum(map(processor_time, program)) for program in programs]

        for name in ("one visitor", "three visitors at once"):
            edit(driver, -1)  # a first time, of which nothing is counted
            before = spent()
            times = [t for step in range(edits) for t in edit(driver, step)]
            print_times(name, times, [b - a for a, b in zip(before, spent(), strict=True)])
            driver.execute_script(TWO_MORE)
            wait_until_ready(driver)


def print_near(url: str) -> None:
    """A near field of eight edges, and a click while it is computed."""
    with browser(url) as driver:
        wait_until_ready(driver)
        edit(driver, 0)
        start = time.monotonic()
        driver.execute_script(NEAR)
        while driver.execute_script(NEAR_SAMPLES) == 0:
            time.sleep(0.01)
        coarse = time.monotonic() - start
        click = driver.execute_async_script(CLICK) / 1e3
        while driver.execute_script(NEAR_SAMPLES) < 128:
            time.sleep(0.05)
        print(
            f"near field: first picture after {1e3 * coarse:.0f} ms, 128 x 128 after "
            f"{time.monotonic() - start:.1f} s; a click meanwhile {1e3 * click:.0f} ms"
        )


def print_parts(rounds: int = 15) -> None:
    """Processor time of each view of an edited aperture, and of what it is shown as."""
    spent: dict[str, list[float]] = {}
    for step in range(rounds):
        state = State(rings=(octagon(step),))
        for name in SHOWN:
            start = time.process_time()
            picture = views.PICTURES[name](state)
            middle = time.process_time()
            shown(picture, next(iter(picture.arrays)))
            spent.setdefault(name, []).append(middle - start)
            spent.setdefault("levels and scales", []).append(time.process_time() - middle)
        for name, view in (("far", views.far_field), ("values", views.values_at)):
            start = time.process_time()
            view(state)
            spent.setdefault(name, []).append(time.process_time() - start)
    print("parts, median of processor time:")
    for name, seconds in spent.items():
        print(f"  {name}: {1e3 * statistics.median(seconds):.1f} ms")


def print_memory(url: str, pid: int, visits: int) -> None:
    """What the server holds after a fifth of the visits, and after all."""
    found = {}
    for number in range(1, visits + 1):
        visit(url)
        if number in (visits // 5, visits):
            time.sleep(KEPT)
            found[number] = memory(pid)
    (first, before), (last, after) = found.items()
    print(
        f"memory after {first} visits {before:.1f} MiB, after {last} {after:.1f} MiB: "
        f"{after - before:+.1f} MiB"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--edits", type=int, default=50)
    parser.add_argument("--visits", type=int, default=100)
    options = parser.parse_args()
    print_parts()
    with server() as (url, pid):
        print_edits(url, pid, options.edits)
        print_near(url)
        if options.visits >= 5:
            print_memory(url, pid, options.visits)


if __name__ == "__main__":
    main()
