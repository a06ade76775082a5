"""The broker of the MQTT mock with mosquitto's own clients: ``mosquitto_pub``, ``mosquitto_sub`` and ``mosquitto_rr``."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session.loop import LoopThread

from .conftest import PATIENCE_S, mock

pytestmark = pytest.mark.long

both_versions = pytest.mark.parametrize("version", ["mqttv311", "mqttv5"])


class Clients:
    """Mosquitto's clients at a mock whose simulation is paused, so that nobody else publishes."""

    def __init__(self, loop: LoopThread, device: MockDevice) -> None:
        self._loop = loop
        self._device = device

    def command(self, program: str, *options: str) -> list[str]:
        """Return the command of a client."""
        return [program, "-h", self._device.host, "-p", str(self._device.port), *options]

    def run(self, program: str, *options: str) -> subprocess.CompletedProcess[str]:
        """Run a client to its end."""
        command = self.command(program, *options)
        return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)

    def publish(self, *options: str) -> None:
        done = self.run("mosquitto_pub", *options)
        assert done.returncode == 0, done.stderr

    @contextmanager
    def subscriber(self, name: str, *options: str) -> Iterator[subprocess.Popen[bytes]]:
        """Run ``mosquitto_sub`` with a client id of its own; it has its subscription when the block begins."""
        mark = self._loop.run(self._device.mark())
        command = self.command("mosquitto_sub", "-i", name, "-W", str(int(PATIENCE_S)), *options)
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            try:
                self.seen(mark, kind="SUBACK", client_id=name)
                yield process
            finally:
                process.kill()

    def seen(self, since: int, **fields: object) -> None:
        """Wait for an entry of the journal."""
        assert self._loop.run(self._device.wait(since, fields, timeout_s=PATIENCE_S)), fields

    def mark(self) -> int:
        """Return the place of the next entry of the journal."""
        return self._loop.run(self._device.mark())

    def retained(self) -> set[str]:
        """Return the topics of which the broker keeps a message."""
        return set(self._loop.run(self._device.image())["retained"])


def output(process: subprocess.Popen[bytes]) -> list[str]:
    """Wait for the end of a client that counts its messages; return the lines that it has printed."""
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    return said.decode().splitlines()


@pytest.fixture(scope="module")
def clients() -> Iterator[Clients]:
    if shutil.which("mosquitto_rr") is None:
        pytest.skip("mosquitto's clients are not installed")
    with mock("mqtt") as (loop, device):
        loop.run(device.reset())
        yield Clients(loop, device)


@both_versions
@pytest.mark.parametrize("granted", [0, 1, 2])
def test_messages_arrive_by_a_wildcard_at_the_lower_of_both_qos(clients: Clients, version: str, granted: int) -> None:
    topic, options = f"mill/{version}-{granted}", ("-V", version, "-q", str(granted), "-C", "3", "-F", "%t %q %r %p")
    with clients.subscriber("lower", "-t", f"{topic}/+/level", "-t", f"{topic}/other/#", *options) as subscriber:
        for qos in (0, 1, 2):
            clients.publish("-V", version, "-t", f"{topic}/elsewhere", "-m", "no")
            clients.publish("-V", version, "-t", f"{topic}/{qos}/level", "-q", str(qos), "-m", f"sent {qos}")
        expected = [f"{topic}/{qos}/level {min(qos, granted)} 0 sent {qos}" for qos in (0, 1, 2)]
        assert output(subscriber) == expected


@both_versions
def test_a_retained_message_is_kept_replaced_and_cleared(clients: Clients, version: str) -> None:
    topic, common = f"kept/{version}", ("-V", version, "-q", "1")
    for payload in ("old", "new"):
        clients.publish(*common, "-t", topic, "-r", "-m", payload)
    assert topic in clients.retained()
    with clients.subscriber("late", *common, "-t", topic, "-C", "1", "-F", "%r %p") as subscriber:
        assert output(subscriber) == ["1 new"]
    clients.publish(*common, "-t", topic, "-r", "-n")
    assert topic not in clients.retained()


@both_versions
def test_a_will_is_published_when_its_client_is_killed_and_not_when_it_leaves(clients: Clients, version: str) -> None:
    topic, common = f"will/{version}", ("-V", version, "-t", f"bell/{version}", "-C", "1")
    will = ("--will-topic", topic, "--will-qos", "2", "--will-payload")
    with clients.subscriber("witness", "-V", version, "-q", "2", "-t", topic, "-C", "1", "-F", "%q %p") as witness:
        with clients.subscriber("leaving", *common, *will, "left") as leaving:
            mark = clients.mark()
            clients.publish("-V", version, "-t", f"bell/{version}", "-m", "leave")
            assert output(leaving) == ["leave"]
            clients.seen(mark, kind="DISCONNECTED", client_id="leaving")
        with clients.subscriber("dying", *common, *will, "killed") as dying:
            dying.kill()
            assert output(witness) == ["2 killed"]


