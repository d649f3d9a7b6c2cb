import json
from dataclasses import replace

import pytest

from mavfi.campaign import detection, effects, paper, success
from mavfi.campaign.analysis import analyse
from mavfi.campaign.flights import Row, read_rows
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.faults.fault import NO_SITE, Fault, FaultSite
from mavfi.outcomes import Outcome
from tests.unit.campaign.fakes import FAKE, small


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    directory = tmp_path_factory.mktemp("campaign")
    run_campaign(small(flights=10, faults=20), directory, workers=1, tools=FAKE)
    with Store.open(directory) as store:
        return analyse(directory), read_rows(store)


def pick(table, **wanted):
    return [entry for entry in table if all(entry[key] == value for key, value in wanted.items())]


def test_it_is_plain_data(flown):
    analysis, _ = flown
    assert json.loads(json.dumps(analysis, allow_nan=False)) == analysis
    assert analysis["campaign"]["done"] == analysis["campaign"]["total"]
    assert paper.NOTE in analysis["remarks"][0]


def test_success_table(flown):
    analysis, rows = flown
    for environment in ("sparse", "dense"):
        [golden] = pick(analysis["success"], environment=environment, setting="golden")
        assert (golden["population"], golden["n"], golden["rate"]) == ("all", 10, 1.0)
        faulty = {e["population"]: e for e in pick(analysis["success"], environment=environment, setting="fi")}
        counts = {name: entry["n"] for name, entry in faulty.items()}
        assert counts == {"sign_exponent": 39, "mantissa": 21, "whole_word": 60}
        own = [
            r for r in rows if (r.spec.environment, r.spec.setting, r.stratum) == (environment, "fi", "sign_exponent")
        ]
        assert faulty["sign_exponent"]["successes"] == sum(row.success for row in own) < len(own)
        assert faulty["sign_exponent"]["paper"] == paper.SUCCESS[environment]["fi"]
        low, high = faulty["whole_word"]["low"], faulty["whole_word"]["high"]
        assert low <= faulty["whole_word"]["rate"] <= high


def test_tables_by_property_part_the_faults(flown):
    analysis, _ = flown
    for table, name in (("by_stage", "stage"), ("by_state", "state"), ("by_field", "field"), ("by_bits", "bits")):
        whole = sum(
            e["n"] for e in pick(analysis[table], environment="all", setting="fi") if e["population"] != "whole_word"
        )
        assert whole == 2 * 60, table
        assert all(entry[name] for entry in analysis[table])


def test_outcomes_add_up(flown):
    analysis, rows = flown
    for entry in analysis["outcomes"]:
        assert sum(entry[outcome.label] for outcome in Outcome) == entry["n"] == 20
        assert entry["hit"] + entry["no_site"] + entry["not_hit"] == entry["n"]
        assert entry["due"] == entry["unknown"] == 0
        assert entry["sdc_alarmed"] == 0, "repaired before it was seen, or without a detector"
    no_site = [row for row in rows if row.site_fate == "no_site" and row.spec.setting == "fi"]
    assert no_site, "missions without an acted-on collision status are in the plan"
    assert all(row.outcome is Outcome.MASKED for row in no_site)


def test_recovery_and_paired_tests(flown):
    analysis, _ = flown
    entries = pick(analysis["recovery"], environment="all", setting="dr_gaussian", population="sign_exponent")
    [entry] = entries
    assert entry["mcnemar"]["first_only"] == 0
    assert entry["mcnemar"]["second_only"] > 0
    assert entry["recovery"]["rate"] == pytest.approx(1.0)
    assert entry["recovery"]["low"] < 1.0, "a few missions prove nothing"
    assert entry["recovery"]["lost"] == entry["recovery"]["regained"] == entry["mcnemar"]["second_only"]
    [against] = pick(analysis["golden_against_faults"], environment="all", population="sign_exponent")
    assert against["first_only"] == entry["mcnemar"]["second_only"]


