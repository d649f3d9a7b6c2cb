"""Contract suites for plug-ins: pytest classes that the author of one subclasses, and that mavfi's own ones pass.

Example: `class TestMyDetector(DetectorContract): detector = "my_package:MyDetector"`.
"""

import json
import pickle
from collections.abc import Callable, Sequence
from dataclasses import FrozenInstanceError, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mavfi.config import PlannerConfig
from mavfi.detectors.detector import Detector, checked_alarm, require_detector
from mavfi.detectors.registry import mission_keys
from mavfi.faults.fault import Fault, fault_from_json, find_level
from mavfi.flight.compose import detector_for, resolve
from mavfi.flight.fly import fly
from mavfi.flight.host import ArmSetup, Host, host_class
from mavfi.levels.level import Level, Sampler, parse, text_of
from mavfi.mission import MissionSpec
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.planners import MOST_VERTICES, PathSearch, make_search
from mavfi.plugins import allow_typed
from mavfi.states import State


class LevelContract:
    """What campaigns, ledgers and commands expect of a fault level.

    Attributes:
        level: The level, which is installed as an entry point.
        faults: Some of its faults.
        campaign: Further keys of a campaign with its faults.
        golden: Golden runs from which a campaign draws (`levels.level.Golden`), by variant.
        environments: Environments of the campaign.
    """

    level: ClassVar[type[Level]]
    faults: ClassVar[Sequence[Fault]]
    campaign: ClassVar[dict[str, Any]] = {}
    golden: ClassVar[Any] = {}
    environments: ClassVar[tuple[str, ...]] = ("sparse",)

    def test_it_is_found_by_the_name_of_its_faults(self) -> None:
        """The name of the entry point is the level of the faults."""
        level = find_level(self.level.fault.level)
        if "host" in self.campaign:
            level = self._campaign().level  # the host may draw these faults otherwise
        assert type(level) is self.level

    def test_its_faults_are_data(self) -> None:
        """Ledgers store them as JSON, other processes get them pickled, sets have them."""
        for fault in self.faults:
            assert type(fault) is self.level.fault and isinstance(fault.site, str)
            assert fault_from_json(json.loads(json.dumps(fault.to_json(), allow_nan=False))) == fault
            assert pickle.loads(pickle.dumps(fault)) == fault and len({fault, replace(fault)}) == 1
            try:
                fault.seed = 1  # type: ignore[misc]
            except FrozenInstanceError:
                continue
            raise AssertionError(f"{fault} can be changed")

    def test_the_text_of_a_fault_is_understood(self) -> None:
        """`mavfi shrink` prints the text as a command."""
        level = find_level(self.level.fault.level)
        for fault in self.faults:
            text = text_of(fault)
            if text is not None:
                assert text.startswith(f"{fault.level}:") and level.form
                parse(text)
            assert level.seed_of(fault) in (None, fault.seed)

    def test_smaller_faults_are_of_the_same_level(self) -> None:
        """Each step of `mavfi shrink` has a finite number of candidates, none of which is the fault itself."""
        level = find_level(self.level.fault.level)
        for fault in self.faults:
            for candidates in level.reductions.values():
                smaller = list(candidates(fault, None))
                assert fault not in smaller
                assert all(type(candidate) is self.level.fault for candidate in smaller)

    def test_its_faults_are_described(self) -> None:
        """Tables have columns of plain values; explanations have words for what did not happen."""
        level = find_level(self.level.fault.level)
        for fault in self.faults:
            assert json.dumps(level.columns(fault)) is not None
        assert all(isinstance(words, str) and words for words in level.absent)

    def test_draws_of_a_campaign_are_a_function_of_its_data(self) -> None:
        """Shards and resumed campaigns draw the same faults, one for each place in the plan."""
        if self.level.sampling is None:
            return
        drawn = [self._drawn() for _ in range(2)]
        assert drawn[0] == drawn[1] and drawn[0]
        for fault in drawn[0]:
            assert fault is None or type(fault) is self.level.fault

    def test_a_campaign_says_how_it_draws(self) -> None:
        """Tables name what the number of faults counts."""
        if self.level.sampling is not None:
            campaign = self._campaign()
            about = campaign.level.about(campaign)
            assert about["each"] and ("how" in about or "lines" in about)

    def _campaign(self) -> Any:
        from mavfi.campaign.config import Campaign

        sampling = {"level": self.level.fault.level, **self.campaign.get("sampling", {})}
        content = {"name": "contract", "environments": self.environments, "missions": 2, "faults": 4, **self.campaign}
        campaign = Campaign.model_validate({**content, "sampling": sampling})
        assert Campaign.model_validate(campaign.to_json()) == campaign, "a ledger stores the campaign"
        return campaign

    def _drawn(self) -> list[Fault | None]:
        campaign = self._campaign()
        sampler: Sampler = campaign.level.sampler(campaign)
        environment = self.environments[0]
        draws = [block.draw(index) for block in sampler.blocks(environment) for index in range(block.count)]
        return sampler.draw(draws, environment, self.golden)


