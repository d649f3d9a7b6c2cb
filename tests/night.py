"""What `make test` leaves to `make nightly ONLY=settings`: repetitions in another setting, each of them long."""

import pytest


def at_night(*values):
    """Values of a parametrized test, tuples for several arguments, that are flown at night only."""
    return [
        pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.long) for value in values
    ]
