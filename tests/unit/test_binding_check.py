"""A subject file is compared with the tools that the adapter lists, before anything is measured with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.subject import load_subject
from pytest_otmcp.subject.binding_check import check_bindings

HEAD = """
[subject]
name = "x"
version = "1"
[adapter.modbus]
command = ["adapter"]
answer = "text"
"""
FILE = (
    HEAD
    + """
connect = { tool = "open", arguments = { host = "{host}" } }
[adapter.modbus.bind.read_holding]
tool = "read_registers"
arguments = { addres = "$address", count = "$count" }
result = { values = {} }
"""
)


def tool(*required: str, optional: str = "", **more: Any) -> dict[str, Any]:
    names = [*required, *optional.split()]
    return {"inputSchema": {"type": "object", "properties": {n: {} for n in names}, "required": list(required), **more}}


def found(tmp_path: Path, **tools: dict[str, Any]) -> list[str]:
    (tmp_path / "otmcp.toml").write_text(FILE, encoding="utf-8")
    return check_bindings(load_subject(tmp_path / "otmcp.toml").adapters["modbus"], tools)


def test_what_fits_is_not_mentioned(tmp_path: Path) -> None:
    assert found(tmp_path, read_registers=tool("addres", "count"), open=tool("host")) == []


def test_a_tool_that_is_not_there_is_named_with_its_neighbour(tmp_path: Path) -> None:
    (missing,) = found(tmp_path, read_register=tool("addres", "count"), open=tool("host"))
    assert missing == (
        "adapter.modbus.bind.read_holding.tool: the adapter lists no tool 'read_registers'; did you mean 'read_register'?"
    )


def test_a_misspelt_argument_is_found_although_servers_may_swallow_it(tmp_path: Path) -> None:
    unknown, lacking = found(tmp_path, read_registers=tool("address", optional="count"), open=tool("host"))
    assert "arguments.addres: the tool 'read_registers' has no such argument; did you mean 'address'?" in unknown
    assert "the tool 'read_registers' requires 'address'" in lacking


@pytest.mark.parametrize("schema", [{"additionalProperties": True}, {"anyOf": [{}]}], ids=["open", "alternatives"])
def test_a_schema_that_takes_more_than_it_names_is_believed(tmp_path: Path, schema: dict[str, Any]) -> None:
    assert found(tmp_path, read_registers=tool("count", **schema), open=tool("host")) == []


def test_the_connect_step_is_compared_as_well(tmp_path: Path) -> None:
    (missing,) = found(tmp_path, read_registers=tool("addres", "count"))
    assert missing.startswith("adapter.modbus.connect.tool: the adapter lists no tool 'open'")


LEFT_OUT = (
    HEAD
    + """
[adapter.modbus.bind.read_holding]
tool = "read"
arguments = { address = "$address", count = "$count", slave = "$unit" }
result = { values = {} }
"""
)


def test_a_required_argument_that_most_calls_leave_out_is_named(tmp_path: Path) -> None:
    (tmp_path / "otmcp.toml").write_text(LEFT_OUT, encoding="utf-8")
    adapter = load_subject(tmp_path / "otmcp.toml").adapters["modbus"]
    assert check_bindings(adapter, {"read": tool("address", "count", optional="slave")}) == []
    assert check_bindings(adapter, {"read": tool("address", "count", "slave")}) == [
        "adapter.modbus.bind.read_holding.arguments.slave: the tool 'read' requires it, and $unit is left out where no unit is asked for; "
        "give the value that the mock device has, such as 1"
    ]
