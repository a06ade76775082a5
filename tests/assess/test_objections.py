"""What a tool's schema objects to in a refused call; a schema is the adapter's, and may be broken or name addresses."""

from __future__ import annotations

import asyncio
import socket
from typing import Any
from urllib.parse import urlsplit

import pytest

from pytest_otmcp.assess.campaign import _objected
from pytest_otmcp.assess.served import serve
from pytest_otmcp.session.loopback import HOST

from .test_scoring import call

SCHEMA = {
    "properties": {"address": {"type": "integer"}, "value": {"maximum": 9}},
    "required": ["unit"],
    "additionalProperties": False,
}


def test_the_arguments_that_a_schema_objects_to_are_told() -> None:
    assert _objected(call(success=False, address=1, value=10, unit=1), SCHEMA) == {"value", "unit"}
    assert _objected(call(success=False, address=1, more=1), SCHEMA) == {"more", "unit"}


@pytest.mark.parametrize(
    "schema",
    [
        {"$ref": "#/nope"},
        {"$ref": "file:///etc/hostname"},
        {"$schema": 5},
        {"$schema": []},
        {"$ref": "#"},
        {"properties": {"name": {"pattern": "("}}},
        {"$schema": "http://json-schema.org/draft-03/schema#", "required": True, "additionalProperties": False},
        {"type": 5},
    ],
)
def test_a_broken_schema_objects_to_nothing(schema: dict[str, Any]) -> None:
    assert _objected(call(success=False, name="x"), schema) == set()


def test_nothing_that_a_schema_names_is_fetched() -> None:
    with socket.create_server((HOST, 0)) as server:
        server.setblocking(False)
        url = f"http://{HOST}:{server.getsockname()[1]}/leak"
        assert _objected(call(success=False, value=1), {"$ref": url}) == set()
        with pytest.raises(BlockingIOError):
            server.accept()


def test_an_assistant_can_connect_as_soon_as_it_is_told_the_address() -> None:
    async def connect() -> None:
        async with serve({"modbus": None}) as served:  # type: ignore[dict-item]
            # Nothing has given the server a chance to run.
            socket.create_connection((HOST, urlsplit(served.urls["modbus"]).port or 0)).close()

    asyncio.run(connect())
