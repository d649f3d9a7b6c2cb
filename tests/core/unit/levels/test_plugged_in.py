"""A level of another package: everything works through its entry point, no file of mavfi names it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from typing import ClassVar, Literal

import pytest

from mavfi import plugins
from mavfi.analysis.runs import Runs, drawn
from mavfi.api import fly
from mavfi.campaign.shrink import shrink
from mavfi.cli import run
from mavfi.config import parse as parse_config
from mavfi.errors import BadInputError
from mavfi.faults import fault as faults
from mavfi.faults.fault import Fault, fault_from_json
from mavfi.faults.injector import Injector
from mavfi.levels.level import Level, Sampler, Sampling, parse, text_of
from mavfi.mission import MissionStatus
from mavfi.record import Injection
from mavfi.testing import LevelContract
from tests.campaigns import run_campaign
from tests.core.unit.campaign import fakes


@dataclass(frozen=True, slots=True)
class OffsetFault(Fault):
    """The way-point is elsewhere, once."""

    level: ClassVar[str] = "offset"
    metres: float
    time_us: int = 0
    bit: int | None = None
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0

    @property
    def site(self) -> str:
        return "way-point"


@dataclass(frozen=True)
class OffsetRequest:
    metres: float
    time_us: int

    def draw(self, setup, seed):
        return OffsetFault(self.metres, self.time_us, seed=seed), None


class OffsetSampling(Sampling):
    level: Literal["offset"]
    metres: float = 8.0


class OffsetSampler(Sampler):
    def __init__(self, campaign):
        super().__init__(campaign)
        self.targets = {"way-point": {"": 1.0}}

    def draw(self, draws, environment, golden):
        return [OffsetFault(self.sampling.metres, 1_000_000 * planned.index, seed=planned.seed) for planned in draws]

    def null(self, index, seed, environment, golden):
        return OffsetFault(0.0, seed=seed)


class OffsetInjector(Injector):
    spent = False

    def __init__(self, fault):
        self.fault, self.injections = fault, []

    def __call__(self, state, time_us):
        if self.injections or state.spec.name != "planning.waypoint" or time_us < self.fault.time_us:
            return state
        changed = state.copy()
        changed.header["x"] += self.fault.metres
        before, after = float(state.header["x"][0]), float(changed.header["x"][0])
        self.injections.append(Injection("offset", "way-point", time_us / 1e6, None, before, after, True))
        return changed

    def finish(self):
        return self.injections


def nearer(fault: OffsetFault, _: Injection | None) -> Iterator[Fault]:
    yield from (replace(fault, metres=metres) for metres in (1.0, 2.0, 4.0) if metres < fault.metres)


class OffsetLevel(Level):
    fault = OffsetFault
    sampling = OffsetSampling
    sampler = OffsetSampler
    local = True
    form = "offset:METRES[@SECONDS]"
    reductions = {"distance": nearer}
    absent = ("published", "there was no way-point")

    def parse(self, text, localization):
        text_parts = self.parts_of(text)
        return OffsetRequest(float(text_parts.site), text_parts.time_us or 0)

    def text_of(self, fault):
        return f"offset:{fault.metres}@{fault.time_us / 1e6}"

    def inject(self, loop, fault, detector):
        injector = loop.taps.injector = OffsetInjector(fault)
        return injector

    def columns(self, fault):
        return {"state": "planning.waypoint", "field": "x"}

    def about(self, campaign):
        return {"each": "way-point", "how": f"{campaign.sampling.metres:g} m"}


class OffsetFlights(fakes.FakeFlights):
    """From 3 m on, the vehicle hits something."""

    def injected(self, runs):
        for index, (arm, fault) in enumerate(runs):
            flight = fakes.fly(self.arms[arm], None, None)
            status = MissionStatus.COLLISION if fault.metres >= 3.0 else MissionStatus.SUCCESS
            injection = Injection("offset", fault.site, 1.0, None, 0.0, fault.metres, True)
            flight.log = replace(flight.log, status=status, injections=[injection])
            yield index, flight


class OffsetHost(fakes.FakeHost):
    levels = frozenset({"offset"})

    def mission(self, arms, *, fast_forward=True):
        return OffsetFlights(arms, fast_forward)


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """The level as an entry point of this module."""
    point = EntryPoint("offset", f"{__name__}:OffsetLevel", "mavfi.levels")
    real = plugins.entry_points
    monkeypatch.setattr(plugins, "entry_points", lambda group: [*real(group=group), *[point] * (group == point.group)])
    caches = faults.find_level, faults.level_names
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()


class TestContract(LevelContract):
    level = OffsetLevel
    faults = [OffsetFault(8.0, 5_000_000), OffsetFault(0.5, seed=3)]


def test_it_is_parsed_and_named_among_what_is_allowed():
    assert parse("offset:2.5@3") == OffsetRequest(2.5, 3_000_000)
    with pytest.raises(BadInputError, match=r"allowed: null, state:.*, offset:\.\.\."):
        parse("offse")
    with pytest.raises(BadInputError, match="level 'offse': not known .did you mean 'offset'"):
        parse("offse:2.5")
    with pytest.raises(BadInputError, match="fault 'offset:2@x': instant 'x': allowed"):
        parse("offset:2@x")
    with pytest.raises(ValueError, match="'sampling.level': 'offse': not known .did you mean 'offset'"):
        fakes.small(sampling={"level": "offse"})


def test_a_mission_is_flown_with_it():
    result = fly(environment="sparse", seed=10_000, fault="offset:1@2")
    (injection,) = result.log.injections
    assert injection.after - injection.before == 1.0 and injection.time_s >= 2.0
    assert fault_from_json(result.fault.to_json()) == result.fault
    assert not result.golden.log.injections


def test_a_campaign_draws_it_and_its_runs_are_told_and_made_smaller(tmp_path, capsys):
    host = f"{__name__}:OffsetHost"
    plugins.allow_names([host])
    campaign = fakes.small(
        host=host, environments=["sparse"], arms={}, null_runs=1, sampling={"level": "offset", "metres": 8.0}
    )
    assert drawn(campaign)["lines"][0].endswith("6 faults per way-point, 8 m")
    run_campaign(campaign, tmp_path)
    runs = Runs.read(tmp_path)
    faulty = runs.where(setting="fi")
    assert set(faulty["target"]) == {"way-point"} and set(faulty["field"]) == {"x"} and len(faulty["run_id"]) == 6
    smallest = shrink(tmp_path, faulty.first("run_id"))
    assert [(step.what, step.tried) for step in smallest.steps] == [("distance", 3)]
    assert text_of(smallest.smallest.fault) == "offset:4.0@0.0"
    assert run(["shrink", str(tmp_path), faulty.first("run_id")]) == 0
    assert "--fault offset:4.0@0.0" in capsys.readouterr().out


def test_its_sampling_is_validated_by_its_own_model():
    content = {"name": "c", "environments": ["sparse"], "sampling": {"level": "offset", "metre": 3}}
    with pytest.raises(BadInputError, match="unknown key 'sampling.metre' .did you mean 'metres'.*allowed: level, met"):
        parse_config(type(fakes.small()), content, "c.yaml")
