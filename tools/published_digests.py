"""Digests of the study of the paper, by scale: kept in docs/results/digests.json, shown in docs/results.md.

With them is stored a fingerprint of the campaigns and of the golden flights of the tests.  Tests compare it with the
program: outdated digests fail.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mavfi.campaign.resolve import resolve
from mavfi.campaign.run import identity_of
from mavfi.campaign.store import read_meta
from mavfi.extras.paper.study import load_study
from mavfi.record import canonical
from mavfi.report.text import markdown_grid, short
from tools.markers import DOCS, ROOT

FILE = "results/digests.json"
"""In the folder of the documentation."""
COMMANDS = {"quick": "make reproduce", "paper": "make reproduce SCALE=paper"}
"""By scale, in the order of their columns."""


def stored_digests(docs: Path = DOCS) -> dict[str, Any]:
    """By scale: program, fingerprint, ledgers with name, what they need, and digest."""
    path = docs / FILE
    digests: dict[str, Any] = {}
    if path.is_file():
        digests = json.loads(path.read_text(encoding="utf-8"))
    return digests


def identities(scale: str) -> dict[str, str]:
    """What the program flies at a scale, by folder of the ledger, as canonical text; models are not in it."""
    campaigns = load_study("paper").at_scale(scale).campaigns_at(scale)
    return {
        folder: canonical(identity_of(resolve(campaign).with_scenarios())) for folder, campaign in campaigns.items()
    }


def fingerprint(scale: str) -> str:
    """Hash of campaigns and golden flights."""
    golden = (ROOT / "tests" / "core" / "golden" / "digests.json").read_text(encoding="utf-8")
    return hashlib.sha256(canonical([identities(scale), golden]).encode()).hexdigest()[:16]


def of_study(out: Path, study: Mapping[str, Any]) -> dict[str, Any]:
    """Entry of a study in a folder, from its study.json.

    Raises:
        ValueError: It is not the study of the paper at one of the scales, or its flights are not complete.
    """
    scale = study["scale"]
    if study["study"] != "paper" or scale not in COMMANDS:
        raise ValueError(f"holds study {study['study']} at scale {scale}; allowed: paper at {', '.join(COMMANDS)}")
    for folder, identity in identities(scale).items():
        campaign = study["campaigns"][folder]
        stored_identity = read_meta(out / folder, "identity")
        if stored_identity is None or canonical({**stored_identity, "models": {}}) != identity:
            raise ValueError(f"campaign {campaign['name']} is not that of scale {scale} here")
        if campaign["done"] < campaign["total"]:
            raise ValueError(f"campaign {campaign['name']}: {campaign['done']} of {campaign['total']} runs are flown")
    if not study.get("programs"):
        raise ValueError("does not say which program flew it; needed: a study of `mavfi reproduce`")
    ledgers = [
        [campaign["name"], needs(campaign), short(campaign["digest"])] for campaign in study["campaigns"].values()
    ]
    return {"program": "; then ".join(study["programs"]), "fingerprint": fingerprint(scale), "ledgers": ledgers}


def needs(campaign: Mapping[str, Any]) -> str:
    """What must be the same, besides the packages, for a ledger with the same digest."""
    python = campaign["versions"].get("python")  # of faults in instructions alone
    if python:
        return f"Python {python}"
    return ""


ABOUT = """\
`make reproduce` ends with a digest of each ledger (`mavfi campaign digest DIR` prints one in full). They are \
the same on all x86-64 machines with the packages of `requirements.lock`; those of faults in instructions also depend \
on the version of Python."""


def block(digests: Mapping[str, Any]) -> str:
    """Digests as a Markdown table with a column for each scale, and what they are good for."""
    scales = [scale for scale in COMMANDS if scale in digests]
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for scale in scales:
        for name, requirement, digest in digests[scale]["ledgers"]:
            rows.setdefault((name, requirement), {})[scale] = f"`{digest}`"
    grid = markdown_grid(
        ["ledger", "depends on", *(f"`{COMMANDS[scale]}`" for scale in scales)],
        [[*key, *(row.get(scale, "") for scale in scales)] for key, row in rows.items()],
    )
    programs = "; ".join(f"scale {scale} by {digests[scale]['program']}" for scale in scales)
    return f"{ABOUT}\n\n{grid}\n\nFlown at {programs}."


def write(digests: Mapping[str, Any], docs: Path = DOCS) -> None:
    """Keep the digests."""
    (docs / FILE).parent.mkdir(exist_ok=True)
    (docs / FILE).write_text(json.dumps(digests, indent=1) + "\n", encoding="utf-8")
