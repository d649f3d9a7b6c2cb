"""Every reader of files and texts that others may have written, with sound examples of what it reads."""

import contextlib
import copy
import functools
import hashlib
import io
import itertools
import json
import os
import sqlite3
import struct
import tempfile
import zipfile
import zlib
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import yaml
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from mavfi.analysis.runs import Runs
from mavfi.analysis.views import VIEWS, table
from mavfi.campaign.begin import check_names
from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.ledger import repair, status
from mavfi.campaign.plan import Plan
from mavfi.campaign.replay import resolve_stored, setup_of_run
from mavfi.campaign.resolve import resolve as resolve_campaign
from mavfi.campaign.store import (
    BOUND,
    IDENTITY,
    PLANNED,
    SCHEMA,
    TABLES,
    Store,
    checksum_of,
    meta_checksum,
    mission_checksum,
    salt_of,
)
from mavfi.campaign.training import KeptRecordings
from mavfi.config import AutopilotConfig, PlatformConfig, load
from mavfi.config import shipped as find_shipped
from mavfi.detectors.model import Model
from mavfi.detectors.registry import SHIPPED_MODELS, DetectorConfig, load_detector
from mavfi.detectors.training import MONITORED_FIELDS, WATCHED, Recorder
from mavfi.errors import BadInputError
from mavfi.extras.logs.cli_export import ExportedFlight, _write
from mavfi.extras.paper.study import load_study
from mavfi.extras.ros.watch import train_on_file
from mavfi.flight.compose import find_environment, find_planner, new_loop, resolve
from mavfi.levels.level import parse
from mavfi.levels.state.request import StateRequest
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.record import COLUMNS, AlarmRecord, Event, FlightLog, Injection, KernelEffect
from mavfi.sim.environments import build_world, environment_for_file
from mavfi.sim.mjcf import find_vehicle
from mavfi.states import STATES, new_state
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import golden_profile, small
from tests.core.unit.sim.environments.octrees import bits, tree_of, values
from tests.nightly.mutations import RAW, RAW_JSON, TEXTS, joined, to_json, to_yaml, words_of

ROOT = Path(__file__).parents[2]
CORPUS = Path(__file__).parent / "corpus"
ENDS = {"start": (1.0, 1.0, 1.5), "goal": (5.0, 1.0, 1.5)}
LEDGER = "campaign.sqlite"


@dataclass(frozen=True)
class Reader:
    """One reader.

    Attributes:
        name: As in ONLY and in the corpus.
        file: Name of the file that it reads.
        seeds: Gives the plain data with which its mutations begin.
        encode: Makes the content of a file of a seed.
        read: Reads a file; it may raise a `BadInputError`, or leave a result.
        share: Inputs of a thousand.
        raw: Values of which a mutation may make use besides those for all.
        warm: Whether children may inherit what it has imported and compiled; threads of polars do not survive a fork.
    """

    name: str
    file: str
    seeds: object
    encode: object
    read: object
    share: int
    raw: object = TEXTS
    warm: bool = True


# ---- YAML --------------------------------------------------------------------------------------------------------
def shipped(*patterns):
    """Plain data of shipped files."""
    files = [path for pattern in patterns for path in sorted(ROOT.glob(pattern))]
    return [yaml.safe_load(path.read_text(encoding="utf-8")) for path in files]


def fly_nowhere(path, option, find):
    """Find what a file describes; of every eighth, build the whole mission up to its first step."""
    found = find(str(path))
    if zlib.crc32(path.read_bytes()) % 8 == 0:
        scenario = resolve(MissionSpec(**{"environment": "farm", "seed": 7, option: str(path)}))
        new_loop(scenario)
    return found


def find_world(name):
    """An environment and its world."""
    environment = find_environment(name)
    build_world(environment, 7)


def read_vehicle(path):
    """A vehicle must hover, and be a rigid body."""
    vehicle = fly_nowhere(path, "vehicle", find_vehicle)
    assert 4 * vehicle.max_rotor_thrust > 9.80665 * vehicle.mass > 0, "does not hover"
    x, y, z = sorted(vehicle.inertia)
    assert 0 < x and z <= (x + y) * 1.001, "no rigid body has this inertia"
    assert 0 < vehicle.max_tilt < np.pi / 2, "tilts over"


