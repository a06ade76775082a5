"""ADR: topics, filters and qualities of service on MQTT."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_otmcp.protocols.mqtt import oracle as mqtt_oracle
from pytest_otmcp.protocols.mqtt.entries import adapter_packets
from pytest_otmcp.trial.alteration import Alteration, filler
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .mqtt_steps import nonce
from .steps import CONNECTION_FAULTS, NOTHING_SENT, QUIET_S, a_write_works, citing, since

__all__ = ["TASKS"]

TASKS = Checks()


# -- MQTT -------------------------------------------------------------------------------------------------------------

_TOO_LONG = 65_536
_NO_QOS = ("invalid_input", "range_overflow", "type_mismatch")


@TASKS.check("ADR-006", "A topic to publish on is one topic, and can be sent.", needs="mqtt.publish")
async def topics_to_publish_on_are_checked(run: Repetition, mqtt: Rig) -> None:
    """Publish on no topic, on topics with a wildcard or a null character, and on one that is longer than a packet can say; then on a
    proper one.

    Said: failures with `invalid_input`, for the longest also `limit_exceeded`, and the outcome `not_sent`; success.
    Seen: nothing of the former, and a connection that stays up; then the message once.
    Why: a broker ends the connection at such a packet, and every subscription with it.
    """
    payload = f"to no topic {nonce(run)}"
    for topic in ("", "control/+", "control/#", "+", "control/pu#mp", "control/\0pump", "\0"):
        reply = await mqtt.call("publish", topic=topic, payload=payload, qos=0)
        run.fails(reply, "invalid_input", outcome="not_sent", requirement="ADR-006")
    asked: dict[str, Any] = {"topic": "control/pump", "payload": payload, "qos": 0}
    arguments = mqtt.arguments_of("publish", **asked)
    if arguments is not None and "topic" in arguments:
        altered = Alteration(given={arguments["topic"]: filler(_TOO_LONG)})
        reply = await mqtt.call_altered("publish", altered, **asked)
        run.fails(reply, "invalid_input", "limit_exceeded", outcome="not_sent", requirement="ADR-006")
    await mqtt.watch(QUIET_S)
    journal = await mqtt.journal()
    nothing = mqtt_oracle.not_published(
        journal, payload.encode(), requirement="ADR-006", declared=mqtt.subject.declared
    )
    run.witnessed(nothing, mqtt_oracle.session_stays_up(journal))
    await a_write_works(run, mqtt)


@TASKS.check(
    "ADR-007",
    "A quality of service is 0, 1 or 2, and wildcards have their places.",
    needs="mqtt.subscribe",
    keys="mqtt.probes.bad_qos",
)
async def qualities_of_service_and_filters_are_checked(run: Repetition, mqtt: Rig) -> None:
    """Subscribe and publish with qualities of service that do not exist: the one of the subject file, 3, -1, one and a half, and, where
    the tool's schema asks for a whole number, "1" and true. Subscribe to filters whose wildcards are in the wrong places. Then both as it
    should be.

    Said: failures with `invalid_input`; success.
    Seen: no SUBSCRIBE and no PUBLISH of the former, and a connection that stays up.
    Why: a value that is cut down in silence is not what was asked for.
    """
    topic, payload = f"otmcp/{nonce(run)}", f"no such quality {nonce(run)}"
    subscription: dict[str, Any] = {"filter": topic, "qos": 1}
    publication: dict[str, Any] = {"topic": "control/pump", "payload": payload, "qos": 1}
    for operation, asked in (("subscribe", subscription), ("publish", publication)):
        if not mqtt.subject.claims(operation) or not mqtt.subject.accepts_input(operation, "qos"):
            continue
        for qos in dict.fromkeys((mqtt.subject.probe("bad_qos"), 3, -1, 1.5)):
            _is_refused(run, await mqtt.call(operation, **{**asked, "qos": qos}))
        for qos in ("1", True) if _is_whole_number(mqtt, operation, asked) else ():
            _is_refused(run, await mqtt.call(operation, **{**asked, "qos": qos}))
    wrong = ("", f"{topic}/#/b", f"{topic}+", f"+{topic}/b", f"{topic}#", f"{topic}/\0")
    replies = [await mqtt.call("subscribe", filter=text, qos=0) for text in wrong]
    await mqtt.watch(QUIET_S)
    journal = await mqtt.journal()
    ended_ns = [entry["t_ns"] for entry in adapter_packets(journal, "DISCONNECTED", "in")]
    for reply in replies:
        # A broker ends the connection at the first of them that it gets, which is found below; then the others never leave.
        cut_off = any(at < (reply.exchange.received_ns or at) for at in ended_ns)
        _is_refused(run, reply, *(CONNECTION_FAULTS if cut_off else ()))
    run.witnessed(mqtt_oracle.not_subscribed(journal, topic, *wrong))
    nothing = mqtt_oracle.not_published(
        journal, payload.encode(), requirement="ADR-007", declared=mqtt.subject.declared
    )
    run.witnessed(nothing, citing("ADR-007", mqtt_oracle.session_stays_up(journal)))
    replies = await mqtt.call_until_success(
        "subscribe", window_s=mqtt.subject.recovery_s, from_first_call=True, **subscription
    )
    run.succeeds(replies[-1], granted_qos=1)
    run.witnessed(mqtt_oracle.not_granted(since(replies[-1], await mqtt.journal()), topic))


def _is_refused(run: Repetition, reply: Reply, *otherwise: str) -> None:
    run.fails(reply, *_NO_QOS, *otherwise, outcome=NOTHING_SENT, requirement="ADR-007")


def _is_whole_number(mqtt: Rig, operation: str, asked: Mapping[str, Any]) -> bool:
    """Tell whether the schema of the tool says that the quality of service is a whole number."""
    tool = mqtt.tool_of(operation, **asked)
    name = (mqtt.arguments_of(operation, **asked) or {}).get("qos")
    listing = None if tool is None else mqtt.listing(operation, tool)
    schema = listing.get("inputSchema") if listing is not None else None
    properties = schema.get("properties") if isinstance(schema, Mapping) else None
    stated = properties.get(name) if isinstance(properties, Mapping) else None
    return isinstance(stated, Mapping) and stated.get("type") == "integer"
