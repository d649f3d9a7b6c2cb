"""Judge recorded flights of real and simulated vehicles, and write docs/results/real-logs.md.

    make results NAME=real-logs LOGS=FOLDER

The folder holds logs of PX4 (`px4_sample.ulg`), of RflyMAD (`rflymad_*.ulg`) and of EuRoC (`euroc_*.csv`); they are not
part of this project.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from mavfi.analysis.table import Table
from mavfi.extras.logs.recording import LogRecording, read_recording
from mavfi.extras.logs.selection import select
from mavfi.extras.logs.watch import BIT_CLASSES, JudgedLog, LogRates, LogWatch, judge_rest, rate_text
from mavfi.report.text import ABSENT, rate
from tools import results
from tools.markers import ROOT

PAGE = "real-logs"
FAULT = "rfly_ctrl_lxl:mode"
FLIPS = 300
SETTINGS = [(kind, profile) for kind in ("gaussian", "autoencoder") for profile in ("tuned", "paper")]
SETS = {
    "PX4": ("px4_sample.ulg", "one multicopter flight: trained on its first half, judged on the second"),
    "RflyMAD": (
        "rflymad_*.ulg",
        "motor fault at a known time: trained on the part before the fault of the other "
        "flights, judged on the part before the fault of each; then the fault",
    ),
    "EuRoC": ("euroc_*.csv", "ground truth of indoor flights, 200 Hz: trained on the other flights, judged on each"),
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
TEXT = (
    "On flights that mavfi neither flew nor simulated, GAD and AAD find every motor fault within 0.2 s, a third to "
    "four fifths of flipped signs and exponents, and a flipped mantissa hardly ever. **The exposure is minutes, not "
    "hours**: a row without any alarm excludes only rates above the upper bound, and few flights of few vehicles do "
    "not represent others. How: [logs](../logs.md)."
)
NOTES = (
    "alarms within one second count as one event; a detector that raises alarms all the time has few events, so the "
    "share of messages with an alarm stands next to them",
    f"{FLIPS} bits per recording, equally many in sign, exponent and mantissa of floating-point fields, each alone; "
    "detected: an alarm on the message, or on the next one of its topic, that the recording itself does not have; a "
    "value near 0 stays small, whichever bit flips",
    "intervals: Poisson (exact) and Wilson, 95 %; flips in one recording are not independent flights",
)


def judge_apart(recordings: Sequence[LogRecording], kind: str, profile: str) -> list[JudgedLog]:
    """Each recording judged by a detector trained on all others; a single one by its own first half."""
    if len(recordings) == 1:
        return [judge_rest(kind, profile, recordings[0], 0.5, flips=FLIPS)[1]]
    judged_logs = []
    for recording in recordings:
        others = [other.normal for other in recordings if other is not recording]
        judged_logs.append(LogWatch(kind, profile, select(others, [recording]), others).judge(recording, FLIPS))
    return judged_logs


def rows(name: str, recordings: Sequence[LogRecording]) -> list[tuple[str, ...]]:
    """One row per detector and profile."""
    rows_of_settings = []
    for kind, profile in SETTINGS:
        rates = LogRates(judge_apart(recordings, kind, profile))
        cells = (
            name,
            f"{kind}, {profile}",
            f"{rates.exposure_s / 60:.1f} min",
            str(rates.alarms.events),
            rate_text(rates.alarms),
            f"{rates.alarm_percent:.2g} %",
            *(rate(rates.flips.get(bits)) for bits in BIT_CLASSES),
            rate(rates.faults),
            ", ".join(f"{delay:.2f}" for delay in rates.delays_s) or ABSENT,
        )
        rows_of_settings.append(cells)
    return rows_of_settings


def write_page(folder: Path) -> Path:
    """Judge the recordings, and write the page."""
    all_rows: list[tuple[str, ...]] = []
    for name, (pattern, _) in SETS.items():
        fault = ""
        if name == "RflyMAD":
            fault = FAULT
        recordings = [read_recording(path, fault) for path in sorted(folder.glob(pattern))]
        if not recordings:
            raise SystemExit(f"{folder}: no {pattern}")
        logs = "1 log"
        if len(recordings) > 1:
            logs = f"{len(recordings)} logs"
        all_rows += rows(f"{name}, {logs}", recordings)
    full = Table.of_text("Alarms and detected flips, by set of logs and detector", HEADINGS, all_rows, NOTES)
    about = [f"{name}: {text}" for name, (_, text) in SETS.items()]
    return results.write(PAGE, "Detectors on recorded flights", TEXT, {"logs": full}, [results.Excerpt("logs")], about)


def main() -> None:
    """Write the page."""
    folder = os.environ.get("LOGS", "")
    if not Path(folder).is_dir():
        raise SystemExit(f"LOGS: {folder or 'not given'}; allowed: LOGS=folder of recorded flights")
    sys.stdout.write(f"wrote {write_page(Path(folder)).relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()
