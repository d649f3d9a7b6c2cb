"""Claims of the paper's sections VI-C and VI-D: computing platforms on flights, redundant processors by a model."""

from collections.abc import Callable, Iterable

import polars as pl

from mavfi.analysis import published as paper
from mavfi.analysis.measures import leading_faults
from mavfi.analysis.runs import Runs
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.extras.paper.claims import Claim, Evidence
from mavfi.extras.paper.mission_claims import HURT, WITHIN, Unit, equality, paired, tested
from mavfi.extras.paper.platform_views import compared
from mavfi.extras.paper.redundancy import shipped_designs
from mavfi.extras.paper.redundancy_views import TMR, band, between, ratio
from mavfi.extras.paper.worlds import within_worlds
from mavfi.plugins import Chapter

PLATFORMS = "platforms"
FAST, SLOW = "i9-9940x", "cortex-a57"
"""Parts of the campaign, with the same worlds."""
_MODEL = "none: a model without chance"


_SECONDS, _KILOJOULES = Unit("s"), Unit("kJ", 1e-3)


def _of_golden(column: str, what: str, unit: Unit) -> Callable[[Runs], Evidence]:
    """Test of successful golden flights on both platforms."""

    def test(runs: Runs) -> Evidence:
        own = compared(runs).where(setting=GOLDEN)
        found = within_worlds(own.where(environment=SLOW), own.where(environment=FAST), pl.col(column), by="seed")
        return tested(found, SLOW, FAST, more=True, what=what, unit=unit)

    return test


def _times_as_long(factor: float) -> Callable[[Runs], Evidence]:
    """Test of successful flights with a fault: mean time on the slow platform - factor x mean time on the fast one."""

    def test(runs: Runs) -> Evidence:
        own = compared(runs).where(setting=FI)
        scaled = own.where(environment=FAST).adding(flight_time_s=factor * pl.col("flight_time_s"))
        found = within_worlds(own.where(environment=SLOW), scaled, pl.col("flight_time_s"), by="seed")
        return tested(found, SLOW, f"{factor:g} x {FAST}", more=True, what="mean flight time", unit=_SECONDS)

    return test


def _same_trend(runs: Runs) -> Evidence:
    """Test of the share of faults that harm."""
    own = leading_faults(runs).where(setting=FI)
    found = within_worlds(own.where(environment=SLOW), own.where(environment=FAST), HURT, by="seed")
    return tested(found, SLOW, FAST, more=True, what="fails or > 5 % longer")


def _redundant(vehicle: str) -> Callable[[Runs], Evidence]:
    """Flight time with TMR by the model; its inputs were calibrated to the claim, so it tests nothing."""

    def test(_: Runs) -> Evidence:
        designs = [design for design in shipped_designs() if design.craft == vehicle]
        found = []
        for design in designs:
            found.append(f"{design.calibration}: {ratio(design, TMR):.3f} (band {between(*band(design, TMR))})")
        return Evidence(
            f"by the model, calibrated to this value after the fact: {'; '.join(found)}", None, supports=True
        )

    return test


def _of_redundancy() -> Iterable[Claim]:
    for name, vehicle in (("redundancy_airsim", "airsim_uav"), ("redundancy_spark", "dji_spark")):
        times = paper.figure("redundancy_time", vehicle=vehicle, scheme=TMR)
        text = f"TMR makes flights of {vehicle} {times:g} times as long as detection does"
        yield Claim(name, text, "VI-C", PLATFORMS, _MODEL, _redundant(vehicle))


def _of_platforms() -> Iterable[Claim]:
    yield Claim(
        "slow_platform_time", "Flights on the Cortex-A57 take longer (115 s : 322 s)", "VI-D", PLATFORMS, WITHIN,
        _of_golden("flight_time_s", "mean flight time", _SECONDS),
    )  # fmt: skip
    yield Claim(
        "slow_platform_energy", "Flights on the Cortex-A57 need more energy (61.7 kJ : 177.1 kJ)", "VI-D", PLATFORMS,
        WITHIN, _of_golden("energy_j", "mean energy", _KILOJOULES),
    )  # fmt: skip
    factor = float(paper.figure("platforms_worst", quantity="flight_time_ratio"))
    text = f"With a fault, flights on the Cortex-A57 take at least {factor:g} times as long (the paper: the worst)"
    yield Claim("slow_platform_ratio", text, "VI-D", PLATFORMS, WITHIN, _times_as_long(factor))
    yield Claim(
        "platforms_alike", "Faults harm alike on both platforms", "VI-D", PLATFORMS, WITHIN, equality(_same_trend)
    )

    def shorter(setting: str, other: str) -> Callable[[Runs], Evidence]:
        return paired(setting, other, "inflation", more=False, what="flight time over golden", environment=SLOW)

    for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
        share = paper.figure("platforms_recovered", setting=f"dr_{arm}")
        text = f"On the Cortex-A57 {short} recovers flight time (by {100 * share:.1f} % of the worst)"
        yield Claim(
            f"{arm}_recovers_slow_platform", text, "VI-D", PLATFORMS, WITHIN,
            shorter(f"dr_{arm}", FI),
        )  # fmt: skip
    yield Claim(
        "autoencoder_beats_gaussian_slow_platform", "On the Cortex-A57 AAD recovers more flight time than GAD", "VI-D",
        PLATFORMS, WITHIN, shorter("dr_autoencoder", "dr_gaussian"),
    )  # fmt: skip


PLATFORMS = Chapter(30, (*_of_redundancy(), *_of_platforms()))
