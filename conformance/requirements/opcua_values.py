"""Random values of the built-in types of OPC UA, and whether JSON says them. Pure.

An adapter may say a value in several ways: OPC 10000-6, section 5.4.2, has two for some types, and a name may stand in an object. The
text of a program's own object is none of them.
"""

from __future__ import annotations

import base64
import binascii
import random
import re
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from pytest_otmcp.core.instants import same_instant
from pytest_otmcp.core.strict_json import Wide, same_json
from pytest_otmcp.trial.reply import Reply

__all__ = [
    "Typed",
    "as_said",
    "bytes_of",
    "every_type",
    "further_types",
    "leaves",
    "moment_text",
    "said_by",
]

_INTEGERS = {
    "SByte": (-(2**7), 2**7 - 1),
    "Byte": (0, 2**8 - 1),
    "Int16": (-(2**15), 2**15 - 1),
    "UInt16": (0, 2**16 - 1),
    "Int32": (-(2**31), 2**31 - 1),
    "UInt32": (0, 2**32 - 1),
    "Int64": (1 - 2**53, 2**53 - 1),
    "UInt64": (0, 2**53 - 1),
}
"""Bounds of each type; those of 64 bits end where a number in JSON is no longer exact for everybody."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Typed:
    """Values of one built-in type.

    Attributes:
        kind: name of the type.
        values: legal values, as JSON.
        same: tells whether what was found says a value.
        data_type: node id of the node's DataType; empty for the built-in type itself.
    """

    kind: str
    values: tuple[Any, ...]
    same: Callable[[object, Any], bool]
    data_type: str = ""

    @property
    def name(self) -> str:
        return f"Otmcp.{'Enumeration' if self.data_type else self.kind}"

    @property
    def node(self) -> str:
        return f"ns=2;s={self.name}"

    def created(self, value: Any) -> dict[str, Any]:
        """Return the description of a variable of the type that holds the value."""
        described = {"variable": self.name, "type": self.kind, "value": value}
        return {**described, "data_type": self.data_type} if self.data_type else described


# -- what an answer may say ---------------------------------------------------------------------------------


def leaves(value: object) -> Iterator[object]:
    """Return everything in a value that is no object and no array."""
    if isinstance(value, Mapping):
        for member in value.values():
            yield from leaves(member)
    elif isinstance(value, list):
        for member in value:
            yield from leaves(member)
    else:
        yield value


def _same_long(found: object, value: int) -> bool:
    return same_json(Wide(value), found)


def _same_guid(found: object, value: str) -> bool:
    return isinstance(found, str) and found.strip("{}").lower() == value


def said_by(found: object, value: object) -> bool:
    """Tell whether a value is said as it is, or by a member of an object."""
    return any(same_json(leaf, value) for leaf in leaves(found))


def _words(leaf: object) -> set[str]:
    """Return the words of a text; a status code may be said as ``BadSensorFailure (0x808C0000)``."""
    return set(re.findall(r"\w+", leaf)) if isinstance(leaf, str) else set()


def as_said(kind: str, value: object, reply: Reply) -> object:
    """Return what the output ``value`` of a reply has to be, for a value of this built-in type.

    OPC 10000-6, section 5.4.2.11: in JSON a localized text may also be an object, which has the text and its locale. In a sentence both may
    stand side by side.
    """
    found = reply.outputs.get("value")
    if kind in ("Int64", "UInt64") and isinstance(value, int):
        return Wide(value)
    whole = said_by(found, value) or (isinstance(found, str) and isinstance(value, str) and "" != value in found)
    return found if kind == "LocalizedText" and whole else value


def _named(found: object, value: str) -> bool:
    """Tell whether a node or a qualified name is said, by whatever its namespace is said."""
    name = value.rpartition("=")[2].rpartition(":")[2]
    return any(
        isinstance(leaf, str) and (leaf == name or leaf.endswith((f"={name}", f":{name}"))) for leaf in leaves(found)
    )


def bytes_of(leaf: object) -> bytes:
    if not isinstance(leaf, str):
        return b""
    try:
        return base64.b64decode(leaf, validate=True)
    except (binascii.Error, ValueError):
        return b""


def every_type(rng: random.Random) -> list[Typed]:
    """Return random legal values, and those at the bounds, of the types that every adapter can write."""
    moment = datetime(2020, 1, 1, tzinfo=UTC) + timedelta(milliseconds=rng.randrange(10**11))
    text = f"otmcp-{rng.getrandbits(32):08x}"
    return [
        Typed(kind="Boolean", values=(False, True), same=same_json),
        *(
            Typed(
                kind=kind,
                values=(low, rng.randrange(low + 1, high), high),
                same=_same_long if kind.endswith("64") else same_json,
            )
            for kind, (low, high) in _INTEGERS.items()
        ),
        Typed(kind="Float", values=(2, 2.5, rng.randrange(-8000, 8000) / 8), same=same_json),
        Typed(kind="Double", values=(2, 2.5, round(rng.uniform(-1000.0, 1000.0), 6)), same=same_json),
        Typed(kind="String", values=(str(rng.randrange(10, 100)), "true", text), same=same_json),
        Typed(
            kind="DateTime",
            values=(moment.isoformat(timespec="milliseconds").replace("+00:00", "Z"),),
            same=same_instant,
        ),
        Typed(kind="Guid", values=(str(uuid.UUID(int=rng.getrandbits(128))),), same=_same_guid),
        Typed(kind="ByteString", values=(base64.b64encode(rng.randbytes(6)).decode(),), same=said_by),
        Typed(kind="LocalizedText", values=(text,), same=said_by),
        # ServerState is an enumeration: OPC 10000-3, section 8.14, transfers it as Int32.
        Typed(kind="Int32", values=(rng.randrange(1, 8),), same=same_json, data_type="i=852"),
    ]


def further_types(rng: random.Random) -> list[Typed]:
    """Return random values of the types that are read, and that nobody has to write."""
    text = f"t{rng.getrandbits(32):08x}"
    return [
        Typed(kind="XmlElement", values=(f"<a>{text}</a>",), same=said_by),
        Typed(kind="NodeId", values=(f"ns=2;s={text}",), same=_named),
        Typed(kind="ExpandedNodeId", values=(f"ns=2;s={text}",), same=_named),
        Typed(kind="QualifiedName", values=(f"2:{text}",), same=_named),
        Typed(
            kind="StatusCode",
            values=("BadSensorFailure",),
            same=lambda found, value: (
                said_by(found, 0x808C0000) or any({value, str(0x808C0000)} & _words(leaf) for leaf in leaves(found))
            ),
        ),
    ]


def moment_text(rng: random.Random) -> str:
    moment = datetime(2024, 1, 1, tzinfo=UTC) + timedelta(milliseconds=rng.randrange(10**10))
    return moment.isoformat(timespec="milliseconds")
