import copy

from mavfi.reports import header, tables
from mavfi.reports.comparable import is_comparable, only_comparable


def _table(analysis, title):
    return next(table for table in tables.tables(analysis) if table.title == title)


def test_success_shows_rate_interval_count_and_the_papers_figure(analysis):
    rows = {row[1]: row for row in _table(analysis, "Success of missions").rows}
    assert rows["golden"][2:4] == ("100.0 [34.2, 100.0] 2/2", "95.0 %")
    assert rows["fi"][3] == "88.3 %"
    assert list(rows) == ["golden", "golden_idle", "fi", "dr_idle"]


def test_an_idle_detector_changes_nothing(analysis):
    rows = {row[1]: row for row in _table(analysis, "Success of missions").rows}
    assert rows["fi"][4:] == rows["dr_idle"][4:]
    assert rows["fi"][2] == rows["dr_idle"][2]


def test_whole_word_stands_beside_the_headline(analysis):
    columns = _table(analysis, "Success of missions").columns
    assert columns[2:] == ("success %, sign + exponent", "paper", "whole word", "mantissa")


def test_undefined_recovery_is_said_so(analysis):
    entry = {
        **copy.deepcopy(analysis["recovery"][0]),
        "recovery": {"rate": None, "low": None, "high": None, "loss": 0.1, "loss_low": -0.1, "loss_high": 0.2},
    }
    table = _table({**analysis, "recovery": [entry]}, "Recovery")
    assert table.rows[0][3] == "undefined"


def test_every_table_names_the_stack_and_its_deviations(analysis):
    for table in tables.tables(analysis):
        assert table.notes[-1].startswith("stack published; deviates from the published code: grace 1 s not 0"), (
            table.title
        )


def test_tables_on_faults_say_that_rates_are_conditional(analysis):
    for title in ("Success of missions", "Recovery", "Flight time", "Success by stage of the fault, sparse"):
        assert tables.ONE_FAULT in _table(analysis, title).notes
    assert tables.HEALS in _table(analysis, "Recovery").notes
    assert tables.VARIANT in _table(analysis, "Success of missions").notes


def test_the_time_limit_stands_beside_the_worst_case(analysis):
    table = _table(analysis, "Flight time")
    limit = table.rows[0][table.columns.index("limit")]
    assert 140 < float(limit.removesuffix(" s")) < 170


def test_rows_of_an_environment_stand_together(analysis):
    other = [{**entry, "environment": "dense"} for entry in analysis["endings"]]
    mixed = [entry for pair in zip(analysis["endings"], other, strict=True) for entry in pair]
    rows = _table({**analysis, "endings": mixed}, "How missions ended").rows
    assert [row[0] for row in rows] == ["sparse"] * 4 + ["dense"] * 4


def test_null_runs_are_reported_either_way(analysis):
    assert header.null_line(analysis).startswith("Null runs: all 2 flights")
    broken = {**analysis, "null_check": {"n": 2, "differing": ["run-a"], "passed": False}}
    assert "1 of 2 DIFFER" in header.null_line(broken)
    assert "run-a" in header.null_line(broken)


def test_header_says_when_a_campaign_is_not_complete_or_on_design_seeds(analysis):
    assert not any("Not complete" in line or "design seeds" in line for line in header.header(analysis))
    campaign = {**analysis["campaign"], "done": 1, "on_design_seeds": True}
    lines = header.header({**analysis, "campaign": campaign})
    assert any("Not complete" in line for line in lines)
    assert any("design seeds" in line for line in lines)


def test_only_the_papers_stack_and_profile_stand_beside_its_figures(analysis):
    campaign = {"stack": "published", "detectors": {"gaussian": {"profile": "paper"}, "own": {"profile": "tuned"}}}
    assert is_comparable(campaign, "fi")
    assert is_comparable(campaign, "dr_gaussian")
    assert not is_comparable(campaign, "dr_own")
    assert not is_comparable({**campaign, "stack": "hardened"}, "golden")
    hardened = only_comparable({**analysis, "campaign": {**analysis["campaign"], "stack": "hardened"}})
    assert {row[3] for row in _table(hardened, "Success of missions").rows} == {"—"}


def test_header_names_detectors_with_their_profiles(analysis):
    assert any("idle = none (paper); coupling inline" in line for line in header.header(analysis))


def test_fields_with_few_flights_are_in_the_summary_only(analysis):
    assert analysis["by_field"], "two faults per stage, each at a field of its own"
    assert not any(table.title == "Success by field, sparse" for table in tables.tables(analysis))
    many = [{**entry, "n": 10} for entry in analysis["by_field"] if entry["population"] == "sign_exponent"]
    table = _table({**analysis, "by_field": many}, "Success by field, sparse")
    assert len(table.rows) == len(many)
    assert any("fewer than 10 flights" in note for note in table.notes)


def test_recovery_shows_the_missions_behind_it(analysis):
    found = {"rate": 0.0, "low": 0.0, "high": 0.41, "loss": 0.117, "loss_low": 0.03, "loss_high": 0.24}
    entry = {**copy.deepcopy(analysis["recovery"][0]), "recovery": {**found, "lost": 7, "regained": 0}}
    assert _table({**analysis, "recovery": [entry]}, "Recovery").rows[0][3] == "0.0 % [0.0, 41.0] 0/7"


def test_differing_flights_with_an_alarm_are_counted_apart(analysis):
    entries = [{**entry, "sdc": 3, "sdc_alarmed": 2} for entry in analysis["outcomes"][:1]]
    table = _table({**analysis, "outcomes": entries}, "Outcomes of faults")
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert (row["sdc"], row["(alarm)"]) == ("3", "2")
    assert not any("nothing said so" in note for note in table.notes)
