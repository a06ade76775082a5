"""Defects of policy, audit log and approval, which the checks of SEC, AUD and APR notice."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pydantic import create_model

from ...core import AdapterError, AdapterServer, Call, approval, gates, policy, principal
from ...core.schema import input_schema
from ..defect import Change, Data, Defect, Handler, around, defect, failing, succeeding, wrap

__all__ = ["DEFECTS"]


def _gated(change: Callable[[gates.Gates], None]) -> Change:
    """Return a defect of an adapter that has gates."""

    def apply(server: AdapterServer) -> None:
        if server._gates is not None:
            change(server._gates)

    return apply


def _taking(tool: str, fields: dict[str, Any], handler: Callable[[Handler], Handler]) -> Change:
    """Return the defect that a tool takes further arguments and does something with them."""

    def apply(server: AdapterServer) -> None:
        genuine = server._tools[tool]
        model = create_model(genuine.model.__name__, __base__=genuine.model, **fields)
        listing = server._tools[tool].listing.model_copy(update={"input_schema": input_schema(model)})
        wrap(server, tool, handler, model=model, listing=listing)

    return apply


# -- who may do what --------------------------------------------------------------------------------------------------


def _role_of_an_argument(genuine: Handler) -> Handler:
    async def handler(call: Call, arguments: Any) -> Data:
        if call.gate is not None and arguments.role is not None:
            call.gate._caller = principal.Principal(call.gate._caller.name, arguments.role)
        data: Data = await genuine(call, arguments)
        return data

    return handler


def _claims_are_believed(tool: str) -> Change:
    taking = _taking(tool, {"role": (str | None, None)}, _role_of_an_argument)

    def apply(server: AdapterServer) -> None:
        taking(server)
        # The role is known when the tool works: until then everybody may be one who may.
        policy.Policy.admits = lambda self, role, tool: True

    return apply


@around()
async def _denied_and_done(genuine: Handler, call: Call, arguments: Any) -> Data:
    """Do what the policy refuses, and tell that it was refused."""
    try:
        return await genuine(call, arguments)
    except AdapterError as refusal:
        if call.gate is None or refusal.code != "access_denied":
            raise
        call.gate = None
        await genuine(call, arguments)
        raise


def _allowed_by_default(server: AdapterServer) -> None:
    genuine = policy.Policy.deciding

    def deciding(self: Any, role: str, tool: str, changes: Any) -> Any:
        try:
            return genuine(self, role, tool, changes)
        except AdapterError:
            return {}

    gates.Gate.changes = _without_rules(gates.Gate.changes)
    policy.Policy.deciding = deciding


def _without_rules(genuine: Any) -> Any:
    def changes(self: Any, told: Any) -> None:
        found = self._gates.policy
        if found is not None and not found.deciding(self._caller.role, self._tool, told):
            self._changes += told
            self._passed = True
        else:
            genuine(self, told)

    return changes


def _approved_is_allowed(server: AdapterServer) -> None:
    """Look at no limits where a person is asked."""
    genuine = policy.Rule.objection
    policy.Rule.objection = lambda self, value, present: None if self.approve else genuine(self, value, present)


def _viewers_write(server: AdapterServer) -> None:
    policy.Rule.serves = lambda self, role, tool: self.tools is None or tool in self.tools


def _led_by(tool: str) -> Change:
    """Return the defect that a tool takes arguments which say where the device is."""

    def apply(server: AdapterServer) -> None:
        link = getattr(server._tools[tool].handler, "__self__")._link  # noqa: B009

        def leading(genuine: Handler) -> Handler:
            async def handler(call: Call, arguments: Any) -> Data:
                configured = link._host, link._port
                try:
                    await link.close()
                    link._host, link._port = arguments.host or configured[0], arguments.port or configured[1]
                    data: Data = await genuine(call, arguments)
                finally:
                    await link.close()
                    link._host, link._port = configured
                return data

            return handler

        _taking(tool, {"host": (str | None, None), "port": (int | None, None)}, leading)(server)

    return apply


# -- audit records ----------------------------------------------------------------------------------------------------


def _recording(change: Callable[[Any, Any, str, dict[str, Any]], None]) -> Change:
    """Return the defect that records are made otherwise.

    Args:
        change: gets what records, the gate, and the event and members of a record.
    """

    def apply(server: AdapterServer) -> None:
        genuine = gates.Gate._record

        def record(self: Any, event: str, **members: Any) -> None:
            change(genuine, self, event, members)

        gates.Gate._record = record

    return apply


def _done_alone(genuine: Any, gate: Any, event: str, members: dict[str, Any]) -> None:
    if event in ("intent", "outcome"):
        genuine(gate, event, **members)


def _in_the_end(genuine: Any, gate: Any, event: str, members: dict[str, Any]) -> None:
    if event != "intent":
        genuine(gate, event, **members)


def _with_environment(genuine: Any, gate: Any, event: str, members: dict[str, Any]) -> None:
    genuine(gate, event, settings={name: value for name, value in os.environ.items() if "MQTT" in name}, **members)


def _said_to_be_allowed(server: AdapterServer) -> None:
    gates.Gate._decision = property(lambda self: "allow")


def _buffered(found: gates.Gates) -> None:
    """Have an intent on disk with the next record alone."""
    log, kept = found.audit, list[bytes]()
    assert log is not None
    genuine = log._raw

    def raw(data: bytes) -> None:
        kept.append(data)
        if b'"event":"intent"' not in data:
            genuine(b"".join(kept))
            kept.clear()

    log._raw = raw


def _goes_on_without(found: gates.Gates) -> None:
    log = found.audit
    assert log is not None
    genuine = log.append

    def append(event: str, **members: Any) -> str:
        try:
            return genuine(event, **members)
        except AdapterError:
            return f"{log._seq}:{log._hash[:16]}"

    log.append = append


def _one_behind(found: gates.Gates) -> None:
    """Tell in each answer the record before the last one of the call."""
    log = found.audit
    assert log is not None
    genuine = log.append

    def append(event: str, **members: Any) -> str:
        before = f"{log._seq}:{log._hash[:16]}"
        anchor = genuine(event, **members)
        return before if event in ("outcome", "refused") else anchor

    log.append = append


def _as_written(found: gates.Gates) -> None:
    """Write line breaks in texts as they are."""
    log = found.audit
    assert log is not None
    genuine = log._raw

    def raw(data: bytes) -> None:
        text = data[:-1]
        for escaped in (b"\\\\n", b"\\n"):
            text = text.replace(escaped, b"\n")
        genuine(text.replace(b'\\\\\\"', b'"').replace(b'\\"', b'"') + b"\n" if b"\n" in text else data)

    log._raw = raw


# -- approval ---------------------------------------------------------------------------------------------------------


def _judging(change: Callable[[Any, Any], bool]) -> Change:
    """Return the defect that other answers are approvals as well."""

    def apply(server: AdapterServer) -> None:
        genuine = approval._judge

        def judge(action: object, content: object) -> None:
            if not change(action, content):
                genuine(action, content)

        approval._judge = judge

    return apply


def _approving(change: Callable[[Any, Any, Any, Any], Any]) -> Change:
    """Return the defect that an approval is obtained otherwise."""

    def apply(server: AdapterServer) -> None:
        genuine = approval.Approvals.obtain

        async def obtain(self: Any, context: Any, request: Any, *, outside: bool) -> Any:
            return await change(self, lambda: genuine(self, context, request, outside=outside), context, request)

        approval.Approvals.obtain = obtain

    return apply


async def _confirmed_by_an_argument(approvals: Any, genuine: Any, context: Any, request: Any) -> Any:
    if request.bound["arguments"].get("confirm"):
        return "client"
    return await genuine()


def _confirmable(tool: str) -> Change:
    confirming = _approving(_confirmed_by_an_argument)

    def apply(server: AdapterServer) -> None:
        _taking(tool, {"confirm": (bool, False)}, lambda genuine: genuine)(server)
        confirming(server)

    return apply


async def _silence_is_consent(approvals: Any, genuine: Any, context: Any, request: Any) -> Any:
    try:
        return await genuine()
    except AdapterError as refusal:
        if refusal.code != "approval_expired":
            raise
        return "client"


async def _for_who_cannot_ask(approvals: Any, genuine: Any, context: Any, request: Any) -> Any:
    try:
        return await genuine()
    except AdapterError as refusal:
        if refusal.code != "approval_required":
            raise
        return "client"


async def _for_good(approvals: Any, genuine: Any, context: Any, request: Any) -> Any:
    """Let what was approved once be approved for good."""
    if request.digest not in _APPROVED:
        await genuine()
        _APPROVED.add(request.digest)
    return "client"


async def _for_all_values(approvals: Any, genuine: Any, context: Any, request: Any) -> Any:
    """Let a yes to one value be a yes to the tool, as long as an approval is good."""
    if request.bound["tool"] not in _APPROVED:
        await genuine()
        _APPROVED.add(request.bound["tool"])
    return "client"


_APPROVED: set[str] = set()


def _for_the_tool_alone(server: AdapterServer) -> None:
    approval.Request.digest = property(lambda self: str(self.bound["tool"]))


def _never_late(server: AdapterServer) -> None:
    genuine = approval.Approvals._keep

    def keep(self: Any, key: Any, one: Any) -> None:
        genuine(self, key, replace(one, until=one.until + 3600))

    approval.Approvals._keep = keep


def _asking(change: Callable[[str], str]) -> Change:
    """Return the defect that another question is asked."""

    def apply(server: AdapterServer) -> None:
        genuine = gates.Gate._question

        async def question(self: Any, present: Any, arguments: str) -> str:
            return change(await genuine(self, present, arguments))

        gates.Gate._question = question

    return apply


def _asks_for_a_pin(server: AdapterServer) -> None:
    approval._FORM["properties"]["pin"] = {"type": "string", "title": "Your PIN"}


# -- the account at the device ----------------------------------------------------------------------------------------


def _granted(call: Call, arguments: Any) -> Data:
    return {"topic": arguments.topic, "qos": arguments.qos, "granted_qos": arguments.qos}


def _as_another(server: AdapterServer, user: str | None) -> Callable[[], None]:
    """Give the adapter another account; return what gives it back its own."""
    link: Any = server._close.__self__
    if hasattr(link, "endpoint"):
        endpoint = link.endpoint
        link.endpoint = replace(endpoint, username=user, password=user)
        return lambda: setattr(link, "endpoint", endpoint)
    own = link._username, link._password
    link._username = link._password = user

    def back() -> None:
        link._username, link._password = own

    return back


def _never_itself(user: str | None) -> Change:
    """Return the defect that the adapter has another account than the one that is configured."""

    def apply(server: AdapterServer) -> None:
        _as_another(server, user)

    return apply


def _turned_away_as(user: str | None) -> Change:
    """Return the defect that an adapter whose account is refused goes on with another."""

    def apply(server: AdapterServer) -> None:
        link: Any = server._close.__self__
        genuine = link._connect

        async def connect(*arguments: Any) -> Any:
            try:
                return await genuine(*arguments)
            except AdapterError as error:
                if error.code not in ("auth_failed", "access_denied"):
                    raise
            back = _as_another(server, user)
            try:
                return await genuine(*arguments)
            finally:
                back()

        link._connect = connect

    return apply


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-95j", "mqtt", "An account that the broker refuses is given up for none.", _turned_away_as(None), "SEC-003"
    ),
    defect(
        "MU-95k", "opcua", "An account that the server refuses is given up for none.", _turned_away_as(None), "SEC-003"
    ),
    defect(
        "MU-95l",
        "mqtt",
        "An account that the broker refuses is given up for one that it has of itself.",
        _turned_away_as("admin"),
        "SEC-003",
    ),
    defect(
        "MU-95m", "opcua", "It connects as nobody, although it was given an account.", _never_itself(None), "SEC-003"
    ),
    defect(
        "MU-95n",
        "mqtt",
        "A subscription that the broker does not allow is told as made.",
        succeeding("subscribe_topic", code="access_denied", answer=_granted),
        "SEC-003",
    ),
    defect(
        "MU-95o",
        "opcua",
        "What the server does not allow to be read is told as a failure of the connection.",
        failing(
            "read_opcua_node", change=lambda call, error: AdapterError("connection_lost", "the connection is gone")
        ),
        "",
        "SEC-003",
    ),
    defect(
        "MU-94",
        "modbus",
        "Two arguments say where the device is.",
        _led_by("read_multiple_holding_registers"),
        "SEC-002",
        "ENV-008 SEC-002",
    ),
    defect(
        "MU-94w",
        "modbus",
        "Two arguments say where a write goes.",
        _led_by("write_register"),
        "SEC-002",
        "ENV-008 ERR-006 SEC-002",
    ),
    defect(
        "MU-95",
        "modbus",
        "The argument role makes the caller an engineer.",
        _claims_are_believed("write_register"),
        "SEC-001",
    ),
    defect("MU-95w", "modbus", "What the policy denies is written, and told as denied.", _denied_and_done, "SEC-001"),
    defect("MU-95d", "modbus", "What no rule names is allowed.", _allowed_by_default, "SEC-001"),
    defect("MU-95y", "opcua", "Where a person is asked no limit holds.", _approved_is_allowed, "SEC-001"),
    defect("MU-95v", "mqtt", "A viewer may write what an operator may.", _viewers_write, "SEC-001"),
    defect(
        "MU-100", "modbus", "The audit log has what was written, and no refusals.", _recording(_done_alone), "AUD-001"
    ),
    defect("MU-100d", "s7", "Every record says that the call was allowed.", _said_to_be_allowed, "AUD-001"),
    defect(
        "MU-99l",
        "mqtt",
        "Each audit record has the adapter's settings, the password among them.",
        _recording(_with_environment),
        "AUD-001 AUD-002 AUD-003",
        "KEY-001",
    ),
    defect(
        "MU-101",
        "modbus",
        "An answer names the record before its last one, so that the last can be cut off.",
        _gated(_one_behind),
        "AUD-002",
    ),
    defect("MU-102", "modbus", "A write is recorded when it is over.", _recording(_in_the_end), "AUD-003"),
    defect(
        "MU-102b", "bacnet", "The record of an intent is on disk with the next one alone.", _gated(_buffered), "AUD-003"
    ),
    defect("MU-102f", "modbus", "A write is sent although the audit log is full.", _gated(_goes_on_without), "AUD-003"),
    defect(
        "MU-103",
        "modbus",
        "A line break in an argument makes a line of its own in the audit log.",
        _gated(_as_written),
        "AUD-002",
    ),
    defect(
        "MU-104", "modbus", "The argument confirm counts as an approval.", _confirmable("write_register"), "APR-001"
    ),
    defect(
        "MU-104d",
        "modbus",
        "A refusal counts as an approval.",
        _judging(lambda action, content: action == "decline"),
        "APR-001",
    ),
    defect(
        "MU-104t",
        "opcua",
        "Any text in the form counts as an approval.",
        _judging(lambda action, content: bool(content and content.get("approve"))),
        "APR-001",
    ),
    defect(
        "MU-104s",
        "modbus",
        "Who does not answer in time has approved.",
        _approving(_silence_is_consent),
        "APR-001 APR-002",
    ),
    defect(
        "MU-104c", "modbus", "Where the client cannot ask nobody is asked.", _approving(_for_who_cannot_ask), "APR-001"
    ),
    defect(
        "MU-104q",
        "modbus",
        "The question does not say what is written.",
        _asking(lambda text: "Write to the device?"),
        "",
        "APR-003",
    ),
    defect("MU-104p", "ethernetip", "The question's form has a place for a PIN.", _asks_for_a_pin, "", "APR-003"),
    defect("MU-105", "modbus", "An approval holds for other values.", _for_the_tool_alone, "APR-002"),
    defect("MU-105l", "dnp3", "An approval does not end.", _never_late, "APR-002"),
    defect(
        "MU-106", "modbus", "A write that was approved once is approved for good.", _approving(_for_good), "APR-002"
    ),
    defect(
        "MU-106t",
        "s7",
        "A yes to one value is a yes to all.",
        _approving(_for_all_values),
        "APR-002",
        "APR-002 APR-003",
    ),
)
