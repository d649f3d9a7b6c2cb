"""Writes docs/generated/lasting.md, what each scheme saves from faults that last, from a campaign's ledger.

mavfi campaign run lasting --scale paper --out out/lasting
python -m tools.lasting_faults out/lasting
"""

import sys
from pathlib import Path

from tools.campaign_page import write

TEXT = (
    "One bit of a field stays stuck at its flipped value, or several adjacent bits flip once (burst; a flag has one). "
    "Every duration has the same draws of field, instant and bit, so rows differ by the duration alone. How they are "
    "injected: [fault model](../fault-model.md#a-fault-is-data-an-injection-is-an-event); the schemes: "
    "[models](../models.md#recommended).\n\n"
    "*twice*: a second fault while a recovery runs; the resent or recomputed value is hit as well. *for ever*: to the "
    "end of the flight. *intermittent*: the same, in a fifth of the publications. `recommended` restarts a node at "
    "most five times, away for 2.4 s together; after that, wrong values of a fault that still lasts pass. `hover`, "
    "`hold` and `back` are `recommended` with that degraded mode: it gives the mission up and keeps the vehicle in the "
    "air. All three are entered by the same alarm and give up the goal: their rows can differ only where one of them "
    "then loses the vehicle."
)
VIEWS = ("schemes", "schemes_by_duration", "schemes_by_target")


if __name__ == "__main__":
    write("lasting", Path(sys.argv[1]), "Faults that last", TEXT, VIEWS)
