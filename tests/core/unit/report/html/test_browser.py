"""The pages in headless Chromium without a network: nothing complains, what is there is seen, what is clicked works."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.slow  # starts a browser, and draws in software


def colours(browser, selector):
    """Number of different colours of an element on the screen."""
    browser.run("return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    url = browser.run("return document.querySelector(arguments[0]).toDataURL('image/png')", selector)
    image = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB")
    return len(np.unique(np.asarray(image).reshape(-1, 3), axis=0))


def test_the_page_of_a_flight_shows_it_and_can_be_played(browser, flight_html, flight):
    browser.open(flight_html)
    assert browser.text("h1") == flight.title
    assert browser.count(".flights tbody tr") == 2
    assert browser.count(".chart canvas") >= 3
    assert colours(browser, ".stage canvas") > 50
    fault = flight.data["fault"]
    assert float(browser.run("return player.time")) == pytest.approx(fault)
    browser.click(".play")
    browser.until(f"return player.time > {fault} + 0.2")
    browser.click(".play")
    assert browser.run("return player.playing") is False
    assert browser.complaints() == []


@pytest.mark.long
def test_keys_and_the_slider_move_through_the_flight(browser, flight_html, flight):
    browser.open(flight_html)
    press = """document.querySelector('.stage canvas').dispatchEvent(
        new KeyboardEvent('keydown', {key: arguments[0], bubbles: true}))"""
    browser.run(press, "Home")
    assert browser.text(".controls output") == "0.00 s"
    browser.run(press, "ArrowRight")
    assert browser.text(".controls output") == "0.10 s"
    browser.run(press, "f")
    assert browser.text(".controls output") == f"{flight.data['fault']:.2f} s"
    browser.run("const s = document.querySelector('.track input'); s.value = 5; s.dispatchEvent(new Event('input'))")
    assert browser.run("return player.time") == pytest.approx(5.0)
    assert browser.run("return document.querySelector('.playhead').hidden") is True  # 5 s is not around the fault


@pytest.mark.long
def test_the_camera_and_the_colours_change(browser, flight_html):
    browser.open(flight_html)
    before = browser.run("return player.scene.camera.position.toArray()")
    browser.click("[data-view=above]")
    assert browser.run("return player.scene.camera.position.toArray()") != before
    assert browser.run("return document.querySelector('[data-view=above]').getAttribute('aria-pressed')") == "true"
    paper = "return getComputedStyle(document.body).backgroundColor"
    light = browser.run(paper)
    browser.click(".theme")
    assert browser.run(paper) != light
    assert browser.complaints() == []


def test_without_webgl_the_flight_is_shown_from_above(browser, flight_html, tmp_path):
    page = tmp_path / "flat.html"
    broken = """<body><script>
        const own = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
            return kind.startsWith("webgl") ? null : own.call(this, kind, ...more);
        };
        </script>"""
    page.write_text(flight_html.read_text(encoding="utf-8").replace("<body>", broken, 1), encoding="utf-8")
    browser.open(page)
    assert browser.run("return getComputedStyle(document.querySelector('.plan')).display") == "block"
    assert browser.count(".plan polyline") == 2
    keys = browser.run("return document.querySelector('.keys').innerText")
    assert keys.startswith("Keys: space plays"), "nothing can be turned"
    browser.click(".to-fault")


@pytest.mark.parametrize("page", ["flight_html", "report_html"])
@pytest.mark.long
def test_pages_never_scroll_sideways_and_load_nothing(browser, request, page):
    browser.open(request.getfixturevalue(page), width=400)
    assert browser.run("return document.documentElement.scrollWidth") <= 400
    assert browser.run("return performance.getEntriesByType('resource').map((entry) => entry.name)") == []
    unnamed = """const controls = document.querySelectorAll('button, a[href], input, select, canvas[role=img]');
        return [...controls].filter((node) =>
        !node.textContent.trim() && !node.getAttribute('aria-label') && !node.labels?.length).length"""
    assert browser.run(unnamed) == 0
    assert browser.complaints() == []


def test_a_cell_opens_exactly_the_runs_behind_it(browser, report_html):
    browser.open(report_html)
    browser.click(".headline .data td a")
    counted = browser.run("return document.querySelector('.headline .data td a').parentElement.textContent")
    n = int(counted.rpartition("/")[2])
    browser.until("return location.hash.startsWith('#runs')")
    browser.until(f"return document.getElementById('runs-summary').textContent.startsWith('{n} of ')")
    assert browser.count(".runs tbody tr") == n
    assert browser.complaints() == []


def test_a_point_of_a_figure_opens_its_runs(browser, report_html):
    browser.open(report_html)
    browser.driver.find_element("css selector", "figure a[aria-label*='setting fi']").click()
    browser.until("return document.getElementById('runs-summary').textContent.includes('arm fi')")
    assert not browser.text("#runs-summary").startswith("0 of")
    assert len(browser.driver.window_handles) == 1


def test_filters_narrow_the_list(browser, report_html, runs):
    browser.open(report_html)
    browser.run("""const select = document.querySelector('.filters [name=effect]');
        select.value = 'masked';
        select.dispatchEvent(new Event('input', {bubbles: true}))""")
    masked = len(runs.where(effect="masked"))
    assert browser.text("#runs-summary").startswith(f"{masked} of {len(runs)} runs")
    browser.click(".filters [type=reset]")
    browser.until(f"return document.getElementById('runs-summary').textContent.startsWith('{len(runs)} of')")


@pytest.mark.long
def test_the_page_of_a_run_has_its_flight_and_the_way_back(browser, report_html, runs):
    browser.open(report_html, fragment="#runs?flight=yes")
    assert browser.count(".runs tbody tr") == 2
    browser.click(".runs tbody a")
    browser.until("return document.querySelector('#run .flight canvas')")
    assert browser.run("return document.getElementById('report').hidden") is True
    assert browser.text("#run h1").startswith("Fault in ")
    assert colours(browser, "#run .stage canvas") > 50
    assert "mavfi replay" in browser.text("#run .commands")
    browser.click(".back")
    browser.until("return !document.getElementById('report').hidden")
    golden = runs.golden["run_id"][0]
    browser.open(report_html, fragment=f"#run/{golden}")
    assert browser.count("#run .flight") == 0
    assert f"mavfi replay {'/'}" in browser.text("#run .place")
    assert browser.complaints() == []
