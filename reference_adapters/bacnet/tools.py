"""The seven BACnet tools. Object types and properties have the standard's names, priorities run from 1 (highest) to 16."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bacpypes3.apdu import ReadPropertyACK, ReadPropertyRequest, WritePropertyRequest
from bacpypes3.pdu import Address
from bacpypes3.primitivedata import Atomic, Null, ObjectIdentifier, PropertyIdentifier

from ..core import AdapterError, AliasName, Call, NameMap, Nothing, device_text, tool
from .aliases import Alias
from .link import Link
from .shapes import (
    AliasValue,
    AliasWritten,
    Device,
    Discovery,
    FoundDevices,
    ObjectList,
    ObjectName,
    PropertyOf,
    PropertyValue,
    Reachable,
    WriteAlias,
    WriteProperty,
    Written,
)
from .values import Read, encoded, known_property, object_type, primitives, same

__all__ = ["Tools"]

_ANY_DEVICE = 4194303
"""Instance by which a device answers as itself, whatever its number is."""
_TOO_LONG = "limit_exceeded"


class Tools:
    """The tools over one socket.

    Args:
        link: the socket.
        aliases: the alias map.
        priority: that of writes that name none.
        configures: other properties than present values may be written.
    """

    def __init__(self, link: Link, *, aliases: Mapping[str, Alias], priority: int, configures: bool) -> None:
        self._link = link
        self._aliases = NameMap(aliases, kind="alias", argument="alias")
        self._priority = priority
        self._configures = configures

    # -- finding ----------------------------------------------------------------------------------------------

    @tool("bacnet.ping")
    async def ping(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that the device at the configured address answers: reads the identifier of its device object, and accepts any
        answer."""
        try:
            values = await self._read(call, None, _OWN_IDENTIFIER)
        except AdapterError:
            if not {"error_class", "reject_reason", "abort_reason"} & call.trace.keys():
                raise
            return {"reachable": True, "device_id": None}
        kind, _, instance = str(values[0][1] if values else "").partition(",")
        return {"reachable": True, "device_id": int(instance) if kind == "device" else None}

    @tool("bacnet.discover")
    async def discover_devices(self, call: Call, arguments: Discovery) -> FoundDevices:
        """Ask the devices at the configured address who they are (Who-Is), and wait timeout_ms milliseconds for all answers. An empty list
        means that none answered."""
        found = await self._link.discover(call, arguments.timeout_ms / 1000)
        return {
            "devices": [
                {
                    "device_id": int(one.iAmDeviceIdentifier[1]),
                    "vendor_id": int(one.vendorID),
                    "max_apdu_length": int(one.maxAPDULengthAccepted),
                    "address": str(one.pduSource),
                }
                for one in found
            ]
        }

    @tool("bacnet.list_objects")
    async def list_objects(self, call: Call, arguments: Device) -> ObjectList:
        """List the objects of a device: its object-list, element by element where the whole does not fit into one message."""
        asked = PropertyOf(
            device_id=arguments.device_id,
            object_type="device",
            object_instance=arguments.device_id,
            property_id="object-list",
        )
        try:
            listed = await self._read(call, arguments.device_id, asked)
        except AdapterError as error:
            if error.code != _TOO_LONG:
                raise
            listed = await self._elements(call, asked)
        objects: list[ObjectName] = []
        for kind, value in listed:
            name, comma, instance = str(value).partition(",")
            if kind != "object-identifier" or not comma:
                raise AdapterError("protocol_error", "the object list holds something else than objects")
            objects.append({"object_type": name, "object_instance": int(instance)})
        return {"device_id": arguments.device_id, "objects": objects}

    async def _elements(self, call: Call, asked: PropertyOf) -> list[Read]:
        [(kind, count)] = await self._read(call, asked.device_id, asked.model_copy(update={"array_index": 0}))
        if kind != "unsigned":
            raise AdapterError("protocol_error", "the number of elements is no number")
        found = []
        for index in range(1, count + 1):
            found += await self._read(call, asked.device_id, asked.model_copy(update={"array_index": index}))
        # What an earlier refusal has left does not belong to a success.
        call.trace.pop("abort_reason", None)
        return found

    # -- reading ----------------------------------------------------------------------------------------------

    @tool("bacnet.read_property")
    async def read_property(self, call: Call, arguments: PropertyOf) -> PropertyValue:
        """Read a property of an object (ReadProperty)."""
        return _shown(call, "/data/value", arguments, await self._read(call, arguments.device_id, arguments))

    @tool("bacnet.read_alias")
    async def read_object_by_alias(self, call: Call, arguments: AliasName) -> AliasValue:
        """Read the property that an alias of the alias map stands for."""
        alias = self._aliases.known(arguments.alias)
        asked = _of_alias(alias)
        shown = _shown(call, "/data/value", asked, await self._read(call, asked.device_id, asked))
        return {"alias": arguments.alias, "unit": alias.unit, **shown}

    # -- writing ----------------------------------------------------------------------------------------------

    @tool("bacnet.write_property", writes=True)
    async def write_property(self, call: Call, arguments: WriteProperty) -> Written:
        """Write a property (WriteProperty, sent once), then read it and the priority array. A value that the device acknowledged and that
        is not in effect, because a higher priority wins, is a failure: verify_failed. null gives the priority up."""
        return await self._write(call, arguments)

    @tool("bacnet.write_alias", writes=True)
    async def write_object_by_alias(self, call: Call, arguments: WriteAlias) -> AliasWritten:
        """Write the property that an alias of the alias map stands for, as write_property does."""
        alias = self._aliases.writable(arguments.alias)
        asked = WriteProperty(
            device_id=alias.device_id,
            object_type=alias.object_type,
            object_instance=alias.object_instance,
            property_id=alias.property_id,
            value=arguments.value,
            priority=alias.priority or self._priority,
        )
        return {"alias": arguments.alias, **await self._write(call, asked)}

    async def present(self, call: Call, target: str) -> object:
        """Return what a target of :meth:`Call.changes` holds."""
        device, name, property_id = target.split("/")
        kind, _, instance = name.rpartition(",")
        place = {"object_type": kind, "object_instance": int(instance), "property_id": property_id}
        asked = PropertyOf.model_validate({"device_id": int(device), **place})
        return (await self.read_property(call, asked))["value"]

    async def _write(self, call: Call, asked: WriteProperty) -> Written:
        number = known_property(asked.property_id)
        if asked.property_id != "present-value" and not self._configures:
            message = "only present values may be written; set BACNET_CONFIGURATION_ENABLED=true to configure devices"
            raise AdapterError("writes_disabled", message, outcome="not_sent")
        identifier = ObjectIdentifier((object_type(asked.object_type), asked.object_instance))
        value = encoded(identifier[0], number, asked.array_index, asked.value)
        priority = self._priority if asked.priority is None else asked.priority

        target = f"{asked.device_id}/{asked.object_type},{asked.object_instance}/{asked.property_id}"
        call.changes((target, asked.value))

        def request(address: Address) -> WritePropertyRequest:
            made = WritePropertyRequest(
                objectIdentifier=identifier,
                propertyIdentifier=number,
                propertyValue=value,
                priority=priority,
                destination=address,
            )
            if asked.array_index is not None:
                made.propertyArrayIndex = asked.array_index
            return made

        _trace(call, asked)
        call.trace["priority"] = priority
        await self._link.command(call, asked.device_id, request)
        return await self._verified(call, asked, value, priority)

    async def _verified(self, call: Call, asked: WriteProperty, value: Atomic, priority: int) -> Written:
        """Read what the device holds after it has acknowledged a write."""
        trace = {name: call.trace[name] for name in call.trace if name != "invoke_ids"}
        try:
            found = await self._read(call, asked.device_id, asked)
            slots = await self._slots(call, asked)
        except AdapterError as error:
            message = f"the device acknowledged the write, but what it holds could not be read: {error.message}"
            raise AdapterError(error.code, message, outcome="unknown") from None
        call.trace |= trace
        shown = _shown(call, "/data/present_value", asked, found)
        winning = next((index for index, slot in enumerate(slots, 1) if slot[0] != "null"), None)
        if slots:
            # What the write was for is the slot; what is in effect, the present value.
            is_held = same(value, slots[priority - 1])
            in_effect = is_held and (winning == priority or isinstance(value, Null) or same(value, found[0]))
        else:
            in_effect = len(found) == 1 and same(value, found[0])
        if not in_effect:
            held = (
                f"priority {winning} wins" if winning is not None and winning != priority else "it holds another value"
            )
            message = f"the device acknowledged the write and does not follow it: {held}"
            details = {"winning_priority": winning, "priority": priority}
            if shown["type"] != "character-string":
                # A text of the device's belongs into data alone.
                details["present_value"] = shown["value"]
            raise AdapterError("verify_failed", message, outcome="applied", details=details)
        return {
            "device_id": asked.device_id,
            "object_type": asked.object_type,
            "object_instance": asked.object_instance,
            "property_id": asked.property_id,
            "value": asked.value,
            "present_value": shown["value"],
            "priority": priority if slots else None,
            "winning_priority": winning,
        }

    async def _slots(self, call: Call, asked: PropertyOf) -> list[Read]:
        """Return the priority array of an object; empty where it has none."""
        if asked.property_id != "present-value":
            return []
        try:
            slots = await self._read(
                call,
                asked.device_id,
                PropertyOf(
                    device_id=asked.device_id,
                    object_type=asked.object_type,
                    object_instance=asked.object_instance,
                    property_id="priority-array",
                ),
            )
        except AdapterError as error:
            if error.code == "illegal_address":
                return []
            raise
        if len(slots) != 16:
            raise AdapterError("protocol_error", "a priority array has 16 elements")
        return slots

    # -- requests ---------------------------------------------------------------------------------------------

    async def _read(self, call: Call, device: int | None, asked: PropertyOf) -> list[Read]:
        number = known_property(asked.property_id)
        identifier = ObjectIdentifier((object_type(asked.object_type), asked.object_instance))

        def request(address: Address) -> ReadPropertyRequest:
            made = ReadPropertyRequest(objectIdentifier=identifier, propertyIdentifier=number, destination=address)
            if asked.array_index is not None:
                made.propertyArrayIndex = asked.array_index
            return made

        _trace(call, asked)
        answer = await self._link.ask(call, device, request)
        _accept(answer, identifier, number, asked.array_index)
        return primitives(answer.propertyValue)


