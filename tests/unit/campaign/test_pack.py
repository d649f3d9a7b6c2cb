"""A campaign travels in one file: what arrives is what was sent, continues to the same end, or is refused."""

import hashlib
import json
import stat
import zipfile
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.integrity import checksum_of
from mavfi.campaign.pack import CONFIG, LEDGER, MANIFEST, pack, unpack
from mavfi.campaign.run import run_campaign, stored_campaign
from mavfi.campaign.store import FILE, Store
from mavfi.detectors.model import Model
from mavfi.detectors.registry import SHIPPED_MODELS
from mavfi.errors import BadInputError
from mavfi.flight_record import canonical
from tests.unit.campaign.fakes import small

NAME = "published-i9-9940x-gaussian-paper.json"
TRAINED = small(arms={"gaussian": {"detector": "gaussian", "profile": "paper"}})


class StopError(Exception):
    """Ends a campaign early."""


def flown_into(directory, campaign, stop_after=None, **options):
    """Fly a campaign, or its first runs; gives how many were flown."""
    reports = []

    def note(progress):
        reports.append(progress.flown)
        if progress.flown == stop_after:
            raise StopError

    try:
        run_campaign(campaign, directory, executor=LocalExecutor(1), progress=note, **options)
    except StopError:
        with Store.open(directory) as store:
            return sum(done for _, done, _ in store.counts().values())
    return max(reports)


def digest(directory):
    with Store.open(directory) as store:
        return store.digest()


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """A folder with a model that is not shipped, and files that no arm uses."""
    folder = tmp_path_factory.mktemp("trained")
    model = Model.load(SHIPPED_MODELS / NAME)
    replace(model, provenance={**model.provenance, "note": "mine"}).save(folder)
    (folder / "notes.json").write_text("[]")
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory, models):
    """Complete, with a trained model."""
    directory = tmp_path_factory.mktemp("whole")
    flown_into(directory, TRAINED, models_dir=models)
    return directory


@pytest.fixture(scope="module")
def packed(whole, tmp_path_factory):
    file = tmp_path_factory.mktemp("packed") / "whole.zip"
    pack(whole, file)
    return file


def content_of(file):
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def written(file, members, attributes=0o644 | stat.S_IFREG):
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            info = zipfile.ZipInfo(name)
            info.external_attr, info.compress_type = attributes << 16, zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return file


def refused(file, out):
    """The line with which a pack is refused; nothing is left of it."""
    before = set(out.parent.iterdir())
    with pytest.raises(BadInputError) as error:
        unpack(file, out)
    assert set(out.parent.iterdir()) == before
    assert str(file) in str(error.value)
    return str(error.value)


def test_what_arrives_is_what_was_sent(whole, packed, tmp_path):
    manifest = unpack(packed, tmp_path / "there")
    assert manifest.complete and manifest.done == manifest.total
    assert manifest.digest == digest(whole) == digest(tmp_path / "there")
    assert sorted(manifest.members) == [LEDGER, f"models/{NAME}"]
    with Store.open(whole) as sent, Store.open(tmp_path / "there") as arrived:
        assert list(arrived.runs()) == list(sent.runs())
        assert arrived.models_dir == tmp_path / "there" / "models"
    assert flown_into(tmp_path / "there", TRAINED) == 0


def test_the_same_ledger_gives_the_same_bytes_wherever_it_is(whole, packed, tmp_path):
    unpack(packed, tmp_path / "there")
    for directory in (whole, tmp_path / "there"):
        pack(directory, tmp_path / "again.zip")
        assert (tmp_path / "again.zip").read_bytes() == packed.read_bytes()


@pytest.mark.parametrize("stop_after", [0, 1, 30, 60])
def test_another_user_resumes_to_the_same_digest(whole, models, tmp_path, stop_after):
    kept = flown_into(tmp_path / "here", TRAINED, stop_after, models_dir=models)
    manifest = pack(tmp_path / "here", tmp_path / "part.zip")
    assert kept >= stop_after and (manifest.done, manifest.complete) == (kept, False)
    unpack(tmp_path / "part.zip", tmp_path / "there")
    (tmp_path / "there").rename(tmp_path / "moved")
    config = load_campaign(tmp_path / "moved" / CONFIG)
    with Store.open(whole) as store:
        total = sum(done for _, done, _ in store.counts().values())
        assert config == stored_campaign(store)
    assert flown_into(tmp_path / "moved", config) == total - kept
    assert digest(tmp_path / "moved") == digest(whole)


