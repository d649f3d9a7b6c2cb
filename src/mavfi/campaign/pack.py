"""Exchange of a campaign as one file: its ledger as text, its trained models, a manifest with every checksum.

A pack is a ZIP archive.  Unpacking rebuilds the ledger row by row and verifies everything: names, sizes, checksums of
rows and members, the digest.  A failed unpacking leaves no files behind.
"""

import hashlib
import json
import re
import shutil
import sqlite3
import stat
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import IO

import yaml
from pydantic import Field, ValidationError

from mavfi.campaign.integrity import TABLES
from mavfi.campaign.run import status_of, stored_campaign
from mavfi.campaign.store import FILE, SCHEMA, Store
from mavfi.config import Config
from mavfi.detectors.model import Model
from mavfi.errors import BadInputError, writing
from mavfi.files import exists, is_dir, is_file
from mavfi.flight_record import canonical

FORMAT = 1
MANIFEST, LEDGER, MODELS, CONFIG = "manifest.json", "ledger.jsonl", "models", "campaign.yaml"
_MEMBER = re.compile(rf"{re.escape(LEDGER)}|{MODELS}/[A-Za-z0-9][A-Za-z0-9_.-]{{0,200}}\.json")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # earliest time stamp in ZIP; constant, so that equal ledgers have equal packs
_LARGEST = {MANIFEST: 2**20, LEDGER: 2**34, MODELS: 2**26}
"""Allowed sizes of members (bytes)."""
_MOST_MODELS, _LONGEST_LINE, _CHUNK = 64, 2**24, 2**20
_MARKS = {"meta": 3, "runs": 11, "missions": 3}
"""Columns by table."""
_DAMAGED = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, RuntimeError, ValueError, TypeError,
    LookupError, AttributeError, OverflowError, sqlite3.IntegrityError, sqlite3.InterfaceError,
    sqlite3.ProgrammingError,
)  # fmt: skip


class Member(Config):
    """A file of a pack."""

    bytes: int = Field(ge=0)
    sha256: str


class Manifest(Config):
    """Contents of a pack."""

    format: int = Field(ge=FORMAT, le=FORMAT)
    ledger_schema: int = Field(ge=SCHEMA, le=SCHEMA)
    name: str = Field(description="of the campaign")
    digest: str = Field(description="of the runs so far, or of the whole campaign if it is complete")
    done: int = Field(ge=0, description="runs")
    total: int = Field(ge=0, description="runs of the whole campaign, at most")
    complete: bool
    versions: dict[str, str]
    members: dict[str, Member]


def pack(directory: Path, file: Path) -> Manifest:
    """Write a campaign to one file, also while it is running; equal ledgers give equal bytes.

    Raises:
        BadInputError: The ledger is absent or damaged, a trained model is missing, or the file cannot be written.
    """
    part = file.with_name(f"{file.name}.part")
    with Store.open(directory) as store, store.snapshot(), writing(file):
        models = _models(store)
        try:
            with zipfile.ZipFile(part, "w") as archive:
                members = {LEDGER: _add(archive, LEDGER, _lines(store, bool(models)))}
                for name, content in sorted(models.items()):
                    members[name] = _add(archive, name, iter([content]))
                manifest = _manifest(store, status_of(store).total, members)
                _add(archive, MANIFEST, iter([manifest.model_dump_json(indent=2).encode()]))
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)
    return manifest


def unpack(file: Path, directory: Path) -> Manifest:
    """Verify a pack, and create a folder with its ledger, its trained models, and the campaign as YAML.

    Raises:
        BadInputError: The file is not a valid pack, or the folder is not empty or cannot be written.
    """
    if exists(directory) and (not is_dir(directory) or any(directory.iterdir())):
        raise BadInputError(f"{directory}: exists already; allowed: a folder that is empty or absent")
    if not is_file(file):
        raise BadInputError(f"{file}: no such file")
    parent = directory.absolute().parent
    with writing(directory):
        parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".mavfi-", dir=parent) as scratch:
            staged = Path(scratch) / "ledger"
            staged.mkdir()
            with _reading(file), zipfile.ZipFile(file) as archive:
                manifest = _read_manifest(archive)
                _check_room(manifest, parent)
                _extract(archive, manifest, staged)
                _check_whole(manifest, staged)
            staged.replace(directory)
    return manifest


def _manifest(store: Store, total: int, members: Mapping[str, Member]) -> Manifest:
    done = sum(flown for _, flown, _ in store.counts().values())
    return Manifest(
        format=FORMAT, ledger_schema=SCHEMA, name=stored_campaign(store).name, digest=store.digest(), done=done,
        total=total, complete=store.complete, versions=store.meta("versions") or {}, members=dict(members),
    )  # fmt: skip


def _lines(store: Store, has_models: bool) -> Iterator[bytes]:
    """Rows of the ledger, one JSON array each; the models folder is replaced by that of the pack."""
    for table, row in store.tables():
        if row[0] == "models_dir":
            row = store.meta_row("models_dir", MODELS if has_models else None)
        yield f"{canonical([table, *row])}\n".encode()


def _models(store: Store) -> dict[str, bytes]:
    """Trained models of the arms from the user's folder, by name in the pack."""
    folder = store.models_dir
    wanted = set(store.meta("identity")["models"].values()) - {""}
    if folder is None or not wanted:
        return {}
    found = {path: digest for path in sorted(folder.glob("*.json")) if (digest := _model_hash(path)) in wanted}
    absent = sorted(wanted - set(found.values()))
    if absent:
        raise BadInputError(f"{folder}: the trained model {absent[0][:12]} of the campaign is not there any more")
    return {f"{MODELS}/{path.name}": path.read_bytes() for path in found}


