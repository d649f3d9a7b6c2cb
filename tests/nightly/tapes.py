"""Tapes of kernels: what a kernel was like at an instant of a real flight, and what it received and did next.

A tape is played again with one bit of an input, or of the kernel's memory between two events, flipped.
"""

import copy
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np

from mavfi.config import EnvironmentConfig
from mavfi.flight.compose import new_loop, resolve
from mavfi.mission import MissionSpec
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.ppc import build_pipeline
from mavfi.sim.environments.world import World
from mavfi.states import State

LENGTH = 3
"""Steps on a tape."""
PER_KERNEL = 6
"""Tapes of each kernel and autopilot profile."""
AUTOPILOTS = ("published", "hardened")
ESTIMATOR = "state_estimation"
FLIGHTS = (*((autopilot, "truth") for autopilot in AUTOPILOTS), ("hardened", "estimator"))
"""Of the last one, only the kernel that the others do not have is taped."""
_WORD = {float: 64, int: 32, bool: 1}


def yard(seed, start=None, goal=None):
    """A small world with something in the way, so that maps are small and plans are many."""
    random = np.random.default_rng(seed)
    corner = random.uniform((7.0, -6.0), (19.0, 5.0), (9, 2))
    lower = np.column_stack([corner, np.zeros(9)])
    upper = np.column_stack([corner + random.uniform(0.8, 2.5, (9, 2)), random.uniform(3.0, 8.0, 9)])
    ends = [np.array(end, float) for end in (start or (3.0, 0.0, 3.0), goal or (25.0, 0.0, 3.0))]
    return World(
        *ends,
        np.array([0.0, -8.0, 0.0]),
        np.array([28.0, 8.0, 8.0]),
        np.array([1.0, -7.0, 1.6]),
        np.array([27.0, 7.0, 6.5]),
        lower,
        upper,
    )


@dataclass
class Tape:
    """A kernel and what happened to it: ("receive", state, time) and ("step", None, time)."""

    name: str
    autopilot: str
    kernel: object
    events: list


class Taping:
    """Stands in a kernel's place and tapes what happens to it at some of its steps."""

    def __init__(self, kernel, autopilot, begin_at):
        self._kernel, self._autopilot, self._begin_at = kernel, autopilot, set(begin_at)
        self._steps, self._open, self.tapes = 0, [], []

    def __getattr__(self, name):
        return getattr(self._kernel, name)

    def _note(self, event):
        for tape in self._open:
            tape.events.append(event)

    def receive(self, state, time_us):
        self._note(("receive", state.copy(), time_us))
        return self._kernel.receive(state, time_us)

    def step(self, time_us):
        self._note(("step", None, time_us))
        done = [tape for tape in self._open if sum(kind == "step" for kind, _, _ in tape.events) >= LENGTH]
        self._open = [tape for tape in self._open if tape not in done]
        result = self._kernel.step(time_us)
        if self._steps in self._begin_at:
            tape = Tape(self._kernel.name, self._autopilot, copy.deepcopy(self._kernel, constants(self._kernel)), [])
            self.tapes.append(tape)
            self._open.append(tape)
        self._steps += 1
        return result


def constants(thing):
    """Memo for `copy.deepcopy`: what is never written, shared by all copies."""
    return {id(value): value for value in vars(thing).values() if isinstance(value, PipelineConfig)}


def record(seed=3, recorders=()):
    """Tapes of every kernel in both autopilot profiles, and of the state estimator, from take-off on."""
    tapes = []
    for autopilot, localization in FLIGHTS:
        world = EnvironmentConfig(name="yard", generator="tests.nightly.tapes:yard")
        scenario = resolve(MissionSpec(environment="sparse", seed=seed, autopilot=autopilot, localization=localization))
        scenario = scenario.model_copy(update={"environment": world})
        takers = []

        def build_taping(config, takers=takers, autopilot=autopilot):
            kernels = build_pipeline(config)
            often = {"waypoint": 60, "pid": 60, "planner": 1, "trajectory": 1, ESTIMATOR: 149}
            for name, kernel in kernels.items() if ESTIMATOR not in kernels else [(ESTIMATOR, kernels[ESTIMATOR])]:
                kernels[name] = Taping(kernel, autopilot, range(0, 1000, often.get(name, 4)))
                takers.append(kernels[name])
            return kernels

        loop = new_loop(scenario, make_kernels=build_taping)
        loop.taps.recorders.extend(recorders)
        loop.fly()
        for taker in takers:
            tapes += [tape for tape in taker.tapes if any(kind == "step" for kind, _, _ in tape.events)][:PER_KERNEL]
    return tapes


