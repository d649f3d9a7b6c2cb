"""What a view is: rows, groups, measures; and that one measure which raises does not take the table with it."""

import csv
import io
import json
from dataclasses import replace

import polars as pl
import pytest

from mavfi.analysis import published as paper
from mavfi.analysis.findings import findings
from mavfi.analysis.measures import Measure, count, rate
from mavfi.analysis.runs import Runs, drawn
from mavfi.analysis.table import NUMBER, RATE, UNKNOWN
from mavfi.analysis.views import VIEWS, View, table, views_for
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.config import config_root, read_yaml
from mavfi.errors import BadInputError
from tests.core.unit.analysis.handmade import FAULT, INSTRUCTION, flown, golden, injected, runs

BROUGHT_BACK = (("", False), ("mine", True))
"""Arms, and whether the mission succeeds."""


@pytest.fixture
def two_environments():
    ends = {("sparse", 1): True, ("dense", 1): False, ("sparse", 2): False}
    return runs(*(injected(seed, flown(success), environment=name) for (name, seed), success in ends.items()))


def test_rows_of_an_environment_stand_together_and_a_total_below(two_environments):
    view = View("x", "X", ("environment", "seed"), (count("n", "n"),), total=("environment", "all"))
    assert [row[:2] for row in view.table(two_environments).rows] == [
        ("sparse", 1),
        ("sparse", 2),
        ("dense", 1),
        ("all", 1),
        ("all", 2),
    ]


def test_values_across_make_columns_and_measures_rows(two_environments):
    measures = (rate("success", "here", "success"), Measure("none", "never", RATE, lambda _: None))
    shown = View("x", "X", ("setting",), measures, across="environment").table(two_environments)
    assert [column.key for column in shown.columns] == ["setting", "measure", "sparse", "dense"]
    [(setting, heading, sparse, dense)] = shown.rows
    assert (setting, heading, sparse.successes, dense.successes) == ("fi", "here", 1, 0)


def test_a_measure_that_raises_gives_unknown_and_the_rest_continues(two_environments):
    broken = Measure("ratio", "a ratio", NUMBER, lambda two_environments: 1 / 0)
    shown = View("x", "X", ("environment",), (count("n", "n"), broken)).table(two_environments)
    assert shown.rows == [("sparse", 2, UNKNOWN), ("dense", 1, UNKNOWN)]
    assert any(note.startswith("a ratio: unknown (ZeroDivisionError") for note in shown.notes)


def test_each_cell_knows_the_runs_that_it_was_computed_from(two_environments):
    measures = (rate("success", "success", "success", pl.col("seed") == 1), count("lost", "lost", ~pl.col("success")))
    shown = View("x", "X", ("environment",), measures).table(two_environments)
    ids = dict(
        zip(
            zip(two_environments["environment"], two_environments["seed"], strict=True),
            two_environments["run_id"],
            strict=True,
        )
    )
    sparse = (ids["sparse", 1], ids["sparse", 2])
    assert shown.behind[0] == (sparse, (ids["sparse", 1],), (ids["sparse", 2],))
    assert [len(row) for row in shown.behind] == [len(row) for row in shown.rows]
    across = View("x", "X", ("setting",), measures, across="environment").table(two_environments)
    assert across.behind[1] == (two_environments.ids, (), (ids["sparse", 2],), (ids["dense", 1],)), (
        "the name of a measure opens none"
    )


def test_views_are_found_by_name_and_an_unknown_one_is_refused(two_environments):
    assert table(two_environments, "endings").title == "How missions ended"
    with pytest.raises(BadInputError, match="view 'nothing': not known; allowed: endings, success_as_in_the_paper"):
        table(two_environments, "nothing")


def test_nothing_flown_gives_no_table_and_no_view_raises():
    empty = Runs.of([])
    assert views_for(empty) == []
    for view in VIEWS.values():
        assert view.name.startswith("redundancy") or view.table(empty).rows == []


def test_a_campaign_with_groups_begins_with_them():
    leading = injected(1, flown(success=False), target="way-point")
    other_bits = replace(FAULT, stratum="mantissa")
    others = [injected(1, flown(success=lost), other_bits, target="epoch", arm=arm) for arm, lost in BROUGHT_BACK]
    campaign = runs(golden(1), leading, *others, each="group")
    assert [row[1] for row in views_for(campaign)[0].rows] == ["no fault", "way-point", "epoch"]
    assert "mine brings back 1 of 1 lost missions and newly loses 0." in findings(campaign)
    assert any("with one fault 0.0 %" in sentence and "(n = 2)" in sentence for sentence in findings(campaign)), (
        "no group is left out of the summary, though one has no faults in the leading bits"
    )


def test_an_arm_without_a_detector_is_compared_in_one_sentence_with_golden_rates():
    lost = [injected(seed, flown(success=seed == 1)) for seed in (1, 2, 3)]
    saved = [injected(seed, flown(), arm="b") for seed in (1, 2, 3)]
    saved = [replace(run, spec=replace(run.spec, detector="")) for run in saved]
    (verdict,) = [
        sentence for sentence in findings(runs(golden(1), *lost, *saved)) if "On the same missions" in sentence
    ]
    assert "b succeeds in 100.0 % [43.9, 100.0], the campaign's own mission in 33.3 % [6.1, 79.2] (n = 3)" in verdict
    assert "b saves 2 that are lost without it and loses 0" in verdict
    assert not any("brings back" in sentence for sentence in findings(runs(golden(1), *lost, *saved)))


