"""The worth of each rule is that of the ledgers; bad input is one line."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import pytest

from mavfi.campaign.bench import Bench, load_bench
from mavfi.config import parse
from mavfi.errors import BadInputError
from tests.unit.campaign.analysis.handmade import INSTRUCTION, alarm, died, flown, golden, injected, runs
from tools import build_leaderboard
from tools.build_leaderboard import CURVES, NAME, RULES, SCORED, headline, in_order, main, publish, rules, with_earlier


@pytest.fixture
def bench(monkeypatch):
    """One fault at each target, lost without a scheme; learned ones bring back way-points, the recommended one all."""
    arms = ("gaussian", "recommended", "readback", "autoencoder")
    base = [golden(1), *(golden(1, arm=arm) for arm in arms)]
    sites, dead = list(base), list(base)
    lost = flown(success=False)
    for place, target in enumerate(RULES):
        sites.append(injected(1, lost, index=place, target=target))
        for arm in (*arms[:2], arms[3]):
            back = arm == "recommended" or target == "way-point"
            sites.append(injected(1, flown() if back else lost, index=place, target=target, arm=arm))
    kernel = replace(INSTRUCTION, kernel="rrt_connect")
    dead.append(injected(1, died(success=False), kernel, target="rrt_connect"))
    for arm in arms:
        dead.append(injected(1, died(success=arm == "recommended"), kernel, arm=arm, target="rrt_connect"))
    ledgers = {"sites": runs(*sites), "instruction": runs(*dead)}

    def stored(folder):
        if folder.name not in ledgers:
            raise BadInputError("no ledger")
        return ledgers[folder.name]

    monkeypatch.setattr(build_leaderboard, "load", stored)
    return Path("bench")


def test_each_rule_has_its_faults(bench):
    lines = rules(bench / "sites", bench / "instruction").splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [row[0] for row in cells] == ["1", "1", "2", "2", "3", "4", "5"]
    assert all(row[2] == "1" for row in cells)
    assert [row[3].split()[0] for row in cells] == ["0.0", "0.0", "0.0", "0.0", "0.0", "100.0", "0.0"]
    assert all(row[4].startswith("100.0") for row in cells)


def test_the_headline_counts_what_comes_back(bench):
    lines = headline(bench).splitlines()
    assert [line for line in lines if line.startswith("| a")] == [
        "| a value between kernels, fields and bits that lose most | 6 | 1 (17 %) | 1 (17 %) | 6 (100 %) |",
        "| an instruction of the planner | 1 | 0 (0 %) | 0 (0 %) | 1 (100 %) |",
    ]
    assert not any("alarms" in line for line in lines), "no golden flights, and no fault is moved by them"
    assert not any("remembers" in line for line in lines), "not flown"


def test_the_headline_has_the_false_alarms_of_golden_flights(bench, monkeypatch):
    stored = build_leaderboard.load
    quiet, noisy = flown(injections=()), flown(injections=(), alarms=[alarm(1.0)], alarms_total=1)
    arms = {"gaussian": noisy, "autoencoder": quiet, "recommended": quiet}
    places = ("dense", "sparse")
    own = [golden(1, environment=place) for place in places]
    own += [golden(1, end, arm=arm, environment=place) for arm, end in arms.items() for place in places]
    own = runs(*own)
    monkeypatch.setattr(build_leaderboard, "load", lambda folder: own if folder.name == "golden" else stored(folder))
    sentence = headline(bench).splitlines()[-1]
    assert re.search(r"72\.0 \[[^]]+\] \(`gaussian`\), 0\.0 \[[^]]+\] \(`autoencoder`\), 0\.0", sentence), sentence


def test_the_headline_says_of_how_many_where_a_scheme_moves_the_faults(monkeypatch):
    arms = ("gaussian", "recommended", "autoencoder")
    kernel = replace(INSTRUCTION, kernel="rrt_connect")
    own = [golden(seed, arm=arm) for seed in (1, 2) for arm in ("", *arms)]
    own += [injected(seed, died(success=False), kernel, target="rrt_connect") for seed in (1, 2)]
    for seed, arm in itertools.product((1, 2), arms):
        end = flown(time_s=0.4) if (seed, arm) == (1, "gaussian") else died(success=arm == "recommended")
        own.append(injected(seed, end, kernel, arm=arm, target="rrt_connect"))

    def stored(folder):
        if folder.name != "instruction":
            raise BadInputError("no ledger")
        return runs(*own)

    monkeypatch.setattr(build_leaderboard, "load", stored)
    line = "| an instruction of the planner | 2 | 0 of 1 (0 %) | 0 (0 %) | 2 (100 %) |"
    lines = headline(Path("bench")).splitlines()
    assert line in lines and "only faults in the same value count" in lines[-1]


def test_a_bench_without_any_level_has_no_headline(monkeypatch):
    monkeypatch.setattr(build_leaderboard, "load", lambda folder: runs(golden(1)))
    with pytest.raises(BadInputError, match="no part was flown with gaussian, autoencoder and recommended"):
        headline(Path("bench"))


@pytest.mark.parametrize("arguments", [[], ["a", "b", "c"], ["no-such-folder"]])
def test_bad_input_is_one_line(arguments, capsys):
    assert main(arguments) == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith("bad input: ") and stderr.count("\n") == 1


def test_published_rows_are_those_of_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(build_leaderboard, "ROOT", tmp_path)
    frozen = tmp_path / "configs" / "bench" / NAME
    frozen.mkdir(parents=True)
    (frozen / "sites-quick.csv").touch()
    title = load_bench(NAME).parts["sites"].title
    page = f"# Top\n\n## {title}\n\n| scheme | lost |\n| --- | ---: |\n| a b | 3 [1, 5] |\n\n- note | more\n"
    publish(page + "\n## Other\n\n| scheme |\n| --- |\n| c |\n", "quick")
    assert [path.name for path in frozen.glob("*.rows.csv")] == ["sites-quick.rows.csv"]
    assert (frozen / "sites-quick.rows.csv").read_text() == 'scheme,lost\na b,"3 [1, 5]"\n'
    (frozen / "golden-quick.csv").touch()
    grid = "| environment | setting |\n| --- | --- |\n| dense | a |\n|  | b |\n| farm | a |\n"
    publish(f"# Top\n\n## {load_bench(NAME).parts['golden'].title}\n\n{grid}", "quick")
    assert (frozen / "golden-quick.rows.csv").read_text() == "environment,setting\ndense,a\ndense,b\nfarm,a\n"


@pytest.mark.parametrize(("part", "heading", "first"), [("sites", "scheme", "a"), ("golden", "environment", "all")])
def test_rows_that_a_page_lacks_are_not_lost(tmp_path, monkeypatch, part, heading, first):
    folder = tmp_path / "configs" / "bench" / NAME
    folder.mkdir(parents=True)
    (folder / f"{part}-quick.csv").touch()
    monkeypatch.setattr(build_leaderboard, "ROOT", tmp_path)

    def page(*rows):
        table = "\n".join(f"| {first if heading != 'scheme' else row} | {row} |" for row in rows)
        title = load_bench(NAME).parts[part].title
        return f"# Top\n\n## {title}\n\n| {heading} | setting |\n| --- | --- |\n{table}\n"

    publish(page("golden_a", "golden_b"), "quick")
    shipped = (folder / f"{part}-quick.rows.csv").read_text()
    with pytest.raises(BadInputError, match=rf"{part}-quick\.rows\.csv: rows of golden_b: not on the page"):
        publish(page("golden_a", "golden_c"), "quick")
    assert (folder / f"{part}-quick.rows.csv").read_text() == shipped
    publish(page("golden_a", "golden_b", "golden_c"), "quick")
    assert "golden_c" in (folder / f"{part}-quick.rows.csv").read_text()


def test_sections_that_were_not_flown_again_remain_with_their_date():
    earlier = "top\n\nFlown on 1.\n\n## a\n\n| 1 |\n\n- n\n\n## b\n\n| 2 |\n\n![picture](p.png)\n"
    page = with_earlier("top\n\nFlown on 2.\n\n## c\n\n| 5 |\n\n## b\n\n| 3 |\n", earlier, "abc")
    assert page == "top\n\nFlown on 2.\n\n## a\n\nFlown on 1.\n\n| 1 |\n\n- n\n\n## b\n\n| 3 |\n\n## c\n\n| 5 |\n"
    assert with_earlier(page, "", "abc") == page
    again = with_earlier("top\n\nFlown on 3.\n\n## b\n\n| 4 |\n", page, "abc")
    assert "## a\n\nFlown on 1.\n\n| 1 |" in again and "## c\n\nFlown on 2." in again and "| 3 |" not in again
    assert again.count("Flown on") == 3
    renamed = with_earlier("top\n\nFlown on 3.\n\n## d\n\n| 4 |\n", page, "bc")
    assert "## a" not in renamed and all(f"## {title}" in renamed for title in "bcd"), "no part has the title a"


def test_parts_and_schemes_are_in_the_order_of_the_bench():
    part = {"campaign": "bench_sites"}
    parts = {
        "g": {**part, "title": "Golden flights, all"},
        "s": {**part, "title": "S"},
        "t": {**part, "title": "S*"},
    }
    arms = {name: {"detector": "acceptance"} for name in "abc"}
    bench = parse(Bench, {"name": "b", "parts": parts, "arms": arms}, "b.yaml")
    table = "| scheme | x |\n| --- | --- |\n| c | 1 |\n|  | 2 |\n| own | 3 |\n| a | 4 |\n"
    golden = "| environment | setting |\n| --- | --- |\n| farm | golden_b |\n|  | golden_a |\n| dense | golden_b |\n"
    sections = {"False alarms by regime": "- r", "S": f"{table}\n- note", "S*": "- t", "Golden flights, all": golden}
    page = in_order("\n\n".join(["# Top", *(f"## {title}\n\n{rest}" for title, rest in sections.items())]), bench)
    assert "| --- | --- |\n| a | 4 |\n| c | 1 |\n|  | 2 |\n| own | 3 |\n\n- note\n" in page
    assert "| farm | golden_a |\n|  | golden_b |\n| dense | golden_b |\n" in page
    assert in_order(page, bench) == page
    titles = ["Golden flights, all", "S", "S*", "False alarms by regime"]
    assert re.findall("^## (.+)$", page, re.MULTILINE) == titles
    assert re.findall(r"^- \[(.+)\]\(#(.+)\)$", page, re.MULTILINE) == list(
        zip(titles, ["golden-flights-all", "s", "s-1", "false-alarms-by-regime"], strict=True)
    )


def test_groups_keep_the_rows_that_were_flown():
    def page(day, rows, note):
        table = "\n".join(["| environment | setting |", "| --- | --- |", *rows])
        drawn = "- 4 faults, sha256 abc: as published"
        return f"top\n\nFlown on {day}.\n\n## G\n\n{table}\n\n{drawn}\n{note}\n"

    first = page(1, ["| farm | golden_a |"], "- systematic: same state; control.command at 0.40 s")
    both = with_earlier(page(2, ["| farm | golden_a |", "|  | golden_b |"], "- systematic: same state"), first, ["G"])
    assert "| farm | golden_a |\n|  | golden_b |\n" in both
    assert "- systematic: same state; control.command at 0.40 s" in both and "same state\n" not in both


def test_reasons_for_the_lack_of_scores_remain_with_the_rows():
    def page(day, row, note):
        return (
            f"top\n\nFlown on {day}.\n\n## False alarms by regime\n\n| scheme | x |\n| --- | --- |\n{row}\n\n{note}\n"
        )

    reason = "- checksum: not scored: it compares with a seal"
    both = with_earlier(page(2, "| b | 2 |", "- n"), page(1, "| a | 1 |", reason), ["G"])
    assert "| a | 1 |" in both and "| b | 2 |" in both and both.count(reason) == 1


def test_curves_of_other_detectors_are_a_picture_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr(build_leaderboard, "IMAGES", tmp_path)
    bench = tmp_path / "bench"
    bench.mkdir()
    assert build_leaderboard._pictures(bench, "leaderboard-paper", papers=True, kept=False) == ""
    for papers, drawn in ((True, "curves-paper.png"), (False, "curves-paper-others.png")):
        (bench / "curves.png").write_text(drawn)
        text = build_leaderboard._pictures(bench, "leaderboard-paper", papers=papers, kept=False)
        assert (tmp_path / drawn).read_text() == drawn and f"(../images/{drawn})" in text
    assert text.count("![") == 2 and (tmp_path / "curves-paper.png").read_text() == "curves-paper.png"
    (bench / "curves.png").write_text("of other parts")
    assert build_leaderboard._pictures(bench, "leaderboard-paper", papers=False, kept=True) == text
    assert (tmp_path / "curves-paper-others.png").read_text() == "curves-paper-others.png"


def test_scores_of_other_parts_do_not_replace_earlier_ones():
    def page(day, row, parts):
        table = f"| scheme | regime |\n| --- | --- |\n{row}\n"
        note = f"- one golden flight for each mission of these parts, their faults together: {parts}\n"
        scores = f"## {CURVES}\n\n{table}\n{note}\n## False alarms by regime\n\n{table}"
        return f"top\n\nFlown on {day}.\n\n## T\n\n| {day} |\n\n{scores}"

    first = page(1, "| a | x |", "golden, sites")
    other = with_earlier(page(2, "| a | y |", "state, words"), first, {"T", *SCORED})
    assert "| 2 |" in other and other.count("| a | x |") == 2 and "| a | y |" not in other
    same = with_earlier(page(2, "| a | y |", "golden, sites"), first, {"T", *SCORED})
    assert same.count("| a | y |") == 2 and "| a | x |" not in same


def test_schemes_that_were_not_scored_again_keep_their_rows_with_their_date():
    def page(day, *rows):
        table = "\n".join(["| scheme | regime |", "| --- | --- |", *rows])
        return f"top\n\nFlown on {day} at scale paper.\n\n## False alarms by regime\n\n{table}\n\n- note\n"

    first = page(1, "| a | x |", "|  | y |", "| b | x |", "|  | y |")
    second = with_earlier(page(2, "| b | X |", "|  | Y |", "| c | X |"), first, ())
    assert second.endswith("| b | X |\n|  | Y |\n| c | X |\n| a | x |\n|  | y |\n\n- note\n- a: flown on 1\n")
    third = with_earlier(page(3, "| c | 3 |"), second, ())
    assert "| c | 3 |\n| b | X |\n|  | Y |\n| a | x |\n|  | y |\n" in third
    assert third.endswith("- note\n- b: flown on 2\n- a: flown on 1\n")
    assert with_earlier(page(4, "| a | 4 |", "| b | 4 |", "| c | 4 |"), third, ()).count("flown on") == 0


def test_schemes_keep_their_rows_if_faults_and_columns_are_the_same():
    def page(day, faults, *rows, heading="| scheme | lost |"):
        table = "\n".join([heading, "| --- | --- |", *rows])
        return f"top\n\nFlown on {day}.\n\n## T\n\n{table}\n\n- 9 faults, sha256 {faults}…: as published\n"

    first = page("1", "12ab", "| a | 1 |", "| b | 2 |")
    second = with_earlier(page("2", "12ab", "| c | 3 |", "| a | 4 |"), first, "T")
    assert "| c | 3 |\n| a | 4 |\n| b | 2 |\n" in second and second.endswith("- b: flown on 1.\n")
    for other in (page("2", "34cd", "| c | 3 |"), page("2", "12ab", "| c | 3 |", heading="| scheme | late |")):
        assert "| b |" not in with_earlier(other, first, "T")
    here = "- flown here: c; the other rows are those published in x, on the same faults\n"
    older = with_earlier(page("2", "12ab", "| a | 0 |", "| c | 3 |") + here, first, "T")
    assert "| a | 1 |\n| c | 3 |\n| b | 2 |\n" in older, "a was flown before the page, but not there"


def test_schemes_that_were_not_flown_again_keep_their_comparison():
    note = "- b against a: missions that only one of them flies to the end 1 : 2 of 9, p = 1"
    head = "Title\n\nFlown on 2026-01-01.\n\n## T\n\n| scheme | lost |\n| --- | --- |\n| a | 1 |\n| b | 2 |\n"
    earlier = f"{head}| c | 3 |\n\n{note}\n{note.replace('b against', 'c against')}\n"
    page = with_earlier(f"{head}| c | 4 |\n\n- rates\n", earlier, {"T"})
    assert page.endswith(f"- rates\n{note}\n"), "c was flown again, and not with a"
    for again in (note, note.replace("p = 1", "p = 0.5")):
        assert with_earlier(f"{head}| c | 3 |\n\n{again}\n", earlier, {"T"}).count("- b against a: ") == 1


def test_a_bench_of_other_parts_leaves_the_readme_as_it_is(tmp_path, monkeypatch):
    for name in ("ROOT", "GENERATED", "DOCS", "IMAGES"):
        monkeypatch.setattr(build_leaderboard, name, tmp_path)
    (tmp_path / "configs" / "bench").mkdir(parents=True)
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench" / "leaderboard.md").write_text(
        "# Top\n\n    mavfi bench detectors /a/b.yaml --part a --part b-c --detector d\n\nFlown on 1.\n\n"
        "## a\n\n| 1 |\n\n- flown here: c, d; the other rows are those published in x, on the same faults\n- note\n"
    )
    (tmp_path / "curves-paper.png").touch()
    assert main([str(tmp_path / "bench"), "paper"]) == 0
    page = (tmp_path / "leaderboard-paper.md").read_text()
    assert "## a\n\n| 1 |" in page and "mavfi bench detectors --detector d\n" in page
    assert "\n- flown on this day: c, d; the other rows earlier, on the same faults\n- note\n" in page
    assert "curves-paper.png" in page, "drawn earlier"
    assert "## recommended\n" in (tmp_path / "detectors.md").read_text(), "sections of single detectors"
    assert not (tmp_path / "README.md").exists()
