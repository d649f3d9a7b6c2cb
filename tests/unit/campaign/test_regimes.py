"""False alarms by regime: the regimes against their definition, and the rates against counts."""

import numpy as np
import pytest

from mavfi.campaign.regimes import NAMES, Exposure, RegimeClock, table
from mavfi.states import AUTOPILOTS
from tests.unit.detectors import streams

SAME, NEW, TRAJECTORY, NONE = range(4)
WATCHED = ("perception.collision_status", "planning.path", "planning.trajectory", "planning.waypoint",
           "control.command", "control.tracking")  # fmt: skip


def by_definition(events):
    """Regime of each publication, from the way-points between it and the last one of its state."""
    for place, (state, _) in enumerate(events):
        name = state.spec.name
        if name not in WATCHED:
            yield NONE
            continue
        before = [k for k in range(place) if events[k][0].spec.name == name]
        since = range(before[-1] + 1 if before else 0, place + (name == "planning.waypoint"))
        points = [k for k in since if events[k][0].spec.name == "planning.waypoint"]
        yield max((new_or_first(events, k) for k in points), default=SAME)


def new_or_first(events, place):
    earlier = [s.header["trajectory_seq"][0] for s, _ in events[:place] if s.spec.name == "planning.waypoint"]
    return NEW if earlier and earlier[-1] == events[place][0].header["trajectory_seq"][0] else TRAJECTORY


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_regimes_are_those_of_their_definition(autopilot):
    events, clock = streams.flight(3, 200), RegimeClock(autopilot)
    found = [clock(state) for state, _ in events]
    assert found == list(by_definition(events))
    assert {SAME, NEW, TRAJECTORY, NONE} == set(found)


def exposure(hours, judged, alarms, environment="dense"):
    return Exposure(hours, judged, alarms, environment)


def test_rates_by_regime_add_up_and_have_their_own_exposure():
    flights = [exposure(1.0, [1000, 100, 0, 0], [2, 0, 0, 0]), exposure(3.0, [3000, 300, 0, 8], [0, 4, 0, 0])]
    found = table({"one": flights, "silent": [Exposure(4.0)]})
    rows = {entry["regime"]: entry for entry in found.entries()}
    assert list(rows) == [NAMES[SAME], NAMES[NEW], NAMES[NONE]], "what is never judged has no row"
    same, new, none = rows.values()
    assert (same["judged"], same["alarms"], same["per_hour"].per_hour) == (4000, 2, 0.5)
    assert sum(entry["per_hour"].per_hour for entry in rows.values()) == 6 / 4.0
    assert new["per_million"].per_hour == pytest.approx(1e6 * 4 / 400)
    assert none["per_hour"].per_hour == 0.0 and none["per_hour"].high > 0.0
    assert same["per_hour"].low <= 0.5 <= same["per_hour"].high
    assert "4.00 h" in found.notes[0]


def test_rates_of_environments_count_their_flights_alone():
    flights = [
        exposure(1.0, [10, 10, 0, 0], [2, 1, 0, 0]),
        exposure(1.0, [10, 10, 0, 0], [1, 0, 0, 0]),
        exposure(4.0, [40, 40, 0, 0], [0, 2, 0, 0], "farm"),
    ]
    found = table({"one": flights, "two": flights[:2]})
    assert [column.heading for column in found.columns[-3:]] == ["per hour of flight", "dense", "farm"]
    shown = [(row["arm"], row["regime"], *(None if row[key] is None else (row[key].events, row[key].hours)
             for key in ("per_hour", "dense", "farm"))) for row in found.entries()]  # fmt: skip
    assert shown == [
        ("one", NAMES[SAME], (3, 6.0), (3, 2.0), (0, 4.0)), ("one", NAMES[NEW], (3, 6.0), (1, 2.0), (2, 4.0)),
        ("two", NAMES[SAME], (3, 2.0), (3, 2.0), None), ("two", NAMES[NEW], (1, 2.0), (1, 2.0), None),
    ]  # fmt: skip


def test_only_scores_above_one_are_alarms():
    own = Exposure()
    for score in (0.0, 1.0, np.nextafter(1.0, 2.0), 9.0):
        own.add(NEW, score)
    assert (own.judged, own.alarms) == ([0, 4, 0, 0], [0, 2, 0, 0])
