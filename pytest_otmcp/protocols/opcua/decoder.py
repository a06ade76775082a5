"""Decoder of OPC UA over TCP for recorded bytes, security policy None, written from the specification alone.

OPC 10000-6, section 7.1 (OPC UA Connection Protocol) and 6.7 (chunks); OPC 10000-4 for the services. Every service is a
request, except those of :data:`SESSION_KEEPING`; those of :data:`STATE_CHANGING` may change the plant. Signed channels are
framed but not read: their messages are of kind ``Sealed``, and such a message of a client may ask for anything. Of the message with
which a session is activated only the header is kept: it may hold a password.
"""

from __future__ import annotations

from typing import Any

from ...wire.framing import MalformedError
from ...wire.opcua import LARGEST_CHUNK
from ..conversation import Direction, Message, Outstanding
from .binary import BinaryReader, symbol

__all__ = ["POLICY_NONE", "SERVICES", "OpcUaConversation", "request_header"]

_CONNECTION_PROTOCOL = {"HEL": "Hello", "ACK": "Acknowledge", "ERR": "Error", "RHE": "ReverseHello"}
POLICY_NONE = "http://opcfoundation.org/UA/SecurityPolicy#None"

# Numeric id of the binary encoding of the request (OPC 10000-6, annex A); the id of the response is three higher.
SERVICES = {
    422: "FindServers",
    428: "GetEndpoints",
    437: "RegisterServer",
    446: "OpenSecureChannel",
    452: "CloseSecureChannel",
    461: "CreateSession",
    467: "ActivateSession",
    473: "CloseSession",
    479: "Cancel",
    488: "AddNodes",
    494: "AddReferences",
    500: "DeleteNodes",
    506: "DeleteReferences",
    527: "Browse",
    533: "BrowseNext",
    554: "TranslateBrowsePaths",
    560: "RegisterNodes",
    566: "UnregisterNodes",
    615: "QueryFirst",
    621: "QueryNext",
    631: "Read",
    664: "HistoryRead",
    673: "Write",
    700: "HistoryUpdate",
    712: "Call",
    751: "CreateMonitoredItems",
    763: "ModifyMonitoredItems",
    769: "SetMonitoringMode",
    775: "SetTriggering",
    781: "DeleteMonitoredItems",
    787: "CreateSubscription",
    793: "ModifySubscription",
    799: "SetPublishingMode",
    826: "Publish",
    832: "Republish",
    841: "TransferSubscriptions",
    847: "DeleteSubscriptions",
    12208: "FindServersOnNetwork",
    12211: "RegisterServer2",
}
_SERVICE_FAULT = 397
_MAY_HOLD_CREDENTIALS = "ActivateSession"
STATE_CHANGING = frozenset(
    {"Write", "Call", "HistoryUpdate", "AddNodes", "AddReferences", "DeleteNodes", "DeleteReferences"}
)
"""Services whose request can change the plant or its address space."""
SESSION_KEEPING = frozenset(
    {"OpenSecureChannel", "CloseSecureChannel", "FindServers", "GetEndpoints"}
    | {"CreateSession", "ActivateSession", "CloseSession", "CreateSubscription", "Publish", "DeleteSubscriptions"}
)
"""Services that open, keep and close sessions and subscriptions: they ask nothing of the plant."""

_ATTRIBUTES = (
    *("", "NodeId", "NodeClass", "BrowseName", "DisplayName", "Description", "WriteMask", "UserWriteMask"),
    *("IsAbstract", "Symmetric", "InverseName", "ContainsNoLoops", "EventNotifier", "Value", "DataType", "ValueRank"),
    *("ArrayDimensions", "AccessLevel", "UserAccessLevel", "MinimumSamplingInterval", "Historizing", "Executable"),
    *("UserExecutable", "DataTypeDefinition", "RolePermissions", "UserRolePermissions", "AccessRestrictions"),
    "AccessLevelEx",
)


