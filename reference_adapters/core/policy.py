"""The policy: which role may change which targets, by which tools, between which limits, how often, and with whose approval.

A TOML file that is read once. While there is one, nothing is written that no rule allows::

    [rule.setpoints]
    targets = ["1/holding_registers/80..89"]  # as in OT_WRITE_ALLOW
    tools = ["write_register"]                # any tool that writes, where this is left out
    roles = ["operator", "engineer"]          # these two, where this is left out; a viewer never writes
    lowest = 0
    highest = 800
    step = 50                                 # from what the device holds now
    values = [0, 400, 800]                    # one of these
    per_minute = 10                           # calls of one caller
    approve = "client"                        # or "inbox": see approval
    label = "Setpoint of the boiler, 0.1 °C"  # for the person who is asked

The first rule with role, tool and target decides, for each target on its own; one refusal refuses the call.
"""

from __future__ import annotations

import hashlib
import math
import time
import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .bounds import covers
from .errors import AdapterError
from .settings import ConfigError, Environment

__all__ = ["Change", "Policy", "Rule"]

_SETTING = "OT_POLICY"
_MINUTE_S = 60.0

Change = tuple[str, object]
"""A target and the value that it gets, as :meth:`~.call.Call.changes` is told them."""

_Words = Annotated[list[str], Field(min_length=1)]


class Rule(BaseModel):
    """One rule; see the module."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    targets: _Words
    tools: _Words | None = None
    roles: Annotated[list[Literal["operator", "engineer"]], Field(min_length=1)] = ["operator", "engineer"]
    lowest: float | None = None
    highest: float | None = None
    step: Annotated[float, Field(gt=0)] | None = None
    values: Annotated[list[bool | int | float | str], Field(min_length=1)] | None = None
    per_minute: Annotated[int, Field(ge=1)] | None = None
    approve: Literal["client", "inbox"] | None = None
    label: Annotated[str, Field(max_length=100)] | None = None

    def serves(self, role: str, tool: str) -> bool:
        """Tell whether the rule is for this role and this tool."""
        return role in self.roles and (self.tools is None or tool in self.tools)

    @property
    def limits(self) -> dict[str, object]:
        """What the value has to keep, for the caller and for the person who is asked."""
        return self.model_dump(include={"lowest", "highest", "step", "values"}, exclude_none=True)

    def objection(self, value: object, present: object) -> str | None:
        """Return what a value breaks, or None.

        Args:
            present: what the target holds; looked at where the rule has a step.
        """
        if self.values is not None and not any(type(value) is type(one) and value == one for one in self.values):
            return "gets a value that is not one of those allowed"
        if self.lowest is None and self.highest is None and self.step is None:
            return None
        if not _is_number(value):
            return "has limits, and the value is no finite number"
        assert isinstance(value, int | float)
        if self.lowest is not None and value < self.lowest:
            return "gets a value below its lowest"
        if self.highest is not None and value > self.highest:
            return "gets a value above its highest"
        if self.step is not None and not (
            _is_number(present) and isinstance(present, int | float) and abs(value - present) <= self.step
        ):
            return "changes by more than its largest step"
        return None


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    rule: Annotated[dict[str, Rule], Field(min_length=1)]


class Policy:
    """The rules of a file.

    Attributes:
        rules: by their names, in the order of the file.
        digest: SHA-256 of the file.
    """

    def __init__(self, rules: Mapping[str, Rule], digest: str) -> None:
        self.rules = rules
        self.digest = digest
        self._spent: dict[tuple[str, str], list[float]] = {}

    @classmethod
    def of(cls, environment: Environment) -> Policy | None:
        """Return the policy in the file that ``OT_POLICY`` names; None where it is not set.

        Raises:
            ConfigError: the file cannot be read, or a word in it is not understood, so that a rule would not be kept.
        """
        path = environment.optional(_SETTING)
        if path is None:
            return None
        try:
            raw = Path(path).read_bytes()
            file = _File.model_validate(tomllib.loads(raw.decode()))
        except OSError as error:
            raise ConfigError(f"{_SETTING}: {path} cannot be read: {error.strerror}") from None
        except ValidationError as error:
            fault = error.errors(include_url=False, include_input=False)[0]
            place = ".".join(map(str, fault["loc"])) or "the file"
            raise ConfigError(f"{_SETTING}: {path}: {place}: {fault['msg']}") from None
        except ValueError as error:
            raise ConfigError(f"{_SETTING}: {path}: {error}") from None
        return cls(file.rule, hashlib.sha256(raw).hexdigest())

    def check(self, *, writing: Collection[str], has_present: bool, has_inbox: bool) -> None:
        """Check that every rule can be kept.

        Args:
            writing: the tools that write.
            has_present: the adapter can be asked what a target holds.
            has_inbox: there is an inbox for approvals.

        Raises:
            ConfigError: one cannot be kept.
        """
        for name, rule in self.rules.items():
            if unknown := sorted(set(rule.tools or ()) - set(writing)):
                raise ConfigError(f"{_SETTING}: rule.{name}.tools: no tool that writes is called {unknown[0]}")
            if rule.step is not None and not has_present:
                raise ConfigError(f"{_SETTING}: rule.{name}.step: this adapter cannot ask what a target holds")
            if rule.approve == "inbox" and not has_inbox:
                raise ConfigError(f"{_SETTING}: rule.{name}.approve: there is no inbox; set OT_APPROVAL_INBOX")

    def admits(self, role: str, tool: str) -> bool:
        """Tell whether any rule is for this role and this tool."""
        return any(rule.serves(role, tool) for rule in self.rules.values())

    def deciding(self, role: str, tool: str, changes: Sequence[Change]) -> dict[str, tuple[str, Rule]]:
        """Return the name of the rule that decides of each target, and the rule.

        Raises:
            AdapterError: ``access_denied``: no rule allows one of the targets.
        """
        found = {}
        for target, _ in changes:
            for name, rule in self.rules.items():
                if rule.serves(role, tool) and any(covers(pattern, target) for pattern in rule.targets):
                    found[target] = (name, rule)
                    break
            else:
                message = f"no rule of the policy lets a caller with the role {role} change a target by this tool"
                raise AdapterError("access_denied", message, outcome="not_sent", details={"target": target})
        return found

    def spend(self, caller: str, names: Collection[str]) -> None:
        """Count a call of a caller by rules, all or none; what may be sent counts.

        Raises:
            AdapterError: ``rate_limited``.
        """
        now = time.monotonic()
        spent = {}
        for name in names:
            most = self.rules[name].per_minute
            if most is None:
                continue
            recent = [at for at in self._spent.get((caller, name), ()) if now - at < _MINUTE_S]
            if len(recent) >= most:
                after = math.ceil(1000 * (_MINUTE_S - (now - recent[-most])))
                message = f"the policy allows {most} such writes a minute"
                details = {"rule": name}
                raise AdapterError("rate_limited", message, outcome="not_sent", details=details, retry_after_ms=after)
            spent[caller, name] = [*recent, now]
        self._spent |= spent


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
