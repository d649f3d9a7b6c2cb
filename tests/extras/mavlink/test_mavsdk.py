"""Unmodified programs for MAVSDK fly the vehicle, in wall time, each in a network namespace of its own.

MAVSDK's server listens on all addresses; in a namespace nobody else can reach it.  Needs mavsdk 3.17
(`make clients`); the examples need `MAVSDK_EXAMPLES`, the folder `examples` of github.com/mavlink/MAVSDK-Python.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.clients import python_of
from tests.core.architecture.source import ROOT
from tests.pages import files

pytest.importorskip("pymavlink", reason="pymavlink (extra mavlink) is not installed")

PYTHON, EXAMPLES = python_of("mavsdk"), os.environ.get("MAVSDK_EXAMPLES", "")
NAMESPACE = ["unshare", "-rn"]
SCRIPT = """
ip link set lo up
"$1" -m mavfi mavlink serve --environment farm --seed "$6" --seconds "$4" --json > "$5" &
sleep 6
timeout "$4" "$2" -u "$3"
code=$?
wait
exit $code
"""
FLYING = {  # seconds, and a line that the program prints at its end
    "takeoff_and_land": (60, "-- Landing"),
    "offboard_velocity_ned": (75, "-- Stopping offboard"),
    "offboard_velocity_body": (75, "-- Stopping offboard"),
    "offboard_position_ned": (90, "-- Stopping offboard"),
    "offboard_attitude": (60, "-- Stopping offboard"),
    "mission": (90, "Mission progress: 3/3"),
    "telemetry_takeoff_and_land": (75, "-- Landing"),
    "failure_injection": (75, "-- Disabling failure injection"),
    "offboard_position_velocity_ned": (75, "-- Stopping offboard"),
    "mission_raw": (30, "-- Done"),
    "geofence": (30, "Geofence uploaded!"),
    "all_params": (30, "MPC_XY_CRUISE: "),
    "firmware_version": (30, "Version: [flight_sw_major"),
    "goto": (100, "Staying connected"),
    "do_orbit": (110, "Do orbit at 10m height"),
}
SEEDS = {"offboard_velocity_body": 8}
"""Worlds other than 7, whose trees its circles touch."""
TARGET = (-15.1, -190.6)
"""North and east of the start (m), where `goto` flies: 47.397606, 8.543060."""

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(not PYTHON, reason="mavsdk 3.17 is not installed (make clients)"),
    pytest.mark.skipif(
        subprocess.run([*NAMESPACE, "true"], capture_output=True, check=False).returncode != 0,
        reason="network namespaces are not permitted",
    ),
]


def fly(program, seconds, last, folder, seed=7):
    """Run a program with a vehicle for some time (s); it must print a line.  Returns the vehicle's final state."""
    summary = folder / "server.json"
    words = [sys.executable, PYTHON, str(program), str(seconds), str(summary), str(seed)]
    done = subprocess.run(
        [*NAMESPACE, "sh", "-c", SCRIPT, "sh", *words],
        capture_output=True,
        text=True,
        timeout=seconds + 60,
        check=False,
    )
    assert last in done.stdout, done.stdout + done.stderr
    end = json.loads(summary.read_text())
    assert end["messages"] > 2 and not end["collided"]
    return end


@pytest.mark.long
@pytest.mark.skipif(not EXAMPLES, reason="MAVSDK_EXAMPLES is not set")
@pytest.mark.parametrize("name", FLYING)
def test_an_example_flies(name, tmp_path):
    end = fly(Path(EXAMPLES) / f"{name}.py", *FLYING[name], tmp_path, SEEDS.get(name, 7))
    if name == "goto":  # endless; stopped at the time limit
        assert end["position"][:2] == pytest.approx(TARGET, abs=1.0) and not end["landed"]
    if name == "do_orbit":
        assert end["mode"] in ("orbit", "land", "hold", "return")


def test_every_example_of_the_page_is_repeated():
    page = (ROOT / "docs" / "how-to" / "mavlink.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith(("| completed |", "| endless"))]
    named = {name for line in rows for name in re.findall(r"`(\w+)`", line)}
    assert len(rows) == 2 and named - set(FLYING) == {"telemetry_flight_mode"}  # which does not fly


def test_the_program_of_the_page_loses_a_motor(tmp_path):
    ((name, text),) = files("how-to/mavlink.md")
    program = tmp_path / name
    program.write_text(text, encoding="utf-8")
    fly(program, 40, "motor 1 off: at 0.0 m", tmp_path)
