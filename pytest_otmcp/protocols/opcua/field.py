"""What the kit may do at a real OPC UA server: read variables, and write numbers and truth values.

The tap judges each chunk by itself and keeps nothing of those before it: a request passes when it is whole in one chunk of a channel
without security, and of a service that is known to change nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ...core.finding import Finding
from ...wire.opcua import chunk_length
from ..exercise import Asked
from ..field import Field
from ..journal import Entries, Image
from .binary import BinaryReader
from .decoder import POLICY_NONE, SERVICES, request_header
from .entries import answers, as_opcua
from .oracle import exactly_one_write, read_from_device

__all__ = ["FIELD"]

_HARMLESS = {
    b"OPN": frozenset({"OpenSecureChannel"}),
    b"CLO": frozenset({"CloseSecureChannel"}),
    b"MSG": frozenset(
        {
            "FindServers",
            "FindServersOnNetwork",
            "GetEndpoints",
            "CreateSession",
            "ActivateSession",
            "CloseSession",
            "Cancel",
        }
        | {"Read", "HistoryRead", "Browse", "BrowseNext", "TranslateBrowsePaths", "RegisterNodes", "UnregisterNodes"}
        | {"QueryFirst", "QueryNext"}
        | {
            "CreateSubscription",
            "ModifySubscription",
            "SetPublishingMode",
            "DeleteSubscriptions",
            "Publish",
            "Republish",
        }
        | {"CreateMonitoredItems", "ModifyMonitoredItems", "SetMonitoringMode", "SetTriggering", "DeleteMonitoredItems"}
    ),
}
"""Services that change at most what belongs to their own session. TransferSubscriptions takes those of another one away."""
_NAMES_ADDRESSES = frozenset({425, 431, 464, 12209})
"""Identifiers of the answers of FindServers, GetEndpoints, CreateSession and FindServersOnNetwork (OPC 10000-6, annex A)."""
_ADDRESS = b"opc.tcp://"
_APART, _BLOCK = 3, 4
_VALUE = 13
"""The attribute Value (OPC 10000-6, annex A)."""
_EXPANDED = 0x40
"""Bits of a node id's first byte from here on say that more follows, which servers read in different ways."""


def _content(frame: bytes) -> BinaryReader:
    """Return a reader of what follows the security header of a chunk.

    Raises:
        MalformedError: it has none.
    """
    reader = BinaryReader(frame[12:])
    if frame[:3] == b"OPN":
        for _ in range(3):
            reader.byte_string()
    else:
        reader.take(4)
    return reader


def _policy(frame: bytes) -> str | None:
    return BinaryReader(frame[12:]).string()


def _service(frame: bytes) -> str | None:
    """Return the service of a request that is whole in one chunk, or None."""
    return _body(frame)[0]


def _body(frame: bytes) -> tuple[str | None, BinaryReader]:
    """Return the service of a request that is whole in one chunk, or None, and a reader of what follows its identifier."""
    number, reader = _identifier(frame)
    is_whole = frame[3:4] == b"F" and chunk_length(frame) == len(frame)
    return SERVICES.get(number) if is_whole and number is not None else None, reader


def _identifier(frame: bytes) -> tuple[int | None, BinaryReader]:
    """Return the identifier with which the first chunk of a message begins, and a reader of what follows it.

    It has to be in one of the two forms of a node id (OPC 10000-6, 5.2.2.9) that have nothing more to it; else it is None.
    """
    reader = _content(frame)
    reader.take(8)
    head = reader.take(2)
    if head == b"\1\0":
        return reader.unpack("H"), reader
    if head == b"\2\0" and reader.take(1) == b"\0":
        return reader.unpack("I"), reader
    return None, reader


def _harmless(frame: bytes) -> bool:
    if frame[:4] == b"HELF":
        return chunk_length(frame) == len(frame)
    if frame[:3] == b"OPN" and _policy(frame) != POLICY_NONE:
        return False
    return _service(frame) in _HARMLESS.get(frame[:3], ())


