"""Rates of a detector on recorded flights, each with its exposure or number and its 95 % interval."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from mavfi.analysis.statistics import EventRate, Rate, event_rate, wilson
from mavfi.extras.logs.watch import BIT_CLASSES, Judged

_MINUTE, _HOUR = 60.0, 3600.0


@dataclass(frozen=True)
class Rates:
    """Rates over several recordings."""

    recordings: Sequence[Judged]

    @property
    def exposure_s(self) -> float:
        """Normal flight judged (s)."""
        return sum(judged.exposure_s for judged in self.recordings)

    @property
    def alarms(self) -> EventRate:
        """Alarm events per hour of normal flight, with the exact interval of Poisson counts."""
        return event_rate(sum(judged.events for judged in self.recordings), self.exposure_s / _HOUR)

    @property
    def flips(self) -> Mapping[str, Rate]:
        """Share of detected flips by class of the bit."""
        every = [flip for judged in self.recordings for flip in judged.flips]
        groups = {name: [flip.detected for flip in every if flip.bit_class == name] for name in BIT_CLASSES}
        return {name: wilson(sum(found), len(found)) for name, found in groups.items() if found}

    @property
    def faults(self) -> Rate:
        """Share of the known faults that were followed by an alarm."""
        known = [judged for judged in self.recordings if judged.has_fault]
        return wilson(sum(judged.fault_delay_s is not None for judged in known), len(known))

    @property
    def delays_s(self) -> list[float]:
        """Delays of the detected known faults (s), ascending."""
        return sorted(judged.fault_delay_s for judged in self.recordings if judged.fault_delay_s is not None)

    @property
    def alarm_percent(self) -> float:
        """Share of normal messages with an alarm (%)."""
        alarms = sum(len(judged.alarms) for judged in self.recordings)
        return 100 * alarms / max(1, sum(judged.messages for judged in self.recordings))

    def headline(self) -> str:
        """Alarm events per hour and share of messages with an alarm, in one line."""
        rate, minutes = self.alarms, self.exposure_s / _MINUTE
        events = f"{rate.events} false alarm event{'' if rate.events == 1 else 's'}"
        exposed = f"{minutes:.1f} min of normal flight"
        return f"{events} in {exposed}: {rate_text(rate)} per hour; {self.alarm_percent:.2g} % of messages"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "exposure_s": self.exposure_s, "alarms_per_hour": asdict(self.alarms),
            "flips": {name: asdict(rate) for name, rate in self.flips.items()}, "faults": asdict(self.faults),
            "delays_s": self.delays_s,
            "recordings": [asdict(judged) | {"events": judged.events} for judged in self.recordings],
        }  # fmt: skip


def rate_text(rate: EventRate) -> str:
    """Events per hour with interval; three digits, as rates in minutes of flight span decades."""
    if rate.per_hour is None or rate.low is None or rate.high is None:
        return "not counted"
    found = (rate.per_hour, rate.low, rate.high)
    value, low, high = (f"{one:,.0f}" if one >= 1000.0 else f"{one:.3g}" for one in found)
    return f"{value} [{low}, {high}]"


def delay_text(judged: Judged) -> str:
    """Delay of the first alarm after the known fault."""
    if not judged.has_fault:
        return ""
    return "no alarm" if judged.fault_delay_s is None else f"{judged.fault_delay_s:.2f} s"
