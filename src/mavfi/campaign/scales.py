"""Campaigns of several sizes: the one written at the top level of a YAML file, and others by name."""

from collections.abc import Mapping

from mavfi.config import Config, ConfigType
from mavfi.errors import BadInputError


def at_scale(campaign: ConfigType, campaign_name: str, scales: Mapping[str, Config], name: str) -> ConfigType:
    """A campaign at another size; "quick" is the one written at its top level.

    Args:
        campaign: As it is written.
        campaign_name: What it is called.
        scales: What differs, by name of the size.
        name: Which size.

    Raises:
        BadInputError: It has no such size.
    """
    if name == "quick":
        return campaign
    if name not in scales:
        allowed = ", ".join(["quick", *scales])
        raise BadInputError(f"campaign {campaign_name}: scale {name!r}: not known; allowed: {allowed}")
    return campaign.model_copy(update=scales[name].model_dump())
