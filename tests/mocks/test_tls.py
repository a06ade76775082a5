"""A device's own end of TLS: its handshakes are on the journal, its certificate can be changed, and its faults act on plaintext."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyAes256Sha256RsaPss
from asyncua.crypto.uacrypto import CertProperties
from mock_program import PATIENCE_S, MockProgram, RefusedError

from conftest import StartMock
from pytest_otmcp.plant import pki

pytestmark = pytest.mark.asyncio

READ = bytes.fromhex("000100000006010300000002")
BAD = (
    "unknown_issuer",
    "self_signed",
    "expired",
    "not_yet_valid",
    "other_host",
    "client_only",
    "weak_key",
    "old",
    "nothing",
)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A folder of certificates, and in it those of a client."""
    for name, content in pki.make(tmp_path).items():
        (tmp_path / f"own-{name}.pem").write_bytes(content)
    return tmp_path


def context(own: Path, *, named: bool = True) -> ssl.SSLContext:
    made = ssl.create_default_context(cafile=own / "own-ca.pem")
    if named:
        made.load_cert_chain(own / "own-cert.pem", own / "own-key.pem")
    return made


async def dial(device: MockProgram, tls: ssl.SSLContext | None) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_connection(device.host, device.port, ssl=tls)


async def asked(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
    """Read two registers."""
    writer.write(READ)
    async with asyncio.timeout(PATIENCE_S):
        return await reader.readexactly(13)


async def kinds(device: MockProgram) -> list[Any]:
    return [entry["kind"] for entry in await device.control.journal()]


async def test_a_handshake_and_the_peer_are_on_the_journal_and_frames_are_plaintext(
    start_mock: StartMock, own: Path
) -> None:
    device = await start_mock("modbus", f"--tls={own}")
    for named, subject, role in ((True, "CN=otmcp-adapter", "otmcp-operator"), (False, None, None)):
        reader, writer = await dial(device, context(own, named=named))
        assert len(await asked(reader, writer)) == 13
        writer.close()
        await device.control.wait(kind="DISCONNECTED", connection=2 - named)
        (opened,) = await device.control.journal(kind="tls_open", connection=2 - named)
        assert (opened["version"], opened["certificate"]) == ("TLSv1.3", "server")
        assert (opened["subject"], opened["role"]) == (subject, role)
    one = ["CONNECTED", "tls_open", "request", "response", "DISCONNECTED"]
    assert await kinds(device) == [*one, *one]


async def test_bad_certificates_are_refused_by_a_sound_client_and_nothing_reaches_the_device(
    start_mock: StartMock, own: Path
) -> None:
    device = await start_mock("modbus", f"--tls={own}")
    for count, name in enumerate(BAD, 1):
        await device.control.poke(tls=name)
        with pytest.raises((ssl.SSLError, ConnectionError)):
            await dial(device, context(own))
        ended = await device.control.wait(kind="tls_ended", count=count)
        assert ended[-1]["certificate"] == name
    assert await kinds(device) == ["tls", "tls_ended"] * len(BAD)


async def test_plaintext_is_refused_where_tls_is_spoken_and_served_where_it_is_not(
    start_mock: StartMock, own: Path
) -> None:
    device = await start_mock("modbus", f"--tls={own}")
    reader, writer = await dial(device, None)
    writer.write(READ)
    assert await reader.read() == b""
    writer.close()
    (plain,) = await device.control.wait(kind="tls_plaintext")
    assert (plain["bytes"], plain["count"]) == (READ[:8].hex(), len(READ))
    await device.control.poke(tls="nothing")
    reader, writer = await dial(device, None)
    assert len(await asked(reader, writer)) == 13
    writer.close()
    assert await device.control.journal(kind="tls_open") == []


async def test_another_certificate_ends_connections_and_a_reset_brings_the_first_one_back(
    start_mock: StartMock, own: Path
) -> None:
    device = await start_mock("modbus", f"--tls={own}")
    for expected, change in (("server", {"tls": "server2"}), ("server2", None)):
        reader, writer = await dial(device, context(own))
        await asked(reader, writer)
        await (device.control.ask("reset") if change is None else device.control.poke(**change))
        assert await reader.read() == b""
        writer.close()
        assert [entry["certificate"] for entry in await device.control.journal(kind="tls_open")][-1] == expected
    reader, writer = await dial(device, context(own))
    await asked(reader, writer)
    writer.close()
    assert (await device.control.journal(kind="tls_open"))[-1]["certificate"] == "server"


async def test_faults_act_on_plaintext(start_mock: StartMock, own: Path) -> None:
    device = await start_mock("modbus", f"--tls={own}")
    reader, writer = await dial(device, context(own))
    good = await asked(reader, writer)
    await device.control.fault({"mangle": {"flip": [[9, 255]]}})
    spoilt = await asked(reader, writer)
    assert [index for index in range(13) if good[index] != spoilt[index]] == [9]
    await device.control.fault({"drip_s": 0.01})
    assert await asked(reader, writer) == good
    await device.control.fault({"half_open": True})
    writer.write(READ)
    await device.control.wait(kind="request", count=4)
    await device.control.ask("fault", rules=[])
    writer.write(READ)
    await device.control.wait(kind="lost")
    writer.close()


async def test_the_broker_ends_in_an_orderly_way(start_mock: StartMock, own: Path) -> None:
    device = await start_mock("mqtt", f"--tls={own}")
    reader, writer = await dial(device, context(own))
    # A CONNECT with the level 3 of MQTT 3.1 is refused by a CONNACK, and then by the end of the connection.
    writer.write(bytes.fromhex("100e00064d51497364700302003c0000"))
    assert (await reader.read())[:1] == b"\x20"
    writer.close()
    await device.control.wait(kind="DISCONNECTED")


async def test_what_has_no_certificates_is_told_so(start_mock: StartMock, own: Path) -> None:
    plain = await start_mock("modbus")
    with pytest.raises(RefusedError, match="started with certificates"):
        await plain.control.poke(tls="server2")
    secure = await start_mock("modbus", f"--tls={own}")
    with pytest.raises(RefusedError, match="no certificate 'nobody'"):
        await secure.control.poke(tls="nobody")


async def test_an_opc_ua_server_has_secure_channels_and_the_journal_has_what_is_said_in_them(
    start_mock: StartMock, tmp_path: Path
) -> None:
    own = pki.make(tmp_path, "urn:otmcp:mock")
    device = await start_mock("opcua", f"--tls={tmp_path}")
    for name in ("server", "server2"):
        await device.control.poke(tls=name)
        client = Client(f"opc.tcp://{device.host}:{device.port}", timeout=PATIENCE_S, watchdog_intervall=600)
        client.application_uri = "urn:otmcp-adapter"
        files = [CertProperties(own[part], extension="pem") for part in ("cert", "key")]
        await client.set_security(SecurityPolicyAes256Sha256RsaPss, *files, mode=ua.MessageSecurityMode.SignAndEncrypt)
        begun = await device.control.next()
        async with client:
            await client.get_node("i=2259").read_value()
        await device.control.wait(begun, kind="DISCONNECTED")
        (opened,) = await device.control.journal(begun, kind="tls_open")
        assert (opened["certificate"], opened["subject"]) == (name, "CN=otmcp-adapter")
        assert (opened["version"], opened["cipher"]) == ("Aes256_Sha256_RsaPss", "SignAndEncrypt")
        (read, _) = await device.control.journal(begun, kind="Read")
        assert read["nodes"] == [{"node_id": "i=2259", "attribute": "Value"}]
        assert await device.control.journal(begun, kind="Sealed") == []
    await device.control.poke(tls="nothing")
    with pytest.raises(ua.UaError, match="No matching endpoints"):
        await client.set_security(SecurityPolicyAes256Sha256RsaPss, *files)
