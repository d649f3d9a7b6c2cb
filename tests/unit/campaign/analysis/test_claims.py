import polars as pl
import pytest

from mavfi.campaign.analysis.claims import CLAIMS, Claim, Evidence, claims_table, holm, register, verdict
from mavfi.campaign.overheads import ALL
from mavfi.errors import BadInputError
from mavfi.flight_record import EnergyTerms
from tests.unit.campaign.analysis.handmade import flown, golden, injected, runs


def test_holm_is_that_of_the_textbook():
    # Holm (1979): ordered 0.005, 0.01, 0.03, 0.04 -> 4 x 0.005, 3 x 0.01, 2 x 0.03, then no smaller than before
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([None, 0.2, None]) == [None, 0.2, None]
    assert holm([0.9, 0.8]) == [1.0, 1.0]


@pytest.mark.parametrize(
    ("corrected", "supports", "expected"),
    [(0.01, True, "confirmed"), (0.01, False, "contradicted"), (0.05, True, "undecided"), (None, True, "undecided")],
)
def test_verdicts(corrected, supports, expected):
    assert verdict(Evidence("", 0.001, supports=supports), corrected) == expected


def test_the_correction_is_over_all_claims_of_the_table():
    name = "of_this_test"
    register(Claim(name, "It holds", "I", "handmade", "by hand", lambda _: Evidence("seen", 0.03, supports=True)))
    try:
        own = [runs(golden(1), injected(1, flown()))]
        [alone] = claims_table([name], own).entries()
        assert (alone["verdict"], alone["holm_p"]) == ("confirmed", 0.03)
        first, second = claims_table([name, name], own).entries()
        assert first["holm_p"] == second["holm_p"] == 0.06 and first["verdict"] == "undecided"
        [absent] = claims_table([name], []).entries()
        assert (absent["verdict"], absent["p"]) == ("undecided", None) and "no runs of campaign" in absent["here"]
    finally:
        del CLAIMS[name]
    with pytest.raises(BadInputError, match="claim 'none': not known; allowed: perception_least_critical"):
        claims_table(["none"], [])


def states(stage_lost, arm_saves=True):
    """Ten missions with one fault each: those of a stage are lost without the detector `gaussian`."""
    own = []
    for seed in range(10):
        own += [golden(seed), injected(seed, flown(not stage_lost)), injected(seed, flown(arm_saves), arm="gaussian")]
    return runs(*own, name="table1")


@pytest.mark.parametrize(
    ("name", "stage_lost", "arm_saves", "expected"),
    [
        ("fault_loses_missions_in_states", True, True, "confirmed"),
        ("fault_loses_missions_in_states", False, True, "undecided"),
        ("gaussian_recovers_in_states", True, True, "confirmed"),
        ("gaussian_recovers_in_states", False, False, "contradicted"),
    ],
)
def test_claims_of_the_paper_follow_the_runs(name, stage_lost, arm_saves, expected):
    [found] = claims_table([name], [states(stage_lost, arm_saves)]).entries()
    assert found["verdict"] == expected, found["here"]


def test_verdict_and_p_open_the_tested_runs():
    own = states(True)
    found = claims_table(["fault_loses_missions_in_states", "gaussian_recovers_in_states"], [own])
    linked = [column.key in ("verdict", "p", "holm_p") for column in found.columns]
    for behind, settings in zip(found.behind, (["fi"], ["fi", "dr_gaussian"]), strict=True):
        assert [bool(ids) for ids in behind] == linked
        tested = own.injected.where(pl.col("setting").is_in(settings))
        assert {ids for ids in behind if ids} == {tuple(sorted(tested["run_id"], key=behind[2].index))}


