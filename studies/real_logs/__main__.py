"""Judge recorded flights of real and simulated vehicles, and write docs/results/real-logs.md.

    python -m studies.real_logs [FOLDER]        # without: from the stored rows

The folder holds logs of RflyMAD (`rflymad_*.ulg`), of EuRoC (`euroc_*.csv`) and of ALFA (`carbonZ_*.csv`, tables with a
row each 0.1 s and a column `is_boundary` that is 1 when the fault begins); they are not part of this project.
"""

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mavfi.analysis.table import Table
from mavfi.errors import BadInputError
from mavfi.extras.logs.detectors import is_fitted, uses_rules
from mavfi.extras.logs.recording import LogRecording, read_recording
from mavfi.extras.logs.selection import Wanted, select
from mavfi.extras.logs.watch import BIT_CLASSES, JudgedLog, LogRates, LogWatch, rate_text
from mavfi.report.text import ABSENT, rate
from tools import results
from tools.markers import ROOT

PAGE = "real-logs"
FLIPS = 300
SETTINGS = [
    *((kind, profile) for kind in ("gaussian", "autoencoder") for profile in ("tuned", "paper")),
    ("limits", "tuned"),
    ("recommended", "tuned"),
]
NORMAL_FLIGHT = "no_failure"
"""Part of the names of flights without a fault, in ALFA."""


class LogSet(NamedTuple):
    """Recordings of one source.

    Attributes:
        pattern: Their file names.
        fault: Number that tells of the known fault; "" = none.
        kinds: What fields are that the format does not define, see `parse_kinds`.
        text: What they are, and how they are used.
    """

    pattern: str
    fault: str
    kinds: dict[str, str]
    text: str


SETS = {
    "RflyMAD": LogSet(
        "rflymad_*.ulg",
        "rfly_ctrl_lxl:mode",
        {},
        "PX4 in simulation, motor fault at a known time: trained on the part before the fault of the other flights, "
        "judged on the part before the fault of each; then the fault",
    ),
    "EuRoC": LogSet(
        "euroc_*.csv", "", {}, "ground truth of indoor flights, 200 Hz: trained on the other flights, judged on each"
    ),
    "ALFA": LogSet(
        "carbonZ_*.csv",
        "row:is_boundary",
        dict.fromkeys(("heading", "pitch", "roll", "yaw"), "deg"),
        "real flights of a fixed-wing aircraft (Keipour, Mousaei and Scherer, IJRR 40, 2021), faults of engine and "
        "control surfaces at known times; 8 fields, resampled to 10 Hz as in github.com/gotham29/htm-state: trained on "
        "the flights without a fault, judged on all others; its angles are declared (`--kinds`)",
    ),
}

HEADINGS = (
    "logs",
    "detector",
    "exposure",
    "false alarm events",
    "per hour [95 %]",
    "messages with an alarm",
    *(f"flips detected, {bits} (%)" for bits in BIT_CLASSES),
    "faults with an alarm (%)",
    "delays (s)",
)
FIELD_HEADINGS = ("logs", "field", *(f"flips detected, {bits} (%)" for bits in BIT_CLASSES))
TEXT = (
    "Flights that mavfi neither flew nor simulated. Flipped signs and exponents of large numbers are found, a flipped "
    "mantissa hardly ever, the sign of a number near 0 never: it stays small. The detectors look for single values "
    "that jump: they find a motor that stops, and **few or none of the faults of a fixed-wing aircraft's control "
    "surfaces and engine**, which change the motion slowly. A field that jumps in the training blinds them to smaller "
    "jumps: heading and yaw of ALFA were interpolated across north. Exposure is minutes, about an hour for ALFA: a row "
    "without any alarm excludes only rates above the upper bound. How: [logs](../how-to/logs.md)."
)
NOTES = (
    "alarms within one second count as one event; the file also has the share of messages with an alarm, since a "
    "detector that raises alarms all the time has few events",
    f"{FLIPS} bits per recording (ALFA: {FLIPS // 10}), equally many in sign, exponent and mantissa of floating-point "
    "fields, each alone; detected: an alarm on the message, or on the next one of its topic, that the recording itself "
    "does not have",
    "recommended: its rules 1 and 3, where the shipped mappings fit",
    "intervals: Poisson (exact) and Wilson, 95 %; flips in one recording are not independent flights",
)
EXCERPT = results.Excerpt(
    "logs",
    lambda cells: cells["detector"].endswith("tuned"),
    ("logs", "detector", "exposure", "false alarm events", *HEADINGS[6:10]),
)
"""The detectors in profile `tuned`: those of the paper, and the project's."""
FILES = {
    "logs": "Alarms and detected flips, by set of logs and detector",
    "fields": "Detected flips by field, detector gaussian in profile tuned",
}
"""Titles of the tables, by file."""