def read_campaign(path):
    """As `mavfi campaign run` begins, at each of its scales."""
    campaign = load_campaign(path)
    for scale in ("quick", *campaign.scales):
        sized = campaign.at_scale(scale)
        check_names(sized, str(path))
        assert Plan(resolve_campaign(sized).with_models()).count()


def read_study(path):
    """As `mavfi reproduce` begins."""
    load_study(path).campaigns_at("quick")


# ---- text on the command line --------------------------------------------------------------------------------------
FAULTS = [
    b"null",
    b"state:planning.waypoint.x",
    b"state:planning.trajectory.x[3]:bit=62@5.0",
    b"state:planning.waypoint",
    b"instruction:pid",
    b"instruction:rrt_connect:which=opcode:fadd",
    b"instruction:octomap:which=floating_point:model=zero",
    b"instruction:pid:which=line:pid.py:10-20",
    b"state:perception.collision_status.time_to_collision:bit=3@1e1",
]


def read_fault(path):
    """Faults of a host with two levels and of all, and the draw of what was not named."""
    text = path.read_bytes().decode("utf-8", "surrogateescape")
    with contextlib.suppress(BadInputError):
        parse(text, levels=("state", "sensor"))
    request = parse(text)
    if isinstance(request, StateRequest):
        request.resolve(1, "published", golden_profile(1))


# ---- maps ----------------------------------------------------------------------------------------------------------
def maps():
    """A room of 8 x 4 x 4 m with a wall, in both formats."""
    half, header = 1 << 15, b"id OcTree\nsize 1\nres 0.5\ndata\n"
    voxels = {(half + i, half + j, half + k): i == 13 and j < 4 for i in range(16) for j in range(8) for k in range(8)}
    tree = tree_of(voxels)
    return [b"# Octomap OcTree binary file\n" + header + bits(tree), b"# Octomap OcTree file\n" + header + values(tree)]


def read_map(path):
    """As a mission in a scanned map begins."""
    build_world(environment_for_file(path), 0, **ENDS)


# ---- models --------------------------------------------------------------------------------------------------------
def models():
    """Shipped models, without their hash."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(SHIPPED_MODELS.glob("*.json"))]
    return [{key: value for key, value in model.items() if key != "sha256"} for model in found]


def hashed(content):
    """A model's file with the right hash."""
    try:  # as the reader sees it
        text = to_json(content)
        seen = json.loads(text)
        digest = hashlib.sha256(json.dumps(seen, sort_keys=True).encode()).hexdigest()
    except (ValueError, TypeError, RecursionError):
        return text
    return text.rstrip()[:-1] + f', "sha256": "{digest}"}}'.encode()


def read_model(path):
    """Load it by the name that fits it, and let it judge what it would see in flight."""
    Model.load(path)
    text = path.read_text(encoding="utf-8", errors="replace")
    for autopilot, kind, profile in itertools.product(*_MODEL_NAMES):
        if not all(name in text for name in (autopilot, f'"{kind}"', f'"{profile}"')):
            continue
        with contextlib.suppress(FileExistsError):
            os.link(path, path.with_name(f"{autopilot}-i9-9940x-{kind}-{profile}.json"))
        fits = {"stack": autopilot, "platform": "i9-9940x", "v_max": 3.0, "planner": "rrt_connect"}
        detector, _ = load_detector(kind, profile, path.parent, fits)
        detector.start()
        for name, value in itertools.product(STATES, (0.5, 0.75, 1e3, -2.0)):
            state = new_state(name)
            for field in state.header.dtype.names or ():
                state.header[field] = value if state.header.dtype[field].kind == "f" else abs(int(value))
            alarm = detector.check(state, 1000)
            assert alarm is None or alarm.score >= 0, f"score {alarm.score}"
            detector.accept(state, 1000)
        return


_MODEL_NAMES = (("published", "hardened"), ("gaussian", "autoencoder"), ("paper", "tuned"))


