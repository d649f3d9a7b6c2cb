"""Arms that differ in the copies of their detector alone: their golden runs are identical, so they share its faults."""

from collections.abc import Mapping

from mavfi.campaign.config import ArmConfig


def lead_of(arms: Mapping[str, ArmConfig], name: str) -> str:
    """The first arm that differs from an arm with a detector at most in its copies; any other name is its own lead."""
    own = arms.get(name)
    if own is None or not own.detector:
        return name
    return next(other for other, arm in arms.items() if _but_copies(arm) == _but_copies(own))


def _but_copies(arm: ArmConfig) -> ArmConfig:
    return arm.model_copy(update={"mission": {key: value for key, value in arm.mission.items() if key != "copies"}})
