"""Protection of a function of one's own."""

import numpy as np
import pytest
from examples import harden_kernel as example

from mavfi.campaign.hardening.advise import FRACTIONS
from mavfi.campaign.hardening.kernel import see
from mavfi.errors import BadInputError


@pytest.mark.slow  # builds many variants of the kernel
def test_the_example_protects_its_kernel_and_certifies_it(capsys):
    example.main(30, budget=9.0)  # on a busy machine, the times that are measured vary
    printed = capsys.readouterr().out.splitlines()
    assert len([line for line in printed if line.startswith("time x")]) == len(FRACTIONS) + 1
    assert printed[-3].startswith("chosen: ") and "prediction" in printed[-2]
    assert float(printed[-1].rpartition(" ")[2]) > 0


def test_calls_of_several_types_or_none_are_refused():
    own = (np.zeros((4, 3)), np.zeros(3), 0.5, np.zeros(3))
    with pytest.raises(BadInputError, match="calls of 0 types"):
        see(example.follow, [])
    with pytest.raises(BadInputError, match="calls of 2 types"):
        see(example.follow, [own, (*own[:3], np.zeros(3, np.float32))])
