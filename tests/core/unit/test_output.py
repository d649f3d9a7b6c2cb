"""What plug-ins print never stands in what a command answers."""

import json
import os
import subprocess
import sys

from mavfi import output
from mavfi.cli import run
from mavfi.cli.console import answer
from mavfi.plugins import allow_typed, load_object

TALKATIVE = """
import os
from mavfi.pipeline.planners import RrtConnect
print("imported")

class Talkative:
    def __init__(self, config, seed):
        self.inner = RrtConnect(config, seed)
        self.random = self.inner.random
        print("built")

    def search(self, *arguments):
        os.write(1, b"as a library in C\\n")
        print("searching")
        return self.inner.search(*arguments)
"""
SHORT = ["--environment", "sparse", "--seed", "7", "--goal", "6", "0", "2"]


def test_stdout_of_a_flight_is_its_json_alone(tmp_path):
    (tmp_path / "talkative.py").write_text(TALKATIVE, encoding="utf-8")
    command = [sys.executable, "-m", "mavfi", "fly", *SHORT, "--planner", "talkative:Talkative", "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["status"]
    for printed in ("imported", "built", "searching", "as a library in C"):
        assert printed in done.stderr


def test_workers_and_later_output_are_apart_too_and_a_command_ends_as_it_began(tmp_path, capfd, monkeypatch):
    (tmp_path / "chatty.py").write_text("print('imported')\ndef make(): print('called')\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    allow_typed(["chatty:make"])
    before = sys.stdout
    with output.answering():
        make = load_object("thing", "chatty:make", "mavfi.no_such_group", {})
        make()
        child = os.fork()
        if not child:
            make()
            sys.stdout.flush()
            os._exit(0)
        os.waitpid(child, 0)
        answer("an answer")
    assert sys.stdout is before
    captured = capfd.readouterr()
    assert captured.out == "an answer\n" and captured.err.count("called") == 2
    make()  # a program of the user's own prints where it likes
    assert capfd.readouterr().out == "called\n"


def test_without_plug_ins_stdout_is_untouched(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip()
