"""What a ledger says of missions."""

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.hardening.summary import harm_of


class Empty:
    """Runs without a fault in an instruction."""

    def __init__(self):
        self.injected = self

    def where(self, *_, **__):
        return []


def test_a_ledger_without_faults_in_instructions_is_refused():
    with pytest.raises(BadInputError, match="no flight with a fault in an instruction is done"):
        harm_of(Empty())