def test_a_campaign_is_packed_while_it_is_flown(whole, models, tmp_path):
    done = []

    def note(progress):
        if progress.flown in (5, 50):
            done.append((progress.flown, pack(tmp_path / "here", tmp_path / f"{progress.flown}.zip").done))

    run_campaign(TRAINED, tmp_path / "here", executor=LocalExecutor(2), models_dir=models, progress=note)
    assert [least for least, _ in done] == [5, 50]
    assert all(least <= packed <= least + 20 for least, packed in done), "runs are kept in batches"
    for number, _ in done:
        unpack(tmp_path / f"{number}.zip", tmp_path / str(number))
        flown_into(tmp_path / str(number), TRAINED)
        assert digest(tmp_path / str(number)) == digest(whole)


def test_a_snapshot_is_one_state_of_a_ledger_that_grows(models, tmp_path):
    seen = []
    with ExitStack() as until_later:

        def look(progress):
            if progress.flown == 5:
                store = until_later.enter_context(Store.open(tmp_path))
                until_later.enter_context(store.snapshot())
                seen.extend([store, list(store.rows())])
            if progress.flown == 20:
                assert list(seen[0].rows()) == seen[1]
                assert sum(done for _, done, _ in seen[0].counts().values()) == sum(
                    flown is not None for _, flown in seen[1]
                )
                raise StopError

        with pytest.raises(StopError):
            run_campaign(TRAINED, tmp_path, executor=LocalExecutor(1), models_dir=models, progress=look)
    assert len(seen) == 2


def test_shipped_models_are_not_packed(tmp_path):
    flown_into(tmp_path / "here", TRAINED)
    assert list(pack(tmp_path / "here", tmp_path / "a.zip").members) == [LEDGER]
    unpack(tmp_path / "a.zip", tmp_path / "there")
    assert flown_into(tmp_path / "there", TRAINED) == 0


def test_a_model_that_is_gone_is_named(models, tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / NAME).write_bytes((models / NAME).read_bytes())
    flown_into(tmp_path / "here", TRAINED, 1, models_dir=folder)
    (folder / NAME).unlink()
    with pytest.raises(BadInputError, match="of the campaign is not there any more"):
        pack(tmp_path / "here", tmp_path / "a.zip")
    assert not list(tmp_path.glob("a.zip*"))


def test_a_folder_that_holds_something_is_not_touched(packed, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    with pytest.raises(BadInputError, match=r"full: exists already; allowed: a folder that is empty or absent"):
        unpack(packed, tmp_path / "full")
    (tmp_path / "empty").mkdir()
    assert unpack(packed, tmp_path / "empty").complete


@pytest.mark.parametrize(
    "name", ["../evil", "/evil", "models/../../evil.json", "models/a/b.json", "campaign.sqlite", "models/.json"]
)
def test_a_member_cannot_leave_the_folder(packed, tmp_path, name):
    members = content_of(packed)
    file = written(tmp_path / "a.zip", {**members, name: b"x"})
    assert "has no place in a pack" in refused(file, tmp_path / "there")


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFDIR, stat.S_IFBLK])
def test_a_link_or_device_is_refused(packed, tmp_path, kind):
    file = written(tmp_path / "a.zip", content_of(packed), kind | 0o777)
    assert "is no plain file" in refused(file, tmp_path / "there")


def changed_ledger(members, change):
    """A pack whose manifest fits a ledger with changed rows."""
    rows = [json.loads(line) for line in members[LEDGER].splitlines()]
    text = b"".join(f"{canonical(row)}\n".encode() for row in change(rows))
    return with_ledger(members, text)


def with_ledger(members, text):
    manifest = json.loads(members[MANIFEST])
    manifest["members"][LEDGER] = {"bytes": len(text), "sha256": hashlib.sha256(text).hexdigest()}
    return {**members, LEDGER: text, MANIFEST: json.dumps(manifest).encode()}


