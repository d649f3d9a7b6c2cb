"""Recorded flights in all formats, written without a simulation."""

import numpy as np
import pytest

from mavfi.extras.airsim.calls import RecordedCall
from mavfi.extras.logs.files import write_bag, write_csv, write_mcap
from mavfi.extras.logs.timeline import Message, tick_messages
from mavfi.extras.logs.tlog import write_tlog
from mavfi.extras.logs.ulog import write_ulog
from mavfi.mission import MissionStatus
from mavfi.record import COLUMNS, FlightLog, Injection


def make_log(seed, seconds=12.0, onset=None):
    """A flight on a Lissajous figure; from `onset` (s) on, the vehicle drops."""
    time = np.arange(0, seconds, 0.02)
    phase, slow = time + seed, 0.3 * time
    rows = np.zeros((len(time), 21))
    rows[:, 0] = time
    rows[:, 1], rows[:, 2], rows[:, 3] = 5 * np.sin(phase), 4 * np.cos(slow + seed), 3 + np.sin(0.5 * phase)
    rows[:, 4], rows[:, 5], rows[:, 6] = 5 * np.cos(phase), -1.2 * np.sin(slow + seed), 0.5 * np.cos(0.5 * phase)
    rows[:, 7], rows[:, 10], rows[:, 13] = np.cos(slow), np.sin(slow), 0.6
    rows[:, 14:17], rows[:, 17], rows[:, 18:21] = rows[:, 4:7], 0.6, rows[:, 1:4]
    injections = []
    if onset is not None:
        late = time >= onset
        rows[late, 3] -= 40 * (time[late] - onset)
        rows[late, 6] -= 40
        injections = [Injection("state", "control.command.vz", onset, 62, 0.5, -40.0, True)]
    return FlightLog(rows, MissionStatus.SUCCESS, injections=injections)


def messages(log) -> list[Message]:
    return [message for row in log.rows for message in tick_messages(row)]


def write_calls(log, path):
    """As if a program had asked for the vehicle's state at each control period."""
    calls = (
        RecordedCall.of(round(1e6 * row[0]), "state(return)", dict(zip(COLUMNS[1:], row[1:], strict=True)))
        for row in log.rows
    )
    path.write_text("".join(call.line() for call in calls), encoding="utf-8")


WRITERS = {
    "ulg": write_ulog,
    "tlog": write_tlog,
    "csv": write_csv,
    "jsonl": write_calls,
    "bag": lambda log, path: write_bag(messages(log), path),
    "mcap": lambda log, path: write_mcap(messages(log), path),
}


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """Function (format, name of flight) -> path of "a", "b" (normal) or "fault" (from 9 s on)."""
    folder, made = tmp_path_factory.mktemp("logs"), {}
    logs = {"a": (0.0, 12.0, None), "b": (0.7, 12.0, None), "fault": (0.3, 12.0, 9.0)}

    def path_of(ending, name):
        {"ulg": lambda: pytest.importorskip("pyulog"), "tlog": lambda: pytest.importorskip("pymavlink")}.get(
            ending, lambda: None
        )()
        path = folder / f"{name}.{ending}"
        if path not in made:
            made[path] = WRITERS[ending](make_log(*logs[name]), path)
        return path

    return path_of
