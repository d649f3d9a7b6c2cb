import errno
import json
import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from mavfi.campaign import run as run_module
from mavfi.cli import run
from tests.core.unit.campaign.fakes import HOST, TROUBLE

CAMPAIGN = """
name: tiny
environments: [sparse]
missions: {missions}
faults: 1
sampling: {{strata: {{sign_exponent: 1}}}}
null_runs: 1
"""
FAKE = f"{CAMPAIGN}host: {HOST}\n"


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("config") / "tiny.yaml"
    path.write_text(FAKE.format(missions=1))
    return path


@pytest.fixture(scope="module")
def flown(config, tmp_path_factory):
    directory = tmp_path_factory.mktemp("flown")
    assert run(["campaign", "run", str(config), "--out", str(directory), "--workers", "1"]) == 0
    return directory


@pytest.fixture(scope="module")
def really_flown(tmp_path_factory):
    """By the host `local`."""
    directory = tmp_path_factory.mktemp("really")
    (directory / "tiny.yaml").write_text(CAMPAIGN.format(missions=1))
    arguments = [str(directory / "tiny.yaml"), "--out", str(directory / "out"), "--workers", "1"]
    assert run(["campaign", "run", *arguments]) == 0
    return directory / "out"


def _json(capsys, *arguments):
    assert run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_status_counts_by_setting(capsys, flown):
    data = _json(capsys, "campaign", "status", str(flown))
    assert data["complete"] and data["done"] == data["total"] == 5
    assert data["settings"]["fi"] == {"planned": 3, "flown": 3, "succeeded": data["settings"]["fi"]["succeeded"]}
    assert run(["campaign", "status", str(flown)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("5 of 5 runs, complete") and "golden" in text


def test_a_larger_campaign_keeps_what_is_flown_and_is_compared_with_the_smaller_one(capsys, flown, tmp_path):
    grown = tmp_path / "grown"
    shutil.copytree(flown, grown)
    (tmp_path / "tiny.yaml").write_text(FAKE.format(missions=2).replace("faults: 1", "faults: 2"))
    command = ["campaign", "run", str(tmp_path / "tiny.yaml"), "--workers", "1", "--out"]
    assert run([*command, str(grown)]) == 2
    assert "choose another directory, or keep its runs with --extend" in capsys.readouterr().err
    assert run([*command, str(tmp_path / "typo"), "--extend"]) == 2
    assert "typo holds no campaign; allowed: the folder of one, or without --extend" in capsys.readouterr().err
    assert not (tmp_path / "typo").exists()
    assert run([*command, str(grown), "--extend"]) == 0
    capsys.readouterr()
    assert run(["compare", str(flown), str(grown)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("B flies as A: all 4 shared runs are equal bit for bit.")
    assert f"B: {grown}" in text and "4 runs have no partner" in text
    assert run(["compare", str(flown), str(grown), "--require", "A.lost - B.lost < 2 %"]) == 3
    verdict = capsys.readouterr().out.splitlines()[-1]
    assert verdict.startswith("not shown  A.lost - B.lost < 2 %: 0.0 % [") and verdict.endswith(", n = 3: n too small")
    assert run(["compare", str(flown), str(grown), "--require", "lost < 2 %"]) == 2
    assert "'lost < 2 %': is not about A and B" in capsys.readouterr().err
    data = _json(capsys, "compare", str(flown), str(grown))
    assert data["answer"]["same"] == data["answer"]["n_a"] == 3


def test_runs_that_are_no_flights_have_effects_in_place_of_success(capsys, tmp_path):
    (tmp_path / "programs.yaml").write_text(FAKE.format(missions=2).replace(":FakeHost", ":ProgramHost"))
    command = ["campaign", "run", str(tmp_path / "programs.yaml"), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert run(command) == 0
    printed = capsys.readouterr().out
    assert run(["campaign", "status", str(tmp_path / "out")]) == 0
    status = capsys.readouterr().out
    for text in (printed, status):
        assert "succe" not in text and max(map(len, text.splitlines()[:-1])) <= 80
        shares = [line.removeprefix("fi").split() for line in text.splitlines() if "%" in line]
        assert [effect for effect, *_ in shares] == ["masked", "SDC", "crash", "hang"]
    fi = _json(capsys, "campaign", "status", str(tmp_path / "out"))["settings"]["fi"]
    assert "succeeded" not in fi and fi["effects"]["sdc"]["n"] == fi["flown"] == 3
    assert fi["effects"]["sdc"]["successes"] == 3 and fi["effects"]["hang"]["high"] < 1


def test_a_requirement_that_is_not_shown_is_exit_code_3_and_no_part_of_the_campaign(capsys, config, flown, tmp_path):
    digest = _json(capsys, "campaign", "digest", str(flown))["digest"]
    path = tmp_path / "tiny.yaml"
    path.write_text(FAKE.format(missions=1) + "require: [success >= 1 %, success >= 99 %]\n")
    command = ["campaign", "run", str(path), "--out", str(flown), "--workers", "1"]
    assert run([*command, "--junit", str(tmp_path / "junit.xml")]) == 3
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith("holds      success >= 1 %: ") and "; without a fault 100.0 % [" in first
    assert second.endswith(": n too small")
    assert (tmp_path / "junit.xml").read_text().count("<testcase ") == 2
    assert _json(capsys, "campaign", "digest", str(flown))["digest"] == digest
    assert run(["campaign", "run", str(config), "--out", str(flown), "--workers", "1", "--require", "sdc > 1 %"]) == 0
    assert run(["campaign", "status", str(flown), "--require", "sdc < 1 %"]) == 3
    capsys.readouterr()
    assert run([*command, "--require", "cheap: sdc < 5 %"]) == 2
    assert "--require: 'cheap: sdc < 5 %': arm 'cheap': not known" in capsys.readouterr().err


def test_runs_that_could_not_be_judged_are_no_success(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(TROUBLE, "raises", True)
    path = tmp_path / "tiny.yaml"
    path.write_text(FAKE.format(missions=3).replace("faults: 1", "faults: 3"))  # one of them with the seed `BROKEN`
    command = ["campaign", "run", str(path), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert run(command) == 1
    printed = capsys.readouterr()
    assert f"{tmp_path / 'out'}: 3 of 13 runs have status unknown" in printed.err and "Done" not in printed.out
    reason = "tests.core.unit.campaign.fakes:FakeHost: ZeroDivisionError: a mistake of ours (fakes.py:"
    assert f"unknown (3 of them: {reason}" in printed.err
    listed = _json(capsys, "runs", str(tmp_path / "out"), "--failed")
    unknown = [row for row in listed["rows"] if row["reason"]]
    assert len(unknown) == 3 and all(row["reason"].startswith(reason) for row in unknown)
    assert run(["explain", str(tmp_path / "out"), unknown[0]["run_id"]]) == 2
    assert f"left no flight to explain ({reason}" in capsys.readouterr().err
    assert run([*command, "--allow-unknown"]) == 0
    assert "Done" in capsys.readouterr().out


@pytest.mark.parametrize("verb", [["campaign", "status"], ["explain"]])
def test_a_damaged_ledger_is_one_line(capsys, flown, tmp_path, verb):
    shutil.copytree(flown, tmp_path / "copy")
    with closing(sqlite3.connect(tmp_path / "copy" / "campaign.sqlite")) as connection, connection:
        connection.execute("UPDATE runs SET record = replace(record, 'success', 'timeout') WHERE position = 0")
    assert run([*verb, str(tmp_path / "copy"), *(["sparse"] if verb == ["explain"] else [])]) == 2
    stderr = capsys.readouterr().err
    assert stderr.count("\n") == 1 and "is damaged: run 'sparse-10000-golden-" in stderr


def test_digest_is_the_same_when_run_again(capsys, config, flown):
    digest = _json(capsys, "campaign", "digest", str(flown))["digest"]
    assert run(["campaign", "run", str(config), "--out", str(flown), "--workers", "1"]) == 0
    heading, golden, *_, last = capsys.readouterr().out.splitlines()
    assert heading.split()[:3] == ["setting", "flown", "succeeded"]
    assert golden.split()[:3] == ["golden", "1", "1"] and last == f"Done. Tables and figures: mavfi report {flown}"
    assert run(["campaign", "digest", str(flown)]) == 0
    assert capsys.readouterr().out.strip() == digest


def test_the_digest_of_a_part_says_that_it_is_one(capsys, tmp_path, flown, config):
    from mavfi.campaign.config import load_campaign
    from mavfi.campaign.ledger import status
    from tests.campaigns import run_campaign
    from tests.core.unit.campaign.fakes import OneByOne

    def stop(progress):
        if progress.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(load_campaign(config), tmp_path / "part", executor=OneByOne(), progress=stop)
    assert run(["campaign", "digest", str(tmp_path / "part")]) == 0
    captured = capsys.readouterr()
    assert len(captured.out.strip()) == 64
    done = status(tmp_path / "part").done
    assert 1 <= done < 5 and captured.err.startswith(f"partial: {done} of 5 runs")
    data = _json(capsys, "campaign", "digest", str(tmp_path / "part"))
    assert (data["partial"], data["done"], data["total"]) == (True, done, 5)
    assert not _json(capsys, "campaign", "digest", str(flown))["partial"]


@pytest.mark.slow
def test_replay_gives_the_same_bytes(capsys, really_flown):
    data = _json(capsys, "replay", str(really_flown), "sparse-10000-fi-planning")
    assert data["same"] and data["digest"] == data["stored_digest"]
    assert run(["replay", str(really_flown), "sparse-10000-golden-"]) == 0
    assert "the same run, bit for bit" in capsys.readouterr().out


def test_a_replay_that_is_another_run_fails(capsys, flown, monkeypatch):
    monkeypatch.setattr(TROUBLE, "stray", 1e-9)
    assert run(["replay", str(flown), "sparse-10000-golden-"]) == 1
    printed = capsys.readouterr()
    assert "bit for bit" not in printed.out
    assert ": another run: " in printed.err and "; stored: " in printed.err and printed.err.count("\n") == 1
    assert run(["replay", str(flown), "sparse-10000-golden-", "--json"]) == 1
    assert not json.loads(capsys.readouterr().out)["same"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["campaign", "run", "smoke", "--out", "OUT", "--workers", "0"], "workers: 0"),
        (["campaign", "run", "CONFIG", "--out", "CONFIG"], "cannot be written"),
        (["campaign", "run", "smok"], "campaign 'smok': not known (did you mean 'smoke'?); allowed: smoke, "),
        (["campaign", "run", "FLOWN"], ": is a folder; allowed: as_published"),
        (["campaign", "status", "OUT"], "holds no campaign"),
        (["replay", "FLOWN", "sparse"], "ambiguous, 5 runs match, e.g. sparse-10000-golden-"),
        (["explain", "FLOWN", "sparse-10000-golden-"], "is a golden run; explain needs a run with a fault"),
        (["reproduce", "--scale", "huge", "--out", "OUT"], "scale 'huge'"),
        (["reproduce", "--out", "STUDY"], "holds another campaign (differs in: campaign."),
        (["train", "--flights", "0", "--out", "OUT"], "--flights: 0"),
        (["train", "--out", "CONFIG"], "cannot be written"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(capsys, tmp_path, config, flown, arguments, message):
    places = {"OUT": tmp_path / "out", "CONFIG": config, "FLOWN": flown}
    places["MARS"] = tmp_path / "mars.yaml"
    places["MARS"].write_text("name: mars\nenvironments: [sparse]\nhost: mars\n")
    places["STUDY"] = tmp_path / "study"
    shutil.copytree(flown, places["STUDY"])
    assert run([str(places.get(argument, argument)) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("mavfi: ") and error.count("\n") == 1
    assert message in error
    assert not (tmp_path / "out").exists()
    assert not (flown / "models").exists() and not (places["STUDY"] / "models").exists()


def _of_sqlite(code, text):
    error = sqlite3.OperationalError(text)
    error.sqlite_errorcode = code
    return error


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.EMFILE, "", "/ledger"), "Too many open files (/ledger)"),
        (ValueError("Error: engine error: Could not allocate memory"), "out of memory"),
        (
            _of_sqlite(sqlite3.SQLITE_IOERR_READ, "disk I/O error"),
            "the ledger cannot be read or written (disk I/O error)",
        ),
    ],
)
def test_a_machine_that_fails_is_one_line_and_exit_code_1(capsys, monkeypatch, config, tmp_path, error, message):
    def fail(*arguments, **options):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(run_module, "run_campaign", fail)
        assert run(["campaign", "run", str(config), "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"mavfi: {message}\n"
    error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(Path, "mkdir", fail)
    assert run(["campaign", "run", str(config), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == f"mavfi: {tmp_path / 'out'}: cannot be written (No space left on device)\n"
