"""The seventeen EtherNet/IP tools."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

from ..core import AdapterError, Call, NameMap, Nothing, device_text, exact_in_json, tool
from .aliases import Alias
from .codec import DataType, Plain, TagType, Value, decode, encode, tag_type
from .controller import Controller
from .link import Link
from .refusals import refusal
from .shapes import (
    AliasList,
    AliasValue,
    AliasWritten,
    Elements,
    ElementsWritten,
    OneAlias,
    OneTag,
    ReadArray,
    ReadTags,
    TagText,
    TagValue,
    TagWritten,
    Values,
    ValuesWritten,
    WriteAlias,
    WriteArray,
    WriteTag,
    WriteTags,
    WriteText,
)
from .wire import SUCCESS, Reply, modify_service, read_service, several, write_service

__all__ = ["Tools"]


@dataclass(frozen=True, slots=True)
class _Target:
    """A tag as it is addressed: its name without the number of a bit, and that number."""

    name: str
    bit: int | None

    @property
    def known_as(self) -> str:
        """The name under which its type is remembered: names are the same in any case, and elements of an array have one type."""
        return re.sub(r"\[[^]]*\]", "[]", self.name.lower())


def _elements(name: str, values: Sequence[Plain]) -> list[tuple[str, Plain]]:
    """Return the elements of an array that a block from this one on covers, each with its value."""
    base, _, index = name.removesuffix("]").rpartition("[")
    if "," in index:
        # The block goes on in the next row, whose length only the controller knows.
        return [(f"{name}[{len(values)}]", values[0])]
    first = int(index) if base else 0
    return [(f"{base or name}[{first + place}]", value) for place, value in enumerate(values)]


def _target(name: str) -> _Target:
    base, _, last = name.rpartition(".")
    return _Target(base, int(last)) if base and last.isdecimal() else _Target(name, None)


def _told(call: Call, pointer: str, value: Value) -> Value:
    """Return a value for this place of the answer; a text is marked as the device's, ``raw`` has its bytes."""
    if isinstance(value["value"], str) and value["type"] == "STRING":
        value["value"] = device_text(call, pointer, value["value"])
    return value


