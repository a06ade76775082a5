"""What a subject file may not say: misspelt placeholders, constants of another type; and what adapters inherit."""

from __future__ import annotations

from pathlib import Path

import pytest

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.session.process import subject_environment
from pytest_otmcp.subject import load_subject
from pytest_otmcp.subject.addressing import mentions_address
from pytest_otmcp.subject.binding_check import check_bindings

FILE = """
[subject]
name = "x"
version = "1"

[adapter.modbus]
command = ["adapter", COMMAND]
env = { A = ENV }
answer = "json"

[adapter.modbus.bind.write_holding]
tool = "write"
arguments = { unit = UNIT, address = "$address", value = "$value" }
"""
GOOD = {"COMMAND": '"{port}"', "ENV": '"{host}"', "UNIT": "1"}


def write(path: Path, **texts: str) -> Path:
    text = FILE
    for name, value in (GOOD | texts).items():
        text = text.replace(name, value)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("texts", "sentence"),
    [
        ({"COMMAND": '"{prot}"'}, r"adapter\.modbus\.command\[1\]: \{prot\} is not replaced; did you mean \{port\}\?"),
        ({"ENV": '"tcp://{HOST}"'}, r"adapter\.modbus\.env\.A: \{HOST\} is not replaced; did you mean \{host\}\?"),
        ({"UNIT": '"{address}"'}, r"arguments\.unit: \{address\} is not replaced; the input is written \"\$address\""),
    ],
)
def test_a_misspelt_placeholder_is_refused(tmp_path: Path, texts: dict[str, str], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        load_subject(write(tmp_path / "otmcp.toml", **texts))


def test_the_adapters_own_ports_are_no_address_of_a_device() -> None:
    assert mentions_address({"env": ["{host}:{local_port}"]})
    assert not mentions_address(["{http_port}", {"bind": "{local_port}"}])


def test_braces_that_are_no_placeholders_are_the_adapter_s_own(tmp_path: Path) -> None:
    assert load_subject(write(tmp_path / "otmcp.toml", ENV='"{level}: {message}"'))


@pytest.mark.parametrize(
    ("unit", "schema", "sentence"),
    [
        ("1", {"type": "integer"}, None),
        ('"1"', {"type": "integer"}, "the tool takes integer, the subject file gives '1'"),
        ("true", {"type": "number"}, "the tool takes number, the subject file gives True"),
        ("1", {"type": "string"}, "the tool takes string, the subject file gives 1"),
        ('"1"', {}, None),
    ],
)
def test_a_constant_of_another_type_than_the_tool_takes_is_a_contradiction(
    tmp_path: Path, unit: str, schema: dict[str, object], sentence: str | None
) -> None:
    adapter = load_subject(write(tmp_path / "otmcp.toml", UNIT=unit)).adapters["modbus"]
    properties = {"unit": schema, "address": {"type": "integer"}, "value": {"type": "integer"}}
    found = check_bindings(adapter, {"write": {"inputSchema": {"type": "object", "properties": properties}}})
    assert found == ([] if sentence is None else [f"adapter.modbus.bind.write_holding.arguments.unit: {sentence}"])


def test_an_adapter_inherits_what_is_documented_and_prints_without_a_buffer(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"HOME": "/h", "LANG": "de", "MODBUS_WRITES_ENABLED": "true"}.items():
        monkeypatch.setenv(name, value)
    environment = subject_environment({"LANG": "en"})
    assert environment["PATH"]
    assert (environment["HOME"], environment["LANG"], environment["PYTHONUNBUFFERED"]) == ("/h", "en", "1")
    assert "MODBUS_WRITES_ENABLED" not in environment
    assert subject_environment({"PYTHONUNBUFFERED": ""})["PYTHONUNBUFFERED"] == ""