def test_tables_as_csv_and_json(two_environments):
    view = View("x", "X", ("environment",), (rate("success", "s", "success"), count("n", "n")))
    shown = view.table(two_environments)
    rows = list(csv.DictReader(io.StringIO(shown.to_csv())))
    assert [row["environment"] for row in rows] == ["sparse", "dense"]
    assert float(rows[0]["success"]) == 0.5 and float(rows[0]["success_low"]) < 0.5 and rows[0]["success_n"] == "2"
    data = json.loads(json.dumps(shown.to_json(), allow_nan=False))
    assert data["rows"][0]["success"]["successes"] == 1 and data["name"] == "x"
    assert shown.column("n") == [2, 1]
    with pytest.raises(KeyError):
        shown.column("m")
    assert View("y", "Y", ("seed",), ()).table(Runs.of([])).to_csv() == "seed\n"


def test_every_table_names_the_autopilot_profile_and_its_deviations(two_environments):
    for shown_view in views_for(two_environments):
        assert shown_view.notes[-1].startswith(
            "autopilot profile published; deviates from the published code: grace 1 s"
        )
    hardened = runs(injected(1, flown()), profile="hardened")
    assert "not the paper's" in views_for(hardened)[0].notes[-1]


# ---- the paper ---------------------------------------------------------------------------------------------------
def test_figures_of_the_paper_have_sources_and_are_found_by_key():
    held = read_yaml(config_root() / "figures" / "mavfi_paper.yaml")["figures"]
    assert all(figure["source"] and figure["by"] and figure["values"] for figure in held.values())
    assert paper.success("sparse", "fi") == 0.883
    assert paper.success("sparse", "dr_own") is None and paper.success("clutter", "fi") is None
    assert paper.recovery("dense", "dr_gaussian") == pytest.approx((0.830 - 0.753) / (0.850 - 0.753))
    assert paper.worst_time("farm", "dr_gaussian") == pytest.approx(0.742 - 0.635)


def test_only_what_the_paper_flew_is_compared_with_its_figures():
    entries = [golden(1), injected(1, flown())]
    assert table(runs(*entries), "success").column("paper") == [0.95, 0.883]
    unlike = {"mission": ["planner rrt"], "faults": [], "arms": {}}
    shown = table(runs(*entries, unlike_the_paper=unlike), "success")
    assert "paper" not in [column.key for column in shown.columns]
    assert shown.notes[0] == "not compared with the paper, which flew otherwise: planner rrt"
    watched = runs(*entries, injected(1, flown(), arm="gaussian"))
    assert table(watched, "success").column("paper")[-1] == 0.943
    unlike = {"mission": [], "faults": [], "arms": {"gaussian": ["profile tuned"]}}
    assert table(replace(watched, campaign={**watched.campaign, "unlike_the_paper": unlike}), "success").column(
        "paper"
    ) == [0.95, 0.883, None]


def test_only_what_the_paper_flew_is_called_its_table():
    entries = [golden(1), injected(1, flown(), INSTRUCTION, target="control")]
    name = "instructions_as_in_the_paper"
    assert "the paper's Table I" in table(runs(*entries), name).title
    unlike = {"mission": [], "faults": ["no faults in planning"], "arms": {}}
    shown = table(runs(*entries, unlike_the_paper=unlike), name)
    assert shown.title == "Instruction level: success rates, one fault per mission"
    assert [row[:2] for row in shown.rows if "paper" in row] == []


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({"mission": {"planner": "rrt", "v_max": 4.5}}, ["planner rrt", "v_max 4.5"]),
        ({"parts": {"sparse": {"environment": "dense"}}}, ["sparse = dense on the same computer"]),
        (
            {"sampling": {"level": "instruction", "kernels": ["octomap", "pid"], "share": "stage"}},
            ["no faults in planning"],
        ),
        (
            {"sampling": {"scheme": "groups", "groups": [{"name": "x", "sites": ["planning.waypoint.x"]}]}},
            ["groups x", "30 faults per group, not per stage"],
        ),
        (
            {"arms": {"gaussian": {"detector": "gaussian", "profile": "tuned", "wind": 5}}},
            ["wind 5.0", "profile tuned"],
        ),
    ],
)
def test_what_a_campaign_does_otherwise_than_the_paper(changes, expected):
    campaign = Campaign.model_validate({"name": "own", "environments": ["sparse"], **changes})
    unlike = drawn(campaign)["unlike_the_paper"]
    of_arms = [text for texts in unlike["arms"].values() for text in texts]
    assert [*unlike["mission"], *unlike["faults"], *of_arms] == expected


@pytest.mark.parametrize("name", ["as_published", "table1", "table1_instructions", "platforms"])
def test_campaigns_of_the_study_are_comparable_with_the_paper(name):
    assert drawn(load_campaign(name))["unlike_the_paper"] == {"mission": [], "faults": [], "arms": {}}
