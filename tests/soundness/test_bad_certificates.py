"""The reference adapters refuse every bad certificate, as a table: the mock presents it, and its journal has what came over the connection."""

from __future__ import annotations

import pytest

from .conftest import Judge, words

BAD = {
    "unknown_issuer",
    "self_signed",
    "expired",
    "not_yet_valid",
    "other_host",
    "client_only",
    "weak_key",
    "old",
}
"""As the mock calls them; the last is TLS 1.1, or a deprecated policy."""


@pytest.mark.long
@pytest.mark.parametrize(
    ("protocol", "bad"),
    [
        ("modbus", BAD),
        ("mqtt", BAD),
        ("dnp3", BAD),
        ("ethernetip", BAD),
        ("opcua", BAD | {"other_application"}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_not_one_byte_goes_to_a_device_with_a_bad_certificate(judge: Judge, protocol: str, bad: set[str]) -> None:
    check = f"TLS-002.{protocol}"
    command = ("-P", "-m", "pytest_otmcp.reference_adapters", protocol)
    results = judge(protocol, *command, tasks=check)
    assert results[check]["status"] == "PASS", words(results)
    calls = [call["envelope"] for call in results[check]["samples"][0]["calls"]]
    refused = [envelope["error"] for envelope in calls if not envelope["success"]]
    # That nothing came is what the check looks for; here it is that it was tried with every one.
    assert [error["code"] for error in refused] == ["tls_error"] * len(bad)
    assert {error["outcome"] for error in refused} == {"not_sent"}
