"""Nothing is written to a device that is not the mock: a second device, the plant, sees reads at most."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.plant.device import Device
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.protocols.oracle import state_changing
from pytest_otmcp.protocols.own import OWN
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Subject, load_subject, reference_subject
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from tests.trials import as_read, recorded

from .conftest import HERE, SUBJECTS, Results

WRITING = {
    "modbus": "M3 M4 FM2 S4",
    "mqtt": "Q3 Q4 FQ1",
    "opcua": "O3 FO2 S6",
    "s7": "K3 K4 FK3 SK2",
    "bacnet": "B3 B4 FB3 SB2",
    "ethernetip": "E3 E4 FE3 SE2",
    "dnp3": "D3 D4 FD4 SD2",
    "profibus": "P3 P4 FP3 SP2",
}
"""Without the protocols of a cable: an adapter in its network reaches the mock alone."""

GUARDED = ("M4", "K4", "B4", "E4", "D4", "P4")
"""Items about the variant with writes disabled alone."""

OUTAGE = {"modbus": "S10", "mqtt": "S11", "opcua": "S12", "s7": "SK4", "ethernetip": "SE4", "dnp3": "SD4"}
READING = {
    "modbus": "M2",
    "mqtt": "Q1",
    "opcua": "O1",
    "s7": "K2",
    "bacnet": "B2",
    "ethernetip": "E2",
    "dnp3": "D2",
    "profibus": "P2",
}

Elsewhere = Callable[[str], Device]


@pytest.fixture
def elsewhere(loop: LoopThread, plant: Plant) -> Elsewhere:
    """``elsewhere(protocol)``: the other device, as it is at its start."""

    def device(protocol: str) -> Device:
        found = loop.run(plant.device(f"{protocol}@elsewhere"))
        loop.run(found.forget(loop.run(found.mark())))
        return found

    return device


def wandering(warm_start: WarmStart, protocol: str, manner: str, **env: str) -> Subject:
    """The reference adapter that is led elsewhere in this manner, as the only one of its subject."""
    genuine = reference_subject().adapters[protocol]
    command = (*warm_start.python, str(HERE / "wandering.py"), protocol, manner)
    variants = {
        name: replace(variant, command=command, env={**variant.env, **env})
        for name, variant in genuine.variants.items()
    }
    adapter = replace(genuine, variants=variants)
    return Subject(name="wandering", version="0", adapters={protocol: adapter}, source=HERE)


def address(device: Device) -> str:
    """Host and port of a device, or the path of its pseudo terminal."""
    (first, *_) = device.endpoints.values()
    return first.path or f"{first.host}:{first.port}"


def place_of(device: Device) -> str:
    """What stands in a subject file for such an address."""
    return "{host}:{port}" if device.port else "{serial}"


async def run_items(subject: Subject, plant: Plant, names: str) -> Results:
    bench = Bench(subject, BenchOptions(), plant)
    try:
        tasks = tasks_by_id(subject.adapters)
        results = {name: await measured(bench, tasks[name]) for name in names.split()}
        record = recorded(bench, results.values())
    finally:
        await bench.close()
    assert await asyncio.to_thread(rejudge, as_read(record)) == []
    return results


def seen_by(loop: LoopThread, device: Device) -> list[str]:
    """What may have changed a device."""
    journal = loop.run(device.journal(loop.run(device.first())))
    return [entry["kind"] for entry in state_changing(journal.entries)]


MANNERS: dict[str, dict[str, str]] = {
    "misspelt": {"ADRESS": "PLACE"},
    "hard-wired": {},
    "home": {},
}


@pytest.mark.parametrize(
    "protocol", [pytest.param(name, marks=() if name == "mqtt" else pytest.mark.long) for name in WRITING]
)
@pytest.mark.parametrize(
    "manner", [pytest.param(name, marks=() if name == "misspelt" else pytest.mark.long) for name in MANNERS]
)
def test_an_adapter_that_talks_to_the_plant_is_never_told_to_write(
    loop: LoopThread,
    plant: Plant,
    elsewhere: Elsewhere,
    warm_start: WarmStart,
    tmp_path: Path,
    manner: str,
    protocol: str,
) -> None:
    other = elsewhere(protocol)
    (tmp_path / "address").write_text(address(other), encoding="utf-8")
    place = {name: text.replace("PLACE", place_of(other)) for name, text in MANNERS[manner].items()}
    env = {"PLANT": address(other), "HOME": str(tmp_path), **place}
    subject = wandering(warm_start, protocol, manner, **env)
    first, *later = WRITING[protocol].split()
    results = loop.run(run_items(subject, plant, f"{READING[protocol]} {WRITING[protocol]}"))
    assert seen_by(loop, other) == []

    assert results[READING[protocol]]["status"] == "FAIL"
    (finding,) = results[first]["findings"]
    mock = loop.run(plant.device(protocol))
    assert f"{protocol}: the adapter does not talk to the mock device at " in finding["message"]
    assert address(mock) in finding["message"]
    assert f"it names {reference_scheme(protocol)}://{address(other)}" in finding["message"]
    assert "nothing was written" in finding["message"]
    assert (f"env.{list(env)[-1]}" in finding["message"]) == (manner == "misspelt")
    assert [call["role"] for part in results[first]["around"] for call in part["calls"]] != []
    assert {call["role"] for part in results[first]["around"] for call in part["calls"]} == {"setup"}
    for name in later:
        assert results[name]["status"] == "FAIL"
        assert [call for sample in results[name]["samples"] for call in sample["calls"] if call["role"] == "task"] == []
        # The session with writes disabled is another one, with a device of its own.
        assert results[name]["findings"][0]["cause"] == (None if name in GUARDED else first)


def reference_scheme(protocol: str) -> str:
    return protocols()[protocol].scheme


@pytest.mark.parametrize(
    "protocol", [pytest.param(name, marks=() if name == "mqtt" else pytest.mark.long) for name in OUTAGE]
)
@pytest.mark.long
def test_an_adapter_that_goes_over_to_the_plant_in_an_outage_is_not_told_to_write_there(
    loop: LoopThread, plant: Plant, elsewhere: Elsewhere, warm_start: WarmStart, protocol: str
) -> None:
    other = elsewhere(protocol)
    subject = wandering(warm_start, protocol, "failover", PLANT=address(other), ADDRESS="{host}:{port}")
    first, *_ = WRITING[protocol].split()
    again = WRITING[protocol].split()[-1]
    results = loop.run(run_items(subject, plant, f"{first} {OUTAGE[protocol]} {again}"))
    assert seen_by(loop, other) == []
    assert results[first]["status"] == "PASS", results[first]["findings"]
    assert results[OUTAGE[protocol]]["status"] == "FAIL"
    (refused,) = {
        finding["message"]
        for part in (results[OUTAGE[protocol]], *results[OUTAGE[protocol]]["samples"])
        for finding in part["findings"]
        if "nothing was written" in finding["message"]
    }
    # The subject file has the right address: the adapter did talk to the mock before.
    assert "It was proven to talk to it before" in refused
    assert "Look at" not in refused
    # It has a session of its own, which is proven before anything is written.
    assert results[again]["status"] == "PASS", results[again]["findings"]


@pytest.mark.parametrize("protocol", OWN)
def test_a_write_that_is_not_given_the_address_that_reads_are_given_is_refused(tmp_path: Path, protocol: str) -> None:
    read, write, results = {
        "modbus": ("read_holding", "write_holding", "values = 'a'"),
        "mqtt": ("info", "publish", ""),
        "opcua": ("variables", "write", "node_ids = 'a'"),
        "s7": ("read_db", "write_db", "values = 'a'"),
        "bacnet": ("read", "write", "value = 'a'"),
        "ethernetip": ("read_tag", "write_tag", "value = 'a'"),
        "dnp3": ("read_analog", "write_binary", "values = 'a'"),
        "profibus": ("read_inputs", "write_outputs", "values = 'a'"),
        "ethercat": ("read_sdo", "write_sdo", "value = 'a'"),
        "profinet": ("read_inputs", "write_outputs", "values = 'a'"),
    }[protocol]
    text = f"""
