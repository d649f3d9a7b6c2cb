"""A campaign before its first flight: its names are checked, and it is resolved as its ledger has begun it."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mavfi.campaign.config import ArmConfig, Campaign
from mavfi.campaign.extension import as_grown
from mavfi.campaign.ledger import ORDERED
from mavfi.campaign.resolve import Arm, ResolvedCampaign, resolve
from mavfi.campaign.store import read_meta
from mavfi.config import STORED
from mavfi.detectors.registry import check_detector
from mavfi.errors import BadInputError
from mavfi.faults.plug_ins import is_custom_detector, plug_ins_of_spec
from mavfi.flight.compose import with_keys_of
from mavfi.flight.host import require_level
from mavfi.mission import MissionSpec


def begin(
    campaign: Campaign, directory: Path, *, models_dir: Path | None = None, extend: bool = False
) -> ResolvedCampaign:
    """Resolve a campaign that is flown into a ledger, new or begun.

    Args:
        campaign: The campaign.
        directory: Folder of the ledger.
        models_dir: Folder of trained models; None = that of the ledger, or the shipped ones.
        extend: Whether the ledger may be that of a smaller campaign, whose runs are kept; see `campaign.extension`.

    Raises:
        BadInputError: A name is unknown, options are incompatible, or a model is absent or does not match.
    """
    begun = _as_begun(campaign.without_requirements(), directory, extend=extend)
    held_models = read_meta(directory, "models_dir")
    if models_dir is None and held_models is not None:  # the models with which the ledger was begun
        models_dir = directory / held_models
    resolved = resolve(begun, models_dir)
    require_level(resolved.host, begun.sampling.level)
    return resolved.with_models()


def _as_begun(campaign: Campaign, directory: Path, *, extend: bool) -> Campaign:
    """The campaign with sizes that its ledger has had, and its keys in the order of it.

    Both determine draws and positions of runs.
    """
    with suppress(ValueError):  # no ledger, or damage, which is reported when the ledger is opened
        begun = Campaign.model_validate_json(read_meta(directory, ORDERED) or "", context=STORED)
        campaign = as_grown(begun, campaign, extend=extend)
        if begun == campaign:
            return begun
    return campaign


def check_null_runs(campaign: Campaign, directory: Path) -> None:
    """Refuse a new campaign with custom parts and without null runs, at a level that has them.

    A ledger that was begun without them is completed as it is.

    Raises:
        BadInputError: It has none.
    """
    if campaign.nulls or not campaign.sampling.null_runs or read_meta(directory, ORDERED) is not None:
        return
    for arm in (ArmConfig(), *campaign.arms.values()):
        detector = ""
        if is_custom_detector(arm.detector):
            detector = arm.detector
        spec = campaign.spec(campaign.environments[0], campaign.first_seed, arm.mission)
        for plug_in in plug_ins_of_spec(spec, detector):
            raise BadInputError(
                f"campaign {campaign.name}: null_runs: 0: {plug_in.address} is custom, and null runs show whether it "
                "flies the same each time; allowed: 1 or more, or without the key"
            )


def check_names(campaign: Campaign, source: str) -> None:
    """Check that everything a campaign names exists, before its first flight.

    Args:
        campaign: The campaign.
        source: Its file, for messages.

    Raises:
        BadInputError: Something does not exist, or cannot be combined; the message names the source, and the key.
    """
    resolved = resolve(campaign)
    with _named(source, [("host", campaign.host, "host")]):
        host = resolved.host
    for arm in resolved.arms:
        if arm.detector:
            with_keys_of(MissionSpec(), arm.detector)
            keys = f"arms.{arm.name}"
            named = [
                ("detector", arm.detector, f"{keys}.detector"),
                ("detector profile", arm.profile, f"{keys}.profile"),
            ]
            with _named(source, named):
                check_detector(arm.detector, arm.profile)
        for environment in campaign.environments:
            spec = resolved.spec(environment, arm)
            options = [(name.replace("_", " "), value, _key(campaign, environment, arm, name)) for name, value in spec]
            with _named(source, options):
                host.resolve(spec)


@contextmanager
def _named(source: str, values: Iterable[tuple[str, object, str]]) -> Iterator[None]:
    """Errors name the source, and of a value, given with the word for it, the key that has it."""
    try:
        yield
    except BadInputError as error:
        text = str(error)
        for word, value, key in values:
            if text.startswith(f"{word} {value!r}: "):
                text = f"key {key!r}: {text.removeprefix(word).lstrip()}"
                break
        raise type(error)(f"{source}: {text}") from None


def _key(campaign: Campaign, environment: str, arm: Arm, name: str) -> str:
    """The key of a campaign from which a mission has its value."""
    part = campaign.parts.get(environment)
    if part is not None and getattr(part, name, None) is not None:
        return f"parts.{environment}.{name}"
    if name == "environment":
        return "environments"
    if arm.name and name in arm.overrides:
        return f"arms.{arm.name}.{name}"
    return f"mission.{name}"