def test_flight_times_are_of_pairs_that_succeed_in_all_settings(flown):
    analysis, rows = flown
    for environment in ("sparse", "dense"):
        faulty, recovered = pick(analysis["flight_times"], environment=environment)
        assert (faulty["setting"], recovered["setting"]) == ("fi", "dr_gaussian")
        failing = [r for r in rows if (r.spec.environment, r.spec.setting) == (environment, "fi") and not r.success]
        assert faulty["pairs"] == recovered["pairs"] == 60 - len(failing)
        assert faulty["censored"] == len(failing)
        assert faulty["time"]["worst"] > 0.1
        assert recovered["time"]["worst"] == pytest.approx(0)
        worst = next(row for row in rows if row.spec.run_id == faulty["worst_run"])
        assert worst.inflation == pytest.approx(faulty["time"]["worst"])
        assert faulty["paper_worst"] == paper.WORST_TIME_INCREASE[environment]


def test_false_alarms_have_exposure_and_bound(flown):
    analysis, rows = flown
    [entry] = pick(analysis["false_alarms"], environment="all", setting="golden_gaussian")
    golden = [row for row in rows if row.spec.setting == "golden_gaussian"]
    assert entry["flights"] == 20
    assert entry["events"] == sum(row.spec.seed % 3 == 0 for row in golden)
    assert entry["hours"] == pytest.approx(sum(row.record["flight_time_s"] for row in golden) / 3600)
    assert entry["upper"] > entry["per_hour"]
    assert entry["kinds"] == {"fake/recompute/accepted": entry["events"]}
    assert entry["systematic"] == [], "a third of the flights is not all of them"


def test_detections_and_overheads(flown):
    analysis, _ = flown
    assert {entry["rate"] for entry in analysis["detections"]} == {1.0}
    assert {entry["consequence"]["rate"] for entry in analysis["detections"]} == {1.0}
    assert {entry["monitored"] for entry in analysis["detections"]} == {True, False}
    [entry] = pick(analysis["overheads"], environment="sparse", setting="golden_gaussian")
    seeds = range(10_000, 10_010)
    alarms = sum(seed % 3 == 0 for seed in seeds)
    assert entry["recompute"]["perception"] == pytest.approx(alarms * 0.289 / 10.0)
    assert entry["recompute"]["control"] == 0


def test_endings_golden_flights_and_shares(flown):
    analysis, rows = flown
    [entry] = pick(analysis["endings"], environment="dense", setting="fi")
    assert sum(entry["statuses"].values()) == 60
    assert set(entry["statuses"]) == {"success", "collision"}
    [golden] = pick(analysis["golden"], environment="sparse", setting="golden")
    assert golden["replans"] == 1
    [share] = pick(analysis["unmonitored_failures"], environment="dense")
    assert share["n"] == entry["statuses"]["collision"]
    assert 0 <= share["low"] <= share["rate"] <= share["high"] <= 1
    [acted] = pick(analysis["acted_on"], environment="dense")
    assert (acted["publications"], acted["acted_on"]) == (120, 24)
    [differences] = pick(analysis["separable"], environment="dense")
    assert differences["golden_fi"] > differences["fi_dr"] > 0


def test_null_check_passes_and_can_fail(flown):
    analysis, rows = flown
    assert analysis["null_check"] == {"n": 6, "differing": [], "passed": True}
    null = next(row for row in rows if row.spec.setting == "null")
    broken = replace(null, record={**null.record, "digest": "another"})
    assert effects.null_check([broken]) == {"n": 1, "differing": [null.spec.run_id], "passed": False}


# ---- rows that no fake flight makes --------------------------------------------------------------------------------
FAULT = Fault(
    "state", FaultSite("planning.waypoint", "x"), 1, 62, stratum="sign_exponent", weight=0.1875, stage="planning"
)
SPEC = RunSpec(2, "fi", "dense", 1, "key", "planning", 0, FAULT)
GOLDEN = {"end": "flown", "success": True, "status": "success", "digest": "g", "flight_time_s": 50.0, "energy_j": 1e4}


def row(record, fault=FAULT) -> Row:
    return Row(replace(SPEC, fault=fault), record, GOLDEN, GOLDEN)


def test_verdicts_of_runs_that_did_not_end_well():
    due, unknown = row({"end": "due"}), row({"end": "unknown", "error": "KeyError"})
    assert (due.outcome, due.status, due.success, due.judged) == (Outcome.DUE, "due", False, True)
    assert (unknown.outcome, unknown.status, unknown.judged) == (Outcome.UNKNOWN, "unknown", False)
    assert row({"end": "flown", "digest": "x"}).outcome is Outcome.SDC
    orphan = Row(SPEC, {**GOLDEN}, None, None)
    assert orphan.outcome is Outcome.UNKNOWN
    assert orphan.inflation is None


