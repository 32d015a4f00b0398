"""A headless browser for tests of pages."""

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
    """Starts a browser with an empty profile; skips the test if no browser is installed."""
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
    """Reads and operates a page as a user would."""

    def __init__(self, browser):
        self.browser = browser

    def show(self, url, width=1280, height=900, *, is_dark=False):
        """Opens a page with a window size, in the light or the dark color scheme."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        self.browser.get("about:blank")
        self.browser.get_log("browser")
        self.browser.get(url)

    def all(self, selector):
        """Returns the elements that match a selector."""
        return self.browser.find_elements("css selector", selector)

    def text(self, selector):
        """Returns the text of the first matching element."""
        return self.all(selector)[0].text

    def click(self, selector):
        """Clicks the first matching element."""
        self.all(selector)[0].click()

    def press(self, keys):
        """Presses keys on the page."""
        self.all("body")[0].send_keys(keys)

    def run(self, code):
        """Runs JavaScript code and returns its result."""
        return self.browser.execute_script(code)

    def until(self, condition):
        """Waits until a condition holds and returns its value."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            found = condition()
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError(f"not within {PATIENCE:.0f} s; mode {self.text('#mode')!r}")

    def errors(self):
        """Returns the messages in the browser's log since the page was opened."""
        return [entry["message"] for entry in self.browser.get_log("browser")]
