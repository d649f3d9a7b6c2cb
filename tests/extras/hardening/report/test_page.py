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
    page,
    source,
    verdict_line,
    write_certificate,
)
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
    some = "of the silent corruptions (SDC) in pid, octomap, collision_check, predicted"
    assert some in headline(replace(advice, complete=False)), "rates of other kernels are not known"
    nothing = tuple(replace(row, added=0.0, coverage=rate(0.0)) for row in advice.kernels)
    assert headline(replace(advice, kernels=nothing)).startswith("Nothing can be protected within 10.0 %")
    assert "of 60 with a dead kernel" in caveats(advice)[0]


def test_what_was_not_seen_is_said():
    advice = summary()
    track = replace(
        advice.functions[0],
        coverage=rate(None),
        recorded=3,
        missions=2,
        unseen_lines={"mavfi/kernels/control/pid.py": [60, 61, 62, 71, 80, 90]},
    )
    advice = replace(advice, functions=(track, *advice.functions[1:]))
    assert caveats(advice)[-1].endswith("mission executes: track pid.py:60-62, pid.py:71 and 2 more.")
    assert "removes predicted from 3 calls of 2 missions: too few" in page(advice, DIRECTORY, PLAN)
    assert "too few" in advice_table(advice).to_csv()
    assert "a share of all silent corruptions (SDC) that is not known" in headline(replace(advice, coverage=rate(None)))


def test_the_page_of_a_certificate_starts_with_its_verdict(tmp_path):
    effects = {"masked": 50, "sdc": 50}, {"detected": 99, "sdc": 1}
    claim, paired = Coverage(estimate=0.95, low=0.9, high=0.98), mcnemar([True], [False])
    certificate = Certificate("pid", "mavfi.pid.track", "f8", 1000, *effects, 2.4, claim, paired, 1.372, 1.34)
    found = Certification("ab" * 32, 100, ("sparse-9",), (certificate,), GoldenCheck(2, 2, 3578, 0))
    write_certificate(tmp_path / "c.html", found, DIRECTORY, PLAN, ("pid",))
    text = (tmp_path / "c.html").read_text()
    assert "The plan is confirmed: 95.2\u00a0% [" in text and "0 false alarms in 3,578 calls" in text
    assert "mavfi harden &#39;out/my runs&#39; --kernels pid --plan plan.yaml --certify --faults 100" in text
    assert "<td>1 : 0, p = 1</td>" in text and "<td>×1.37 (×1.34)</td>" in text
    unprotected = Unprotected("octomap", "m.insert_scan", "f8", 99_000, {"masked": 80, "sdc": 20})
    whole = replace(found, others=(unprotected,))
    assert verdict_line(whole).startswith("The plan is confirmed: 2.3 % [1.2, 3.7] of all SDCs are removed")
    assert certificate_table(whole).rows[1][:4] == ("octomap", "insert_scan", "20.0 % [13.3, 28.9]", "—")
    assert "95.2 % [73.2, 99.2] of the SDCs in pid are removed" in verdict_line(replace(found, scope=("pid",)))
    refuted = replace(found, golden=GoldenCheck(2, 1, 9, 0))
    assert refuted.refuted and verdict_line(refuted).startswith("The plan is refuted")
