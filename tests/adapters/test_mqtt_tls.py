"""The MQTT reference adapter over TLS: a terminating proxy stands before the mock broker."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import ipaddress
import queue
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from .cases import MQTT

CASE = MQTT
CLIENT = "mqtt-tls"


def certificate(folder: Path, address: str) -> tuple[Path, Path]:
    """Write a self-signed certificate for an address, and its key; return the two paths."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "otmcp tests")])
    now = datetime.datetime.now(datetime.UTC)
    signed = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(hours=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address(address))]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    files = folder / f"{address}.pem", folder / f"{address}.key"
    files[0].write_bytes(signed.public_bytes(serialization.Encoding.PEM))
    files[1].write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return files


@contextlib.contextmanager
def tls_before(port: int, files: tuple[Path, Path]) -> Iterator[int]:
    """Open a port that speaks TLS with this certificate and passes everything on to another port."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*files)
    started: queue.Queue[tuple[int, asyncio.AbstractEventLoop, asyncio.Event]] = queue.Queue()

    async def pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError), contextlib.closing(writer):
            while data := await reader.read(65536):
                writer.write(data)
                await writer.drain()

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(pump(reader, inner_writer), pump(inner_reader, writer))

    async def serve() -> None:
        stop = asyncio.Event()
        server = await asyncio.start_server(pass_on, "127.0.0.1", 0, ssl=context)
        started.put((server.sockets[0].getsockname()[1], asyncio.get_running_loop(), stop))
        await stop.wait()
        server.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    own_port, loop, stop = started.get(timeout=40.0)
    try:
        yield own_port
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join()


@pytest.fixture(scope="module")
def broker(rig: Any) -> Any:
    return rig.device


def test_everything_works_over_tls_and_bursts_do_not_get_stuck(rig: Any, broker: Any, tmp_path: Path) -> None:
    files = certificate(tmp_path, "127.0.0.1")
    with tls_before(broker.port, files) as port:
        url = f"mqtts://127.0.0.1:{port}"
        adapter = rig.start("tls", writes="true", MQTT_CLIENT_ID=CLIENT, MQTT_URL=url, SSL_CERT_FILE=str(files[0]))
        assert adapter.call("get_broker_info").data["endpoint"] == f"mqtts://127.0.0.1:{port}"
        assert adapter.call("subscribe_topic", topic="tls/#", qos=1).data["granted_qos"] == 1
        for qos in (0, 1, 2):
            assert (
                adapter.call("publish_message", topic=f"tls/{qos}", payload="x" * 100_000, qos=qos).data["qos"] == qos
            )
        # One TLS record holds many packets; data that is decrypted already does not make the socket readable.
        ids = [adapter.start("publish_message", {"topic": "tls/many", "payload": str(i), "qos": 1}) for i in range(200)]
        assert all(adapter.reply("publish_message", one).envelope["success"] for one in ids)
        adapter.call("get_broker_info")
        messages = adapter.call("read_messages", topic="tls/many", limit=1000).data["messages"]
        assert [int(one["payload"]) for one in messages] == list(range(200))
        assert adapter.call("get_broker_info").meta["connection"]["generation"] == 1
        adapter.close()


def test_a_broker_that_cannot_prove_who_it_is_gets_nothing(rig: Any, broker: Any, tmp_path: Path) -> None:
    trusted, wrong_address = certificate(tmp_path, "127.0.0.1"), certificate(tmp_path, "127.0.0.2")
    env = {"MQTT_CLIENT_ID": CLIENT, "SSL_CERT_FILE": str(wrong_address[0])}
    for files in (trusted, wrong_address):
        mark = broker.mark()
        with tls_before(broker.port, files) as port:
            adapter = rig.start("tls", writes="true", MQTT_URL=f"mqtts://127.0.0.1:{port}", **env)
            error = adapter.call("publish_message", topic="secret", payload="x", qos=1).error
            assert (error["code"], error["outcome"], error["retryable"]) == ("tls_error", "not_sent", False)
            adapter.close()
        assert broker.since(mark, kind="CONNECT", client_id=CLIENT) == []


def test_a_broker_without_tls_is_a_tls_error(rig: Any, broker: Any) -> None:
    adapter = rig.start("tls", MQTT_CLIENT_ID=CLIENT, MQTT_URL=f"mqtts://127.0.0.1:{broker.port}")
    assert adapter.call("get_broker_info").error["code"] in ("tls_error", "connect_failed")
    adapter.close()