class OpcUaConversation:
    """One connection: it joins chunks to messages, and answers to their requests."""

    def __init__(self) -> None:
        self._bodies: dict[tuple[Direction, int], bytes] = {}
        self._chunks: dict[tuple[Direction, int], tuple[bytes, ...]] = {}
        self._outstanding = Outstanding()
        self._sealed = False

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        """Decode one frame, see :class:`~pytest_otmcp.protocols.conversation.Conversation`; the kind is the service's name."""
        kind = frame[:3].decode()
        try:
            return self._messages(kind, direction, frame)
        except MalformedError as error:
            malformed = {"reason": str(error), "bytes": frame[:256].hex()}
            return [Message(direction=direction, kind="malformed", fields=malformed)]

    def _messages(self, kind: str, direction: Direction, frame: bytes) -> list[Message]:
        reader = BinaryReader(frame[8:])
        if kind in _CONNECTION_PROTOCOL:
            return [_connection_message(kind, direction, reader)]
        reader.unpack("I")
        if kind == "OPN":
            self._sealed = reader.string() != POLICY_NONE
            reader.byte_string()
            reader.byte_string()
        else:
            reader.unpack("I")
        if self._sealed:
            asks = direction == "in" and kind == "MSG"
            sealed = {"message": kind, "bytes_count": len(frame)}
            return [Message(direction=direction, kind="Sealed", fields=sealed, request=asks, state_changing=asks)]
        reader.unpack("I")
        request_id = reader.unpack("I")
        body = frame[len(frame) - reader.left :]
        return self._service(direction, request_id, frame, body)

    def _service(self, direction: Direction, request_id: int, frame: bytes, body: bytes) -> list[Message]:
        key, final = (direction, request_id), chr(frame[3])
        head = frame[: len(frame) - len(body)]
        before, chunks = self._bodies.pop(key, b""), (*self._chunks.pop(key, ()), frame)
        if final == "A":
            return [Message(direction=direction, kind="Abort", fields={"request_id": request_id})]
        body = before + body
        if final == "C":
            if len(body) > LARGEST_CHUNK:
                raise MalformedError("the message is too long")
            self._bodies[key], self._chunks[key] = body, chunks
            return []
        reader = BinaryReader(body)
        type_id = reader.node_id()
        number = int(type_id.removeprefix("i=")) if type_id.startswith("i=") else -1
        if direction == "in":
            message = self._request(request_id, SERVICES.get(number, type_id), reader)
            if message.kind == _MAY_HOLD_CREDENTIALS:
                # Its header says all that an entry has of it.
                shown = head[:4] + (len(head) + len(body) - reader.left).to_bytes(4, "little") + head[8:]
                chunks = (shown + body[: len(body) - reader.left],)
        else:
            message = self._response(request_id, number, type_id, reader)
        message.frames = chunks
        return [message]

    def _request(self, request_id: int, name: str, reader: BinaryReader) -> Message:
        handle = request_header(reader)
        message = Message(
            direction="in",
            kind=name,
            fields={"request_id": request_id, "request_handle": handle, **_asked(name, reader)},
            request=name not in SESSION_KEEPING,
            state_changing=name in STATE_CHANGING,
        )
        self._outstanding.add(request_id, message)
        return message

    def _response(self, request_id: int, number: int, type_id: str, reader: BinaryReader) -> Message:
        asked = self._outstanding.take(request_id)
        name = SERVICES.get(number - 3, type_id) if asked is None else asked.kind
        reader.take(8)
        handle, result = reader.unpack("I"), reader.unpack("I")
        reader.diagnostic_info()
        reader.array(reader.string)
        reader.extension_object()
        fields = {"request_id": request_id, "request_handle": handle, "service_result": symbol(result)}
        if number != _SERVICE_FAULT:
            fields |= _answered(name, reader)
        return Message(direction="out", kind=name, fields=fields, answers=asked)


def request_header(reader: BinaryReader) -> int:
    """Read a RequestHeader (OPC 10000-4, section 7.33) and return its handle."""
    reader.node_id()
    reader.take(8)
    handle: int = reader.unpack("I")
    reader.take(4)
    reader.string()
    reader.take(4)
    reader.extension_object()
    return handle


def _connection_message(kind: str, direction: Direction, reader: BinaryReader) -> Message:
    """Read a message of the OPC UA Connection Protocol (OPC 10000-6, section 7.1.2)."""
    fields: dict[str, object] = {}
    if kind in ("HEL", "ACK"):
        reader.take(20)
    if kind == "HEL":
        fields = {"endpoint_url": reader.string()}
    elif kind == "ERR":
        fields = {"status": symbol(reader.unpack("I")), "reason": reader.string()}
    return Message(direction=direction, kind=_CONNECTION_PROTOCOL[kind], fields=fields)


