"""`mavfi firmware`, and the options of `mavfi fly` for register faults in a firmware."""

import pytest

from mavfi.cli.commands import run
from mavfi.errors import BadInputError
from mavfi.extras.firmware import build
from mavfi.extras.firmware.cli import RegisterFaultOptions
from mavfi.mission import MissionSpec


def register_fault(text, registers, seed):
    values = {"register_fault": text, "registers": registers, "register_seed": seed}
    return RegisterFaultOptions.chosen(MissionSpec(), values)[0]


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("octomap@10", None, None), "allowed: firmware@SECONDS"),
        (("firmware@x", None, None), "e.g. firmware@10"),
        (("firmware@1", "mmx", None), "--registers"),
        (("firmware@1", None, -1), "--register-seed"),
        ((None, "fp", None), "with --register-fault only"),
        ((None, None, 3), "with --register-fault only"),
    ],
)
def test_bad_options_are_refused(options, complaint):
    with pytest.raises(BadInputError, match=complaint):
        register_fault(*options)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["fly", "--register-fault", "firmware@1", "--fault", "null"], "allowed: without --fault"),
        (
            ["fly", "--register-fault", "firmware@1", "--world", "airsim://127.0.0.1:1"],
            "allowed: without --fault, --html",
        ),
        (["fly", "--flight-controller", "betaflight", "--world", "airsim://127.0.0.1:1"], "that of the server flies"),
        (["firmware", "setup", "--betaflight", "/nonexistent"], "contains no betaflight_"),
        (["firmware", "setup", "--betaflight", "/", "--build"], "allowed: one of them"),
        (["fly", "--register-fault", "firmware@1"], "flight controller cascade: has no registers of its own"),
    ],
)
def test_bad_input_is_one_line(arguments, complaint, capsys):
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert len(error.strip().splitlines()) == 1


def test_a_missing_firmware_is_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    build.installed.cache_clear()
    assert run(["firmware", "setup"]) == 2
    assert "no Betaflight firmware on this machine" in capsys.readouterr().err
