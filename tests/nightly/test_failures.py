"""The harness that lets system calls fail: a short run, and what it would notice."""

import errno
import os
import random
import time

import pytest

from mavfi.campaign import mission
from tests.nightly import failures, syscalls
from tests.nightly.failures import Point

_REASON = syscalls.why_not()
pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(_REASON), reason=_REASON)]


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return failures.undisturbed("instruction", tmp_path_factory.mktemp("golden"))


def test_a_campaign_whose_system_calls_fail_ends_well_or_says_what_failed(reference, tmp_path):
    draw = random.Random(4)
    failed = 0
    for number in range(3):
        point = failures.draw_point(reference, draw)
        _, count, wrong = failures.disturbed("instruction", tmp_path / str(number), reference, point)
        assert wrong == [], point
        failed += count
    assert failed > 0


def test_a_failure_that_is_stored_as_a_result_is_noticed(reference, tmp_path):
    def store_it():
        mission._check_recordable = lambda error, where: None

    point = Point("worker", "pipe2", 0, errno.EMFILE, "role")
    _, failed, wrong = failures.disturbed("instruction", tmp_path / "campaign", reference, point, store_it)
    assert failed and any(line.startswith("stored: ") and "unknown" in line for line in wrong)


def test_a_call_is_answered_with_the_error_that_was_chosen():
    def work():
        try:
            open("/")
        except OSError as error:
            return error.errno
        return 0

    def decide(call):
        return errno.ENOSPC if call.name == "openat" else 0

    assert syscalls.Supervised(work).serve(decide) == (errno.ENOSPC, False)
    assert syscalls.Supervised(work).serve(lambda call: 0) == (errno.EISDIR, False)


def test_a_process_that_outlives_its_parent_is_noticed():
    def work():
        if os.fork() == 0:
            time.sleep(60.0)
        return 0

    assert syscalls.Supervised(work).serve(lambda call: 0, patience=0.5) == (0, True)
