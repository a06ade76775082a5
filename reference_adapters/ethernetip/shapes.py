"""The arguments of the tools with their bounds, and the shapes of their ``data``.

The adapter splits no request, because two reads are not made at one moment and two writes are not one change: what is asked for
at once has to fit into one message, of 4000 bytes or, with older controllers, of 500.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field, field_validator
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AdapterError, Arguments, BoundsCode
from .codec import DataType, Plain, Value

MAX_ELEMENTS = 2000
MAX_TAGS = 50
LONGEST_NAME = 200

_NAME = r"[A-Za-z_][A-Za-z0-9_]{0,39}"
# A name of a module's data has colons, as has that of a program: Local:1:I.Data, Program:MainProgram.Step.
_SCOPED = rf"{_NAME}(?::[A-Za-z0-9_]{{1,40}}){{0,3}}"
_INDEX = r"\[[0-9]{1,9}(?:,[0-9]{1,9}){0,2}\]"
_TAG = rf"^{_SCOPED}(?:{_INDEX})?(?:\.{_NAME}(?:{_INDEX})?)*(?:\.[0-9]{{1,2}})?$"

TagName = Annotated[
    str,
    Field(
        min_length=1,
        max_length=LONGEST_NAME,
        pattern=_TAG,
        description="name as in the controller: ValvePosition, Levels[2], Flags.3 (a bit), Recipe.Rate (a member), "
        "Program:MainProgram.Step",
    ),
]
AnyValue = Annotated[
    Plain,
    Field(description="true or false for BOOL and bits, a text for STRING, else a number within the type's range"),
]
Text = Annotated[str, Field(description="characters of ISO 8859-1, at most 82")]
WantedType = Annotated[
    DataType, Field(description="data type that the tag must have; the controller is asked for it either way")
]


class OneTag(Arguments):
    """A tag."""

    tag_name: TagName


class WriteTag(OneTag):
    """A tag and its value."""

    value: AnyValue
    data_type: WantedType = LEFT_OUT


class ReadArray(OneTag):
    """Elements of an array, from the index in the name on; from the first one without."""

    elements: Annotated[
        int,
        Field(ge=1, le=MAX_ELEMENTS, description=f"number of elements, 1 to {MAX_ELEMENTS}"),
        BoundsCode("limit_exceeded"),
    ]


class WriteArray(OneTag):
    """Elements of an array and their values, from the index in the name on; from the first one without."""

    values: Annotated[
        list[AnyValue], Field(min_length=1, max_length=MAX_ELEMENTS, description=f"1 to {MAX_ELEMENTS} values")
    ]


class WriteText(OneTag):
    """A STRING and its text."""

    value: Text


class ReadTags(Arguments):
    """Several tags."""

    tags: Annotated[list[TagName], Field(min_length=1, max_length=MAX_TAGS, description=f"1 to {MAX_TAGS} tags")]


class WriteTags(Arguments):
    """Several tags and their values."""

    payloads: Annotated[
        list[WriteTag], Field(min_length=1, max_length=MAX_TAGS, description=f"1 to {MAX_TAGS} tags with values")
    ]


class TagListOf(Arguments):
    """A scope of tags."""

    program: str = Field(
        default=LEFT_OUT,
        max_length=50,
        pattern=rf"^Program:{_NAME}$",
        description="such as Program:MainProgram; the controller's own tags if left out",
    )


class OneAlias(Arguments):
    """A tag of the alias map."""

    alias: Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, description="an alias that list_tags lists")]


class WriteAlias(OneAlias):
    """A tag of the alias map and its value."""

    value: AnyValue


class ClockTime(Arguments):
    """A time."""

    time: Annotated[
        str,
        Field(min_length=10, max_length=40, description="UTC, ISO 8601, such as 2026-11-23T14:05:00; not before 1970"),
    ]

    @field_validator("time")
    @classmethod
    def _is_a_time(cls, text: str) -> str:
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise AdapterError("invalid_input", "a time is written as 2026-11-23T14:05:00", field="/time") from None
        if moment.year < 1970:
            raise AdapterError("range_overflow", "the controller's clock begins with the year 1970", field="/time")
        return text


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """The controller answers."""

    reachable: bool


class Connected(TypedDict):
    """Whether the controller answers, and how it was reached. ``message_size`` in bytes."""

    connected: bool
    message_size: int


class TagValue(Value):
    """A tag's value."""

    tag_name: str


class TagWritten(TypedDict):
    """A tag's value that the controller has confirmed, and its bytes in hexadecimal. ``status`` is the controller's, 0."""

    tag_name: str
    type: str
    value: bool | int | float | str
    raw: str
    status: int


class Elements(TypedDict):
    """Elements of an array, read by one request. ``specials`` has NaN, Infinity or -Infinity where ``values`` has null."""

    tag_name: str
    type: str
    values: list[bool | int | float | str | None]
    specials: list[str | None]
    raw: str


class ElementsWritten(TypedDict):
    """Elements of an array that the controller has confirmed, written by one request."""

    tag_name: str
    type: str
    values: list[bool | int | float | str]
    raw: str


class TagText(TypedDict):
    """The text of a STRING."""

    tag_name: str
    value: str


class Values(TypedDict):
    """Values in the order of the tags, read by one request."""

    tags: list[TagValue]


class ValuesWritten(TypedDict):
    """Values that the controller has confirmed, in the order of the tags, written by one request."""

    tags: list[TagWritten]


class ListedTag(TypedDict):
    """A tag of the controller; ``dimensions`` are those of an array."""

    tag_name: str
    type: str
    dimensions: list[int]


class TagList(TypedDict):
    """The tags of a scope, and the programs, which have tags of their own."""

    tags: list[ListedTag]
    programs: list[str]


class ListedAlias(TypedDict):
    """An alias."""

    alias: str
    tag: str
    unit: str | None
    writable: bool


class AliasList(TypedDict):
    """The alias map."""

    tags: list[ListedAlias]


class AliasValue(TagValue):
    """The value of an alias's tag."""

    alias: str
    unit: str | None


class AliasWritten(TagWritten):
    """The value of an alias's tag that the controller has confirmed."""

    alias: str
    unit: str | None


class PlcInfo(TypedDict):
    """Who the controller says that it is."""

    product_name: str
    vendor_id: int
    device_type: int
    product_code: int
    revision: str
    serial_number: str
    status: int


class PlcTime(TypedDict):
    """The controller's clock: UTC, ISO 8601."""

    time: str
