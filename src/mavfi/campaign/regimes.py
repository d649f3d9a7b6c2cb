"""False alarms by regime and environment.

A regime is what happened to the way-point in force since the last publication of a state.
Detectors set their limits by the same regimes (`mavfi.detectors.residuals`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mavfi.campaign.analysis.statistics import EventRate, event_rate_by_flight
from mavfi.campaign.analysis.table import NUMBER, PER_HOUR, Column, Table
from mavfi.detectors.field_codes import FieldCodes
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
        self._field_codes = FieldCodes(autopilot)
        self._codes = np.zeros(len(self._field_codes.fields), np.int16)

    def __call__(self, state: State) -> int:
        """Index in `NAMES`."""
        slot = self._field_codes.slots.get(state.spec.name)
        if slot is None:
            self._field_codes.note(state)
            return _NONE
        found = self._field_codes.measure(state, slot, self._codes, keep=True)
        return found if found >= 0 else -1 - found  # not finite


@dataclass(slots=True)
class Exposure:
    """Scored publications and false alarms of one detector in one golden flight, by regime.

    Attributes:
        hours: Duration of the flight (h).
        judged: Scored publications.
        alarms: Of these, with a score above 1.
        environment: Environment of the flight.
    """

    hours: float = 0.0
    judged: list[int] = field(default_factory=lambda: [0] * len(NAMES))
    alarms: list[int] = field(default_factory=lambda: [0] * len(NAMES))
    environment: str = ""

    def add(self, regime: int, score: float) -> None:
        """Count a publication."""
        self.judged[regime] += 1
        self.alarms[regime] += score > 1.0


def table(found: Mapping[str, Sequence[Exposure]]) -> Table:
    """False alarms of each scheme by regime, and of these the rate in each environment.

    Args:
        found: One exposure per flight, by scheme.
    """
    places = list(dict.fromkeys(flight.environment for flights in found.values() for flight in flights))
    columns = (
        Column("arm", "scheme"), Column("regime", "regime"), Column("judged", "publications", NUMBER),
        Column("alarms", "false alarms", NUMBER), Column("per_million", "per million publications", PER_HOUR),
        Column("per_hour", "per hour of flight", PER_HOUR), *(Column(place, place, PER_HOUR) for place in places),
    )  # fmt: skip
    rows = []
    for name, flights in found.items():
        own = [[flight for flight in flights if flight.environment == place] for place in places]
        for regime, label in enumerate(NAMES):
            judged = [flight.judged[regime] for flight in flights]
            if sum(judged):
                alarms = sum(_alarms(flights, regime))
                per_million = event_rate_by_flight(_alarms(flights, regime), [n / _MILLION for n in judged])
                rows.append((
                    name, label, sum(judged), alarms, per_million, *(_per_hour(one, regime) for one in (flights, *own))
                ))  # fmt: skip
    exposure = max((sum(flight.hours for flight in flights) for flights in found.values()), default=0.0)
    notes = (
        f"golden flights of the parts with scores, {exposure:.2f} h, thresholds as shipped, without recovery; the "
        "rates per hour of a scheme's regimes add up",
        f"{', '.join(places)}: per hour of flight there",
        "each publication above the threshold counts: a deviation that lasts counts many times here, and once where "
        "recovery answers the alarm",
        "regime of a publication: since the last one of its state, or with it, the same way-point was in force, "
        "another one came, or the first one of a trajectory; cloud, map: no regime",
        "95 % interval: bootstrap of flights, at least as wide as Poisson's",
    )
    return Table("regimes", "False alarms by regime", columns, rows, 2, notes)


def _alarms(flights: Sequence[Exposure], regime: int) -> list[int]:
    return [flight.alarms[regime] for flight in flights]


def _per_hour(flights: Sequence[Exposure], regime: int) -> EventRate | None:
    """Rate of a regime's false alarms; None without a flight."""
    return event_rate_by_flight(_alarms(flights, regime), [flight.hours for flight in flights]) if flights else None