# The instance is one that a caller may not name.
_OWN_IDENTIFIER = PropertyOf.model_construct(
    device_id=_ANY_DEVICE,
    object_type="device",
    object_instance=_ANY_DEVICE,
    property_id="object-identifier",
    array_index=None,
)


def _of_alias(alias: Alias) -> PropertyOf:
    return PropertyOf(
        device_id=alias.device_id,
        object_type=alias.object_type,
        object_instance=alias.object_instance,
        property_id=alias.property_id,
    )


def _trace(call: Call, asked: PropertyOf) -> None:
    call.trace["object"] = f"{asked.object_type},{asked.object_instance}"
    call.trace["property"] = asked.property_id


def _accept(answer: Any, identifier: ObjectIdentifier, number: PropertyIdentifier, index: int | None) -> None:
    """Check that an answer is about what was asked for: bacpypes3 matches the invoke id alone."""
    told = isinstance(answer, ReadPropertyACK) and (
        answer.objectIdentifier,
        answer.propertyIdentifier,
        answer.propertyArrayIndex,
    )
    own = identifier[1] == _ANY_DEVICE and told and told[1:] == (number, index)
    if told != (identifier, number, index) and not own:
        raise AdapterError("protocol_error", "the device answered about another property than it was asked for")


def _shown(call: Call, pointer: str, asked: PropertyOf, found: list[Read]) -> PropertyValue:
    """Return what a property holds, for this place of the answer; texts are marked as the device's."""
    if asked.property_id == "present-value" and len(found) != 1:
        raise AdapterError("protocol_error", f"a present value is one value, the device sent {len(found)}")

    def told(place: str, kind: str, value: Any) -> Any:
        return device_text(call, place, value) if kind == "character-string" else value

    kind, value = found[0] if len(found) == 1 else ("list", None)
    if len(found) == 1:
        value = told(pointer, kind, value)
    else:
        value = [told(f"{pointer}/{place}", *one) for place, one in enumerate(found)]
    special = None
    if kind in ("real", "double") and isinstance(value, str):
        value, special = None, value
    return {
        "device_id": asked.device_id,
        "object_type": asked.object_type,
        "object_instance": asked.object_instance,
        "property_id": asked.property_id,
        "type": kind,
        "value": value,
        "special": special,
    }
