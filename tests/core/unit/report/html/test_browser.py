"""The pages in headless Chromium without a network: nothing complains, what is there is seen, what is clicked works."""

import base64
import io
import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from mavfi.analysis.measures import leading_faults
from mavfi.extras.paper.views import by_bits
from mavfi.report.campaign_report import report_of
from mavfi.report.figures import figure
from mavfi.report.html.flight_page import Course, FlightPage, write_flight_page
from mavfi.report.html.report_page import Drawn, PageSection, ReportedCampaign, write_report_page
from tests.core.unit.report.html.made import scene, straight

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


def test_a_chart_marks_what_is_off_the_scale_with_its_sign(browser, flight, tmp_path):
    data = {"golden": [[19.0, 24.0], [1.0, 1.0]], "injected": [[19.0, 20.0, 22.0, 23.0], [1.0, -3.3e39, 1.0, 9e9]]}
    line = {"label": "planning.path.y[2]", "unit": "m", "site": True, "window": [19.0, 24.0], "data": data}
    browser.open(write_flight_page(tmp_path / "off.html", replace(flight, data=flight.data | {"lines": [line]})))
    assert browser.text(".chart p") == "Off the scale (▴ ▾): with the fault down to −3.30e+39, up to 9.00e+9."
    assert browser.complaints() == []
    browser.run("return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    in_each_second = """const {ctx, bbox: {left, top, width, height}} = player.charts.plots[0].plot;
        const [down] = arguments, y = down < 0 ? top + height + down : top + down;
        const row = ctx.getImageData(left, y, width, 1);
        return [0, 1, 2, 3, 4].map((second) => {
            const first = Math.ceil(second * width / 5) + 3, end = Math.floor((second + 1) * width / 5) - 3;
            const reds = Array.from({length: end - first}, (_, x) => row.data[4 * (first + x) + 3] > 200
                && row.data[4 * (first + x)] > 190 && row.data[4 * (first + x) + 2] < 80);
            return reds.filter(Boolean).length;
        });"""
    above, below = browser.run(in_each_second, 5), browser.run(in_each_second, -6)  # rows through the triangles
    assert above[:4] == [0, 0, 0, 0] and above[4] > 0
    assert below[1] > 0 and [below[0], *below[3:]] == [0, 0, 0]
    assert browser.run(in_each_second, -1)[2] == 0  # no line along the edge
    assert browser.run("return player.charts.plots[0].times") == [19.0, 24.0]


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


def test_a_scan_is_drawn_as_voxels(browser, tmp_path):
    occupied = np.zeros((60, 20, 12), bool)
    occupied[20:22, 8:12, :8] = True
    scan = scene(occupied=occupied, origin=np.array([0.0, -10, 0]), resolution=1.0)
    flown = FlightPage.of(
        "scan", [("verdict", "reached the goal")], [], [Course("golden", "golden run", straight(900))], scan
    )
    browser.open(write_flight_page(tmp_path / "scan.html", flown))
    assert colours(browser, ".stage canvas") > 30
    assert browser.count(".plan rect") == 8
    assert browser.text(".lines-title") == "Speed and height"
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
    browser.click(".to-fault")


@pytest.mark.parametrize("page", ["flight_html", "report_html"])
@pytest.mark.parametrize("width", [400, 1440])
def test_pages_never_scroll_sideways_and_load_nothing(browser, request, page, width):
    browser.open(request.getfixturevalue(page), width=width)
    assert browser.run("return document.documentElement.scrollWidth") <= width
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


def test_a_box_and_a_curve_open_exactly_their_runs(browser, flown, runs, tmp_path):
    figures = [Drawn(name, figure(runs, name), name) for name in ("bit_fields", "flight_time")]
    page = tmp_path / "figures.html"
    write_report_page(
        page, [ReportedCampaign(flown, report_of(runs))], [PageSection("first"), PageSection("second", (), figures)], []
    )
    browser.open(page)
    shown = by_bits(runs).where("success", bits="mantissa")
    box = f"figure a[aria-label='{len(shown)} runs: environment sparse, bits mantissa']"
    right_end = """const band = document.querySelector(arguments[0]);
        band.scrollIntoView({block: "center", behavior: "instant"});
        const box = band.getBoundingClientRect();
        return [box.right - 2, box.y + box.height / 2];"""
    browser.click_at(*browser.run(right_end, box))
    browser.until(f"return document.getElementById('runs-summary').textContent.startsWith('{len(shown)} of ')")
    listed = browser.run(
        "return [...document.querySelectorAll('.runs tbody td:first-child a')].map((a) => a.textContent)"
    )
    assert sorted(listed) == sorted(shown["run_id"])
    assert "bit class mantissa" in browser.text("#runs-summary")
    on_curve = """const line = document.querySelector(arguments[0] + ' path');
        line.scrollIntoView({block: 'center', behavior: 'instant'});
        const place = line.getPointAtLength(0.7 * line.getTotalLength()).matrixTransform(line.getScreenCTM());
        return document.elementFromPoint(place.x, place.y).closest('a')?.getAttribute('aria-label')"""
    n = len(leading_faults(runs).where(setting="dr_idle"))
    label = f"{n} runs: environment sparse, setting dr_idle"
    assert browser.run(on_curve, f"svg[aria-label=flight_time] a[aria-label='{label}']") == label
    assert browser.complaints() == []


CENTRE = """
const dot = document.querySelectorAll("g.dots")[arguments[0]].querySelectorAll("use")[arguments[1]];
dot.scrollIntoView({block: "center", behavior: "instant"});
const box = dot.getBoundingClientRect();
return [box.x + box.width / 2, box.y + box.height / 2];
"""


def test_each_dot_of_a_box_opens_its_run(browser, flown, runs, tmp_path):
    page = tmp_path / "figures.html"
    figures = [Drawn("bit_fields", figure(runs, "bit_fields"), "bit_fields")]
    write_report_page(
        page, [ReportedCampaign(flown, report_of(runs))], [PageSection("first"), PageSection("second", (), figures)], []
    )
    browser.open(page)
    shown = by_bits(runs).where("success", bits="mantissa")
    group = list(by_bits(runs).groups("bits")).index(("mantissa",))
    times = []
    for place in range(len(shown)):
        browser.run("location.hash = ''")
        browser.until("return !document.getElementById('report').hidden")
        where = None
        while (now := browser.run(CENTRE, group, place)) != where:  # the page may still be laid out
            where = now
            time.sleep(0.1)
        browser.click_at(*where)
        browser.until("return location.hash.startsWith('#run/')")
        times.append(browser.run("return location.hash").removeprefix("#run/"))
    assert times == shown["run_id"]
    assert browser.complaints() == []


def test_filters_narrow_the_list(browser, report_html, runs):
    browser.open(report_html)
    browser.run("""const select = document.querySelector('.filters [name=effect]');
        select.value = 'masked';
        select.dispatchEvent(new Event('input', {bubbles: true}))""")
    masked = len(runs.where(effect="masked"))
    assert browser.text("#runs-summary").startswith(f"{masked} of {len(runs)} runs")
    browser.click(".filters [type=reset]")
    browser.until(f"return document.getElementById('runs-summary').textContent.startsWith('{len(runs)} of')")


def test_the_page_of_a_run_has_its_flight_and_the_way_back(browser, report_html, runs):
    browser.open(report_html, place="#runs?flight=yes")
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
    browser.open(report_html, place=f"#run/{golden}")
    assert browser.count("#run .flight") == 0
    assert f"mavfi replay {'/'}" in browser.text("#run .place")
    assert browser.complaints() == []


def test_print_shows_what_is_folded(browser, report_html):
    browser.open(report_html)
    hidden = """return [...document.querySelectorAll('#report details > :not(summary)')].filter((node) =>
        !node.checkVisibility()).length"""
    assert browser.run(hidden) > 0
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert browser.run(hidden) == 0
    finally:
        browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_tables_are_downloaded_as_csv(browser, report_html):
    browser.open(report_html)
    browser.run("window.kept = []; window.download = (name, text) => kept.push([name, text])")
    browser.click("button.csv")
    name, text = browser.run("return kept[0]")
    assert name.endswith(".csv") and len(text.splitlines()) > 1
