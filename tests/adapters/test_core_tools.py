"""Methods as tools: which methods become tools, in which order, and with which names."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import AdapterServer, Arguments, Call, tool
from pytest_otmcp.reference_adapters.core.tools import tools_of


class Nothing(Arguments):
    """No arguments."""


class Readers:
    """Tools that read."""

    @tool("toy.second")
    async def second(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Come first."""
        return {"from": type(self).__name__}

    async def helper(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Be no tool."""
        return {}

    @tool("toy.first")
    async def first(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Come second,
        in two lines."""
        return {}


class Writers(Readers):
    """The same tools, and one that writes."""

    @tool("toy.write", writes=True, idempotent=False)
    async def alter(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Come last."""
        return {}

    @tool("toy.other")
    async def second(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Replace the one of the base class."""
        return {}


async def close() -> None:
    """Close nothing."""


def server() -> AdapterServer:
    return AdapterServer(
        name="toy",
        version="1.0",
        protocol="toy",
        endpoint="toy://",
        writes_enabled=False,
        switch="WRITES",
        deadline_s=1.0,
        close=close,
    )


def test_declared_methods_are_the_tools_in_the_order_of_their_definition() -> None:
    found = tools_of(Readers(), "toy")
    assert [each.listing.name for each in found] == ["second", "first"]
    assert [each.listing.description for each in found] == ["Come first.", "Come second,\nin two lines."]
    assert [(each.operation, each.protocol, each.writes) for each in found] == [
        ("toy.second", "toy", False),
        ("toy.first", "toy", False),
    ]


def test_a_subclass_adds_tools_after_those_of_its_base_and_can_replace_one() -> None:
    found = tools_of(Writers(), "toy")
    assert [(each.listing.name, each.operation) for each in found] == [
        ("second", "toy.other"),
        ("first", "toy.first"),
        ("alter", "toy.write"),
    ]
    annotations = found[-1].listing.annotations
    assert annotations is not None
    assert (annotations.read_only_hint, annotations.destructive_hint, annotations.idempotent_hint) == (
        False,
        True,
        False,
    )


@pytest.mark.asyncio
async def test_a_tool_is_bound_to_its_object() -> None:
    call = Call(protocol="toy", operation="toy.second", endpoint="toy://", writes=False)
    (bound, _) = tools_of(Readers(), "toy")
    assert await bound.handler(call, Nothing()) == {"from": "Readers"}


def test_two_tools_of_one_name_are_refused() -> None:
    one = server()
    one.add(Readers())
    with pytest.raises(ValueError, match="two tools named second"):
        one.add(Writers())
