"""The runs of a ledger as rows that analyses select from."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

from mavfi.campaign.plan import FI, GOLDEN, NULL, RECOVERY, RunSpec
from mavfi.campaign.store import Store
from mavfi.campaign.worker import AFTERMATH, INSTANT, End
from mavfi.faults.strata import bit_class
from mavfi.outcomes import FlightEnd, Outcome, classify
from mavfi.states import MONITORED_SETS, STATES

_Row = TypeVar("_Row")

ALL_BITS = "all_bits"
"""Population of faults in instructions: their bits are drawn uniformly, so no stratum of them is apart."""


@dataclass(frozen=True, slots=True)
class Row:
    """One run that is done.

    Attributes:
        spec: What was planned.
        record: What was recorded.
        twin: Record of the golden run with the same detector; None for golden runs.
        golden: Record of the golden run without a detector, for flight times.
    """

    spec: RunSpec
    record: dict[str, Any]
    twin: dict[str, Any] | None
    golden: dict[str, Any] | None

    @property
    def world(self) -> tuple[str, int]:
        """Environment and seed."""
        return self.spec.environment, self.spec.seed

    @property
    def pair(self) -> tuple[str, str, int]:
        """Environment, target and number of the fault: the same in `fi` and every `dr_<arm>`."""
        return self.spec.environment, self.spec.target, self.spec.index

    @property
    def judged(self) -> bool:
        """Whether it is known how the run ended; unknown ones are counted apart."""
        return bool(self.record["end"] != End.UNKNOWN)

    @property
    def success(self) -> bool:
        """Whether the mission succeeded; a run that died did not."""
        return bool(self.record.get("success", False))

    @property
    def status(self) -> str:
        """Mission status, or "due" or "unknown"."""
        return str(self.record.get("status", self.record["end"]))

    @property
    def stratum(self) -> str:
        """Bit stratum of the draw."""
        return "" if self.spec.fault is None else self.spec.fault.stratum

    @property
    def population(self) -> str:
        """Which faults one rate is given of: the bit stratum, or `ALL_BITS` of a fault in an instruction."""
        return self.stratum if self.instruction is None else ALL_BITS

    @property
    def success_if_ended(self) -> bool:
        """The same where the mission ends with the death of a kernel, instead of a restart of its node."""
        return self.success and bool(self.record.get("due_end", {}).get("success", True))

    @property
    def weight(self) -> float:
        """Weight of the draw in the whole word."""
        return 1.0 if self.spec.fault is None else self.spec.fault.weight

    @property
    def state(self) -> str:
        """State of the fault's site."""
        return "" if self.spec.fault is None else self.spec.fault.site.state

    @property
    def field(self) -> str:
        """Field of the fault's site, with its state."""
        return "" if self.spec.fault is None else f"{self.state}.{self.spec.fault.site.field}"

    @property
    def stage(self) -> str:
        """Stage of the fault's site."""
        return "" if self.spec.fault is None else self.spec.fault.stage

    @property
    def bits(self) -> str:
        """Class of the flipped bit."""
        fault = self.spec.fault
        if fault is None or fault.bit is None:
            return ""
        if fault.instruction is not None:
            return fault.stratum
        return bit_class(STATES[fault.site.state].find(fault.site.field), fault.bit)

    @property
    def instruction(self) -> dict[str, Any] | None:
        """The planned `InstructionFault` as plain data; None for other faults."""
        return None if self.spec.fault is None else self.spec.fault.instruction

    @property
    def site_fate(self) -> str:
        """Where the fault went: "hit"; "no_site" in the golden flight; "not_hit": none in the injected flight."""
        if self.spec.fault is None or not self.spec.fault.has_site:
            return "no_site"
        hit = any(injection["hit"] for injection in self.record.get("injections", ()))
        return "hit" if hit or self.record["end"] != End.FLOWN else "not_hit"

    @property
    def inflation(self) -> float | None:
        """Flight time / that of the golden run - 1, where both succeed."""
        return self._relative("flight_time_s")

    @property
    def energy_inflation(self) -> float | None:
        """Energy / that of the golden run - 1, where both succeed."""
        return self._relative("energy_j")

    @property
    def golden_success(self) -> bool | None:
        """Whether the golden run of the same world succeeds; None where that is not known."""
        if self.golden is None or self.golden["end"] == End.UNKNOWN:
            return None
        return bool(self.golden.get("success", False))

    @property
    def alarmed(self) -> bool:
        """Whether an alarm was raised on the publication that was struck: of its state, at the injection's instant."""
        instants = self._struck()
        return any(
            alarm["state"] == self.state and abs(alarm["time_s"] - time_s) < INSTANT
            for alarm in self.record.get("alarms", ())
            for time_s in instants
        )

    @property
    def consequence_alarmed(self) -> bool:
        """Whether, within `AFTERMATH` of the injection, there is an alarm that the golden twin of the arm has not."""
        instants = self._struck()
        twins = () if self.twin is None else self.twin.get("alarms", ())
        known = {(alarm["state"], round(1e6 * alarm["time_s"])) for alarm in twins}
        return any(
            -INSTANT < alarm["time_s"] - time_s <= AFTERMATH
            and (alarm["state"], round(1e6 * alarm["time_s"])) not in known
            for alarm in self.record.get("alarms", ())
            for time_s in instants
        )

    def _struck(self) -> list[float]:
        return [injection["time_s"] for injection in self.record.get("injections", ()) if injection["hit"]]

    def _relative(self, key: str) -> float | None:
        if not self.success or self.golden is None or not self.golden.get("success"):
            return None
        return float(self.record[key] / self.golden[key] - 1)

    def watched(self, monitored_set: str) -> bool:
        """Whether detectors watch the field that was struck."""
        fault = self.spec.fault
        return fault is not None and (fault.site.state, fault.site.field) in MONITORED_SETS[monitored_set]

    @property
    def outcome(self) -> Outcome:
        """What the fault did; `unknown` where the records do not allow a verdict."""
        try:
            return classify(None if self.twin is None else _end(self.twin), _end(self.record))
        except (KeyError, TypeError, ValueError):
            return Outcome.UNKNOWN


