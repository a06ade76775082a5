"""A certificate says what the run says, and a run that leaves anything open gets none."""

from __future__ import annotations

import copy
import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from pytest_otmcp import __version__
from pytest_otmcp.certificate.badge import badge, badge_svg
from pytest_otmcp.certificate.eligibility import objections
from pytest_otmcp.certificate.statement import awarded, certificate, differences
from pytest_otmcp.cli import Refusal, main
from pytest_otmcp.cli.examination import answer
from pytest_otmcp.cli.signature import sign
from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.record.schema import AdapterFacts
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.suite.requirements import catalogue

from ..examined import verify
from ..keys import WHO, new_key, trusted
from ..stored_runs import store, store_as_it_is
from .certified import NO_PING, adapter, conformant_run
from .samples import finding

TASKS = tasks_by_id(suites=SUITES)
FILE = "ab" * 32

Change = Callable[[dict[str, Any]], object]


@pytest.fixture
def record() -> dict[str, Any]:
    return conformant_run()


@pytest.fixture
def statement(record: dict[str, Any]) -> dict[str, Any]:
    return certificate(record, FILE, TASKS)


def told(statement: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = statement["predicate"]["otmcp"]
    return found


def test_a_run_in_order_has_no_objections(record: dict[str, Any]) -> None:
    assert objections(record, TASKS) == []


def test_it_is_an_in_toto_statement_about_a_test_result(statement: dict[str, Any]) -> None:
    assert statement["_type"] == "https://in-toto.io/Statement/v1"
    assert statement["predicateType"] == "https://in-toto.io/attestation/test-result/v0.1"
    assert statement["subject"] == [{"name": "acme-adapter 1.4.0", "digest": {"sha256": "5" * 64}}]
    predicate = statement["predicate"]
    assert predicate["result"] == "PASSED"
    assert predicate["failedTests"] == predicate["warnedTests"] == []
    assert {"name": "run.json", "digest": {"sha256": FILE}, "mediaType": "application/json"} in predicate[
        "configuration"
    ]
    for descriptor in predicate["configuration"]:
        assert set(descriptor["digest"]) == {"sha256"}
        assert len(descriptor["digest"]["sha256"]) == 64


def test_warnings_are_named_with_the_items_that_they_are_about(record: dict[str, Any]) -> None:
    warning = {**finding("no_text", "there is no text block", "MCP-006"), "strength": "SHOULD"}
    warned = next(item for item in record["items"] if item["id"] == "M2")
    warned["samples"][3]["findings"] = [warning]
    warned["findings"] = [{**warning, "message": "warmup: there is no text block"}]
    assert objections(record, TASKS) == []
    statement = certificate(record, FILE, TASKS)
    predicate = statement["predicate"]
    assert (predicate["result"], predicate["warnedTests"]) == ("WARNED", ["M2"])
    assert "M2" not in predicate["passedTests"]
    assert told(statement)["warnings"] == [
        {
            "requirement": "MCP-006",
            "code": "no_text",
            "message": "there is no text block",
            "items": ["M2"],
            "times": 2,
        }
    ]


def test_every_item_has_passed_or_says_why_it_does_not_apply(statement: dict[str, Any]) -> None:
    passed, not_applicable = set(statement["predicate"]["passedTests"]), told(statement)["not_applicable"]
    assert passed | not_applicable.keys() == TASKS.keys()
    assert not passed & not_applicable.keys()
    assert not_applicable["M1"] == f"modbus.ping: {NO_PING}"
    assert not_applicable["Q1"] == "mqtt.info: the subject has no adapter for MQTT"
    assert {"M4", "O1", "R-opcua"} <= passed


def test_an_item_that_found_nothing_to_judge_says_why(record: dict[str, Any]) -> None:
    by_id(record, "M2").update(status="NOT_APPLICABLE", reason="there is nothing to judge")
    assert told(certificate(record, FILE, TASKS))["not_applicable"]["M2"] == "there is nothing to judge"


def test_facets_are_earned_not_exercised_or_not_claimed_with_the_reason(statement: dict[str, Any]) -> None:
    facets = told(statement)["adapters"]["modbus"]["facets"]
    assert facets["not_claimed"] == {"ping": NO_PING}
    assert {"guard", "read_input", "write_holding", "recovery"} <= set(facets["earned"])
    assert {"M2", "S1"} <= set(facets["earned"]["read_input"])
    assert "M1" not in facets["earned"]["recovery"]
    assert set(told(statement)["adapters"]) == {"modbus", "opcua"}


def test_a_claimed_facet_that_no_applying_item_needs_is_not_earned() -> None:
    mqtt = adapter("acme-mqtt", "2026-07-28", unclaimed={"device_birth": "no Sparkplug"})
    facets = told(certificate(conformant_run({"mqtt": mqtt}), FILE, TASKS))["adapters"]["mqtt"]["facets"]
    assert "device_data" in facets["claimed_not_exercised"]
    assert "device_data" not in facets["earned"]
    assert "publish" in facets["earned"]


def test_of_what_is_claimed_by_a_binding_only_what_a_check_needs_is_mentioned() -> None:
    def mentioned(facts: AdapterFacts) -> set[str]:
        facets = told(certificate(conformant_run({"mqtt": facts}), FILE, TASKS))["adapters"]["mqtt"]["facets"]
        return {*facets["earned"], *facets["claimed_not_exercised"], *facets["not_claimed"]}

    silent = adapter("acme-mqtt", "2026-07-28")
    without = mentioned(silent)
    assert not without & {"sparkplug_nodes", "publish.retain"}
    # A check names the operations that it needs; inputs that it gives besides are not listed.
    assert mentioned({**silent, "offered": ["sparkplug_nodes", "publish.retain"]}) == without | {"sparkplug_nodes"}


def test_messages_can_be_received_without_subscribing_by_a_call_that_waits_for_them() -> None:
    unclaimed = {"subscribe": "every call subscribes anew"}
    waiting = adapter("acme-mqtt", "2026-07-28", unclaimed=unclaimed, blocking=["messages"])
    run = conformant_run({"mqtt": waiting})
    assert objections(run, TASKS) == []
    facets = told(certificate(run, FILE, TASKS))["adapters"]["mqtt"]["facets"]
    assert facets["not_claimed"].keys() == {"subscribe", "subscribe.qos"}
    assert "Q2" in facets["earned"]["messages"]
    run["subject"]["adapters"]["mqtt"]["blocking"] = []
    assert "Q2 is called PASS, which is not what the subject claims" in objections(run, TASKS)


def test_how_many_items_passed_of_how_many_stands_beside_the_verdict(statement: dict[str, Any]) -> None:
    items = told(statement)["items"]
    assert items.keys() == {"Modbus", "OPC UA"}
    assert sum(count["passed"] for count in items.values()) == len(statement["predicate"]["passedTests"])
    assert all(count["of"] >= count["passed"] for count in items.values())


def test_a_deadline_that_nobody_waits_for_earns_nothing(record: dict[str, Any]) -> None:
    record["subject"]["adapters"]["opcua"]["deadline_s"] = 30.0
    assert objections(record, TASKS) == []
    record["subject"]["adapters"]["opcua"]["deadline_s"] = 30.5
    assert objections(record, TASKS) == ["opcua: its deadline_s of 30.5 s is above the 30 s that a certificate allows"]


def test_the_deadline_is_named(record: dict[str, Any]) -> None:
    record["subject"]["adapters"]["modbus"]["deadline_s"] = 30.0
    adapters = told(certificate(record, FILE, TASKS))["adapters"]
    assert (adapters["modbus"]["deadline_s"], adapters["opcua"]["deadline_s"]) == (30.0, 5.0)


def test_the_time_to_come_back_and_declared_caches_are_named(record: dict[str, Any]) -> None:
    record["subject"]["adapters"]["modbus"] |= {"recovery_s": 2.0, "cached": {"ping": 1.5}}
    modbus = told(certificate(record, FILE, TASKS))["adapters"]["modbus"]
    assert (modbus["recovery_s"], modbus["cached_s"]) == (2.0, {"ping": 1.5})


def test_a_stranger_that_judges_a_protocol_is_named_with_its_digest(record: dict[str, Any]) -> None:
    digest = "sha256:" + "7" * 64
    stranger = {"key": "modbus", "name": "Modbus", "distribution": "acme-modbus", "version": "2.0", "digest": digest}
    record["kit"]["protocols"] = [stranger, {**stranger, "key": "s7", "name": "S7"}]
    configuration = certificate(record, FILE, TASKS)["predicate"]["configuration"]
    assert {"name": "protocol modbus: acme-modbus 2.0", "digest": {"sha256": "7" * 64}} in configuration
    assert not any("s7" in entry["name"] for entry in configuration)


def test_server_and_protocol_era_are_named(statement: dict[str, Any]) -> None:
    adapters = told(statement)["adapters"]
    assert adapters["modbus"]["server"] == {"name": "acme-modbus", "version": "1.4.0"}
    assert adapters["modbus"]["mcp"] == {"revision": "2026-07-28", "era": "stateless"}
    assert adapters["opcua"]["mcp"] == {"revision": "2025-11-25", "era": "initialize"}
    assert adapters["opcua"]["envelope"] == "synthesised"
    assert adapters["opcua"]["envelope_requirements_unmet"] == ["ENV-001"]


def test_counts_have_exact_bounds_that_are_never_rounded_up(statement: dict[str, Any]) -> None:
    counts = told(statement)["counts"]
    # 0.05^(1/30) and 0.025^(1/30), to four digits towards zero.
    assert counts["items"]["M2"] == {"passed": 30, "planned": 30, "at_least": 0.9049, "interval": [0.8842, 1.0]}
    assert counts["items"]["R-modbus"]["planned"] == 20
    assert "Q1" not in counts["items"]
    total = counts["total"]
    assert total["passed"] == total["planned"] == sum(item["planned"] for item in counts["items"].values())
    assert sum(suite["items"] for suite in counts["suites"].values()) == total["items"] == len(counts["items"])


def test_the_same_run_gives_the_same_certificate(record: dict[str, Any], statement: dict[str, Any]) -> None:
    assert certificate(copy.deepcopy(record), FILE, TASKS) == statement


def by_id(record: dict[str, Any], name: str) -> dict[str, Any]:
    return next(item for item in record["items"] if item["id"] == name)


def unclaim(record: dict[str, Any], protocol: str, **reasons: str) -> None:
    record["subject"]["adapters"][protocol]["unclaimed"].update(reasons)


def test_an_adapter_that_does_not_write_needs_no_guard() -> None:
    reading = adapter("acme-opcua", "2025-11-25", unclaimed={"guard": "does not write", "write": "does not write"})
    assert objections(conformant_run({"opcua": reading}), TASKS) == []


def device(*, first: int) -> dict[str, Any]:
    facts = {"protocol": "modbus", "variant": "rw", "worker": "main", "endpoints": [], "placeholders": {}}
    return {**facts, "first": first}


def does_not_start(run: dict[str, Any]) -> None:
    told = {"code": "cannot_start", "message": "there is no such program", "requirement": "MCP-002", "strength": "MUST"}
    for item in run["items"]:
        item.update(status="FAIL", findings=[{**told, "evidence": None, "cause": None}])


OBJECTIONABLE: list[tuple[Change, str]] = [
    (does_not_start, "the verdict is NOT CONFORMANT: there is no such program"),
    (lambda run: by_id(run, "M1").update(status="FAIL"), "the verdict is NOT CONFORMANT: M1 did not pass"),
    (lambda run: by_id(run, "M1").update(status="NOT_TESTABLE"), "the verdict is NOT CONFORMANT: M1 did not pass"),
    (lambda run: by_id(run, "M1").update(status="KIT_ERROR"), "the verdict is INDETERMINATE: M1 did not pass"),
    (lambda run: by_id(run, "M1").update(status="INTERRUPTED"), "the verdict is INCOMPLETE: M1 did not pass"),
    (lambda run: run["items"].remove(by_id(run, "M2")), "the verdict is INCOMPLETE: M2 did not run"),
    (lambda run: [item.update(status="NOT_APPLICABLE") for item in run["items"]], "nothing applies to the subject"),
    (lambda run: by_id(run, "M2").update(status="NOT_APPLICABLE"), "M2 is called NOT_APPLICABLE, which is not"),
    (lambda run: by_id(run, "M1").update(status="PASS"), "M1 is called PASS, which is not what the subject claims"),
    (lambda run: run["items"].append({**by_id(run, "M1"), "id": "M9"}), "there is no item M9 in the suite"),
    (lambda run: by_id(run, "M1").update(suite="stress"), "M1 is an item of normal, Modbus"),
    (lambda run: by_id(run, "M1").update(planned=29), "M1 has 29 repetitions, the settings say 30"),
    (lambda run: run["footer"].update(complete=False, reason="interrupted"), "the run is incomplete: interrupted"),
    (lambda run: run["footer"].update(verdict="NOT CONFORMANT"), "the record calls the run NOT CONFORMANT"),
    (
        lambda run: unclaim(run, "modbus", guard="has no read-only mode"),
        "modbus: it writes, and that its writes can be disabled (guard, requirement WR-004) is not claimed: has no",
    ),
    (lambda run: run["settings"].update(reps=29), "29 repetitions are not the 30"),
    (lambda run: run["settings"].update(time_scale=2.0), "deadlines and windows were scaled by 2.0"),
    (lambda run: run["settings"].update(broker="mqtt://127.0.0.1:1883"), "the broker was not the kit's own"),
    (lambda run: run["settings"].update(suites=["normal"]), "suites were left out, which otmcp certify runs: fault"),
    (lambda run: run["settings"].update(narrowed=["-k M1"]), "the suite was narrowed: -k M1"),
    (
        lambda run: run["subject"].update(deviations=[{"item": "FQ2", "reason": "clamps", "expires": "2027-03-31"}]),
        "a certificate excuses nothing: FQ2",
    ),
    (
        lambda run: run["devices"].update(modbus=device(first=1000)),
        "the journal of modbus does not begin with the run",
    ),
    (
        lambda run: run["subject"]["adapters"].update(hart=adapter("acme-hart", "2026-07-28")),
        "adapter 'hart' is none that the kit knows",
    ),
    (
        lambda run: by_id(run, "M2").update(started_at="2026-11-20T07:03:43.000Z"),
        "M2: started_at 2026-11-20T07:03:43.000Z is not within the run, which lasted from 2026-11-21T07:03:43Z to",
    ),
    (
        lambda run: by_id(run, "M2").update(finished_at="2026-11-21T07:23:43.000Z"),
        "M2: finished_at 2026-11-21T07:23:43.000Z is not within the run",
    ),
    (
        lambda run: by_id(run, "M2").update(ended_ns=60 * 10**9),
        "M2: finished_at 2026-11-21T07:03:44.000Z does not go with its monotonic time: it is of another run, or the clock",
    ),
    (lambda run: run["environment"].update(finished_at=None), "the record does not say when the run ended"),
    (
        lambda run: run["subject"]["adapters"]["modbus"]["unclaimed"].update(ping="none\x1b[2J"),
        "subject.adapters.modbus.unclaimed.ping has a control character: 'none\\x1b[2J'",
    ),
    (
        lambda run: run["subject"].update(name="acme \u202egnitset"),
        "subject.name has a control character: 'acme \\u202egnitset'",
    ),
    *(
        (lambda run, name=name: run["subject"].update(name=name), f"subject.name {what}: {name!a}")
        for name, what in (
            ("\u3164\u2800\u115f", "has a letter that shows nothing"),
            ("acme\u3164", "has a letter that shows nothing"),
            ("   ", "shows nothing"),
            ("\ufe0f", "shows nothing"),
        )
    ),
    (
        lambda run: run["subject"]["adapters"]["modbus"].update(recovery_s=0.001),
        "modbus: its recovery_s of 0.001 s is less than the 0.1 s that the kit can measure",
    ),
    (
        lambda run: by_id(run, "R-modbus")["samples"][3]["phases"].update(same_session=6100.0, same_session_attempts=2),
        "modbus: it worked again after 6.1 s, its recovery_s is 5 s",
    ),
    (
        lambda run: run["environment"].update(platform="Linux \u202e46_68x"),
        "environment.platform has a control character: 'Linux \\u202e46_68x'",
    ),
]


@pytest.mark.parametrize(("change", "reason"), OBJECTIONABLE, ids=[reason for _, reason in OBJECTIONABLE])
def test_what_leaves_anything_open_earns_no_certificate(record: dict[str, Any], change: Change, reason: str) -> None:
    change(record)
    assert any(reason in sentence for sentence in objections(record, TASKS)), objections(record, TASKS)


# -- comparing --------------------------------------------------------------------------------------------------


def leaves(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the path of everything in a document that is no container, or an empty one."""
    children = list(value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else [])
    if not children:
        yield path
    for name, child in children:
        yield from leaves(child, (*path, name))


def parent(document: Any, path: tuple[str | int, ...]) -> Any:
    for name in path[:-1]:
        document = document[name]
    return document


def other(value: Any) -> Any:
    """Return another value of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return value + "x"
    return "something"


def test_a_change_of_any_value_is_found_and_located(statement: dict[str, Any]) -> None:
    paths = list(leaves(statement))
    assert len(paths) > 200
    for path in paths:
        changed = copy.deepcopy(statement)
        holder = parent(changed, path)
        holder[path[-1]] = other(holder[path[-1]])
        sentences = list(differences(changed, statement))
        assert len(sentences) == 1, path
        assert str(path[-1]) in sentences[0]


@pytest.mark.long
def test_what_is_left_out_or_put_in_is_found(statement: dict[str, Any]) -> None:
    for path in leaves(statement):
        changed = copy.deepcopy(statement)
        del parent(changed, path)[path[-1]]
        assert list(differences(changed, statement)), path
        assert list(differences(statement, changed)), path


def test_true_is_not_one_and_a_whole_number_is_no_fraction() -> None:
    assert list(differences({"a": True}, {"a": 1})) == ["a is True, from the run follows 1"]
    assert list(differences({"a": 1.0}, {"a": 1})) == ["a is 1.0, from the run follows 1"]
    assert not list(differences({"a": [1, {"b": None}]}, {"a": [1, {"b": None}]}))


# -- badge ------------------------------------------------------------------------------------------------------


def test_the_badge_is_what_shields_draws_from(statement: dict[str, Any]) -> None:
    passed = len(statement["predicate"]["passedTests"])
    of = sum(count["of"] for count in told(statement)["items"].values())
    counted = f"{passed} of {of} items, {of - passed} do not apply"
    assert badge(statement) == {
        "schemaVersion": 1,
        "label": "OT-MCP conformance",
        "message": f"conformant: Modbus Silver, OPC UA Silver ({counted}, catalogue {catalogue().version})",
        "color": "1a7f37",
    }


def test_a_badge_for_everything_counts_too() -> None:
    everything = conformant_run({name: adapter(name, "2026-07-28") for name in ("modbus", "mqtt", "opcua")})
    message = badge(certificate(everything, FILE, TASKS))["message"]
    assert message.startswith("conformant: Modbus Silver, MQTT Silver, OPC UA Silver (")


def test_the_picture_is_valid_and_says_in_words_what_it_shows(statement: dict[str, Any]) -> None:
    statement["subject"][0]["name"] = 'a <b> & "c"\x07 1.0'
    picture = ElementTree.fromstring(badge_svg(statement))
    namespace = "{http://www.w3.org/2000/svg}"
    title = picture.find(f"{namespace}title")
    assert title is not None
    message = badge(statement)["message"]
    deadlines = "deadlines of a call: modbus 5 s, opcua 5 s"
    assert title.text == f'OT-MCP conformance: {message} (a <b> & "c"  1.0; {deadlines})'
    assert picture.get("aria-label") == title.text
    assert picture.get("role") == "img"
    texts = [element.text for element in picture.iter(f"{namespace}text")]
    assert texts == ["OT-MCP conformance", message]
    assert "http" not in badge_svg(statement).replace("http://www.w3.org/2000/svg", "")


# -- verifying --------------------------------------------------------------------------------------------------


@pytest.fixture
def files(record: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A certificate and its record, which has no history that could be judged again."""
    monkeypatch.setattr("pytest_otmcp.cli.examination.rejudge", lambda run: [])
    cert, run = tmp_path / "certificate.json", tmp_path / "run.json"
    issue(cert, run, record)
    return cert, run


def issue(cert: Path, run: Path, record: dict[str, Any]) -> None:
    store(run, record)
    cert.write_text(json.dumps(certificate(record, hashlib.sha256(run.read_bytes()).hexdigest(), TASKS)))


def forge(cert: Path, run: Path, record: dict[str, Any]) -> None:
    """Seal another record and make the certificate say that it is about that record."""
    store(run, record)
    statement = json.loads(cert.read_text())
    about = next(entry for entry in statement["predicate"]["configuration"] if entry["name"] == "run.json")
    about["digest"]["sha256"] = hashlib.sha256(run.read_bytes()).hexdigest()
    cert.write_text(json.dumps(statement))


def refusal(cert: Path, run: Path) -> str:
    with pytest.raises(Refusal) as refused:
        verify(cert, run)
    sentence = str(refused.value)
    assert sentence.startswith("refused: ")
    assert "\n" not in sentence
    return sentence


def test_a_certificate_of_its_own_run_is_verified(files: tuple[Path, Path]) -> None:
    found = verify(*files)
    assert found.code == 0
    assert found.said[0].startswith("verified: acme-adapter 1.4.0 is CONFORMANT; ")


def test_a_program_gets_what_was_verified_as_json(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The process with bounds has no replaced judgement.
    monkeypatch.setattr("pytest_otmcp.cli.confined.confined", lambda work, asked, bounds, what: answer(asked))
    assert main(["verify", "--json", *map(str, files)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["verdict"], told["levels"], told["signed_by"]) == (
        "CONFORMANT",
        {"modbus": "silver", "opcua": "silver"},
        None,
    )
    assert told["items"]["Modbus"]["passed"] <= told["items"]["Modbus"]["of"]
    assert told["said"][0].startswith("verified: ")
    files[1].write_text("{}")
    assert main(["verify", "--json", *map(str, files)]) == 1
    assert json.loads(capsys.readouterr().out)["refused"].startswith("refused: ")


def test_a_certificate_repeats_no_member_that_the_schema_does_not_have() -> None:
    record = conformant_run()
    before = json.dumps(certificate(record, "ab", TASKS))
    record["environment"]["level"] = "Gold"
    record["settings"]["approved_by"] = "TUV"
    assert json.dumps(certificate(record, "ab", TASKS)) == before


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="ssh-keygen is not installed")
def test_of_a_key_that_has_expired_is_said_as_of_when_it_was_valid(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pytest_otmcp.cli.confined.confined", lambda work, asked, bounds, what: answer(asked))
    measured = json.loads(files[0].read_text())["predicate"]["otmcp"]["measured_at"]
    day = datetime.fromisoformat(measured) + timedelta(days=2)
    key = new_key(tmp_path / "key")
    sign(files[0], key)
    trust = trusted(key, tmp_path / "trust")
    trust.write_text(trust.read_text().replace("namespaces=", f'valid-before="{day:%Y%m%d}",namespaces='))
    assert main(["verify", "--json", "--trust", str(trust), *map(str, files)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["signed_by"] == WHO
    assert datetime.fromisoformat(told["key_valid_as_of"]) == datetime.fromisoformat(measured)
    assert "when the certificate says that it was measured, and trusts no more" in told["said"][-1]


@pytest.mark.long
def test_a_certificate_that_was_edited_anywhere_is_refused(files: tuple[Path, Path]) -> None:
    statement = json.loads(files[0].read_text())
    places = kinds(statement)
    assert len(places) > 100
    # That each difference is told is tested above: here that it is asked for.
    for path in list(places.values())[::8]:
        changed = copy.deepcopy(statement)
        holder = parent(changed, path)
        holder[path[-1]] = other(holder[path[-1]])
        files[0].write_text(json.dumps(changed))
        assert re.search("does not say what the run says|about another run|not an in-toto", refusal(*files)), path


def test_what_is_added_to_a_certificate_is_refused(files: tuple[Path, Path]) -> None:
    statement = json.loads(files[0].read_text())
    told(statement)["awarded"] = "Gold"
    files[0].write_text(json.dumps(statement))
    assert "predicate.otmcp.awarded does not follow from the run" in refusal(*files)


@pytest.mark.parametrize("text", ["", "[]", "null", "{", '{"_type": "x"}', '{"a": 1, "a": 2}', "\xff"])
def test_what_is_no_certificate_is_refused(files: tuple[Path, Path], text: str) -> None:
    files[0].write_text(text, encoding="latin-1")
    assert re.search("not strict JSON|not an in-toto statement", refusal(*files))


def test_files_in_the_wrong_order_are_told(files: tuple[Path, Path]) -> None:
    certificate, record = files
    assert "it is a run record: the certificate is named first" in refusal(record, certificate)


def kinds(document: Any) -> dict[str, tuple[str | int, ...]]:
    """Return one path for every kind of field, whatever item or list element it is in."""
    return {"/".join("*" if isinstance(name, int) else name for name in path): path for path in leaves(document)}


@pytest.mark.long
def test_a_run_of_which_any_kind_of_field_was_edited_is_refused(
    files: tuple[Path, Path],
) -> None:
    stored = json.loads(files[1].read_bytes())
    # It is worked out anew with each file.
    del stored["footer"]["digest"]
    places = kinds(stored)
    assert len(places) > 60
    for kind, path in places.items():
        changed = copy.deepcopy(stored)
        holder = parent(changed, path)
        holder[path[-1]] = other(holder[path[-1]])
        # A record that is sealed again does not fit the certificate, which is about another file.
        store_as_it_is(files[1], changed)
        assert refusal(*files), kind


@pytest.mark.parametrize("lost", [1, 2, 100, 10_000])
def test_a_run_that_was_cut_off_is_refused(files: tuple[Path, Path], lost: int) -> None:
    files[1].write_bytes(files[1].read_bytes()[:-lost])
    assert "not strict JSON" in refusal(*files)


def test_an_incomplete_run_is_refused_even_if_its_certificate_is_about_it(
    files: tuple[Path, Path], record: dict[str, Any]
) -> None:
    record["footer"] |= {"complete": False, "reason": "interrupted by the user"}
    forge(*files, record)
    assert "the run is incomplete: interrupted by the user" in refusal(*files)


def test_a_run_by_another_version_or_by_a_changed_kit_is_refused(
    files: tuple[Path, Path], record: dict[str, Any]
) -> None:
    record["kit"]["version"] = "9.9.9"
    forge(*files, record)
    assert "was judged by another kit: pytest-otmcp 9.9.9" in refusal(*files)
    record["kit"] |= {"version": __version__, "suite_digest": "sha256:" + "0" * 64}
    forge(*files, record)
    assert "with other files than this one" in refusal(*files)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda run: run["settings"].update(narrowed=["-k M1"]), "the suite was narrowed: -k M1"),
        (lambda run: run["settings"].update(reps=7), "7 repetitions are not the 30"),
        (lambda run: by_id(run, "M2").update(status="NOT_APPLICABLE"), "M2 is called NOT_APPLICABLE"),
        (lambda run: run["subject"]["adapters"].pop("opcua"), "O1 is called PASS"),
        (lambda run: run["subject"]["adapters"]["modbus"]["unclaimed"].clear(), "M1 is called NOT_APPLICABLE"),
    ],
)
def test_a_forged_pair_is_refused_where_it_contradicts_itself(
    files: tuple[Path, Path], record: dict[str, Any], change: Change, reason: str
) -> None:
    change(record)
    forge(*files, record)
    assert reason in refusal(*files)


def test_a_history_that_deserves_another_judgement_is_refused(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = ["M1: the record says PASS, the history FAIL", "M2: so too", "M3: so too", "M4: so too"]
    monkeypatch.setattr("pytest_otmcp.cli.examination.rejudge", lambda run: found)
    assert refusal(*files).endswith("M1: the record says PASS, the history FAIL; M2: so too; M3: so too (and 1 more)")


def test_a_history_that_cannot_be_judged_at_all_is_refused(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pytest_otmcp.cli.examination.rejudge", lambda run: run.header["nothing"])
    assert "holds what no run of this kit has written (KeyError('nothing'))" in refusal(*files)


def test_a_record_without_any_of_its_fields_is_refused_and_crashes_nothing(
    files: tuple[Path, Path], record: dict[str, Any]
) -> None:
    for value in (None, [], {}, "", -1):
        for path in [
            ("kit",),
            ("subject", "digest"),
            ("subject", "adapters", "modbus"),
            ("environment",),
            ("settings",),
            ("devices",),
        ]:
            changed = copy.deepcopy(record)
            parent(changed, path)[path[-1]] = value
            forge(*files, changed)
            if (path, value) != (("devices",), {}):
                refusal(*files)


def test_a_file_that_is_not_there_is_named(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = tmp_path / "nowhere.json"
    for pair in ((nowhere, files[1]), (files[0], nowhere), (nowhere,)):
        assert main(["verify", *map(str, pair)]) == 2
        assert capsys.readouterr().err.endswith("nowhere.json: there is no such file\n")


def with_levels() -> dict[str, Any]:
    """Return the record of a conformant run in which one row was not shown for one protocol."""
    record = conformant_run()
    record["items"] = [item for item in record["items"] if item["id"] != "RES-001.opcua"]
    return record


def test_the_level_of_each_protocol_is_awarded_with_what_is_missing_for_the_next() -> None:
    level = awarded(with_levels())  # type: ignore[arg-type]
    assert level["awarded"] == {"modbus": "silver", "opcua": "bronze"}
    assert level["why"] == (
        "Modbus: Silver; for Gold: 10 rows not asked for (SEC-001, SEC-002, AUD-001, AUD-002, AUD-003 and 5 more). OPC UA: Bronze; for Silver: 1 row not shown (RES-001)."
    )
    assert "No item has shown RES-001." in level["next"]["opcua"]  # type: ignore[index]
    statement = certificate(conformant_run(), FILE, TASKS)  # type: ignore[arg-type]
    statement["predicate"]["otmcp"]["level"] = level  # type: ignore[index]
    assert badge(statement)["message"].startswith("conformant: Modbus Silver, OPC UA Bronze (")
