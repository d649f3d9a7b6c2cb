"""Samplers, which draw the faults of a campaign: one per level, with a common protocol."""

from typing import TYPE_CHECKING

from mavfi.campaign.samplers.sampler import Sampler

if TYPE_CHECKING:
    from mavfi.campaign.config import Campaign


def sampler_for(campaign: "Campaign") -> Sampler:
    """The sampler of a campaign.

    Raises:
        BadInputError: The sampling names unknown sites, or conflicts with the rest of the campaign.
    """
    level = campaign.sampling.level  # local imports: each sampler imports the campaign's configuration
    if level == "instruction":
        from mavfi.campaign.samplers.instruction import InstructionSampler

        return InstructionSampler(campaign)
    if level == "memory":
        from mavfi.campaign.samplers.memory import MemorySampler

        return MemorySampler(campaign)
    if level == "register":
        from mavfi.extras.registers.sampler import RegisterSampler

        return RegisterSampler(campaign)
    if level == "message":
        from mavfi.campaign.samplers.message import MessageSampler

        return MessageSampler(campaign)
    if level == "sensor":
        from mavfi.campaign.samplers.sensor import SensorSampler

        return SensorSampler(campaign)
    from mavfi.campaign.samplers.state import StateSampler

    return StateSampler(campaign)
