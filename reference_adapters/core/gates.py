"""The gates that a call of a writing tool passes: policy, approval and audit log. Without ``OT_POLICY`` and ``OT_AUDIT_LOG`` there are none.

What a call tells of itself while it works (:class:`~.call.Call`) is enough for all of them, so that no adapter knows of them:

* :meth:`~.call.Call.changes`, before anything is sent: the policy decides. Where it needs to know what a target holds now, or a person's approval, the
  tool is left by an exception, and begins again when that is there. Everything is then decided anew.
* :meth:`~.call.Call.sending`, before bytes leave: the intent is on disk.
* the answer: the outcome is on disk, and ``meta.audit_id`` names its record.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Awaitable, Callable, Collection, Sequence
from typing import Any

from mcp.server import ServerRequestContext

from . import principal
from .approval import Approvals, InputRequired, Request
from .audit import Audit
from .errors import AdapterError
from .policy import Change, Policy, Rule
from .settings import ConfigError, Environment

__all__ = ["Gate", "Gates", "Unsettled"]

Present = Callable[[str], Awaitable[object]]
"""Asks the device what a target holds."""

_LONGEST = 2000
_MOST_SHOWN = 20


class Unsettled(AdapterError):
    """The tool has to begin again when :meth:`Gate.settle` has been called. Where nobody does that, it is a refusal."""

    def __init__(self, targets: Collection[str] = ()) -> None:
        super().__init__("approval_required", "a person has to approve this; nothing was written", outcome="not_sent")
        self.targets = targets
        """Targets of which must be known what they hold; none where an approval is needed."""


class Gates:
    """The gates of a server.

    Attributes:
        caller: tells who makes the present call.
    """

    def __init__(
        self,
        policy: Policy | None,
        audit: Audit | None,
        approvals: Approvals,
        endpoint: str,
        local: principal.Principal,
    ) -> None:
        self.policy = policy
        self.audit = audit
        self.approvals = approvals
        self.endpoint = endpoint
        self.caller: Callable[[], principal.Principal] = lambda: local

    @classmethod
    def of(cls, environment: Environment, server: str, endpoint: str) -> Gates | None:
        """Return the gates that the environment describes, or None.

        Raises:
            ConfigError: a setting cannot be used.
        """
        policy = Policy.of(environment)
        about = {"server": server, "endpoint": endpoint, "policy": None if policy is None else policy.digest}
        audit = Audit.of(environment, about)
        if policy is None and audit is None:
            return None
        return cls(policy, audit, Approvals.of(environment), endpoint, principal.of_environment(environment))

    def ready(self, *, writing: Collection[str], has_present: bool, over_http: bool, has_tokens: bool) -> None:
        """Check, before the server begins, that the gates can be kept, and begin the audit log; over HTTP callers are those of tokens.

        Raises:
            ConfigError: one cannot.
        """
        if over_http:
            if not has_tokens:
                raise ConfigError("OT_POLICY and OT_AUDIT_LOG need to know who calls; on HTTP set MCP_AUTH_ISSUER")
            self.caller = principal.of_token
        if self.policy is not None:
            self.policy.check(writing=writing, has_present=has_present, has_inbox=self.approvals.inbox is not None)
        if self.audit is not None:
            self.audit.begin()

    def gate(self, tool: str, operation: str, arguments: Any, context: ServerRequestContext[Any, Any]) -> Gate:
        """Return the gate of one call."""
        return Gate(self, tool, operation, arguments, context)

    def close(self) -> None:
        """End the audit log."""
        if self.audit is not None:
            self.audit.close()


class Gate:
    """What one call of a writing tool has told, and what was decided of it."""

    def __init__(
        self, gates: Gates, tool: str, operation: str, arguments: Any, context: ServerRequestContext[Any, Any]
    ) -> None:
        self._gates = gates
        self._tool = tool
        self._operation = operation
        self._arguments = arguments
        self._context = context
        self._caller = gates.caller()
        self._changes: list[Change] = []
        self._rules: dict[str, tuple[str, Rule]] = {}
        self._present: dict[str, object] = {}
        self._asked: list[Change] = []
        """Changes for which an approval is needed."""
        self._approved: list[Change] | None = None
        self._approval: str | None = None
        """What the records of the calls have in common that are about one approval."""
        self._approved_by: str | None = None
        self._recorded = 0
        """Changes of which the intent is on disk."""
        self._counted: set[str] = set()
        self._passed = False
        self.has_intent = False
        self.anchor: str | None = None
        """That of the last record of this call."""

    def begin(self) -> None:
        """Begin, or begin again.

        Raises:
            AdapterError: ``access_denied``: the policy has nothing for the caller's role and this tool.
        """
        self._changes, self._recorded, self._passed = [], 0, False
        policy, role = self._gates.policy, self._caller.role
        if policy is not None and not policy.admits(role, self._tool):
            message = f"no rule of the policy lets a caller with the role {role} use this tool"
            raise AdapterError("access_denied", message, outcome="not_sent")

    def changes(self, changes: Sequence[Change]) -> None:
        """Decide changes that the tool has told.

        Raises:
            AdapterError: the policy refuses them.
            Unsettled: something must be found out first.
        """
        policy, self._passed = self._gates.policy, False
        if policy is not None:
            rules = policy.deciding(self._caller.role, self._tool, changes)
            self._rules |= rules
            needed = [target for target, (_, rule) in rules.items() if rule.step is not None]
            if missing := [target for target in needed if target not in self._present]:
                raise Unsettled(missing)
            for target, value in changes:
                name, rule = rules[target]
                what = rule.objection(value, self._present.get(target))
                if what is not None:
                    raise AdapterError(
                        "range_overflow",
                        f"a target {what} (rule {name} of the policy)",
                        outcome="not_sent",
                        allowed=rule.limits,
                        details={"target": target, "rule": name},
                    )
            told = self._changes + list(changes)
            if any(rule.approve for _, rule in rules.values()):
                if self._approved is None:
                    self._asked = told
                    raise Unsettled
                if self._approved[: len(told)] != told:
                    message = "what the call would change is not what was approved"
                    raise AdapterError("approval_denied", message, outcome="not_sent")
            names = {name for name, _ in rules.values()} - self._counted
            policy.spend(self._caller.name, names)
            self._counted |= names
        self._changes += changes
        self._passed = True

    async def settle(self, needed: Unsettled, present: Present | None) -> None:
        """Find out what a tool could not go on without.

        Raises:
            AdapterError: the device does not tell, or nobody approves.
            InputRequired: the client has to be asked first.
        """
        if needed.targets:
            assert present is not None
            for target in needed.targets:
                self._present[target] = await present(target)
            return
        request = self._request(present)
        self._approval = request.digest[:16]
        outside = any(rule.approve == "inbox" for _, rule in self._rules.values())
        try:
            self._approved_by = await self._gates.approvals.obtain(self._context, request, outside=outside)
        except InputRequired:
            self._record("asked")
            raise
        # Time has passed: what the targets hold is asked for again.
        self._approved, self._present = self._asked, {}

    def _request(self, present: Present | None) -> Request:
        arguments = json.dumps(self._arguments)
        if len(self._asked) > _MOST_SHOWN or len(arguments) > _LONGEST:
            message = f"a person can approve {_MOST_SHOWN} targets and {_LONGEST} characters of arguments at once"
            raise AdapterError("limit_exceeded", message, outcome="not_sent")
        policy = self._gates.policy
        bound = {
            "endpoint": self._gates.endpoint,
            "principal": self._caller.name,
            "role": self._caller.role,
            "tool": self._tool,
            "arguments": self._arguments,
            "changes": [[target, _plain(value)] for target, value in self._asked],
            "policy": None if policy is None else policy.digest,
        }
        return Request(lambda: self._question(present, arguments), bound)

    async def _question(self, present: Present | None, arguments: str) -> str:
        caller, approvals = self._caller, self._gates.approvals
        lines = [f"Write to {self._gates.endpoint}?"]
        for target, value in self._asked:
            _, rule = self._rules[target]
            line = f"- {json.dumps(target)}" + ("" if rule.label is None else f" ({rule.label})")
            if present is not None:
                line += f", now {await _told(present, target)}"
            line += f", to be {_shown(value, 'what the arguments say')}"
            lines.append(line + (f"; limits {json.dumps(rule.limits)}" if rule.limits else ""))
        lines += [
            f"Tool {self._tool}, arguments {arguments}",
            f"Asked for by {json.dumps(caller.name)} ({caller.role}); for {approvals.valid_s:g} s.",
        ]
        return "\n".join(lines)

    def sending(self, request_id: str) -> None:
        """Put the intent on disk.

        Raises:
            AdapterError: ``audit_unavailable``, or ``access_denied``: the tool has not told what it changes.
        """
        if self._gates.policy is not None and not (self._passed and self._changes):
            message = "this tool does not say what it changes, or goes on after a refusal; while there is a policy it may not write"
            raise AdapterError("access_denied", message, outcome="not_sent")
        if not self.has_intent or self._recorded < len(self._changes):
            self._record("intent", request_id=request_id)
            self.has_intent, self._recorded = True, len(self._changes)

    def ended(self, request_id: str, error: dict[str, Any] | None) -> None:
        """Record what became of the call; a record that cannot be made changes nothing of that.

        Args:
            error: the envelope's; None for a success.
        """
        what = {"code": None, "outcome": "applied"} if error is None else {n: error[n] for n in ("code", "outcome")}
        try:
            if self.has_intent:
                self._record("outcome", request_id=request_id, **what)
            elif what["code"] != "audit_unavailable":
                self._record("ended" if error is None else "refused", request_id=request_id, **what)
        except AdapterError:
            pass

    @property
    def _decision(self) -> str:
        if not (self._passed or self.has_intent):
            return "deny"
        return "approval" if self._approved_by else "allow"

    @property
    def meta(self) -> dict[str, Any]:
        """The members of the envelope's ``meta`` that are the gates'."""
        found: dict[str, Any] = {} if self.anchor is None else {"audit_id": self.anchor}
        if self._gates.policy is not None:
            found["policy"] = {"decision": self._decision, "principal": self._caller.name}
            if self._rules:
                found["policy"]["rule"] = ",".join(sorted({name for name, _ in self._rules.values()}))
        return found

    def _record(self, event: str, **members: Any) -> None:
        audit = self._gates.audit
        if audit is None:
            return
        self.anchor = audit.append(
            event,
            principal=self._caller.name,
            role=self._caller.role,
            tool=self._tool,
            operation=self._operation,
            endpoint=self._gates.endpoint,
            arguments=_argument_text(self._arguments),
            changes=[[target, _plain(value)] for target, value in self._changes or self._asked],
            rules=sorted({name for name, _ in self._rules.values()}),
            decision=self._decision if event != "asked" else "approval",
            approval=self._approval,
            approved_by=self._approved_by,
            **members,
        )


async def _told(present: Present, target: str) -> str:
    try:
        return _shown(await present(target), "no number")
    except AdapterError:
        return "not known"


def _plain(value: object) -> object:
    """Return a value as JSON can hold it; None for what is no number, no truth value and no text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, bool | int | float | str) else None


def _shown(value: object, otherwise: str) -> str:
    # Text may come from a device, and must not read like a part of the question.
    return json.dumps(value) if isinstance(value, int | float) and math.isfinite(value) else otherwise


def _argument_text(arguments: Any) -> object:
    """Return arguments as JSON text, or their digest where they are long."""
    try:
        text = json.dumps(arguments, separators=(",", ":"))
    except (ValueError, RecursionError):
        return None
    if len(text) <= _LONGEST:
        return text
    return {"sha256": hashlib.sha256(text.encode()).hexdigest(), "characters": len(text)}
