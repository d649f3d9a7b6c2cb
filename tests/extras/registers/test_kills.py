"""SIGKILL of the tracer: a target that is not stepped survives; one that is stepped dies, by the kernel's rules."""

import os
import random
import signal

import pytest

from mavfi.extras.registers.ptrace import Tracee
from tests.nightly import tracers

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", tracers.TARGETS)
def test_a_target_that_is_not_stepped_survives_its_tracer(targets, name):
    wrong, hits = tracers.strike(targets, name, 20, random.Random(6), tracers.STEPLESS)
    assert wrong == [] and hits == 20


@pytest.mark.parametrize("steps", [0, 1])
def test_a_step_of_a_tracer_that_dies_is_deadly(spin, steps):
    """Else the documentation is too cautious."""
    tracer = os.fork()
    if tracer == 0:
        try:
            tracee = Tracee(spin.pid)
            tracee.interrupt(2.0)
            for _ in range(steps):
                tracee.step(2.0)
            os.kill(os.getpid(), signal.SIGKILL)
        finally:
            os._exit(1)
    assert os.waitpid(tracer, 0)[1] == signal.SIGKILL
    assert tracers.survives(spin) == ("it ended with -5" if steps else "")
