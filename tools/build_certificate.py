"""Put the certificate of the shipped plan into README.md and docs/generated/hardening.md.

python -m tools.build_certificate

After `mavfi harden LEDGER --plan configs/protections/ten_percent.yaml --certify --faults 1000`, which writes it.
"""

import json
import sys
from typing import Any

from mavfi.campaign.analysis.pairs import Paired
from mavfi.campaign.hardening.certify import REFUTED, Certificate, foreseen, together, verdict_on
from mavfi.errors import BadInputError
from mavfi.hardening.plan import Coverage, Plan, load_plan
from mavfi.reports.hardening.plain import interval, interval_of
from mavfi.reports.text import markdown_grid
from tools.markers import GENERATED, ROOT, fill

PLAN = ROOT / "configs" / "protections" / "ten_percent.yaml"
NAME = "certificate"
HEADINGS = (
    "kernel", "function", "SDC before", "SDC after", "SDCs removed", "predicted", "verdict", "time", "time in the plan"
)  # fmt: skip
Row = dict[str, Any]


def read(plan: Plan, found: Row) -> list[Certificate]:
    """The certificates of a plan's functions.

    Raises:
        BadInputError: They are of another plan.
    """
    if found["plan"] != plan.digest:
        raise BadInputError(f"certificate: of plan {found['plan'][:12]}, this is {plan.digest[:12]}; certify it again")
    return [
        Certificate(
            one["kernel"], one["function"], one["signature"], one["instructions"], one["before"], one["after"],
            one["growth"], None if one["predicted"] is None else Coverage(**one["predicted"]),
            Paired(*(one["paired"][key] for key in ("n", "plain_only", "protected_only", "p"))), one["time"],
            one["planned_time"],
        )
        for one in found["functions"]
    ]  # fmt: skip


def sentence(certificates: list[Certificate], found: Row) -> str:
    """What is certified, beside what was predicted."""
    measured, predicted = together(certificates), foreseen(certificates)
    refuted = sum(one.verdict == REFUTED for one in certificates)
    return (
        f"Certified on {len(found['missions'])} fresh missions with {found['faults']:,} fresh faults per function, in "
        f"plain and in protected code: {interval_of(measured)} of all SDCs are removed (the predictions with the same "
        f"weights: {interval_of(predicted)}, {verdict_on(measured, predicted)}; {refuted} of {len(certificates)} "
        "functions refuted)."
    )


def table(certificates: list[Certificate], found: Row) -> str:
    """The certificate of each function."""
    rows = [
        [
            one.kernel, one.function.rpartition(".")[2], interval(row["sdc_before"]), interval(row["sdc_after"]),
            interval_of(one.coverage), interval_of(one.predicted_rate), one.verdict,
            "" if one.time is None else f"×{one.time:.2f}", f"×{one.planned_time:.2f}",
        ]
        for one, row in zip(certificates, found["functions"], strict=True)
    ]  # fmt: skip
    return markdown_grid(HEADINGS, rows)


def block() -> tuple[str, str]:
    """Sentence and table of the shipped certificate.

    Raises:
        BadInputError: It is absent, or of another plan.
    """
    path = PLAN.with_suffix(".certificate.json")
    if not path.is_file():
        raise BadInputError(f"{path.name}: absent; write it with mavfi harden --certify")
    found: Row = json.loads(path.read_text(encoding="utf-8"))
    certificates = read(load_plan(PLAN), found)
    return sentence(certificates, found), table(certificates, found)


def main() -> int:
    """Write both; returns the exit code."""
    try:
        text, grid = block()
    except BadInputError as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    fill(ROOT / "README.md", {NAME: text})
    fill(GENERATED / "hardening.md", {NAME: f"{text}\n\n{grid}"})
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
