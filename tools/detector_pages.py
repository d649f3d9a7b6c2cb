"""Write docs/generated/detectors.md: for each shipped detector what it is, its results by part, and its cost.

Everything is stated elsewhere: descriptions in docs/detectors.md, training in the shipped models, results in the
published rows of the bench, cost in docs/models.md.
"""

import json
import re
from collections.abc import Iterator, Mapping

from mavfi.campaign.analysis.flight_views import TOTAL
from mavfi.campaign.bench import Bench, published_rows
from mavfi.campaign.config import ArmConfig
from mavfi.detectors.registry import ONLY_PROFILE, SHIPPED_MODELS, mission_keys, of_all_fields, trainable
from mavfi.reports.text import ABSENT
from tools.markers import DOCS, GENERATED, anchors, banner, contents

PAGE = GENERATED / "detectors.md"
SCALE = "paper"
COLUMNS = {
    "lost": ("lost",),
    "brought back": ("brought back",),
    "late, in time": ("late, in time",),
    "only it lost": ("only it lost", "of these, only it lost"),
    "p": ("p",),
}
"""Headings of a section's table, and those of published rows, of which the first that a part has counts."""
_HEAD = """# Detectors one by one

The rows of each detector in all parts of the [leaderboard](leaderboard-paper.md), where columns are explained, with its
training and its cost; the five rules alone have a bench of their own. All detectors in one table:
[detectors](../detectors.md)."""
_COST = re.compile(r"^\*\*(.+)\*\*$|^\| (`[^|]+`) \| (`[^|]+`) \| ([^|]+) \| ([^|]+) \|", re.MULTILINE)


def page(bench: Bench) -> str:
    """The page with its present content."""
    watching = {name: arm for name, arm in bench.arms.items() if arm.detector}
    flown = {arm.detector for arm in watching.values()}
    others = {name.replace("_", " "): name for name in descriptions() if name not in {*flown, "none"}}
    sections = [f"## {name}\n\n{_section(bench, name, arm)}" for name, arm in watching.items()]
    sections += [f"## {title}\n\n{_not_in_the_bench(name)}" for title, name in others.items()]
    return banner("make docs") + "\n\n".join([_HEAD, contents("Detectors", [*watching, *others]), *sections]) + "\n"


def _section(bench: Bench, name: str, arm: ArmConfig) -> str:
    return "\n\n".join([
        _what(arm),
        *([_training(arm)] if arm.detector in trainable() else []),
        *_recovery(arm),
        "\n".join(_results(bench, name)),
        "\n\n".join([*_false_alarms(bench, name), *_cost(arm)]),
    ])  # fmt: skip


def _not_in_the_bench(detector: str) -> str:
    arm = ArmConfig(detector=detector)
    return "\n\n".join([_what(arm), *_recovery(arm), "No row in the bench."])


def _what(arm: ArmConfig) -> str:
    checks, provenance, description = descriptions()[arm.detector]
    description = description.replace("](", "](../")  # a link from a folder below
    source = "" if provenance == "–" else f" Source: {provenance}."
    option = f"`{_option(arm)}`. {checks[:1].upper()}{checks[1:]}."
    return f"{option}{source} Description: {description}."


def _option(arm: ArmConfig) -> str:
    return f"--detector {arm.detector}{' --profile tuned' if arm.profile == 'tuned' else ''}"


def descriptions() -> dict[str, tuple[str, str, str]]:
    """What a detector checks, its provenance, and where it is described: cells of docs/detectors.md, by name."""
    found: dict[str, tuple[str, str, str]] = {}
    for line in (DOCS / "detectors.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("| `") and "`--" not in line:
            names, checks, provenance, description = (cell.strip() for cell in line.strip("|").split("|"))
            found |= dict.fromkeys(re.findall(r"`([^`]+)`", names), (checks, provenance, description))
    return found


def _training(arm: ArmConfig) -> str:
    """Flights that the shipped models were fitted to."""
    profile = ONLY_PROFILE if arm.detector in of_all_fields(("bench",)) else arm.profile
    told = []
    for file in sorted(SHIPPED_MODELS.glob(f"*-{arm.detector}-{profile}.json")):
        own = json.loads(file.read_text(encoding="utf-8"))["provenance"]
        told.append(f"`{own['stack']}`, {own['platform']}: {own['flights']} flights in {own['environment']}")
    if not told:
        return "Model: not shipped; `mavfi train --baselines` fits it."
    return f"Models, fitted to error-free flights: {'; '.join(told)}."


def _recovery(arm: ArmConfig) -> list[str]:
    """Mission keys that go with the detector."""
    keys = [f"`{key}: {value}`" for key, value in mission_keys(arm.detector).items()]
    return [f"Recovery that goes with it: {', '.join(keys)}."] if keys else []


def _results(bench: Bench, name: str) -> Iterator[str]:
    yield f"| part | {' | '.join(COLUMNS)} |"
    yield "|---|" + "---:|" * len(COLUMNS)
    links = anchors(part.title for part in bench.parts.values())
    for part, row in _rows(bench, name):
        cells = (next((row[one] for one in names if one in row), ABSENT) for names in COLUMNS.values())
        title = bench.parts[part].title
        link = f"[{title}](leaderboard-{SCALE}.md#{links[title]})"
        yield f"| {link} | {' | '.join(cell or ABSENT for cell in cells)} |"


def _rows(bench: Bench, name: str) -> Iterator[tuple[str, Mapping[str, str]]]:
    for part in bench.parts:
        for row in published_rows(bench, part, SCALE):
            if row.get("scheme") == name:
                yield part, row


def _false_alarms(bench: Bench, name: str) -> Iterator[str]:
    """Rates on golden flights of all environments, by part."""
    told = [
        f"{row['per hour']} in {row['exposure']} ({bench.parts[part].title.removesuffix(': false alarms')})"
        for part in bench.parts
        for row in published_rows(bench, part, SCALE)
        if row.get("setting") == f"golden_{name}" and row[TOTAL[0]] == TOTAL[1]
    ]
    if told:
        yield f"False alarms per flight hour: {'; '.join(told)}."


def _cost(arm: ArmConfig) -> Iterator[str]:
    """Time of a publication and share of the kernels' time by processor, from docs/models.md."""
    block = (DOCS / "models.md").read_text(encoding="utf-8").partition("<!-- detector-cost:begin -->")[2]
    told, processor = [], ""
    for found in _COST.finditer(block.partition("<!-- detector-cost:end -->")[0]):
        processor = found[1] or processor
        if found[2] == f"`{arm.detector}`, `{arm.profile}`":
            told.append(f"{found[4]} µs and {found[5]} % ({processor}, {found[3]})")
    if told:
        yield f"Cost, time of a publication and share of the kernels' time: {'; '.join(told)}."
