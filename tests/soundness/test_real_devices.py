"""Adapters at a real device, for which the servers of pyModbusTCP and of python-snap7 stand: honest ones pass, liars are found, and what it counts
itself shows that nothing was written but what a person consents to."""

from __future__ import annotations

import datetime
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pyModbusTCP.server import DataBank, DataHandler, DeviceIdentification, ModbusServer
from snap7.server import Server
from snap7.type import SrvArea

from pytest_otmcp.core.errors import NoBindingError
from pytest_otmcp.errors import UsageError
from pytest_otmcp.plant import field_device
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.plant.field_device import FieldDevice, UnrestoredError
from pytest_otmcp.protocols.field import Consent, Writable
from pytest_otmcp.record import load
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.among_genuine import with_command
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.suite.catalogue import field_tasks
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from pytest_otmcp.wire.modbus import frame

from .conftest import DEFECT, HERE, Results, failing, perform, words

IDENTITY = "Foreign Stand-in 1.0"
FIRST, LAST, HIGHEST = 100, 103, 500


class StandIn(DataHandler):
    """A device that counts the writes that it is asked for, as ``(table, address, values)``.

    Attributes:
        frozen: the second and every later write is confirmed and not carried out.
        unwritable: addresses of holding registers whose writes are refused.
        failing: how many reads of holding registers are refused; each takes one away.
        absent: the exception for registers that are not there.
    """

    def __init__(self) -> None:
        super().__init__(DataBank(coils_size=64, d_inputs_size=64, h_regs_size=200, i_regs_size=200))
        self.writes: list[tuple[str, int, list[Any]]] = []
        self.frozen = False
        self.unwritable: set[int] = set()
        self.failing = 0
        self.absent = 2
        self.data_bank.set_holding_registers(0, [1000 + 7 * address for address in range(64)])
        self.data_bank.set_input_registers(0, [5000 + 3 * address for address in range(64)])
        self.data_bank.set_coils(0, [address % 3 == 0 for address in range(64)])
        self.data_bank.set_discrete_inputs(0, [address % 5 == 0 for address in range(64)])
        self.data_bank.set_holding_registers(FIRST, self.consented)

    @property
    def consented(self) -> list[int]:
        return [11, 12, 13, 14]

    @property
    def held(self) -> list[int]:
        found: list[int] = self.data_bank.get_holding_registers(FIRST, 4)
        return found

    def write_coils(self, address: int, bits_l: list[bool], srv_info: Any) -> Any:
        self.writes.append(("coils", address, list(bits_l)))
        return super().write_coils(address, bits_l, srv_info)

    def write_h_regs(self, address: int, words_l: list[int], srv_info: Any) -> Any:
        self.writes.append(("holding_registers", address, list(words_l)))
        if self.frozen and len(self.writes) > 1:
            return DataHandler.Return(exp_code=0)
        if address in self.unwritable:
            return DataHandler.Return(exp_code=4)
        return super().write_h_regs(address, words_l, srv_info)

    def read_h_regs(self, address: int, count: int, srv_info: Any) -> Any:
        # The kit reads the consented ones one by one, and a block of others.
        if self.failing and count > 1:
            self.failing -= 1
            return DataHandler.Return(exp_code=4)
        found = super().read_h_regs(address, count, srv_info)
        return DataHandler.Return(exp_code=self.absent) if found.exp_code == 2 else found

    def outside(self) -> list[Any]:
        """Return the writes that nobody consents to."""
        return [
            write
            for write in self.writes
            if write[0] != "holding_registers"
            or not FIRST <= write[1] <= write[1] + len(write[2]) - 1 <= LAST
            or not all(0 <= value <= HIGHEST for value in write[2])
        ]


@contextmanager
def serving(identity: DeviceIdentification | None) -> Iterator[tuple[StandIn, str]]:
    stand_in = StandIn()
    server = ModbusServer("127.0.0.1", 0, no_block=True, data_hdl=stand_in, device_id=identity)
    server.start()
    try:
        yield stand_in, f"tcp://127.0.0.1:{server._service.server_address[1]}"
    finally:
        server.stop()


@pytest.fixture
def device() -> Iterator[tuple[StandIn, str]]:
    told = DeviceIdentification(vendor_name=b"Foreign", product_code=b"Stand-in", major_minor_revision=b"1.0")
    with serving(told) as found:
        yield found


