"""Nobody gets a defective adapter by accident, or takes one for the reference adapter."""

from __future__ import annotations

import subprocess
import sys

import pytest
from pytest_otmcp.reference_adapters.defects import __main__ as program
from pytest_otmcp.reference_adapters.defects.table import DEFECTS
from pytest_otmcp.reference_adapters.modbus import build


def test_the_command_of_the_reference_adapters_does_not_know_the_defects() -> None:
    command = [sys.executable, "-P", "-m", "pytest_otmcp.reference_adapters", "defects"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "{bacnet|dnp3|ethercat|ethernetip|modbus|mqtt|opcua|profibus|profinet|s7}" in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [(), ("MU-13", "MU-14"), ("MU-13", "s7"), ("MU-47", "S7"), ("MU-47", "s7", "s7"), ("mu-13",), ("modbus",)],
)
def test_a_defective_adapter_has_to_be_asked_for_by_its_id(
    arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["defects", *arguments])
    assert program.main() == 2
    assert capsys.readouterr().err.startswith("usage: ")


def test_a_defective_adapter_introduces_itself_as_one(capsys: pytest.CaptureFixture[str]) -> None:
    server = build()
    program.introduce(server, DEFECTS["MU-13"])
    assert server.mcp.create_initialization_options().server_name == "modbus-reference with defect MU-13"
    assert "modbus-reference with defect MU-13" in str(server._completion["_meta"])
    assert "for the kit's mock devices only" in capsys.readouterr().err
