"""The account of a secure device, asked for by foreign clients: who gets in, who may read and write, and what the journal says of it."""

from __future__ import annotations

import asyncio
import json
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyAes256Sha256RsaPss
from asyncua.crypto.uacrypto import CertProperties
from mock_program import PATIENCE_S, MockProgram, RefusedError

from conftest import StartMock
from pytest_otmcp.plant import pki

pytestmark = pytest.mark.asyncio

OWN, OTHER, NONE = ("operator", "open sesame"), ("admin", "admin"), (None, None)
BY_STATE = {"any": (OWN, OTHER, NONE), "required": (OWN,), "refused": (OTHER, NONE), "denied": (OWN,)}
BAD_USER_NAME_OR_PASSWORD, NOT_AUTHORIZED, UNSPECIFIED = 0x86, 0x87, 0x80


def certificates(folder: Path, application: str = "") -> None:
    for name, content in pki.make(folder, application).items():
        (folder / f"own-{name}.pem").write_bytes(content)
    (folder / "account.json").write_text(json.dumps(OWN))


@contextmanager
def client(device: MockProgram, folder: Path, account: tuple[Any, Any], version: int) -> Iterator[Any]:
    """A client of paho's that is connecting; what the broker answers comes into its ``said``, as a name and its reason codes."""
    made: Any = paho.Client(
        paho.CallbackAPIVersion.VERSION2,
        "someone",
        protocol=paho.MQTTProtocolVersion(version),
        reconnect_on_failure=False,
    )
    made.said = queue.Queue()
    made.username_pw_set(*account)
    made.tls_set(str(folder / "own-ca.pem"))
    made.on_connect = lambda c, u, flags, reason, p: made.said.put(("CONNACK", [reason.value]))
    made.on_subscribe = lambda c, u, mid, reasons, p: made.said.put(("SUBACK", [one.value for one in reasons]))
    made.on_publish = lambda c, u, mid, reason, p: made.said.put(("PUBACK", [reason.value]))
    made.connect(device.host, device.port)
    made.loop_start()
    try:
        yield made
    finally:
        made.disconnect()
        made.loop_stop()


async def heard(made: Any) -> tuple[str, list[int]]:
    said: tuple[str, list[int]] = await asyncio.to_thread(made.said.get, timeout=PATIENCE_S)
    return said


@pytest.mark.parametrize("version", [4, 5], ids=["3.1.1", "5"])
async def test_a_broker_lets_in_whom_it_knows(start_mock: StartMock, tmp_path: Path, version: int) -> None:
    certificates(tmp_path)
    device = await start_mock("mqtt", f"--tls={tmp_path}")
    for state, welcome in BY_STATE.items():
        await device.control.poke(account=state)
        for account in (OWN, OTHER, NONE, ("operator", "wrong")):
            begun = await device.control.next()
            with client(device, tmp_path, account, version) as made:
                accepted = account in welcome or state == "any" or (state == "refused" and account != OWN)
                assert await heard(made) == ("CONNACK", [0 if accepted else BAD_USER_NAME_OR_PASSWORD])
            (login,) = await device.control.journal(begun, kind="login")
            assert (login["user"], login["accepted"]) == (account[0], accepted)
    assert OWN[1] not in json.dumps([entry for entry in await device.control.journal() if entry["kind"] == "login"])


@pytest.mark.parametrize("version", [4, 5], ids=["3.1.1", "5"])
async def test_a_broker_denies_an_account_what_it_may_not(start_mock: StartMock, tmp_path: Path, version: int) -> None:
    certificates(tmp_path)
    device = await start_mock("mqtt", f"--tls={tmp_path}")
    await device.control.poke(account="denied")
    with client(device, tmp_path, OWN, version) as made:
        await heard(made)
        made.subscribe("sensors/#", qos=1)
        assert await heard(made) == ("SUBACK", [NOT_AUTHORIZED if version == 5 else UNSPECIFIED])
        made.publish("control/pump", b"on", qos=1, retain=True)
        # 3.1.1 has no way to refuse it.
        assert await heard(made) == ("PUBACK", [NOT_AUTHORIZED if version == 5 else 0])
        made.publish("control/pump", b"on", qos=0, retain=True)
        await device.control.wait(kind="denied", count=3)
        assert "control/pump" not in (await device.control.image())["retained"]
    await device.control.ask("reset")
    with client(device, tmp_path, OTHER, version) as made:
        await heard(made)
        made.publish("control/pump", b"on", qos=1, retain=True)
        assert await heard(made) == ("PUBACK", [0])
    assert "control/pump" in (await device.control.image())["retained"]


async def test_a_server_lets_in_whom_it_knows_and_denies_him_the_plant(start_mock: StartMock, tmp_path: Path) -> None:
    certificates(tmp_path, "urn:otmcp:mock")
    device = await start_mock("opcua", f"--tls={tmp_path}")
    node = next(iter((await device.control.image())["variables"]))

    def dialling(account: tuple[Any, Any]) -> Client:
        made = Client(f"opc.tcp://{device.host}:{device.port}", timeout=PATIENCE_S, watchdog_intervall=600)
        made.application_uri = "urn:otmcp-adapter"
        if account[0] is not None:
            made.set_user(account[0])
            made.set_password(account[1])
        return made

    files = [CertProperties(tmp_path / f"own-{part}.pem", extension="pem") for part in ("cert", "key")]
    for state, welcome in BY_STATE.items():
        await device.control.poke(account=state)
        for account in (OWN, OTHER, NONE):
            begun = await device.control.next()
            made = dialling(account)
            await made.set_security(
                SecurityPolicyAes256Sha256RsaPss, *files, mode=ua.MessageSecurityMode.SignAndEncrypt
            )
            if account not in welcome:
                with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                    await made.connect()
                made.disconnect_socket()
            else:
                async with made:
                    if state == "denied":
                        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                            await made.get_node(node).read_value()
                        # What the server says of itself is not the plant's.
                        await made.get_node("i=2259").read_value()
                    else:
                        await made.get_node(node).read_value()
            (login,) = await device.control.journal(begun, kind="login")
            assert (login["user"], login["accepted"]) == (account[0], account in welcome)
            assert len(await device.control.journal(begun, kind="denied")) == (state == "denied" and account == OWN)


@pytest.mark.parametrize("name", ["mqtt", "opcua"])
async def test_what_has_no_account_is_told_so(start_mock: StartMock, tmp_path: Path, name: str) -> None:
    plain = await start_mock(name)
    with pytest.raises(RefusedError, match="started with an account"):
        await plain.control.poke(account="required")
    certificates(tmp_path, "urn:otmcp:mock" if name == "opcua" else "")
    secure = await start_mock(name, f"--tls={tmp_path}")
    with pytest.raises(RefusedError, match="expected one of any, required, refused, denied"):
        await secure.control.poke(account="nobody")