class HostContract:
    """What campaigns and commands expect of a host.

    Attributes:
        host: Its name, that of the entry point.
        under_test: What is under test, as in a campaign's file; None = mavfi's pipeline.
        mission: A mission that it flies.
        fault: A fault of a level that it does not inject.
    """

    host: ClassVar[str]
    under_test: ClassVar[dict[str, Any] | None] = None
    mission: ClassVar[MissionSpec] = MissionSpec(environment="sparse")
    fault: ClassVar[Fault | None] = None

    def make(self) -> Host:
        """The host."""
        tested_class = host_class(self.host)
        make: Callable[..., Host] = tested_class
        assert (tested_class.config is None) == (self.under_test is None) == (not tested_class.config_key)
        if tested_class.config is None:
            return make()
        return make(tested_class.config.model_validate(self.under_test))

    def test_it_declares_what_it_is(self) -> None:
        """The declarations are of the declared types."""
        host = self.make()
        assert isinstance(host, Host) and host.name == self.host
        assert host.levels and all(find_level(level).fault.level == level for level in host.levels)
        assert host.single_levels <= host.levels
        assert {type(value) for value in (host.deterministic, host.flies, host.in_process)} == {bool}

    def test_a_mission_is_resolved_to_data_with_a_key(self) -> None:
        """A ledger stores the scenario, and compares its key."""
        scenarios = [self.make().resolve(self.mission) for _ in range(2)]
        assert scenarios[0].key() == scenarios[1].key()
        assert json.dumps(scenarios[0].to_json())

    def test_a_campaign_accepts_its_key(self) -> None:
        """What is under test is validated, stored under the key, and read again."""
        from mavfi.campaign.config import Campaign

        host = host_class(self.host)
        keys: dict[str, Any] = {}
        if self.under_test is not None:
            keys[host.config_key] = self.under_test
        level = min(self.make().levels)
        content = {
            "name": "contract",
            "host": self.host,
            "environments": ["sparse"],
            "sampling": _sampling(level),
            **keys,
        }
        campaign = Campaign.model_validate(content)
        assert Campaign.model_validate(campaign.to_json()) == campaign
        assert (host.config_key in campaign.to_json()) or not keys

    def test_preparing_a_mission_flies_nothing(self) -> None:
        """Flights are prepared for all arms of a mission; a fault of another level ends its own run only."""
        host = self.make()
        if not host.flies:
            return
        flights = host.mission({"": ArmSetup(host.resolve(self.mission))}, fast_forward=False)
        if self.fault is not None:
            ((number, error),) = flights.injected([("", self.fault)])
            assert number == 0 and "allowed: " in str(error)


def _sampling(level: str) -> dict[str, Any]:
    if level == "instruction":
        return {"level": level, "kernels": ["pid"]}
    if level == "combined":
        return {"level": level, "of": ["null"]}
    return {"level": level}


@cache
def _publications(mission: str) -> list[tuple[State, int]]:
    """Publications of a golden flight, in order, with their instants (us)."""
    published: list[tuple[State, int]] = []
    fly(
        resolve(MissionSpec.model_validate_json(mission)), recorders=[lambda state, now: published.append((state, now))]
    )
    return published


