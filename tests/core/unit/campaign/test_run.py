"""A campaign leaves the same ledger for any number of workers, after any stop, and whatever dies on the way."""

import errno
import os
import re
import shutil
import signal
import time
from collections import Counter
from dataclasses import asdict
from types import SimpleNamespace

import pytest

from mavfi.campaign import fingerprint
from mavfi.campaign import resolve as resolve_module
from mavfi.campaign import run as run_module
from mavfi.campaign.begin import begin
from mavfi.campaign.executors.executor import Done
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.ledger import status, stored_campaign
from mavfi.campaign.replay import verify
from mavfi.campaign.resolve import resolve
from mavfi.campaign.store import Store
from mavfi.detectors.registry import Loaded
from mavfi.errors import BadInputError, MachineError, SpecMismatchError
from mavfi.flight import compose
from mavfi.record import End
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import (
    BROKEN,
    DEADLY,
    DETECTOR,
    TROUBLE,
    FakeDetector,
    OneByOne,
    deaths,
    failures,
    small,
)

TOTAL = 2 * (2 * (4 + 18) + 3)
INSTRUCTIONS = {"level": "instruction", "kernels": ["pid"]}


def flown_into(directory, campaign=None, workers=1, executor=None, **options):
    return run_campaign(campaign or small(), directory, executor=executor or LocalExecutor(workers), **options)


def digest(directory) -> str:
    with Store.open(directory) as store:
        assert store.complete
        return store.digest()


def stop_at(flown):
    """A progress report that presses Ctrl-C once so many runs are flown."""

    def interrupt(progress):
        if progress.flown == flown:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)  # the signal arrives in here

    return interrupt


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    directory = tmp_path_factory.mktemp("campaign")
    reports = []
    return directory, flown_into(directory, progress=reports.append), reports


def test_everything_is_flown_and_reported(flown):
    directory, end, reports = flown
    assert end.complete
    assert end.done == end.total == TOTAL
    assert end.settings["golden"] == (8, 8, 8)
    assert end.settings["fi"][:2] == (36, 36)
    assert sorted({report.done for report in reports}) == list(range(end.total + 1))
    assert reports[-1].flown == end.total
    assert status(directory) == end
    assert set(asdict(end)) == {"done", "total", "settings", "unknown", "shard", "flies"}, (
        "the session is over: nothing to say of its speed"
    )
    with Store.open(directory) as store:
        assert stored_campaign(store) == small()
        runs = list(store.runs())
    assert all(run.record.end is End.FLOWN for run in runs)
    successes = Counter(run.spec.setting for run in runs if run.record.status == "success")
    assert {name: success for name, (_, _, success) in end.settings.items()} == successes
    assert 0 < successes["fi"] < 36 and reports[-1].settings == end.settings


@pytest.mark.parametrize("fast_forward", [True, False])
def test_two_workers_give_the_same_content_either_way(flown, tmp_path, fast_forward):
    assert flown_into(tmp_path, workers=2, fast_forward=fast_forward) == flown[1]
    assert digest(tmp_path) == digest(flown[0])


@pytest.mark.slow
@pytest.mark.parametrize(("stop_after", "fast_forward"), [(0, True), (40, False), (TOTAL - 1, True)])
def test_ctrl_c_stops_cleanly_and_the_same_call_resumes(flown, tmp_path, stop_after, fast_forward):
    with pytest.raises(KeyboardInterrupt):
        flown_into(tmp_path, workers=2, progress=stop_at(stop_after), fast_forward=not fast_forward)
    flown_before = status(tmp_path).done
    assert stop_after <= flown_before <= stop_after + 20, "what came at once is kept at once"
    reports = []
    end = flown_into(tmp_path, progress=reports.append, fast_forward=fast_forward)
    assert (reports[-1].flown if reports else 0) == end.total - flown_before
    assert end == flown[1]
    assert digest(tmp_path) == digest(flown[0])