def consent_to(url: str, identity: str | None = IDENTITY) -> Consent:
    writable = Writable(target=f"1/holding_registers/{FIRST}..{LAST}", lowest=0, highest=HIGHEST)
    today = datetime.date.today()
    return Consent(
        device=f"modbus={url}", identity=identity, name="a test", date=today, expires=today, writable=(writable,)
    )


Judge = Callable[..., Results]


@pytest.fixture
def judge(loop: LoopThread, warm_start: WarmStart) -> Judge:
    """``judge(url, program, …, key=…, consent=…)`` runs the items of a real device with the reference adapter, or with a program that lies;
    what is found follows from the record again."""

    def run(
        url: str,
        *lying: str,
        key: str = "modbus",
        consent: Consent | None = None,
        env: Mapping[str, str] | None = None,
        only: Sequence[str] = (),
        capture: Path | None = None,
    ) -> Results:
        subject = warm_start.subject(reference_subject())
        if lying:
            subject = with_command(subject, key, (*warm_start.python, *lying))
        if env is not None:
            adapter = subject.adapters[key]
            variants = {name: replace(one, env={**one.env, **env}) for name, one in adapter.variants.items()}
            subject = replace(subject, adapters={key: replace(adapter, variants=variants)})
        if only:
            adapter = subject.adapters[key]
            bound = {name: one for name, one in adapter.operations.items() if name in only}
            unclaimed = dict.fromkeys(adapter.operations.keys() - bound.keys(), "not for this test")
            subject = replace(subject, adapters={key: replace(adapter, operations=bound, unclaimed=unclaimed)})
        facts = {key: {"url": url, "consent": None if consent is None else consent.as_record()}}
        plant = Plant({key: url}, consents={} if consent is None else {key: consent}, capture=capture)
        bench = Bench(subject, BenchOptions(devices=facts), plant)
        try:
            return loop.run(perform(bench, [task for task in field_tasks().values() if key in task.protocols]))
        finally:
            loop.run(plant.close())

    return run


def statuses(results: Results) -> list[str]:
    """Return those of the items of a device that is not cut off."""
    return [result["status"] for name, result in results.items() if not name.startswith("F6")]


def test_without_a_consent_an_adapter_is_judged_by_reads_alone(device: tuple[StandIn, str], judge: Judge) -> None:
    stand_in, url = device
    results = judge(url)
    assert statuses(results) == ["PASS", "PASS", *["NOT_APPLICABLE"] * 3], words(results)
    assert stand_in.writes == []


def test_what_was_written_with_consent_is_given_back(device: tuple[StandIn, str], judge: Judge) -> None:
    stand_in, url = device
    results = judge(url, consent=consent_to(url))
    assert statuses(results) == ["PASS"] * 5, words(results)
    assert stand_in.writes == [("holding_registers", FIRST, [0]), ("holding_registers", FIRST, [11])]
    assert stand_in.held == stand_in.consented


LIES = {
    "MU-01": "F1-modbus F2-modbus F3-modbus F4-modbus F5-modbus",
    "MU-04": "F1-modbus F3-modbus F4-modbus F5-modbus",
    "MU-14": "F4-modbus F5-modbus",
    "MU-20": "F3-modbus",
    "MU-25": "F4-modbus",
    "MU-53c": "F1-modbus F3-modbus F4-modbus F5-modbus",
}
"""Defects to the items that find them: another register, swapped bytes, "written" of what was never sent, a guard that sends, a write that
is sent twice, a read that writes. One that reads no true value is not asked to write."""


@pytest.mark.parametrize("defect", [pytest.param(name, marks=[pytest.mark.long] * (name != "MU-14")) for name in LIES])
def test_a_lie_is_found_and_nothing_is_written_beyond_the_consent(
    device: tuple[StandIn, str], judge: Judge, defect: str
) -> None:
    stand_in, url = device
    results = judge(url, *DEFECT, defect, consent=consent_to(url))
    assert failing(results) == set(LIES[defect].split()), words(results)
    assert stand_in.outside() == []
    assert stand_in.held == stand_in.consented


@pytest.mark.long
@pytest.mark.parametrize("defect", ["MU-20", "MU-53c"])
def test_without_a_consent_no_write_of_an_adapter_arrives(
    device: tuple[StandIn, str], judge: Judge, defect: str
) -> None:
    stand_in, url = device
    judge(url, *DEFECT, defect)
    assert stand_in.writes == []


