"""The trial of tools that tell whether the device can be reached: with the device, and at last without it."""

from __future__ import annotations

from .evidence import claims_success, failure_rules, turned_false
from .experimenter import Experimenter, words_of
from .guess import Guess
from .proposal import Proposal

__all__ = ["outlast", "reach"]


async def reach(experimenter: Experimenter, guess: Guess) -> Proposal:
    """Try a tool that only has to reach the device: it is called twice, because the first call may have to connect."""
    await experimenter.call(guess, {})
    shown = await experimenter.call(guess, {})
    asked = {entry["seq"] for entry in shown.entries if entry["request"]}
    answered = any(entry["answers"] in asked for entry in shown.entries)
    proven = answered and shown.message is not None and claims_success(shown.message)
    seen = "an exchange" if answered else "nothing"
    evidence = [f"the device saw {seen}" if proven else f"the device saw {seen}; the answer: {shown.words}"]
    return Proposal(guess=guess, proven=proven, evidence=evidence, good=shown.message)


async def outlast(experimenter: Experimenter, proposal: Proposal, tells: str | None) -> None:
    """Ask for the device's state while the device is gone: only an answer that says so proves that it is the state.

    It is the last experiment, because an adapter may not come back from it.

    Args:
        tells: the output that says whether the device can be reached.
    """
    await experimenter.adapter.open()
    await experimenter.device.stop()
    try:
        message, failure = await experimenter.answer(proposal.guess, {}, {}, writes=False)
    finally:
        await experimenter.device.start()
    good = proposal.good or {}
    if message is None:
        proposal.evidence.append(f"with the device gone: {failure}")
        return
    if (place := turned_false(good, message)) is not None and tells is not None:
        proposal.form, proposal.outputs[tells] = place.form, place.rule
    elif claims_success(message) and not failure_rules(message, [good], "text"):
        proposal.proven = False
        proposal.evidence = [f"with the device gone it says nothing of that: {words_of(message)}"]
        return
    else:
        proposal.bad, proposal.bad_code = message, "connect_failed"
    proposal.evidence.append("with the device gone it said so")