@pytest.mark.parametrize("stop_at_plan", [1, 2, 16])
def test_a_campaign_stopped_while_it_is_planned_has_no_gap(flown, tmp_path, monkeypatch, stop_at_plan):
    plans = []

    def stop(store, specs):
        plans.append(specs)
        if len(plans) == stop_at_plan:
            raise KeyboardInterrupt
        return really(store, specs)

    really = Store.plan
    monkeypatch.setattr(Store, "plan", stop)
    with pytest.raises(KeyboardInterrupt):
        flown_into(tmp_path)
    monkeypatch.undo()
    flown_into(tmp_path)
    assert digest(tmp_path) == digest(flown[0])


def test_bad_input_is_found_before_anything_is_written(tmp_path, monkeypatch):
    directory, environment = tmp_path / "out", tmp_path / "own.yaml"
    environment.write_text("name: own\ngenerator: absent\n")
    state_host = "tests.core.unit.campaign.fakes:StateHost"
    for campaign, message in (
        (small(environments=["venus"]), "environment 'venus'"),
        (small(host="nowhere"), "host 'nowhere': not known"),
        (small(environments=[str(environment)]), "generator 'absent': not known"),
        (small(host=state_host, sampling=INSTRUCTIONS), "faults of level 'instruction'"),
    ):
        with pytest.raises(BadInputError, match=message):
            flown_into(directory, campaign)
    assert not directory.exists()


def with_model(monkeypatch, sha=None):
    """Detectors have a model now, whose sha256 is the name of its folder."""

    def load_with_model(scenario, name, profile, models_dir=None, trained_for="", options=None):
        return Loaded(FakeDetector(), sha or (models_dir.name if models_dir else "shipped"))

    monkeypatch.setattr(compose, "detector_for", load_with_model)


def test_another_campaign_or_model_is_refused(flown, tmp_path, monkeypatch):
    directory, _, _ = flown
    before = digest(directory)
    for changed in (small(faults=7), small(mission={"wind": 1.0}), small(arms={})):
        with pytest.raises(BadInputError, match=r"differs in: .*campaign\.(arms|faults: \d, not 7|mission)"):
            flown_into(directory, changed)
    with_model(monkeypatch)
    with pytest.raises(BadInputError, match="differs in: models"):
        flown_into(directory, models_dir=tmp_path / "retrained")
    assert digest(directory) == before


ARMS = {"gaussian": {"detector": DETECTOR}, "windy": {"mission": {"wind": 1.0}}}
STRATA = {"sign_exponent": 2.0, "mantissa": 1.0}


def in_order(turned):
    """A campaign, and the same with its keys turned round."""
    arms, strata = (dict(list(keys.items())[:: -1 if turned else 1]) for keys in (ARMS, STRATA))
    return small(arms=arms, sampling={"strata": strata})


def test_a_file_whose_keys_are_in_another_order_resumes_to_the_same_ledger(tmp_path):
    flown_into(tmp_path / "whole", in_order(False))
    with pytest.raises(KeyboardInterrupt):
        flown_into(tmp_path / "part", in_order(False), progress=stop_at(30))
    assert flown_into(tmp_path / "part", in_order(True)).complete
    assert digest(tmp_path / "part") == digest(tmp_path / "whole")
    with Store.open(tmp_path / "part") as store:
        assert list(stored_campaign(store).arms) == list(ARMS)


def test_runs_know_the_model_that_they_fly_with_and_workers_refuse_another(tmp_path, monkeypatch):
    with_model(monkeypatch)
    flown_into(tmp_path / "out", models_dir=tmp_path / "mine")
    with Store.open(tmp_path / "out") as store:
        assert {(run.spec.arm, run.spec.model) for run in store.runs()} == {("", ""), ("gaussian", "mine")}
        assert store.meta("models_dir") == str(tmp_path / "mine")
    begun = begin(small(), tmp_path / "other", models_dir=tmp_path / "mine")
    with_model(monkeypatch, "trained since")
    with pytest.raises(SpecMismatchError, match="arm gaussian: planned with the model mine, but .*mine holds trained"):
        run_module.run_campaign(begun, tmp_path / "other")
    with Store.open(tmp_path / "other") as store:
        assert {run.record.end for run in store.runs(done=True)} <= {End.FLOWN}, "nothing is recorded of such a flight"


