"""A subject file beside what a record says of its subject: nothing of the file is executed, and every difference is told."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.subject import load_subject, reference_subject
from pytest_otmcp.subject.comparison import differences, stored_bindings
from pytest_otmcp.subject.model import Function

SUBJECT = """
[subject]
name = "acme"
version = "1"

[adapter.modbus]
command = ["acme"]
cwd = "nowhere"
env = { KEY = "{env:OTMCP_TEST_NOT_SET}" }
bindings = "bindings.py"
"""

BINDINGS = """
from pathlib import Path

Path("executed").touch()


async def ping(tools):
    return {"reachable": True}
"""


def recorded() -> dict[str, Any]:
    """Return what a record says of the reference adapters, each of whose operations was used."""
    subject = reference_subject()
    adapters = {
        protocol: {**adapter.facts(), "bindings": {name: stored_bindings(adapter, name) for name in adapter.operations}}
        for protocol, adapter in subject.adapters.items()
    }
    told = {"name": subject.name, "version": subject.version, "digest": subject.digest, "deviations": []}
    read: dict[str, Any] = json.loads(json.dumps({**told, "adapters": adapters}))
    return read


def test_a_record_of_the_file_differs_in_nothing() -> None:
    assert list(differences(reference_subject(), recorded())) == []  # type: ignore[arg-type]


Change = Callable[[dict[str, Any]], object]

CHANGES: list[tuple[Change, str]] = [
    (
        lambda told: told.update(name="other"),
        "the name of the subject is 'other', the file says 'pytest-otmcp reference",
    ),
    (lambda told: told.update(version="9"), "the version of the subject is '9', the file says"),
    (lambda told: told.update(digest="sha256:0"), "the digest of the subject is sha256:0, that of the file is sha256:"),
    (lambda told: told["deviations"].append({}), "the subject's deviations is [{}], the file says []"),
    (lambda told: told["adapters"].update(toy=told["adapters"]["modbus"]), "the file has no adapter 'toy'"),
    (lambda told: told["adapters"]["modbus"].update(command=["x"]), 'modbus.command is ["x"], the file says'),
    (lambda told: told["adapters"]["modbus"].update(deadline_s=300.0), "modbus.deadline_s is 300.0, the file says 5"),
    (lambda told: told["adapters"]["modbus"]["unclaimed"].update(ping="none"), "modbus.unclaimed is"),
    (
        lambda told: told["adapters"]["modbus"]["bindings"]["ping"][0]["outputs"]["reachable"].update(regex="."),
        "modbus.bind.ping is",
    ),
    (lambda told: told["adapters"]["modbus"]["bindings"].update(pong=None), "modbus: the file has no binding of pong"),
]


@pytest.mark.parametrize(("change", "sentence"), CHANGES, ids=[sentence for _, sentence in CHANGES])
def test_every_difference_is_told(change: Change, sentence: str) -> None:
    told = copy.deepcopy(recorded())
    change(told)
    found = list(differences(reference_subject(), told))  # type: ignore[arg-type]
    assert len(found) == 1
    assert found[0].startswith(sentence)


def test_a_subject_that_is_only_compared_is_not_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "otmcp.toml").write_text(SUBJECT)
    (tmp_path / "bindings.py").write_text(BINDINGS)
    subject = load_subject(tmp_path / "otmcp.toml", run=False)
    assert isinstance(subject.adapters["modbus"].operations["ping"], Function)
    assert not (tmp_path / "executed").exists()
