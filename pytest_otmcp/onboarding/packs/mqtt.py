"""Words and experiments for tools that speak MQTT and Sparkplug B."""

from __future__ import annotations

import asyncio
import base64
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ...protocols.journal import JournalEntry
from ...protocols.mqtt.commands import SCAN_RATE, is_sparkplug_command
from ...protocols.mqtt.entries import as_mqtt, payload_of
from ...subject.answers import extract, read_answer
from ...subject.model import OutputRule, placeholders
from ...wire.mqtt.sparkplug import parse_topic
from ..evidence import Sample, claims_success, find, lists_in
from ..experimenter import Experimenter
from ..guess import Guess
from ..input_schema import required, resolved
from ..pack import Hints, Pack, plain
from ..proposal import Proposal, Shown
from ..status import reach

__all__ = ["PACK"]

_ENDINGS = ("UNSUBSCRIBE", "DISCONNECT", "DISCONNECTED")
_COLLECTED, _KEPT = "otmcp/init/z", "otmcp/init/x"
"""Topics of the messages that a call waits for, and of those that are asked for later."""
_SUBSCRIBED = "otmcp/init/#"
"""The filter that is subscribed to for the latter."""
_ASKED = "otmcp/filter"
"""What the filters begin with by which tools that subscribe are tried."""

_LOOKS, _LOOK_S = 20, 0.05
"""How often a tool is asked for what a node has reported, and the pause in between."""

_LOSES = "it does not give all messages"
_WAITING_S, _SUBSCRIBING_S = 2, 4.0
"""How long a call that waits is told to wait, and how long it may take to subscribe."""


def _nonce(experimenter: Experimenter) -> str:
    return f"nonce-{experimenter.random.getrandbits(48):012x}"


async def _subscribe(experimenter: Experimenter, guess: Guess) -> Proposal:
    name, nonce = _nonce(experimenter), _nonce(experimenter)
    shown = await _call_and_publish(experimenter, guess, [nonce], filter=f"{_ASKED}/{name}", qos=0)
    asked = [entry["connection"] for entry in shown.entries if entry["kind"] == "SUBSCRIBE" and name in str(entry)]
    ended = {entry["connection"] for entry in shown.entries if entry["kind"] in _ENDINGS}
    # A call that subscribes, waits and leaves again, or answers with what came, receives by itself: it is no subscription for
    # later.
    waited = nonce in str(shown.message)
    kept = bool(set(asked) - ended) and not waited and shown.message is not None and claims_success(shown.message)
    proposal = experimenter.propose(guess, shown, proven=kept, seen="a SUBSCRIBE for the filter" if asked else "")
    proposal.returned = bool(asked)
    if waited:
        proposal.evidence = ["no subscription for later: the call waits, and answers with the messages"]
    if kept:
        # For the messages that the next experiment publishes.
        await experimenter.call(guess, {}, filter=_SUBSCRIBED, qos=0)
    return proposal


async def _call_and_publish(experimenter: Experimenter, guess: Guess, nonces: list[str], **inputs: Any) -> Shown:
    """Call a tool, and publish these messages on its topic as soon as the broker has granted it."""
    device = experimenter.device
    since = await device.mark()
    call = asyncio.create_task(experimenter.call(guess, {}, **inputs))
    granted = asyncio.create_task(device.wait(since, {"kind": "SUBACK", "direction": "out"}, timeout_s=_SUBSCRIBING_S))
    await asyncio.wait((call, granted), return_when=asyncio.FIRST_COMPLETED)
    if granted.done() and granted.result():
        for nonce in nonces:
            await device.poke(publish=_message(inputs["filter"], nonce))
    granted.cancel()
    return await call


async def _messages(experimenter: Experimenter, guess: Guess) -> Proposal:
    if "seconds" not in placeholders(guess.arguments):
        return await _inbox(experimenter, guess)
    proposal = await _collected(experimenter, guess)
    if proposal.proven or any(entry.startswith(_LOSES) for entry in proposal.evidence):
        return proposal
    kept = {name: value for name, value in guess.arguments.items() if "seconds" not in placeholders(value)}
    return await _inbox(experimenter, replace(guess, arguments=kept))


