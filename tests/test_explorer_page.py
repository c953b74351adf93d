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

from explorer_server import SECONDS, handshake, need_bokeh, running
from polywigner.cli import main
from polywigner.explorer import outlines
from polywigner.explorer.state import State, from_query, to_query

pytestmark = pytest.mark.slow  # a browser, and a page that it waits for

LeaveOut = Callable[[str], NoReturn]


@pytest.fixture(scope="module")
def bokeh(leave_out: LeaveOut) -> None:
    """Tests that ask for this are left out without the library of the page."""
    need_bokeh(leave_out)


@pytest.fixture(scope="module")
def address(bokeh: None) -> Iterator[str]:
    """A running server of the page."""
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
        "headless=new",
        "no-sandbox",
        "disable-gpu",
        "disable-dev-shm-usage",
        "window-size=1500,1200",
        "host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # no network
    ):
        options.add_argument(f"--{argument}")
    downloads = tmp_path_factory.mktemp("downloads")
    made = webdriver.Chrome(options, service=webdriver.ChromeService(driver))
    where = {"behavior": "allow", "downloadPath": str(downloads)}
    made.execute_cdp_cmd("Browser.setDownloadBehavior", where)
    made.downloads = downloads
    yield made
    made.quit()


# What a visitor sees is in shadow trees: the models are asked by name instead.
FIND = """
const doc = Bokeh.documents[0]
const model = doc.get_model_by_name(arguments[0])
const view = Bokeh.index.find_one(model)
"""
PLACE = (
    FIND
    + """
const box = view.el.getBoundingClientRect()
const {x_scale, y_scale} = view.frame
return [box.left + x_scale.compute(arguments[1]), box.top + y_scale.compute(arguments[2])]
"""
)


class Page:
    """The page as a visitor has it: what it says, and where a mouse would go."""

    def __init__(self, browser: Any, url: str) -> None:
        from selenium.webdriver import ActionChains

        self.browser = browser
        self.chain = ActionChains
        browser.get(url)
        self.wait_until(self.is_ready)
        self.open("outline", "light", "views", "vertices", "take")

    def wait_until(self, holds: Callable[[], bool]) -> None:
        from selenium.common.exceptions import WebDriverException

        # a large file, which the page reads before it refuses it, has taken more than SECONDS
        deadline = time.monotonic() + 3 * SECONDS
        while time.monotonic() < deadline:
            try:
                if holds():
                    return
            except WebDriverException:
                pass  # not there yet
            time.sleep(0.05)
        raise AssertionError(f"did not come to hold; the page says {self.text('message')!r}")

    def is_ready(self) -> bool:
        return "ready" in self.text("busy")

    def text(self, name: str) -> str:
        return str(self.get(name, "text"))

    def get(self, name: str, attribute: str) -> Any:
        return self.browser.execute_script(FIND + "return model[arguments[1]]", name, attribute)

    def set(self, name: str, attribute: str, value: Any) -> None:
        script = FIND + "model[arguments[1]] = arguments[2]"
        self.browser.execute_script(script, name, attribute, value)

    def element(self, name: str, selector: str) -> Any:
        script = FIND + "return view.shadow_el.querySelector(arguments[1])"
        return self.browser.execute_script(script, name, selector)

    def open(self, *groups: str) -> None:
        """Controls that may be closed in this window."""
        for group in groups:
            self.set(f"group_{group}", "active", True)

    def click(self, name: str) -> None:
        button = self.element(name, "button")
        self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
        button.click()

    def press(self, *keys: str) -> None:
        """Keys one after the other, by their letters or Selenium's names."""
        from selenium.webdriver.common.keys import Keys

        for key in keys:
            self.chain(self.browser).send_keys(getattr(Keys, key, key)).perform()

    def at(self, figure: str, x: float, y: float) -> Any:
        """A mouse at a place of a figure, in its units."""
        across, down = self.browser.execute_script(PLACE, figure, x, y)
        moved = self.chain(self.browser, duration=20)
        moved.w3c_actions.pointer_action.move_to_location(int(across), int(down))
        return moved

    def tap(self, figure: str, x: float, y: float) -> None:
        self.at(figure, x, y).click().perform()
        time.sleep(0.3)  # two clicks at once are a double click

    def state(self) -> State:
        return from_query(str(self.get("link", "value")))

    def settled(self) -> State:
        """The state once nothing is on its way any more."""
        before, now = None, self.state()
        while now != before or not self.is_ready():
            time.sleep(0.3)
            before, now = now, self.state()
        return now

    def downloaded(self, name: str) -> Path:
        path = self.browser.downloads / name
        self.wait_until(path.is_file)
        return Path(path)


@pytest.fixture
def page(browser: Any, address: str) -> Page:
    return Page(browser, address)


