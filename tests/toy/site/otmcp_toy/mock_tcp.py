"""The mock over TCP, as ``python -m pytest_otmcp.mocks otmcp_toy.mock_tcp`` starts it."""

from pytest_otmcp.mocks.endpoint import Endpoint

from otmcp_toy.device import ToyDevice

ENDPOINTS = (Endpoint(name="registers", kind="tcp"),)
create = ToyDevice


def warm() -> None:
    """Do nothing: nothing is slow here."""
