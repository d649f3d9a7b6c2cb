import pytest

from mavfi.errors import BadInputError
from mavfi.faults.strata import HEADLINE, WORD_BITS, bit_class, bits_of, word_share
from mavfi.states import Field


@pytest.mark.parametrize(
    ("dtype", "stratum", "bits"),
    [
        ("f8", "sign_exponent", range(52, 64)),
        ("f8", "mantissa", range(52)),
        ("f8", "sign", range(63, 64)),
        ("f8", "exponent", range(52, 63)),
        ("f4", "mantissa", range(23)),
        ("i4", "sign_exponent", range(31, 32)),
        ("i4", "mantissa", range(31)),
        ("u8", "sign_exponent", range(0)),
        ("u1", "mantissa", range(8)),
        ("?", "sign_exponent", range(1)),
        ("f8", "exponent_field", range(52, 63)),
        ("i4", "exponent_field", range(31)),
        ("f8", "word", range(64)),
    ],
)
def test_bits_of_each_stratum(dtype, stratum, bits):
    assert bits_of(Field("f", dtype, "-"), stratum) == bits


@pytest.mark.parametrize("dtype", WORD_BITS)
def test_the_two_strata_part_every_word_and_lengths_have_their_own(dtype):
    field = Field("f", dtype, "-")
    every = [bit for stratum in ("mantissa", HEADLINE, "length") for bit in bits_of(field, stratum)]
    assert every == list(range(WORD_BITS[dtype]))
    assert ("length" in {bit_class(field, bit) for bit in every}) == (dtype == "u4")
    assert sum(word_share(field, stratum) for stratum in ("mantissa", HEADLINE, "length")) == 1


def test_unknown_stratum_is_refused():
    with pytest.raises(BadInputError, match="allowed: sign_exponent, mantissa"):
        bits_of(Field("f", "f8", "m"), "high")