def test_the_page_works_without_a_network_and_starts_with_a_square(page: Page) -> None:
    assert page.state() == State()
    assert page.text("message") == ""
    assert [entry for entry in page.browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_an_outline_is_drawn_with_the_mouse(page: Page) -> None:
    page.set("snap", "value", 0.5)
    page.set("shape", "value", "blank sheet")
    page.wait_until(lambda: "blank" in page.text("message") and page.get("draw", "active"))
    corners = [(-3.0, -2.0), (3.0, -2.0), (0.0, 3.0)]
    for corner in [*corners, corners[0]]:
        page.tap("aperture", *corner)
    page.wait_until(lambda: page.state().rings == (tuple(corners),) and page.is_ready())
    page.tap("fourier", 0.05, 0.02)
    page.wait_until(lambda: np.allclose(page.state().nu, (0.05, 0.02), atol=0.01))


CELLS = (
    FIND
    + """
const rows = [...view.shadow_el.querySelectorAll(".slick-row")]
return rows.map((row) => [...row.querySelectorAll(".slick-cell")].map((cell) => cell.innerText))
"""
)


def wait_for_cells(page: Page) -> None:
    """Until the table shows the vertices of the state: what is painted, not what is known."""

    def agree() -> bool:
        found = page.browser.execute_script(CELLS, "table")
        rows = [[float(text) for text in row] for row in found]
        return bool(np.allclose(rows, outlines.rows_of_rings(page.settled().rings), rtol=1e-3))

    page.wait_until(agree)


def test_the_table_shows_the_vertices_after_every_kind_of_edit(page: Page) -> None:
    wait_for_cells(page)
    states = [page.state().rings]

    def has_changed() -> None:
        page.wait_until(lambda: page.state().rings != states[-1])
        states.append(page.settled().rings)
        wait_for_cells(page)

    page.at("aperture", 5.0, 5.0).click_and_hold().perform()
    page.chain(page.browser, duration=50).move_by_offset(20, -30).perform()
    page.at("aperture", 6.0, 6.0).release().perform()
    has_changed()
    page.browser.execute_script(FIND + "view.canvas_view.events_el.focus()", "aperture")
    page.press("n", "ARROW_UP")
    has_changed()
    page.click("undo")
    has_changed()
    page.click("redo")
    has_changed()
    focus(page, "table", "[tabindex='0']")
    page.press("ARROW_DOWN", "ENTER")
    page.press("7", "ENTER")
    has_changed()
    page.browser.execute_script(FIND + "view.canvas_view.events_el.focus()", "aperture")
    page.press("n", "DELETE")
    has_changed()
    assert len(states[-1][0]) == 3


WINDOWS = {"laptop": (1280, 800, 240), "desktop": (1920, 1080, 320), "phone": (390, 844, 290)}
"""Width, height and the least side of a picture, in pixels."""


@pytest.mark.parametrize("window", WINDOWS)
def test_the_page_fills_its_window_and_shows_all_headings(page: Page, window: str) -> None:
    width, height, side = WINDOWS[window]
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    page.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        page.browser.refresh()
        page.wait_until(page.is_ready)
        assert page.browser.execute_script("return innerWidth") == width
        page.wait_until(lambda: page.get("fourier", "frame_width") >= side)
        scrolled = "return document.documentElement.scrollWidth"
        assert page.browser.execute_script(scrolled) == width
        page.set("drawer", "active", True)
        for name in ("outline", "light", "views", "vertices", "take"):
            bottom = FIND + "return view.el.getBoundingClientRect().bottom"
            found = page.browser.execute_script(bottom, f"group_{name}")
            assert 0 < found <= height or window == "phone", name
    finally:
        page.browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_dark_system_has_a_dark_page_with_light_letters(page: Page) -> None:
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
    try:
        ground = "return getComputedStyle(document.body).backgroundColor"
        page.wait_until(lambda: page.browser.execute_script(ground) == "rgb(18, 22, 26)")
        title = FIND + "return model.title.text_color"
        page.wait_until(lambda: page.browser.execute_script(title, "fourier") == "#e3e8ed")
    finally:
        page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def focus(page: Page, name: str, selector: str) -> None:
    """The keyboard at a part of a widget."""
    page.browser.execute_script("arguments[0].focus()", page.element(name, selector))


FOCUSED = """
let at = document.activeElement
while (at?.shadowRoot?.activeElement) { at = at.shadowRoot.activeElement }
return [at.tagName, at.ariaLabel ?? "", getComputedStyle(at).outlineStyle]
"""


def test_the_tabulator_reaches_every_control_and_comes_to_an_end(page: Page) -> None:
    page.browser.execute_script("document.activeElement?.blur()")
    stops = []
    for _ in range(60):
        page.press("TAB")
        stops.append(tuple(page.browser.execute_script(FOCUSED)))
        if stops[-1][0] == "BODY":
            break
    tags = [tag for tag, _, _ in stops]
    labels = " ".join(label for _, label, _ in stops)
    assert tags[-1] == "BODY"  # nobody is kept in the table
    assert tags.count("INPUT") > 15 and tags.count("BUTTON") > 10
    for name in ("Vertices", "Defocus", "Near field at z", "Aperture", "|F(ν)|²", "W(x, ν) over x"):
        assert name in labels
    for tag, label, outline in stops[:-1]:  # where one is can be seen; the table has a frame
        assert outline != "none" or "Vertices" in label, (tag, label)


def test_everything_that_is_typed_or_pressed_has_a_name(page: Page) -> None:
    tree = page.browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    acting = {"button", "textbox", "combobox", "slider", "checkbox", "application"}
    found = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in tree
        if node.get("role", {}).get("value") in acting
    ]
    assert len(found) > 40
    assert [role for role, name in found if not name] == []


