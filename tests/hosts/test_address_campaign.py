"""A campaign that strikes addresses: the same bytes for any workers, after a stop, on replay; its page, its stories."""

import html
import json
import os
import re
import shlex
import subprocess
import sys

import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.kernel_rows import DUE, read_kernel_runs
from mavfi.campaign.replay import replay
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.cli import run
from mavfi.faults.instruction import launch
from mavfi.hosts import template
from mavfi.reports.change import change
from mavfi.reports.explain import explain, lines
from tests.hosts.missions import run_in_two_sittings

pytestmark = pytest.mark.slow


def campaign(which="address", faults=8):
    return Campaign.model_validate({
        "name": "addresses", "environments": ["sparse"], "first_seed": 7, "flights": 2, "faults": faults,
        "law": "kernels", "kernels": {"names": ["pid", "point_cloud"], "which": which}, "null_runs": 0,
        "v_max": 6.0,
    })  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    directory = tmp_path_factory.mktemp("addresses")
    assert run_campaign(campaign(), directory, workers=1).complete
    return directory


@pytest.fixture(scope="module")
def runs(folder):
    with Store.open(folder) as store:
        return read_kernel_runs(store)


def records(directory):
    with Store.open(directory) as store:
        assert store.complete
        return {stored.spec.run_id: stored.record for stored in store.runs(done=True)}


def test_there_are_crashes_and_corruptions_and_all_can_be_replayed(runs):
    assert {"crash", "sdc"} <= {run.outcome for run in runs}
    assert all(run.replayable and run.value_class == "address" for run in runs)


def test_workers_and_stops_do_not_matter(folder, tmp_path):
    run_in_two_sittings(campaign(), tmp_path, flown=9)
    assert records(tmp_path) == records(folder)


@pytest.mark.parametrize("outcome", ["crash", "sdc", "masked"])
def test_the_command_gives_the_same_bytes_in_a_fresh_process(folder, runs, outcome):
    chosen = next((run for run in runs if run.outcome == outcome), None)
    if chosen is None:
        pytest.skip(f"no run was {outcome}")
    done = subprocess.run(
        [sys.executable, "-m", "mavfi", "replay", str(folder), chosen.run_id, "--json"], capture_output=True,
        text=True, check=True, env=os.environ | {"SOMETHING": "else"},
    )  # fmt: skip
    told = json.loads(done.stdout)
    assert told["same"] and told["replayable"]
    again, stored = replay(folder, chosen.run_id).flight.log, records(folder)[chosen.run_id]
    assert again.injections == stored["injections"], "value before and after too"
    assert again.meta["kernel_outcome"] == stored["kernel_outcome"]


def test_explain_names_line_values_and_first_output_that_differed(folder, runs, capsys):
    for chosen in {one.outcome: one for one in runs}.values():
        story = dict(lines(explain(folder, chosen.run_id)))
        record = records(folder)[chosen.run_id]["injections"][0]
        assert f"{chosen.file}:{chosen.line}" in story["source line"]
        assert story["fault"].endswith(" → ".join(change(record["before"], record["after"])))
        assert chosen.kernel in story["kernel"]
        if chosen.first_difference is not None:
            first = chosen.first_difference
            assert first["state"] in story["kernel"] and first["field"] in story["kernel"]
        if chosen.outcome in DUE:
            assert chosen.detail in story["kernel"]
        assert run(["explain", str(folder), chosen.run_id]) == 0
        shown = "".join(capsys.readouterr().out.split())
        assert all("".join(sentence.split()) in shown for sentence in story.values())


def test_a_command_of_the_page_gives_the_same_flight(folder, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert run(["vulnerability", str(folder), "--html", str(page)]) == 0
    capsys.readouterr()
    commands = sorted(set(re.findall(r"mavfi replay [^<\n]+", html.unescape(page.read_text(encoding="utf-8")))))
    assert len(commands) > 1
    for command in commands[:2]:
        program, *arguments = shlex.split(command)
        assert program == "mavfi"
        assert run([*arguments, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["same"]


def test_where_addresses_cannot_be_fixed_rows_and_report_say_so(tmp_path, monkeypatch, capsys):
    template.close_templates()
    monkeypatch.setattr(launch, "_personality", lambda wanted=0: -1)
    try:
        assert run_campaign(campaign("all", 6), tmp_path, workers=1).complete
    finally:
        template.close_templates()
    with Store.open(tmp_path) as store:
        found = read_kernel_runs(store)
    assert {run.replayable for run in found if run.value_class in ("address", "control")} == {False}
    assert {run.replayable for run in found if run.value_class in ("floating_point", "integer")} == {True}
    assert run(["report", str(tmp_path)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"{sum(run.replayable for run in found)} of {len(found)} flights can be replayed" in text