class DetectorContract:
    """What flights, campaigns and recovery expect of a detector.

    Attributes:
        detector: Its name, or "package:Class".
        profile: Profile of a trained detector.
        models: Folder of trained models; None = the shipped ones.
        options: Options of the detector.
        mission: The mission that it watches.
        most_alarms: Alarms that it may raise in the golden flight of that mission.
    """

    detector: ClassVar[str]
    profile: ClassVar[str] = "tuned"
    models: ClassVar[Path | None] = None
    options: ClassVar[dict[str, Any]] = {}
    mission: ClassVar[MissionSpec] = MissionSpec(environment="sparse", seed=1)
    most_alarms: ClassVar[int] = 0

    def make(self) -> Detector:
        """The detector, as it starts a flight."""
        allow_typed([self.detector])
        scenario = resolve(self.mission)
        detector = detector_for(scenario, self.detector, self.profile, self.models, options=self.options).detector
        detector.start()
        return detector

    def publications(self) -> list[tuple[State, int]]:
        """What it receives: publications of the golden flight, of the states that it reads."""
        states = self.make().states
        published = _publications(self.mission.model_dump_json(exclude_unset=True))
        return [(state, now) for state, now in published if states is None or state.spec.name in states]

    def test_it_declares_what_it_is(self) -> None:
        """It inherits `Detector`, reads states that exist, and sets mission keys that it may set."""
        detector = self.make()
        assert require_detector(detector) is detector
        assert all(isinstance(key, str) for key in mission_keys(detector))

    def test_a_check_changes_nothing(self) -> None:
        """Memory is what it was accepted to be; a published value belongs to its readers."""
        detector = self.make()
        for state, now in self.publications()[:2000]:
            memory = detector.memory()
            content = (state.header.tobytes(), state.elements.tobytes())
            detector.check(state, now)
            assert detector.memory() == memory, f"check of {state.spec.name} at {now} us"
            assert (state.header.tobytes(), state.elements.tobytes()) == content
            detector.accept(state, now)

    def test_its_alarms_can_be_answered(self) -> None:
        """An alarm names a stage that can be recomputed, and agrees with the score; golden flights have few."""
        detector = self.make()
        alarms = 0
        for state, now in self.publications():
            score = detector.score(state, now)
            alarm = detector.check(state, now)
            if alarm is not None:
                alarms += 1
                assert json.dumps(checked_alarm(detector, alarm).to_json())
            assert score is None or (score > 1.0) == (alarm is not None)
            detector.accept(state, now)
        assert alarms <= self.most_alarms

    def test_a_flight_can_be_repeated(self) -> None:
        """`start` forgets the flight before."""
        detector = self.make()
        results = []
        for _ in range(2):
            detector.start()
            results.append(self._results(detector, self.publications()))
        assert results[0] == results[1]

    def test_a_flight_can_be_continued_from_a_checkpoint(self) -> None:
        """Another detector with the restored memory judges as this one."""
        detector = self.make()
        other = self.make()
        publications = self.publications()
        half = len(publications) // 2
        self._results(detector, publications[:half])
        other.restore(detector.memory())
        assert other.memory() == detector.memory()
        assert self._results(detector, publications[half:]) == self._results(other, publications[half:])

    def test_its_memory_can_be_struck(self) -> None:
        """Faults flip bits of the arrays themselves."""
        detector = self.make()
        for state, now in self.publications()[:200]:
            detector.accept(state, now)
        memory = detector.memory()
        for name, array in detector.arrays().items():
            if array.size:
                bits = array.reshape(-1)[:1].view(np.uint8)
                bits ^= 1
                assert detector.memory() != memory, name
                bits ^= 1
                assert detector.memory() == memory, name
        detector.instrument({})

    def _results(self, detector: Detector, publications: list[tuple[State, int]]) -> list[Any]:
        results = []
        for state, now in publications:
            alarm = detector.check(state, now)
            results.append(None if alarm is None else alarm.to_json())
            detector.accept(state, now)
        return results


class PlannerContract:
    """What the planning kernel expects of a path search.

    Attributes:
        planner: Its configuration; `name` is that of an entry point, or "package:Class".
    """

    planner: ClassVar[PlannerConfig]

    def make(self) -> PathSearch:
        """The search, as it starts a flight."""
        allow_typed([self.planner.name])
        return make_search(self.planner, seed=3)

    def search(self, search: PathSearch, *, blocked: bool = False) -> np.ndarray:
        """A path around a wall with a gap, or one without (`blocked`), across a map of 20 m x 10 m x 5 m."""
        grid = Grid(0.0, 0.0, 0.0, 2.0, 40, 20, 10)
        counter = np.zeros((grid.nx, grid.ny, grid.nz), np.int16)
        counter[18:22, :, :] = 1
        if not blocked:
            counter[18:22, 12:16, :] = 0
        corners = np.array([1.0, 1.0, 1.0]), np.array([19.0, 9.0, 4.0])
        start = np.array([2.0, 5.0, 2.0])
        goal = np.array([18.0, 5.0, 2.0])
        return search.search(counter.ravel(), grid, start, goal, *corners)

    def test_a_path_leads_from_start_to_goal(self) -> None:
        """Vertices are finite, in the box, and not too many."""
        path = self.search(self.make())
        assert path.dtype == np.float64 and path.shape[1] == 3 and 2 <= len(path) <= MOST_VERTICES
        assert np.isfinite(path).all()
        assert (path >= 1.0).all() and (path <= [19.0, 9.0, 4.0]).all()
        assert path[0].tolist() == [2.0, 5.0, 2.0] and path[-1].tolist() == [18.0, 5.0, 2.0]

    def test_where_there_is_no_path_none_is_found(self) -> None:
        """An empty path, in a bounded time."""
        assert self.search(self.make(), blocked=True).shape == (0, 3)

    def test_equal_seeds_give_equal_paths(self) -> None:
        """A flight is a function of its seed."""
        assert self.search(self.make()).tobytes() == self.search(self.make()).tobytes()

    def test_its_generator_is_all_that_it_remembers(self) -> None:
        """A restarted or restored search continues as it did."""
        search = self.make()
        self.search(search)
        saved = search.random.copy()
        path = self.search(search)
        search.random[:] = saved
        assert self.search(search).tobytes() == path.tobytes()
