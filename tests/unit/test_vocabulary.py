"""What a certificate says of the adapter's own names: as the subject file states them, and which members of answers nobody has judged."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.certificate.statement import _members_not_judged, _vocabulary
from pytest_otmcp.report.certificate_page import _stated

RECORD = Path(__file__).parents[1] / "data" / "golden" / "reference-named.json.gz"


@pytest.fixture(scope="module")
def run() -> Any:
    return json.loads(gzip.decompress(RECORD.read_bytes()))


def test_what_names_mean_is_told_with_the_values_that_were_tested(run: Any) -> None:
    told = {one["name"]: _stated(one) for one in _vocabulary(run["subject"]["adapters"]["modbus"])}
    assert told["read_temperature"] == (
        "read_input address=$place count=1; $place inlet (10), outlet (12); what it tells means $value * 10; "
        "tested while the device held 0 to 65535"
    )
    assert told["valve_position"].endswith(
        'what it tells means {"open": true, "closed": false}; tested while the device held true, false'
    )
    assert told["set_pump_speed"] == "write_holding address=40 value=$percent * 10; $percent 0 to 100 by 0.5"
    assert "write_holding address=41 value=$litres, then write_coil address=12 value=true" in told["start_batch"]


def test_members_of_answers_that_no_reading_is_of_are_told(run: Any) -> None:
    facts = run["subject"]["adapters"]["modbus"]
    assert _members_not_judged("modbus", facts, run) == {}
    for item in run["items"]:
        for sample in item["samples"]:
            for call in sample["calls"]:
                if call.get("tool") == "read_temperature" and (call.get("envelope") or {}).get("data"):
                    call["envelope"]["data"]["trend"] = "rising"
                if call.get("tool") == "set_pump_speed" and (call.get("envelope") or {}).get("data"):
                    call["envelope"]["data"]["percent"] = 0
    # What a command was given may be denied by its answer; "place" of a reading is what it was asked about.
    assert _members_not_judged("modbus", facts, run) == {"read_temperature": ["trend"], "set_pump_speed": ["percent"]}
