"""What a record keeps of a journal, and what a reader makes of it."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.journal import DeviceJournal
from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.evidence import JournalReader, evidence
from pytest_otmcp.protocols.modbus.decoder import ModbusConversation
from pytest_otmcp.protocols.mqtt.decoder import MqttConversation
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record import load
from pytest_otmcp.record.redaction import Redactor

from ..stored_runs import store
from .journals import Entry
from .samples import around, item, run

READ_COILS = bytes.fromhex("0001 0000 0006 01 01 0003 0003")
THREE_COILS = bytes.fromhex("0001 0000 0004 01 01 01 05")
CONNECT_5 = bytes.fromhex("10 0f 0004 4d515454 05 02 003c 00 0002 6d65")
PUBLISH_5 = bytes.fromhex("30 07 0001 61 02 0101 31")
"""A message of MQTT 5, whose payload is text as a property says; to 3.1.1 the property is a part of the payload."""


def journal(conversation: Any, *frames: tuple[Direction, bytes]) -> list[Entry]:
    found = DeviceJournal(conversation)
    for direction, frame in frames:
        found.frame(1, direction, frame, None)
    return found.since(0)


def of_device(protocol: str, entries: list[Entry]) -> list[Entry]:
    return [{"protocol": protocol, **entry} for entry in entries]


def found(device: str, **more: Any) -> dict[str, Any]:
    """Return a device as an item found it."""
    times = {"begin": 0, "asked_ns": 0, "seen_ns": 0, "accepting_ns": 0, "starts": 0}
    return {"device": device, **times, "before": [], "quiet": False, "session": None, **more}


def read_back(path: Path, *items: dict[str, Any]) -> list[Any]:
    """Return these items as a file gives them back."""
    facts: dict[str, Any] = {"variant": "rw", "worker": "main", "endpoints": [], "placeholders": {}, "first": 0}
    devices = {protocol: {"protocol": protocol, **facts} for protocol in ("modbus", "mqtt")}
    return list(load(store(path / "run.json", run(list(items)) | {"devices": devices}))["items"])


def test_a_message_is_kept_as_its_frame_and_an_event_as_it_is() -> None:
    (asked,) = journal(ModbusConversation, ("in", READ_COILS))
    assert evidence(asked) == {
        **{name: asked[name] for name in ("seq", "t_ns", "connection", "direction", "origin")},
        "frame": READ_COILS.hex(),
    }
    event = {"seq": 0, "kind": "DISCONNECTED", "reason": "it was told to"}
    assert evidence(event) == event


def test_what_the_device_says_beside_the_frame_is_kept_and_what_the_frame_says_is_read_from_it_alone() -> None:
    device = DeviceJournal(ModbusConversation)
    record = {"number": 0, "t_ns": 1, "connection": 1, "direction": "in", "origin": "client", "answers": None}
    told = {"fault": {"drop": True}, "unit": 1, "address": 9, "state_changing": True}
    device.take(
        {"first": 0, "next": 1, "peers": {}, "records": [{**record, "frame": READ_COILS.hex(), "fields": told}]}
    )
    (entry,) = device.since(0)
    assert evidence(entry)["told"] == {"fault": {"drop": True}}
    assert (entry["address"], entry["state_changing"]) == (3, False)
    assert JournalReader(ModbusConversation).read(evidence(entry)) == entry


@pytest.mark.parametrize("frame", [READ_COILS.hex(), "00"])
def test_what_a_record_says_of_a_message_beside_its_frame_is_not_believed(frame: str) -> None:
    (asked,) = journal(ModbusConversation, ("in", READ_COILS))
    kept = {**evidence(asked), "frame": frame}
    lies = {"kind": "response", "request": False, "state_changing": True, "address": 9}
    honest = JournalReader(ModbusConversation).read(kept)
    assert JournalReader(ModbusConversation).read({**kept, **lies}) == honest
    told = JournalReader(ModbusConversation).read({**kept, "told": lies})
    assert {name: told[name] for name in honest} == honest


def test_what_the_bytes_do_not_settle_the_device_may_know() -> None:
    connect = bytes.fromhex("10 0c 0004 4d515454 04 02 003c 0000")
    (told,) = journal(MqttConversation, ("in", connect))
    assert (
        JournalReader(MqttConversation).read({**evidence(told), "told": {"client_id": "given"}})["client_id"] == "given"
    )
    (named,) = journal(MqttConversation, ("in", CONNECT_5))
    assert (
        JournalReader(MqttConversation).read({**evidence(named), "told": {"client_id": "given"}})["client_id"] == "me"
    )


def test_the_journal_of_a_device_that_was_started_again_is_read_from_its_beginning() -> None:
    reader = JournalReader(ModbusConversation)
    (asked,) = journal(ModbusConversation, ("in", READ_COILS))
    answer = {**evidence(asked), "direction": "out", "frame": THREE_COILS.hex()}
    assert reader.read(evidence(asked))["kind"] == "request"
    assert reader.read({**answer, "seq": 0})["answers"] is None


def test_a_frame_that_no_witness_has_cut_is_malformed() -> None:
    (asked,) = journal(ModbusConversation, ("in", READ_COILS))
    for frame in ("00", "000", f"{READ_COILS.hex()} {READ_COILS.hex()}"):
        assert JournalReader(ModbusConversation).read({**evidence(asked), "frame": frame})["kind"] == "malformed"
    assert JournalReader(None).read(evidence(asked))["kind"] == "unread"


def test_a_message_that_held_a_secret_is_kept_without_its_frame() -> None:
    (told,) = journal(MqttConversation, ("in", bytes.fromhex("30 0d 0006") + b"secret" + b"value"))
    kept = evidence(Redactor(["secret"]).apply(told))
    assert ("frame" in kept, kept["kind"], kept["topic"]) == (False, "PUBLISH", "[redacted]")


def test_an_answer_in_the_closing_steps_is_read_with_its_request_in_a_repetition(tmp_path: Path) -> None:
    asked, answered = journal(ModbusConversation, ("in", READ_COILS), ("out", THREE_COILS))
    assert answered["values"] == [True, False, True]
    entry = item("M1", "normal", "Modbus", "Ping", [1.0]) | {"devices": {"modbus": found("modbus")}}
    entry["samples"][0]["device"] = of_device("modbus", [asked])
    entry["around"] = [around("control") | {"device": of_device("modbus", [answered])}]
    assert read_back(tmp_path, entry) == [entry]


def test_a_journal_goes_on_from_item_to_item_in_the_order_of_time(tmp_path: Path) -> None:
    asked, answered = journal(ModbusConversation, ("in", READ_COILS), ("out", THREE_COILS))
    later = item("M1", "normal", "Modbus", "Ping", [1.0]) | {"began_ns": 2, "ended_ns": 3}
    earlier = item("M2", "normal", "Modbus", "Read", [1.0]) | {"began_ns": 0, "ended_ns": 1}
    for entry, seen in ((earlier, asked), (later, answered)):
        entry["devices"] = {"modbus": found("modbus")}
        entry["samples"][0]["device"] = of_device("modbus", [seen])
    assert read_back(tmp_path, later, earlier) == [later, earlier]


def test_what_an_item_that_was_cut_off_has_taken_is_there_for_what_comes_after(tmp_path: Path) -> None:
    connect, published = journal(MqttConversation, ("in", CONNECT_5), ("in", PUBLISH_5))
    assert published["payload"] == "MQ=="
    entry = item("Q1", "normal", "MQTT", "Ping", [1.0])
    entry["devices"] = {"mqtt": found("mqtt", missed=of_device("mqtt", [connect]))}
    entry["samples"][0]["device"] = of_device("mqtt", [published])
    assert read_back(tmp_path, entry) == [entry]


@pytest.mark.parametrize("protocol", sorted(protocols()))
def test_any_bytes_in_the_place_of_a_frame_are_read_without_an_exception(protocol: str) -> None:
    framing = protocols()[protocol].framing
    assert framing is not None
    chance, reader = random.Random(20261126), JournalReader(framing.conversation)
    kept: dict[str, Any] = {"t_ns": 0, "connection": 1, "origin": "client"}
    starts = (
        b"",
        bytes(7),
        b"\x68\x05\x05\x68",
        b"MSGF\0\0\0\0",
        b"\x03\0\0\x0b\x02\xf0\x80\x32",
        b"\x05\x64\x08\xc4",
        b"\x6f\0",
    )
    for seq in range(3000):
        frame = chance.choice(starts) + chance.randbytes(chance.randrange(1, 40))
        entry = reader.read({**kept, "seq": seq, "direction": chance.choice(("in", "out")), "frame": frame.hex()})
        assert isinstance(entry["kind"], str)
