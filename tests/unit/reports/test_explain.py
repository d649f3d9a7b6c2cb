import numpy as np
import pytest

from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.flight_log import COLUMNS, FlightLog
from mavfi.mission import MissionStatus
from mavfi.reports.explain import departure, explain, lines, to_json
from mavfi.reports.watch import Publication, first_difference
from mavfi.states import new_state


def _publication(time_us, x=1.0, name="planning.waypoint"):
    state = new_state(name)
    state.header["x"] = x
    return Publication(time_us, state)


def test_same_publications_do_not_differ():
    assert first_difference([_publication(0)], [_publication(0)]) is None


def test_the_first_changed_field_is_named():
    found = first_difference([_publication(0), _publication(5)], [_publication(0), _publication(5, 2.0)])
    assert (found.time_us, found.state, found.field, found.golden, found.injected) == (
        5,
        "planning.waypoint",
        "x",
        1.0,
        2.0,
    )


def test_nan_and_negative_zero_differ_by_their_bits():
    assert first_difference([_publication(0, 0.0)], [_publication(0, -0.0)]).field == "x"
    assert first_difference([_publication(0, np.nan)], [_publication(0, np.nan)]) is None


def test_a_changed_element_is_named_with_its_place():
    before, after = new_state("planning.path", 3), new_state("planning.path", 3)
    after.elements["y"][2] = 1.0
    assert first_difference([Publication(0, before)], [Publication(0, after)]).field == "y[2]"


def test_a_later_or_an_absent_publication_differs():
    assert first_difference([_publication(0)], [_publication(1)]).field == ""
    assert first_difference([_publication(0)], [_publication(0), _publication(7)]).time_us == 7


def _log(offsets):
    rows = np.zeros((len(offsets), len(COLUMNS)))
    rows[:, 0] = 0.02 * np.arange(len(offsets))
    rows[:, 2] = offsets
    return FlightLog(rows, MissionStatus.SUCCESS)


def test_departure_is_where_the_distance_exceeds_the_limit():
    found = departure(_log([0, 0, 0, 0, 0]), _log([0, 0.05, 0.2, 0.7, 0.3]))
    assert found.time_s == pytest.approx(0.04)
    assert found.position == (0.0, 0.2, 0.0)
    assert (found.largest_m, found.largest_s) == (0.7, pytest.approx(0.06))


def test_departure_of_a_corrupted_flight_is_infinite():
    assert departure(_log([0, 0, 0]), _log([0, np.nan, 0])).largest_m == np.inf


def test_paths_that_stay_together_do_not_part():
    found = departure(_log([0, 0]), _log([0, 0.01]))
    assert found.time_s is None
    assert found.largest_m == pytest.approx(0.01)


@pytest.fixture(scope="module")
def struck(flown):
    with Store.open(flown) as store:
        return next(
            run.spec.run_id for run in store.runs()
            if run.spec.setting == "fi" and run.spec.fault.stage == "control" and run.spec.fault.has_site
        )  # fmt: skip


def test_a_run_is_explained_from_the_fault_on(flown, struck):
    found = explain(flown, struck)
    assert found.same
    injection = found.log.injections[0]
    assert f"{found.first.state}.{found.first.field}" == injection["site"]
    assert 1e-6 * found.first.time_us == pytest.approx(injection["time_s"])
    assert [heading for heading, _ in lines(found)] == ["run", "fault", "first difference", "path", "alarms", "end"]
    assert to_json(found)["first_difference"]["state"] == found.first.state


def test_golden_runs_have_nothing_to_explain(flown):
    with pytest.raises(BadInputError, match="has no fault to explain"):
        explain(flown, "sparse-10000-golden-")
