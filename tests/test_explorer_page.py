"""The explorer's page in a real browser without a window, and its command."""

from __future__ import annotations

import importlib.util
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

import polywigner as pw
from explorer_server import SECONDS, handshake, need_panel, running
from polywigner.cli import main
from polywigner.explorer import State
from polywigner.explorer.outlines import rows_of_rings
from polywigner.explorer.state import from_query, to_query

pytestmark = pytest.mark.slow  # a browser, and a page that it waits for

DIGITS = 1e-11  # relative: the page prints twelve
LeaveOut = Callable[[str], NoReturn]
# What a visitor sees is in shadow trees: models are asked by name or tag instead.
FIND = """
const model = [...Bokeh.documents[0].all_models]
  .find((m) => m.name === arguments[0] || m.tags.includes(arguments[0]))
const view = Bokeh.index.find_one(model)
"""
PLACE = """
const box = view.el.getBoundingClientRect(), {x_scale, y_scale} = view.frame
return [box.left + x_scale.compute(arguments[1]), box.top + y_scale.compute(arguments[2])]
"""
CELLS = """
const rows = [...view.shadow_el.querySelectorAll(".slick-row")]
return rows.map((row) => [...row.querySelectorAll(".slick-cell")].map((cell) => cell.innerText))
"""
PIXELS = """
const {value} = model.renderers.find((r) => r.glyph.type === "ImageRGBA").data_source.data
return value.map((part) => [Array.from(part), part.shape])
"""
FOCUSED = """
let at = document.activeElement
while (at?.shadowRoot?.activeElement) { at = at.shadowRoot.activeElement }
return [at.tagName, at.ariaLabel ?? "", getComputedStyle(at).outlineStyle]
"""


@pytest.fixture(scope="module")
def address(leave_out: LeaveOut) -> Iterator[str]:
    """A running server of the page."""
    need_panel(leave_out)
    with running("127.0.0.1") as url:
        yield url


