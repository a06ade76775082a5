"""The mock over TCP, as ``python -m pytest_otmcp.mocks otmcp_toy.mock_tcp`` starts it."""

from otmcp_toy.device import ToyDevice
from pytest_otmcp.mocks.endpoint import Endpoint

ENDPOINTS = (Endpoint(name="registers", kind="tcp"),)
create = ToyDevice


def warm() -> None:
    """Nothing is slow here."""
