"""The error registry: complete, consistent with the schema and with the protocols' tables."""

from __future__ import annotations

import json
from importlib import resources

import pytest

from pytest_otmcp.core.error_registry import registry, wire_codes
from pytest_otmcp.protocols.registry import protocols

SCHEMA = json.loads((resources.files("pytest_otmcp.protocols") / "envelope.schema.json").read_text(encoding="utf-8"))
ERROR = SCHEMA["properties"]["error"]["oneOf"][1]["properties"]


def test_every_class_and_outcome_of_the_registry_is_one_of_the_schema() -> None:
    for entry in registry().values():
        assert entry.classes
        assert entry.outcomes
        assert set(entry.classes) <= set(ERROR["class"]["enum"]), entry.code
        assert set(entry.outcomes) <= set(ERROR["outcome"]["enum"]), entry.code
        assert {entry.retry_read, entry.retry_write} <= {"yes", "no", "verify", None}, entry.code
        assert (entry.retry_read, entry.retry_write) != (None, None), entry.code


TABLES = [
    *((protocol.package, "codes.toml", "codes") for protocol in protocols().values()),
    (protocols()["mqtt"].package, "codes.toml", "connack"),
    ("pytest_otmcp.core", "errors.toml", "socket"),
]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: ".".join((table[0].rpartition(".")[2], table[2])))
def test_every_code_of_a_protocol_leads_to_codes_of_the_registry_that_allow_its_outcome(
    table: tuple[str, str, str],
) -> None:
    for wire in wire_codes(*table).values():
        for code in wire.codes:
            assert code in registry(), wire
            assert wire.outcome is None or any(registry()[one].allows_outcome(wire.outcome) for one in wire.codes), wire


def test_modbus_exceptions_are_those_of_the_specification() -> None:
    codes = {int(key): entry.codes[0] for key, entry in wire_codes(protocols()["modbus"].package).items()}
    assert codes[2] == "illegal_address"
    assert codes[6] == "device_busy"
    assert sorted(codes) == [1, 2, 3, 4, 5, 6, 8, 10, 11]


def test_opcua_status_values_are_those_of_the_library() -> None:
    ua = pytest.importorskip("asyncua.ua")
    for name, entry in wire_codes(protocols()["opcua"].package).items():
        assert entry.value == getattr(ua.StatusCodes, name), name


def test_mqtt_reason_codes_are_those_of_the_library() -> None:
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.reasoncodes import ReasonCode

    names = {code for code, _ in ReasonCode(PacketTypes.CONNACK).names.items()}
    assert {int(key) for key in wire_codes(protocols()["mqtt"].package)} <= names


def test_a_retryable_error_must_be_retryable_in_some_kind_of_call() -> None:
    assert registry()["connect_failed"].allows_retryable(True)
    assert not registry()["connect_failed"].allows_retryable(False)
    assert registry()["timeout"].allows_retryable(True)
    assert registry()["timeout"].allows_retryable(False)
    assert not registry()["writes_disabled"].allows_retryable(True)


def test_outcomes_are_limited_to_what_can_be_true_of_a_code() -> None:
    assert registry()["writes_disabled"].allows_outcome("not_sent")
    assert not registry()["writes_disabled"].allows_outcome("unknown")
    assert registry()["illegal_address"].allows_outcome("not_applicable")


def test_an_unknown_table_is_an_error() -> None:
    with pytest.raises(KeyError):
        wire_codes(protocols()["modbus"].package, table="bacnet")
