"""What a published state passes, and in which order."""

from mavfi.flight.taps import CHECKED_AT_PRODUCER, Taps
from mavfi.states import new_state


class Injector:
    spent = False

    def __init__(self, seen, answer):
        self.seen, self.answer = seen, answer

    def __call__(self, state, time_us):
        self.seen.append(("injector", state, time_us))
        return self.answer

    def finish(self):
        return []


def test_the_order_is_injector_detector_recorders_and_each_sees_what_the_one_before_gave():
    seen, published, injected = [], new_state("control.command"), new_state("control.command")

    def detector(state, time_us):
        seen.append(("detector", state, time_us))
        return state

    taps = Taps(Injector(seen, injected), detector, [lambda s, t: seen.append(("recorder", s, t))])
    assert taps(published, 7) is injected
    assert [(who, time_us) for who, _, time_us in seen] == [("injector", 7), ("detector", 7), ("recorder", 7)]
    assert seen[0][1] is published and seen[1][1] is seen[2][1] is injected


def test_a_detector_at_the_producer_sees_neither_the_fault_nor_the_loss():
    seen, published, injected = [], new_state("control.command"), new_state("control.command")

    def detector(state, time_us):
        seen.append(state)
        return state

    at_producer = {"checked_at_producer": CHECKED_AT_PRODUCER["published"]}
    taps = Taps(Injector([], injected), detector, **at_producer)
    assert taps(published, 7) is injected and seen == [published]
    path = new_state("planning.path")
    assert taps(path, 7) is injected and seen == [published, injected]
    losses = []
    lost = Taps(Injector([], None), detector, answer_loss=lambda s, t: True, note_loss=lambda s, t: losses.append(s))
    assert lost(published, 7) is None and losses == []
    lost.checked_at_producer = CHECKED_AT_PRODUCER["producer"]
    assert lost(published, 7) is None and losses == [published]


def test_what_is_lost_or_held_back_nobody_sees():
    seen, state = [], new_state("control.command")
    lost = Taps(Injector(seen, None), lambda s, t: seen.append("detector"), [lambda s, t: seen.append("recorder")])
    assert lost(state, 7) is None and len(seen) == 1
    held = Taps(None, lambda s, t: None, [lambda s, t: seen.append("recorder")])
    assert held(state, 7) is None and len(seen) == 1


def test_a_detector_is_shown_what_it_watches():
    seen, state, other = [], new_state("control.command"), new_state("control.tracking")
    taps = Taps(None, lambda s, t: seen.append(s), watched=frozenset(["control.command"]))
    assert taps(other, 7) is other and taps(state, 8) is None
    assert seen == [state]