def test_a_slider_moves_its_view_and_no_other_number(page: Page) -> None:
    handle = page.element("defocus", ".noUi-handle")
    values = page.text("values")
    handle.send_keys("\ue014" * 3)  # arrow to the right: by keyboard
    page.wait_until(lambda: np.isclose(page.state().defocus, 0.15))
    assert page.text("values") == values


def test_a_file_is_sent_and_one_that_is_too_large_is_not(page: Page, tmp_path: Path) -> None:
    good, huge = tmp_path / "outline.wkt", tmp_path / "huge.wkt"
    good.write_text("POLYGON((0 0, 4 0, 4 2, 0 2, 0 0))")
    with huge.open("wb") as file:
        file.truncate(8 << 20)  # more than the connection takes
    page.element("upload", "input").send_keys(str(good))
    page.wait_until(lambda: page.state().rings[0][0] == (4, 0) and page.is_ready())
    page.element("upload", "input").send_keys(str(huge))
    page.wait_until(lambda: "8.0 MiB" in page.text("message"))
    page.element("upload", "input").send_keys(str(good))  # the page is still there
    page.wait_until(lambda: page.text("message") == "" and page.is_ready())


def test_the_address_follows_and_has_room_for_long_links(browser: Any, address: str) -> None:
    state = State(taper="cosine", x=(1.0, 2.0), nu=(0.03, 0.0), defocus=0.5, unit="cm")
    page = Page(browser, f"{address}?{to_query(state)}")
    page.wait_until(lambda: "?" in browser.current_url)
    assert from_query(browser.current_url.split("?")[1]) == state == page.state()
    long = "x" * 45_000  # as of a thousand vertices
    page = Page(browser, f"{address}?unit=furlong&taper={long}")
    assert "furlong" in page.text("message") and page.state() == State()


def test_a_view_is_downloaded_as_python_code(page: Page) -> None:
    page.click("take_py")
    script = page.downloaded("wigner_nu.py").read_text(encoding="utf-8")
    assert script == page.get("code", "value")


WATCH = """
const doc = Bokeh.documents[0], root = Bokeh.index.find_one(doc.get_model_by_name("page"))
window.watched = {messages: 0, layouts: 0}
for (const [object, name, count] of [
  [doc, "apply_json_patch", "messages"], [root, "compute_layout", "layouts"],
]) {
  const before = object[name]
  object[name] = function (...all) { window.watched[count] += 1; return before.apply(this, all) }
}
"""


def test_an_edit_is_answered_in_few_messages_and_lays_nothing_out_anew(page: Page) -> None:
    """Bokeh's own ways take three times as long; a new version of it may go round ours."""
    page.browser.execute_script(WATCH)
    values = page.text("values")
    rows = {"ring": [1] * 4, "x": [-5, 5, 5.5, -5], "y": [-5, -5, 5, 5]}
    page.set("rows", "data", rows)
    page.wait_until(lambda: page.text("values") != values and page.is_ready())
    watched = page.browser.execute_script("return window.watched")
    assert 0 < watched["messages"] <= 9  # the state, and at most one for each view
    assert watched["layouts"] <= 2  # where labels of an axis have become wider


def test_a_port_in_use_is_told_in_one_line(
    address: str, capsys: pytest.CaptureFixture[str]
) -> None:
    port = str(urlsplit(address).port)
    assert main(["explore", "--no-browser", "--port", port]) == 2
    errors = capsys.readouterr().err
    assert f"{port}, which is in use" in errors and errors.count("\n") == 1


def test_the_command_prints_its_address_and_stops_cleanly(bokeh: None) -> None:
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


def test_without_the_extra_the_command_names_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "bokeh"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    assert main(["explore"]) == 2
    errors = capsys.readouterr().err
    assert ".[explorer]" in errors and errors.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["missing.geojson"], "not a file"),
        (["--frequency", "ten"], "frequency"),
        (["--address", "203.0.113.1", "--port", "0"], "--address"),
        (["--address", "", "--port", "0"], "expected an address to listen at"),
        (["--address", " ", "--port", "0"], "expected an address to listen at"),
        (["--allow-host", "*", "--port", "0"], "--allow-host"),
        (["--port", "-4"], "port"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    options: list[str], match: str, bokeh: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explore", "--no-browser", *options]) == 2
    errors = capsys.readouterr().err
    assert match in errors and errors.count("\n") == 1
