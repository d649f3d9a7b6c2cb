"""Arms that differ in the copies of their detector alone: their golden runs are identical, so they share its faults."""

from collections.abc import Mapping

from mavfi.campaign.config import ArmConfig, Campaign
from mavfi.detectors.registry import contains
from mavfi.errors import BadInputError
from mavfi.states import RECOVERY


def lead_of(arms: Mapping[str, ArmConfig], name: str) -> str:
    """The first arm that differs from an arm with a detector at most in its copies; any other name is its own lead."""
    own = arms.get(name)
    if own is None or not own.detector:
        return name
    return next(other for other, arm in arms.items() if _but_copies(arm) == _but_copies(own))


def watched_in(campaign: Campaign, target: str) -> str:
    """The arm in which a detector, also as a named configuration (`recommended`), or recovery is injected.

    Raises:
        BadInputError: There is no such arm, or several differ in more than copies.
    """
    leads = _leads(campaign, target)
    if len(leads) != 1:
        raise BadInputError(
            f"sampling.kernels: {target!r}: is in {len(leads)} arms; allowed: what is in one arm, or in arms that "
            "differ in copies alone"
        )
    return leads[0]


def injected_in(campaign: Campaign, target: str) -> tuple[str, ...]:
    """The arms in which a detector or recovery is injected, each with faults of its own: recovery is in several.

    Of arms that differ in copies alone, which share the faults, the first.

    Raises:
        BadInputError: There is no such arm, or a detector is in several that differ in more than copies.
    """
    leads = _leads(campaign, target) if target == RECOVERY else ()
    return leads or (watched_in(campaign, target),)


def _leads(campaign: Campaign, target: str) -> tuple[str, ...]:
    """The arms with a detector or recovery; of those that differ in copies alone, the first."""
    found = [
        name
        for name, arm in campaign.arms.items()
        if arm.detector and (target == RECOVERY or contains(arm.detector, arm.profile, target, arm.options))
    ]
    return tuple(dict.fromkeys(lead_of(campaign.arms, name) for name in found))


def _but_copies(arm: ArmConfig) -> ArmConfig:
    return arm.model_copy(update={"mission": {key: value for key, value in arm.mission.items() if key != "copies"}})