[subject]
name = "x"
version = "1"
[adapter.{protocol}]
command = ["adapter"]
answer = "json"
[adapter.{protocol}.bind.{read}]
tool = "read"
arguments = {{ where = "{{url}}" }}
result = {{ {results} }}
[adapter.{protocol}.bind.{write}]
tool = "write"
arguments = {{ PLACE }}
"""
    path = tmp_path / "otmcp.toml"
    for place, sentence in {
        "": r"lacks \{host\}, \{port\} or \{url\}, which .* is given with each call: it would write to another device",
        'host = "10.0.0.5", port = 502, where = "{url}"': "names a device by itself",
    }.items():
        path.write_text(text.replace("PLACE", place), encoding="utf-8")
        with pytest.raises(UsageError, match=sentence):
            load_subject(path)
    path.write_text(text.replace("PLACE", 'where = "{url}"'), encoding="utf-8")
    assert load_subject(path)


def test_a_binding_function_that_forgets_the_address_of_a_write_does_not_write(
    loop: LoopThread, plant: Plant, warm_start: WarmStart, tmp_path: Path
) -> None:
    text = (SUBJECTS / "modbus-json.toml").read_text(encoding="utf-8").replace("{dir}", str(SUBJECTS))
    head, _, _ = text.partition("[adapter.modbus.bind.write_holding]")
    (tmp_path / "otmcp.toml").write_text(
        head.replace('answer = "json"', 'answer = "json"\nbindings = "functions.py"'), encoding="utf-8"
    )
    (tmp_path / "functions.py").write_text(
        "async def write_holding(tools, *, address, value):\n"
        "    await tools.call('write_point', start=address + 1, value=value)\n"
        "    return {}\n",
        encoding="utf-8",
    )
    subject = warm_start.subject(load_subject(tmp_path / "otmcp.toml"))
    results = loop.run(run_items(subject, plant, "M2 FM2"))
    assert results["M2"]["status"] == "PASS"
    assert results["FM2"]["status"] == "NOT_TESTABLE"
    assert "write_point may write and is not told where the mock device is" in results["FM2"]["reason"]
