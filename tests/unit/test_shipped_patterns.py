"""No error pattern that ``otmcp init`` writes gives a failure a code that a check then holds against the adapter.

A pattern is written into a subject file because it matched one failure; it is then searched in all of them. So each is tried on the
words of every failure that the checks provoke, and whichever code it gives must be one that the checks accept there: their own tables
say which. To give no code is always right.
"""

from __future__ import annotations

import errno
import os
import re
import socket
import tomllib
from collections.abc import Callable, Iterator
from importlib import resources

import pytest
from asyncua import ua
from paho.mqtt.client import connack_string
from pycomm3.cip.status_info import SERVICE_STATUS
from pymodbus.exceptions import ConnectionException, ModbusIOException
from pymodbus.pdu import ExceptionResponse

from conformance.requirements import adr
from pytest_otmcp.core.error_registry import WireCode, registry, wire_codes
from pytest_otmcp.onboarding.evidence import CONNECT_FAILED, CONNECTION_LOST, TIMEOUT
from pytest_otmcp.onboarding.pack import load_pack
from pytest_otmcp.protocols.registry import protocols

KNOWN = [key for key, known in protocols().items() if known.onboarding is not None]

Failure = tuple[str, tuple[str, ...]]
"""What an adapter may say of a failure, and the codes that the checks accept for it."""


def patterns(protocol: str) -> list[tuple[str, str]]:
    """Return every pattern that a file for the protocol may hold, with its code."""
    shipped = {
        "connect_failed": CONNECT_FAILED,
        "connection_lost": CONNECTION_LOST,
        "timeout": TIMEOUT,
        **load_pack(protocol).errors,
    }
    return [(pattern, code) for code, several in shipped.items() for pattern in several]


# -- what the device says ---------------------------------------------------------------------------------------------


def ethernetip_words(code: WireCode) -> list[str]:
    status = int(code.key.partition("/")[0], 16) if re.match(r"[0-9A-F]{2}(/|$)", code.key) else None
    return [SERVICE_STATUS[status]] if status in SERVICE_STATUS and "/" not in code.key else []


def mqtt_words(code: WireCode) -> list[str]:
    return [connack_string(code.value)] if code.value is not None and code.value <= 5 else []


LIBRARIES: dict[str, Callable[[WireCode], list[str]]] = {
    "modbus": lambda code: [str(ExceptionResponse(3, exception_code=code.value or 0))],
    "mqtt": mqtt_words,
    "opcua": lambda code: [str(ua.UaStatusCodeError(code.value)), *ua.status_codes.get_name_and_doc(code.value)],
    "ethernetip": ethernetip_words,
}
"""How client libraries say a code of a protocol."""


def what_the_device_says(protocol: str) -> Iterator[Failure]:
    package = f"pytest_otmcp.protocols.{protocol}"
    tables = tomllib.loads((resources.files(package) / "codes.toml").read_text(encoding="utf-8"))
    for table in tables:
        for code in wire_codes(package, table=table).values():
            if not code.codes:
                continue
            words = [code.name, *LIBRARIES.get(protocol, lambda _: [])(code)]
            if not code.key.isdecimal():
                words.append(code.key)
            if code.value is not None:
                words += [f"error 0x{code.value:02x}", f"error 0x{code.value:04X}", f"error code {code.value}"]
            yield from ((word, code.codes) for word in words)


# -- what sockets say -------------------------------------------------------------------------------------------------

SOCKETS: dict[str, list[str]] = {
    "refused": [
        *(f"[Errno {errno.ECONNREFUSED}] {words}" for words in ("Connect call failed ('127.0.0.1', 502)",)),
        f"Cannot connect to the device: {os.strerror(errno.ECONNREFUSED)}",
        "connect ECONNREFUSED 127.0.0.1:1883",
        str(ConnectionException("Failed to connect[TcpClient 127.0.0.1:502]")),
    ],
    "unreachable": [os.strerror(errno.EHOSTUNREACH), os.strerror(errno.ENETUNREACH)],
    "connect_timeout": [f"Failed to connect: {os.strerror(errno.ETIMEDOUT)}"],
    "name_resolution": [
        str(socket.gaierror(socket.EAI_NONAME, "Name or service not known")),
        "getaddrinfo ENOTFOUND plc",
    ],
    "reset": [
        *(os.strerror(number) for number in (errno.ECONNRESET, errno.EPIPE, errno.ECONNABORTED)),
        f"Failed to connect: [Errno {errno.ECONNRESET}] {os.strerror(errno.ECONNRESET)}",
        f"cannot reach the device: {os.strerror(errno.EPIPE)}",
        "The device is offline",
        "read ECONNRESET",
        # After a reset a client of a library may find that it has no connection before it makes one.
        str(ConnectionException("Not connected[TcpClient 127.0.0.1:502]")),
        "The client is not currently connected.",
    ],
    "closed": [
        "Connection closed by the device",
        str(ConnectionException("Connection unexpectedly closed 0.001 seconds into read of 8 bytes without response")),
        "Connection lost; could not connect again",
    ],
    "silent": [
        os.strerror(errno.ETIMEDOUT),
        str(ModbusIOException("No response received after 0 retries")),
        "timed out",
    ],
    "tls": ["[SSL: CERTIFICATE_VERIFY_FAILED] certificate verify failed: self-signed certificate"],
}
"""Conditions of the registry's table of sockets, to what the system and client libraries say of them."""


