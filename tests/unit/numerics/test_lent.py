"""Headers lent to compiled code: it reads and writes the same memory as with an array, and refuses all else."""

import sys
from typing import Any

import numba
import numpy as np
import pytest

from mavfi.numerics.jit import entry, short_jit
from mavfi.numerics.lent import content_of, header_of, lent
from mavfi.states import STATES, new_state

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="lent to compiled code only")


@short_jit
def _twice(header: Any) -> float:
    header_of(header)[0]["vx"] *= 2.0
    return header_of(header)[0]["vx"]


@short_jit
def _sum(header: Any) -> int:
    return content_of(header).sum()


@short_jit
def _length(header: Any) -> int:
    return content_of(header).size


@pytest.fixture
def command():
    header = new_state("control.command").header
    header["vx"] = 1.5
    return header


def test_the_memory_is_that_of_the_header(command):
    twice = entry(_twice, lent(command))
    assert twice(command) == 3.0 == command["vx"][0]


@pytest.mark.parametrize("name", sorted(STATES))
def test_the_bytes_are_those_of_the_header(name):
    header = new_state(name).header
    header.view(np.uint8)[:] = np.random.default_rng(3).integers(0, 256, header.nbytes)
    assert entry(_sum, lent(header))(header) == header.view(np.uint8).sum()
    assert entry(_length, lent(header))(header) == header.nbytes


def test_a_record_of_an_array_is_lent_alone(command):
    records = np.repeat(command, 3)
    assert entry(_twice, lent(command))(records[1:2]) == 3.0
    assert records["vx"].tolist() == [1.5, 3.0, 1.5]


def test_no_reference_is_kept(command):
    twice, before = entry(_twice, lent(command)), sys.getrefcount(command)
    for _ in range(100):
        twice(command)
    assert sys.getrefcount(command) == before


def others():
    header = new_state("control.command").header
    return {
        "None": None, "a list": [1.0], "bytes": header.tobytes(), "a record": header[0],
        "another state": new_state("planning.waypoint").header, "no record": header[:0],
        "two records": np.repeat(header, 2), "a table": header.reshape(1, 1), "every second": np.repeat(header, 2)[::2],
    }  # fmt: skip


def test_a_list_lends_its_last_item(command):
    twice, place = entry(_twice, lent(command, listed=True)), [command]
    assert twice(place) == 3.0
    place.append(command.copy())
    assert twice(place) == 6.0 and command["vx"][0] == 3.0
    for other in (command, [], (command,), [None], [command, None]):
        with pytest.raises(TypeError, match="not an array of one record of"):
            twice(other)


@pytest.mark.parametrize("kind", sorted(others()))
def test_anything_else_is_refused(command, kind):
    with pytest.raises(TypeError, match="not an array of one record of"):
        entry(_twice, lent(command))(others()[kind])
