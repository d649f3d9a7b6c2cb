from dataclasses import replace

import pytest

from mavfi.analysis.views import table
from mavfi.record import EnergyTerms
from tests.core.unit.analysis.handmade import GOLDEN, flown, golden, injected, runs

PARTS = {
    "fast": {"environment": "dense", "platform": "i9-9940x"},
    "slow": {"environment": "dense", "platform": "cortex-a57"},
}


def lasting(seconds, record=GOLDEN):
    return replace(record, flight_time_s=seconds, energy=EnergyTerms(duration_s=seconds))


def campaign(**about):
    """Golden flights of 40 s and 100 s; a fault adds up to 40 s and 100 s, the detector leaves 10 s and 0 s of that."""
    entries = []
    for name, time in (("fast", 40.0), ("slow", 100.0)):
        for seed in (1, 2):
            entries += [
                golden(seed, lasting(time), environment=name),
                golden(seed, lasting(time), arm="gaussian", environment=name),
            ]
        entries.append(injected(1, lasting(time, flown()), environment=name))
        entries.append(injected(2, lasting(2 * time, flown()), environment=name))
        entries.append(injected(3, lasting(9 * time, flown(False)), environment=name))
        left = 10.0 if name == "fast" else 0.0
        entries.append(injected(2, lasting(time + left, flown()), environment=name, arm="gaussian"))
    return runs(*entries, parts=PARTS, **about)


def rows(campaign_runs):
    return {(row["environment"], row["setting"]): row for row in table(campaign_runs, "platforms").entries()}


def test_times_energies_and_ratios_by_hand():
    shown = rows(campaign())
    assert set(shown) == {(name, setting) for name in PARTS for setting in ("golden", "fi", "dr_gaussian")}
    assert shown["fast", "fi"]["n"] == 2, "failures have no flight time"
    assert shown["fast", "fi"]["worst_s"] == 80 and shown["fast", "fi"]["median_s"] == 60
    ratio, worst = shown["slow", "golden"]["median_ratio"], shown["slow", "fi"]["worst_ratio"]
    assert (ratio.rate, ratio.low, ratio.high, ratio.p_value) == (2.5, 2.5, 2.5, 0.5), "two worlds: 2 of 4 swaps"
    assert worst.rate == 2.5 and (worst.low, worst.high) == (2.5, 2.5)
    assert shown["slow", "golden"]["energy_ratio"].rate == pytest.approx(2.5)
    assert shown["fast", "golden"]["median_ratio"] is None
    assert shown["slow", "golden"]["power_w"] == pytest.approx(443.9)
    assert shown["fast", "dr_gaussian"]["recovered"].rate == pytest.approx(30 / 40)
    assert shown["slow", "dr_gaussian"]["recovered"].rate == 1.0
    assert shown["fast", "fi"]["recovered"] is None