class Tools(Controller):
    """The tools over one connection; those about the controller itself are the base class's.

    Args:
        link: the connection.
        aliases: the alias map.
        control_enabled: setting the controller's clock is allowed.
    """

    def __init__(self, link: Link, *, aliases: Mapping[str, Alias], control_enabled: bool) -> None:
        super().__init__(link, control_enabled=control_enabled)
        self._aliases = NameMap(aliases, kind="alias", argument="alias", listed_by="list_tags")
        self._types: dict[str, TagType] = {}

    # -- reading ------------------------------------------------------------------------------------------

    @tool("ethernetip.read_tag")
    async def read_tag(self, call: Call, arguments: OneTag) -> TagValue:
        """Read one value: a tag, an element of an array, a member of a structure or a bit of a whole number."""
        return await self._value(call, arguments.tag_name)

    @tool("ethernetip.read_array")
    async def read_array(self, call: Call, arguments: ReadArray) -> Elements:
        """Read elements of an array, in one request."""
        target = self._array(arguments.tag_name)
        request = read_service(self._path(target), arguments.elements)
        reply = await self._link.ask(call, request, tag=target.name)
        kind, contents = self._contents(call, target, reply, arguments.elements)
        values = [decode(content, kind.name) for content in contents]
        return {
            "tag_name": arguments.tag_name,
            "type": kind.name,
            "values": [_told(call, f"/data/values/{index}", one)["value"] for index, one in enumerate(values)],
            "specials": [value["special"] for value in values],
            "raw": b"".join(contents).hex(),
        }

    @tool("ethernetip.read_string")
    async def read_string(self, call: Call, arguments: OneTag) -> TagText:
        """Read the text of a STRING."""
        value = await self._value(call, arguments.tag_name)
        if value["type"] != "STRING":
            message = f"the tag is a {value['type']}, no STRING"
            raise AdapterError("type_mismatch", message, field="/tag_name", outcome="not_applicable")
        return {"tag_name": arguments.tag_name, "value": cast(str, value["value"])}

    @tool("ethernetip.read_many")
    async def read_multiple_tags(self, call: Call, arguments: ReadTags) -> Values:
        """Read several values by one request. The controller answers each; a call of which it refuses some has failed."""
        targets = [_target(name) for name in arguments.tags]
        replies = await self._read_all(call, targets)
        if any(reply.status != SUCCESS for reply in replies):
            raise self._refused(call, arguments.tags, replies, "read")
        return {
            "tags": [
                {"tag_name": name, **_told(call, f"/data/tags/{index}/value", self._decoded(call, target, reply))}
                for index, (name, target, reply) in enumerate(zip(arguments.tags, targets, replies, strict=True))
            ]
        }

    @tool("ethernetip.list_aliases")
    async def list_tags(self, call: Call, arguments: Nothing) -> AliasList:
        """List the alias map: names, tags and units. Asks the controller nothing; its own tags are what get_tag_list lists."""
        return {
            "tags": [
                {"alias": name, "tag": alias.tag, "unit": alias.unit, "writable": alias.writable}
                for name, alias in sorted(self._aliases.items())
            ]
        }

    @tool("ethernetip.read_alias")
    async def read_tag_by_alias(self, call: Call, arguments: OneAlias) -> AliasValue:
        """Read the value of an alias's tag."""
        alias = self._aliases.known(arguments.alias)
        return {"alias": arguments.alias, "unit": alias.unit, **await self._value(call, alias.tag)}

    # -- writing ------------------------------------------------------------------------------------------

    @tool("ethernetip.write_tag", writes=True)
    async def write_tag(self, call: Call, arguments: WriteTag) -> TagWritten:
        """Write one value, by one request. A bit is written as a bit; its neighbours are not touched.

        The type is the tag's, for which the controller is asked once; a value that it does not have is refused.
        """
        return await self._write(call, arguments.tag_name, arguments.value, arguments.data_type)

    @tool("ethernetip.write_array", writes=True)
    async def write_array(self, call: Call, arguments: WriteArray) -> ElementsWritten:
        """Write elements of an array, in one request."""
        target = self._array(arguments.tag_name)
        kind = await self._type(call, target)
        contents = [encode(value, kind.name, f"/values/{index}") for index, value in enumerate(arguments.values)]
        call.changes(*_elements(target.name, arguments.values))
        await self._confirmed(call, write_service(self._path(target), kind.wire, contents), target)
        return {
            "tag_name": arguments.tag_name,
            "type": kind.name,
            "values": [exact_in_json(value) for value in arguments.values],
            "raw": b"".join(contents).hex(),
        }

    @tool("ethernetip.write_string", writes=True)
    async def write_string(self, call: Call, arguments: WriteText) -> TagWritten:
        """Write the text of a STRING; one that is too long is refused, not cut off."""
        return await self._write(call, arguments.tag_name, arguments.value, "STRING")

    @tool("ethernetip.write_many", writes=True)
    async def write_multiple_tags(self, call: Call, arguments: WriteTags) -> ValuesWritten:
        """Write several values by one request. The controller confirms each; a call that it confirms in part has failed."""
        wanted = arguments.payloads
        targets = [_target(one.tag_name) for one in wanted]
        await self._learn(call, targets)
        services, written = [], []
        for number, (one, target) in enumerate(zip(wanted, targets, strict=True)):
            service, confirmed = await self._service(
                call, one.tag_name, target, one.value, one.data_type, f"/payloads/{number}"
            )
            services.append(service)
            written.append(confirmed)
        call.changes(*((one.tag_name, one.value) for one in wanted))
        if len(services) == 1:
            await self._confirmed(call, services[0], targets[0])
            return {"tags": written}
        replies = await self._link.ask_for_several(call, several(services), tag=targets[0].name)
        if any(reply.status != SUCCESS for reply in replies):
            raise self._refused(call, [one.tag_name for one in wanted], replies, "written")
        return {"tags": written}

    @tool("ethernetip.write_alias", writes=True)
    async def write_tag_by_alias(self, call: Call, arguments: WriteAlias) -> AliasWritten:
        """Write the value of an alias's tag."""
        alias = self._aliases.writable(arguments.alias)
        written = await self._write(call, alias.tag, arguments.value)
        return {"alias": arguments.alias, "unit": alias.unit, **written}

    async def present(self, call: Call, target: str) -> object:
        """Return what a target of :meth:`Call.changes` holds."""
        return (await self._value(call, target))["value"]

    # -- requests -----------------------------------------------------------------------------------------

    async def _value(self, call: Call, name: str) -> TagValue:
        target = _target(name)
        reply = await self._link.ask(call, read_service(self._path(target), 1), tag=target.name)
        return {"tag_name": name, **_told(call, "/data/value", self._decoded(call, target, reply))}

    async def _write(self, call: Call, name: str, value: Plain, wanted: DataType | None = None) -> TagWritten:
        target = _target(name)
        service, written = await self._service(call, name, target, value, wanted)
        call.changes((name, value))
        await self._confirmed(call, service, target)
        return written

    async def _confirmed(self, call: Call, service: bytes, target: _Target) -> None:
        try:
            await self._link.ask(call, service, tag=target.name)
        except AdapterError as error:
            if error.code == "type_mismatch":
                # Somebody has loaded another program.
                self._types.clear()
            raise

    async def _service(
        self, call: Call, name: str, target: _Target, value: Plain, wanted: DataType | None, field: str = ""
    ) -> tuple[bytes, TagWritten]:
        """Return the request that writes a value, and what is told when the controller has confirmed it.

        Raises:
            AdapterError: the tag has no such value; nothing was sent but, at most, the question for its type.
        """
        kind = await self._type(call, target)
        shown: DataType = kind.name
        if target.bit is not None:
            self._check_bit(kind, target.bit, f"{field}/tag_name")
            shown = "BOOL"
        if wanted not in (None, shown):
            message = f"the tag is a {shown}, no {wanted}"
            raise AdapterError("type_mismatch", message, field=f"{field}/data_type", outcome="not_sent")
        content = encode(value, shown, f"{field}/value")
        path = self._path(target)
        if target.bit is not None:
            service = modify_service(path, kind.size, target.bit, bool(value))
        else:
            service = write_service(path, kind.wire, [content])
        confirmed: TagWritten = {
            "tag_name": name,
            "type": shown,
            "value": exact_in_json(value),
            "raw": content.hex(),
            "status": SUCCESS,
        }
        return service, confirmed

    async def _read_all(self, call: Call, targets: Sequence[_Target], *, question: bool = False) -> list[Reply]:
        """Read tags by one request and return the controller's answer to each; a ``question`` is what a writing tool asks before
        it writes."""
        services = [read_service(self._path(target), 1) for target in targets]
        first, changes = targets[0].name, not question
        if len(services) == 1:
            return [await self._link.exchange(call, services[0], tag=first, changes_state=changes)]
        return await self._link.ask_for_several(call, several(services), tag=first, changes_state=changes)

    async def _type(self, call: Call, target: _Target) -> TagType:
        """Return the type of a tag that is to be written; the controller is asked once for it."""
        await self._learn(call, [target])
        return self._types[target.known_as]

    async def _learn(self, call: Call, targets: Sequence[_Target]) -> None:
        unknown = list({target.known_as: target for target in targets if target.known_as not in self._types}.values())
        if not unknown:
            return
        for target, reply in zip(unknown, await self._read_all(call, unknown, question=True), strict=True):
            if reply.status != SUCCESS:
                raise refusal(call, reply.status, reply.extended)
            self._contents(call, target, reply, 1)

    def _contents(self, call: Call, target: _Target, reply: Reply, count: int) -> tuple[TagType, list[bytes]]:
        """Return type and bytes of the values that an answer to a read holds, and remember the type."""
        kind = tag_type(reply.data, "not_sent" if call.writes else "not_applicable")
        if kind is None or len(reply.data) != len(kind.wire) + count * kind.size:
            raise AdapterError("protocol_error", "the answer has another number of bytes than were asked for")
        self._types[target.known_as] = kind
        data = reply.data[len(kind.wire) :]
        return kind, [data[start : start + kind.size] for start in range(0, len(data), kind.size)]

    def _decoded(self, call: Call, target: _Target, reply: Reply) -> Value:
        kind, (content,) = self._contents(call, target, reply, 1)
        if target.bit is None:
            return decode(content, kind.name)
        self._check_bit(kind, target.bit, None)
        value = int.from_bytes(content, "little") >> target.bit & 1
        return {"type": "BOOL", "value": bool(value), "special": None, "raw": f"{value:02x}", "quality": "good"}

    def _check_bit(self, kind: TagType, bit: int, field: str | None) -> None:
        if bit >= kind.bits:
            message = f"a {kind.name} has {f'the bits 0 to {kind.bits - 1}' if kind.bits else 'no bits'}"
            outcome = None if field is None else "not_sent"
            raise AdapterError("illegal_address", message, field=field, outcome=outcome)

    def _refused(self, call: Call, names: Sequence[str], replies: Sequence[Reply], done: str) -> AdapterError:
        """Return the error for a request of which the controller has refused a part, or all."""
        refused = [reply for reply in replies if reply.status != SUCCESS]
        first = refusal(call, refused[0].status, refused[0].extended)
        self._types.clear()
        if len(refused) == len(replies):
            return first
        shown = [
            {"tag_name": name, done: reply.status == SUCCESS, "status": reply.status, "extended_status": reply.extended}
            for name, reply in zip(names, replies, strict=True)
        ]
        message = f"{len(refused)} of {len(replies)} tags were refused; the others are {done}"
        outcome = "partial" if call.writes else "not_applicable"
        return AdapterError("partial_failure", message, outcome=outcome, partial=shown)

    def _array(self, name: str) -> _Target:
        target = _target(name)
        if target.bit is not None:
            raise AdapterError("invalid_input", "a bit is no array", field="/tag_name", outcome="not_sent")
        return target

    def _path(self, target: _Target) -> bytes:
        """Return the path of a tag. The type given to pylogix only has to be none of an array of BOOL, whose index it divides."""
        return bytes(self._link.builder._build_ioi(target.name, _ANY_TYPE))


_ANY_TYPE = 0xC4
