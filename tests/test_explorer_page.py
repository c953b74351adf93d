"""The server and the page of the explorer, in headless Chromium."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

import polywigner.explorer

pytestmark = pytest.mark.slow

SECONDS = 60.0  # longest wait on a busy machine


@contextmanager
def serving(*command):
    """Start a server, and yield the address that it prints."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen([sys.executable, "-m", *command], **pipes) as server:
        try:
            addresses = (re.search(r"http://[^ ]+[^ \n]", line) for line in server.stdout)
            yield next(filter(None, addresses)).group()
        finally:
            server.kill()


@pytest.fixture(scope="module")
def address(leave_out):
    if importlib.util.find_spec("panel") is None:
        leave_out('Panel. `pip install ".[explorer]"` brings it.')
    with serving("polywigner", "explore", "--no-browser", "--port", "0") as address:
        yield address


@pytest.fixture(scope="module")
def browser(address, tmp_path_factory, leave_out):
    """Yield a headless Chromium that can reach this machine only."""
    if importlib.util.find_spec("selenium") is None:
        leave_out('Selenium. `pip install ".[browser]"` brings it.')
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if program is None or driver is None:
        leave_out("a browser. Debian: `apt-get install chromium chromium-driver`.")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in (
        "headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage",
        "disable-background-networking", "window-size=1400,1300",
        "host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    ):  # fmt: skip
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    folder = tmp_path_factory.mktemp("downloads")
    chromium = webdriver.Chrome(options, service=webdriver.ChromeService(driver))
    settings = {"behavior": "allow", "downloadPath": str(folder)}
    chromium.execute_cdp_cmd("Browser.setDownloadBehavior", settings)
    chromium.downloads = folder
    yield chromium
    chromium.quit()


# The elements of the page are in shadow trees, so their models are found through Bokeh's document.
MODELS = """
const doc = Bokeh.documents[0]
const named = (name) => doc.get_model_by_name(name)
const labelled = (text) => [...doc._all_models.values()].find(
  (m) => [m.label, m.title, m.name].includes(text) && Bokeh.index.find_one(m)?.el)
const element = (text, selector) =>
  Bokeh.index.find_one(labelled(text)).shadow_el.querySelector(selector)
const at = (name, x, y) => {
  const view = Bokeh.index.find_one(named(name))
  view.el.scrollIntoView({block: 'center'})
  const box = view.el.getBoundingClientRect()
  return [box.left + view.frame.x_scale.compute(x), box.top + view.frame.y_scale.compute(y)]
}
"""


class Page:
    """Operations of a user on the page."""

    def __init__(self, browser, address):
        self.browser = browser
        browser.get(address)
        self.wait(self.is_ready)

    def js(self, code, *arguments):
        return self.browser.execute_script(MODELS + code, *arguments)

    def wait(self, holds):
        from selenium.common.exceptions import WebDriverException

        deadline = time.monotonic() + SECONDS
        while time.monotonic() < deadline:
            try:
                if holds():
                    return
            except WebDriverException:
                pass
            time.sleep(0.05)
        raise AssertionError(f"not after {SECONDS} s; the page shows {self.messages()}")

    def messages(self):
        return self.js(
            "return [...doc._all_models.values()].filter((m) => m.visible && m.text)"
            ".map((m) => String(m.text))"
        )

    def is_ready(self):
        return "ready" in self.messages()

    def shows(self, text):
        return any(text in message for message in self.messages())

    def vertices(self):
        return self.js("const d = named('vertices').data; return [[...d.x], [...d.y]]")

    def image(self, name):
        values = self.js(
            "const [image] = named(arguments[0]).renderers[0].data_source.data.image;"
            "return [...image]",
            name,
        )
        return np.array(values)

    def mouse(self, name, x, y):
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.actions.action_builder import ActionBuilder
        from selenium.webdriver.common.actions.pointer_input import PointerInput

        chain = ActionChains(self.browser)
        chain.w3c_actions = ActionBuilder(
            self.browser, mouse=PointerInput("mouse", "mouse"), duration=20
        )
        px, py = self.js("return at(...arguments)", name, x, y)
        chain.w3c_actions.pointer_action.move_to_location(round(px), round(py))
        return chain.w3c_actions

    def click(self, name, x, y, double=False):
        actions = self.mouse(name, x, y)
        for _ in range(1 + double):
            actions.pointer_action.click()
        actions.perform()
        time.sleep(0.5)  # two clicks must not count as a double click

    def drag(self, start, end, steps=5):
        actions = self.mouse("editor", *start)
        actions.pointer_action.pointer_down()
        for k in range(1, steps + 1):
            x, y = (a + (b - a) * k / steps for a, b in zip(start, end, strict=True))
            px, py = self.js("return at('editor', ...arguments)", x, y)
            actions.pointer_action.move_to_location(round(px), round(py))
        actions.pointer_action.pointer_up()
        actions.perform()

    def press(self, label, selector="button"):
        button = self.js("return element(...arguments)", label, selector)
        self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
        button.click()

    def choose(self, label, value):
        self.js(
            "const select = element(arguments[0], 'select'); select.value = arguments[1];"
            "select.dispatchEvent(new Event('change'))",
            label, value,
        )  # fmt: skip

    def slide(self, label, value):
        self.js("const m = labelled(arguments[0]); m.value = arguments[1]; "
                "m.value_throttled = arguments[1]", label, value)  # fmt: skip


@pytest.fixture
def page(browser, address):
    return Page(browser, address)


def test_all_views_are_drawn_without_errors_or_requests_to_other_hosts(page):
    for name in ("fourier", "wigner_nu", "wigner_x", "ambiguity", "otf", "near"):
        assert page.image(name).std() > 0
    assert page.js("return named('far').renderers[0].data_source.data.xs.length") == 2
    assert page.js("return named('lags').renderers[0].data_source.data.xs.length") == 2
    errors = [e for e in page.browser.get_log("browser") if e["level"] == "SEVERE"]
    assert errors == []
    events = [json.loads(e["message"])["message"] for e in page.browser.get_log("performance")]
    urls = [e["params"]["request"]["url"] for e in events if e["method"].endswith("WillBeSent")]
    assert {u.split("/")[2] for u in urls if u.startswith("http")} == {urls[0].split("/")[2]}


def test_dragging_a_vertex_changes_the_views_and_undo_takes_it_back(page):
    before, image = page.vertices(), page.image("fourier")
    page.drag((10, -2), (12, 3))
    page.wait(lambda: page.is_ready() and page.vertices() != before)
    x, y = page.vertices()
    k = x.index(max(x))
    assert (x[k], y[k]) == pytest.approx((12, 3), abs=0.2)
    page.wait(lambda: not np.array_equal(page.image("fourier"), image))
    page.press("Undo")
    page.wait(lambda: page.vertices() == before)
    page.press("Redo")
    page.wait(lambda: page.vertices() == [x, y])


def test_a_double_click_inserts_a_vertex_and_the_button_deletes_it(page):
    page.click("editor", -5, 2, double=True)
    page.wait(lambda: len(page.vertices()[0]) == 7)
    k = page.vertices()[0].index(min(page.vertices()[0], key=lambda x: abs(x + 5)))
    page.click("editor", *(c[k] for c in page.vertices()))
    page.press("Delete vertex")
    page.wait(lambda: len(page.vertices()[0]) == 6)


def test_an_outline_is_drawn_by_clicks_and_a_second_one_is_a_hole(page):
    page.choose("Start from", "blank sheet")
    page.wait(lambda: page.vertices() == [[], []])
    for size in (9, 4):
        if size == 4:
            page.press("Draw outline")
        page.wait(lambda: page.js("return labelled('Finish outline') !== undefined"))
        corners = [(-size, -size), (size, -size), (size, size), (-size, size)]
        for corner in (*corners, corners[0]):
            page.click("editor", *corner)
        page.wait(lambda size=size: len(page.vertices()[0]) == (4 if size == 9 else 8))
    page.wait(page.is_ready)
    assert page.js("return named('lags').renderers[0].data_source.data.xs.length") == 1


def test_an_outline_that_crosses_itself_is_named_and_the_figures_are_pale_until_undone(page):
    opacity = """
const all = [...doc._all_models.values()].find((m) => m.styles?.['grid-area'] === 'views')
return getComputedStyle(Bokeh.index.find_one(all).el).opacity"""
    page.drag((10, -2), (-12, 8))
    page.wait(lambda: page.shows("earlier outline") and float(page.js(opacity)) < 0.5)
    page.press("Undo")
    page.wait(lambda: page.is_ready() and float(page.js(opacity)) == 1)


def test_sliders_and_catalogue_change_the_views(page):
    page.choose("Start from", "hexagon")
    page.wait(lambda: page.is_ready() and len(page.vertices()[0]) == 6)
    image = page.image("otf")
    page.slide("Defocus W20 (waves)", 1.5)
    page.wait(lambda: not np.array_equal(page.image("otf"), image))
    assert page.image("otf").max() == pytest.approx(1, abs=0.05)
    page.slide("Wavelength (mm)", 0.0)
    wave = "return labelled('Frequency or wavelength').value"
    page.wait(lambda: page.is_ready() and page.js(wave) == "1 mm")
    page.slide("Steering θ (degrees)", 20)
    page.wait(page.is_ready)
    page.choose("F(ν) as", "phase")
    page.wait(lambda: page.image("fourier").min() < -170)


def test_a_click_into_the_transform_chooses_the_frequency(page):
    page.click("fourier", 0.1, 0.05)
    page.wait(lambda: "(0, 0)" not in page.js("return named('wigner_x').title.text"))
    page.click("editor", 4, 2)
    page.wait(lambda: "(0, 0)" not in page.js("return named('wigner_nu').title.text"))


def test_files_are_read_and_bad_ones_are_named(page, tmp_path):
    good, bad = tmp_path / "slot.wkt", tmp_path / "bad.wkt"
    good.write_text("POLYGON ((0 0, 4 0, 4 1, 0 1, 0 0))")
    bad.write_text("POLYGON ((0 0, 4")
    find = "return [...doc._all_models.values()].find((m) => 'mime_type' in m).id"
    element = "return Bokeh.index.find_one(doc.get_model_by_id(arguments[0])).shadow_el" \
        ".querySelector('input')"  # fmt: skip
    upload = page.js(element, page.js(find))
    upload.send_keys(str(bad))
    page.wait(lambda: page.shows("bad.wkt"))
    upload.send_keys(str(good))
    page.wait(lambda: sorted(page.vertices()[0]) == [0, 0, 4, 4])


@pytest.fixture(params=[1400, 390])
def width(request, browser):
    """Width of the browser window in pixels: desktop and phone."""
    size = {"width": request.param, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    yield request.param
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_the_page_fits_into_the_window_and_figures_values_and_code_are_saved(width, page):
    page.wait(lambda: page.js("return document.documentElement.scrollWidth") <= width)
    page.js("for (const m of doc._all_models.values()) if (m.collapsed) m.collapsed = false")
    page.wait(lambda: page.shows("pw.fourier"))
    page.wait(lambda: page.js("return labelled('npz of the view') !== undefined"))
    page.js("named('otf').toolbar.tools.find((t) => t.type === 'SaveTool').do.emit()")
    page.press("npz of the view", "a, button")
    page.press("GeoJSON of the aperture", "a, button")
    starts = {"otf.png": b"\x89PNG", "fourier.npz": b"PK", "aperture.geojson": b"{"}
    for name, start in starts.items():
        path = page.browser.downloads / name
        page.wait(path.exists)
        assert path.read_bytes().startswith(start)
        path.unlink()


def test_panel_serve_shows_the_page_too(browser):
    app = Path(polywigner.explorer.__file__).with_name("page.py")
    with serving("panel", "serve", str(app), "--address", "127.0.0.1", "--port", "0") as address:
        page = Page(browser, address)
        page.choose("Start from", "hexagon")
        page.wait(lambda: page.is_ready() and len(page.vertices()[0]) == 6)


@pytest.mark.parametrize(
    ("host", "status"),
    [("127.0.0.1:{}", 200), ("localhost:{}", 200), ("evil.example:{}", 403), ("127.0.0.1", 403)],
)
@pytest.mark.parametrize("path", ["/", "/ws"])
def test_foreign_hosts_are_refused_even_with_the_same_origin(address, host, status, path):
    port = urlsplit(address).port
    name = host.format(port)
    headers = {"Host": name, "Origin": f"http://{name}"}
    if path == "/ws":
        headers |= {
            "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "bokeh, x",
        }  # fmt: skip
    connection = HTTPConnection("127.0.0.1", port, timeout=SECONDS)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse().status
    connection.close()
    assert response == {"/": status, "/ws": {200: 101}.get(status, status)}[path]
