"""The arguments of the tools with their bounds, and the shapes of their ``data``."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired

from pydantic import Field
from typing_extensions import TypedDict

from ..core import Arguments, BoundsCode

MAX_ITEMS = 1000
MAX_ARGUMENTS = 100

NodeText = Annotated[
    str, Field(min_length=1, max_length=4096, description="node id, such as ns=2;s=Temperature or nsu=urn:plant;s=Temp")
]
Value = Annotated[Any, Field(description="a JSON value of the kind that the node's data type asks for")]
Many = BoundsCode("limit_exceeded")

# -- arguments ----------------------------------------------------------------------------------------------


class OneNode(Arguments):
    """One node."""

    node_id: NodeText


class Nodes(Arguments):
    """Several nodes."""

    node_ids: Annotated[list[NodeText], Field(min_length=1, max_length=MAX_ITEMS), Many]


class WriteNode(OneNode):
    """One variable and the value to write."""

    value: Value


class WriteNodes(Arguments):
    """Several variables and their values."""

    items: Annotated[list[WriteNode], Field(min_length=1, max_length=MAX_ITEMS), Many]


class CallMethod(Arguments):
    """A method, the object it belongs to, and its input arguments in order."""

    object_id: NodeText
    method_id: NodeText
    arguments: Annotated[list[Value], Field(max_length=MAX_ARGUMENTS, default_factory=list), Many]


# -- data ---------------------------------------------------------------------------------------------------


class ValueObject(TypedDict):
    """A value with its built-in type. Where JSON has no number for it, ``value`` is null and ``special`` names it, both
    at the same place of an array. Integers beyond 2**53 - 1 are decimal strings; with ``encoding`` bytes are base64."""

    value: Any
    data_type: str
    special: Any
    encoding: NotRequired[str]


class Reading(ValueObject):
    """A value as it was read, with its status and times."""

    node_id: str
    status: str
    quality: str
    source_timestamp: str | None
    server_timestamp: str | None


class Variable(Reading):
    """A variable as the enumeration lists it."""

    browse_name: str


class Variables(TypedDict):
    """All variables."""

    variables: list[Variable]
    count: int


class Items(TypedDict):
    """Results of a batch, one for each item, in the order of the request."""

    items: list[dict[str, Any]]


class Child(TypedDict):
    """A node as browsing lists it."""

    node_id: str
    browse_name: str
    display_name: str
    node_class: str


class Children(TypedDict):
    """What is below a node."""

    node_id: str
    children: list[Child]


class Written(TypedDict):
    """A value that the server accepted. ``clamped``: it stored another one, which is the one here; ``verified``: false
    while it has not finished."""

    node_id: str
    value: Any
    data_type: str
    status: str
    clamped: NotRequired[bool]
    verified: NotRequired[bool]


class Called(TypedDict):
    """What a method returned."""

    method_id: str
    outputs: list[ValueObject]
    status: str
