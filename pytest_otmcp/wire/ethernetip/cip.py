"""Numbers of the Common Industrial Protocol that several modules need: services and object classes.

Sources: CIP volume 1, appendix A and chapter 5; Rockwell 1756-PM020, "CIP services".
"""

from __future__ import annotations

__all__ = [
    "CONNECTION_MANAGER",
    "FORWARD_CLOSE",
    "FORWARD_OPEN",
    "GET_ALL",
    "GET_LIST",
    "GET_SINGLE",
    "IDENTITY",
    "LARGE_FORWARD_OPEN",
    "LIST_INSTANCES",
    "MESSAGE_ROUTER",
    "MODIFY",
    "MULTIPLE",
    "PROGRAM_NAME",
    "READ",
    "READ_FRAGMENT",
    "SET_LIST",
    "SYMBOL",
    "TAG_SERVICES",
    "TEMPLATE",
    "UNCONNECTED_SEND",
    "WALL_CLOCK",
    "WRITE",
    "WRITE_FRAGMENT",
]

# Services of most objects.
GET_ALL, GET_LIST, SET_LIST, GET_SINGLE, MULTIPLE = 0x01, 0x03, 0x04, 0x0E, 0x0A

# Services of tags. The numbers mean something else to other objects, as those of the connection manager show.
READ, WRITE, MODIFY, READ_FRAGMENT, WRITE_FRAGMENT, LIST_INSTANCES = 0x4C, 0x4D, 0x4E, 0x52, 0x53, 0x55
TAG_SERVICES = frozenset({READ, WRITE, MODIFY, READ_FRAGMENT, WRITE_FRAGMENT})

# Services of the connection manager.
FORWARD_CLOSE, UNCONNECTED_SEND, FORWARD_OPEN, LARGE_FORWARD_OPEN = 0x4E, 0x52, 0x54, 0x5B

# Object classes; those from 0x64 on are the vendor's.
IDENTITY, MESSAGE_ROUTER, CONNECTION_MANAGER = 0x01, 0x02, 0x06
PROGRAM_NAME, SYMBOL, TEMPLATE, WALL_CLOCK = 0x64, 0x6B, 0x6C, 0x8B
