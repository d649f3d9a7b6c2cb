"""False alarms by regime: what happened to the way-point in force since the last publication of a state.

The regimes are those by which detectors set their limits (`mavfi.detectors.residuals`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mavfi.campaign.analysis.statistics import event_rate_by_flight
from mavfi.campaign.analysis.table import NUMBER, PER_HOUR, Column, Table
from mavfi.detectors.everything import Everything
from mavfi.states import State

NAMES = ("same way-point", "new way-point", "new trajectory", "cloud, map")
"""By regime; the last one: states without a regime."""
_NONE = len(NAMES) - 1
_MILLION = 1e6


class RegimeClock:
    """The regime of each publication of a flight, in order; one without a fault.

    Args:
        autopilot: Name of the autopilot profile.
    """

    def __init__(self, autopilot: str) -> None:
        self._everything = Everything(autopilot)
        self._codes = np.zeros(len(self._everything.fields), np.int16)

    def __call__(self, state: State) -> int:
        """Index in `NAMES`."""
        slot = self._everything.slots.get(state.spec.name)
        if slot is None:
            self._everything.note(state)
            return _NONE
        found = self._everything.measure(state, slot, self._codes, keep=True)
        return found if found >= 0 else -1 - found  # not finite


@dataclass(slots=True)
class Exposure:
    """Scored publications and false alarms of one detector in one golden flight, by regime.

    Attributes:
        hours: Duration of the flight (h).
        judged: Scored publications.
        alarms: Of these, with a score above 1.
    """

    hours: float = 0.0
    judged: list[int] = field(default_factory=lambda: [0] * len(NAMES))
    alarms: list[int] = field(default_factory=lambda: [0] * len(NAMES))

    def add(self, regime: int, score: float) -> None:
        """Count a publication."""
        self.judged[regime] += 1
        self.alarms[regime] += score > 1.0


def table(found: Mapping[str, Sequence[Exposure]]) -> Table:
    """False alarms of each scheme by regime.

    Args:
        found: One exposure per flight, by scheme.
    """
    columns = (
        Column("arm", "scheme"), Column("regime", "regime"), Column("judged", "publications", NUMBER),
        Column("alarms", "false alarms", NUMBER), Column("per_hour", "per hour of flight", PER_HOUR),
        Column("per_million", "per million publications", PER_HOUR),
    )  # fmt: skip
    rows = []
    for name, flights in found.items():
        hours = [flight.hours for flight in flights]
        for regime, label in enumerate(NAMES):
            judged, alarms = (
                [getattr(flight, key)[regime] for flight in flights] for key in ("judged", "alarms")
            )  # fmt: skip
            if sum(judged):
                rates = (
                    event_rate_by_flight(alarms, hours),
                    event_rate_by_flight(alarms, [n / _MILLION for n in judged]),
                )
                rows.append((name, label, sum(judged), sum(alarms), *rates))
    exposure = max((sum(flight.hours for flight in flights) for flights in found.values()), default=0.0)
    notes = (
        f"golden flights of the parts with scores, {exposure:.2f} h, thresholds as shipped, without recovery; the "
        "rates per hour of a scheme's regimes add up",
        "each publication above the threshold counts: a deviation that lasts counts many times here, and once where "
        "recovery answers the alarm",
        "regime of a publication: since the last one of its state, or with it, the same way-point was in force, "
        "another one came, or the first one of a trajectory; cloud, map: no regime",
        "95 % interval: bootstrap of flights, at least as wide as Poisson's",
    )
    return Table("regimes", "False alarms by regime", columns, rows, 2, notes)
