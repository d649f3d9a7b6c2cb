"""Shipped kernels and detectors own their memory: no address of the process enters the record of a fault in them."""

import pytest

from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.mission import MissionPlan
from mavfi.campaign.resolve import resolve
from mavfi.campaign.warm_up import warm_up
from mavfi.ir.injection import variant
from mavfi.ir.injection.build import Built, cached_build
from mavfi.levels.instruction.sampling import InstructionSampling


def only(detector: str, kernel: str) -> Campaign:
    """Few faults in the functions of one detector."""
    return Campaign(
        name=detector,
        environments=("dense",),
        missions=2,
        faults=2,
        sampling={"level": "instruction", "kernels": [kernel]},
        arms={detector: {"detector": detector}},
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "campaign",
    [
        only("recommended", "acceptance"),
        only("limits", "limits"),
        *(load_campaign(name) for name in ("kernels", "detector_instructions")),
    ],
    ids=lambda campaign: campaign.name,
)
def test_every_function_into_which_a_campaign_injects_has_planned_memory(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Built] = []

    def noted(*arguments: object) -> Built:
        seen.append(cached_build(*arguments))  # type: ignore[arg-type]
        return seen[-1]

    monkeypatch.setattr(variant, "cached_build", noted)
    monkeypatch.setattr(variant, "_variants", {})
    monkeypatch.setattr(variant, "_variants_by_key", {})
    warm_up(MissionPlan(resolve(campaign).with_models(), campaign.environments[0], campaign.first_seed))
    assert isinstance(campaign.sampling, InstructionSampling)
    assert len(seen) >= len(campaign.sampling.kernels)
    assert [built.wrapper for built in seen if not built.owned] == []
