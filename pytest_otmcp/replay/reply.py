"""Replies rebuilt from what a run record has of them, without I/O.

What is judged again, and what is believed:

- A reply whose frames are in the record is read from their bytes, by the same rules as before; their digest must fit.
- For a reply without frames, which had no fault, the envelope is read again: schema, codes, contradictions within it, its
  clock against the kit's. It is believed that its text block said the same and that ``isError`` agreed.
- Frames that are cut off, are no UTF-8, or held a secret cannot be read again: envelope and faults of such a reply are believed.
- The handles that a call took from the answers of earlier ones are believed: the connect step is no call of the record.
- For how long the machine kept adapter or kit waiting for a processor is believed: the kernel alone knew it.
- The outputs that a Python function of a subject returned are believed; everything that follows from them is judged again.
- Tool and arguments must be those that the stored binding makes of what the steps ask for; outputs are read anew.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from ..core.errors import place_of
from ..core.finding import Finding
from ..core.strict_json import same_json
from ..record.redaction import REDACTED
from ..record.unread import is_unread
from ..session.exchange import Exchange, joint
from ..subject.command import Command
from ..subject.model import READ_WRITE, Answering, Binding, ErrorRule, OutcomeRule, OutputRule
from ..trial.alteration import Alteration
from ..trial.reply import Expectation, Reply, observe, replace_outputs
from ..trial.stored import KEPT_OF_A_FRAME

__all__ = ["UNREADABLE", "HistoryError", "at_its_place", "recorded_reply", "restored_bindings"]


UNREADABLE = (LookupError, TypeError, ValueError, AttributeError, RecursionError, re.error)
"""Exceptions that reading a record may raise when it has another shape than any that the kit writes."""


class HistoryError(Exception):
    """The stored history cannot be true; the message says why."""


def at_its_place(error: Exception) -> str:
    """Return an exception that a record or an oracle has raised, with the line of the kit that raised it."""
    return f"{error!r} at {place_of(error)}"


def restored_bindings(stored: Mapping[str, Any]) -> dict[str, list[Binding] | None]:
    """Return the bindings of the operations that were used; None for an operation that a Python function performs."""
    return {name: None if cases is None else [_binding(case) for case in cases] for name, cases in stored.items()}


def _binding(case: Mapping[str, Any]) -> Binding:
    answering = case["answering"]
    rules = {
        "outputs": {name: _output_rule(rule) for name, rule in case["outputs"].items()},
        "keep": {name: _output_rule(rule) for name, rule in case.get("keep", {}).items()},
        "answering": Answering(
            form=answering["form"],
            outcome=tuple(OutcomeRule(**rule) for rule in answering["outcome"]),
            errors=tuple(ErrorRule(**rule) for rule in answering["errors"]),
        ),
    }
    command = case.get("command")
    return Binding(**{**case, **rules, "command": None if command is None else Command.of_record(command)})


def _output_rule(rule: Mapping[str, Any]) -> OutputRule:
    grid = rule.get("grid")
    if grid is not None and not (len(grid) == 2 and grid[1] > 0):
        raise ValueError("a value is rounded to a grid that there is not")
    return OutputRule(**{**rule, "grid": None if grid is None else tuple(grid)})


def recorded_reply(
    call: Mapping[str, Any],
    *,
    cases: list[Binding] | None,
    endpoint: Mapping[str, str],
    deadline_s: float,
    altered: Alteration | None = None,
) -> Reply:
    """Read a recorded call again.

    Args:
        call: as ``run.json`` has it.
        cases: the subject's bindings of the operation; None for a Python function.
        endpoint, deadline_s: of the adapter under test.
        altered: how the steps change the arguments.

    Raises:
        HistoryError: the call cannot have been made as it is recorded.
    """
    inputs = call["inputs"]
    if cases is None:
        binding, arguments, tool = None, inputs, call["tool"]
    else:
        binding = next((case for case in cases if case.fits(inputs)), None)
        if binding is None:
            raise HistoryError(f"no binding of {call['operation']} is stored for {inputs}")
        arguments, tool = binding.fill(inputs, endpoint, call.get("taken", {})), binding.tool
        if altered is not None:
            arguments, tool = altered.applied(arguments), altered.tool or tool
    if tool != call["tool"] or not same_json(arguments, call["arguments"]):
        raise HistoryError(
            f"{call['operation']} is performed by {tool} with {arguments}, "
            f"the history has {call['tool']} with {call['arguments']}"
        )
    exchange = _exchange(call)
    if exchange is None:
        return _believed(call)
    # Only the read-only variant may do without a tool.
    # Of its own tools a variant that may write lists each; of another tool that the steps name the record says it.
    listed = call["listed"] or (call["variant"] == READ_WRITE and (altered is None or altered.tool is None))
    made = {name: call[name] for name in ("adapter", "variant", "operation")}
    if binding is None:
        expected = Expectation(
            **made,
            deadline_s=deadline_s,
            answering=Answering(form="text"),
            outputs={},
            calls=joint(call["tool"]),
            listed=listed,
        )
        reply = observe(exchange, expected)
        return replace_outputs(reply, call["outputs"], _refusal(call))
    return observe(exchange, Expectation.of(binding, inputs, **made, deadline_s=deadline_s, listed=listed))


def _refusal(call: Mapping[str, Any]) -> tuple[str, str] | None:
    error = (call["envelope"] or {}).get("error")
    return None if error is None else (error["code"], error["message"])


def _exchange(call: Mapping[str, Any]) -> Exchange | None:
    """Return the exchange of a call; None when its frames cannot be read again."""
    frames = call.get("frames")
    response: bytes | None
    if frames is None:
        if not isinstance(call["envelope"], dict) or not call["native"]:
            raise HistoryError(f"{call['tool']} was answered without an envelope, and there are no frames")
        if "frames_sha256" in call:
            raise HistoryError(f"{call['tool']} has a digest of frames, and no frames")
        response, failure, complaint = _frame(call["envelope"]), None, None
    else:
        response = None if frames["response"] is None else frames["response"].encode()
        failure, complaint = frames["failure"], frames["complaint"]
        if response is not None and "frames_sha256" not in call:
            raise HistoryError(f"{call['tool']} has frames, and no digest of them")
        if is_unread(call):
            if not (_altered(frames["request"]) or _altered(frames["response"])):
                raise HistoryError(f"the frames of {call['tool']} are not those of their digest")
            return None
        if response is not None and failure is not None:
            raise HistoryError(f"{call['tool']} was answered, and its failure is called {failure!r}")
    return Exchange(
        tool=call["tool"],
        arguments=call["arguments"],
        response=response,
        sent_ns=call["sent_ns"],
        received_ns=call["received_ns"],
        starved_ns=call.get("starved_ns", 0),
        failure=failure,
        client_complaint=complaint,
    )


def _altered(frame: str) -> bool:
    """Tell whether a frame may have been recorded with less than its bytes: cut off, without a secret, or with bytes that are no text."""
    return len(frame.encode()) > KEPT_OF_A_FRAME or REDACTED in frame or "\\x" in frame


def _frame(envelope: Mapping[str, object]) -> bytes:
    result = {
        "content": [{"type": "text", "text": json.dumps(envelope)}],
        "structuredContent": envelope,
        "isError": envelope.get("success") is not True,
    }
    return json.dumps({"jsonrpc": "2.0", "id": 0, "result": result}).encode()


def _believed(call: Mapping[str, Any]) -> Reply:
    frames = call["frames"]
    return Reply(
        adapter=call["adapter"],
        variant=call["variant"],
        operation=call["operation"],
        exchange=Exchange(
            tool=call["tool"],
            arguments=call["arguments"],
            response=b"",
            sent_ns=call["sent_ns"],
            received_ns=call["received_ns"],
            failure=frames["failure"],
            client_complaint=frames["complaint"],
        ),
        envelope=call["envelope"],
        outputs=dict(call["outputs"]),
        faults=tuple(Finding(**fault) for fault in frames["faults"]),
        native=call["native"],
        listed=call["listed"],
    )
