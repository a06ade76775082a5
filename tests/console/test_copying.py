"""What was done in the console, as a test and as a binding."""

from __future__ import annotations

import tomllib

from pytest_otmcp.console.copying import Called, Done, as_binding, as_test
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.subject.model import Adapter

MODBUS = reference_subject().adapters["modbus"]
HOSTILE = "\"'\\\n\u202e}]\x00"


def called(tool: str, changing: int | None = 0, success: bool | None = True, **arguments: object) -> Called:
    return Called(tool=tool, arguments=arguments, success=success, changing=changing)


def test_calls_and_what_was_done_to_the_device_become_a_test_that_expects_the_same() -> None:
    steps = [
        called("read", address=1),
        called("write_register", 1, address=7, value=42),
        Done(what="stop"),
        called("write_register", None, success=False, address=7, value=43),
        Done(what="start"),
        Done(what="fault", arguments=({"times": 1, "action": {"drop": True}},)),
        called("write_register", 2, success=None, **{"class": True}),
        Done(what="poke", arguments=({"unit": 1},)),
    ]
    assert as_test("modbus", steps) == (
        "# It expects what the console saw. Change what should be otherwise.\n"
        "def test_copied_from_the_console_modbus(otmcp_device, otmcp_session):\n"
        "    device = otmcp_device('modbus')\n"
        "    adapter = otmcp_session('modbus')\n"
        "\n"
        "    reply = adapter.tool('read', address=1)\n"
        "    assert reply.success is True\n"
        "    assert len([entry for entry in device.journal() if entry.writes]) == 0\n"
        "\n"
        "    reply = adapter.tool('write_register', address=7, value=42)\n"
        "    assert reply.success is True\n"
        "    assert len(device.wait_for(count=1, state_changing=True)) == 1\n"
        "\n"
        "    device.stop()\n"
        "\n"
        "    reply = adapter.tool('write_register', address=7, value=43)\n"
        "    assert reply.success is False\n"
        "\n"
        "    device.start()\n"
        "\n"
        "    device.fault({'times': 1, 'action': {'drop': True}})\n"
        "\n"
        "    reply = adapter.tool('write_register', **{'class': True})\n"
        "    assert reply.success is None\n"
        "    assert len(device.wait_for(count=3, state_changing=True)) == 3\n"
        "\n"
        "    # The device was poked here, past the protocol: {'unit': 1}\n"
    )


def test_no_word_of_an_adapter_gets_out_of_its_quotes() -> None:
    step = called(HOSTILE, **{HOSTILE: HOSTILE})
    compile(as_test("modbus", [step]), "copied", "exec")
    assert as_test("modbus", [step]).isascii()
    line = binding(MODBUS, step)
    [(_, found)] = line.items()
    assert found == {"tool": HOSTILE, "arguments": {HOSTILE: HOSTILE}}


def binding(adapter: Adapter, step: Called) -> dict[str, object]:
    """Return the bindings that the copied text declares."""
    found: dict[str, object] = tomllib.loads(as_binding(adapter, step))["adapter"][adapter.protocol]["bind"]
    return found


def test_a_bound_tool_is_copied_as_it_is_bound() -> None:
    arguments = {"address": "$address", "value": "$value", "unit_id": "$unit"}
    found = binding(MODBUS, called("write_register", 1, address=7, value=42))
    assert found == {"write_holding": {"tool": "write_register", "arguments": arguments}}


def test_another_tool_is_bound_to_the_operation_whose_inputs_it_takes_and_that_does_what_the_device_saw() -> None:
    wrote = binding(MODBUS, called("set_register", 1, address=7, value=42, note=None, deep={"a": [1, None, 2.5]}))
    expected = {"address": "$address", "value": "$value", "deep": {"a": [1, 2.5]}}
    assert list(wrote.values()) == [{"tool": "set_register", "arguments": expected}]
    assert all(name.startswith("write") for name in wrote)
    read = binding(MODBUS, called("get_holding", address=7, count=1))
    assert read == {"read_holding": {"tool": "get_holding", "arguments": {"address": "$address", "count": "$count"}}}