@pytest.mark.long
def test_an_adapter_that_goes_past_the_tap_is_not_asked_to_write(device: tuple[StandIn, str], judge: Judge) -> None:
    stand_in, url = device
    past = {"MODBUS_PORT": url.rpartition(":")[2]}
    results = judge(url, consent=consent_to(url), env=past)
    assert statuses(results) == ["FAIL"] * 5, words(results)
    assert "the tap before the device saw no read" in words(results)
    assert stand_in.writes == []


@pytest.mark.long
def test_an_adapter_that_reads_bits_alone_is_judged_by_them(device: tuple[StandIn, str], judge: Judge) -> None:
    stand_in, url = device
    results = judge(url, consent=consent_to(url), only=("read_coils", "write_holding"))
    assert statuses(results) == ["PASS", "PASS", *["NOT_APPLICABLE"] * 3], words(results)
    assert stand_in.writes == []


@pytest.mark.long
def test_behind_walls_there_is_no_way_past_the_tap(device: tuple[StandIn, str], loop: LoopThread) -> None:
    _, url = device
    isolation = Isolation()
    try:
        walls = isolation.walls()
        if walls is None or not walls.network:
            pytest.skip("this machine makes no networks of their own")
        plant = Plant({"modbus": url}, isolation)
        try:
            tapped = loop.run(plant.device("modbus"))
            for host, port, reached in (
                (tapped.host, tapped.port, True),
                ("127.0.0.1", int(url.rpartition(":")[2]), False),
            ):
                with walls.socket(socket.SOCK_STREAM) as inside:
                    assert (inside.connect_ex((host, port)) == 0) is reached
        finally:
            loop.run(plant.close())
    finally:
        isolation.close()


def launched(loop: LoopThread, url: str, consent: Consent | None, key: str = "modbus") -> None:
    plant = Plant({key: url}, consents={} if consent is None else {key: consent})
    try:
        loop.run(plant.device(key))
    finally:
        loop.run(plant.close())


def test_a_device_that_is_not_the_one_of_the_consent_is_not_used(device: tuple[StandIn, str], loop: LoopThread) -> None:
    stand_in, url = device
    for other in ("Another Stand-in 1.0", None):
        with pytest.raises(UsageError, match=f"it says that it is '{IDENTITY}', the consent is for {other!r}"):
            launched(loop, url, consent_to(url, other))
    assert stand_in.writes == []


def test_a_device_that_says_nothing_of_itself_has_a_consent_that_says_nothing(loop: LoopThread) -> None:
    with serving(None) as (_, url):
        launched(loop, url, consent_to(url, None))
        with pytest.raises(UsageError, match="it says that it is None"):
            launched(loop, url, consent_to(url))


def test_values_that_are_all_alike_show_nothing(device: tuple[StandIn, str], loop: LoopThread) -> None:
    _, url = device
    with pytest.raises(UsageError, match="fewer than 3 values differ"):
        launched(loop, f"{url}/150", None)
    with pytest.raises(UsageError, match="cannot be used"):
        launched(loop, "tcp://127.0.0.1:1", None)


@pytest.mark.long
def test_an_old_value_that_does_not_come_back_is_told(
    device: tuple[StandIn, str], judge: Judge, loop: LoopThread
) -> None:
    stand_in, url = device
    stand_in.frozen = True
    with pytest.raises(
        UnrestoredError, match="did not get its old values back, 1/holding_registers/100 = 11: it holds 0"
    ):
        judge(url, consent=consent_to(url))
    assert stand_in.outside() == []


@contextmanager
def real(loop: LoopThread, url: str, consent: Consent) -> Iterator[tuple[FieldDevice, Callable[[], None]]]:
    """The kit's view of a device, and what ends it; on another way out it ends in any case."""
    plant = Plant({"modbus": url}, consents={"modbus": consent})
    try:
        device = loop.run(plant.device("modbus"))
        assert isinstance(device, FieldDevice)
        yield device, lambda: loop.run(plant.close())
    finally:
        loop.run(plant.close())


