"""Clients of a vehicle with PX4's modes, on the ground and in the air."""

import pytest


@pytest.fixture
def client():
    from tests.extras.mavlink.client import Client  # needs pymavlink

    return Client()


@pytest.fixture
def flying(client):
    client.fly_up()
    return client