def _model_hash(path: Path) -> str:
    """Hash of a trained model; "" = the file is not a model."""
    try:
        return Model.load(path).sha256
    except BadInputError:
        return ""


def _add(archive: zipfile.ZipFile, name: str, parts: Iterator[bytes]) -> Member:
    info = zipfile.ZipInfo(name, _EPOCH)
    info.compress_type, info.external_attr, info.create_system = zipfile.ZIP_DEFLATED, (stat.S_IFREG | 0o644) << 16, 3
    digest, size = hashlib.sha256(), 0
    with archive.open(info, "w", force_zip64=name == LEDGER) as target:
        for part in parts:
            target.write(part)
            digest.update(part)
            size += len(part)
    return Member(bytes=size, sha256=digest.hexdigest())


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    """Convert errors of a damaged archive to a `BadInputError` of one line."""
    try:
        yield
    except ValidationError as error:
        found = error.errors()[0]
        where = ".".join(str(part) for part in found["loc"])
        raise BadInputError(f"{file}: {MANIFEST}: {where or 'content'}: {found['msg']}") from None
    except (OSError, sqlite3.OperationalError) as error:
        raise BadInputError(f"{file}: cannot be unpacked ({error})") from None
    except _DAMAGED as error:
        raise BadInputError(f"{file}: is no pack of a campaign, or damaged: {error}") from None


def _read_manifest(archive: zipfile.ZipFile) -> Manifest:
    """Read the manifest, after checking names, types and sizes of all members."""
    infos = {info.filename: info for info in archive.infolist()}
    if len(infos) < len(archive.infolist()) or len(infos) > _MOST_MODELS + 2:
        raise ValueError("has members of the same name, or too many")
    if MANIFEST not in infos:
        raise ValueError(f"has no {MANIFEST}")
    for info in infos.values():
        _check_member(info)
    manifest = Manifest.model_validate_json(_content(archive, MANIFEST))
    held = {name: info.file_size for name, info in infos.items() if name != MANIFEST}
    if LEDGER not in held or held != {name: member.bytes for name, member in manifest.members.items()}:
        raise ValueError(f"its members or their sizes are not those of {MANIFEST}")
    return manifest


def _check_member(info: zipfile.ZipInfo) -> None:
    if info.filename != MANIFEST and not _MEMBER.fullmatch(info.filename):
        raise ValueError(f"member {info.filename[:80]!r} has no place in a pack")
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"member {info.filename}: is encrypted, or compressed in a way that is not allowed")
    if stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG):
        raise ValueError(f"member {info.filename}: is no plain file")
    if info.file_size > (most := _LARGEST[info.filename.partition("/")[0]]):
        raise ValueError(f"member {info.filename}: {info.file_size} bytes; allowed: {most}")


def _check_room(manifest: Manifest, parent: Path) -> None:
    """Refuse a pack that would fill the disk; a ledger takes about as much space as its text."""
    needed, free = 2 * sum(member.bytes for member in manifest.members.values()), shutil.disk_usage(parent).free
    if needed > free:
        raise BadInputError(f"{parent}: {free // 10**6} MB are free; the pack needs {needed // 10**6} MB")


def _content(archive: zipfile.ZipFile, name: str) -> bytes:
    with archive.open(name) as source:
        return source.read()


def _extract(archive: zipfile.ZipFile, manifest: Manifest, staged: Path) -> None:
    with closing(sqlite3.connect(staged / FILE)) as ledger, ledger, archive.open(LEDGER) as source:
        ledger.executescript(f"BEGIN; {TABLES} PRAGMA user_version = {SCHEMA};")
        _fill(ledger, source, lambda digest: _check_digest(manifest, LEDGER, digest))
    for name in manifest.members:
        if name != LEDGER:
            content = _content(archive, name)
            _check_digest(manifest, name, hashlib.sha256(content).hexdigest())
            Model.from_json(json.loads(content), name)
            (staged / name).parent.mkdir(exist_ok=True)
            (staged / name).write_bytes(content)


def _fill(ledger: sqlite3.Connection, source: IO[bytes], check_digest: Callable[[str], None]) -> None:
    """Insert the rows of a ledger; lines that do not match a table, and a wrong checksum of the member, are errors."""
    digest, number = hashlib.sha256(), 0
    while line := source.readline(_LONGEST_LINE):
        digest.update(line)
        number += 1
        table, *row = json.loads(line)
        if _MARKS.get(table) != len(row):
            raise ValueError(f"{LEDGER}, line {number}: is no row of a ledger")
        ledger.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", row)
    check_digest(digest.hexdigest())


def _check_digest(manifest: Manifest, name: str, found: str) -> None:
    if found != manifest.members[name].sha256:
        raise ValueError(f"member {name}: checksum mismatch")


def _check_whole(manifest: Manifest, staged: Path) -> None:
    """Compare the rebuilt ledger with the manifest, and write its campaign as YAML."""
    try:
        with Store.open(staged) as store:
            found = _manifest(store, manifest.total, manifest.members)
            models = {f"{MODELS}/{path.name}" for path in (staged / MODELS).glob("*.json")}
            has_models = store.meta("models_dir") == (MODELS if models else None) and set(_models(store)) == models
            content = stored_campaign(store).to_json()
    except BadInputError as error:
        raise ValueError(str(error).replace(f"{staged / FILE}", "its ledger")) from None
    if found != manifest or not has_models or found.done > found.total:
        raise ValueError(f"its ledger is not the one of {MANIFEST}")
    (staged / CONFIG).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