def test_unknown_runs_are_counted_apart_and_due_runs_fail():
    rows = [row(GOLDEN), row({"end": "due"}), row({"end": "unknown"})]
    [entry] = success.success_by_environment(rows)
    assert (entry["n"], entry["successes"], entry["unknown"]) == (2, 1, 1)


def test_fates_of_sites():
    assert row({**GOLDEN, "injections": [{"hit": True}]}).site_fate == "hit"
    assert row({**GOLDEN, "injections": [{"hit": False}]}).site_fate == "not_hit"
    assert row({"end": "due"}).site_fate == "hit"
    assert row(GOLDEN, replace(FAULT, time_us=NO_SITE)).site_fate == "no_site"


def test_slower_counts_from_five_per_cent():
    assert not success.fails_or_slower(row({**GOLDEN, "flight_time_s": 52.4}))
    assert success.fails_or_slower(row({**GOLDEN, "flight_time_s": 52.6}))
    assert success.fails_or_slower(row({**GOLDEN, "success": False}))


def test_fine_strata_make_up_whole_words_too():
    rows = [row(GOLDEN, replace(FAULT, stratum=name)) for name in ("sign", "exponent", "mantissa")]
    assert "whole_word" in success.populations(rows, lambda r: r.success)
    assert "whole_word" not in success.populations(rows[:2], lambda r: r.success)


def test_nothing_flown_gives_empty_tables():
    assert success.success_by_environment([]) == []
    assert effects.flight_times([]) == []
    assert detection.false_alarms([]) == []
    assert effects.null_check([])["n"] == 0


# ---- alarms --------------------------------------------------------------------------------------------------------
def alarm(time_s, state="planning.waypoint"):
    return {"time_s": time_s, "state": state}


def watched_row(alarms, twins=()):
    record = {**GOLDEN, "digest": "x", "injections": [{"hit": True, "time_s": 0.3}], "alarms": list(alarms)}
    spec = replace(SPEC, setting="dr_gaussian", arm="gaussian", detector="gaussian")
    return Row(spec, record, {**GOLDEN, "alarms": list(twins)}, GOLDEN)


@pytest.mark.parametrize(
    ("alarms", "twins", "alarmed", "consequence"),
    [
        ([alarm(0.3)], [], True, True),
        ([alarm(0.1 + 0.2)], [], True, True),  # 0.30000000000000004: the same microsecond
        ([alarm(0.3 - 1e-9)], [], True, True),
        ([alarm(0.3, "control.command")], [], False, True),
        ([alarm(0.4, "control.command")], [alarm(0.4, "control.command")], False, False),
        ([alarm(0.4)], [], False, True),
        ([alarm(1.4), alarm(0.2)], [], False, False),
        ([], [], False, False),
    ],
)
def test_only_alarms_on_what_was_struck_detect_the_fault(alarms, twins, alarmed, consequence):
    own = watched_row(alarms, twins)
    assert (own.alarmed, own.consequence_alarmed) == (alarmed, consequence)
    [entry] = detection.detections([own], "paper-13")
    assert (entry["rate"], entry["consequence"]["rate"]) == (alarmed, consequence)
    [counted] = effects.outcomes([own])
    assert (counted["sdc"], counted["sdc_alarmed"]) == (1, int(alarmed))


def test_alarms_of_nearly_every_flight_are_systematic():
    golden = RunSpec(1, "golden_g", "dense", 1, "key", arm="g", detector="g")
    start, chance = alarm(0.40046, "control.command"), alarm(12.0)
    records = [
        {**GOLDEN, "alarms": [start, chance][: 1 + (seed < 10)], "alarms_total": 1 + (seed < 10), "alarm_counts": {}}
        for seed in range(20)
    ]
    rows = [Row(replace(golden, seed=seed), record, None, None) for seed, record in enumerate(records)]
    entry = detection.false_alarms(rows)[0]
    assert entry["systematic"] == [{"state": "control.command", "time_s": pytest.approx(0.40046), "flights": 20}]


def test_golden_runs_that_are_not_known_give_no_pair():
    assert row(GOLDEN).golden_success is True
    assert Row(SPEC, GOLDEN, None, {"end": "unknown"}).golden_success is None
    assert Row(SPEC, GOLDEN, None, None).golden_success is None
    assert Row(SPEC, GOLDEN, None, {"end": "due"}).golden_success is False
