"""Node ids as text (OPC 10000-6, 5.3.1.10): ``ns=2;s=Name`` or, safe from a server that renumbers its namespaces,
``nsu=urn:plant;s=Name``."""

from __future__ import annotations

import base64
import binascii
import re
import uuid
from dataclasses import dataclass

from asyncua import ua

from ..core import AdapterError

__all__ = ["NodeName", "parse_node"]

_SYNTAX = re.compile(r"(?:ns=(?P<index>0|[1-9]\d{0,4});|nsu=(?P<uri>[^;]+);)?(?P<kind>[isgb])=(?P<rest>.+)", re.DOTALL)
_NUMBER = re.compile(r"0|[1-9]\d{0,9}")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_LARGEST_INDEX, _LARGEST_NUMBER = 2**16 - 1, 2**32 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeName:
    """A node id as the caller wrote it.

    Attributes:
        text: the text as given.
        field: JSON Pointer to the text in the arguments.
        identifier: numeric, string, GUID or bytes.
        index: namespace index that the text gives; 0 if it gives none.
        uri: namespace URI that the text gives, or None.
    """

    text: str
    field: str
    identifier: int | str | uuid.UUID | bytes
    index: int
    uri: str | None

    def at(self, index: int) -> ua.NodeId:
        """Return the node id with this namespace index."""
        return ua.NodeId(self.identifier, index)


def parse_node(text: str, field: str) -> NodeName:
    """Parse a node id.

    Raises:
        AdapterError: ``invalid_input``: the text is no node id.
    """
    match = _SYNTAX.fullmatch(text)
    if match is not None and not _CONTROL.search(text):
        identifier = _identifier(match["kind"], match["rest"])
        index = int(match["index"] or 0)
        if identifier is not None and index <= _LARGEST_INDEX:
            return NodeName(text=text, field=field, identifier=identifier, index=index, uri=match["uri"])
    message = "not a node id such as ns=2;s=Name, ns=2;i=42 or nsu=urn:plant;s=Name"
    raise AdapterError("invalid_input", message, field=field)


def _identifier(kind: str, text: str) -> int | str | uuid.UUID | bytes | None:
    try:
        if kind == "i":
            number = int(text) if _NUMBER.fullmatch(text) else _LARGEST_NUMBER + 1
            return number if number <= _LARGEST_NUMBER else None
        if kind == "g":
            guid = uuid.UUID(text)
            return guid if str(guid) == text.lower() else None
        return base64.b64decode(text, validate=True) if kind == "b" else text
    except (ValueError, binascii.Error):
        return None
