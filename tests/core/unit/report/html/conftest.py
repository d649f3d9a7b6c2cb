import shutil
import time

import pytest

from mavfi.api import fly
from mavfi.flight.host import ArmSetup
from mavfi.report.campaign_report import report_of
from mavfi.report.html.flight_page import page_of_result, write_flight_page
from mavfi.report.html.report_page import write_html

FAULT = "state:planning.waypoint.x:bit=62@20.0"
COMMAND = f"mavfi fly --environment sparse --seed 7 --fault {FAULT}"
_CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # the network is off
)


@pytest.fixture(scope="session")
def result():
    return fly(environment="sparse", seed=7, fault=FAULT)


@pytest.fixture(scope="session")
def flight(result):
    return page_of_result(result, ArmSetup(result.scenario), result.scenario, COMMAND)


@pytest.fixture(scope="session")
def flight_html(flight, tmp_path_factory):
    return write_flight_page(tmp_path_factory.mktemp("pages") / "flight.html", flight)


@pytest.fixture(scope="session")
def report_html(flown, runs, tmp_path_factory):
    path = tmp_path_factory.mktemp("pages") / "report.html"
    assert write_html(path, flown, report_of(runs), 2, 1).stored == 2
    return path


class Browser:
    """A headless Chromium with one page."""

    def __init__(self, driver):
        self.driver = driver

    def open(self, path, *, width=1440, height=900, fragment=""):
        self.driver.get("about:blank")
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
        )
        self.driver.get(f"file://{path}{fragment}")

    def run(self, script, *values):
        return self.driver.execute_script(script, *values)

    def text(self, selector):
        return self.run("return document.querySelector(arguments[0]).textContent", selector)

    def count(self, selector):
        return self.run("return document.querySelectorAll(arguments[0]).length", selector)

    def click(self, selector):
        self.run("const found = document.querySelector(arguments[0]); found.focus(); found.click()", selector)

    def until(self, script, seconds=10.0):
        """Wait until a script gives something true, and give it."""
        end = time.monotonic() + seconds
        while not (value := self.run(script)):
            assert time.monotonic() < end, script
            time.sleep(0.05)
        return value

    def complaints(self):
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


@pytest.fixture(scope="session")
def driver(tmp_path_factory):
    """Chromium, driven by Debian's chromedriver."""
    binary = next(filter(None, map(shutil.which, _CHROMIUM)), None)
    service = shutil.which("chromedriver")
    if binary is None or service is None:
        pytest.skip("needs Chromium and its driver: apt-get install chromium chromium-driver")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for option in (*_OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(service))
    yield chrome
    chrome.quit()


@pytest.fixture
def browser(driver):
    driver.get_log("browser")
    return Browser(driver)
