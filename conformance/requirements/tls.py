"""TLS: the secure form of a protocol, for subjects that have a launch for it.

The mock's own end of TLS is the witness (``mocks/tls``): its journal has each handshake with the device's certificate and the client's, and
what was sent over a connection has that connection's number. A bad certificate stands between two good ones: what works with these shows
that a refusal was of the certificate.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from pytest_otmcp.core.credentials import CLIENT, ROLE
from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import HANDSHAKES, Entries, JournalEntry
from pytest_otmcp.protocols.oracle import has
from pytest_otmcp.protocols.protocol import CLIENT_CERTIFICATE, SECURE
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.expectations import failed
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import EndedError, Rig

from .steps import CONNECTION_FAULTS, answers_again, exercise, read

__all__ = ["TASKS"]

TASKS = Checks()

_GOOD, _OTHER_GOOD, _NOTHING = "server", "server2", "nothing"
_BAD = {
    "unknown_issuer": "a device with a certificate of an unknown issuer",
    "self_signed": "a device with a certificate that has signed itself",
    "expired": "a device with a certificate that has expired",
    "not_yet_valid": "a device with a certificate that is not valid yet",
    "other_host": "a device with a certificate for another host",
    "client_only": "a device with a certificate that is for clients alone",
    "weak_key": "a device with a key of 1024 bits",
    "other_application": "a device with a certificate for another application",
    "old": "a device that offers only what is deprecated",
}
"""What the mock presents, by its own word for it."""
_CODES = ("tls_error", "config_error", "auth_failed", *CONNECTION_FAULTS)
_NO_DATA = HANDSHAKES | {"CONNECTED", "DISCONNECTED"}


@TASKS.every_protocol("TLS-001", "A secure connection is never given up for a plain one.", launch=SECURE)
async def nothing_goes_in_clear(run: Repetition, at: Rig, secure: Rig) -> None:
    """Read through an adapter that was told to connect securely; read while the same port is that of a device without security; read when it
    is the secure one again.

    Said: success; a failure with `tls_error`; success.
    Seen: a handshake of TLS 1.2 at least, and what was read after it; nothing in clear.
    Why: whoever sits in between needs only to say that it has no encryption, and reads and writes along.
    """
    await _handshake(run, secure, "TLS-001", _OTHER_GOOD)
    await _refused(run, secure, "TLS-001", _NOTHING, "a device without encryption")
    await _handshake(run, secure, "TLS-001", _GOOD)


@TASKS.every_protocol("TLS-002", "A device that cannot prove who it is gets nothing.", launch=SECURE)
async def bad_certificates_are_refused(run: Repetition, at: Rig, secure: Rig) -> None:
    """Read while the device presents a bad certificate: of an unknown issuer, signed by itself, expired, not valid yet, for another host, for
    clients alone, with a weak key, over OPC UA for another application; and while it offers only TLS 1.1, or a deprecated policy. Between them, read while it presents a good one, each time another.

    Said: failures with `tls_error`; success with the good ones.
    Seen: handshakes that end, and not one byte of data; with the good ones what was read.
    Why: encryption with somebody unknown is a private talk with the attacker.
    """
    good = [_OTHER_GOOD, _GOOD]
    await _handshake(run, secure, "TLS-002", _OTHER_GOOD)
    for index, (name, what) in enumerate(_BAD.items()):
        if name == "other_application" and not protocols()[secure.protocol].application:
            continue
        await _refused(run, secure, "TLS-002", name, what)
        await _handshake(run, secure, "TLS-002", good[1 - index % 2])


@TASKS.every_protocol(
    "TLS-003",
    "The adapter's own certificate is presented, and without it there is no connection.",
    launch=SECURE,
    facets=CLIENT_CERTIFICATE,
)
async def the_own_certificate_is_presented(run: Repetition, at: Rig, secure: Rig) -> None:
    """Read at a device that asks for a certificate and can do without; start the adapter without the files of its certificate, and read; start it as
    always, and read.

    Said: success; no start, or a failure with `tls_error` or `config_error`; success.
    Seen: the subject of the certificate, and the security policy and mode that the subject file says were configured; without it nothing;
        the same again.
    Why: a certificate that is configured and not presented is a login that nobody checks.
    """
    await _presents(run, secure, await _handshake(run, secure, "TLS-003", _OTHER_GOOD))
    await secure.close_session()
    if await secure.start_without_certificate():
        begun = len(await secure.journal())
        _, reply = await read(run, secure)
        run.fails(reply, *_CODES, requirement="TLS-003")
        sent = _data(secure, (await secure.journal())[begun:], subject=None)
        if sent:
            message = f"{reply.label}: without the adapter's certificate the device should have received nothing, it received {_told(secure, sent)}"
            run.witnessed([Finding(code="no_certificate", message=message, requirement="TLS-003")])
    await secure.fresh_session()
    await _presents(run, secure, await _handshake(run, secure, "TLS-003", _GOOD))


@TASKS.check(
    "TLS-004",
    "The role is presented, and a refusal for it is told as one.",
    needs="modbus.read_holding modbus.secure modbus.client_certificate",
)
async def the_role_is_presented(run: Repetition, modbus: Rig, modbus_secure: Rig) -> None:
    """Read; read while the device answers with exception 01, which over TLS says that the role may not.

    Said: success; a failure with `access_denied`, which is recommended.
    Seen: the role in the adapter's certificate.
    Why: "not supported" sends an engineer to the manual, "not allowed" to the person who can allow it.
    """
    opened = await _handshake(run, modbus_secure, "TLS-004", _OTHER_GOOD)
    roles = {entry.get("role") for entry in opened}
    if roles != {ROLE}:
        message = f"modbus: the device should have seen the role {ROLE!r}, it saw {', '.join(map(repr, roles))}"
        run.witnessed([Finding(code="no_role", message=message, requirement="TLS-004", strength="SHOULD")])
    await modbus_secure.device.fault({"action": {"exception": 1}})
    _, reply = await read(run, modbus_secure)
    await modbus_secure.device.fault()
    run.judge(reply, [replace(one, strength="SHOULD") for one in failed(reply, "access_denied", requirement="TLS-004")])
    await _handshake(run, modbus_secure, "TLS-004", _GOOD)


async def _handshake(run: Repetition, at: Rig, row: str, name: str) -> Entries:
    """Present a good certificate and read: a success, over a connection that was opened with it. Return the handshakes."""
    begun = len(await at.journal())
    await at.device.poke(tls=name)
    asked = exercise(at).read(run.rng)
    reply = await at.call(asked.operation, role="control", **asked.inputs)
    if plain := _in_clear(at, (await at.journal())[begun:]):
        # Everything else that fails has this cause.
        run.witnessed([_sent_in_clear(at, reply, "a device with encryption", plain)])
        raise EndedError
    reply = await answers_again(run, at, requirement=row)
    opened = [entry for entry in (await at.journal())[begun:] if entry["kind"] == "tls_open"]
    if reply.success and not opened:
        message = f"{reply.label}: the device should have seen a handshake of TLS, it saw none"
        run.witnessed([Finding(code="no_handshake", message=message, requirement=row)])
    return opened


async def _refused(run: Repetition, at: Rig, row: str, name: str, what: str) -> None:
    """Read while the device is not to be trusted: a failure, and nothing that was sent."""
    begun = len(await at.journal())
    await at.device.poke(tls=name)
    _, reply = await read(run, at)
    entries = (await at.journal())[begun:]
    plain, sent = _in_clear(at, entries), _data(at, entries, certificate=name)
    told = run.fails(reply, *_CODES, requirement="TLS-001" if plain else row)
    if plain:
        run.witnessed([_sent_in_clear(at, reply, what, plain)])
    elif told:
        _advise(run, reply, "tls_error", row)
    if sent:
        message = f"{reply.label}: {what} should have received nothing, it received {_told(at, sent)}"
        run.witnessed([Finding(code="untrusted_device", message=message, requirement=row)])


async def _presents(run: Repetition, at: Rig, opened: Entries) -> None:
    subjects = {entry.get("subject") for entry in opened}
    if opened and subjects != {f"CN={CLIENT}"}:
        shown = ", ".join("none" if subject is None else repr(subject) for subject in subjects)
        message = f"{at.protocol}: the device should have seen the certificate 'CN={CLIENT}', it saw {shown}"
        run.witnessed([Finding(code="no_certificate", message=message, requirement="TLS-003")])
    told = at.subject.secured
    for made in {tuple(str(entry.get(name)) for name in told) for entry in opened} - {tuple(told.values())}:
        wanted, found = " and ".join(told.values()), " and ".join(made)
        message = (
            f"{at.protocol}: the device should have seen a channel of {wanted}, as configured, it saw one of {found}"
        )
        run.witnessed([Finding(code="other_security", message=message, requirement="TLS-003")])


def _data(at: Rig, entries: Entries, **handshake: object) -> list[JournalEntry]:
    """Return what clients have sent over connections that began with such a handshake; what was opened before is nobody's fault."""
    opened = {entry["connection"] for entry in entries if has(entry, kind="tls_open", **handshake)}
    known = protocols()[at.protocol]
    allowed = _NO_DATA.union(known.discovery, known.introduction)
    return [entry for entry in _sent(entries, allowed) if entry["connection"] in opened]


