"""Put the certificate of the shipped plan into README.md and docs/generated/hardening.md.

python -m tools.build_certificate

After `mavfi harden LEDGER --plan configs/protections/ten_percent.yaml --certify --faults 1000`, which writes it.
"""

import json
import sys

from mavfi.campaign.hardening.certification import certification_of
from mavfi.errors import BadInputError
from mavfi.hardening.plan import load_plan
from mavfi.reports.hardening.plain import certificate_table, verdict_line
from mavfi.reports.text import markdown_grid, shown
from tools.build_hardening import PAGE, PLAN
from tools.markers import ROOT, fill

CERTIFICATE = PLAN.with_suffix(".certificate.json")
NAME = "certificate"


def blocks() -> tuple[str, str]:
    """What the certificate says, in a sentence, and with a table.

    Raises:
        BadInputError: It is of another plan.
    """
    found, plan = certification_of(json.loads(CERTIFICATE.read_text(encoding="utf-8"))), load_plan(PLAN)
    if found.plan != plan.digest:
        raise BadInputError(f"{CERTIFICATE.name}: of plan {found.plan[:12]}, this is {plan.digest[:12]}; certify it")
    table, verdict = certificate_table(found), verdict_line(found)
    columns, rows = shown(table)
    notes = "\n".join(f"- {note}" for note in table.notes)
    same = f"; {plan.cpu}; " in PAGE.read_text(encoding="utf-8").partition("\n## ")[0]
    chosen = "" if same else f" Chosen with times on {plan.cpu}; the study above was timed on another processor."
    sentence = f"The shipped plan{verdict.removeprefix('The plan')}{chosen}"
    return sentence, f"{sentence}\n\n{markdown_grid([column.heading for column in columns], rows)}\n\n{notes}"


def main() -> int:
    """Write both; returns the exit code."""
    try:
        sentence, section = blocks()
    except (BadInputError, OSError) as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    fill(ROOT / "README.md", {NAME: sentence})
    fill(PAGE, {NAME: section})
    print(sentence)
    return 0


if __name__ == "__main__":
    sys.exit(main())
