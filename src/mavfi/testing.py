"""Contract suites for plug-ins: pytest classes that the author of one subclasses, and that mavfi's own ones pass.

class TestMyDetector(DetectorContract):
    detector = "my_package:MyDetector"
"""

import json
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mavfi.config import PlannerConfig
from mavfi.detectors.detector import Detector, checked_alarm, require_detector
from mavfi.detectors.registry import mission_keys
from mavfi.flight.compose import detector_for, resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.planners import MOST_VERTICES, PathSearch, make_search
from mavfi.plugins import allow_typed
from mavfi.states import State


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
            memory, content = detector.memory(), (state.header.tobytes(), state.elements.tobytes())
            detector.check(state, now)
            assert detector.memory() == memory, f"check of {state.spec.name} at {now} us"
            assert (state.header.tobytes(), state.elements.tobytes()) == content
            detector.accept(state, now)

    def test_its_alarms_can_be_answered(self) -> None:
        """An alarm names a stage that can be recomputed, and agrees with the score; golden flights have few."""
        detector, alarms = self.make(), 0
        for state, now in self.publications():
            score, alarm = detector.score(state, now), detector.check(state, now)
            if alarm is not None:
                alarms += 1
                assert json.dumps(checked_alarm(detector, alarm).to_json())
            assert score is None or (score > 1.0) == (alarm is not None)
            detector.accept(state, now)
        assert alarms <= self.most_alarms

    def test_a_flight_can_be_repeated(self) -> None:
        """`start` forgets the flight before."""
        detector, results = self.make(), []
        for _ in range(2):
            detector.start()
            results.append(self._results(detector, self.publications()))
        assert results[0] == results[1]

    def test_a_flight_can_be_continued_from_a_checkpoint(self) -> None:
        """Another detector with the restored memory judges as this one."""
        detector, other, publications = self.make(), self.make(), self.publications()
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
            results.append(alarm if alarm is None else alarm.to_json())
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
        start, goal = np.array([2.0, 5.0, 2.0]), np.array([18.0, 5.0, 2.0])
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
