"""The DNP3 reference adapter against an outstation of opendnp3, which nobody of this project wrote."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.session.free_port import free_port

OUTPUT = {"outstation_address": 10, "point_type": "analog_output", "index": 1, "writable": True}
ALIASES = {"setpoint": {**OUTPUT, "data_type": "float32"}, "whole": {**OUTPUT, "data_type": "int16"}}
CLASS_1 = {"outstation_address": 10, "event_class": 1}


class Outstation:
    """The program with an outstation of opendnp3."""

    def __init__(self) -> None:
        self.port = free_port(socket.socket)
        program = Path(__file__).with_name("opendnp3_outstation.py")
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, str(program), str(self.port)], stdin=pipe, stdout=pipe, text=True, bufsize=1
        )
        self._said("ready")

    def _said(self, word: str) -> None:
        assert self._process.stdout
        assert self._process.stdout.readline().strip() == word

    def change(self) -> None:
        """Change the binary input 3: on, off, on, ….; it is off line until then."""
        assert self._process.stdin
        self._process.stdin.write("\n")
        self._said("changed")

    def close(self) -> None:
        self._process.communicate()


@pytest.fixture(scope="module")
def outstation() -> Iterator[Outstation]:
    started = Outstation()
    yield started
    started.close()


@pytest.fixture(scope="module")
def adapter(outstation: Outstation, sessions: Any, adapter_command: Any, tmp_path_factory: Any) -> Any:
    aliases = tmp_path_factory.mktemp("peer") / "aliases.json"
    aliases.write_text(json.dumps(ALIASES))
    settings = {
        "DNP3_PORT": str(outstation.port),
        "DNP3_WRITES_ENABLED": "true",
        "DNP3_DIRECT_OPERATE_ENABLED": "true",
        "DNP3_TIMEOUT_S": "20",
        "DNP3_DEADLINE_S": "30",
        "DNP3_ALIAS_MAP": str(aliases),
    }
    return sessions(adapter_command("dnp3"), settings)


def test_what_opendnp3_has_not_measured_yet_is_no_value(adapter: Any) -> None:
    assert adapter.call("ping").data["reachable"] is True
    reply = adapter.call("read_analog_inputs", outstation_address=10, start_index=0, count=2)
    assert reply.error["code"] == "bad_quality"
    assert [point["flags"] for point in reply.envelope["data"]["partial"]["points"]] == [["RESTART"]] * 2


def test_events_of_opendnp3_are_told_once(adapter: Any, outstation: Outstation) -> None:
    outstation.change()
    outstation.change()
    told = adapter.call("poll_class", CLASS_1).data["points"]
    assert [(one["index"], one["value"], one["flags"]) for one in told] == [
        (3, True, ["ONLINE"]),
        (3, False, ["ONLINE"]),
    ]
    assert adapter.call("poll_class", CLASS_1).data["points"] == []
    (point,) = adapter.call("read_binary_inputs", outstation_address=10, start_index=3, count=1).data["points"]
    assert point["value"] is False


def test_class_0_of_opendnp3_is_read_though_it_has_objects_that_are_no_points(adapter: Any) -> None:
    told = adapter.call("poll_class", {**CLASS_1, "event_class": 0}).data["points"]
    kinds = {one["point_type"] for one in told}
    assert kinds >= {
        "binary_input",
        "double_bit_input",
        "binary_output",
        "counter",
        "analog_input",
        "analog_output",
        "octet_string",
    }


@pytest.mark.parametrize(("mode", "value"), [("select_before_operate", True), ("direct_operate", False)])
def test_opendnp3_is_operated_and_tells_the_new_state(adapter: Any, mode: str, value: bool) -> None:
    told = adapter.call("write_binary_output", outstation_address=10, index=2, value=value, mode=mode).data
    assert (told["status"], told["state"]) == ("SUCCESS", value)


@pytest.mark.parametrize("index", [9, 300])
def test_an_output_that_opendnp3_does_not_have_is_refused(adapter: Any, index: int) -> None:
    error = adapter.call("write_binary_output", outstation_address=10, index=index, value=True).error
    assert error["code"] in ("illegal_address", "unsupported_operation")
    assert error["outcome"] == "rejected"


@pytest.mark.parametrize(("alias", "value"), [("setpoint", 40.5), ("whole", -3)])
def test_an_analog_output_of_opendnp3_tells_what_it_was_set_to(adapter: Any, alias: str, value: float) -> None:
    # By itself it would tell 40.5 as 40: its default is a whole number.
    assert adapter.call("write_point_by_alias", alias=alias, value=value).data["state"] == value
    assert adapter.call("read_point_by_alias", alias=alias).data["value"] == value
