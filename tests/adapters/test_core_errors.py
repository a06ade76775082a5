"""The adapters' own copy of the error registry against the kit's, and the treatment of a device's text."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import pytest
from pytest_otmcp.reference_adapters.core import AdapterError, Call, ConfigError, Environment, device_text
from pytest_otmcp.reference_adapters.core.errors import REGISTRY

from pytest_otmcp.core.error_registry import registry


@pytest.mark.parametrize("code", REGISTRY)
@pytest.mark.parametrize(("writes", "sent"), [(False, False), (True, False), (True, True)])
def test_every_error_is_one_that_the_registry_allows(code: str, writes: bool, sent: bool) -> None:
    entry = registry()[code]
    error = AdapterError(code, "no").as_error(writes=writes, sent=sent)
    assert error["class"] in entry.classes
    assert entry.allows_retryable(error["retryable"])
    if writes and sent:
        assert entry.allows_outcome(error["outcome"])
    else:
        # No request that could change the plant was sent, and no error may suggest otherwise.
        assert error["outcome"] in ("not_sent", "not_applicable")


@pytest.mark.parametrize(("code", "message"), [("no_such_code", "text"), ("timeout", "")])
def test_an_error_that_cannot_be_reported_cannot_be_made(code: str, message: str) -> None:
    with pytest.raises(ValueError, match="code of the registry"):
        AdapterError(code, message)


def test_a_refusal_of_the_device_is_not_ours() -> None:
    ours = AdapterError("unsupported_operation", "no").as_error(writes=False, sent=False)
    theirs = AdapterError("unsupported_operation", "no", outcome="rejected").as_error(writes=True, sent=True)
    assert (ours["class"], theirs["class"]) == ("validation", "device")


def test_the_device_is_asked_by_a_writing_tool_without_a_write() -> None:
    call = Call(protocol="opcua", operation="opcua.write", endpoint="opc.tcp://127.0.0.1:4840", writes=True)
    call.sending(changes_state=False)
    envelope = call.failure(AdapterError("timeout", "no answer"))
    assert (envelope["error"]["outcome"], envelope["meta"]["attempts"]) == ("not_sent", 1)
    call.sending()
    call.sending(changes_state=False)
    assert call.failure(AdapterError("timeout", "no answer"))["error"]["outcome"] == "unknown"


@pytest.mark.parametrize(
    ("text", "shown", "sanitised"),
    [
        ("Kessel 1 °C", "Kessel 1 °C", False),
        (b"M\xc3\xbcller", "Müller", False),
        ("a\x1b[31mb", "a\N{REPLACEMENT CHARACTER}[31mb", True),
        ("a\u202eb\u200bc\U000e0041d", "a�b�c�d", True),
        ("x" * 2000, "x" * 1024, True),
    ],
)
def test_text_of_a_device_is_cleaned_and_marked(text: str | bytes, shown: str, sanitised: bool) -> None:
    call = Call(protocol="opcua", operation="opcua.read", endpoint="opc.tcp://127.0.0.1:4840", writes=False)
    assert device_text(call, "/data/name", text) == shown
    meta = call.success({"name": shown})["meta"]
    assert meta["untrusted"] == ["/data/name"]
    assert meta.get("sanitised", False) is sanitised


@pytest.mark.parametrize("text", ["many", "", "1.5", "-1", "70000", " 5x"])
def test_a_number_that_is_not_understood_stops_the_start(text: str) -> None:
    with pytest.raises(ConfigError, match="PORT"):
        Environment({"PORT": text}).whole("PORT", 502, 1, 65535)


@pytest.mark.parametrize("text", ["", "flase", "enabled", " true", "2", "0", "no"])
def test_everything_but_a_clear_yes_leaves_writes_disabled(text: str) -> None:
    assert not Environment({"SWITCH": text}).writes_enabled("SWITCH")
    assert not Environment({}).writes_enabled("SWITCH")


@pytest.mark.parametrize("text", ["true", "TRUE", "1", "yes", "on"])
def test_a_clear_yes_enables_writes(text: str) -> None:
    assert Environment({"SWITCH": text}).writes_enabled("SWITCH")
