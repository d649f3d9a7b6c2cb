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
    headline: bool = Field(False, description="its first table is printed, and leads the page; all, if none is marked")

    @model_validator(mode="after")
    def _consistent(self) -> "StudySection":
        if (self.views or self.figures) and not self.campaign:
            raise ValueError(f"section {self.title!r}: views and figures are of a campaign; needed: key campaign")
        return self


class Study(Config):
    """A set of campaigns, and the tables, figures and tested claims computed from them."""

    name: Name
    training_flights: int = Field(100, ge=0, description="error-free flights that the detectors are trained on")
    campaigns: dict[Name | Literal["."], str] = Field(
        min_length=1, description="name or path of a campaign, by folder of its ledger"
    )
    scales: dict[str, dict[str, Scale]] = Field(
        default_factory=dict, description="sizes of campaigns by folder, where they differ from those of the campaign"
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
        return {
            folder: campaign.resized(sizes[folder]) if folder in sizes else campaign.at_scale(scale)
            for folder, campaign in campaigns.items()
        }


def load_study(name: str | Path) -> Study:
    """Read a study from a path, or a shipped one by name, e.g. "paper".

    Raises:
        BadInputError: The file does not exist or is invalid.
    """
    return shipped("studies", Study, str(name))
