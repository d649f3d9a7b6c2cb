"""CRC-32C against its published check value, and against a division bit by bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavfi.numerics.crc import crc32c


def sum_of(content, before=0):
    return crc32c(np.frombuffer(content, np.uint8), before)


def naive(content):
    value = 0xFFFFFFFF
    for byte in content:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0x82F63B78 * (value & 1)
    return value ^ 0xFFFFFFFF


def test_published_values():
    """Check value of the catalogue of parametrised CRCs; RFC 3720, appendix B.4."""
    assert sum_of(b"123456789") == 0xE3069283
    assert sum_of(bytes(32)) == 0x8A9136AA
    assert sum_of(b"\xff" * 32) == 0x62A8AB43
    assert sum_of(bytes(range(32))) == 0x46DD794E
    assert sum_of(b"") == 0


@given(st.binary(max_size=80), st.integers(0, 80))
def test_it_is_the_remainder_of_a_division_in_one_piece_or_two(content, cut):
    assert sum_of(content) == naive(content) == sum_of(content[cut:], sum_of(content[:cut]))


@given(st.binary(min_size=1, max_size=200), st.data())
def test_one_flipped_bit_is_always_seen(content, data):
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    struck = bytearray(content)
    struck[bit // 8] ^= 1 << bit % 8
    assert sum_of(bytes(struck)) != sum_of(content)