def test_a_client_of_mqtt_5_may_leave_with_its_will(clients: Clients) -> None:
    with clients.subscriber("witness", "-V", "mqttv5", "-t", "will/asked", "-C", "1") as witness:
        will = ("-V", "mqttv5", "-t", "nothing", "--will-topic", "will/asked", "--will-payload", "left")
        with clients.subscriber("leaving", *will) as leaving:
            # It says reason code 0x04, disconnect with will message, when it is terminated.
            leaving.terminate()
            assert output(witness) == ["left"]


@pytest.mark.parametrize(
    "session", [("-V", "mqttv311", "-c"), ("-V", "mqttv5", "-c", "-x", "3600")], ids=["3.1.1", "5"]
)
def test_messages_wait_for_a_session_that_is_away(clients: Clients, session: tuple[str, ...]) -> None:
    topic, name = f"queue/{session[1]}", f"away-{session[1]}"
    subscription = ("-i", name, *session, "-q", "2", "-t", f"{topic}/#")
    # It ends as soon as its subscription is acknowledged.
    assert clients.run("mosquitto_sub", *subscription, "-E").returncode == 0
    for qos in (1, 2):
        clients.publish("-V", session[1], "-t", f"{topic}/{qos}", "-q", str(qos), "-m", f"waited {qos}")
    back = clients.run("mosquitto_sub", *subscription, "-C", "2", "-W", str(int(PATIENCE_S)))
    assert back.stdout.splitlines() == ["waited 1", "waited 2"]


@both_versions
def test_a_payload_of_400_kb_arrives_byte_for_byte_at_qos_2(clients: Clients, version: str, tmp_path: Path) -> None:
    payload = tmp_path / "payload"
    payload.write_bytes(bytes(range(256)) * 1600)
    common = ("-V", version, "-q", "2", "-t", f"large/{version}")
    with clients.subscriber("large", *common, "-C", "1", "-N") as subscriber:
        clients.publish(*common, "-f", str(payload))
        said, _ = subscriber.communicate(timeout=PATIENCE_S)
    assert said == payload.read_bytes()


def test_properties_of_mqtt_5_travel_with_a_message(clients: Clients) -> None:
    common = ("-V", "mqttv5", "-t", "properties")
    properties = (("user-property", "unit", "bar"), ("content-type", "text/plain"), ("response-topic", "answers/here"))
    with clients.subscriber("properties", *common, "-C", "1", "-F", "%P|%C|%R|%p") as subscriber:
        clients.publish(*common, "-m", "5", *(word for each in properties for word in ("-D", "publish", *each)))
        assert output(subscriber) == ["unit:bar|text/plain|answers/here|5"]


def test_a_request_gets_its_answer(clients: Clients) -> None:
    with clients.subscriber("server", "-V", "mqttv5", "-t", "ask", "-C", "1", "-F", "%R %p") as server:
        request = ("-i", "asking", "-V", "mqttv5", "-t", "ask", "-e", "answers/ask", "-m", "how much", "-W", "60")
        command = clients.command("mosquitto_rr", *request)
        with subprocess.Popen(command, stdout=subprocess.PIPE) as asking:
            assert output(server) == ["answers/ask how much"]
            clients.publish("-V", "mqttv5", "-t", "answers/ask", "-m", "twelve")
            assert output(asking) == ["twelve"]


def test_a_shared_subscription_gives_each_message_to_one_client(clients: Clients) -> None:
    common = ("-V", "mqttv5", "-q", "1", "-t", "$share/group/shared")
    with clients.subscriber("one", *common, "-C", "5") as one, clients.subscriber("other", *common, "-C", "5") as other:
        for number in range(10):
            clients.publish("-V", "mqttv5", "-q", "1", "-t", "shared", "-m", f"{number}")
        assert sorted(output(one) + output(other)) == [f"{number}" for number in range(10)]


def test_mqtt_3_1_is_refused_in_its_own_words(clients: Clients) -> None:
    done = clients.run("mosquitto_pub", "-V", "mqttv31", "-t", "t", "-m", "x")
    assert done.returncode != 0
    assert "unacceptable protocol version" in done.stderr