def _asked(name: str, reader: BinaryReader) -> dict[str, Any]:
    """Return the parameters of a request, for the services that name nodes."""
    if name == "Read":
        reader.take(12)
        return {"nodes": reader.array(lambda: _read_value_id(reader)) or []}
    if name == "Write":
        return {"nodes": reader.array(lambda: _write_value(reader)) or []}
    if name == "Browse":
        reader.node_id()
        reader.take(12)
        most = reader.unpack("I")
        return {"nodes": reader.array(lambda: _browse_description(reader)) or [], "most": most}
    if name == "BrowseNext":
        release = reader.unpack("B") != 0
        return {"points": len(reader.array(reader.byte_string) or []), "release": release}
    if name == "TranslateBrowsePaths":
        return {"nodes": reader.array(lambda: _browse_path(reader)) or []}
    if name == "CreateMonitoredItems":
        reader.take(8)
        return {"nodes": reader.array(lambda: _monitored_item(reader)) or []}
    if name == "Call":
        methods = reader.array(lambda: _method_call(reader)) or []
        return {"nodes": [one["method_id"] for one in methods], "methods": methods}
    return {}


def _attribute(number: int) -> str:
    return _ATTRIBUTES[number] if 0 < number < len(_ATTRIBUTES) else str(number)


def _read_value_id(reader: BinaryReader) -> dict[str, Any]:
    node, attribute = reader.node_id(), reader.unpack("I")
    reader.string()
    reader.qualified_name()
    return {"node_id": node, "attribute": _attribute(attribute)}


def _monitored_item(reader: BinaryReader) -> dict[str, Any]:
    item = _read_value_id(reader)
    # Monitoring mode, the client's handle and the sampling interval come before the filter, the queue after it.
    reader.take(16)
    reader.extension_object()
    reader.take(5)
    return item


def _write_value(reader: BinaryReader) -> dict[str, Any]:
    node, attribute = reader.node_id(), reader.unpack("I")
    reader.string()
    value = reader.data_value()
    del value["status"]
    return {"node_id": node, "attribute": _attribute(attribute), **value}


def _browse_description(reader: BinaryReader) -> str:
    node = reader.node_id()
    reader.unpack("I")
    reader.node_id()
    reader.take(9)
    return node


def _browse_path(reader: BinaryReader) -> str:
    node = reader.node_id()
    reader.array(lambda: (reader.node_id(), reader.take(2), reader.qualified_name()))
    return node


def _method_call(reader: BinaryReader) -> dict[str, Any]:
    object_id, method_id = reader.node_id(), reader.node_id()
    variants = reader.array(reader.variant) or []
    return {
        "object_id": object_id,
        "method_id": method_id,
        "arguments": [value for _, value in variants],
        "types": [name for name, _ in variants],
    }


def _answered(name: str, reader: BinaryReader) -> dict[str, Any]:
    """Return the results of an answer."""
    if name == "Read":
        values = reader.array(reader.data_value) or []
        return {"results": [{"status": value["status"], "value": value["value"]} for value in values]}
    if name in ("Write", "AddReferences", "DeleteNodes", "DeleteReferences"):
        return {"results": reader.array(lambda: {"status": symbol(reader.unpack("I"))}) or []}
    if name in ("Browse", "BrowseNext"):
        results = reader.array(lambda: _browse_result(reader)) or []
        return {"results": [{"status": status} for status, _ in results], "counts": [count for _, count in results]}
    if name == "CreateMonitoredItems":
        return {"results": reader.array(lambda: _monitored_result(reader)) or []}
    if name == "TranslateBrowsePaths":
        return {"results": reader.array(lambda: _path_result(reader)) or []}
    if name == "Call":
        return {"results": reader.array(lambda: _method_result(reader)) or []}
    return {}


def _browse_result(reader: BinaryReader) -> tuple[str, int]:
    status = symbol(reader.unpack("I"))
    reader.byte_string()
    return status, len(reader.array(lambda: _reference(reader)) or [])


def _reference(reader: BinaryReader) -> None:
    reader.node_id()
    reader.unpack("B")
    reader.node_id()
    reader.qualified_name()
    reader.localized_text()
    reader.unpack("I")
    reader.node_id()


def _path_result(reader: BinaryReader) -> dict[str, Any]:
    status = symbol(reader.unpack("I"))
    reader.array(lambda: (reader.node_id(), reader.take(4)))
    return {"status": status}


def _monitored_result(reader: BinaryReader) -> dict[str, Any]:
    status = symbol(reader.unpack("I"))
    # The item's identifier, its sampling interval and its queue; then the result of its filter.
    reader.take(16)
    reader.extension_object()
    return {"status": status}


def _method_result(reader: BinaryReader) -> dict[str, Any]:
    status = symbol(reader.unpack("I"))
    reader.array(lambda: reader.unpack("I"))
    reader.array(reader.diagnostic_info)
    outputs = reader.array(reader.variant) or []
    return {"status": status, "outputs": [value for _, value in outputs]}
