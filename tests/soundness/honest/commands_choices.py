"""Honest adapters with a vocabulary of their own, whose commands reach the device in another form."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, cast

from pytest_otmcp.reference_adapters.core import AdapterServer
from pytest_otmcp.reference_adapters.modbus import named as modbus_named
from pytest_otmcp.reference_adapters.modbus.shapes import Cell, WriteCoils, WriteRegisters
from pytest_otmcp.reference_adapters.mqtt import named as mqtt_named
from pytest_otmcp.reference_adapters.mqtt.shapes import Publish

from pytest_otmcp.subject import named_subject

from .choice import choices

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter, Binding

__all__ = ["CHOICES"]

_MODBUS, modbus = choices("modbus")
_MQTT, mqtt = choices("mqtt")


def _named(adapter: Adapter) -> Adapter:
    named = named_subject().adapters[adapter.protocol]
    return dataclasses.replace(named, variants={name: adapter.variants[name] for name in named.variants})


def _without_qos(adapter: Adapter) -> Adapter:
    named = _named(adapter)
    operations = {
        name: tuple(map(_any_qos, bound)) if isinstance(bound, tuple) else bound
        for name, bound in named.operations.items()
    }
    return dataclasses.replace(named, operations=operations)


def _any_qos(binding: Binding) -> Binding:
    if binding.command is None:
        return binding
    then = tuple(dataclasses.replace(one, effect=_no_qos(one.effect)) for one in binding.command.then)
    command = dataclasses.replace(binding.command, effect=_no_qos(binding.command.effect), then=then)
    return dataclasses.replace(binding, command=command)


def _no_qos(effect: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in effect.items() if name != "qos"}


def tools_of(server: AdapterServer, status: str) -> Any:
    """Take the adapter's tools away, and return the object whose methods they are."""
    tools = server._tools[status].handler.__self__  # type: ignore[attr-defined]
    server._tools.clear()
    return tools


def publishing(server: AdapterServer, change: Callable[[Publish], dict[str, Any]]) -> None:
    """Change the members of each message that a command publishes."""
    genuine = tools_of(server, "get_broker_info")

    class Changed:
        def __getattr__(self, name: str) -> Any:
            return getattr(genuine, name)

        async def publish_message(self, call: Any, arguments: Publish) -> Any:
            return await genuine.publish_message(call, arguments.model_copy(update=change(arguments)))

    server.add(mqtt_named.NamedTools(cast(Any, Changed())))


@modbus(
    "commands several coils and several registers, one of each",
    "MODBUS Application Protocol, sections 6.11 and 6.12: one cell may be written so",
    described=_named,
)
def writes_blocks_of_one(server: AdapterServer) -> None:
    genuine = tools_of(server, "ping")

    class Blocks:
        def __getattr__(self, name: str) -> Any:
            return getattr(genuine, name)

        async def write_register(self, call: Any, arguments: Any) -> None:
            await genuine.write_registers(call, WriteRegisters(address=arguments.address, values=[arguments.value]))

        async def write_coil(self, call: Any, arguments: Any) -> None:
            await genuine.write_coils_bulk(call, WriteCoils(address=arguments.address, values=[arguments.value]))

    server.add(modbus_named.NamedTools(cast(Any, Blocks())))


@modbus(
    "reads a set point back before it presses what it is for",
    "a command of several requests may read between them",
    described=_named,
)
def reads_between_its_writes(server: AdapterServer) -> None:
    genuine = tools_of(server, "ping")

    class Careful:
        def __getattr__(self, name: str) -> Any:
            return getattr(genuine, name)

        async def write_register(self, call: Any, arguments: Any) -> None:
            await genuine.write_register(call, arguments)
            await genuine.read_register(call, Cell(address=arguments.address))

    server.add(modbus_named.NamedTools(cast(Any, Careful())))


@mqtt(
    "stamps each message with the time and an identifier",
    "what a message says beyond what the subject file states is the adapter's own",
    described=_named,
)
def stamps_its_messages(server: AdapterServer) -> None:
    def stamped(message: Publish) -> dict[str, Any]:
        if not message.payload.startswith("{"):
            return {}
        stamp = {"ts": time.time_ns(), "source": {"adapter": "otmcp"}}
        return {"payload": json.dumps({**stamp, **json.loads(message.payload)}, indent=1)}

    publishing(server, stamped)


@mqtt(
    "publishes its commands with QoS 0",
    "MQTT 3.1.1, section 4.3.1: a message that is not acknowledged; the subject file states no QoS",
    described=_without_qos,
)
def commands_without_acknowledgement(server: AdapterServer) -> None:
    publishing(server, lambda message: {"qos": 0})


CHOICES = {**_MODBUS, **_MQTT}
