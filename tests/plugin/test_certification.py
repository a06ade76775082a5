"""``otmcp certify`` and ``otmcp verify`` over the whole suite: all tests share one run of 30 repetitions, a minute."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from pytest_otmcp import cli
from pytest_otmcp.certificate.eligibility import objections
from pytest_otmcp.certificate.statement import certificate
from pytest_otmcp.core.matrix import BENCHMARK, REQUIREMENTS, SUITES
from pytest_otmcp.record import RecordError, load
from pytest_otmcp.suite.catalogue import tasks_by_id
from tests.examined import verify
from tests.keys import WHO, new_key, trusted
from tests.once import once
from tests.stored_runs import store

from .command import otmcp, sentence
from .places import Change, Record, call, item, journal, moved

pytestmark = pytest.mark.long

HOSTILE_CONFTEST = """
import pytest

@pytest.fixture
def _otmcp_trial():
    return lambda task: None

def pytest_collection_modifyitems(items):
    del items[1:]
"""


def certify(here: Path) -> str:
    """Certify the reference adapters from a directory whose configuration would change an ordinary run."""
    (here / "conftest.py").write_text(HOSTILE_CONFTEST)
    (here / "pytest.ini").write_text("[pytest]\naddopts = -k M1\nfilterwarnings = error\nasyncio_mode = auto\n")
    (here / "bending.py").write_text("raise SystemExit('a plugin of the vendor was loaded')")
    environment = {
        "PYTEST_ADDOPTS": "-k M2",
        "PYTEST_PLUGINS": "bending",
        "PYTHONOPTIMIZE": "2",
        "PYTHONWARNINGS": "error",
    }
    signing = ("--sign", str(new_key(here / "key"))) if shutil.which("ssh-keygen") else ()
    done = otmcp("certify", *signing, cwd=here, environment=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    (here / "told").write_text(done.stdout)
    return str(here)


@pytest.fixture(scope="module")
def certified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory from which the reference adapters were certified."""
    return Path(once(tmp_path_factory, "certified", certify))


@pytest.fixture
def out(certified: Path) -> Path:
    """The directory with the certificate."""
    return certified / "reports" / "certificate"


@pytest.fixture
def told(certified: Path) -> str:
    """The output of ``otmcp certify``."""
    return (certified / "told").read_text()


