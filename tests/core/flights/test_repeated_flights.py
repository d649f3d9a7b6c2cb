# ruff: noqa: NPY002 - planners that use the global generator are what is tested
"""A golden flight with custom parts is flown twice; if the two differ, no effect of a fault is claimed."""

import sqlite3

import numpy as np
import pytest

import mavfi
from mavfi.campaign.begin import check_null_runs
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.store import FILE, Store
from mavfi.cli import run
from mavfi.detectors import Alarm, Detector
from mavfi.errors import BadInputError, MavfiError
from mavfi.flight.host import ArmSetup
from mavfi.flight.mission_flights import LocalHost
from mavfi.numerics.random import seed_generator
from mavfi.plugins import allow_typed
from mavfi.record import End
from tests.campaigns import run_campaign
from tests.core.flights.missions import GOAL, mission

MISSION = {"environment": "dense", "seed": 1, "goal": GOAL}
FAULT = "state:planning.waypoint.z:bit=0@3"
DIFFER = r"^two flights without a fault differ from \d+\.\d\d s on, so no effect of a fault can be told"


class Unseeded:
    """Draws from a generator that no seed determines."""

    def __init__(self, config, seed):
        self.random = seed_generator(seed, 1)

    def draw(self):
        return np.random.default_rng().random()

    def search(self, counter, grid, start, goal, lower, upper):
        middle = 0.5 * (start + goal)
        middle[2] += 4.0 + 1e-3 * self.draw()
        return np.array([start, middle, goal])


class OfTheProcess(Unseeded):
    """Draws from the global generator, which it seeds: no checkpoint contains it."""

    def __init__(self, config, seed):
        super().__init__(config, seed)
        np.random.seed(seed)

    def draw(self):
        return np.random.random()


class OfItsOwn(Unseeded):
    """Draws from an attribute, which checkpoints contain."""

    def __init__(self, config, seed):
        super().__init__(config, seed)
        self.generator = np.random.default_rng(seed)

    def draw(self):
        return self.generator.random()


class Counts(Detector):
    """Its memory of earlier flights is written by `check`, and not forgotten by `start`."""

    states = frozenset({"control.command"})
    checks = 0

    def check(self, state, time_us):
        self.checks += 1
        if self.checks == 600:
            return Alarm("counts", stage="control")
        return None


class Changes(Detector):
    """Changes a command by its lowest bit, from 2 s on."""

    states = frozenset({"control.command"})

    def check(self, state, time_us):
        if state.spec.name == "control.command" and time_us > 2_000_000:
            state.header.view(np.uint8)[0] ^= 1


def address(part):
    name = f"{__name__}:{part.__name__}"
    allow_typed([name])
    return name


@pytest.mark.parametrize("fault", [None, FAULT])
@pytest.mark.parametrize("planner", [Unseeded, OfTheProcess])
def test_a_planner_that_flies_otherwise_each_time_is_told_before_any_effect(planner, fault):
    state = np.random.get_state()[1].copy()
    with pytest.raises(MavfiError, match=DIFFER) as refusal:
        mavfi.fly(**MISSION, planner=address(planner), fault=fault)
    assert planner.__name__ in str(refusal.value)
    if planner is Unseeded:
        assert (np.random.get_state()[1] == state).all(), "the caller's generator is as it was"


def test_a_planner_whose_generator_is_an_attribute_flies():
    result = mavfi.fly(**MISSION, planner=address(OfItsOwn), fault=FAULT)
    assert result.effect is not None


def test_alarms_are_compared_too():
    with pytest.raises(MavfiError, match=r"differ in their alarms \(0, then 1\)"):
        mavfi.fly(**MISSION, detector=Counts())


def test_a_detector_that_changes_a_state_is_named():
    with pytest.raises(BadInputError, match=r":Changes: check changed control.command at 2\.\d\d s"):
        mavfi.fly(**MISSION, detector=Changes())


def test_a_detector_that_changes_a_state_ends_its_own_runs_of_a_campaign_alone(tmp_path):
    arms = {"changes": {"detector": address(Changes)}}
    keys = {"name": "changes", "environments": ["dense"], "first_seed": 1, "missions": 1, "faults": 1, "arms": arms}
    campaign = Campaign.model_validate({**keys, "mission": {"goal": GOAL}, "null_runs": 2})
    run_campaign(campaign, tmp_path, executor=LocalExecutor(1))
    with Store.open(tmp_path) as store:
        ends = {(run.spec.arm, run.record.end) for run in store.runs()}
        (reason,) = store.unknown()
    assert ends == {("", End.FLOWN), ("changes", End.UNKNOWN)}
    assert "check changed control.command at" in reason