def write(device: FieldDevice, first: int, *values: int) -> None:
    """Write registers as an adapter does, through the tap."""
    pdu = struct.pack(f">BHHB{len(values)}H", 16, first, len(values), 2 * len(values), *values)
    with socket.create_connection((device.host, device.port), timeout=60) as client:
        client.sendall(frame(1, 1, pdu))
        assert client.recv(12)[7] in (16, 0x90)


def test_the_old_values_are_those_from_before_the_first_write(device: tuple[StandIn, str], loop: LoopThread) -> None:
    stand_in, url = device
    with real(loop, url, consent_to(url)) as (tapped, end):
        for operators in (55, 56):
            stand_in.data_bank.set_holding_registers(FIRST, [operators])
            loop.run(tapped.poke(writes=True))
            write(tapped, FIRST, 99)
            loop.run(tapped.poke(writes=False))
            assert stand_in.held == [operators, 12, 13, 14]
        end()
    assert stand_in.held == [56, 12, 13, 14]


def test_what_else_cannot_be_read_or_written_keeps_no_old_value_away(
    device: tuple[StandIn, str], loop: LoopThread
) -> None:
    stand_in, url = device
    with real(loop, url, consent_to(url)) as (tapped, end):
        loop.run(tapped.poke(writes=True))
        write(tapped, FIRST, 91, 92)
        stand_in.failing, stand_in.unwritable = 1000, {FIRST}
        lost = f"values back, 1/holding_registers/{FIRST} = 11: it holds 91$"
        with pytest.raises(UnrestoredError, match=lost):
            loop.run(tapped.poke(writes=False))
        assert stand_in.held == [91, 12, 13, 14]
        with pytest.raises(UnrestoredError, match=lost):
            end()


def test_a_write_that_is_carried_out_late_is_taken_back_at_the_end(
    device: tuple[StandIn, str], loop: LoopThread
) -> None:
    stand_in, url = device
    for late, left in ((99, 11), (42, 42)):
        with real(loop, url, consent_to(url)) as (tapped, end):
            loop.run(tapped.poke(writes=True))
            write(tapped, FIRST, 99)
            loop.run(tapped.poke(writes=False))
            assert stand_in.held == stand_in.consented
            stand_in.data_bank.set_holding_registers(FIRST, [late])
            # What nobody has written through the tap is somebody else's.
            with nullcontext() if left == 11 else pytest.raises(UnrestoredError, match="= 11: it holds 42"):
                end()
        assert stand_in.held == [left, 12, 13, 14]


def test_a_look_that_fails_does_not_show_that_the_device_is_away(
    device: tuple[StandIn, str], loop: LoopThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in, url = device
    monkeypatch.setattr(field_device, "_GONE_S", 1.0)
    with real(loop, url, replace(consent_to(url), stop=("true",), start=("true",))) as (tapped, _):
        stand_in.failing = 3
        with pytest.raises(NoBindingError, match="still answers"):
            loop.run(tapped.stop())
        assert stand_in.failing == 0
        stand_in.failing = 1
        loop.run(tapped.start())


@pytest.mark.parametrize("absent", [1, 2, 3, 4, 6])
def test_one_refusal_alone_says_that_something_is_not_there(
    device: tuple[StandIn, str], loop: LoopThread, absent: int
) -> None:
    stand_in, url = device
    stand_in.absent = absent
    with real(loop, url, consent_to(url)) as (tapped, _):
        image: Any = loop.run(tapped.image())
        assert ("holding_registers" in image["beyond"]) == (absent == 2)


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "lowest", "highest", "expected"),
    [
        ("holding_registers/100", -5, 100, "PASS"),
        ("holding_registers/100", 11, 70000, "PASS"),
        ("holding_registers/100", -9, -5, "NOT_APPLICABLE"),
        ("coils/1", 2, 5, "NOT_APPLICABLE"),
    ],
)
def test_an_adapter_is_asked_to_write_what_a_point_can_hold(
    device: tuple[StandIn, str], judge: Judge, target: str, lowest: float, highest: float, expected: str
) -> None:
    stand_in, url = device
    writable = (Writable(target=f"1/{target}", lowest=lowest, highest=highest),)
    results = judge(url, consent=replace(consent_to(url), writable=writable))
    assert statuses(results) == ["PASS", "PASS", *[expected] * 3], words(results)
    assert stand_in.held == stand_in.consented


