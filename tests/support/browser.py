"""A real browser without a window, for tests of pages."""

import shutil
import time

import pytest

REMEDY = "no Chromium with its driver here: apt install chromium chromium-driver"
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"),
    *("--no-first-run", "--disable-quic", "--disable-sync", "--disable-component-update"),
    *("--disable-background-networking", "--hide-scrollbars"),
)
PATIENCE = 20.0


def open_browser(profile):
    """A browser with an empty profile in a folder; skips the test where there is none."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip(REMEDY)
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))


class Reader:
    """Reads and presses what is on a page as somebody in front of it would."""

    def __init__(self, browser):
        self.browser = browser

    def show(self, url, width=1280, height=900, *, is_dark=False):
        """Opens a page in a window of a size, by day or by night."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        self.browser.get("about:blank")
        self.browser.get_log("browser")
        self.browser.get(url)

    def all(self, selector):
        """The elements."""
        return self.browser.find_elements("css selector", selector)

    def text(self, selector):
        """What the first element says."""
        return self.all(selector)[0].text

    def click(self, selector):
        """Clicks the first element."""
        self.all(selector)[0].click()

    def press(self, keys):
        """Presses keys on the page."""
        self.all("body")[0].send_keys(keys)

    def run(self, code):
        """What a piece of JavaScript returns."""
        return self.browser.execute_script(code)

    def until(self, condition):
        """Waits until something holds and returns it."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            found = condition()
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError(f"not within {PATIENCE:.0f} s; mode {self.text('#mode')!r}")

    def errors(self):
        """What the browser has complained about since the page was opened."""
        return [entry["message"] for entry in self.browser.get_log("browser")]
