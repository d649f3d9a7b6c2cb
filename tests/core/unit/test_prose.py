"""Figures in sentences of the documentation are those of the tables of mavfi, for the profile that is flown."""

import re

import pytest

from mavfi.states import AUTOPILOTS, STATES
from tests.pages import DOCS

PAGES = sorted(path.relative_to(DOCS) for name in ("tutorials", "concepts") for path in (DOCS / name).glob("*.md"))
BLOCKS = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
SENTENCE_ENDS = re.compile(r"(?<=[.;:])\s+(?=\D)")
NAMES = {"way-point": "planning.waypoint", "command": "control.command", "odometry": "sensor.odometry"}
"""What sentences call a state."""
SECONDS = {"s": 1.0, "ms": 1e-3}
TIMES = re.compile(r"(?P<per_second>\d+)(?: times a second| Hz)|every (?P<every>[\d.]+) (?P<every_unit>m?s)\b")
LATER = re.compile(r"(?P<every>[\d.]+) (?P<every_unit>m?s) later the next(?P<per_second>)")


def periods_in(sentence):
    """The periods that a sentence names (s)."""
    periods = []
    for match in (*TIMES.finditer(sentence), *LATER.finditer(sentence)):
        if match["per_second"]:
            periods.append(1 / int(match["per_second"]))
        else:
            periods.append(float(match["every"]) * SECONDS[match["every_unit"]])
    return periods


def period_of(state, autopilot):
    """Period of the publications of a state, as `mavfi states` prints it (s)."""
    rate = STATES[state].rate
    of_profile = re.search(rf"{autopilot} ([\d.]+) (m?s)\b", rate)
    if of_profile:
        return float(of_profile[1]) * SECONDS[of_profile[2]]
    return 1 / int(re.match(r"(\d+) Hz", rate)[1])


def wrong_periods(text):
    """Sentences with a period that is not that of the state they are about."""
    wrong = []
    for sentence in SENTENCE_ENDS.split(BLOCKS.sub("", text).replace("\n", " ")):
        autopilot = next((name for name in AUTOPILOTS if name in sentence), AUTOPILOTS[0])
        states = [state for name, state in NAMES.items() if name in sentence]
        right = [pytest.approx(period_of(state, autopilot)) for state in states]
        wrong += [sentence for period in periods_in(sentence) if states and period not in right]
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_periods_in_prose_are_those_of_the_states(page):
    assert not wrong_periods((DOCS / page).read_text(encoding="utf-8"))


def test_a_wrong_period_is_seen():
    assert wrong_periods("One *way-point*, the position that the planner hands over 50 times a second:")
    assert wrong_periods("No mission is lost, not even by a way-point: 20 ms later the next one replaces it.\n")
    assert not wrong_periods("With hardened, a way-point comes every 20 ms. A command comes at 50 Hz.")
