from dataclasses import replace

import pytest

from mavfi.analysis import measures as m
from mavfi.analysis.rows import WHOLE_WORD
from tests.core.unit.analysis.handmade import (
    DUE,
    FAULT,
    GOLDEN,
    INSTRUCTION,
    UNKNOWN,
    alarm,
    flown,
    golden,
    injected,
    runs,
)


def test_unknown_runs_are_left_out_and_due_runs_fail():
    campaign_runs = runs(golden(1), injected(1, flown()), injected(2, DUE), injected(3, UNKNOWN)).injected
    rate = m.rates_by_population(campaign_runs, "success")["sign_exponent"]
    assert (rate.n, rate.successes) == (2, 1)


def test_strata_that_part_the_word_make_up_whole_words():
    faults = [replace(FAULT, stratum=name) for name in ("sign", "exponent", "mantissa")]
    campaign_runs = runs(*(injected(seed, flown(), fault) for seed, fault in enumerate(faults)))
    assert WHOLE_WORD in m.rates_by_population(campaign_runs, "success")
    assert WHOLE_WORD not in m.rates_by_population(campaign_runs.where(m.pl.col("seed") < 2), "success")
    assert m.population_names(campaign_runs, ()) == ["sign", "exponent", "whole_word", "mantissa"]
    instructions = [replace(INSTRUCTION, stratum=name) for name in ("a", "b")]
    campaign_runs = runs(*(injected(seed, flown(), fault) for seed, fault in enumerate(instructions)))
    assert list(m.rates_by_population(campaign_runs, "success")) == [m.ALL_BITS], (
        "bits of instructions are one population"
    )


def test_slower_counts_from_five_per_cent():
    times = {52.4: False, 52.6: True}
    for time_s, hurt in times.items():
        campaign_runs = runs(golden(1), injected(1, flown(flight_time_s=time_s))).injected
        assert m.rate_of(campaign_runs, m.FAILS_OR_SLOWER).successes == int(hurt)
    assert m.rate_of(runs(golden(1), injected(1, flown(success=False))).injected, m.FAILS_OR_SLOWER).rate == 1.0


def test_recovery_counts_lost_brought_back_and_newly_lost():
    ends = {1: (False, True), 2: (False, False), 3: (True, False), 4: (True, True)}
    campaign_runs = [golden(seed) for seed in ends]
    for seed, (fi, dr) in ends.items():
        campaign_runs += [injected(seed, flown(fi)), injected(seed, flown(dr), arm="gaussian")]
    paired = m.against_fi(runs(*campaign_runs, injected(9, flown(), arm="gaussian")))
    assert paired["seed"] == [1, 2, 3, 4], "a run of the arm without one in fi is no pair"
    recovery, test = m.recovery_of(paired), m.discordant(paired)
    assert (recovery.lost, recovery.regained, test.first_only, test.second_only) == (2, 1, 1, 1)
    assert m.against_golden(paired.adding(success=m.pl.col("fi_success"))).first_only == 2


def test_alarms_of_nearly_every_flight_are_systematic():
    start, chance = alarm(0.40046, "control.command"), alarm(12.0)
    records = [replace(GOLDEN, alarms=(start, chance)[: 1 + (seed < 10)], alarms_total=1) for seed in range(20)]
    campaign_runs = runs(*(golden(seed, record, arm="g") for seed, record in enumerate(records)))
    assert m.systematic(campaign_runs) == [("control.command", pytest.approx(0.40046), 20)]
    assert m.systematic(campaign_runs.where(seed=0)) == [], "one flight shows nothing"


def test_recomputations_are_not_counted_as_compute_time():
    record = replace(GOLDEN, compute_us={"octomap": 900, "pid": 400}, recompute_us={"perception": 300, "control": 0})
    campaign_runs = runs(golden(1, record, arm="g"))
    shares = [m.recomputed_share(campaign_runs.recorded(), (stage,)) for stage in ("perception", "control")]
    assert (m.recomputed(campaign_runs), shares) == (0.3, [0.3, 0.0])
    assert m.recomputed(runs(golden(1))) is None
