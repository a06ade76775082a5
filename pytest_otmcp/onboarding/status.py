"""The trial of tools that tell whether the device can be reached: with the device, and at last without it, and with one that is silent."""

from __future__ import annotations

import re
from collections.abc import Mapping

from ..protocols.protocol import Operation
from ..protocols.registry import protocols
from ..subject.answers import read_answer
from .evidence import claims_success, failure_rules, turned_false
from .experimenter import Experimenter, words_of
from .guess import Guess
from .proposal import Proposal

__all__ = ["look_at_silence", "look_without_device", "reach"]


_SPEAKS_OF_ERRORS = re.compile(
    r"""\b(error|failed|failure|exception)s?\b(?!["'\\]*\s*:\s*(null|none|false|\[\]|\{\}))""", re.IGNORECASE
)
"""Words of an error, but a member that says that there is none."""


async def reach(experimenter: Experimenter, guess: Guess) -> Proposal:
    """Try a tool that only has to reach the device: it is called twice, because the first call may have to connect."""
    await experimenter.call(guess, {})
    shown = await experimenter.call(guess, {})
    asked = {entry["seq"] for entry in shown.entries if entry["request"]}
    answers = [entry for entry in shown.entries if entry["answers"] in asked]
    exercise = protocols()[experimenter.adapter.adapter.protocol].exercise
    refused = bool(answers) and exercise is not None and all(list(exercise.refusals(entry)) for entry in answers)
    # A refusal shows that the device is there; an adapter that takes it for an error, and calls the whole a success, does not know it.
    answered = bool(answers) and not (refused and _SPEAKS_OF_ERRORS.search(str(shown.message)) is not None)
    # A status that is not good may still say of the device alone that it is there: what it says without the device decides.
    proven = answered and shown.message is not None and not read_answer(shown.message, "text")[2]
    seen = "an exchange" if answered else "nothing that it did not refuse" if refused else "nothing"
    evidence = [f"the device saw {seen}" if proven else f"the device saw {seen}; the answer: {shown.words}"]
    return Proposal(guess=guess, proven=proven, evidence=evidence, good=shown.message)


async def look_without_device(experimenter: Experimenter, proposals: Mapping[str, Proposal]) -> None:
    """Call what is proven and cannot succeed while the device is gone: each status, and one other operation.

    It is the last experiment, because an adapter may not come back from it.
    """
    proven = _proven(experimenter, proposals)
    others = [tried for tried in proven if not tried[0].status]
    for operation, proposal, inputs in [*(tried for tried in proven if tried[0].status), *others[:1]]:
        await experimenter.renew()
        await experimenter.device.stop()
        try:
            message, failure = await experimenter.answer(proposal.guess, proposal.offset, inputs, writes=False)
        finally:
            await experimenter.device.start()
        if operation.status:
            _judge_status(proposal, operation.tells, message, failure)
        elif message is not None:
            proposal.failures.append(("connect_failed", message))


async def look_at_silence(experimenter: Experimenter, proposals: Mapping[str, Proposal]) -> None:
    """Call what is proven and cannot succeed while the device takes every request and answers none: how long that takes says which
    deadline the adapter can keep."""
    exercise = protocols()[experimenter.adapter.adapter.protocol].exercise
    tried = next((one for one in _proven(experimenter, proposals) if not one[0].status), None)
    if exercise is None or tried is None:
        return
    _, proposal, inputs = tried
    await experimenter.renew()
    await experimenter.device.fault(*exercise.silent)
    try:
        message, _ = await experimenter.answer(proposal.guess, proposal.offset, inputs, writes=False)
    finally:
        await experimenter.device.fault()
    if message is not None:
        proposal.failures.append(("timeout", message))


def _proven(
    experimenter: Experimenter, proposals: Mapping[str, Proposal]
) -> list[tuple[Operation, Proposal, Mapping[str, object]]]:
    """Return the operations that are proven and cannot succeed without the device, each with inputs for a call."""
    known = protocols()[experimenter.adapter.adapter.protocol]
    return [
        (known.operations[call.operation], proposals[call.operation], call.made(experimenter.random))
        for call in known.proof.unreachable
        if call.operation in proposals and proposals[call.operation].proven
    ]


def _judge_status(proposal: Proposal, tells: str | None, message: Mapping[str, object] | None, failure: str) -> None:
    """Take back the proof of a status that does not say that the device is gone.

    Args:
        tells: the output that says whether the device can be reached.
        message: the answer while the device was gone; None where there was none.
        failure: why there was none.
    """
    good = proposal.good or {}
    if message is None:
        proposal.evidence.append(f"with the device gone: {failure}")
        return
    if tells is not None and (place := turned_false(good, message)) is not None:
        proposal.form, proposal.outputs[tells] = place.form, place.rule
    elif not claims_success(good) or (claims_success(message) and not failure_rules(message, [good], "text")):
        proposal.proven = False
        proposal.evidence = [f"with the device gone it says nothing of that: {words_of(message)}"]
        return
    else:
        proposal.failures.append(("connect_failed", message))
    proposal.evidence.append("with the device gone it said so")