@pytest.mark.parametrize(("share", "expected"), [(1e-6, "confirmed"), (0.01, "contradicted"), (None, "undecided")])
def test_measured_overheads_are_tested_by_stage(share, expected):
    rows = [
        {"environment": place, "arm": "autoencoder", "stage": stage, "detection": share / 2, "recovery": share / 2}
        for place in ("factory", "farm", "sparse", "dense")
        for stage in (("perception", "planning", "control", ALL) if share else ())
    ] if share else []  # fmt: skip
    own = runs(golden(1), name="table1")
    own.campaign["overheads"] = {"rows": rows}
    [found] = claims_table(["autoencoder_overhead_measured"], [own]).entries()
    assert found["verdict"].startswith(expected), found


def test_a_bound_is_tested_on_recomputation_over_compute_time():
    def flight(spent):
        return flown(recompute_us={"control": spent}, compute_us={"pid": 1_000_000 + spent})

    for spent, expected in ((10_000, "confirmed"), (100_000, "contradicted")):
        own = [injected(seed, flight(spent), arm="gaussian") for seed in range(10)]
        [found] = claims_table(["gaussian_overhead"], [runs(*own, name="table1_instructions")]).entries()
        assert found["verdict"] == expected and "(n = 10) of compute time" in found["here"]


PLATFORMS = {"i9-9940x": {"platform": "i9-9940x"}, "cortex-a57": {"platform": "cortex-a57"}}


def on_platforms(slow, faulty, detected):
    """Ten missions per platform with one fault each; flight times (s) on the Cortex-A57, 40 s elsewhere."""
    own = []
    for seed in range(10):
        for place, times in (("i9-9940x", (40.0, 40.0, 40.0)), ("cortex-a57", (slow, faulty, detected))):
            one, fault, cured = (flown(flight_time_s=time + 0.01 * seed, energy=EnergyTerms(time)) for time in times)
            own += [
                golden(seed, one, environment=place),
                injected(seed, fault, environment=place),
                injected(seed, cured, environment=place, arm="gaussian"),
            ]
    return runs(*own, name="platforms", parts=PLATFORMS)


@pytest.mark.parametrize(
    ("name", "times", "expected", "here"),
    [
        (
            "slow_platform_time",
            (100, 100, 100),
            "confirmed",
            "cortex-a57 100.0 s [100.0, 100.1] (n = 10), i9-9940x 40.0 s [40.0, 40.1] (n = 10)",
        ),
        ("slow_platform_time", (30, 30, 30), "contradicted", "cortex-a57 30.0 s"),
        ("slow_platform_energy", (100, 100, 100), "confirmed", "cortex-a57 44.4 kJ [44.4, 44.4] (n = 10), i9-9940x"),
        (
            "slow_platform_ratio",
            (100, 150, 100),
            "confirmed",
            "150.0 s [150.0, 150.1] (n = 10), 2.8 x i9-9940x 112.1 s",
        ),
        (
            "slow_platform_ratio",
            (100, 100, 100),
            "contradicted",
            "100.0 s [100.0, 100.1] (n = 10), 2.8 x i9-9940x 112.1 s",
        ),
        (
            "platforms_alike",
            (100, 150, 100),
            "contradicted",
            "cortex-a57 100.0 % [72.2, 100.0] (n = 10), i9-9940x 0.0 % [0.0, 27.8]",
        ),
        ("platforms_alike", (100, 100, 100), "undecided", "cortex-a57 0.0 % [0.0, 27.8] (n = 10), i9-9940x"),
        ("gaussian_recovers_slow_platform", (100, 150, 100), "confirmed", "fault with GAD 0.0 % [0.0, 0.0] (n = 10)"),
        ("gaussian_recovers_slow_platform", (100, 110, 150), "contradicted", "fault 10.0 % [10.0, 10.0] (n = 10)"),
        ("redundancy_airsim", (100, 100, 100), "undecided", "calibrated to this value after the fact"),
    ],
)
def test_claims_of_platforms_follow_the_runs(name, times, expected, here):
    [found] = claims_table([name], [on_platforms(*times)]).entries()
    assert found["verdict"] == expected and here in found["here"], found["here"]
