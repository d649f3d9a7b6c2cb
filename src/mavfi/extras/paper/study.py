"""Model of a study (YAML files in configs/studies): campaigns, their sizes, and the sections of the report."""

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from mavfi.campaign.config import Campaign, Scale, load_campaign
from mavfi.config import Config, Name, shipped
from mavfi.errors import BadInputError
from mavfi.levels.level import check_distinct, check_known


class StudySection(Config):
    """A section of a study's report: tables and figures of one campaign, or claims tested on any of them."""

    title: str
    text: str = Field("", description="a paragraph below the title")
    campaign: str = Field("", description="folder of its ledger, a key of campaigns; not needed for claims")
    views: tuple[str, ...] = Field((), description="tables, in this order")
    figures: tuple[str, ...] = Field((), description="in this order")
    claims: tuple[str, ...] = Field((), description="statements of the paper that are tested")
    claims_at: dict[str, tuple[str, ...]] = Field(
        default_factory=dict,
        description="those that only a scale has flights enough to decide, by scale; elsewhere named",
    )
    untested: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="claims that this scale names only, by the scale that tests them; computed"
    )
    headline: bool = Field(False, description="its first table is printed, and leads the page; all, if none is marked")

    @model_validator(mode="after")
    def _consistent(self) -> "StudySection":
        if (self.views or self.figures) and not self.campaign:
            raise ValueError(f"section {self.title!r}: views and figures are of a campaign; needed: key campaign")
        return self

    def at_scale(self, scale: str) -> "StudySection":
        """The section with the claims of a scale; those of other scales are `untested`."""
        others = {name: claims for name, claims in self.claims_at.items() if name != scale}
        claims = (*self.claims, *self.claims_at.get(scale, ()))
        return self.model_copy(update={"claims": claims, "claims_at": {}, "untested": others})


class Study(Config):
    """A set of campaigns, and the tables, figures and tested claims computed from them."""

    name: Name
    title: str = Field("", description="of its report")
    training_flights: int = Field(100, ge=0, description="error-free flights that the detectors are trained on")
    campaigns: dict[Name | Literal["."], str] = Field(
        min_length=1, description="name or path of a campaign, by folder of its ledger"
    )
    scales: dict[str, dict[str, Scale | None]] = Field(
        default_factory=dict,
        description="sizes of campaigns by folder, where they differ from those of the campaign; null = not flown",
    )
    sections: tuple[StudySection, ...] = Field(
        (), description="of its report, in this order; by default the leading table of each campaign"
    )

    @model_validator(mode="after")
    def _consistent(self) -> "Study":
        named = [section.campaign for section in self.sections if section.campaign]
        check_known("sections: campaign", named, self.campaigns)
        for scale, sizes in self.scales.items():
            check_known(f"scales: {scale}", sizes, self.campaigns)
        return self

    def at_scale(self, scale: str) -> "Study":
        """The study with the campaigns and claims of a scale, and with the sections that these fill."""
        sizes = self.scales.get(scale, {})
        campaigns = {folder: name for folder, name in self.campaigns.items() if sizes.get(folder, True) is not None}
        sections = [section.at_scale(scale) for section in self.sections]
        shown = tuple(section for section in sections if not section.campaign or section.campaign in campaigns)
        return self.model_copy(update={"campaigns": campaigns, "sections": shown})

    def campaigns_at(self, scale: str) -> dict[str, Campaign]:
        """Campaigns by ledger folder, at a scale.

        Raises:
            BadInputError: A campaign does not exist, does not define the scale, or is in two folders.
        """
        campaigns = {folder: load_campaign(name) for folder, name in self.campaigns.items()}
        try:  # names of files and steps
            check_distinct(f"study {self.name}: campaigns", [campaign.name for campaign in campaigns.values()])
        except ValueError as error:
            raise BadInputError(str(error)) from None
        sizes = self.scales.get(scale, {})
        resized = {}
        for folder, campaign in campaigns.items():
            size = sizes.get(folder)
            if size is None:
                resized[folder] = campaign.at_scale(scale)
            else:
                resized[folder] = campaign.resized(size)
        return resized


def load_study(name: str | Path) -> Study:
    """Read a study from a path, or a shipped one by name, e.g. "paper".

    Raises:
        BadInputError: The file does not exist or is invalid.
    """
    return shipped("studies", Study, str(name))