def test_the_command_line_says_it_first_and_fails(capsys):
    flags = ["--environment", "dense", "--seed", "1", "--goal", *map(str, GOAL)]
    assert run(["fly", *flags, "--planner", address(Unseeded), "--fault", FAULT]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines()[-1].startswith("mavfi: two flights without a fault differ")


def test_a_campaign_draws_no_fault_from_a_golden_flight_that_differs(tmp_path):
    keys = {"goal": GOAL, "planner": address(Unseeded)}
    campaign = Campaign.model_validate(
        {"name": "differs", "environments": ["dense"], "first_seed": 1, "missions": 1, "faults": 1, "mission": keys}
    )
    status = run_campaign(campaign, tmp_path, executor=LocalExecutor(1))
    assert status.unknown == 1
    with Store.open(tmp_path) as store:
        (golden,) = store.runs()
        ((reason, _),) = store.unknown().most_common()
    assert golden.spec.kind == "golden"
    assert reason.startswith("two flights without a fault differ")


def test_what_is_part_of_mavfi_is_flown_once(monkeypatch):
    flown = []
    monkeypatch.setattr("mavfi.flight.mission_flights.check_repetition", lambda *flights: flown.append(flights))
    LocalHost().mission({"": ArmSetup(mission())}, fast_forward=False).golden("")
    assert not flown


def test_a_campaign_with_custom_parts_has_null_runs(tmp_path):
    keys = {"name": "none", "environments": ["dense"], "null_runs": 0}
    refused = Campaign.model_validate({**keys, "arms": {"own": {"detector": address(Counts)}}})
    with pytest.raises(BadInputError, match=r"null_runs: 0: \S+:Counts is custom, .*; allowed: 1 or more"):
        check_null_runs(refused, tmp_path)
    check_null_runs(Campaign.model_validate({**keys, "arms": {"shipped": {"detector": "recommended"}}}), tmp_path)


def test_null_runs_are_compared_with_the_golden_run_of_their_arm(tmp_path):
    campaign = Campaign.model_validate(
        {
            "name": "nulls",
            "environments": ["dense"],
            "first_seed": 1,
            "missions": 1,
            "faults": 1,
            "null_runs": 2,
            "mission": {"goal": GOAL},
            "arms": {"idle": {"detector": "none"}},
        }
    )
    run_campaign(campaign, tmp_path, executor=LocalExecutor(1))
    with Store.open(tmp_path) as store:
        assert not store.differing_null_runs()
    with sqlite3.connect(tmp_path / FILE) as connection:
        changed = "UPDATE runs SET record = json_set(record, '$.alarms_total', 1) WHERE setting = 'null_idle'"
        assert connection.execute(changed).rowcount == 1
        # what a detector that remembers in `check` leaves
        store = Store(tmp_path, connection)
        assert [run_id.rpartition("-null-")[0] for run_id in store.differing_null_runs()] == ["dense-1-null_idle"]


@pytest.mark.parametrize(("seconds", "charged"), [(None, "0.073"), (0.5, "0.5")])
def test_what_a_path_is_charged_as_is_said_where_a_custom_planner_flies(seconds, charged, capsys):
    flags = ["--environment", "dense", "--seed", "1", "--goal", *map(str, GOAL), "--planner", address(OfItsOwn)]
    if seconds is not None:
        flags += ["--planner-latency", str(seconds)]
    assert run(["fly", *flags]) == 0
    text = " ".join(word for word in capsys.readouterr().out.split() if word != "│")
    assert f":OfItsOwn: a path is charged as {charged} s of flight; here it took" in text
    assert "--planner-latency sets it" in text


def test_the_planner_takes_as_long_as_its_key_says():
    times = {}
    for seconds in (0.1, 2.0):
        log = mavfi.fly(**MISSION, planner_latency=seconds).log
        times[seconds] = next(event.time_us for event in log.events if event.kind == "plan")
    assert times[2.0] - times[0.1] == 1_900_000
