"""Write the JSON schemas by which editors check and complete campaigns and studies, from the models of these files."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from mavfi.campaign.config import ArmConfig, Campaign
from mavfi.cli.init import SCHEMAS
from mavfi.extras.paper.study import Study
from mavfi.faults.fault import find_level, level_names
from mavfi.flight.host import GROUP
from mavfi.mission import MissionSpec
from mavfi.plugins import extensions

_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_DEFINITIONS = "#/$defs/"


def _samplings() -> Iterator[type[BaseModel]]:
    """Models of the key `sampling`: of each level, and of hosts that draw its faults otherwise."""
    for name in level_names():
        model = find_level(name).sampling
        if model is not None:
            yield model
    for host in extensions(GROUP).values():
        for level in host.samplings.values():
            yield level.sampling


def campaign_schema() -> dict[str, Any]:
    """The schema of a campaign: its model, and what its validators put in the place of open keys."""
    samplings = list(dict.fromkeys(_samplings()))
    hosts = [host for host in extensions(GROUP).values() if host.config is not None]
    models = [Campaign, ArmConfig, MissionSpec, *samplings, *(host.config for host in hosts)]
    names, whole = models_json_schema([(model, "validation") for model in models])
    definitions = whole["$defs"]
    references = {model: reference for (model, _), reference in names.items()}

    # a mission in a campaign: the campaign itself names environments and seeds
    mission = _definition(definitions, references[MissionSpec])
    for key in ("environment", "seed"):
        del mission["properties"][key]
    mission.pop("required", None)

    # an arm has the keys of a mission, too
    arm = _definition(definitions, references[ArmConfig])
    arm["properties"]["mission"] = references[MissionSpec]
    arm["properties"] |= {key: value for key, value in mission["properties"].items() if key not in arm["properties"]}

    # the campaign: sampling by level, and what is under test under the key of its host
    campaign = _definition(definitions, references[Campaign])
    campaign["properties"]["mission"] = references[MissionSpec]
    campaign["properties"]["sampling"] = {"anyOf": [references[model] for model in samplings]}
    del campaign["properties"]["under_test"]
    for host in hosts:
        campaign["properties"][host.config_key] = references[host.config]
    campaign["required"] = ["name"]  # hosts may bring the environments
    return {"$schema": _DRAFT, **references[Campaign], "$defs": definitions}


def study_schema() -> dict[str, Any]:
    """The schema of a study."""
    return {"$schema": _DRAFT, **Study.model_json_schema(mode="validation")}


def _definition(definitions: Mapping[str, Any], reference: Mapping[str, str]) -> dict[str, Any]:
    """What a reference refers to."""
    definition: dict[str, Any] = definitions[reference["$ref"].removeprefix(_DEFINITIONS)]
    return definition


def schemas() -> dict[Path, str]:
    """Content of each file."""
    built = {"campaign": campaign_schema(), "study": study_schema()}
    return {SCHEMAS / f"{name}.json": json.dumps(schema, indent=1) + "\n" for name, schema in built.items()}
