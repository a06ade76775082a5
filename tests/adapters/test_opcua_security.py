"""The OPC UA reference adapter over a secure channel: a server of asyncua's with good and bad certificates."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any

import pytest
from asyncua import Server, ua
from asyncua.server.user_managers import User, UserRole
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID
from pytest_otmcp.reference_adapters.core import ConfigError, Environment
from pytest_otmcp.reference_adapters.opcua.security import Security

from pytest_otmcp.plant.pki import Authority
from pytest_otmcp.session.free_port import free_port

from .cases import OPCUA

CASE = OPCUA
SERVER, CLIENT = "urn:otmcp:test-server", "urn:otmcp:test-client"
EVERY = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Basic256Sha256_Sign,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
]


class SecureServer:
    """A server in a thread. ``users`` are the names of those that it was asked to let in: nobody sends one to a server that is refused."""

    def __init__(self, folder: Path) -> None:
        self.users: list[str | None] = []
        self._folder = folder
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        self.url = f"opc.tcp://127.0.0.1:{free_port(socket.socket)}"

    def get_user(
        self, iserver: Any, username: str | None = None, password: Any = None, certificate: Any = None
    ) -> User:
        self.users.append(username)
        return User(role=UserRole.User)

    def run(self, work: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(timeout=40.0)

    async def start(self) -> None:
        self._server = Server(user_manager=self)
        await self._server.init()
        self._server.set_endpoint(self.url)
        await self._server.set_application_uri(SERVER)
        await self._server.start()

    async def present(self, files: tuple[bytes, bytes], policies: list[ua.SecurityPolicyType]) -> None:
        for kind, content in zip(("certificate", "key"), files, strict=True):
            (self._folder / f"server-{kind}.pem").write_bytes(content)
        server = self._server
        await server.load_certificate(self._folder / "server-certificate.pem")
        await server.load_private_key(self._folder / "server-key.pem")
        server.set_security_policy(policies)
        server._policies.clear()
        server.iserver.endpoints.clear()
        await server._setup_server_nodes()

    def close(self) -> None:
        self.run(self._server.stop())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


@pytest.fixture(scope="module")
def issuer() -> Authority:
    return Authority("otmcp tests")


@pytest.fixture(scope="module")
def key() -> rsa.RSAPrivateKey:
    return rsa.generate_private_key(65537, 2048)


@pytest.fixture(scope="module")
def settings(issuer: Authority, key: rsa.RSAPrivateKey, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("client")
    certificate, private = issuer.issue("client", uris=(CLIENT,), key=key)
    files = {"OPCUA_CA": issuer.pem, "OPCUA_CERT": certificate, "OPCUA_KEY": private}
    for name, content in files.items():
        (folder / f"{name}.pem").write_bytes(content)
    return {name: str(folder / f"{name}.pem") for name in files}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecureServer]:
    made = SecureServer(tmp_path_factory.mktemp("server"))
    made.run(made.start())
    yield made
    made.close()


def read(rig: Any, server: SecureServer, settings: dict[str, str], **more: str) -> Any:
    """Read the server's state through an adapter of its own; return the envelope."""
    adapter = rig.start("secure", OPCUA_URL=server.url, OPCUA_TIMEOUT_S="5", OPCUA_DEADLINE_S="20", **settings, **more)
    reply = adapter.call("read_opcua_node", node_id="i=2259")
    adapter.close()
    return reply


def test_each_policy_works_and_the_user_is_told_over_an_encrypted_channel(
    rig: Any, server: SecureServer, issuer: Authority, key: rsa.RSAPrivateKey, settings: dict[str, str]
) -> None:
    server.run(server.present(issuer.issue("server", uris=(SERVER,), key=key), EVERY))
    for policy, mode in (
        ("Basic256Sha256", "SignAndEncrypt"),
        ("Basic256Sha256", "Sign"),
        ("Aes128_Sha256_RsaOaep", "SignAndEncrypt"),
        ("Aes256_Sha256_RsaPss", "SignAndEncrypt"),
    ):
        account = {"OPCUA_USERNAME": "ada", "OPCUA_PASSWORD": "secret"} if mode != "Sign" else {}
        before = len(server.users)
        more = {"OPCUA_SECURITY_POLICY": policy, "OPCUA_SECURITY_MODE": mode, **account}
        assert read(rig, server, settings, **more).data["value"] == 0
        assert server.users[before:] == [account.get("OPCUA_USERNAME")]


def test_a_server_that_cannot_prove_who_it_is_is_refused_before_a_user_is_told(
    rig: Any, server: SecureServer, issuer: Authority, key: rsa.RSAPrivateKey, settings: dict[str, str]
) -> None:
    own: dict[str, Any] = {"uris": (SERVER,), "key": key}
    bad = {
        "issuer": Authority("otmcp tests").issue("server", **own),
        "expired": issuer.issue("server", days=(-9, -1), **own),
        "not valid yet": issuer.issue("server", days=(1, 9), **own),
        "host": issuer.issue("server", hosts=("plant.example",), **own),
        "application": issuer.issue("server", uris=("urn:other",), key=key),
        "for a server": issuer.issue("server", usage=(ExtendedKeyUsageOID.CLIENT_AUTH,), **own),
        "too short": issuer.issue("server", uris=(SERVER,), key=rsa.generate_private_key(65537, 1024)),  # noqa: S505
    }
    before = len(server.users)
    for word, files in bad.items():
        server.run(server.present(files, EVERY))
        error = read(rig, server, settings, OPCUA_USERNAME="ada", OPCUA_PASSWORD="secret").error  # noqa: S106
        assert (error["code"], error["outcome"]) == ("tls_error", "not_sent"), (word, error)
        assert word in error["details"]["reason"]
    server.run(server.present(issuer.issue("server", **own), [ua.SecurityPolicyType.NoSecurity]))
    error = read(rig, server, settings, OPCUA_USERNAME="ada", OPCUA_PASSWORD="secret").error  # noqa: S106
    assert (error["code"], error["details"]["reason"]) == ("tls_error", "it has no endpoint with this policy and mode")
    assert len(server.users) == before


def test_settings_that_are_no_security_stop_the_start(settings: dict[str, str], tmp_path: Path) -> None:
    def refused(**more: str) -> str:
        with pytest.raises(ConfigError) as caught:
            Security.of(Environment({**settings, **more}), "127.0.0.1")
        return str(caught.value)

    assert Security.of(Environment({}), "127.0.0.1") is None
    assert "OPCUA_CA" in refused(OPCUA_CA=str(tmp_path / "nothing"))
    assert "application URI" in refused(OPCUA_CERT=settings["OPCUA_CA"])
    assert "Basic256Sha256" in refused(OPCUA_SECURITY_POLICY="Basic128Rsa15")
    assert "SignAndEncrypt" in refused(OPCUA_SECURITY_MODE="None")
    assert "password" in refused(OPCUA_SECURITY_MODE="Sign", OPCUA_PASSWORD="secret")  # noqa: S106
