"""Tapes of kernels and detectors: what one was like at an instant of a real flight, and what happened to it next.

A tape is played again with one bit flipped: of an input, or of the memory.
"""

import copy
from dataclasses import dataclass

import numpy as np

from mavfi.config import EnvironmentConfig
from mavfi.detectors.detector import part_of
from mavfi.detectors.registry import detector_names, of_monitored_fields
from mavfi.flight.compose import detector_for, new_loop, resolve
from mavfi.levels.memory.injector import ArrayMemory
from mavfi.mission import MissionSpec
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.ppc import build_pipeline
from mavfi.pipeline.words import change, words_of
from mavfi.sim.environments.world import World
from mavfi.states import WATCHING

LENGTH = 3
"""Steps on a tape."""
PER_KERNEL = 6
"""Tapes of each kernel and autopilot profile."""
WATCHED_LENGTH = 250
"""Publications on the tape of a detector."""
INSTANTS = 8
"""Tapes of each detector and autopilot profile."""
AUTOPILOTS = ("published", "hardened")
ESTIMATOR = "state_estimation"
FLIGHTS = (
    *((autopilot, {}) for autopilot in AUTOPILOTS),
    ("hardened", {"map": "octree", "planner": "rrt_star"}),
    ("hardened", {"localization": "estimator"}),
)
"""Autopilot profiles and keys of missions; of the last one, only the kernel that the others do not have is taped."""


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
class KernelTape:
    """A kernel and what happened to it: ("receive", state, time) and ("step", None, time)."""

    name: str
    autopilot: str
    kernel: object
    events: list

    def play(self, random):
        """Yields the label of the flip first, then what each step gives."""
        kernel = copy.deepcopy(self.kernel, constants(self.kernel))
        inputs = [i for i, (kind, state, _) in enumerate(self.events) if kind == "receive" and _size(state)]
        struck_input = struck_memory = -1
        if inputs and random.random() < 0.5:
            struck_input = inputs[int(random.integers(len(inputs)))]
        else:
            struck_memory = int(random.integers(len(self.events)))
        for i, (kind, state, time_us) in enumerate(self.events):
            if i == struck_memory:
                yield f"memory before event {i}: {flip_memory(kernel, random)}"
            if kind == "step":
                yield kernel.step(time_us)
                continue
            if i == struck_input:
                state = state.copy()
                yield f"input {i}: {flip_state(state, random)}"
            kernel.receive(state, time_us)


@dataclass
class DetectorTape:
    """A detector and what it saw from an instant on; `name` is the part that is struck."""

    name: str
    autopilot: str
    detector: object
    memory: object
    events: list

    def play(self, random):
        """Yields the label of the flip first, then what each check says."""
        self.detector.restore(self.memory)
        holder = ArrayMemory(part_of(self.detector, self.name))
        yield f"{self.name}.{flip_memory(holder, random)}"
        for state, time_us in self.events:
            yield self.detector.check(state, time_us)
            self.detector.accept(state, time_us)


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
            tape = KernelTape(
                self._kernel.name, self._autopilot, copy.deepcopy(self._kernel, constants(self._kernel)), []
            )
            self.tapes.append(tape)
            self._open.append(tape)
        self._steps += 1
        return result


def constants(thing):
    """Memo for `copy.deepcopy`: what is never written, shared by all copies."""
    return {id(value): value for value in vars(thing).values() if isinstance(value, PipelineConfig)}


def record(seed=3, recorders=()):
    """Tapes of every kernel and detector in both autopilot profiles, of an octree, and of the state estimator."""
    tapes = []
    for autopilot, keys in FLIGHTS:
        world = EnvironmentConfig(name="yard", generator="tests.nightly.tapes:yard")
        scenario = resolve(MissionSpec(environment="sparse", seed=seed, autopilot=autopilot, **keys))
        takers, published = [], []

        def build_taping(config, takers=takers, autopilot=autopilot):
            kernels = build_pipeline(config)
            often = {"waypoint": 60, "pid": 60, "planner": 1, "trajectory": 1, ESTIMATOR: 149}
            for name, kernel in kernels.items() if ESTIMATOR not in kernels else [(ESTIMATOR, kernels[ESTIMATOR])]:
                kernels[name] = Taping(kernel, autopilot, range(0, 1000, often.get(name, 4)))
                takers.append(kernels[name])
            return kernels

        loop = new_loop(scenario.model_copy(update={"environment": world}), make_kernels=build_taping)
        loop.taps.recorders += [*recorders, lambda state, time_us, to=published: to.append((state.copy(), time_us))]
        loop.fly()
        for taker in takers:
            tapes += [tape for tape in taker.tapes if any(kind == "step" for kind, _, _ in tape.events)][:PER_KERNEL]
        if "planner" not in keys:  # detectors see the same of any planner
            tapes += _watching(scenario, autopilot, keys.get("localization", "truth"), published)
    return tapes


def _watching(scenario, autopilot, localization, published):
    """Tapes of every detector with injectable memory, in both profiles; with the estimator of the acceptance test,
    which then remembers more."""
    tapes = []
    detectors = [name for name in WATCHING if name in detector_names()]
    apart = len(published) // (INSTANTS + 1)
    for kind in detectors if localization == "truth" else ["acceptance"]:
        for profile in ("paper", "tuned") if kind in of_monitored_fields() else ("paper",):
            detector, _ = detector_for(scenario, kind, profile)
            parts = [name for name in WATCHING if part_of(detector, name) is not None]
            detector.start()
            for number, (state, time_us) in enumerate(published):
                if number and number % apart == 0:
                    events = published[number : number + WATCHED_LENGTH]
                    tapes += [DetectorTape(name, autopilot, detector, detector.memory(), events) for name in parts]
                detector.check(state, time_us)
                detector.accept(state, time_us)
    return tapes


def _size(state):
    return state.header.size + state.elements.size


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


def flip_memory(owner, random):
    """Flip one bit of a kernel's or detector's memory; says where."""
    names = [words for words in words_of(owner) if words.count]
    words = names[int(random.integers(len(names)))]
    index = int(random.integers(words.count))
    before, after = change(owner, words.name, index, lambda word: flip_array(word, random))
    return f"{words.name}[{index}]: {before} to {after}"


def flip_state(state, random):
    """Flip one bit of one field of a message; says where."""
    in_elements = state.elements.size and random.random() < 0.5
    array = state.elements if in_elements else state.header
    name = array.dtype.names[int(random.integers(len(array.dtype.names)))]
    column = array[name].copy()
    where = flip_array(column, random)
    array[name] = column
    return f"{state.spec.name}.{name}{where}"
