"""Make the pictures of the explorer's page, from the real page in Chromium.

    python docs/make_explorer_images.py

Needs `pip install ".[browser]"` in a clone, and chromium with chromium-driver of the system.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from polywigner.explorer.outlines import rings_of_aperture
from polywigner.explorer.state import CATALOGUE, State, to_query

IMAGES = Path(__file__).parent / "images"
SECONDS = 120.0

CHEVRON = State(rings=rings_of_aperture(CATALOGUE["chevron"]()), x=(-4.0, 0.0), nu=(0.05, 0.08))
STAR = State(rings=rings_of_aperture(CATALOGUE["star"]()), distance=25.0)
MODEL = "Bokeh.documents[0].get_model_by_name(arguments[0])"


def browser() -> Any:
    """Chromium without a window."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for argument in ("headless=new", "no-sandbox", "disable-gpu", "hide-scrollbars"):
        options.add_argument(f"--{argument}")
    return webdriver.Chrome(options, service=webdriver.ChromeService(shutil.which("chromedriver")))


def wait(driver: Any) -> None:
    """Until all pictures are there."""
    deadline = time.monotonic() + SECONDS
    ready = "return (window.Bokeh?.documents[0]?.get_model_by_name('busy')?.text ?? '')"
    while "ready" not in driver.execute_script(ready):
        if time.monotonic() > deadline:
            raise TimeoutError("the page is not ready")
        time.sleep(0.2)
    time.sleep(1)  # painted


def main() -> None:
    command = [sys.executable, "-m", "polywigner", "explore", "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        found = re.search(r"http://\S+", server.stdout.readline())
        assert found
        driver = browser()
        try:
            driver.set_window_size(1440, 1010)
            driver.get(f"{found[0]}?{to_query(CHEVRON)}")
            wait(driver)
            driver.save_screenshot(str(IMAGES / "explorer.png"))
            driver.set_window_size(1440, 1560)
            driver.get(f"{found[0]}?{to_query(STAR)}")
            wait(driver)
            driver.execute_script(f"{MODEL}.active = [0, 1, 2, 3, 4, 5]", "views")
            time.sleep(1)
            wait(driver)
            driver.save_screenshot(str(IMAGES / "explorer_near_field.png"))
        finally:
            driver.quit()
            server.terminate()


if __name__ == "__main__":
    main()
