"""Folders of flights: none is left by a process that was killed, and none is taken from one that lives."""

import shutil
import subprocess
import sys
import tempfile

import pytest

from mavfi.errors import MachineError, MavfiError
from mavfi.extras.ros.lockstep.folder import LOG, new_folder

KILLED = """
import os, signal
from mavfi.extras.ros.lockstep.folder import new_folder
with new_folder() as folder:
    (folder / "log").mkdir()
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """The folders that exist."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return lambda: sorted(tmp_path.iterdir())


def test_the_folder_of_a_killed_process_is_removed_by_the_next_flight(folders):
    subprocess.run([sys.executable, "-c", KILLED], check=False)
    (left,) = folders()
    with new_folder() as folder:
        assert folders() == [folder] and folder != left
    assert folders() == []


def test_a_removal_that_is_cut_short_is_completed_by_the_next_flight(folders, monkeypatch):
    def cut_short(path, **_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt), new_folder() as cut:
        (cut / "a").touch()
        (cut / "messages" / "msg").mkdir(parents=True)
        patch.setattr(shutil, "rmtree", cut_short)
    assert cut.is_dir()
    with new_folder():
        assert not cut.exists()


def test_the_folder_of_a_flight_in_progress_is_left_alone(folders):
    with new_folder() as first, new_folder() as other:
        assert folders() == sorted([first, other])
    assert folders() == []


def test_the_logs_of_a_failed_flight_remain(folders):
    with pytest.raises(MavfiError, match=rf"it failed; logs: .*/mavfi-ros-.*/{LOG}$"), new_folder() as failed:
        raise MavfiError("it failed")
    with new_folder():
        assert failed in folders()
    for error in (KeyboardInterrupt, MachineError("it was killed")):
        with pytest.raises((KeyboardInterrupt, MachineError)), new_folder():
            raise error
    assert folders() == [failed]