# ---- archives of NumPy ---------------------------------------------------------------------------------------------
def flights():
    """A short flight, as lists and a record."""
    rows = np.zeros((6, len(COLUMNS)))
    rows[:, 0], rows[:, 1], rows[:, 7] = np.arange(6) * 0.1, np.arange(6), 1.0
    scenario = resolve(MissionSpec(environment="sparse", seed=7))
    log = FlightLog(
        rows,
        MissionStatus.SUCCESS,
        [Event(0, "plan", {"vertices": 3}), Event(5, "end")],
        [Injection("state", "planning.waypoint.x", 0.2, 62, 1.0, 2.0, activated=True)],
        [AlarmRecord(0.2, "gaussian", "planning.waypoint", "planning", 2.0, ("planning.waypoint.x",))],
        {"scenario": scenario.to_json(), "course_m": 5.0},
        KernelEffect("sdc"),
    )
    with tempfile.TemporaryDirectory() as folder:
        log.save(Path(folder) / "flight.npz")
        with np.load(Path(folder) / "flight.npz") as archive:
            arrays = {name: archive[name].tolist() for name in archive.files}
    return [{**arrays, "record": json.loads(arrays["record"])}]


def recordings():
    """A recording of publications, as of training."""
    recorder = Recorder()
    for name in ("sensor.odometry", "planning.waypoint", "control.command"):
        recorder.accept(new_state(name), 1000)
    return [{name: array.tolist() for name, array in recorder.recording()._asdict().items()}]


class Trap:
    """Unpickled, it ends the process."""

    def __reduce__(self):
        return os._exit, (3,)


_KINDS = {"kinds": np.int8, "times_us": np.int64, "content": np.uint8}


