"""Contract suites for plug-ins: pytest classes that the author of one subclasses, and that mavfi's own ones pass.

class TestMyLevel(LevelContract):
    level = MyLevel
    faults = [MyFault(...), ...]
"""

import json
import pickle
from collections.abc import Sequence
from dataclasses import FrozenInstanceError, replace
from typing import Any, ClassVar

from mavfi.faults.fault import Fault, fault_from_json, find_level
from mavfi.flight.host import ArmSetup, Host, host_class
from mavfi.levels.level import Level, parse, sampler_for, text_of
from mavfi.mission import MissionSpec


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
        assert type(find_level(self.level.fault.level)) is self.level

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
                found = list(candidates(fault, None))
                assert fault not in found and {type(one) for one in found} <= {self.level.fault}

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
            about = self.level().about(self._campaign())
            assert about["each"] and ("how" in about or "lines" in about)

    def _campaign(self) -> Any:
        from mavfi.campaign.config import Campaign

        sampling = {"level": self.level.fault.level, **self.campaign.get("sampling", {})}
        content = {"name": "contract", "environments": self.environments, "missions": 2, "faults": 4, **self.campaign}
        campaign = Campaign.model_validate({**content, "sampling": sampling})
        assert Campaign.model_validate(campaign.to_json()) == campaign, "a ledger stores the campaign"
        return campaign

    def _drawn(self) -> list[Fault | None]:
        sampler, environment = sampler_for(self._campaign()), self.environments[0]
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
        found = host_class(self.host)
        make: Any = found
        assert (found.config is None) == (self.under_test is None) == (not found.config_key)
        return make() if found.config is None else make(found.config.model_validate(self.under_test))

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
        keys: dict[str, Any] = {} if self.under_test is None else {host.config_key: self.under_test}
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
    return {"level": level, **({"kernels": ["pid"]} if level == "instruction" else {})}
