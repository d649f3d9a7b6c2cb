"""A bench: parts, schemes, who is left out, and the frozen faults."""

import csv

import pytest

from mavfi.analysis.views import VIEWS
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.resolve import resolve
from mavfi.config import config_root, names, parse
from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import (
    FAULT_COLUMNS,
    FOLDER,
    ROWS_ENDING,
    Bench,
    checksum,
    faults_of,
    level_of,
    load_bench,
    select_parts,
    with_only,
    with_schemes,
)
from mavfi.faults.strata import STRATA
from mavfi.states import STATES
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import DETECTOR, small
from tests.night import at_night

BENCH = load_bench("mavfi-bench-1")
SLOW = BENCH.model_copy(
    update={"parts": {"slow": BENCH.parts["sites"].model_copy(update={"mission": {"platform": "cortex-a57"}})}}
)
"""A bench on a computer that no detector was trained for."""


@pytest.mark.long
def test_every_part_of_a_shipped_bench_can_be_flown():
    for name in names("bench"):
        for part, entry in select_parts(load_bench(name), "paper").items():
            assert entry.campaign.arms, part
            assert entry.part.view in VIEWS
            assert not entry.campaign.on_design_seeds


def test_a_scheme_that_was_trained_for_other_flights_is_left_out_with_the_reason():
    selected = select_parts(SLOW, "quick")["slow"]
    assert "no model is trained" in selected.left_out["gaussian"]
    assert "gaussian" not in selected.campaign.arms and "recommended" in selected.campaign.arms


@pytest.mark.parametrize("part", ["other-profile", *at_night("cortex-a57", "rrt", "rrt-star")])
def test_parts_that_detectors_were_not_trained_for_are_flown_with_the_models_there_are(part):
    selected = select_parts(BENCH, "quick", parts=[part])[part]
    used = resolve(selected.campaign).with_models().models
    trained = select_parts(BENCH, "quick", parts=["sites"])["sites"].campaign
    assert used == resolve(trained).with_models().models
    assert {"gaussian", "limits", "recommended"} <= set(used)


@pytest.mark.long
def test_parts_by_level_and_by_name():
    for level in ("instruction", "memory", "sensor", "message"):
        selected = select_parts(BENCH, "quick", levels=[level])
        assert next(iter(selected)) == level and all(
            level_of(part_of_bench.campaign) == level for part_of_bench in selected.values()
        )
        assert not any(name in selected for name in ("state", "sites", "golden"))
    assert list(select_parts(BENCH, "quick", parts=["sites"])) == ["sites"]


def test_policies_of_dead_nodes_are_flown_where_nodes_die():
    arms = {
        name: entry.campaign.arms
        for name, entry in select_parts(BENCH, "quick", parts=["sites", "instruction"]).items()
    }
    assert "readback" in arms["instruction"] and "readback" not in arms["sites"]


def test_a_detector_of_ones_own_takes_the_place_of_the_schemes():
    selected = select_parts(with_only(BENCH, [DETECTOR]), "quick", parts=["sites"])["sites"].campaign
    assert list(selected.arms) == ["FakeDetector"]
    assert selected.arms["FakeDetector"].detector == DETECTOR


def test_the_faults_of_a_ledger_are_listed_once_each(tmp_path):
    groups = [{"name": "a way-point, x", "sites": ["planning.waypoint.x"]}]
    sampling = {"level": "state", "scheme": "groups", "groups": groups}
    run_campaign(small(missions=2, faults=4, sampling=sampling), tmp_path, executor=LocalExecutor(1))
    head, *lines = faults_of(tmp_path).splitlines()
    assert head == ",".join(FAULT_COLUMNS)
    listed = list(csv.reader(lines))
    assert {row[2] for row in listed} == {"a way-point, x"}
    assert len({tuple(row[:4]) for row in listed}) == len(listed) > 0
    assert all(row[4].startswith(tuple(STATES)) and row[7] in STRATA for row in listed)
    assert checksum(faults_of(tmp_path)) == checksum("\n".join([head, *lines]) + "\n")


def test_shipped_lists_have_one_entry_per_column():
    shipped = sorted((config_root() / FOLDER / BENCH.name).glob("*.csv"))
    lists = [path for path in shipped if not path.name.endswith(ROWS_ENDING)]
    assert lists
    for path in lists:
        head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
        assert tuple(head) == FAULT_COLUMNS and rows and all(len(row) == len(FAULT_COLUMNS) for row in rows), path.name


@pytest.mark.parametrize(
    ("schemes", "selection", "message"),
    [
        (None, {"parts": ["nothing"]}, "part 'nothing': not known; allowed: noise, state"),
        (
            None,
            {"levels": ["nothing"]},
            "level 'nothing': not known; allowed: instruction, memory, message, sensor",
        ),
        (None, {"levels": ["memory"], "parts": ["sites"]}, "in part sites: level 'memory': not known; allowed: state"),
        (None, {"scale": "huge"}, "scale 'huge': not known"),
        ({"readback"}, {"parts": ["sites"]}, "no scheme can fly: without a detector, .* only where nodes die"),
    ],
)
def test_what_cannot_be_flown_is_refused(schemes, selection, message):
    bench = with_schemes(BENCH, list(schemes)) if schemes else BENCH
    with pytest.raises(BadInputError, match=message):
        select_parts(bench, **{"scale": "quick", **selection})


def test_a_bench_that_nobody_can_fly_is_refused():
    with pytest.raises(BadInputError, match="no scheme can fly: .*no model is trained"):
        select_parts(with_only(SLOW, ["gaussian"]), "quick")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "detector '': allowed: a name, or package:Class"),
        (" ", "detector ' ': allowed: a name, or package:Class"),
        ("none", "detector 'none': watches nothing"),
    ],
)
def test_names_of_no_scheme_are_refused(name, message):
    with pytest.raises(BadInputError, match=message):
        with_only(BENCH, [name])


@pytest.mark.parametrize(
    ("part", "changes", "arm", "message"),
    [
        ("../p", {}, "a", "key 'parts.../p': '../p': allowed: a plain folder name"),
        ("scores", {}, "a", "is the name of a table"),
        ("p", {"campaign": "bench_instruction", "scores": True}, "a", "level 'instruction'; allowed: state"),
        ("p", {"campaign": "nothing"}, "a", "nothing"),
        ("p", {}, "../x", "^b.yaml: arms: '../x': allowed: any name without a slash"),
    ],
)
def test_a_wrong_file_of_a_bench_is_refused(part, changes, arm, message):
    bench_parts = {part: {"campaign": "bench_sites", "title": "t", **changes}}
    with pytest.raises(BadInputError, match=message):
        parse(Bench, {"name": "b", "parts": bench_parts, "arms": {arm: {"detector": "acceptance"}}}, "b.yaml")