def judge_set(recordings: Sequence[LogRecording], kinds: dict[str, str], kind: str, profile: str) -> list[JudgedLog]:
    """Each recording judged by a detector trained on all others, or on those without a fault if there are any."""
    wanted = Wanted(kinds=kinds)
    if not is_fitted(kind):
        wanted = Wanted(mapping="", only_mapped=uses_rules(kind))
    normal = [recording for recording in recordings if NORMAL_FLIGHT in recording.name]
    if normal:
        rest = [recording for recording in recordings if recording not in normal]
        log_watch = LogWatch(kind, profile, select(normal, rest, wanted), normal)
        return [log_watch.judge(recording, FLIPS // 10, seed) for seed, recording in enumerate(rest)]
    judged_logs = []
    for seed, recording in enumerate(recordings):
        others = [other.normal for other in recordings if other is not recording]
        log_watch = LogWatch(kind, profile, select(others, [recording], wanted), others)
        judged_logs.append(log_watch.judge(recording, FLIPS, seed))
    return judged_logs


def row(name: str, setting: tuple[str, str], judged: Sequence[JudgedLog]) -> tuple[str, ...]:
    """The row of a detector on a set of logs."""
    rates = LogRates(judged)
    delays = f"{len(rates.delays_s)} of {rates.faults.n}"
    if len(rates.delays_s) <= 4:
        delays = ", ".join(f"{delay:.2f}" for delay in rates.delays_s) or ABSENT
    return (
        name,
        ", ".join(setting),
        f"{rates.exposure_s / 60:.1f} min",
        str(rates.alarms.events),
        rate_text(rates.alarms),
        f"{rates.alarm_percent:.2g} %",
        *(rate(rates.flips.get(bits)) for bits in BIT_CLASSES),
        rate(rates.faults),
        delays,
    )


def field_rows(name: str, judged: Sequence[JudgedLog]) -> list[tuple[str, ...]]:
    """Detected flips of each field."""
    rows = []
    for field, rates in LogRates(judged).flips_by_field.items():
        cells = []
        for bits in BIT_CLASSES:
            cells.append(rate(rates.get(bits)))
        rows.append((name, field.replace(":", " "), *cells))
    return sorted(rows)


def judged_tables(folder: Path) -> dict[str, Table]:
    """Judge the recordings in a folder."""
    rows: list[tuple[str, ...]] = []
    rows_of_fields: list[tuple[str, ...]] = []
    for name, log_set in SETS.items():
        recordings = [read_recording(path, log_set.fault) for path in sorted(folder.glob(log_set.pattern))]
        if not recordings:
            raise SystemExit(f"{folder}: no {log_set.pattern}")
        label = f"{name}, {len(recordings)} logs"
        for setting in SETTINGS:
            try:
                judged = judge_set(recordings, log_set.kinds, *setting)
            except BadInputError:  # no shipped mapping fits
                if not uses_rules(setting[0]):
                    raise
                continue
            rows.append(row(label, setting, judged))
            if setting == SETTINGS[0]:
                rows_of_fields += field_rows(name, judged)
    return {
        "logs": Table.of_text(FILES["logs"], HEADINGS, rows, NOTES),
        "fields": Table.of_text(FILES["fields"], FIELD_HEADINGS, rows_of_fields, ()),
    }


def stored_tables() -> dict[str, Table]:
    """The published tables."""
    tables = {}
    for name, title in FILES.items():
        with (results.TABLES / PAGE / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            headings, *rows = csv.reader(file)
        tables[name] = Table.of_text(title, headings, [tuple(cells) for cells in rows], NOTES)
    return tables


def main(arguments: Sequence[str]) -> None:
    """Write the page."""
    tables = stored_tables()
    if arguments:
        tables = judged_tables(Path(arguments[0]))
    about = [f"{name}: {log_set.text}" for name, log_set in SETS.items()]
    title = "Detectors on recorded flights"
    page = results.write(PAGE, title, TEXT, tables, [EXCERPT], about, command="python -m studies.real_logs")
    print(f"wrote {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main(sys.argv[1:])
