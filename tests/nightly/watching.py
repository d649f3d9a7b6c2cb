"""Tapes of detectors: what one remembered at instants of a real flight, and what was published next.

A tape is played again with one bit of the memory flipped.
"""

from dataclasses import dataclass

from mavfi.config import EnvironmentConfig
from mavfi.detectors.detector import part_of
from mavfi.detectors.registry import detector_names, of_monitored_fields
from mavfi.flight.compose import detector_for, new_loop, resolve
from mavfi.flight.memory_faults import DetectorMemory
from mavfi.mission import MissionSpec
from mavfi.pipeline.words import change, words_of
from mavfi.states import BASELINES, WATCHING
from tests.nightly.tapes import FLIGHTS, flip_array

LENGTH = 250
"""Publications on a tape."""
INSTANTS = 8
"""Tapes of each detector and autopilot profile."""


@dataclass
class Watched:
    """A detector and what it saw from an instant on; `name` is the part that is struck."""

    name: str
    autopilot: str
    detector: object
    memory: object
    events: list


def published(autopilot, localization="truth", seed=3):
    """The publications of a flight, and its scenario."""
    scenario = resolve(MissionSpec(environment="sparse", seed=seed, autopilot=autopilot, localization=localization))
    world = EnvironmentConfig(name="yard", generator="tests.nightly.tapes:yard")
    loop = new_loop(scenario.model_copy(update={"environment": world}))
    events = []
    loop.taps.recorders.append(lambda state, time_us: events.append((state.copy(), time_us)))
    loop.fly()
    return scenario, events


def record_watching():
    """Tapes of every detector with injectable memory, in both profiles of detector and autopilot; with an estimator of
    the acceptance test, which then remembers more."""
    tapes = []
    for autopilot, localization in FLIGHTS:
        scenario, events = published(autopilot, localization)
        every = [name for name in WATCHING if name in detector_names() and name not in BASELINES]
        for whole in every if localization == "truth" else ["acceptance"]:
            for profile in ("paper", "tuned") if whole in of_monitored_fields() else ("paper",):
                detector, _ = detector_for(scenario, whole, profile)
                names = [name for name in WATCHING if part_of(detector, name) is not None]
                detector.start()
                apart = len(events) // (INSTANTS + 1)
                for place, (state, time_us) in enumerate(events):
                    if place and place % apart == 0:
                        seen = events[place : place + LENGTH]
                        tapes += [Watched(name, autopilot, detector, detector.memory(), seen) for name in names]
                    detector.check(state, time_us)
                    detector.accept(state, time_us)
    return tapes


def play_watching(tape, random):
    """Play a tape with one bit flipped; yields the label of the strike first, then what each check says."""
    tape.detector.restore(tape.memory)
    holder = DetectorMemory(part_of(tape.detector, tape.name))
    every = [words for words in words_of(holder) if words.count]
    words = every[int(random.integers(len(every)))]
    index = int(random.integers(words.count))
    before, after = change(holder, words.name, index, lambda word: flip_array(word, random))
    yield f"{tape.name}.{words.name}[{index}]: {before} to {after}"
    for state, time_us in tape.events:
        yield tape.detector.check(state, time_us)
        tape.detector.accept(state, time_us)
