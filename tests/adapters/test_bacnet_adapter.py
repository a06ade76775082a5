"""The BACnet reference adapter against the mock device: its replies and the device's journal."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import asyncio
import socket
from importlib import import_module
from typing import Any

import pytest
from bacpypes3.apdu import ReadPropertyRequest
from pytest_otmcp.reference_adapters.core import Call, ConfigError

from .cases import BACNET, Unfit

pytestmark = pytest.mark.usefixtures("clean")
CASE = BACNET
WRITE_PROPERTY = 15
ZONE = {"device_id": 12345, "object_type": "analog-input", "object_instance": 1}
VALVE = {"device_id": 12345, "object_type": "analog-output", "object_instance": 1}


def points(device: Any) -> dict[str, Any]:
    found: dict[str, Any] = device("image")["points"]
    return found


def requests(device: Any, mark: int, **fields: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = device.since(mark, kind="request", **fields)
    return found


def test_there_are_the_seven_tools_of_the_paper(adapter: Any) -> None:
    assert set(adapter.tools) == set(BACNET.tools)
    assert len(BACNET.tools) == 7


def test_what_the_device_holds_is_told(adapter: Any, device: Any) -> None:
    device("poke", params={"object": "analog-input,1", "value": 70.5})
    told = adapter.call("read_property", **ZONE).data
    assert (told["type"], told["value"]) == ("real", 70.5)
    assert adapter.call("read_object_by_alias", alias="zone").data["value"] == 70.5
    slots = adapter.call("read_property", **VALVE, property_id="priority-array").data["value"]
    assert slots == [None] * 16
    assert adapter.call("read_property", **VALVE, property_id="priority-array", array_index=0).data["value"] == 16
    assert adapter.call("ping").data == {"reachable": True, "device_id": 12345}
    mark = device.mark()
    identifier = adapter.start("discover_devices", {"timeout_ms": 4000})
    device.wait(mark, direction="out")
    adapter.pass_time()
    (found,) = adapter.reply("discover_devices", identifier).data["devices"]
    assert (found["device_id"], found["vendor_id"]) == (12345, 999)


@pytest.mark.parametrize("more", [0, 300])
def test_every_object_is_listed_however_many_there_are(adapter: Any, device: Any, more: int) -> None:
    device("poke", params={"objects": more})
    listed = adapter.call("list_objects", device_id=12345).data["objects"]
    assert len(listed) == 11 + more
    assert listed[-1]["object_type"] == ("analog-value" if more else "schedule")


@pytest.mark.parametrize("tool", BACNET.writes)
def test_a_write_is_sent_once_and_verified(adapter: Any, device: Any, tool: str) -> None:
    mark = device.mark()
    reply = adapter.call(tool, BACNET.writes[tool])
    (write,) = requests(device, mark, service=WRITE_PROPERTY)
    told, priority = reply.data, write["writes"][0]["priority"]
    assert told["present_value"] == BACNET.writes[tool]["value"]
    assert (told["priority"], told["winning_priority"]) == (priority, priority)
    assert points(device)[f"analog-output,1/priority-array/{priority}"] == told["value"]
    assert reply.meta["attempts"] == len(requests(device, mark))
    assert write["invoke_id"] in reply.meta["trace"]["invoke_ids"]


def test_null_relinquishes_and_says_what_is_in_effect_then(adapter: Any, device: Any) -> None:
    device("poke", params={"object": "analog-output,1", "priority": 8, "value": 30.0})
    device("poke", params={"object": "analog-output,1", "priority": 12, "value": 50.0})
    told = adapter.call("write_property", **VALVE, value=None, priority=8).data
    assert (told["present_value"], told["winning_priority"]) == (50.0, 12)
    assert points(device)["analog-output,1/priority-array/8"] is None


def test_a_write_that_a_higher_priority_overrides_is_no_success(adapter: Any, device: Any) -> None:
    device("poke", params={"object": "analog-output,1", "priority": 5, "value": 99.0})
    error = adapter.call("write_property", **VALVE, value=30.5, priority=8).error
    assert (error["code"], error["outcome"]) == ("verify_failed", "applied")
    assert error["details"] == {"present_value": 99.0, "winning_priority": 5, "priority": 8}


@pytest.mark.parametrize("action", [{"ack_only": True}, {"clamp": [0, 10]}])
def test_a_device_that_acknowledges_and_does_not_do_it_is_found_out(adapter: Any, device: Any, action: Any) -> None:
    device.fault({"service": WRITE_PROPERTY, "action": action})
    assert adapter.call("write_property", **VALVE, value=30.5).error["code"] == "verify_failed"


@pytest.mark.parametrize("unfit", BACNET.unfit, ids=lambda unfit: f"{unfit.tool}-{unfit.code}")
def test_unfit_arguments_are_refused_before_anything_is_sent(adapter: Any, device: Any, unfit: Unfit) -> None:
    mark = device.mark()
    error = adapter.call(unfit.tool, unfit.arguments).error
    assert (error["code"], error["outcome"]) == (unfit.code, error["outcome"])
    assert error["outcome"] in ("not_sent", "not_applicable")
    adapter.call("ping")
    assert len(requests(device, mark)) == 1


@pytest.mark.parametrize("tool", BACNET.writes)
def test_a_denied_write_puts_nothing_on_the_wire(rig: Any, device: Any, tool: str) -> None:
    mark, before = device.mark(), points(device)
    assert rig.guarded.call(tool, BACNET.writes[tool]).error["code"] == "writes_disabled"
    rig.ask(rig.guarded)
    assert len(requests(device, mark)) == 1
    assert points(device) == before


def test_another_property_than_the_present_value_needs_a_switch_of_its_own(rig: Any, adapter: Any, device: Any) -> None:
    wanted = {**VALVE, "property_id": "relinquish-default", "value": 1.0}
    assert adapter.call("write_property", wanted).error["code"] == "writes_disabled"
    configuring = rig.start("configuring", writes="true", BACNET_CONFIGURATION_ENABLED="true")
    assert configuring.call("write_property", wanted).error["code"] == "not_writable"


@pytest.mark.parametrize(
    ("asked", "code", "pair"),
    [
        ({**ZONE, "object_instance": 77}, "illegal_address", (1, 31)),
        ({**ZONE, "property_id": "priority-array"}, "illegal_address", (2, 32)),
        ({**ZONE, "array_index": 1}, "illegal_address", (2, 50)),
        ({**VALVE, "property_id": "priority-array", "array_index": 17}, "illegal_address", (2, 42)),
    ],
)
def test_a_refusal_of_the_device_is_told_with_its_numbers(
    adapter: Any, asked: dict[str, Any], code: str, pair: tuple[int, int]
) -> None:
    reply = adapter.call("read_property", asked)
    assert reply.error["code"] == code
    assert (reply.meta["trace"]["error_class"], reply.meta["trace"]["error_code"]) == pair


@pytest.mark.parametrize(
    ("action", "code", "outcome"),
    [
        ({"error": [0, 2]}, "device_busy", "rejected"),
        ({"error": [0, 25]}, "device_failure", "unknown"),
        ({"error": [3, 0]}, "limit_exceeded", "rejected"),
        ({"error": [5, 29]}, "access_denied", "rejected"),
        ({"error": [7, 99]}, "protocol_error", "unknown"),
        ({"reject": 9}, "unsupported_operation", "rejected"),
        ({"reject": 4}, "protocol_error", "unknown"),
        ({"abort": 11}, "limit_exceeded", "rejected"),
    ],
)
def test_every_kind_of_refusal_has_its_code(
    adapter: Any, device: Any, action: dict[str, Any], code: str, outcome: str
) -> None:
    device.fault({"service": WRITE_PROPERTY, "action": action})
    error = adapter.call("write_property", **VALVE, value=30.5).error
    assert (error["code"], error["outcome"]) == (code, outcome)


def test_an_answer_about_another_object_is_not_data(adapter: Any, device: Any) -> None:
    device.fault({"action": {"answer_instance": 2}})
    assert adapter.call("read_property", **ZONE).error["code"] == "protocol_error"


@pytest.mark.parametrize("action", [{"answer_values": []}, {"answer_values": [{"type": "real", "value": 1}] * 2}])
def test_a_present_value_is_one_value(adapter: Any, device: Any, action: dict[str, Any]) -> None:
    device.fault({"action": action})
    assert adapter.call("read_property", **ZONE).error["code"] == "protocol_error"


@pytest.mark.parametrize(
    "action", [{"garbage": True}, {"truncate": 12}, {"invoke_id": 1}, {"drop": True}, {"lose": True}]
)
def test_a_read_without_an_answer_is_sent_again_once(adapter: Any, device: Any, action: dict[str, Any]) -> None:
    adapter.call("read_property", **ZONE)
    device.fault({"service": 12, "times": 1, "action": action})
    mark = device.mark()
    identifier = adapter.start("read_property", ZONE)
    device.wait(mark, kind="request")
    adapter.pass_time()
    reply = adapter.reply("read_property", identifier)
    assert reply.data["value"] == 72.5
    first, second = requests(device, mark)
    assert first["invoke_id"] != second["invoke_id"]
    assert reply.meta["attempts"] == 2


def test_a_write_without_an_answer_is_not_sent_again(adapter: Any, device: Any) -> None:
    adapter.call("read_property", **VALVE)
    device.fault({"service": WRITE_PROPERTY, "action": {"drop": True}})
    mark = device.mark()
    identifier = adapter.start("write_property", {**VALVE, "value": 30.5})
    device.wait(mark, kind="request")
    adapter.pass_time()
    reply = adapter.reply("write_property", identifier)
    assert (reply.error["code"], reply.error["outcome"]) == ("timeout", "unknown")
    assert len(requests(device, mark)) == reply.meta["attempts"] == 1
    assert reply.meta["connection"]["state"] == "disconnected"
    device.fault()
    again = adapter.call("read_property", **VALVE)
    assert again.data["value"] == 30.5
    assert again.meta["connection"]["state"] == "reconnected"


def test_a_request_that_was_given_up_does_not_end_a_later_one(monkeypatch: pytest.MonkeyPatch) -> None:
    link = import_module("pytest_otmcp.reference_adapters.bacnet.link")
    # The library's patience ends here while later requests have the invoke ids of those that it remembers.
    monkeypatch.setattr(link, "_FORGETTING_MS", 500)

    def read(target: Any) -> Any:
        return ReadPropertyRequest(
            objectIdentifier="analog-input,1", propertyIdentifier="present-value", destination=target
        )

    async def codes(silent: int) -> list[str]:
        asking, found = link.Link("127.0.0.1", silent, timeout_s=0.4), []
        for _ in range(3):
            calls = [Call(protocol="bacnet", operation="read", endpoint="", writes=False) for _ in range(128)]
            told = await asyncio.gather(*(asking.ask(call, None, read) for call in calls), return_exceptions=True)
            found += [one.code for one in told]
        await asking.close()
        return found

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        assert set(asyncio.run(codes(silent.getsockname()[1]))) == {"timeout"}


def test_a_device_that_is_not_there_is_not_answered_for_by_another(adapter: Any, device: Any) -> None:
    mark = device.mark()
    identifier = adapter.start("read_property", {**ZONE, "device_id": 54321})
    for count in (1, 2):
        device.wait(mark, count, kind="request", service=8)
        adapter.pass_time()
    reply = adapter.reply("read_property", identifier)
    assert reply.error["code"] == "timeout"
    assert {request["service"] for request in requests(device, mark)} == {8}


@pytest.mark.parametrize(("value", "special"), [("nan", "NaN"), ("inf", "Infinity"), ("-inf", "-Infinity")])
def test_numbers_that_json_does_not_have_are_told_as_special(
    adapter: Any, device: Any, value: str, special: str
) -> None:
    device.fault({"action": {"answer_values": [{"type": "real", "value": value}]}})
    told = adapter.call("read_property", **ZONE).data
    assert (told["value"], told["special"]) == (None, special)


@pytest.mark.parametrize(("value", "shown"), [(2**53 - 1, 2**53 - 1), (2**53, str(2**53)), (2**64 - 1, str(2**64 - 1))])
def test_whole_numbers_that_json_rounds_are_told_digit_by_digit(
    adapter: Any, device: Any, value: int, shown: object
) -> None:
    device.fault({"action": {"answer_values": [{"type": "unsigned", "value": value}]}})
    assert adapter.call("read_property", **ZONE).data["value"] == shown


@pytest.mark.parametrize(("name", "value"), BACNET.bad_settings)
def test_a_setting_that_cannot_be_used_is_named(name: str, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=name):
        import_module("pytest_otmcp.reference_adapters.bacnet").build()