def test_versions_are_not_mixed_within_a_campaign(flown, tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        flown_into(tmp_path, executor=OneByOne(), progress=stop_at(3))
    monkeypatch.setattr(fingerprint, "__version__", "99.0")
    with pytest.raises(BadInputError, match="was begun with mavfi .*, here is 99.0"):
        flown_into(tmp_path)
    assert status(tmp_path).done == 3
    flown_into(flown[0])  # nothing is left to fly, so nothing is mixed


def test_another_python_resumes_faults_in_states_but_not_in_instructions(tmp_path, monkeypatch):
    instructions = small(sampling=INSTRUCTIONS, null_runs=0, arms={})
    for name, campaign in (("state", small()), ("instruction", instructions)):
        with pytest.raises(KeyboardInterrupt):
            flown_into(tmp_path / name, campaign, progress=stop_at(3))
    later = SimpleNamespace(python_version_tuple=lambda: ("3", "99", "0"))
    monkeypatch.setattr("mavfi.levels.instruction.sampling.platform", later)
    resolve_module._NAMES.clear()
    assert flown_into(tmp_path / "state").complete
    with pytest.raises(BadInputError, match=r"was begun with python 3\.\d+, here is 3.99; runs cannot be mixed"):
        flown_into(tmp_path / "instruction", instructions)


@pytest.mark.slow
def test_a_mission_that_died_is_flown_again_with_each_run_in_a_process_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(TROUBLE, "dies", deaths(tmp_path / "deaths", 1000))
    monkeypatch.setattr(TROUBLE, "dies_at", "planning.waypoint")
    groups = [{"name": name, "sites": [f"{name}.x"]} for name in ("planning.waypoint", "planning.path")]
    campaign = small(environments=["sparse"], sampling={"scheme": "groups", "groups": groups}, null_runs=0)
    end = flown_into(tmp_path / "out", campaign, workers=2)
    assert end.complete
    with Store.open(tmp_path / "out") as store:
        runs = list(store.runs())
    dead = [run for run in runs if run.spec.seed == DEADLY and run.spec.target == "planning.waypoint"]
    assert len(dead) == 4
    assert [run for run in runs if run.record.end is not End.FLOWN] == dead
    for run in dead:
        assert (run.record.end, run.record.error) == (End.DUE, "the process died each time")
        assert "status 9" in run.note


@pytest.mark.slow
def test_a_golden_run_that_dies_each_time_is_due_and_nothing_is_drawn_from_it(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(TROUBLE, "golden_dies", deaths(tmp_path / "deaths", 1000))
    end = flown_into(tmp_path / "out", workers=2)
    assert end.complete and end.done < TOTAL
    with Store.open(tmp_path / "out") as store:
        lost = [run for run in store.runs() if run.spec.seed == DEADLY]
        others = [(run.spec, run.record) for run in store.runs() if run.spec.seed != DEADLY]
    assert {run.spec.kind for run in lost} == {"golden"} and len(lost) == 4
    assert {run.record.end for run in lost} == {End.DUE}
    assert all("exit code 9" in run.note for run in lost)
    with Store.open(flown[0]) as store:
        assert others == [(run.spec, run.record) for run in store.runs() if run.spec.seed != DEADLY]


def test_a_process_of_which_all_workers_die_records_nothing(tmp_path, monkeypatch):
    campaign = small(environments=["sparse"], missions=1, first_seed=DEADLY)
    monkeypatch.setattr(TROUBLE, "golden_dies", deaths(tmp_path / "deaths", 1000))
    with pytest.raises(MachineError, match=r"no mission can be flown here: its worker died \(exit code 9\)"):
        flown_into(tmp_path / "out", campaign)
    with Store.open(tmp_path / "out") as store:
        assert [run.record for run in store.runs(done=True)] == []


@pytest.mark.slow
def test_an_exception_of_ours_is_recorded_as_unknown_and_the_rest_is_flown(tmp_path, monkeypatch):
    monkeypatch.setattr(TROUBLE, "raises", True)
    for name, fast_forward in (("fast", True), ("long", False)):
        assert flown_into(tmp_path / name, fast_forward=fast_forward).complete
    with Store.open(tmp_path / "fast") as store:
        unknown = [run for run in store.runs() if run.record.end is End.UNKNOWN]
        injected = [run for run in store.runs() if run.spec.seed == BROKEN and run.spec.fault is not None]
    assert unknown == injected
    for run in unknown:
        assert run.record.error == "ZeroDivisionError" and not run.record.digest
        assert "Traceback" in run.note and "a mistake of ours" in run.note
    assert digest(tmp_path / "fast") == digest(tmp_path / "long")


@pytest.mark.slow
@pytest.mark.parametrize(("number", "done"), [(errno.EMFILE, 0), (errno.EIO, 7), (0, 40)])
def test_a_machine_that_keeps_failing_stops_the_campaign_until_it_is_mended(flown, tmp_path, monkeypatch, number, done):
    monkeypatch.setattr(run_module, "PAUSE_S", 0.0)
    folder = tmp_path / "failures"

    def fail(progress):
        if progress.flown >= done and TROUBLE.machine is None:
            monkeypatch.setattr(TROUBLE, "machine", failures(folder, number, 1000))

    monkeypatch.setattr(TROUBLE, "machine", None)
    what = "out of memory" if number == 0 else re.escape(f"{os.strerror(number)} (/cache/code.nbc)")
    executor = InThisProcess()  # workers would not learn of the trouble
    with pytest.raises(MachineError, match=what):
        run_campaign(small(), tmp_path / "out", executor=executor, progress=fail)
    with Store.open(tmp_path / "out") as store:
        held = [run.record for run in store.runs(done=True)]
    assert len(held) >= done and all(record.end is End.FLOWN for record in held)
    monkeypatch.setattr(TROUBLE, "machine", None)
    assert flown_into(tmp_path / "out") == flown[1]
    assert digest(tmp_path / "out") == digest(flown[0])


@pytest.mark.slow
def test_a_process_that_is_killed_from_outside_is_no_effect_of_a_fault(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "PAUSE_S", 0.0)
    monkeypatch.setattr(TROUBLE, "killed", deaths(tmp_path / "few", 3))
    assert flown_into(tmp_path / "out", workers=2) == flown[1]
    monkeypatch.setattr(TROUBLE, "killed", deaths(tmp_path / "many", 1000))
    with pytest.raises(MachineError, match="killed by SIGKILL"):
        flown_into(tmp_path / "other", workers=2)
    with Store.open(tmp_path / "other") as store:
        assert all(run.record.end is End.FLOWN for run in store.runs(done=True))


class InThisProcess:
    """An executor without workers."""

    forks = True
    workers = 0

    def map(self, function, missions):
        for mission in missions:
            for item in function(mission):
                yield mission, [item]
            yield mission, [Done()]


def test_arms_differ_in_any_key_of_the_mission(tmp_path):
    arms = {
        "slow": {"planner": "rrt"},
        "windy": {"wind": 4.0},
        "loose": {"coupling": "observer"},
        "guarded": {"autopilot": "hardened", "detector": DETECTOR},
        "same": {"mission": {"map": "octree"}},
    }
    campaign = small(environments=["sparse"], missions=2, faults=2, arms=arms, null_runs=12)
    assert flown_into(tmp_path, campaign).complete
    with Store.open(tmp_path) as store:
        runs = list(store.runs())
        scenarios = store.meta("identity")["scenarios"]
    golden = {run.spec.arm: run.record for run in runs if run.spec.kind == "golden" and run.spec.seed == 10_000}
    times = {arm: round(record.flight_time_s - golden[""].flight_time_s, 6) for arm, record in golden.items()}
    assert times == {"": 0.0, "slow": 3.0, "windy": 4.0, "loose": 1.0, "guarded": 0.0, "same": 0.0}
    assert scenarios["sparse/guarded"]["stack"]["name"] == "hardened"
    assert scenarios["sparse/same"]["map"]["kind"] == "octree"
    settings = Counter(run.spec.setting for run in runs)
    assert [settings[name] for name in ("golden", "golden_slow", "fi", "fi_slow", "dr_guarded", "null_same")] == [
        *(2, 2, 6, 6, 6, 2)
    ]
    for run in runs:
        if run.spec.kind == "null":
            assert run.record.digest == golden[run.spec.arm].digest or run.spec.seed != 10_000
            assert run.record.injections[0].activated


# ---- a campaign that becomes a larger one --------------------------------------------------------------------------

ONE_STRATUM = {"level": "state", "strata": {"sign_exponent": 1}}


def large(**changes):
    return small(
        missions=3,
        faults=3,
        environments=["dense", "sparse", "farm"],
        null_runs=3,
        sampling=ONE_STRATUM,
        arms={"late": {"latency_jitter": 0.1}, "gaussian": {"detector": DETECTOR}},
        **changes,
    )


def test_an_extended_campaign_is_the_large_one_flown_from_the_start(tmp_path):
    flown_into(tmp_path / "large", large(grown=[{"missions": 2, "faults": 2}]))
    begun = small(missions=2, faults=2, null_runs=1, sampling=ONE_STRATUM)
    flown_into(tmp_path / "grown", begun)
    with Store.open(tmp_path / "grown") as store:
        stored_texts = {row.run_id: result.text for row, result in store.rows()}
    reports = []
    with pytest.raises(KeyboardInterrupt):
        flown_into(tmp_path / "grown", large(), extend=True, executor=OneByOne(), progress=stop_at(7))
    end = flown_into(tmp_path / "grown", large(), progress=reports.append)  # the ledger is that of the large one now
    assert end == status(tmp_path / "large")
    assert reports[-1].flown == end.total - len(stored_texts) - 7, "nothing is flown twice"
    assert digest(tmp_path / "grown") == digest(tmp_path / "large")
    with Store.open(tmp_path / "grown") as store:
        assert {run_id: store.record_text(run_id) for run_id in stored_texts} == stored_texts
    flown_into(tmp_path / "grown", large(), extend=True)  # nothing is left to do
    assert verify(tmp_path / "grown", 1.0).differing == ()


def test_an_arm_is_added_and_null_runs_take_the_arms_in_turn_as_before(flown, tmp_path):
    shutil.copytree(flown[0], tmp_path / "grown")
    more = small(arms={"gaussian": {"detector": DETECTOR}, "late": {"latency_jitter": 0.1}})
    with pytest.raises(BadInputError, match="choose another directory, or keep its runs with --extend"):
        flown_into(tmp_path / "grown", more)
    reports = []
    end = flown_into(tmp_path / "grown", more, extend=True, progress=reports.append)
    assert reports[-1].flown == end.total - TOTAL + 2, "one null run in each environment is that of the new arm"
    flown_into(tmp_path / "large", more)
    assert digest(tmp_path / "grown") == digest(tmp_path / "large")


def test_what_is_drawn_together_is_extended_by_missions_only():
    def drawn(missions, faults, grown=()):
        campaign = small(missions=missions, faults=faults, grown=grown, null_runs=0, sampling=INSTRUCTIONS, arms={})
        sampler = resolve(campaign).sampler
        return [sampler.basis("sparse", sampler.blocks("sparse")[0].draw(index)) for index in range(2)]

    begun = [{"missions": 2, "faults": 2}]
    assert drawn(2, 2) == drawn(4, 4, begun)
    assert drawn(2, 2) != drawn(2, 4, begun), "two faults of one stream are not the one and another"


def test_a_campaign_with_several_faults_in_a_mission_is_refused_when_it_grows():
    combined = {"level": "combined", "of": [ONE_STRATUM], "faults_per_mission": 2}
    with pytest.raises(ValueError, match="missions, faults: with several faults in a mission"):
        small(sampling=combined, null_runs=0, grown=[{"missions": 4, "faults": 3}])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"missions": 3}, "key 'missions': 3; the ledger has 4; allowed: 4 or more"),
        ({"faults": 9, "grown": [{"missions": 4, "faults": 5}]}, "key 'grown': lacks a size that the ledger has had"),
        ({"environments": ["dense"]}, "key 'environments': lacks sparse"),
        ({"first_seed": 20_000}, "key 'first_seed': differs"),
        ({"mission": {"v_max": 4.0}}, "key 'mission': differs"),
        ({"arms": {"gaussian": {"detector": DETECTOR, "profile": "tuned"}}}, "key 'arms.gaussian': differs"),
    ],
)
def test_what_does_not_extend_a_campaign_is_refused_with_its_key(flown, changes, message):
    directory, end, _ = flown
    before = digest(directory)
    with pytest.raises(BadInputError, match=re.escape(message)):
        flown_into(directory, small(**changes), extend=True)
    assert (digest(directory), status(directory)) == (before, end)
