"""Honest adapters with a policy, an audit log and approvals of another design."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from mcp import MCPError
from mcp.types import INVALID_PARAMS
from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, approval, gates
from pytest_otmcp.reference_adapters.core import server as core_server

from .choice import choices

if TYPE_CHECKING:
    from pytest_otmcp.protocols.bounds import Governance
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

_MODBUS, modbus = choices("modbus")
_MQTT, mqtt = choices("mqtt")
_OPCUA, opcua = choices("opcua")
_S7, s7 = choices("s7")

_PRINT = """
import json, sqlite3, sys
for row in sqlite3.connect(sys.argv[1]).execute("SELECT at, who, what, verdict, result, digest FROM audit ORDER BY number"):
    print(json.dumps(dict(zip(("at", "who", "what", "verdict", "result", "digest"), row))))
"""


def _described(
    *,
    told: Callable[[Governance], Governance],
    env: dict[str, str] | None = None,
    policy: tuple[str, str] = ("", ""),
    **more: Any,
) -> Callable[[Adapter], Adapter]:
    """Return what a subject file says of another design.

    Args:
        told: changes what is stated.
        env: further variables of the launch.
        policy: a text in its policy, and what is there instead.
        more: further changes of the launch.
    """

    def described(adapter: Adapter) -> Adapter:
        assert adapter.governed is not None
        launch = adapter.variants["governed"]
        files = {name: text.replace(*policy) if policy[0] else text for name, text in launch.files.items()}
        launch = replace(launch, env={**launch.env, **(env or {})}, files={**files, "inbox/.keep": ""})
        governed = replace(adapter.governed, told=told(adapter.governed.told), **more)
        return replace(adapter, variants={**adapter.variants, "governed": launch}, governed=governed)

    return described


def _by_a_person(told: Governance) -> Governance:
    assert told.approval is not None
    stated = {name: value for name, value in told.approval.items() if name != "expires_s"}
    return replace(told, approval={**stated, "by": "outside"})


@modbus(
    "has writes approved by somebody who does not sit at the assistant",
    "MCP's elicitation proves what the client says, and is not the only way",
    described=_described(
        told=_by_a_person,
        env={"OT_APPROVAL_INBOX": "{work}/inbox", "OT_APPROVAL_S": "30"},
        policy=('approve = "client"', 'approve = "inbox"'),
        approve=(
            "{python}",
            "-P",
            "-m",
            "pytest_otmcp.reference_adapters.approvals",
            "approve",
            "{work}/inbox",
            "{approval}",
        ),
    ),
)
def asks_outside(server: AdapterServer) -> None:
    pass


def _of_a_database(told: Governance) -> Governance:
    fields = {"time": "at", "principal": "who", "tool": "what", "decision": "verdict", "outcome": "result"}
    audit = {"fields": fields, "anchor": "meta.audit_id", "digest": True, "is_file": False, "verifies": False}
    return replace(told, audit=audit)


@s7(
    "keeps its audit records in a database, one for a call, with digests of the arguments",
    "what a log is kept in is its author's choice, as long as it can be read",
    described=_described(
        told=_of_a_database,
        env={"OT_AUDIT_LOG": "", "AUDIT_DATABASE": "{work}/audit.db"},
        log="",
        records=("{python}", "-c", _PRINT, "{work}/audit.db"),
        verify=(),
    ),
)
def database(server: AdapterServer) -> None:
    if "AUDIT_DATABASE" not in os.environ:
        return
    log = sqlite3.connect(os.environ["AUDIT_DATABASE"], isolation_level=None)
    log.execute("PRAGMA synchronous = FULL")
    columns = "number INTEGER PRIMARY KEY, at TEXT, who TEXT, what TEXT, verdict TEXT, result TEXT, digest TEXT"
    log.execute(f"CREATE TABLE IF NOT EXISTS audit ({columns})")

    def record(self: Any, event: str, **members: Any) -> None:
        result = members.get("outcome") or event
        number = getattr(self, "_row", None)
        if number is None:
            digest = hashlib.sha256(json.dumps(self._arguments, default=str).encode()).hexdigest()
            insert = "INSERT INTO audit (at, who, what, verdict, result, digest) VALUES (?, ?, ?, ?, ?, ?)"
            row = (
                datetime.now(UTC).isoformat(),
                self._caller.name,
                self._tool,
                "no" if self._decision == "deny" else "yes",
                result,
                digest,
            )
            self._row = log.execute(insert, row).lastrowid
        else:
            log.execute("UPDATE audit SET result = ? WHERE number = ?", (result, number))

    genuine = gates.Gate.meta.fget
    assert genuine is not None
    gates.Gate._record = record  # type: ignore[method-assign]
    gates.Gate.meta = property(  # type: ignore[method-assign, assignment]
        lambda self: {**genuine(self), "audit_id": f"row-{getattr(self, '_row', 0)}"}
    )


@modbus(
    "leaves the state of its questions to the SDK, which refuses another one before a tool is called",
    "the SDK's boundary answers -32602, and no author can change that",
)
def sealed_by_the_sdk(server: AdapterServer) -> None:
    genuine = core_server._result

    def result(envelope: dict[str, Any]) -> dict[str, Any]:
        error = envelope["error"]
        if error is not None and error["message"].startswith("this is no open approval"):
            raise MCPError(INVALID_PARAMS, "Invalid or expired requestState")
        return genuine(envelope)

    core_server._result = result


def _says_approve(told: Governance) -> Governance:
    assert told.approval is not None
    return replace(told, approval={**told.approval, "form": {"decision": "approve"}})


@modbus(
    "asks for one of two words, of which the first means no",
    "a form has whatever its author puts into it, and the subject file says what is a yes",
    described=_described(told=_says_approve),
)
def asks_for_a_word(server: AdapterServer) -> None:
    approval._FORM["properties"] = {"decision": {"type": "string", "enum": ["deny", "approve"]}}
    approval._FORM["required"] = ["decision"]

    def judge(action: object, content: object) -> None:
        if action != "accept" or content != {"decision": "approve"}:
            raise AdapterError("approval_denied", "this was not approved; nothing was written", outcome="not_sent")

    approval._judge = judge


@opcua(
    "asks with a form that has nothing to be filled in, for who accepts it has said yes",
    "MCP has accept, decline and cancel for that",
)
def accepting_is_enough(server: AdapterServer) -> None:
    approval._FORM["properties"].clear()
    approval._FORM["required"].clear()

    def judge(action: object, content: object) -> None:
        if action != "accept":
            raise AdapterError("approval_denied", "this was not approved; nothing was written", outcome="not_sent")

    approval._judge = judge


def _no_viewer(told: Governance) -> Governance:
    return replace(told, viewer=False, audit=None)


@mqtt(
    "has a policy and approvals, one caller, and no audit log",
    "what a subject file does not claim is not asked for",
    described=_described(told=_no_viewer, env={"OT_AUDIT_LOG": ""}, viewer=None, log=""),
)
def policy_alone(server: AdapterServer) -> None:
    pass


CHOICES = {**_MODBUS, **_MQTT, **_OPCUA, **_S7}
