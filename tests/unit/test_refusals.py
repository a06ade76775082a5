"""The keys of ``codes.toml`` by which answers of devices refuse what was asked for."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.core.error_registry import wire_codes
from pytest_otmcp.protocols.registry import protocols


@pytest.mark.parametrize(
    ("protocol", "answer", "key"),
    [
        ("modbus", {"exception": 2}, "2"),
        ("s7", {"items": [{"code": 5}]}, "5"),
        ("s7", {"error": 33538}, "33538"),
        ("bacnet", {"error": [2, 37]}, "2,37"),
        ("bacnet", {"results": [{"error": [1, 31]}]}, "1,31"),
        ("bacnet", {"reject": 9}, "reject-9"),
        ("ethernetip", {"items": [{"status": 5}]}, "05"),
        ("ethernetip", {"status": 0xFF, "extended": 0x2105}, "FF/2105"),
        ("dnp3", {"iin": 0x0400}, "iin2-2"),
        ("dnp3", {"objects": [{"points": [{"index": 1, "status": 4}]}]}, "status-4"),
        ("profibus", {"status": 3}, "3"),
        ("opcua", {"direction": "out", "results": [{"status": "BadTypeMismatch"}]}, "BadTypeMismatch"),
    ],
)
def test_a_refusal_of_a_device_is_a_code_of_its_protocol(protocol: str, answer: dict[str, Any], key: str) -> None:
    described = protocols()[protocol]
    assert described.exercise is not None
    found = described.exercise.refusals({"kind": "response", **answer})  # type: ignore[typeddict-item]
    known = wire_codes(described.package)
    assert [one for one in found if one in known] == [key]
    assert known[key].codes


@pytest.mark.parametrize("protocol", sorted(protocols()))
def test_what_is_no_answer_refuses_nothing(protocol: str) -> None:
    described = protocols()[protocol]
    assert described.exercise is not None
    found = described.exercise.refusals({"kind": "request", "status": 3})  # type: ignore[typeddict-item]
    assert not [one for one in found if one in wire_codes(described.package) and protocol == "profibus"]