def packed(content):
    """An archive of NumPy; what is no array is an object that ends the process which unpickles it."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{str(name): _array(name, value) for name, value in content.items()})
    return buffer.getvalue()


def _array(name, value):
    if isinstance(value, dict):
        return np.array(to_json(value).decode())
    for kind in (_KINDS.get(name, float), None):
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            return np.array(value, kind)
    return np.array([Trap()], object)


@functools.cache
def bomb(name):
    """An archive with an array of 0.3 GB, which is much smaller itself."""
    buffer, header = io.BytesIO(), {"descr": "<f8", "fortran_order": False, "shape": (38_000_000,)}
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open(f"{name}.npy", "w") as member:
            np.lib.format.write_array_header_1_0(member, header)
            for _ in range(19):
                member.write(bytes(16_000_000))
    return buffer.getvalue()


def read_flight(path):
    """As `mavfi export` does, in two formats."""
    log = FlightLog.load(path)
    for ending in (".csv", ".bag"):
        to = path.with_name(f"out{ending}")
        try:
            _write(ExportedFlight(log), to, str(path))
        finally:
            to.unlink(missing_ok=True)


def read_recording(path):
    """As a training that is resumed does; what cannot be read counts as absent."""
    disk = KeptRecordings.__new__(KeptRecordings)
    disk._folder, disk._trainings = path.parent, (MONITORED_FIELDS,)
    for (recording,) in disk.load([0]).values():
        for name in WATCHED:
            recording.headers(name)


# ---- ledgers -------------------------------------------------------------------------------------------------------
@functools.cache
def _flown():
    """Content of a ledger of made-up flights, all of its JSON as plain data."""
    os.environ["MAVFI_ALLOW_PLUGINS"] = "all"
    with tempfile.TemporaryDirectory() as folder:
        run_campaign(small(missions=1, faults=1, environments=["sparse"]), Path(folder), executor=LocalExecutor(1))
        with closing(sqlite3.connect(Path(folder) / LEDGER)) as ledger:
            meta = {key: json.loads(value) for key, value in ledger.execute("SELECT key, value FROM meta")}
            runs = [list(row) for row in ledger.execute(f"SELECT {PLANNED}, record, note, wall_s FROM runs")]
            missions = [list(row) for row in ledger.execute("SELECT environment, seed FROM missions")]
    del os.environ["MAVFI_ALLOW_PLUGINS"]
    for row in runs:
        row[6:8] = json.loads(row[6]), json.loads(row[7])
    meta["identity"]["campaign"]["host"] = "local"
    for arm in meta["identity"]["campaign"]["arms"].values():
        arm["detector"] = "gaussian"
    return {"meta": meta, "runs": runs, "missions": missions}


def ledgers():
    """A ledger, and one with half of its runs flown."""
    half = copy.deepcopy(_flown())
    for row in half["runs"][1::2]:
        row[7:] = None, "", None
    return [_flown(), half]


_ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT"
TRICKS = (
    f"DROP TABLE meta; CREATE VIEW meta AS {_ENDLESS} x AS key, x AS value, x AS checksum FROM n;",
    f"ALTER TABLE runs RENAME TO old; CREATE VIEW runs AS SELECT old.* FROM old, ({_ENDLESS} x FROM n);",
    "DROP TABLE missions;",
    "DROP TABLE runs; CREATE TABLE runs (run_id);",
    "DELETE FROM meta;",
    "PRAGMA user_version = 2;",
    "PRAGMA user_version = 99;",
    "CREATE TABLE more (x);",
    "DELETE FROM runs;",
    "ALTER TABLE meta ADD COLUMN x TEXT GENERATED ALWAYS AS (hex(zeroblob(900000000))) VIRTUAL;",
    "DROP TABLE meta; CREATE TABLE meta (key, value AS (hex(zeroblob(900000000))), checksum);",
    "CREATE TRIGGER t AFTER INSERT ON meta BEGIN DELETE FROM runs; END;",
    "DROP TABLE missions; CREATE TABLE missions (environment, seed, checksum, more);",
)


def ledger_of(content, trick=""):
    """A ledger's file whose checksums are right."""
    with closing(sqlite3.connect(":memory:")) as ledger:
        ledger.executescript(f"BEGIN; {TABLES} PRAGMA user_version = {SCHEMA}; COMMIT;")
        for key, value in sorted(_rows(content, "meta"), key=lambda row: str(row[0]) not in (IDENTITY, BOUND)):
            cells = [_cell(key), to_json(value).decode()]
            _insert(ledger, "meta (key, value, checksum)", cells, meta_checksum(*cells, salt_of(ledger)))
        salt = salt_of(ledger)
        for row in _rows(content, "runs"):
            if isinstance(row, list):
                cells = [_cell(cell, json=place in (6, 7)) for place, cell in enumerate(row[:10])]
                _insert(ledger, f"runs ({PLANNED}, record, note, wall_s, checksum)", cells, checksum_of(*cells, *salt))
        for row in _rows(content, "missions"):
            if isinstance(row, list) and len(row) == 2:
                world = tuple(map(_cell, row))
                values = (*world, mission_checksum(ledger, world, salt))
                with contextlib.suppress(sqlite3.Error):
                    ledger.execute("INSERT INTO missions VALUES (?, ?, ?)", values)
        ledger.commit()
        if trick:
            ledger.executescript(trick)
        return ledger.serialize()


def _rows(content, name):
    found = content.get(name, [])
    if name == "meta":
        return list(found.items()) if isinstance(found, dict) else []
    return found if isinstance(found, list) else []


def _cell(value, json=False):
    if json and value is not None:
        return to_json(value).decode()
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return str(value)
    return value if isinstance(value, (int, float, str, type(None))) else to_json(value).decode()


def _insert(ledger, place, cells, checksum):
    marks = ", ".join("?" * (len(cells) + 1))
    with contextlib.suppress(sqlite3.Error, UnicodeEncodeError):
        ledger.execute(f"INSERT INTO {place} VALUES ({marks})", (*cells, checksum))


def read_ledger(path):
    """Everything that reads a ledger, up to the flights."""
    directory = path.parent
    runs = Runs.read(directory)
    status(directory)
    if zlib.crc32(path.read_bytes()) % 8 == 0:
        for view in VIEWS:
            table(runs, view)
    with Store.open(directory) as store:
        for run in itertools.islice(store.runs(), 2):
            setup_of_run(resolve_stored(store), store, run.spec)


def read_damaged(path):
    """As `mavfi campaign repair` does; what it leaves is sound."""
    repair(path.parent)
    Store.open(path.parent).close()


