from dataclasses import replace

import polars as pl
import pytest

from mavfi.analysis import published as paper
from mavfi.analysis.measures import leading_populations, population_text
from mavfi.analysis.views import table
from mavfi.extras.paper.figures import path_cases
from mavfi.extras.paper.views import by_bits, by_state, value_at_risk
from mavfi.faults.fault import FaultSite
from mavfi.levels.state.fault import StateFault
from tests.core.unit.analysis.handmade import FAULT, GOLDEN, INSTRUCTION, flown, golden, injected, runs

PERCEPTION = StateFault(FaultSite("perception.collision_status", "time_to_collision"), 1, 62, "sign_exponent", 0.1)


def entries(own, name, **where):
    return [row for row in table(own, name).entries() if all(row[key] == value for key, value in where.items())]


def test_value_at_risk_is_the_mean_of_the_slowest():
    assert value_at_risk([float(value) for value in range(1, 101)]) == 98.0
    assert value_at_risk([1.0, 3.0]) == 3.0, "at least one"
    assert value_at_risk([]) is None


def test_rows_are_tested_against_their_golden_runs_in_pairs():
    lost = replace(GOLDEN, status="collision")
    own = [golden(seed, lost if seed == 6 else GOLDEN) for seed in range(9)]
    # six pairs: five lost, none saved, one alike; the seventh mission fails without the fault, the last has no twin
    own += [injected(seed, flown(seed == 5), INSTRUCTION, target="pid") for seed in (*range(7), 20)]
    found = table(runs(*own, each="kernel"), "kernels_as_in_the_paper")
    first, second = found.entries()
    assert (first["p"], second["n"], second["p"]) == (None, 8, pytest.approx(2 * 0.5**5))
    behind = found.behind[1][[column.key for column in found.columns].index("p")]
    assert len(behind) == 7 and not any("-20-" in run_id for run_id in behind)
    assert any("McNemar's exact test" in note for note in found.notes)


def test_flight_times_are_of_pairs_that_succeed_in_all_settings(fake):
    for environment in ("sparse", "dense"):
        bare, faulty, watched = entries(fake, "flight_times", environment=environment)
        assert [row["setting"] for row in (bare, faulty, watched)] == ["golden", "fi", "dr_gaussian"]
        leading = fake.where(environment=environment, setting="fi", population="sign_exponent")
        failing = leading.where(~pl.col("success"))
        assert faulty["pairs"] == watched["pairs"] == len(leading) - len(failing)
        assert faulty["worst"] > 0.1 and watched["worst"] == pytest.approx(0)
        [worst] = fake.where(run_id=faulty["worst_run"])["inflation"]
        assert worst == faulty["worst"]
        assert faulty["paper"] == paper.worst_time(environment, "fi")
        assert watched["recovered"].rate == pytest.approx(faulty["worst"])
        assert watched["recovered_p95"].rate == pytest.approx(faulty["p95"], abs=1e-3)
        assert watched["recovered"].low <= watched["recovered"].rate <= watched["recovered"].high
        assert 0 < watched["recovered"].p_value <= 1
        assert watched["paper_recovered"] is None  # the arm's detector is a custom one
        assert faulty["recovered"] is bare["recovered"] is None
        assert faulty["time_limit"] == 150.0


def test_cases_are_the_faults_that_the_detector_shortens_most():
    def pair(seed, time, with_detector, fault=PERCEPTION, target="perception", **more):
        return [
            golden(seed, environment="dense"),
            injected(seed, flown(flight_time_s=time, **more), fault, target=target, environment="dense"),
            injected(
                seed, flown(flight_time_s=with_detector), fault, arm="autoencoder", target=target, environment="dense"
            ),
        ]

    shortened = runs(*pair(1, 60.0, 59.0), *pair(2, 55.0, 50.0), *pair(3, 90.0, 50.0, activated=False), golden(9))
    [found] = path_cases(shortened)
    assert (found.stage, found.environment, found.arm) == ("perception", "dense", "autoencoder")
    assert found.fault.startswith("dense-2-fi") and found.inflation == pytest.approx(0.1)
    saved = runs(*pair(1, 50.0, 50.0), *pair(4, 30.0, 51.0, success=False))
    assert path_cases(saved)[0].fault.startswith("dense-4"), "nothing is shortened: a mission that is saved"
    assert path_cases(runs(golden(1, GOLDEN))) == []


def test_sign_and_exponent_lead_together_where_they_are_drawn_apart():
    """Fig. 4 counts faults in both; section III-B those in floats, not the other bits of an integer."""
    own = [golden(1)]
    for index, (stratum, bit) in enumerate((("sign", 63), ("exponent", 60), ("mantissa", 3))):
        own.append(injected(1, flown(), replace(FAULT, stratum=stratum, bit=bit), target="yaw", index=index))
    epoch = FaultSite("planning.trajectory", "trajectory_seq")
    for index, (stratum, bit) in enumerate((("sign_exponent", 31), ("mantissa", 3))):
        fault = replace(FAULT, where=epoch, stratum=stratum, bit=bit)
        own.append(injected(1, flown(), fault, target="epochs", index=index))
    found = runs(*own, name="states")
    assert by_state(found).values("target") == ["golden run", "yaw", "epochs"]
    assert [len(by_state(found).where(target=name)) for name in ("yaw", "epochs")] == [2, 1]
    assert by_bits(found).values("bits") == ["golden run", "sign", "exponent", "mantissa"]
    assert [len(by_bits(found).where(bits=name)) for name in ("sign", "exponent", "mantissa")] == [1, 1, 1]
    assert population_text(leading_populations(found)) == "sign + exponent"
    assert [population_text([name]) for name in ("sign", "all_bits")] == ["sign", ""]
