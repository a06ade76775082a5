"""Secrets do not get into the files that a run keeps or the texts that it shows."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from urllib.parse import quote

import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.record.redaction import REDACTED, Redactor
from pytest_otmcp.subject import load_subject

SECRET = 'pa"ss/w\\ord ü'  # noqa: S105


@pytest.mark.parametrize(
    "written",
    [SECRET, json.dumps(SECRET)[1:-1], quote(SECRET, safe=""), base64.b64encode(SECRET.encode()).decode()],
    ids=["plain", "json", "url", "base64"],
)
def test_a_secret_is_taken_out_however_it_is_written(written: str) -> None:
    value = {"stderr": [f"connecting to mqtt://op:{written}@host"], "n": 1, written: None}
    cleaned = Redactor([SECRET]).apply(value)
    assert cleaned == {"stderr": [f"connecting to mqtt://op:{REDACTED}@host"], "n": 1, REDACTED: None}


def test_what_is_no_secret_worth_the_name_stays() -> None:
    assert Redactor(["", "abc", "true"]).apply({"x": "abc true"}) == {"x": "abc true"}


FILE = """
[subject]
name = "x"
version = "1"
[adapter.mqtt]
command = ["adapter", "--token={env:PLANT_TOKEN}"]
env = { MQTT_PASSWORD = "open sesame", CUSTOM = "also hidden", MQTT_KEYBOARD = "visible", BROKER_PIN = "{env:PIN}" }
secrets = ["CUSTOM", "PIN"]
"""


def test_secrets_are_those_declared_and_those_named_like_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANT_TOKEN", "from the shell")
    monkeypatch.setenv("PIN", "12345678")
    (tmp_path / "otmcp.toml").write_text(FILE, encoding="utf-8")
    adapter = load_subject(tmp_path / "otmcp.toml").adapters["mqtt"]
    assert adapter.secret_values() == {"open sesame", "also hidden", "from the shell", "12345678"}
    launch = adapter.variants["rw"].for_endpoint({})
    assert launch.command == ("adapter", "--token=from the shell")
    assert launch.env["BROKER_PIN"] == "12345678"
    # The record holds the template of the launch.
    assert "from the shell" not in json.dumps(adapter.facts())


def test_a_variable_that_is_not_set_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PLANT_TOKEN", raising=False)
    (tmp_path / "otmcp.toml").write_text(FILE, encoding="utf-8")
    with pytest.raises(UsageError, match="the environment variable PLANT_TOKEN is not set"):
        load_subject(tmp_path / "otmcp.toml")
