"""`mavfi fly --fault instruction:...`: what its record holds, and what is refused."""

import json
import re

import pytest

from mavfi.cli import run
from mavfi.faults.fault import fault_from_json
from mavfi.levels.level import text_of
from mavfi.states import INJECTABLE

pytestmark = pytest.mark.slow

MISSION = ["fly", "--environment", "sparse", "--seed", "7"]


@pytest.fixture(scope="module")
def flown():
    """What the command of the manual prints."""
    with pytest.MonkeyPatch.context() as patch:
        lines = []
        patch.setattr("mavfi.cli.fly.write_json", lambda data: lines.append(json.dumps(data, allow_nan=False)))
        assert run([*MISSION, "--fault", "instruction:octomap", "--fault-seed", "3", "--json"]) == 0
    return json.loads(lines[0])


def test_the_record_names_the_instruction_and_its_line(flown):
    (record,) = flown["injections"]
    details = record["details"]
    assert record["activated"] is True
    assert (record["level"], record["site"]) == ("instruction", f"octomap.{details['function']}")
    assert details["function"] in INJECTABLE["octomap"]
    assert record["file"].startswith("mavfi/") and record["file"].endswith(".py") and record["line"] > 0
    assert details["opcode"].isalpha() and details["type"]
    assert details["value_class"] in ("floating_point", "integer", "address", "control")
    assert re.fullmatch("[0-9a-f]{64}", details["ir_sha256"])
    assert record["before"] != record["after"]
    assert record["bit"] in range(details["width"]) and details["bits"] == [record["bit"]]
    assert details["replayable"] is True
    fault = flown["fault"]
    assert (fault["kernel"], fault["entry"]) == ("octomap", details["function"])
    assert all(fault[key] == details[key] for key in ("ir_sha256", "index", "call", "bits", "value_class"))


def test_the_text_of_the_drawn_fault_flies_it_again(capsys, flown):
    text = text_of(fault_from_json(flown["fault"]))
    assert run([*MISSION, "--fault", text, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["digest"] == flown["digest"] and again["kernel"] == flown["kernel"]
    assert again["injections"] == flown["injections"]
    assert run([*MISSION, "--fault", re.sub("ir=.{8}", "ir=00000000", text)]) != 0
    assert "drawn for IR 00000000" in capsys.readouterr().err


def test_the_effects_on_kernel_and_mission_are_reported(flown):
    assert flown["kernel"]["effect"] in ("masked", "sdc", "crash", "hang", "exception")
    assert flown["golden"]["status"] == "success"
    if flown["kernel"]["effect"] == "masked":
        assert flown["digest"] == flown["golden"]["digest"]