def elsewhere(rows):
    """Models would be read from another folder."""
    text = canonical("/etc")
    [identity] = [row[2] for row in rows if row[1] == "identity"]
    mine = ["meta", "models_dir", text, checksum_of("models_dir", text, checksum_of(identity))]
    return [mine if row[1] == "models_dir" else row for row in rows]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: [r for r in rows if r[2] != 7], "runs are missing or were added"),
        (lambda rows: [*rows, rows[-1]], "UNIQUE constraint failed"),
        (lambda rows: [[*r[:-1], "0" * 32] for r in rows], "checksum mismatch"),
        (lambda rows: [["sqlite_master", *r[1:]] for r in rows], "line 1: is no row of a ledger"),
        (lambda rows: [["meta; DROP TABLE runs", *r[1:]] for r in rows], "line 1: is no row of a ledger"),
        (lambda rows: [r for r in rows if r[1] != "identity"], "its ledger: is damaged: metadata"),
        (lambda rows: [r for r in rows if r[0] != "missions"], f"is not the one of {MANIFEST}"),
        (elsewhere, f"is not the one of {MANIFEST}"),
        (lambda rows: [[], *rows], "is no pack of a campaign, or damaged"),
    ],
)
def test_a_ledger_with_other_rows_is_refused(packed, tmp_path, change, message):
    file = written(tmp_path / "a.zip", changed_ledger(content_of(packed), change))
    assert message in refused(file, tmp_path / "there")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("digest", "0" * 64, f"is not the one of {MANIFEST}"),
        ("done", 3, f"is not the one of {MANIFEST}"),
        ("total", 3, f"is not the one of {MANIFEST}"),
        ("name", "other", f"is not the one of {MANIFEST}"),
        ("versions", {}, f"is not the one of {MANIFEST}"),
        ("format", 2, "format: Input should be less than or equal to 1"),
        ("ledger_schema", 1, "ledger_schema: Input should be greater than or equal to"),
        ("members", {}, "its members or their sizes are not those"),
        ("extra", 1, "extra: Extra inputs are not permitted"),
    ],
)
def test_a_manifest_that_says_something_else_is_refused(packed, tmp_path, key, value, message):
    members = content_of(packed)
    manifest = json.dumps({**json.loads(members[MANIFEST]), key: value}).encode()
    file = written(tmp_path / "a.zip", {**members, MANIFEST: manifest})
    assert message in refused(file, tmp_path / "there")


def test_a_model_that_was_changed_is_refused(packed, tmp_path):
    members = content_of(packed)
    name = f"models/{NAME}"
    file = written(tmp_path / "a.zip", {**members, name: members[name].replace(b"mine", b"thin")})
    assert f"member {name}: checksum mismatch" in refused(file, tmp_path / "there")


def test_a_member_of_a_thousand_times_its_size_ends_at_its_first_line(packed, tmp_path):
    file = written(tmp_path / "a.zip", with_ledger(content_of(packed), b"0" * 2**26))
    assert file.stat().st_size < 2**20
    assert "is no pack of a campaign, or damaged" in refused(file, tmp_path / "there")


def test_a_manifest_beyond_its_bound_is_refused(packed, tmp_path):
    file = written(tmp_path / "a.zip", {**content_of(packed), MANIFEST: b" " * (2**20 + 1)})
    assert "1048577 bytes; allowed: 1048576" in refused(file, tmp_path / "there")


def test_no_file_and_no_archive_are_one_line(tmp_path):
    assert "no such file" in refused(tmp_path / "none.zip", tmp_path / "there")
    (tmp_path / "text.zip").write_text("hello")
    assert "is no pack of a campaign" in refused(tmp_path / "text.zip", tmp_path / "there")


@pytest.mark.slow
def test_flipped_bits_are_refused_or_without_effect(packed, tmp_path):
    random, whole = np.random.default_rng(1), packed.read_bytes()
    expected, harmless = unpack(packed, tmp_path / "whole"), 0
    for number in range(200):
        damaged = bytearray(whole)
        # a quarter of them in the directory at the end, which is small
        place = int(random.integers(len(whole)) if number % 4 else len(whole) - 1 - random.integers(300))
        damaged[place] ^= 1 << int(random.integers(8))
        file = tmp_path / f"{number}.zip"
        file.write_bytes(damaged)
        try:
            assert unpack(file, tmp_path / "out" / str(number)) == expected
        except BadInputError as error:
            assert str(error).startswith(str(file))
            continue
        harmless += 1
        assert digest(tmp_path / "out" / str(number)) == expected.digest
    assert harmless < 50
    assert len(list((tmp_path / "out").iterdir())) == harmless


@pytest.mark.slow
def test_a_pack_that_was_cut_off_is_refused(packed, tmp_path):
    whole = packed.read_bytes()
    for length in [*range(0, len(whole), len(whole) // 40), len(whole) - 1]:
        (tmp_path / "a.zip").write_bytes(whole[:length])
        assert "is no pack of a campaign, or damaged" in refused(tmp_path / "a.zip", tmp_path / "there")


def test_packing_a_folder_without_a_ledger_is_one_line(tmp_path):
    with pytest.raises(BadInputError, match=f"holds no campaign \\(no {FILE}\\)"):
        pack(tmp_path, tmp_path / "a.zip")
