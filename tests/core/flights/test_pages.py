"""Every command of the pages on other people's vehicles, logs and kernels, as it stands there, in an empty folder."""

import importlib.util
import re
import shlex
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from mavfi.campaign.begin import check_names
from mavfi.campaign.config import load_campaign
from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.extras.firmware import build
from tests.core.architecture.source import ROOT
from tests.pages import DOCS, arguments, commands, serving

PAGES = tuple(f"how-to/{name}.md" for name in ("airsim", "firmware", "hardening", "logs"))
ALL = [(page, command) for page in PAGES for command in commands(page)]
SAYS = {
    "airsim run --environment sparse": r"golden: ended, .* 18 calls, digest [0-9a-f]{16}\n",
    "moveToPosition.x:bit=51": r"^effect: deviates\n.* 8\.0 → 12\.0\n",
    "moveByVelocityZ.vx:bit=62@15": r"^effect: deviates\n(.*\n)*alarms: [1-9]\d*, first at 15\.000 s",
    "run examples/airsim/box.yaml": r"",
    "--settings examples/airsim": r"m apart, the leader sees \['Wing'\]",
    "report out/airsim_box": r"What one bit in a call does to a program",
    "--seed 7 --flight-controller betaflight": r"Reached the goal",
    "--register-seed 3": r"fault +\w+, bit \d+, at 10\.",
    "--register-seed 10012": r"Touched an obstacle or the ground(.*\n)*.*data corruption \(sdc\): another flight",
    "--protection ten_percent --fault": r"[Dd]etected",
    "--save flight.npz": r"fault +planning\.waypoint\.x, bit 62(.*\n)*wrote flight\.npz",
    "--save normal": r"Reached the goal(.*\n)*wrote normal\d\.npz",
    "mavfi export": r"\.(mcap|ulg|tlog): [\d,]+ messages, .* success",
    "mavfi watch": "",  # what the page shows
}
"""What a command must say, by a part of it."""
PLANNED = ("campaign run firmware", "campaign run hardening")
"""Campaigns of many minutes: planned, not flown."""
ELSEWHERE = {
    "airsim serve --save": "tests/extras/airsim/test_serve.py",
    "firmware setup": "tests/extras/firmware/test_cli.py",
    "report out/firmware-campaign": "tests/extras/firmware/test_cli.py",
    "mavfi harden out/hardening": "tests/extras/hardening/test_cli.py",
    "campaign run plan.proof.yaml": "tests/extras/hardening/test_cli.py",
    "--protection plan.yaml": "tests/extras/hardening/test_protected.py",
}
"""Commands that need the ledger of such a campaign, a client of some kind, or an absent one: the tests of the same on a
smaller scale."""
LONG = ("airsim_box", "--flight-controller", "ten_percent --fault")
NEEDS = {"airsim": "cosysairsim", "mavlink": "pymavlink", ".tlog": "pymavlink", ".ulg": "pyulog", "--live": "foxglove"}
"""Packages that a command needs, by a part of it."""
ASK = "import cosysairsim as airsim; print(airsim.MultirotorClient().getMultirotorState().landed_state)"


def part_of(parts, command):
    """The first part that is in a command; None if there is none."""
    return next((part for part in parts if part in command), None)


def heartbeat(port):
    """A vehicle's heartbeat, or any message of a flight, arrives at a ground station's port."""
    from pymavlink import mavutil

    station = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
    try:
        assert station.recv_match(type="HEARTBEAT", blocking=True, timeout=60) is not None
    finally:
        station.close()


def ask_airsim():
    done = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "0\n", done.stderr


def fly_there():
    """The page's next command."""
    (command,) = (command for command in commands("how-to/airsim.md") if "--world" in command)
    done = subprocess.run(arguments(command, {}), capture_output=True, text=True, timeout=120, check=False)
    assert "Reached the goal" in done.stdout, done.stderr


SERVERS = {
    "airsim serve --environment dense": (r"AirSim API on 127\.0\.0\.1:41451", ask_airsim),
    "--in-flight": (r"AirSim API on 127\.0\.0\.1:41451", fly_there),
    "--live": (r"ws://127\.0\.0\.1:8765", lambda: socket.create_connection(("127.0.0.1", 8765), 10).close()),
    "--mavlink 14550": (r"", lambda: heartbeat(14_550)),
}
"""Commands that run until Ctrl-C: what they say when they are ready, and what makes use of them."""


def test_the_pages_have_no_command_that_is_not_known_here():
    unknown = [
        command for _, command in ALL if part_of([*SAYS, *SERVERS, *PLANNED, *ELSEWHERE, "--world"], command) is None
    ]
    assert unknown == []
    every = " ".join(command for _, command in ALL)
    assert [part for part in (*SAYS, *SERVERS, *PLANNED, *ELSEWHERE, *LONG) if part not in every] == []
    assert all((ROOT / path).exists() for path in ELSEWHERE.values())


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A folder for each page, empty but for the examples and configurations that the page names."""
    made = {page: tmp_path_factory.mktemp(Path(page).stem) for page in PAGES}
    for folder in made.values():
        for name in ("examples", "configs"):
            (folder / name).symlink_to(ROOT / name)
    return made


@pytest.fixture
def folder(request, folders, monkeypatch):
    """That of the command's page, as the working directory of a user who has allowed nothing."""
    monkeypatch.chdir(folders[request.node.callspec.params["page"]])
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS")
    return folders[request.node.callspec.params["page"]]


def need(command):
    """Skip a command whose client is absent."""
    for part, package in NEEDS.items():
        if part in command and importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    if "betaflight" in command:
        try:
            build.installed()
        except BadInputError as error:
            pytest.skip(str(error))


def of(keys):
    """Commands with one of the parts as arguments of a test, in the order of the pages."""
    known_commands = [(page, command) for page, command in ALL if part_of(keys, command) is not None]
    return pytest.mark.parametrize(
        ("page", "command"),
        [
            pytest.param(*page_command, marks=[pytest.mark.long] * (part_of(LONG, page_command[1]) is not None))
            for page_command in known_commands
        ],
    )


@of(SAYS)
def test_a_command_says_what_it_should(page, command, folder, capsys):
    need(command)
    assert run(shlex.split(command)[1:]) == 0, capsys.readouterr().err
    printed = capsys.readouterr().out
    assert re.search(SAYS[part_of(SAYS, command)], printed)
    if "mavfi watch" in command:
        text = (DOCS / page).read_text(encoding="utf-8")
        shown = re.findall(r"^    (\d+ false .*|flight.ulg, .*|(?:no )?flip.*|known .*\n)", text, re.M)
        assert len(shown) == 7 and "\n".join(shown) in printed


@of(PLANNED)
def test_a_campaign_is_planned(page, command, folder):
    words = shlex.split(command)
    campaign = load_campaign(words[words.index("run") + 1])
    check_names(campaign, page)


@of(SERVERS)
def test_a_server_is_used_and_ended(page, command, folder):
    need(command)
    ready, use = SERVERS[part_of(SERVERS, command)]
    with serving(command, ready, folder):
        use()