def _written(frame: bytes) -> Mapping[str, object] | None:
    name, reader = _body(frame)
    if frame[:3] != b"MSG" or name != "Write":
        return None
    request_header(reader)
    written = reader.array(lambda: _written_value(frame, reader)) or []
    nodes = dict(one for one in written if one is not None)
    # A node that is named twice would be judged by one of its values.
    return nodes if len(nodes) == len(written) and not reader.left else None


def _written_value(frame: bytes, reader: BinaryReader) -> tuple[str, object] | None:
    """Return node and value of one item of a Write: of a value alone, of a node of this server by its namespace's index."""
    named_at = len(frame) - reader.left
    node, attribute, part = reader.node_id(), reader.unpack("I"), reader.string()
    value = reader.data_value()
    plain = frame[named_at] < _EXPANDED and attribute == _VALUE and not part and not value["has_status"]
    return (node, value["value"]) if plain else None


def _unseen(frame: bytes) -> str | None:
    if frame[:3] == b"OPN" and (policy := _policy(frame)) != POLICY_NONE:
        told = str(policy).rpartition("#")[2]
        return f"the adapter opens a channel with the security policy {told}, and the tap sees into channels without security alone"
    if frame[:3] == b"MSG" and frame[3:4] != b"F":
        return "the adapter sends a request in several chunks, and the tap sees into those of one chunk alone"
    return None


def _led(frame: bytes, place: str) -> bytes | None:
    """Return an answer with the address of the tap in each URL where the server names one; None of the first of several chunks."""
    if frame[:3] != b"MSG" or _identifier(frame)[0] not in _NAMES_ADDRESSES:
        return frame
    if frame[3:4] != b"F":
        return None
    told, at, lower = bytearray(frame[:8]), 8, frame.lower()
    while (found := lower.find(_ADDRESS, at)) >= 0:
        end = found + int.from_bytes(frame[found - 4 : found], "little")
        if end > len(frame):
            # In the middle of another text.
            told += frame[at : found + 1]
            at = found + 1
            continue
        path = frame[found + len(_ADDRESS) : end].partition(b"/")[1:]
        url = _ADDRESS + place.encode() + b"".join(path)
        told += frame[at : found - 4] + len(url).to_bytes(4, "little") + url
        at = end
    told += frame[at:]
    told[4:8] = len(told).to_bytes(4, "little")
    return bytes(told)


def _reads(image: Image, claims: Callable[[str], bool]) -> list[Asked]:
    points = image["points"]
    first_with = {str(value): node for node, value in reversed(points.items())}
    chosen = [node for node in points if node in first_with.values()][:_APART]
    if claims("read"):
        singles = [
            Asked(operation="read", inputs={"node": node}, outputs={"value": points[node]}, points={node: points[node]})
            for node in chosen
        ]
    else:
        singles = [_several(image, [node]) for node in chosen] if claims("read_many") else []
    return [*singles, *([_several(image, list(points)[:_BLOCK])] if points and claims("read_many") else [])]


def _several(image: Image, nodes: Sequence[str]) -> Asked:
    held = {node: image["points"][node] for node in nodes}
    return Asked(
        operation="read_many", inputs={"nodes": list(nodes)}, outputs={"values": list(held.values())}, points=held
    )


def _beyond(image: Image, claims: Callable[[str], bool]) -> Asked | None:
    missing = image["beyond"].get("node")
    return Asked(operation="read", inputs={"node": missing}) if missing is not None and claims("read") else None


def _write(point: str, value: object) -> Asked | None:
    return Asked(
        operation="write", inputs={"node": point, "value": value}, outputs={"value": value}, points={point: value}
    )


def _was_written(entries: Entries, asked: Asked) -> list[Finding]:
    ((node, value),) = asked.points.items()
    return exactly_one_write(entries, node, value)


def _was_read(entries: Entries, asked: Asked) -> list[Finding]:
    return [found for node in asked.points for found in read_from_device(entries, node)][:1]


def _sent(entries: Entries) -> list[object]:
    return [result["value"] for entry in answers(entries, "Read") for result in as_opcua(entry).get("results", [])]


FIELD = Field(
    harmless=_harmless,
    written=_written,
    reads=_reads,
    beyond=_beyond,
    write=_write,
    was_read=_was_read,
    was_written=_was_written,
    sent=_sent,
    unseen=_unseen,
    led=_led,
)