async def _collected(experimenter: Experimenter, guess: Guess) -> Proposal:
    """Try a tool that subscribes, waits, and answers with what came meanwhile."""
    nonces = [_nonce(experimenter), _nonce(experimenter)]
    shown = await _call_and_publish(experimenter, guess, nonces, filter=_COLLECTED, seconds=_WAITING_S)
    asked = any(entry["kind"] == "SUBSCRIBE" for entry in shown.entries)
    problem = _lacks(shown, nonces)
    if problem is None:
        later = [_nonce(experimenter)]
        again = await _call_and_publish(experimenter, guess, later, filter=_COLLECTED, seconds=_WAITING_S)
        problem = None if _lacks(again, later) is None else f"{_LOSES}: asked again, it answers from memory"
    seen = "a SUBSCRIBE, and its message is in the answer"
    proposal = experimenter.propose(guess, shown, proven=problem is None, seen=seen if problem is None else "")
    if problem is not None:
        if asked:
            proposal.evidence = [problem if problem else f"the device saw a SUBSCRIBE; {shown.words}"]
        return proposal
    proposal.returned = proposal.blocking = True
    _placed(proposal, _COLLECTED, nonces[0])
    proposal.whole = nonces[1] in str(shown.message)
    if not proposal.whole:
        proposal.evidence.append("of two messages that came together, only the first was in the answer")
    return proposal


def _lacks(shown: Shown, nonces: list[str]) -> str | None:
    """Say what is wrong with an answer that should have these messages, or the first of them; None when nothing is."""
    held = [nonce in str(shown.message) for nonce in nonces]
    if held[0]:
        return None
    return f"{_LOSES}: of two messages on a topic only the last was in the answer" if any(held) else ""


def _message(topic: str, text: str) -> dict[str, object]:
    return {"topic": topic, "payload": base64.b64encode(text.encode()).decode(), "qos": 0, "retain": False}


async def _inbox(experimenter: Experimenter, guess: Guess) -> Proposal:
    nonces, device = [_nonce(experimenter), _nonce(experimenter)], experimenter.device
    since = await device.mark()
    for nonce in nonces:
        await device.poke(publish=_message(_KEPT, nonce))
    await device.wait(since, {"kind": "PUBLISH", "direction": "out", "topic": _KEPT}, count=2, timeout_s=1.0)
    shown = await experimenter.call(guess, {}, filter=_KEPT)
    if nonces[0] not in str(shown.message):
        # What the broker has sent may not have been read yet.
        shown = await experimenter.call(guess, {}, filter=_KEPT)
    problem = _lacks(shown, nonces)
    proposal = experimenter.propose(guess, shown, proven=problem is None, seen="")
    if problem is not None:
        proposal.evidence = [problem or f"a message that was published was not in the answer: {shown.words}"]
        return proposal
    if "filter" in placeholders(guess.arguments) and not await _takes_wildcards(experimenter, guess, nonces[0]):
        kept = {name: value for name, value in guess.arguments.items() if "filter" not in placeholders(value)}
        proposal = await _inbox(experimenter, replace(guess, arguments=kept))
        proposal.evidence.append("its argument for a topic takes no wildcards, so it is left out")
        return proposal
    proposal.returned = True
    proposal.evidence = ["a message that the device published is in the answer"]
    sent = [
        entry
        for entry in (await device.journal(0)).entries
        if entry["kind"] == "PUBLISH" and entry["direction"] == "out"
    ]
    return _placed(proposal, _KEPT, nonces[0], [payload_of(entry).decode("utf-8", "replace") for entry in sent])


async def _takes_wildcards(experimenter: Experimenter, guess: Guess, nonce: str) -> bool:
    """Tell whether a tool that gives the messages of a topic takes a filter as well, which the operation is about. One whose argument is
    required has to be bound all the same."""
    session = experimenter.adapter.session
    needed = required(resolved({} if session is None else session.tools[guess.tool], None))
    if any("filter" in placeholders(value) for name, value in guess.arguments.items() if name in needed):
        return True
    return nonce in str((await experimenter.call(guess, {}, filter=_SUBSCRIBED)).message)


def _placed(proposal: Proposal, topic: str, nonce: str, others: Sequence[str] = ()) -> Proposal:
    """Say where messages are in an answer that holds one with this topic and payload.

    Args:
        others: payloads of messages that may be listed before it.
    """
    for form, first in itertools.product(("structured", "json", "texts"), dict.fromkeys((nonce, *others))):
        place = find([Sample(message=proposal.good or {}, expected=first)], (form,))
        if place is None or "[0]." not in str(place.rule.get("path")):
            continue
        listed, payload = str(place.rule["path"]).split("[0].", 1)
        path = f"{listed}[].{{topic: topic, payload: {payload}}}"
        document = read_answer(proposal.good or {}, form)[0]
        if {"topic": topic, "payload": nonce} in (
            extract({"messages": OutputRule(path=path)}, document)["messages"] or []
        ):
            proposal.form = form
            proposal.outputs["messages"] = {"path": path}
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
        experimenter.provoke(proposal, "invalid_input", topic="", payload=nonce, qos=0)
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


async def _unsubscribe(experimenter: Experimenter, guess: Guess) -> Proposal:
    shown = await experimenter.call(guess, {}, filter=_SUBSCRIBED)
    ended = any(entry["kind"] == "UNSUBSCRIBE" and _SUBSCRIBED in str(entry) for entry in shown.entries)
    return experimenter.propose(guess, shown, proven=ended, seen="an UNSUBSCRIBE for the filter" if ended else "")


async def _subscriptions(experimenter: Experimenter, guess: Guess) -> Proposal:
    """Try a tool that tells the filters of which one was subscribed to before."""
    shown = await experimenter.call(guess, {})
    proposal = experimenter.propose(guess, shown, proven=False)
    for form, rule, found in lists_in(shown.message or {}):
        if any(one.startswith(_ASKED) for one in found):
            proposal.proven, proposal.form, proposal.outputs["filters"] = True, form, rule
            proposal.evidence = ["a filter that was subscribed to is in the answer"]
            break
    return proposal


def _told(entry: JournalEntry) -> tuple[str, dict[str, object]] | None:
    topic = as_mqtt(entry).get("topic")
    try:
        payload = payload_of(entry).decode()
    except UnicodeDecodeError:
        return None
    return (
        None if topic is None or parse_topic(topic) is not None else ("publish", {"topic": topic, "payload": payload})
    )


async def _known_metrics(experimenter: Experimenter, guess: Guess) -> Proposal:
    """Try a tool that tells what is known of a device of the mock's edge node, which is born with a random value."""
    value = _random_setpoint(experimenter)
    setpoint = {"device": "device-1", "name": "setpoint", "datatype": "Double", "value": value, "writable": True}
    for look in range(_LOOKS):
        if look:
            await asyncio.sleep(_LOOK_S)
        # Whoever begins to listen when it is first asked hears of the next births.
        for poke in ({"metrics": [setpoint]}, {"rebirth": True}):
            await experimenter.device.poke(edge_node=poke)
        shown = await experimenter.call(guess, {}, group="factory", node="edge-node-1", device="device-1")
        place = None if shown.message is None else _metrics_in(shown.message, value)
        if place is not None:
            break
    proposal = experimenter.propose(guess, shown, proven=place is not None, seen="")
    if place is None:
        proposal.evidence = [f"a value that the device's node has reported was not in the answer: {shown.words}"]
        return proposal
    proposal.returned = True
    proposal.form, proposal.outputs["metrics"] = place
    proposal.evidence = ["a value that the device's node has reported is in the answer"]
    document = read_answer(shown.message or {}, place[0])[0]
    beside = [*str(place[1]["path"]).split(".")[:-1], "online"]
    if extract({"online": OutputRule(path=".".join(beside))}, document)["online"] is True:
        proposal.outputs["online"] = {"path": ".".join(beside)}
    return proposal


def _random_setpoint(experimenter: Experimenter) -> float:
    return 1.0 + experimenter.random.getrandbits(40) / 2**34


def _metrics_in(message: Mapping[str, object], setpoint: float) -> tuple[str, Mapping[str, object]] | None:
    """Return the form of an answer, and the rule for metrics in it, by name or in a list with names; None where they are not there."""
    for form in ("structured", "json"):
        path = _metrics_path(read_answer(message, form)[0], setpoint)
        if path is not None:
            return form, {"path": ".".join(path) or "@"}
    return None


def _metrics_path(document: object, setpoint: float) -> tuple[str, ...] | None:
    """Return the members that lead to metrics of which one is the setpoint with this value."""
    if isinstance(document, list):
        named = [one.get("value") for one in document if isinstance(one, dict) and one.get("name") == "setpoint"]
        return () if named == [setpoint] else None
    if not isinstance(document, dict):
        return None
    told = document.get("setpoint")
    if setpoint == (told.get("value") if isinstance(told, dict) else told):
        return ()
    below = ((name, _metrics_path(member, setpoint)) for name, member in document.items() if name.isidentifier())
    return next(((name, *path) for name, path in below if path is not None), None)


async def _node_command(experimenter: Experimenter, guess: Guess) -> Proposal:
    scan_rate = {"name": SCAN_RATE, "datatype": "Int64", "value": experimenter.random.randrange(1_000, 2**40)}
    return await _command(experimenter, guess, {"metrics": [scan_rate]})


async def _device_command(experimenter: Experimenter, guess: Guess) -> Proposal:
    setpoint = {"name": "setpoint", "datatype": "Double", "value": _random_setpoint(experimenter)}
    return await _command(experimenter, guess, {"device": "device-1", "metrics": [setpoint]})


async def _command(experimenter: Experimenter, guess: Guess, inputs: dict[str, Any]) -> Proposal:
    inputs = {"group": "factory", "node": "edge-node-1", **inputs}
    shown = await experimenter.call(guess, {}, **inputs)
    done = any(entry["kind"] == "PUBLISH" and is_sparkplug_command(entry, inputs) for entry in shown.entries)
    proposal = experimenter.propose(guess, shown, proven=done, seen="the command" if done else "")
    if done:
        experimenter.provoke(proposal, "invalid_input", **{**inputs, "node": ""})
    return proposal


def _role(proposals: Mapping[str, Proposal]) -> Mapping[str, tuple[str, str]]:
    """Return the role of an adapter that commands other edge nodes, or knows them, and publishes as none itself, and that of one that does
    neither."""
    if proposals.keys() & {"device_birth", "device_data"}:
        return {}
    if not proposals.keys() & _OF_HOSTS:
        return {"sparkplug": ("none", "No tool is called like one for Sparkplug B: not proven, only proposed.")}
    names = ", ".join(sorted({proposals[name].guess.tool for name in proposals.keys() & _OF_HOSTS}))
    return {"sparkplug": ("host", f"It has tools of a Sparkplug host application, and none of an edge node: {names}.")}


_OF_HOSTS = frozenset({"send_device_command", "send_node_command", "sparkplug_nodes", "sparkplug_metrics"})

PACK = Pack(
    protocol="mqtt",
    operations={
        "info": Hints(
            likely="info status health connection broker ping",
            unlikely="list publish subscribe unsubscribe spawn stop messages sparkplug brokers subscriptions connect disconnect",
            needed="info status health connection ping check",
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
        "unsubscribe": plain("unsubscribe", r"(mqtt_?)?unsubscribe(_?(from_?)?(mqtt_?)?topic)?", _unsubscribe),
        "subscriptions": plain(
            "subscriptions subscribed status",
            r"(mqtt_?)?(list|get|show)_?(active_?)?subscriptions|get_?subscribed_?topics|(mqtt_?)?(connection_?)?status",
            _subscriptions,
        ),
        "node_birth": plain("node birth", r"(publish|send)?_?(sparkplug_?)?(node_?birth|nbirth)"),
        "node_data": plain("node data", r"(publish|send)?_?(sparkplug_?)?(node_?data|ndata)"),
        "node_death": plain("node death", r"(publish|send)?_?(sparkplug_?)?(node_?death|ndeath)"),
        "device_death": plain("device death", r"(publish|send)?_?(sparkplug_?)?(device_?death|ddeath)"),
        "send_node_command": plain(
            "node command", r"(publish|send|write)?_?(sparkplug_?)?(node_?(command|cmd|metrics?)|ncmd)", _node_command
        ),
        "send_device_command": plain(
            "device command",
            r"(publish|send|write|set)?_?(sparkplug_?)?(device_?(command|cmd|metrics?)|dcmd)",
            _device_command,
        ),
        "sparkplug_nodes": plain("nodes", r"(list|get)_?(sparkplug|edge)_?nodes"),
        "sparkplug_metrics": plain(
            "device metrics",
            r"((get|read|list)_?)?(sparkplug_?)?device_?(metrics?|values?)|read_sparkplug_device",
            _known_metrics,
        ),
        "decode_sparkplug": plain("decode", r"decode_?sparkplug(_?b)?(_?payload)?"),
    },
    arguments={
        "filter": "topic topic_filter filter pattern topics topic_pattern response_topic",
        "seconds": "seconds timeout duration wait wait_seconds timeout_seconds duration_seconds timeout_s max_wait",
        "qos": "qos quality_of_service",
        "retain": "retain retained retain_flag",
        "topic": "topic topic_name",
        "payload": "payload message data content body value",
        "device": "device_id device device_name",
        "metrics": "metrics values data metric_values",
        "node": "edge_node_id edge_node node_id node",
        "group": "group_id group sparkplug_group_id",
    },
    lists=frozenset({"metrics"}),
    names=("mqtt",),
    told=_told,
    choices=_role,
    # A message without acknowledgement can still be on its way when the answer has come.
    late={"kind": "PUBLISH", "direction": "in"},
    errors={
        "invalid_input": (r"(?i)invalid|validation error|must not be empty|empty topic|non-empty|(is|are) required",)
    },
)
