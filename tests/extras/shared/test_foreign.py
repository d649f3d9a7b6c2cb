"""The monitor of numbers of which nothing is known: what it learns of them, and what it sees."""

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.shared.foreign import (
    COUNTER,
    QUATERNION,
    Monitor,
    NamedNumbers,
    Numbers,
    Topic,
    foreign_spec,
    recognise,
    train,
)

PERIOD_US = 20_000
TIME = np.arange(0.0, 30.0, 0.02)
NUMBER = np.arange(len(TIME), dtype=float)
NOISE = 0.002 * np.random.default_rng(1).standard_normal(len(TIME))


def messages_of(topic, **columns):
    """A recording of one topic."""
    names = list(columns)
    rows = zip(*columns.values(), strict=True)
    return [NamedNumbers(topic, PERIOD_US * n, dict(zip(names, row, strict=True))) for n, row in enumerate(rows)]


def alarms_in(monitor, messages):
    """Fields of the alarms, by number of the message."""
    monitor.start()
    alarms = {}
    for index, message in enumerate(messages):
        alarm = monitor.judge(message)
        if alarm is not None:
            alarms[index] = alarm.fields
    return alarms


def changed(messages, index, **numbers):
    """The messages, of which one has other numbers."""
    message = messages[index]
    return [*messages[:index], message._replace(numbers={**message.numbers, **numbers}), *messages[index + 1 :]]


def table(**columns):
    return Numbers(list(columns), np.column_stack(list(columns.values())), np.rint(1e6 * TIME).astype(np.int64))


def wrapped(angle, turn=2 * np.pi, low=-0.5):
    """An angle (turns) in a range that begins at `low` (turns)."""
    return turn * (np.mod(angle - low, 1.0) + low)


# ---- plain numbers ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["gaussian", "autoencoder"])
@pytest.mark.parametrize("profile", ["paper", "tuned"])
def test_normal_numbers_raise_no_alarm_and_a_wild_one_does(kind, profile):
    def normal(start):
        steps = np.arange(start, start + 600)
        arm = messages_of("/arm", x=np.sin(0.02 * steps), tiny=1e-6 * np.cos(0.03 * steps))
        speed = messages_of("/speed", v=np.full(600, 5.0))
        return [message for pair in zip(arm, speed, strict=True) for message in pair]

    monitor = train(kind, profile, [normal(0)])
    assert alarms_in(monitor, normal(600)) == {}
    for index, numbers, name in ((201, {"v": 5e9}, "/speed.v"), (300, {"x": 1e12}, "/arm.x")):
        alarms = alarms_in(monitor, changed(normal(600), index, **numbers))
        assert min(alarms) == index and name in alarms[index]


def test_it_monitors_the_finite_numbers_of_all_messages_that_are_no_counters():
    few = messages_of("/few", x=np.sin(TIME[:49]))
    many = messages_of("/many", x=np.sin(TIME), y=np.cos(TIME), seq=NUMBER, late=np.where(TIME < 1.0, np.nan, TIME))
    many = changed(few + many, 70, x=np.sin(TIME[21]))
    del many[70].numbers["x"]
    monitor = train("gaussian", "tuned", [many])
    wild = NamedNumbers("/many", 0, dict.fromkeys(("x", "y", "seq", "late"), np.nan))
    assert monitor.judge(wild).fields == ("/many.y",)
    assert monitor.judge(NamedNumbers("/few", 0, {"x": np.nan})) is None
    assert monitor.judge(NamedNumbers("/many", 0, {"x": np.nan})) is None


@pytest.mark.parametrize(
    ("kind", "count", "message"),
    [
        ("oracle", 100, "detector 'oracle': is not fitted to messages; allowed: gaussian, autoencoder"),
        ("gaussian", 49, "no number to monitor; allowed: 50 messages or more"),
    ],
)
def test_what_cannot_be_learned_is_refused(kind, count, message):
    with pytest.raises(BadInputError) as error:
        train(kind, "tuned", [messages_of("/arm", x=np.sin(TIME[:count]))])
    assert message in str(error.value)
    topics = {"/arm": Topic(foreign_spec("/arm", ["x"]), {})}
    with pytest.raises(BadInputError, match="training: 1 messages of /arm; allowed: 50 or more"):
        Monitor.fit("gaussian", "tuned", [[topics["/arm"].read({"x": 1.0})]], topics)


# ---- angles and quaternions ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("profile", ["paper", "tuned"])
@pytest.mark.parametrize(("turn", "low"), [(2 * np.pi, -0.5), (2 * np.pi, 0.0), (360.0, -0.5), (3.6e9, -0.5)])
def test_an_angle_that_passes_the_end_of_its_range_raises_no_alarm_and_a_flipped_one_does(turn, low, profile):
    def flight(phase):
        return messages_of("/odom", yaw=wrapped(low + 0.2 * np.sin(0.5 * TIME + phase) + NOISE, turn, low))

    monitor = train("gaussian", profile, [flight(0.0)])
    assert alarms_in(monitor, flight(1.1)) == {}
    quarter = next(n for n, message in enumerate(flight(1.1)) if abs(message.numbers["yaw"] / turn - low - 0.15) < 0.01)
    value = flight(1.1)[quarter].numbers["yaw"]
    assert min(alarms_in(monitor, changed(flight(1.1), quarter, yaw=-value))) == quarter
    # a full turn more is the same angle
    assert alarms_in(monitor, changed(flight(1.1), quarter, yaw=value + turn)) == {}


