"""The page of an advice: complete, offline, and safe; and its sentences."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

from mavfi.analysis.statistics import mcnemar
from mavfi.extras.hardening.certify import Certificate, Certification, Unprotected
from mavfi.extras.hardening.observed import GoldenCheck
from mavfi.extras.hardening.plan import Coverage
from mavfi.extras.hardening.report import (
    HEIGHT,
    WIDTH,
    advice_table,
    caveats,
    certificate_table,
    curve,
    headline,
    interval,
    page,
    pareto_front,
    source,
    verdict_line,
    write_certificate,
)
from mavfi.extras.hardening.summary import StepSummary
from tests.extras.hardening.report.summaries import rate, summary

DIRECTORY, PLAN = Path("out/my runs"), Path("plan.yaml")


def test_the_page_says_what_to_protect_and_what_it_does_not_buy():
    text = page(summary(), DIRECTORY, PLAN)
    HTMLParser().feed(text)
    assert "46.0\u00a0% [41.0, 51.0]" in text and "0 of 253 flights with an SDC were lost" in text
    assert "hardening &lt;small&gt;" in text and "<small>\n" not in text.split("</title>")[0]
    assert "mavfi harden &#39;out/my runs&#39; --plan plan.yaml --certify" in text
    assert "400 injections in recorded calls" in text and "in the ledger" not in text, "the advice has its own faults"
    assert "cannot repeat: call 5.0 %" in text and "beyond the budget 15.0 %" in text


def test_the_commands_of_the_page_have_all_options():
    text = page(replace(summary(), selected=("pid", "octomap"), addresses=True), DIRECTORY, PLAN)
    assert "--budget 0.1 --kernels pid,octomap --addresses --plan plan.yaml" in text
    assert "runs&#39; --kernels pid,octomap --plan plan.yaml --certify" in text
    assert "--kernels" not in page(summary(), DIRECTORY, PLAN)


def test_certified_coverage_is_shown_where_it_is_known():
    advice = summary()
    assert "ertified" not in page(advice, DIRECTORY, PLAN)
    assert advice_table(advice).columns[-1].heading == "sites"
    first, *others = advice.functions
    advice = replace(advice, functions=(replace(first, certified=rate(0.91)), *others))
    assert f"certified {interval(rate(0.91))}" in page(advice, DIRECTORY, PLAN)
    table = advice_table(advice)
    assert table.columns[-1].heading == "certified" and table.rows[0][-1] == interval(rate(0.91))
    assert table.rows[1][-1] == "—"


def test_the_page_loads_nothing():
    text = page(summary(), DIRECTORY, None)
    assert not re.findall(r"(?:src|href)=[\"'](?!#)", text) and "<script" not in text
    assert "default-src 'none'" in text


def test_points_of_a_curve_lie_within_its_drawing_in_order_of_time():
    drawn = curve(summary().functions[0])
    assert [point.x for point in drawn.points] == sorted(point.x for point in drawn.points)
    assert all(0 < point.x < WIDTH and 0 < point.high <= point.y <= point.low < HEIGHT for point in drawn.points)
    assert sum(point.chosen for point in drawn.points) == 1
    assert drawn.xs[0][1] == "×1" and 2 <= len(drawn.xs) <= 6


def test_source_lines_have_their_text_and_gaps():
    ((file, lines),) = source(summary().functions[0]).items()
    assert file.endswith("pid.py") and any(line.code for line in lines)
    assert [line.gap for line in lines] == [False] + [True] * 9
    assert lines[9].summary.protected == 1.0 and lines[9].escapes == 0.0


def test_sentences():
    advice = summary()
    assert headline(advice).startswith("Protect pid, octomap: 9.9 % more kernel time")
    assert "46.0 % [41.0, 51.0] of all silent corruptions (SDC), predicted" in headline(advice)
    some = "of the silent corruptions (SDC) in pid, octomap, collision_check, predicted"
    assert some in headline(replace(advice, complete=False)), "rates of other kernels are not known"
    nothing = tuple(replace(row, added=0.0, coverage=rate(0.0)) for row in advice.kernels)
    assert (
        headline(replace(advice, kernels=nothing))
        == "Nothing can be protected within 10.0 % of a flight's kernel time."
    )
    assert "of 60 with a dead kernel" in caveats(advice)[0]
    assert interval(rate(None)) == "—"
    assert advice_table(advice).rows[0][:4] == ("pid", "track", "0.1 %", "×1.38")


def test_the_page_of_a_certificate_starts_with_its_verdict(tmp_path):
    one = Certificate(
        "pid",
        "mavfi.pid.track",
        "f8",
        1000,
        {"masked": 50, "sdc": 50},
        {"detected": 99, "sdc": 1},
        2.4,
        Coverage(estimate=0.95, low=0.9, high=0.98),
        mcnemar([True], [False]),
        1.372,
        1.34,
    )
    found = Certification("ab" * 32, 100, ("sparse-9",), (one,), GoldenCheck(2, 2, 3578, 0))
    write_certificate(tmp_path / "c.html", found, DIRECTORY, PLAN)
    text = (tmp_path / "c.html").read_text()
    assert "The plan is confirmed: 95.2\u00a0% [" in text and "0 false alarms in 3,578 calls" in text
    assert "mavfi harden &#39;out/my runs&#39; --plan plan.yaml --certify --faults 100" in text
    assert "<td>1 : 0, p = 1</td>" in text and "<td>×1.37 (×1.34)</td>" in text
    write_certificate(tmp_path / "c.html", found, DIRECTORY, PLAN, ("pid",))
    assert "runs&#39; --kernels pid --plan plan.yaml --certify" in (tmp_path / "c.html").read_text()
    rest = Unprotected("octomap", "m.insert_scan", "f8", 99_000, {"masked": 80, "sdc": 20})
    whole = Certification("ab" * 32, 100, (), (one,), GoldenCheck(), (rest,))
    assert verdict_line(whole).startswith("The plan is confirmed: 2.3 % [1.2, 3.7] of all SDCs are removed")
    assert certificate_table(whole).rows[1][:4] == ("octomap", "insert_scan", "20.0 % [13.3, 28.9]", "—")
    assert certificate_table(whole).rows[1][-2] == "not duplicated"
    part = Certification("ab" * 32, 100, (), (one,), GoldenCheck(), (), ("pid",))
    assert "95.2 % [73.2, 99.2] of the SDCs in pid are removed" in verdict_line(part)
    refuted = Certification("ab" * 32, 100, (), (one,), GoldenCheck(2, 1, 9, 0))
    assert refuted.refuted and verdict_line(refuted).startswith("The plan is refuted")


def test_the_line_of_a_curve_joins_what_the_time_buys():
    times, rates = [1.0, 1.3, 1.1, 1.1, 1.4], [0.0, 0.6, 0.7, 0.2, 0.8]
    assert pareto_front(times, rates) == [0, 2, 4]
    steps = [StepSummary(0.5, 1.5, time, rate(share), False) for time, share in zip(times, rates, strict=True)]
    drawn = curve(replace(summary().functions[0], steps=tuple(steps)))
    assert len(drawn.points) == 5
    assert drawn.path.split() == [f"{point.x},{point.y}" for point in (drawn.points[n] for n in (0, 2, 4))]