# ---- bits --------------------------------------------------------------------------------------------------------
def flip_array(array, random):
    """Flip one bit of one element; says where."""
    element = int(random.integers(array.size))
    size = array.dtype.itemsize
    bit = 0 if array.dtype.kind == "b" else int(random.integers(8 * size))
    raw = np.ascontiguousarray(array).view(np.uint8).reshape(array.size, size)
    raw[element, bit // 8] ^= np.uint8(1 << bit % 8)
    array.reshape(-1)[:] = raw.reshape(-1).view(array.dtype)
    return f"[{element}] bit {bit}"


def flipped_number(value, random):
    """The number with one bit flipped, as a word of its kind holds it."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        word = np.array([(value + 2**31) % 2**32 - 2**31], np.int32)
        flip_array(word, random)
        return int(word[0])
    word = np.array([value])
    flip_array(word, random)
    return float(word[0])


def places(kernel):
    """Everything in a kernel's memory that can be struck: (label, strike) pairs."""
    found = []
    _walk(kernel, type(kernel).__name__, found, set())
    return found


def _walk(owner, label, found, seen):
    if id(owner) in seen:
        return
    seen.add(id(owner))
    for name in _attributes(owner):
        value = getattr(owner, name)
        where = f"{label}.{name}"
        if isinstance(value, PipelineConfig):
            continue  # inputs given once are not memory of the kernel
        if isinstance(value, np.ndarray):
            found += _array(name, value, where)
        elif isinstance(value, bool | int | float):
            found.append((where, lambda random, owner=owner, name=name: _strike_number(owner, name, random)))
        elif isinstance(value, State):
            found += _state(value, where)
        elif is_dataclass(value) and type(value).__dataclass_params__.frozen:
            found += _frozen(owner, name, value, where)
        elif _is_own(value):
            _walk(value, where, found, seen)


def _array(name, array, where):
    if not (array.size and array.flags.writeable and array.flags.c_contiguous) or "offsets" in name:
        return []
    return [(where, lambda random: flip_array(array, random))]


def _state(state, where):
    parts = {name: getattr(state, name) for name in ("header", "elements")}
    return [
        (f"{where}.{name}", lambda random, array=array: flip_record(array, random))
        for name, array in parts.items()
        if array.size
    ]


def _attributes(owner):
    names = list(getattr(owner, "__slots__", ())) + list(getattr(owner, "__dict__", ()))
    return [name for name in names if hasattr(owner, name)]


def _is_own(value):
    return type(value).__module__.startswith("mavfi.pipeline") and not isinstance(value, tuple)


def _strike_number(owner, name, random):
    value = flipped_number(getattr(owner, name), random)
    setattr(owner, name, value)
    return f" = {value}"


def _frozen(owner, name, memory, where):
    """A memory that is replaced, never changed."""

    def strike(random, part):
        value = getattr(getattr(owner, name), part)
        if isinstance(value, tuple):
            index = int(random.integers(len(value)))
            value = (*value[:index], flipped_number(value[index], random), *value[index + 1 :])
        else:
            value = flipped_number(value, random)
        setattr(owner, name, replace(getattr(owner, name), **{part: value}))
        return f" = {value}"

    parts = [part.name for part in fields(memory) if isinstance(getattr(memory, part.name), bool | int | float | tuple)]
    return [(f"{where}.{part}", lambda random, part=part: strike(random, part)) for part in parts]


def flip_record(array, random):
    """Flip one bit of one field of a structured array."""
    name = array.dtype.names[int(random.integers(len(array.dtype.names)))]
    column = array[name].copy()
    where = flip_array(column, random)
    array[name] = column
    return f".{name}{where}"


# ---- playing -----------------------------------------------------------------------------------------------------
def play(tape, random):
    """Play a tape with one bit flipped; yields the label of the strike first, then what each step gives."""
    kernel = copy.deepcopy(tape.kernel, constants(tape.kernel))
    inputs = [i for i, (kind, state, _) in enumerate(tape.events) if kind == "receive" and _size(state)]
    memory_at = int(random.integers(len(tape.events)))
    strike_input = inputs and random.random() < 0.5
    struck = inputs[int(random.integers(len(inputs)))] if strike_input else -1
    for i, (kind, state, time_us) in enumerate(tape.events):
        if not strike_input and i == memory_at:
            targets = places(kernel)
            label, strike = targets[int(random.integers(len(targets)))]
            yield f"memory before event {i}: {label}{strike(random)}"
        if kind == "step":
            yield kernel.step(time_us)
            continue
        if i == struck:
            state = state.copy()
            part = _part(state, random)
            yield f"input {i}: {state.spec.name}{flip_record(part, random)}"
        kernel.receive(state, time_us)


def _size(state):
    return state.header.size + state.elements.size


def _part(state, random):
    return state.elements if state.elements.size and random.random() < 0.5 else state.header
