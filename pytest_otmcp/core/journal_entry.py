"""The contract of journal entries, which every witness (a mock or a tap) writes and every record keeps. Pure."""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

__all__ = ["JournalEntry", "OwnerProcess"]


class OwnerProcess(TypedDict):
    """The process that had a connection when it was accepted: its number and the name of its program."""

    pid: int
    name: str


class JournalEntry(TypedDict):
    """One message or event that a device received or sent; a protocol adds members of its own.

    ``seq``: sequence number, from 0 since the device was started, without gaps. ``connection``: number of the
    connection, 0 for none. ``direction``: ``in`` for what the device received, ``out`` for what it sent. ``kind``: its
    type, in the protocol's words. ``origin``: who caused it: the adapter's session (``client``), one that is over
    (``former``), another program (``stranger``), somebody who cannot be known and has not spoken the protocol
    (``unknown``), the ``plant``'s own simulation, or the ``kit``. ``process``: the process that has the connection,
    when it was accepted, and of everything that is not the adapter's. ``request``: a client asks the plant for something; keeping a session alive is no
    request. ``state_changing``: a request that may change the plant. ``answers``: ``seq`` of the request that this
    entry answers, or None.

    Of a message ``frame`` has its bytes in hexadecimal digits, frame by frame, and ``told`` what the device says of it that its bytes do
    not say; everything else follows from these two and from the messages before it. An event that is no message has neither.
    """

    seq: int
    t_ns: int
    connection: int
    direction: Literal["in", "out"]
    kind: str
    origin: Literal["client", "former", "stranger", "unknown", "plant", "kit"]
    request: bool
    state_changing: bool
    answers: int | None
    process: NotRequired[OwnerProcess]
    frame: NotRequired[str]
    told: NotRequired[dict[str, Any]]
