"""`mavfi serve` in headless Chromium: a campaign is opened, its runs are sorted and filtered, a run is flown."""

import threading
import time

import pytest
import uvicorn

from mavfi.extras.serve.app import HOST, application
from mavfi.extras.serve.flights import RequestedFlights
from tests.extras.serve.conftest import TOKEN


@pytest.fixture
def address(flown):
    flights = RequestedFlights()
    config = uvicorn.Config(application(flown, TOKEN, flights), host=HOST, port=0, lifespan="off", log_level="critical")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        while not server.started:
            time.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        yield f"http://{HOST}:{port}/?token={TOKEN}"
    finally:
        flights.close()
        server.should_exit = True
        thread.join()


def stages(browser):
    return browser.run("""const heads = Array.from(document.querySelectorAll('.runs th'));
        const index = heads.findIndex((head) => head.dataset.column === 'stage');
        return Array.from(document.querySelectorAll('.runs tbody tr'), (row) => row.cells[index].textContent)""")


def test_a_run_is_found_and_flown(browser, address):
    browser.driver.get(address)
    browser.until("return document.querySelectorAll('.runs tbody tr').length")
    assert browser.driver.current_url.endswith("/campaign/")
    assert browser.text(".tiles dt") == "Without a fault"

    # sort by the stage of the fault, which the golden run has not, and search
    struck = sorted(filter(None, stages(browser)))
    browser.click(".runs [data-column=stage] button")
    assert stages(browser) == [*struck, ""]
    browser.click(".runs [data-column=stage] button")
    assert stages(browser) == [*struck[::-1], ""]
    browser.run("""const search = document.querySelector('.filters [type=search]');
        search.value = 'FI planning';
        search.dispatchEvent(new Event('input', {bubbles: true}))""")
    assert browser.count(".runs tbody tr") == 1

    # a click anywhere in the row flies the run
    browser.run("document.querySelector('.runs tbody td:nth-child(2)').click()")
    browser.until("return document.querySelector('#run .flight canvas')", seconds=60)
    assert browser.text("#run h1").startswith("Fault in planning.")
    assert browser.count(".flights tbody tr") == 2

    # narrow, the page is not wider than the screen
    metrics = {"width": 400, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    assert browser.run("return document.documentElement.scrollWidth") <= 400
    assert browser.complaints() == []
