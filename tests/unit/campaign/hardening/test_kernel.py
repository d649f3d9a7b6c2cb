"""Protection of a function of one's own."""

import numpy as np
import pytest
from examples import harden_kernel as example

from mavfi.campaign.hardening.advise import FRACTIONS
from mavfi.campaign.hardening.kernel import harden, see
from mavfi.campaign.hardening.target import Target
from mavfi.errors import BadInputError
from mavfi.faults.instruction.api import digest
from mavfi.hardening.recorded import copied
from tests.unit.hardening.kernels import CASES


@pytest.mark.slow  # builds many variants of the kernel
def test_the_example_protects_its_kernel_and_certifies_it(capsys):
    example.main(30, budget=9.0)  # on a busy machine, the times that are measured vary
    printed = capsys.readouterr().out.splitlines()
    assert 3 < len([line for line in printed if line.startswith("time x")]) <= len(FRACTIONS) + 1
    assert printed[-3].startswith("chosen: ") and "prediction" in printed[-2]
    assert float(printed[-1].rpartition(" ")[2]) > 0


def test_calls_of_several_types_or_none_are_refused():
    own = (np.zeros((4, 3)), np.zeros(3), 0.5, np.zeros(3))
    with pytest.raises(BadInputError, match="calls of 0 types"):
        see(example.follow, [])
    with pytest.raises(BadInputError, match="calls of 2 types"):
        see(example.follow, [own, (*own[:3], np.zeros(3, np.float32))])


@pytest.mark.parametrize("budget", [-0.3, "x", float("nan"), float("inf"), None])
def test_a_budget_that_is_no_share_is_refused(budget):
    with pytest.raises(BadInputError, match=r"^budget: .*: allowed: a number from 0 on, e.g. 0.2"):
        harden(example.follow, [], budget)


def test_calls_of_libm_are_protected_only_if_asked_for():
    kernel, args = CASES["blend"]
    seen = see(kernel, [args])
    plain, more = (Target(("own",), seen, libm=libm).values for libm in (False, True))
    added = {value.site for value in more} - {value.site for value in plain}
    assert len(added) == len(more) - len(plain) > 0
    assert {value.opcode for value in more if value.site in added} == {"call"}


@pytest.mark.slow
def test_a_protection_with_libm_and_addresses_finds_its_code_again():
    kernel, args = CASES["blend"]
    found = harden(kernel, [args], budget=99.0, faults=40, addresses=True, libm=True)
    assert found.planned.libm and found.planned.addresses and found.planned.sites
    own, plain = copied(args), copied(args)
    assert digest((found.code(own)(*own), own)) == digest((kernel(*plain), plain))