def _end(record: dict[str, Any]) -> FlightEnd:
    return FlightEnd(record.get("digest"), record["end"] == End.DUE)


def read_rows(store: Store) -> list[Row]:
    """All runs of a ledger that are done, in the order of the plan."""
    runs = [(run.spec, run.record) for run in store.runs(done=True) if run.record is not None]
    golden = {(s.setting, s.environment, s.seed): record for s, record in runs if s.fault is None}
    return [
        Row(
            spec,
            record,
            None if spec.fault is None else golden.get((spec.golden_setting, spec.environment, spec.seed)),
            golden.get((_times_setting(spec), spec.environment, spec.seed)),
        )
        for spec, record in runs
    ]


def _times_setting(spec: RunSpec) -> str:
    """Setting of the golden run whose flight time counts: without a detector, with the same planner."""
    return GOLDEN if spec.detector else spec.golden_setting


def settings_of(rows: Iterable[Row]) -> list[str]:
    """Settings that fly faults, `fi` first; golden and null runs are not among them."""
    found = dict.fromkeys(row.spec.setting for row in rows if is_injected(row))
    return sorted(found, key=lambda setting: setting != FI)


def is_injected(row: Row) -> bool:
    """Whether the row flew with a fault that changes something."""
    return row.spec.setting == FI or row.spec.setting.startswith(f"{RECOVERY}_")


def is_null(row: Row) -> bool:
    """Whether the row flew with an empty mask."""
    return row.spec.setting == NULL or row.spec.setting.startswith(f"{NULL}_")


def is_golden(row: Row) -> bool:
    """Whether the row flew without a fault."""
    return row.spec.fault is None


def group(rows: Iterable[_Row], key: Callable[[_Row], Any]) -> dict[Any, list[_Row]]:
    """Rows of any kind by the value of a key, in the order in which the values first appear."""
    groups: dict[Any, list[_Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups
