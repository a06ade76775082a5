"""Words and experiments for tools that speak MQTT and Sparkplug B."""

from __future__ import annotations

import asyncio
import base64
from dataclasses import replace

from ...subject.model import placeholders
from ..evidence import find
from ..experimenter import Experimenter, Proposal, reach
from ..guess import Guess
from ..pack import Hints, Pack

__all__ = ["PACK"]

_ENDINGS = ("UNSUBSCRIBE", "DISCONNECT", "DISCONNECTED")
_COLLECTED = "otmcp/init/z"
_WAITING_S, _SUBSCRIBING_S = 2, 4.0
"""How long a call that waits is told to wait, and how long it may take to subscribe."""


def _nonce(experimenter: Experimenter) -> str:
    return f"nonce-{experimenter.random.getrandbits(48):012x}"


async def _subscribe(experimenter: Experimenter, guess: Guess) -> Proposal:
    wanted = f"otmcp/{_nonce(experimenter)}/#"
    shown = await experimenter.call(guess, {}, filter=wanted, qos=0)
    asked = [entry["connection"] for entry in shown.entries if entry["kind"] == "SUBSCRIBE" and wanted in str(entry)]
    ended = {entry["connection"] for entry in shown.entries if entry["kind"] in _ENDINGS}
    # A call that subscribes, waits and leaves again receives by itself: it is no subscription for later.
    kept = bool(set(asked) - ended)
    proposal = experimenter.propose(guess, shown, proven=kept, seen="a SUBSCRIBE for the filter" if asked else "")
    proposal.returned = bool(asked)
    if kept:
        # For the messages that the next experiment publishes.
        await experimenter.call(guess, {}, filter="otmcp/init/#", qos=0)
    return proposal


async def _messages(experimenter: Experimenter, guess: Guess) -> Proposal:
    if "seconds" not in placeholders(guess.arguments):
        return await _inbox(experimenter, guess)
    proposal = await _collected(experimenter, guess)
    if proposal.proven:
        return proposal
    kept = {name: value for name, value in guess.arguments.items() if "seconds" not in placeholders(value)}
    return await _inbox(experimenter, replace(guess, arguments=kept))


async def _collected(experimenter: Experimenter, guess: Guess) -> Proposal:
    """Try a tool that subscribes, waits, and answers with what came meanwhile."""
    nonce, device = _nonce(experimenter), experimenter.device
    since = await device.mark()
    waiting = asyncio.create_task(experimenter.call(guess, {}, filter=_COLLECTED, seconds=_WAITING_S))
    subscribed = await device.wait(since, {"kind": "SUBACK", "direction": "out"}, timeout_s=_SUBSCRIBING_S)
    if subscribed:
        await device.poke(publish=_message(_COLLECTED, nonce))
    shown = await waiting
    proven = bool(subscribed) and nonce in str(shown.message)
    seen = "a SUBSCRIBE, and its message is in the answer"
    proposal = experimenter.propose(guess, shown, proven=proven, seen=seen if proven else "")
    proposal.returned = proposal.blocking = proven
    return _placed(proposal, nonce) if proven else proposal


def _message(topic: str, text: str) -> dict[str, object]:
    return {"topic": topic, "payload": base64.b64encode(text.encode()).decode(), "qos": 0, "retain": False}


async def _inbox(experimenter: Experimenter, guess: Guess) -> Proposal:
    nonce = _nonce(experimenter)
    since = await experimenter.device.mark()
    await experimenter.device.poke(publish=_message("otmcp/init/x", nonce))
    await experimenter.device.wait(since, {"kind": "PUBLISH", "direction": "out"}, timeout_s=1.0)
    shown = await experimenter.call(guess, {}, filter="otmcp/init/x")
    proven = nonce in str(shown.message)
    proposal = experimenter.propose(
        guess, shown, proven=proven, seen="to it that the message it published is in the answer"
    )
    proposal.returned = proven
    if not proven:
        proposal.evidence = [f"a message that was published was not in the answer: {shown.words}"]
        return proposal
    return _placed(proposal, nonce)


def _placed(proposal: Proposal, nonce: str) -> Proposal:
    """Say where messages are in an answer that holds one with this payload."""
    for form in ("structured", "json", "texts"):
        place = find(proposal.good or {}, nonce, (form,))
        if place is not None and "[0]." in str(place.rule.get("path")):
            listed, payload = str(place.rule["path"]).split("[0].", 1)
            proposal.form = form
            proposal.outputs["messages"] = {"path": f"{listed}[].{{topic: topic, payload: {payload}}}"}
            return proposal
    proposal.evidence.append("where topic and payload are in the answer was not recognised: fill in 'result'")
    return proposal


async def _publish(experimenter: Experimenter, guess: Guess) -> Proposal:
    nonce = _nonce(experimenter)
    shown = await experimenter.call(guess, {}, topic="otmcp/init/y", payload=nonce, qos=0)
    received = [entry for entry in shown.entries if entry["kind"] == "PUBLISH" and entry["direction"] == "in"]
    own = [entry for entry in received if entry.get("topic") == "otmcp/init/y"]
    proposal = experimenter.propose(
        guess, shown, proven=bool(own), seen=f"a PUBLISH with QoS {own[0].get('qos')}" if own else ""
    )
    if own:
        await experimenter.provoke(proposal, "invalid_input", topic="", payload=nonce, qos=0)
    return proposal


async def _device_birth(experimenter: Experimenter, guess: Guess) -> Proposal:
    return await _report(experimenter, guess, "DBIRTH", {"datatype": "Double"})


async def _device_data(experimenter: Experimenter, guess: Guess) -> Proposal:
    return await _report(experimenter, guess, "DDATA", {})


async def _report(experimenter: Experimenter, guess: Guess, kind: str, further: dict[str, object]) -> Proposal:
    metric = {"name": "temperature", "value": 20.5, **further}
    shown = await experimenter.call(guess, {}, device="device-1", metrics=[metric])
    seen = any(f"/{kind}/" in str(entry.get("topic")) and entry["direction"] == "in" for entry in shown.entries)
    return experimenter.propose(guess, shown, proven=seen, seen=f"a {kind}" if seen else "")


PACK = Pack(
    protocol="mqtt",
    operations={
        "info": Hints(
            likely="info status health connection broker ping",
            unlikely="list publish subscribe unsubscribe spawn stop messages sparkplug brokers subscriptions connect disconnect",
            experiment=reach,
        ),
        "subscribe": Hints(
            likely="subscribe subscription listen start",
            unlikely="unsubscribe list stop end subscriptions",
            needed="subscribe subscription listen",
            experiment=_subscribe,
        ),
        "messages": Hints(
            likely="messages message receive received read get inbox collect",
            unlikely="publish send subscribe delete clear",
            experiment=_messages,
        ),
        "publish": Hints(
            likely="publish send message",
            unlikely="subscribe sparkplug birth death ddata nbirth ndata device node command",
            needed="publish send",
            experiment=_publish,
        ),
        "device_birth": Hints(
            likely="birth dbirth device sparkplug",
            unlikely="death data node nbirth read list decode",
            needed="birth dbirth sparkplug",
            experiment=_device_birth,
        ),
        "device_data": Hints(
            likely="data ddata device sparkplug update",
            unlikely="death birth node ndata read list decode",
            needed="data ddata sparkplug",
            experiment=_device_data,
        ),
    },
    arguments={
        "filter": "topic topic_filter filter pattern topics topic_pattern",
        "seconds": "seconds timeout duration wait wait_seconds timeout_seconds duration_seconds timeout_s max_wait",
        "qos": "qos quality_of_service",
        "topic": "topic topic_name",
        "payload": "payload message data content body value",
        "device": "device_id device device_name",
        "metrics": "metrics values data",
    },
    lists=frozenset({"metrics"}),
    names=("mqtt",),
    # A message without acknowledgement can still be on its way when the answer has come.
    late={"kind": "PUBLISH", "direction": "in"},
    errors={"invalid_input": (r"(?i)invalid|validation error|must not be empty|empty topic",)},
)