@pytest.fixture(scope="module")
def browser(
    address: str, tmp_path_factory: pytest.TempPathFactory, leave_out: LeaveOut
) -> Iterator[Any]:
    """Chromium without a window, by its driver."""
    if importlib.util.find_spec("selenium") is None:
        leave_out('Selenium. `pip install ".[browser]"` brings it.')
    driver, program = shutil.which("chromedriver"), shutil.which("chromium")
    if driver is None or program is None:
        leave_out("a browser. Debian: `apt-get install chromium chromium-driver`.")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in (
        "headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage",
        "window-size=1500,1200", "host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    ):  # fmt: skip
        options.add_argument(f"--{argument}")
    made = webdriver.Chrome(options, service=webdriver.ChromeService(driver))
    made.downloads = tmp_path_factory.mktemp("downloads")
    where = {"behavior": "allow", "downloadPath": str(made.downloads)}
    made.execute_cdp_cmd("Browser.setDownloadBehavior", where)
    yield made
    made.quit()


class Page:
    """The page as a visitor has it: what it says, and where a mouse would go."""

    def __init__(self, browser: Any, url: str) -> None:
        from selenium.webdriver import ActionChains

        self.browser, self.chain = browser, ActionChains
        browser.get(url)
        self.wait_until(self.is_ready)
        self.run("document.querySelectorAll('details').forEach((d) => { d.open = true })")

    def run(self, script: str, *arguments: Any) -> Any:
        return self.browser.execute_script(script, *arguments)

    def wait_until(self, holds: Callable[[], Any]) -> None:
        from selenium.common.exceptions import WebDriverException

        # a file of 40 MiB, which the page reads before it refuses it, has taken more than SECONDS
        deadline = time.monotonic() + SECONDS
        while time.monotonic() < deadline:
            try:
                if holds():
                    return
            except WebDriverException:
                pass  # not there yet
            time.sleep(0.05)
        raise AssertionError(f"did not come to hold; the page says {self.text('message')!r}")

    def is_ready(self) -> bool:
        return self.text("status") == "ready"

    def text(self, name: str) -> str:
        found = self.run("return document.getElementById(arguments[0])?.innerText", name)
        return str(found or "")

    def get(self, name: str, *attributes: str) -> Any:
        script = "return arguments[1].reduce((found, name) => found[name], model)"
        return self.run(FIND + script, name, attributes)

    def selected(self) -> list[int]:
        return list(self.run(FIND + "return Array.from(model.selected.indices)", "vertices"))

    def set(self, name: str, attribute: str, value: Any) -> None:
        self.run(FIND + "model[arguments[1]] = arguments[2]", name, attribute, value)

    def element(self, name: str, selector: str) -> Any:
        script = "return view.shadow_el.querySelector(arguments[1])"
        return self.run(FIND + script, name, selector)

    def click(self, name: str, selector: str = "button, a") -> None:
        button = self.element(name, selector)
        self.run("arguments[0].scrollIntoView({block: 'center'})", button)
        button.click()

    def focus(self, figure: str) -> None:
        self.run(FIND + "view.canvas_view.events_el.focus()", figure)

    def press(self, *keys: str) -> None:
        """Keys one after the other, by their letters or Selenium's names."""
        from selenium.webdriver.common.keys import Keys

        for key in keys:
            self.chain(self.browser).send_keys(getattr(Keys, key, key)).perform()

    def at(self, figure: str, x: float, y: float) -> Any:
        """A mouse at a place of a figure, in its units."""
        across, down = self.run(FIND + PLACE, figure, x, y)
        moved = self.chain(self.browser, duration=20)
        moved.w3c_actions.pointer_action.move_to_location(int(across), int(down))
        return moved

    def tap(self, figure: str, x: float, y: float) -> None:
        self.at(figure, x, y).click().perform()
        time.sleep(0.3)  # two clicks at once are a double click

    def state(self) -> State:
        return from_query(self.browser.current_url.partition("?")[2])

    def settled(self) -> State:
        """The state once nothing is on its way any more."""
        before, now = None, self.state()
        while now != before or not self.is_ready():
            time.sleep(0.3)
            before, now = now, self.state()
        return now

    def until(self, act: Callable[[], None], holds: Callable[[], bool]) -> None:
        """Do it again where a busy machine took two clicks for one, too slow for a double one."""
        for _ in range(5):
            act()
            deadline = time.monotonic() + SECONDS / 10
            while time.monotonic() < deadline:
                if holds():
                    return
                time.sleep(0.05)
        raise AssertionError("did not come to hold")

    def number(self, name: str) -> complex:
        """A value that the page prints, in m²."""
        match = re.search(rf"{re.escape(name)}\s+(.*?) mm²", self.text("values"))
        assert match, self.text("values")
        parts = match[1].replace("− ", "-").replace("+ ", "+").split()
        return complex(float(parts[0]), float(parts[1]) if len(parts) > 1 else 0.0) * 1e-6

    def pictures(self, figure: str) -> list[Any]:
        """The images that a figure shows as numbers: one, or none."""
        return [np.reshape(flat, shape) for flat, shape in self.run(FIND + PIXELS, figure)]

    def cells_agree(self) -> bool:
        """Whether the table paints the vertices of the state."""
        rows = [[float(text) for text in row] for row in self.run(FIND + CELLS, "table")]
        return bool(np.allclose(rows, rows_of_rings(self.state().rings), rtol=1e-3))

    def downloaded(self, name: str) -> Path:
        path = Path(self.browser.downloads) / name
        self.wait_until(path.is_file)
        return path


@pytest.fixture
def page(browser: Any, address: str) -> Page:
    return Page(browser, address)


def test_the_page_works_without_a_network_and_starts_with_a_square(page: Page) -> None:
    assert page.settled() == State() and page.text("message") == ""
    assert [entry for entry in page.browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    assert np.isclose(page.number("∫|u|² dx"), 1e-4, rtol=DIGITS)


def test_an_outline_drawn_with_the_mouse_is_computed_and_its_numbers_are_the_functions(
    page: Page,
) -> None:
    page.set("snap", "value", 0.5)
    page.set("shape", "value", "blank sheet")
    page.wait_until(lambda: page.get("draw", "active") and "nothing drawn" in page.text("status"))
    assert page.pictures("fourier") == [] and "corners" in page.text("message")
    corners = [(-3.0, -2.0), (3.0, -2.0), (0.0, 3.0)]
    for corner in [*corners, corners[0]]:
        page.tap("aperture", *corner)
    page.wait_until(lambda: page.state().rings == (tuple(corners),) and page.is_ready())
    page.tap("aperture", 0.0, 0.0)
    page.tap("fourier", 0.05, 0.02)
    page.wait_until(lambda: page.state().nu != (0.0, 0.0) and page.is_ready())
    state = page.settled()
    assert np.allclose(state.nu, (0.05, 0.02), atol=0.01)
    source = pw.Aperture(np.array(corners) / 1000)
    x, nu = np.array(state.x) / 1000, np.array(state.nu) * 1000
    assert np.isclose(page.number("F(ν)"), pw.fourier(source, nu), rtol=DIGITS)
    assert np.isclose(page.number("W(x, ν)"), pw.wigner(source, x, nu), rtol=DIGITS)


def test_a_vertex_can_be_dragged_added_typed_and_undone_and_the_table_follows(page: Page) -> None:
    before = page.settled()
    page.wait_until(page.cells_agree)
    page.at("aperture", 5.0, 5.0).click_and_hold().perform()
    for _ in range(6):  # a hand begins with less than a pixel at a time
        page.chain(page.browser, duration=10).move_by_offset(1, -1).perform()
    for x in (5.5, 6.0):  # on the way the views follow
        page.at("aperture", x, x).perform()
        page.wait_until(lambda x=x: page.state().rings[0][2][0] > x - 0.1)  # type: ignore[misc]
    page.at("aperture", 6.0, 6.0).release().perform()
    page.wait_until(lambda: np.allclose(page.state().rings[0][2], (6, 6), atol=0.1))
    moved = page.settled().rings
    page.wait_until(page.cells_agree)
    page.until(
        lambda: page.at("aperture", 0.0, -5.0).double_click().perform(),
        lambda: len(page.state().rings[0]) == 5,
    )
    page.wait_until(page.cells_agree)
    page.click("undo")
    page.wait_until(lambda: page.state().rings == moved)
    page.chain(page.browser).key_down("\ue009").send_keys("z").key_up("\ue009").perform()
    page.wait_until(lambda: page.state().rings == before.rings and page.cells_agree())
    page.run("arguments[0].focus()", page.element("table", "[tabindex='0']"))
    page.press("ARROW_DOWN", "ENTER")
    page.press("7", "ENTER")  # an editor's text is selected
    page.wait_until(lambda: page.settled().rings[0][1] == (7, -5))
    page.wait_until(page.cells_agree)
    assert np.isclose(page.number("∫|u|² dx"), 1.1e-4, rtol=DIGITS)


def test_a_hole_does_not_outlive_its_outline(browser: Any, address: str) -> None:
    outer = ((-6.0, -6.0), (6.0, -6.0), (0.0, 6.0))
    state = State(rings=(outer, ((-1.0, -3.0), (1.0, -3.0), (0.0, 0.0))))
    page = Page(browser, f"{address}?{to_query(state)}")
    for key in ("DELETE", "BACKSPACE"):  # the page's own, and that of Bokeh's tool
        page.at("aperture", *outer[1]).click().perform()
        page.wait_until(lambda: page.selected() == [1])
        page.focus("aperture")
        page.press(key)
        page.wait_until(lambda: page.state().rings == () and "nothing" in page.text("status"))
        assert "Outline 1 had" in page.text("message") and "outline 2" in page.text("message")
        assert page.pictures("fourier") == []
        page.click("undo")
        page.wait_until(lambda: page.state().rings == state.rings and page.is_ready())
        assert len(page.pictures("fourier")) == 1


def test_many_vertices_have_fewer_handles_and_all_can_be_reached(
    browser: Any, address: str
) -> None:
    turns = 2 * np.pi * np.arange(240) / 240
    ring = tuple((round(5 * np.cos(t), 6), round(5 * np.sin(t), 6)) for t in turns)
    page = Page(browser, f"{address}?{to_query(State(rings=(ring,)))}")
    assert "120 handles, 240 vertices" in page.get("aperture", "title", "text")
    page.set("views", "active", [0])
    page.focus("aperture")
    page.press("n", "n")  # the second has no handle
    page.wait_until(lambda: page.selected() == [1])
    page.press("ARROW_UP")
    page.wait_until(lambda: page.state().rings[0][1] != ring[1])
    assert [k for k, p in enumerate(page.settled().rings[0]) if p != ring[k]] == [1]


@pytest.mark.parametrize(
    ("width", "height", "side"),
    [(1280, 800, 240), (1920, 1080, 320), (390, 844, 290), (320, 640, 230)],
)
def test_the_page_fills_its_window_and_cuts_nothing_off(
    page: Page, width: int, height: int, side: int
) -> None:
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    page.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        page.browser.refresh()
        page.wait_until(page.is_ready)
        page.wait_until(lambda: page.get("fourier", "frame_width") >= side)
        box = "{const {left, right} = element.getBoundingClientRect(); return [left, right]}"
        right = f"return [...document.querySelectorAll('header *')].map((element) => {box})"
        assert all(0 <= a <= b <= width for a, b in page.run(right) if (a, b) != (0, 0))
        assert page.run("return document.documentElement.scrollWidth") == width
        assert page.run("const m = document.getElementById('main'); return m.scrollWidth") <= width
        if page.run("return document.getElementById('side').hidden"):
            page.run("document.getElementById('drawer').click()")
        for name in ("outline", "light", "views", "vertices", "take"):
            bottom = "return document.getElementById(arguments[0]).getBoundingClientRect().bottom"
            page.wait_until(lambda: 0 < page.run(bottom, f"group_{name}") <= height or width < 500)  # noqa: B023
    finally:
        page.browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_dark_system_has_a_dark_page_with_light_letters(page: Page) -> None:
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
    try:
        ground = "return getComputedStyle(document.body).backgroundColor"
        page.wait_until(lambda: page.run(ground) == "rgb(18, 22, 26)")
        page.wait_until(lambda: page.get("fourier", "title", "text_color") == "#e3e8ed")
    finally:
        page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_lengths_are_in_one_unit_and_colour_bars_keep_their_powers_of_ten(
    browser: Any, address: str
) -> None:
    ring = tuple((1e-3 * x, 1e-3 * y) for x, y in State().rings[0])
    page = Page(browser, f"{address}?{to_query(State(unit='m', rings=(ring,)))}")
    assert "0.0001 m²" in page.text("values")
    assert page.get("wigner_x", "title", "text") == "W(x, ν) over x (10⁻⁶ m²)"
    assert "10⁻⁹ m⁴" in page.get("fourier", "title", "text")
    high = "return model.below.find((part) => part.type === 'ColorBar').color_mapper.high"
    assert np.isclose(page.run(FIND + high, "wigner_x"), 400, rtol=1e-2)  # 4e-4 m²


def test_a_crossing_outline_says_so_and_the_last_good_result_stays(page: Page) -> None:
    (image,), values = page.pictures("wigner_nu"), page.text("values")
    page.set("rows", "data", {"ring": [1] * 4, "x": [-5, 5, -5, 5], "y": [-5, -5, 5, 5]})
    page.wait_until(lambda: "crosses itself" in page.text("message"))
    page.wait_until(lambda: "earlier state" in page.text("status"))  # and not that it is ready
    pale = FIND + "return Number(getComputedStyle(view.el).opacity)"
    page.wait_until(lambda: page.run(pale, "wigner_nu") < 0.5)
    assert page.text("values") == values
    assert np.array_equal(page.pictures("wigner_nu")[0], image)
    page.click("undo")
    page.wait_until(lambda: page.text("message") == "" and page.is_ready())
    page.wait_until(lambda: page.run(pale, "wigner_nu") == 1)


def test_everything_has_a_name_and_the_tabulator_reaches_it_and_comes_to_an_end(
    page: Page,
) -> None:
    tree = page.browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    acting = {"button", "textbox", "combobox", "slider", "checkbox", "application", "spinbutton"}
    found = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in tree
        if node.get("role", {}).get("value") in acting
    ]
    assert len(found) > 40 and [role for role, name in found if not name] == []
    page.run("document.activeElement?.blur()")
    stops = []
    for _ in range(80):
        page.press("TAB")
        stops.append(tuple(page.run(FOCUSED)))
        if stops[-1][0] == "BODY":
            break
    tags, labels = [tag for tag, _, _ in stops], " ".join(label for _, label, _ in stops)
    assert tags[-1] == "BODY"  # nobody is kept in the table
    assert tags.count("INPUT") > 15 and tags.count("BUTTON") > 10
    for name in ("Vertices", "Defocus", "Near field at z", "Aperture", "|F(ν)|²", "W(x, ν) over x"):
        assert name in labels
    for tag, label, outline in stops[:-1]:  # where one is can be seen; the table has a frame
        assert outline != "none" or "Vertices" in label, (tag, label)


def test_a_vertex_is_chosen_moved_added_and_deleted_by_keys(page: Page) -> None:
    before = page.settled().rings
    page.focus("aperture")
    page.press("n", "ARROW_UP")
    page.press("ARROW_UP")
    page.wait_until(lambda: "Vertex 1 of 4: (-5, -4.8) mm" in page.text("message"))
    assert page.settled().rings[0][0] == (-5, -4.8)
    page.press("INSERT")
    page.wait_until(lambda: page.settled().rings[0][1] == (0, -4.9))
    page.press("DELETE")
    page.wait_until(lambda: len(page.settled().rings[0]) == 4)
    for _ in range(3):  # moves of one vertex that follow each other are one step
        page.click("undo")
    page.wait_until(lambda: page.settled().rings == before)


def test_sliders_move_their_views_and_no_other_number(page: Page) -> None:
    values = page.text("values")
    page.element("defocus", ".noUi-handle").send_keys("\ue014" * 3)  # arrow to the right
    page.wait_until(lambda: np.isclose(page.settled().defocus, 0.15))
    assert page.text("values") == values
    page.set("coherence", "value", 5.0)
    page.wait_until(lambda: page.settled().coherence == 5.0)
    assert page.text("message") == ""


def test_good_and_bad_files_can_be_sent(page: Page, tmp_path: Path) -> None:
    good, bad, huge = (tmp_path / name for name in ("outline.wkt", "broken.geojson", "huge.wkt"))
    good.write_text("POLYGON((0 0, 4 0, 4 2, 0 2, 0 0))")
    bad.write_text("{ not json")
    page.element("upload", "input").send_keys(str(good))
    page.wait_until(lambda: page.state().rings[0][0] == (4, 0))
    assert np.isclose(page.number("∫|u|² dx"), 8e-6, rtol=DIGITS)
    page.element("upload", "input").send_keys(str(bad))
    page.wait_until(lambda: "broken.geojson" in page.text("message"))
    assert "Traceback" not in page.text("message") and str(tmp_path) not in page.text("message")
    assert page.state().rings[0][0] == (4, 0)
    with huge.open("wb") as file:
        file.truncate(40 << 20)  # more than the connection takes
    page.element("upload", "input").send_keys(str(huge))
    page.wait_until(lambda: "40.0 MiB" in page.text("message"))
    page.element("upload", "input").send_keys(str(good))  # the page is still there
    page.wait_until(lambda: page.text("message") == "" and page.is_ready())


def test_a_link_restores_the_page_and_a_damaged_one_says_so(browser: Any, address: str) -> None:
    state = State(taper="cosine", x=(1.0, 2.0), nu=(0.03, 0.0), defocus=0.5, unit="cm")
    page = Page(browser, f"{address}?{to_query(state)}")
    assert page.settled() == state and page.get("taper", "value") == "cosine"
    long = "x" * 45_000  # as of a thousand vertices
    page = Page(browser, f"{address}?unit=furlong&taper={long}")
    assert "furlong" in page.text("message")
    page.wait_until(lambda: page.state() == State())  # the address follows


def test_what_is_taken_away_has_the_numbers_of_the_page(page: Page) -> None:
    page.set("array", "value", "2 x 1, 12 mm")
    page.set("x", "value", 6.0)
    page.set("take", "value", "wigner_x")
    page.wait_until(lambda: page.state().x[0] == 6.0 and page.state().array and page.is_ready())
    page.click("take_py")
    script = page.downloaded("wigner_x.py").read_text(encoding="utf-8")
    assert script == page.get("code", "value")
    namespace: dict[str, Any] = {}
    exec(script, namespace)
    (drawn,) = page.pictures("wigner_x")
    scale = np.abs(drawn).max()
    assert np.allclose(drawn, namespace["values"] * 1e6, rtol=1e-6, atol=1e-6 * scale)  # float32
    here = pw.wigner(namespace["source"], (6e-3, 0.0), (0.0, 0.0))
    assert np.isclose(page.number("W(x, ν)"), here, rtol=DIGITS)
    page.click("take_npz")
    with np.load(page.downloaded("wigner_x.npz")) as saved:
        assert np.allclose(saved["W"], namespace["values"], rtol=DIGITS)
    page.click("take_outline_geojson")
    read = pw.read_aperture(page.downloaded("aperture.geojson"), unit="mm")
    assert np.isclose(read.area, 1e-4, rtol=DIGITS)
    page.set("take", "value", "far")
    page.click("take_png")
    assert page.downloaded("far.png").read_bytes().startswith(b"\x89PNG")


def test_a_near_field_comes_coarse_first_and_keeps_nobody_waiting(page: Page) -> None:
    page.set("shape", "value", "star")
    page.set("order", "active", 1)
    page.wait_until(lambda: len(page.state().rings[0]) == 10 and page.is_ready())
    page.set("views", "active", [0, 1, 2, 3, 4, 5])
    page.wait_until(lambda: len(page.pictures("rays_near")[0]) == 16)
    assert "computing near field, " in page.text("status")  # what is finer takes seconds
    assert "0 of 1 pictures done" in page.text("status")  # the others are as they were
    before = page.text("values")
    page.set("x", "value", 0.5)
    page.wait_until(lambda: page.text("values") != before)
    star = pw.shapes.star(5, 7e-3, 3e-3)
    here = pw.wigner(star, (5e-4, 0), (0, 0))
    assert np.isclose(page.number("W(x, ν)"), here, rtol=1e-5)  # the outline is rounded
    assert "computing" in page.text("status")
    page.set("views", "active", [0, 1, 2, 3, 4])
    page.wait_until(page.is_ready)  # and what was still to be computed is dropped


def test_the_tour_shows_what_it_speaks_of_and_no_picture_of_another_source(page: Page) -> None:
    for step in range(1, 6):
        page.click("tour_next")
        page.wait_until(lambda step=step: f"{step} of 5" in page.text("tour"))  # type: ignore[misc]
    page.wait_until(lambda: page.get("rays_near", "visible") and page.is_ready())
    assert len(page.pictures("rays_near")) == 1
    page.set("array", "value", "4 x 4, 12 mm")  # has too many edges for rays
    page.wait_until(lambda: "near field: expected" in page.text("message") and page.is_ready())
    assert page.pictures("rays_near") == []  # not the picture of the last source
    page.click("tour_next")
    page.wait_until(lambda: page.text("tour") == "" and not page.get("rays_near", "visible"))


def test_two_visitors_have_states_of_their_own(browser: Any, address: str, page: Page) -> None:
    first = browser.current_window_handle
    page.set("steering", "value", "10 deg")
    page.wait_until(lambda: page.state().steering == "10 deg")
    browser.switch_to.new_window("tab")
    try:
        assert Page(browser, address).settled() == State()
    finally:
        browser.close()
        browser.switch_to.window(first)
    assert page.state().steering == "10 deg"


def test_the_command_prints_its_address_and_stops_cleanly(address: str) -> None:
    command = [sys.executable, "-m", "polywigner", "explore", "--no-browser", "--port", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None
        line = run.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/", line)
        assert found, line
        assert b"polywigner explore" in urlopen(found[0], timeout=SECONDS).read()
        handshake(found[0], found[0].rstrip("/"))  # without a token
        handshake(found[0], "http://example.org")
        urlopen(f"{found[0]}?rings=0,0%20nan", timeout=SECONDS).close()
        run.send_signal(signal.SIGINT)
        output, errors = run.communicate(timeout=SECONDS)
    assert run.returncode == 0
    assert "stopped" in output and "Traceback" not in errors and "File" not in errors


def test_without_the_extra_the_package_imports_and_the_command_names_it() -> None:
    program = (
        "import sys; sys.modules['panel'] = sys.modules['bokeh'] = None\n"
        "import polywigner.explorer, polywigner.explorer.exports, polywigner.explorer.snippets\n"
        "from polywigner.cli import main; sys.exit(main(['explore']))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 2
    assert ".[explorer]" in run.stderr and run.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["missing.geojson"], "not a file"),
        (["--frequency", "ten"], "frequency"),
        (["--address", "203.0.113.1", "--port", "0"], "--address"),
        (["--address", " ", "--port", "0"], "expected an address to listen at"),
        (["--allow-host", "*", "--port", "0"], "--allow-host"),
        (["--port", "-4"], "port"),
        (["--port", "{used}"], "{used}, which is in use"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    options: list[str], match: str, address: str, capsys: pytest.CaptureFixture[str]
) -> None:
    used = urlsplit(address).port
    texts = [text.format(used=used) for text in options]
    assert main(["explore", "--no-browser", *texts]) == 2
    errors = capsys.readouterr().err
    assert match.format(used=used) in errors and errors.count("\n") == 1