@pytest.fixture
def pair(out: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A copy of the certificate and the record, which a test may damage."""
    names = ("certificate.json", "run.json")
    for name in names:
        shutil.copy(out / name, tmp_path / name)
    return tmp_path / names[0], tmp_path / names[1]


def applying() -> list[str]:
    """Return the items that apply to the reference adapters, which have no named commands and are no Sparkplug host."""
    tasks = tasks_by_id(suites=SUITES).values()
    return sorted(
        task.id for task in tasks if not any(need.endswith((".commands", ".readings", ".host")) for need in task.needs)
    )


def runs() -> int:
    return 870 + sum(task.suite == REQUIREMENTS for task in map(tasks_by_id(suites=SUITES).__getitem__, applying()))


def test_a_certificate_is_written_whatever_the_directory_holds(out: Path, told: str) -> None:
    items, planned = len(applying()), runs()
    every = len(tasks_by_id(suites=SUITES))
    level = "Modbus Gold, MQTT Gold, OPC UA Gold"
    unclaimed = f"{every - items} do not apply, " if every > items else ""
    verdict = (
        f"VERDICT: CONFORMANT ({items} of {every} items passed, {unclaimed}{level}; {planned}/{planned} runs passed)"
    )
    assert verdict in told
    assert (
        "modbus: earned guard, recovery, bounds, times, governance, tokens, secure, client_certificate, ping, " in told
    )
    for protocol in ("Modbus", "MQTT", "OPC UA"):
        assert f"level: {protocol}: Gold" in told
    record, predicate = load(out / "run.json"), json.loads((out / "certificate.json").read_text())["predicate"]
    assert record["settings"]["narrowed"] == []
    assert sorted(predicate["passedTests"]) == applying()
    assert predicate["otmcp"]["counts"]["total"] == {"items": items, "passed": planned, "planned": planned}
    suites = predicate["otmcp"]["counts"]["suites"]
    assert sum(suites[name]["passed"] for name in BENCHMARK) == 870
    assert r"\newcommand{\totalToolCalls}{2820}" in (out / "tables" / "exact_counts.tex").read_text()
    assert set(predicate["otmcp"]["adapters"]) == {"modbus", "mqtt", "opcua"}


def test_progress_is_shown_while_it_runs(told: str) -> None:
    assert re.search(r"^  M1 +30/30 +PASS", told, re.MULTILINE)


def test_the_values_of_two_certifications_differ(out: Path) -> None:
    # The seed is drawn: an adapter that has the values of seed 0 built in gains nothing.
    assert load(out / "run.json")["settings"]["seed"] > 1000


def test_the_badge_says_what_was_certified(out: Path) -> None:
    message = json.loads((out / "badge.json").read_text())["message"]
    assert message.startswith("conformant: Modbus Gold, MQTT Gold, OPC UA Gold (")
    assert ElementTree.parse(out / "badge.svg").getroot().tag.endswith("svg")


def test_the_certificate_is_verified_by_judging_its_history_again(pair: tuple[Path, Path], tmp_path: Path) -> None:
    done = otmcp("verify", *map(str, pair), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    items, every, planned = len(applying()), len(tasks_by_id(suites=SUITES)), runs()
    assert f"is CONFORMANT; {items} of {every} items passed" in done.stdout
    assert f"{planned} of {planned} repetitions passed, and judging them again found the same" in done.stdout
    assert "not signed" in done.stdout


def refused(pair: tuple[Path, Path]) -> str:
    done = otmcp("verify", str(pair[0]), str(pair[1]), cwd=pair[0].parent)
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stdout == ""
    return sentence(done)


def test_a_record_that_was_cut_off_is_refused(pair: tuple[Path, Path]) -> None:
    content = pair[1].read_bytes()
    pair[1].write_bytes(content[: len(content) // 2])
    assert "not strict JSON" in refused(pair)


def test_a_record_that_was_edited_is_refused(pair: tuple[Path, Path]) -> None:
    pair[1].write_text(pair[1].read_text().replace('"duration_ms":', '"duration_ms":1', 1))
    assert "the digest does not match: the file has been changed" in refused(pair)


def test_a_certificate_that_was_edited_is_refused(pair: tuple[Path, Path]) -> None:
    pair[0].write_text(pair[0].read_text().replace('"modbus": "gold"', '"modbus": "silver"'))
    assert "predicate.otmcp.level.awarded.modbus is 'silver', from the run follows 'gold'" in refused(pair)


# -- signatures -----------------------------------------------------------------------------------------------------------

SIGNED = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="ssh-keygen is not installed")


@pytest.fixture
def signed(certified: Path, out: Path, pair: tuple[Path, Path]) -> list[str]:
    """The arguments that verify a copy of the certificate with its signature."""
    shutil.copy(out / "certificate.json.sig", pair[0].parent)
    trust = trusted(certified / "key", pair[0].with_name("allowed_signers"))
    return ["verify", "--trust", str(trust), *map(str, pair)]


def altered_certificate(directory: Path) -> None:
    path = directory / "certificate.json"
    path.write_text(path.read_text() + "\n")


def altered_record(directory: Path) -> None:
    path = directory / "run.json"
    path.write_text(path.read_text().replace('"duration_ms":', '"duration_ms":1', 1))


def no_certificate(directory: Path, make: Callable[[Path], object]) -> None:
    path = directory / "certificate.json"
    path.unlink()
    make(path)


NOT_HELD = [
    (altered_certificate, 1, f"refused: the signature of {WHO} does not hold for this certificate: "),
    (altered_record, 1, "refused: {}run.json: the digest does not match: the file has been changed"),
    (
        lambda directory: trusted(new_key(directory / "other"), directory / "allowed_signers"),
        1,
        "refused: the signature of the certificate is of nobody whom {}allowed_signers trusts: ",
    ),
    (
        lambda directory: (directory / "certificate.json.sig").unlink(),
        1,
        "refused: {}certificate.json is not signed: there is no {}certificate.json.sig",
    ),
    (
        lambda directory: no_certificate(directory, Path.mkdir),
        2,
        "{}certificate.json: this is a folder and no regular file; name the file in it",
    ),
    (lambda directory: no_certificate(directory, os.mkfifo), 2, "{}certificate.json: this is no regular file"),
    (
        lambda directory: no_certificate(directory, lambda path: path.symlink_to("/dev/zero")),
        2,
        "{}certificate.json: this is no regular file",
    ),
    (
        lambda directory: no_certificate(directory, lambda path: path.symlink_to("nowhere")),
        2,
        "{}certificate.json: there is no such file",
    ),
]


@SIGNED
def test_a_signed_certificate_is_verified_with_the_name_of_its_signer(
    signed: list[str], told: str, tmp_path: Path
) -> None:
    assert "certificate.json.sig is the signature of " in told
    # A link to a certificate is the certificate.
    (tmp_path / "certificate.json").rename(tmp_path / "there")
    (tmp_path / "certificate.json").symlink_to("there")
    done = otmcp(*signed, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"the certificate is signed by {WHO}, whom {tmp_path / 'allowed_signers'} trusts" in done.stdout


@SIGNED
@pytest.mark.parametrize(
    ("change", "code", "words"),
    NOT_HELD,
    ids=["certificate", "record", "key", "unsigned", "directory", "pipe", "device", "dangling"],
)
def test_what_is_not_what_was_signed_ends_in_one_sentence(
    signed: list[str], tmp_path: Path, change: Callable[[Path], object], code: int, words: str
) -> None:
    change(tmp_path)
    done = otmcp(*signed, cwd=tmp_path)
    assert done.returncode == code
    assert done.stdout == ""
    assert sentence(done).startswith("otmcp: " + words.replace("{}", f"{tmp_path}/"))
    assert done.stderr.count("\n") == 1


# -- forgeries ------------------------------------------------------------------------------------------------------------

HOUR = 3600 * 10**9


def request(run: Record, identifier: str) -> Record:
    """Return the first request of an item, as the device noted it."""
    return next(one for one in journal(run, identifier) if one.get("kind") == "request")


def each_device(run: Record, change: Change) -> None:
    for one in run["items"]:
        for found in one["devices"].values():
            change(found)


FORGERIES: list[tuple[str, Change]] = [
    ("a refusal made a success", lambda run: call(run, "FM1")["envelope"].update(success=True, error=None)),
    ("which register the device was asked for", lambda run: request(run, "M2").update(address=7, pdu="0400070004")),
    ("a request that reached the device", lambda run: item(run, "M2")["samples"][0]["device"].clear()),
    ("a write at the read-only device", lambda run: item(run, "M4")["samples"][0]["device"].append(request(run, "M3"))),
    ("the seed of the values", lambda run: run["settings"].update(seed=0)),
    ("whether the suite was narrowed", lambda run: run["settings"].update(narrowed=["-k M1"])),
    ("what reached the devices between the items", lambda run: each_device(run, lambda found: found["before"].clear())),
    ("the sequence numbers of an item", lambda run: moved(item(run, "M2"), seq=1000)),
    ("an item of another run", lambda run: item(run, "M2").update(run_id="0" * 32)),
    ("a repetition of another run", lambda run: moved({"samples": item(run, "M2")["samples"][7:8]}, ns=10**9)),
    (
        "a write that came an hour late",
        lambda run: [entry.update(t_ns=entry["t_ns"] + HOUR) for entry in journal(run, "M3")],
    ),
]


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(change, id=name, marks=[pytest.mark.weekly] if number % 6 else [])
        for number, (name, change) in enumerate(FORGERIES)
    ],
)
def test_a_record_that_was_changed_sealed_and_certified_again_is_refused(
    pair: tuple[Path, Path], change: Change
) -> None:
    run = load(pair[1])
    change(run)
    store(pair[1], run)
    with pytest.raises(cli.Refusal, match=r"is about another run|run\.json: "):
        verify(*pair)
    try:
        load(pair[1])
    except RecordError:
        # Its shape gives it away, whatever certificate it has.
        return
    # A forger who knows this kit makes the certificate as well: then only a contradiction within the run gives it away.
    sha256 = hashlib.sha256(pair[1].read_bytes()).hexdigest()
    statement = json.loads(pair[0].read_text())
    if objections(run, tasks_by_id()):
        statement["predicate"]["configuration"][2]["digest"]["sha256"] = sha256
    else:
        statement = certificate(run, sha256, tasks_by_id())
    pair[0].write_text(json.dumps(statement))
    with pytest.raises(cli.Refusal, match="refused: ") as refusal:
        verify(*pair)
    assert "is about another run.json" not in str(refusal.value)