def _sent(entries: Entries, allowed: Collection[str]) -> list[JournalEntry]:
    return [entry for entry in entries if entry["direction"] == "in" and entry["kind"] not in allowed]


def _in_clear(at: Rig, entries: Entries) -> list[JournalEntry]:
    """Return what came in clear: of no handshake, or over a connection without one. What nobody can read was not sent in clear."""
    refused = [entry for entry in entries if entry["kind"] == "tls_plaintext"]
    opened = {entry["connection"] for entry in entries if entry["kind"] == "tls_open"}
    made = {entry["connection"] for entry in entries if entry["kind"] == "CONNECTED"} - opened
    allowed = _NO_DATA.union(protocols()[at.protocol].discovery, {"malformed"})
    return [*refused, *(entry for entry in _sent(entries, allowed) if entry["connection"] in made)]


def _sent_in_clear(at: Rig, reply: Reply, what: str, plain: Entries) -> Finding:
    message = f"{reply.label}: {what} should have received nothing in clear, it received {_told(at, plain)}"
    return Finding(code="sent_in_clear", message=message, requirement="TLS-001")


def _told(at: Rig, entries: Sequence[JournalEntry]) -> str:
    first = entries[0]
    if first["kind"] in ("tls_plaintext", "malformed"):
        return f"bytes {first.get('bytes', ''):.60}"
    return protocols()[at.protocol].seen(entries, most=2)


def _advise(run: Repetition, reply: Reply, code: str, row: str) -> None:
    """Warn where a failure has another code than the best one."""
    found = [one for one in failed(reply, code, requirement=row) if one.code == "wrong_error_code"]
    run.judge(reply, [replace(one, strength="SHOULD") for one in found])
