"""The mock over UDP, as ``python -m pytest_otmcp.mocks otmcp_toy.mock_udp`` starts it."""

from pytest_otmcp.mocks.endpoint import Endpoint

from otmcp_toy.device import ToyDevice

ENDPOINTS = (Endpoint(name="registers", kind="udp"),)
create = ToyDevice


def warm() -> None:
    """Do nothing: nothing is slow here."""