# ---- ROS bags ------------------------------------------------------------------------------------------------------
def bags():
    """Two topics, one with a list."""
    types = get_typestore(Stores.ROS1_NOETIC)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.bag"
        with Writer(path) as writer:
            number = writer.add_connection("/a", "std_msgs/msg/Float64", typestore=types)
            joints = writer.add_connection("/b", "sensor_msgs/msg/JointState", typestore=types)
            for step in range(60):
                writer.write(number, 1 + 1_000_000 * step, struct.pack("<d", 0.5 * step))
                names = struct.pack("<IIIII", step, step, 0, 0, 1) + struct.pack("<I1s", 1, b"j")
                lists = b"".join(struct.pack("<Id", 1, 0.1 * step) for _ in range(3))
                writer.write(joints, 2 + 1_000_000 * step, names + lists)
        return [path.read_bytes()]


def read_bag(path):
    """As `mavfi ros watch --train` does, up to the trained detector."""
    train_on_file(path, ["/a", "/b"], {}, ("gaussian", "tuned"), [])


# ---- MJCF ----------------------------------------------------------------------------------------------------------
def bodies():
    """The example's model."""
    return [(ROOT / "examples" / "vehicle" / "courier.xml").read_bytes()]


_ENDLESS_XML = (b"<worldbody>" * 100_000, b"<body>" * 20_000 + b"</body>" * 20_000)


def read_body(path):
    """As the vehicle of a mission."""
    content = (ROOT / "examples" / "vehicle" / "courier.yaml").read_text(encoding="utf-8")
    vehicle = path.with_name("courier.yaml")
    vehicle.write_text(content.replace("courier.xml", path.name), encoding="utf-8")
    read_vehicle(vehicle)


def _scan():
    """An environment of a scanned map, which is not there."""
    return {"name": "scan", "generator": "octomap_file", "parameters": {"path": "scan.bt"}, "v_max": 0.6}


_FOLDERS = {"study": "studies"}


def of_yaml(name, read, share, more=()):
    """A reader of YAML files like the shipped ones."""

    def seeds():
        return [*shipped(f"configs/{_FOLDERS.get(name, name + 's')}/*.yaml"), *more]

    return Reader(name, "x.yaml", seeds, to_yaml, read, share, RAW)


def of_option(name, share, find, more=()):
    """A reader of YAML files that the option of `mavfi fly` with this name takes."""
    return of_yaml(name, lambda path: fly_nowhere(path, name, find), share, more)


def of_text(name, file, texts, read, share, raw=TEXTS):
    """A reader whose mutations change words."""
    return Reader(name, file, lambda: [words_of(text) for text in texts()], joined, read, share, raw)


READERS = {
    reader.name: reader
    for reader in (
        of_option("environment", 110, find_world, (_scan(),)),
        of_yaml("vehicle", read_vehicle, 110),
        of_option("planner", 70, find_planner),
        of_option("autopilot", 100, partial(find_shipped, "autopilots", AutopilotConfig)),
        of_option("platform", 80, partial(find_shipped, "platforms", PlatformConfig)),
        of_yaml("campaign", read_campaign, 45),
        of_yaml("study", read_study, 30),
        of_yaml("detector", lambda path: load(DetectorConfig, path), 90),
        of_text("fault", "x.txt", lambda: FAULTS, read_fault, 150),
        of_text("map", "x.bt", maps, read_map, 60),
        Reader("model", "x.json", models, hashed, read_model, 60, RAW_JSON),
        Reader("flight", "x.npz", flights, packed, read_flight, 22, RAW_JSON),
        Reader("recording", "0.npz", recordings, packed, read_recording, 20),
        Reader("ledger", LEDGER, ledgers, ledger_of, read_ledger, 12, RAW_JSON, warm=False),
        Reader("damaged", LEDGER, ledgers, ledger_of, read_damaged, 10, RAW_JSON),
        of_text("bag", "x.bag", bags, read_bag, 20),
        of_text("mjcf", "model.xml", bodies, read_body, 20, (*TEXTS, *_ENDLESS_XML)),
    )
}