@pytest.mark.parametrize(
    "names", [("q.w", "q.x", "q.y", "q.z"), ("q[0]", "q[1]", "q[2]", "q[3]"), ("a", "b", "c", "d")]
)
@pytest.mark.parametrize("is_planar", [True, False])
def test_a_quaternion_and_its_opposite_are_the_same(names, is_planar):
    def flight(phase):
        yaw = np.pi + 0.8 * np.sin(0.5 * TIME + phase) + NOISE
        roll = (0.0 if is_planar else 0.2) * np.sin(TIME + phase)
        q = [np.cos(yaw / 2) * np.cos(roll), np.cos(yaw / 2) * np.sin(roll)]
        q = np.array([*q, np.sin(yaw / 2) * np.sin(roll), np.sin(yaw / 2) * np.cos(roll)])
        q *= np.sign(q[0])  # jumps to the opposite sign in each turn through pi
        return messages_of("/pose", **dict(zip(names, q, strict=True)))

    monitor = train("gaussian", "tuned", [flight(0.0)])
    assert alarms_in(monitor, flight(1.1)) == {}
    largest = flight(1.1)[700].numbers[names[3]]
    assert min(alarms_in(monitor, changed(flight(1.1), 700, **{names[3]: -largest}))) == 700


@pytest.mark.parametrize(
    ("columns", "units", "kinds"),
    [
        ({"yaw": np.sin(TIME)}, {}, {}),  # a name says nothing: set-points of rates are named so, too
        ({"yaw": np.sin(TIME)}, {"yaw": "rad"}, {"yaw": "rad"}),
        ({"yaw": np.sin(TIME)}, {"yaw": "rad/s"}, {}),
        ({"lat": 4.7e8 + 450.0 * TIME}, {"lat": "degE7"}, {"lat": "degE7"}),
        ({"x": wrapped(0.1 * TIME)}, {"x": "m"}, {}),
        ({"x": wrapped(0.1 * TIME)}, {}, {"x": "rad"}),
        ({"x": 10.0 * np.mod(TIME, 1.0)}, {}, {}),  # a saw-tooth
        ({name: 1.7e308 * np.sign(np.sin(TIME + 0.1)) for name in "abcd"}, {}, {}),  # overflows
        ({name: np.full(len(TIME), float(name == "d")) for name in "abcd"}, {}, dict.fromkeys("abcd", QUATERNION)),
        ({name: np.full(len(TIME), float(name == "d")) for name in "abcde"}, {}, {}),  # flags
    ],
)
def test_what_numbers_are(columns, units, kinds):
    assert recognise([table(**columns)], units) == kinds


# ---- counters and clocks ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("values", "is_counter"),
    [
        (4000.0 + NUMBER, True),
        (32.0 * NUMBER, True),
        (NUMBER % 256, True),
        (np.floor(1.7e9 + TIME), True),
        (np.floor(1e9 * (TIME % 1.0)), True),  # of a second, in ns
        (np.floor(1e3 * TIME), True),
        (3e5 + TIME + 0.0003 * np.sin(50 * NUMBER), True),
        (np.floor(4.7e8 + 450.0 * TIME + 20.0 * np.sin(TIME)), False),  # a latitude
        (0.7 * TIME, False),
        (np.floor(5.0 * TIME), False),  # a charge
        (np.floor(TIME / 5.0), False),  # of resets
        (np.floor(1500.0 + 300.0 * np.sin(TIME)), False),
        (0.0 * TIME, False),
    ],
)
def test_what_counts_messages_or_time(values, is_counter):
    assert (recognise([table(n=values)]) == {"n": COUNTER}) == is_counter


# ---- numbers that are not finite -------------------------------------------------------------------------------------
def test_a_number_that_is_lost_is_one_alarm_while_others_are_judged():
    def flight(phase):
        return messages_of("/imu", p=np.sin(TIME + phase), q=np.cos(TIME + phase))

    monitor = train("gaussian", "tuned", [flight(0.0)])
    for value in (np.nan, np.inf):
        messages = flight(1.0)
        for index in range(500, 600):
            messages = changed(messages, index, q=value)
        messages = changed(messages, 550, p=1e3)
        alarms = alarms_in(monitor, messages)
        assert alarms[500] == ("/imu.q",) and alarms[550] == ("/imu.p",)
        assert set(alarms) == set(range(500, 601)), "it comes back with a jump"


def test_its_memory_is_restored():
    messages = messages_of("/odom", yaw=wrapped(0.5 + 0.2 * np.sin(0.5 * TIME) + NOISE))
    monitor = train("gaussian", "tuned", [messages])
    monitor.start()
    for message in messages[:300]:
        monitor.judge(message)
    memory = monitor.memory()
    wild = messages[300]._replace(numbers={"yaw": np.nan})
    assert monitor.judge(wild) is not None
    monitor.restore(memory)
    assert all(monitor.judge(message) is None for message in messages[300:])
