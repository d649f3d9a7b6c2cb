"""SIGKILL of the tracer: a target that is not stepped survives; one that is stepped dies, by the kernel's rules."""

import random

import pytest

from tests.nightly import tracers

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", tracers.TARGETS)
def test_a_target_that_is_not_stepped_survives_its_tracer(targets, name):
    wrong, hits = tracers.strike(targets, name, 20, random.Random(6), tracers.STEPLESS)
    assert wrong == [] and hits == 20