class Controller(Server):
    """An S7 controller that counts the requests that may change it."""

    def __init__(self) -> None:
        super().__init__(log=False)
        self.changes = 0
        for name in ("write_area", "plc_control", "plc_stop", "request_download"):
            genuine = getattr(self, f"_handle_{name}")
            setattr(self, f"_handle_{name}", partial(self._counted, genuine))

    def _counted(self, genuine: Callable[..., Any], *arguments: Any) -> Any:
        self.changes += 1
        return genuine(*arguments)


@pytest.fixture
def controller() -> Iterator[tuple[Controller, str]]:
    found = Controller()
    found.register_area(SrvArea.DB, 1, bytearray(range(10, 74)))
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    found.start_to("127.0.0.1", port)
    try:
        yield found, f"tcp://127.0.0.1:{port}"
    finally:
        found.stop()


@pytest.mark.long
@pytest.mark.parametrize(
    ("lie", "failed"), [(None, set()), ("wrong", {"F1-s7"}), ("heartbeat", {"F1-s7"}), ("zero", {"F2-s7"})]
)
def test_an_adapter_is_judged_at_an_s7_controller_that_is_only_read(
    controller: tuple[Controller, str], judge: Judge, lie: str | None, failed: set[str]
) -> None:
    counting, url = controller
    lying = [] if lie is None else [str(HERE / "lying_at_s7.py"), lie]
    results = judge(url, *lying, key="s7")
    assert failing(results) == failed, words(results)
    assert statuses(results)[2:] == ["NOT_APPLICABLE"] * 3
    assert counting.changes == 0


@pytest.mark.long
def test_no_consent_is_taken_for_an_s7_controller(controller: tuple[Controller, str], loop: LoopThread) -> None:
    counting, url = controller
    consent = replace(consent_to(url, "6ES7 315-2EH14-0AB0"), device=f"s7={url}")
    with pytest.raises(UsageError, match="nothing to S7 controllers"):
        launched(loop, url, consent, key="s7")
    assert counting.changes == 0


@pytest.mark.long
def test_a_run_by_url_writes_a_field_record_that_is_judged_again(device: tuple[StandIn, str], tmp_path: Path) -> None:
    stand_in, url = device
    today = datetime.date.today()
    (tmp_path / "consent.toml").write_text(
        f'device = "modbus={url}"\nidentity = "{IDENTITY}"\nname = "a test"\ndate = {today}\nexpires = {today}\n'
        f'[[writable]]\ntarget = "1/holding_registers/{FIRST}..{LAST}"\nlowest = 0\nhighest = {HIGHEST}\n'
    )

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command: Sequence[str] = [sys.executable, "-P", "-m", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)

    options = (f"--otmcp-device=modbus={url}", "--otmcp-consent=consent.toml", "--otmcp-report-dir=report")
    done = run("pytest", "-p", "no:cacheprovider", "--pyargs", "pytest_otmcp.conformance", *options)
    assert done.returncode == 0, done.stdout[-4000:]
    assert (
        "VERDICT: CONFORMANT (5 of 6 Modbus items passed, 1 does not apply; 5/5 runs passed; a field record, at a real device)"
        in done.stdout
    )
    record = load(tmp_path / "report" / "run.json")
    assert record["settings"]["devices"]["modbus"]["consent"]["name"] == "a test"
    for facts in record["devices"].values():
        expected = {"wire": "the kit's tap", "state": "the kit's own Modbus client", "identity": IDENTITY}
        assert facts["witnesses"] == expected
    assert stand_in.outside() == []
    verified = run("pytest_otmcp.cli", "verify", "report/run.json")
    assert verified.returncode == 0, verified.stdout + verified.stderr
    assert "a field record shows no level and earns no certificate" in verified.stdout
    (tmp_path / "consent.toml").write_text(
        (tmp_path / "consent.toml").read_text().replace(f"expires = {today}", "expires = 2020-01-01")
    )
    others = run(
        "pytest",
        "-p",
        "no:cacheprovider",
        "--pyargs",
        "pytest_otmcp.conformance",
        options[0],
        "--otmcp-suite=stress",
        "-k",
        "S7 or S10",
    )
    assert "which is never done to a real one (Modbus)" in " ".join(others.stdout.split()), others.stdout[-4000:]
    refused = run("pytest", "--pyargs", "pytest_otmcp.conformance", *options)
    assert refused.returncode == 2
    assert "--otmcp-consent" in refused.stdout + refused.stderr