def what_sockets_say(protocol: str) -> Iterator[Failure]:
    table = wire_codes("pytest_otmcp.core", "errors.toml", "socket")
    for condition, words in SOCKETS.items():
        yield from ((word, table[condition].codes) for word in words)
    # A broken connection may have been made anew, and refused: then both are said, and neither is wrong.
    yield "Connection lost, and then: Connection refused", ("connect_failed", "connection_lost")


# -- what the adapter says of what it is asked ------------------------------------------------------------------------

PHRASES = (
    "{name} {value} is out of range",
    "{name} {value} out of range (0-99)",
    "{name} must be between 0 and 99",
    "{name} must be at most 99, got {value}",
    "Invalid {name}: {value}",
    "{name} {value} is not supported",
    "{name} {value} not allowed",
    "1 validation error for call\n{name}\n  Input should be less than or equal to 99",
)
GUARDS = (
    "Writes are disabled",
    "Write access denied: read-only mode",
    "Writing is not allowed in read-only mode",
    "read-only: write not permitted, set ALLOW_WRITES",
)


def what_is_said_of_inputs(protocol: str) -> Iterator[Failure]:
    known = protocols()[protocol]
    assert known.exercise is not None
    asked = {name for operation in known.operations.values() for name in operation.inputs}
    outside = asked & ({*known.exercise.outside} | {*known.exercise.bounded}) - {
        known.exercise.number,
        "value",
        "values",
    }
    for name in sorted(outside):
        yield from ((phrase.format(name=name, value=70000), adr._OUTSIDE) for phrase in PHRASES)
    for probe, value in known.probes.items():
        name = probe.partition("_")[2]
        if probe.startswith("missing_"):
            yield from ((phrase.format(name=name, value=value), adr._UNKNOWN) for phrase in PHRASES)
    yield from ((words, ("writes_disabled",)) for words in GUARDS)


FAILURES = {"device": what_the_device_says, "sockets": what_sockets_say, "inputs": what_is_said_of_inputs}


@pytest.mark.parametrize("kind", FAILURES)
@pytest.mark.parametrize("protocol", KNOWN)
def test_no_shipped_pattern_gives_a_code_that_a_check_refuses(protocol: str, kind: str) -> None:
    failures = list(FAILURES[kind](protocol))
    assert failures
    assert {code for _, accepted in failures for code in accepted} <= {*registry()}
    wrong = [
        f"{words!r} would be {code} by {pattern!r}, checks accept {', '.join(accepted)}"
        for words, accepted in failures
        for pattern, code in patterns(protocol)
        if re.search(pattern, words) and code not in accepted
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("protocol", KNOWN)
def test_each_shipped_pattern_is_for_a_failure_that_there_is(protocol: str) -> None:
    failures = [failure for kind in FAILURES.values() for failure in kind(protocol)]
    failures += [
        ("value 70000 is out of range", ("range_overflow",)),
        ("could not convert string to float: 'x'", ("type_mismatch",)),
        ("slave 5 has 2 bytes of outputs, not 3", ("limit_exceeded",)),
    ]
    for pattern, code in patterns(protocol):
        assert any(re.search(pattern, words) and code in accepted for words, accepted in failures), pattern


def test_the_table_of_sockets_is_tried_as_a_whole() -> None:
    table = wire_codes("pytest_otmcp.core", "errors.toml", "socket")
    # What the kit's own machine runs out of is no failure that a check provokes.
    assert {*table} - {*SOCKETS} <= {"keep_alive", "no_descriptors"}
