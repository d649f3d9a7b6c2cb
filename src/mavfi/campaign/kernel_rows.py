"""Runs of a kernel campaign as rows: what was struck, what the kernel did then, and what became of the mission."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

from mavfi.campaign.flights import Row, read_rows
from mavfi.campaign.kernel_profiles import read_kernel_profiles
from mavfi.campaign.plan import FI
from mavfi.campaign.store import Store

DUE = ("crash", "hang", "exception")
"""Outcomes of a kernel that the system notices."""


@dataclass(frozen=True, slots=True)
class KernelRun:
    """One flight with a fault in an instruction.

    Attributes:
        kernel: Name, as in `mavfi.states.INJECTABLE`.
        function: Which of its functions.
        file: Source file, relative to the folder from which it was imported.
        line: Source line; 0 = not known.
        opcode: As in LLVM's language reference.
        value_class: "floating_point", "integer", "address" or "control".
        type: Type of the struck value, e.g. "double".
        bit: Bit that was flipped; None where the whole value was replaced.
        stratum: "sign", "exponent" or "mantissa" of a floating-point value, else "other".
        variable: Source variable; "" = not known.
        outcome: Of the kernel: "masked", "sdc", "crash", "hang", "exception" or "not_reached".
        detail: Name of the signal, or text of the exception.
        first_difference: First published field of the kernel that differed; None if none did.
        success: Whether the mission arrived; after a crash, hang or exception the kernel was started again.
        success_if_ended: The same where the mission ends with the kernel's crash, hang or exception.
        golden_success: Whether the golden twin arrived.
        same_flight: Whether the flight is bit for bit the golden twin's.
        status: How the mission ended.
        flight_time_s: Of this flight (s); with a crash, hang or exception, of the one with a restart.
        golden_flight_time_s: Of the golden twin (s).
        run_id: For `mavfi replay`.
        environment: Of the mission.
        seed: Of the mission.
        weight: Of the fault, where strata were drawn: rates are weighted means.
        replayable: Whether the same bytes come again: not if an address or a branch was struck in a process whose
            addresses were random.
    """

    kernel: str
    function: str
    file: str
    line: int
    opcode: str
    value_class: str
    type: str
    bit: int | None
    stratum: str
    variable: str
    outcome: str
    detail: str
    first_difference: dict[str, Any] | None
    success: bool
    success_if_ended: bool
    golden_success: bool
    same_flight: bool
    status: str
    flight_time_s: float
    golden_flight_time_s: float
    run_id: str
    environment: str
    seed: int
    weight: float = 1.0
    replayable: bool = True

    @property
    def due(self) -> bool:
        """Whether the kernel crashed, hung or raised."""
        return self.outcome in DUE

    @property
    def world(self) -> tuple[str, int]:
        """Environment and seed."""
        return self.environment, self.seed

    @property
    def inflation(self) -> float | None:
        """Flight time / that of the golden twin - 1, where both arrive."""
        if not (self.success and self.golden_success):
            return None
        return self.flight_time_s / self.golden_flight_time_s - 1


def read_kernel_runs(store: Store) -> list[KernelRun]:
    """All flights of a ledger that have a fault in an instruction, no detector, and are done, in the plan's order.

    Runs that ended for a reason of ours (`unknown`), and those whose golden twin did, are left out.
    """
    return [
        _kernel_run(row, row.record, row.twin)
        for row in read_rows(store)
        if row.instruction is not None and row.spec.setting == FI and "kernel_outcome" in row.record
        and row.twin is not None and "digest" in row.twin
    ]  # fmt: skip


def _kernel_run(row: Row, record: dict[str, Any], twin: dict[str, Any]) -> KernelRun:
    struck, outcome = record["injections"][0], record["kernel_outcome"]
    ended = record.get("due_end")
    success = bool(record["success"])
    return KernelRun(
        struck["kernel"], struck["function"], struck.get("file", ""), struck.get("line", 0), struck.get("opcode", ""),
        struck.get("value_class", ""), struck.get("type", ""), struck["bit"], struck["stratum"],
        struck.get("variable", ""), outcome["outcome"], outcome["detail"], outcome["first_difference"], success,
        success if ended is None else bool(ended["success"]), bool(twin["success"]),
        record["digest"] == twin["digest"], row.status, record["flight_time_s"], twin["flight_time_s"],
        row.spec.run_id, row.spec.environment, row.spec.seed, row.weight,
        bool(struck.get("replayable")),
    )  # fmt: skip


def read_line_counts(store: Store) -> dict[tuple[str, str, int], int]:
    """Dynamic instructions by kernel, source file and line, summed over all golden flights."""
    total: Counter[tuple[str, str, int]] = Counter()
    for kernel, profiles in read_kernel_profiles(store).items():
        for profile in profiles:
            for file, line, count in profile.lines:
                total[kernel, file, line] += count
    return dict(total)
