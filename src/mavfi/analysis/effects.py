"""Effects of faults by setting, with intervals: the summary of campaigns whose hosts do not fly."""

from collections.abc import Mapping

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.rows import WHOLE_WORD
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.record import End

HEADINGS = {"sdc": "SDC"}
"""Effects whose label is not their heading."""
ALWAYS = ("masked", "sdc", "crash", "hang")
"""Effects that are shown even if none occurred."""
LOST = "mission lost"
DETECTED = "detected"
FALSE_ALARMS = "false alarms"
ALARMED = pl.col("detected_at_site") | pl.col("alarm_after_s").is_not_null()
"""Whether an alarm that the golden run has not follows the fault."""
_ENDS = tuple(str(end) for end in End)


def judged_faults(runs: Runs) -> Runs:
    """Runs with a fault whose effect is known."""
    return runs.injected.where("judged", pl.col("effect") != "unknown")


def has_verdicts(runs: Runs) -> bool:
    """Whether runs end with the status of a mission, or a verdict in its place."""
    return len(runs.where(~pl.col("status").is_in(_ENDS))) > 0


def effect_rate(faults: Runs, test: pl.Expr) -> Rate:
    """Share of faults that pass a test, over whole words if their bits were drawn by strata that partition a word."""
    rates = m.rates_by_population(faults, test)
    if WHOLE_WORD in rates:
        return rates[WHOLE_WORD]
    return m.rate_of(faults, test)


def effect_rates(runs: Runs) -> dict[str, Mapping[str, Rate]]:
    """Share of each effect by setting; of lost missions if there are verdicts; of alarms where a detector watches."""
    judged = judged_faults(runs)
    rates: dict[str, Mapping[str, Rate]] = {}
    for (setting,), golden in runs.golden.where("judged", pl.col("detector") != "").groups("setting").items():
        rates[setting] = {FALSE_ALARMS: m.rate_of(golden, pl.col("alarms_total") > 0)}
    for (setting,), faults in judged.groups("setting").items():
        labels = dict.fromkeys((*ALWAYS, *faults.values("effect")))
        of_setting = {label: effect_rate(faults, pl.col("effect") == label) for label in labels}
        if has_verdicts(runs):
            of_setting[LOST] = effect_rate(faults, ~pl.col("success"))
        if faults.first("detector"):
            of_setting[DETECTED] = effect_rate(faults, ALARMED)
        rates[setting] = of_setting
    return rates
