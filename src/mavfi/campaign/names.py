"""Names in a campaign (of hosts, environments, detectors, options of missions), checked where its file is known."""

from mavfi.campaign.config import Campaign
from mavfi.campaign.mission import host_of
from mavfi.campaign.plan import Arm, arms_of
from mavfi.detectors.registry import check_detector
from mavfi.errors import BadInputError
from mavfi.flight.compose import with_keys_of
from mavfi.flight.host import Host
from mavfi.mission import MissionSpec


def check_names(campaign: Campaign, source: str) -> None:
    """Check that everything a campaign names exists, before its first flight.

    Args:
        campaign: The campaign.
        source: Its file, for messages.

    Raises:
        BadInputError: Something does not exist, or cannot be combined; the message names the source, and the key.
    """
    try:
        host = host_of(campaign)
    except BadInputError as error:
        raise _at(error, source, "host", "host") from None
    for arm in arms_of(campaign):
        _check_detector(arm, source)
        for environment in campaign.environments:
            _check_mission(campaign, host, environment, arm, source)


def _check_detector(arm: Arm, source: str) -> None:
    if not arm.detector:
        return
    with_keys_of(MissionSpec(), arm.detector)
    try:
        check_detector(arm.detector, arm.profile)
    except BadInputError as error:
        is_profile = str(error).startswith("detector profile")
        key, word = ("profile", "detector profile") if is_profile else ("detector", "detector")
        raise _at(error, source, f"arms.{arm.name}.{key}", word) from None


def _check_mission(campaign: Campaign, host: Host, environment: str, arm: Arm, source: str) -> None:
    spec = campaign.spec(environment, campaign.first_seed, arm.overrides)
    try:
        host.resolve(spec)
    except BadInputError as error:
        for name, value in spec:
            word = name.replace("_", " ")
            if str(error).startswith(f"{word} {value!r}: "):
                raise _at(error, source, _key(campaign, environment, arm, name), word) from None
        raise _at(error, source) from None


def _key(campaign: Campaign, environment: str, arm: Arm, name: str) -> str:
    """The key of a campaign from which a mission has its value."""
    part = campaign.parts.get(environment)
    if part is not None and getattr(part, name, None) is not None:
        return f"parts.{environment}.{name}"
    if name == "environment":
        return "environments"
    return f"arms.{arm.name}.{name}" if arm.name and name in arm.overrides else f"mission.{name}"


def _at(error: BadInputError, source: str, key: str = "", word: str = "") -> BadInputError:
    """The same error with its source and key, in place of the word for what is named."""
    text = str(error).removeprefix(f"{word} ")
    return type(error)(f"{source}: key {key!r}: {text}" if key else f"{source}: {text}")
