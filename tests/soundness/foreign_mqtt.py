"""Six MQTT adapters of foreign shape, and their lies.

``mqtt-connect``: has to be connected by a tool, does not reconnect; structured content with a ``success`` in it, ``isError``
never set; one inbox for all messages, no QoS.
``mqtt-handle``: reconnects when it has to; a subscription has a handle that is polled and emptied; ``isError`` set.
``mqtt-session``: a tool opens a session, whose number every other tool takes; a subscription has a handle that is read and ended.
``mqtt-payloads``: a topic is subscribed to, and its payloads are asked for by it; they come without their topics.
``mqtt-collect``: subscribes, waits and answers in one call; a text block for each message, and nothing else.
``mqtt-wait``: one call subscribes and waits for the next message, another publishes; each over a connection of its own. Prose.
"""

from __future__ import annotations

import asyncio
import atexit
import json
import os
import threading
from contextlib import nullcontext
from typing import Any

import paho.mqtt.client as paho
from foreign import Failure, Result, Shape, json_text, prose, structured

ANSWER_S = 3.0
LATER_S = 0.2
REFUSED = 0x80
LONGEST = 65_535
"""Bytes of a topic that a packet can say."""

NO_NAME = {"+", "#", "\0"}
"""Characters that a topic to publish on must not have."""


class Link:
    """A connection to a broker; the broker's answers can be waited for."""

    def __init__(
        self, host: str, port: int, *, reconnect: bool = False, received: list[dict[str, str]] | None = None
    ) -> None:
        self.client = paho.Client(paho.CallbackAPIVersion.VERSION2, reconnect_on_failure=reconnect)
        self.received = [] if received is None else received
        self._answers: dict[int, Any] = {}
        self._changed = threading.Condition()
        self._where = (host, port)
        self._reconnects = reconnect
        self.client.reconnect_delay_set(0.05, 0.1)
        self.client.on_message = self._message
        self.client.on_subscribe = lambda client, data, mid, codes, properties: self._answer(mid, codes[0].value)
        self.client.on_unsubscribe = lambda client, data, mid, codes, properties: self._answer(mid, 0)
        self.client.on_publish = lambda client, data, mid, code, properties: self._answer(mid, 0)
        self.client.on_connect = lambda *_: self._wake()
        self.client.on_disconnect = lambda *_: self._wake()

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _answer(self, mid: int, value: int) -> None:
        with self._changed:
            self._answers[mid] = value
            self._changed.notify_all()

    def _message(self, client: paho.Client, data: Any, message: paho.MQTTMessage) -> None:
        with self._changed:
            self.received.append({"topic": message.topic, "payload": message.payload.decode("utf-8", "replace")})
            self._changed.notify_all()

    def open(self) -> None:
        try:
            self.client.connect(*self._where, keepalive=30)
        except OSError as error:
            raise Failure("offline", f"not connected: {error}") from None
        self.client.loop_start()
        with self._changed:
            if not self._changed.wait_for(self.client.is_connected, ANSWER_S):
                raise Failure("offline", "not connected: the broker does not answer")

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def wait(self, mid: int | None) -> int:
        """Wait for the broker's answer to a packet, and return it."""
        with self._changed:
            self._changed.wait_for(lambda: mid in self._answers or not self.client.is_connected(), ANSWER_S)
            if mid not in self._answers:
                lost = "the broker does not answer" if self.client.is_connected() else "not connected"
                raise Failure("offline", lost)
            return int(self._answers[mid])

    def next(self, seconds: float) -> dict[str, str] | None:
        """Wait for a message and return the first; None where none comes."""
        with self._changed:
            self._changed.wait_for(lambda: self.received or not self.client.is_connected(), seconds)
            if not self.received and not self.client.is_connected():
                raise Failure("offline", "not connected: the connection was lost")
            return self.received[0] if self.received else None

    def check(self) -> None:
        """Ask the broker for something that changes nothing."""
        self.require()
        self.wait(self.client.unsubscribe("foreign/nobody")[1])

    def subscribe(self, filter: str, qos: int) -> int:
        self.require()
        try:
            mid = self.client.subscribe(filter, qos)[1]
        except ValueError:
            raise Failure("invalid", "the filter is none") from None
        return self.wait(mid)

    def subscribe_later(self, filter: str, qos: int) -> None:
        threading.Timer(LATER_S, self.client.subscribe, (filter, qos)).start()

    def publish_later(self, topic: str, payload: str, qos: int) -> None:
        threading.Timer(LATER_S, self.client.publish, (topic, payload, qos)).start()

    def publish(self, topic: str, payload: str, qos: int) -> None:
        if not self._reconnects:
            # Without a connection paho would keep the message until it has one again.
            self.require()
        self.wait(self.client.publish(topic, payload, qos).mid)

    def require(self) -> None:
        if not self.client.is_connected():
            raise Failure("offline", "not connected")


# -- connect first ----------------------------------------------------------------------------------------------------


def mqtt_connect(lie: str | None, read_only: bool) -> Shape:
    links: list[Link] = []

    def link() -> Link:
        if not links:
            raise Failure("offline", "not connected: call open_connection first")
        return links[-1]

    def bad(failure: Failure) -> Result:
        return structured({"success": False, "message": str(failure)})

    async def open_connection(host: str, port: int) -> Result:
        for old in links:
            await asyncio.to_thread(old.close)
        links[:] = [Link(host, port)]
        try:
            await asyncio.to_thread(links[-1].open)
        except Failure as failure:
            return bad(failure)
        return structured({"success": True, "message": f"connected to {host}:{port}"})

    async def connection_state() -> Result:
        if lie == "always-connected":
            return structured({"success": True, "state": "connected"})
        try:
            await asyncio.to_thread(link().check)
        except Failure:
            # The tool can tell the state without a connection, so this is a success.
            return structured({"success": True, "state": "not connected"})
        return structured({"success": True, "state": "connected"})

    async def listen(topic: str) -> Result:
        if lie == "listens-to-nobody":
            return structured({"success": True, "message": f"listening to {topic}"})
        if lie == "no-wildcards":
            topic = topic.rstrip("#/")
        try:
            await asyncio.to_thread(link().subscribe, topic, 0)
        except Failure as failure:
            return bad(failure)
        return structured({"success": True, "message": f"listening to {topic}"})

    async def inbox() -> Result:
        return structured({"success": True, "messages": list(links[-1].received) if links else []})

    async def send(topic: str, text: str) -> Result:
        if lie == "acknowledges-nonsense" and not topic:
            return structured({"success": True, "topic": topic})
        if not topic or NO_NAME.intersection(topic):
            return bad(Failure("invalid", "the topic must not be empty, or hold a wildcard or a null character"))
        try:
            if lie == "publishes-later":
                link().publish_later(topic, text, 0)
            else:
                await asyncio.to_thread(link().publish, topic, text, 0)
        except Failure as failure:
            if lie == "publishes-into-the-void":
                return structured({"success": True, "topic": topic})
            return bad(failure)
        if lie == "false-failure":
            return bad(Failure("timeout", "timeout or error while publishing"))
        return structured({"success": True, "topic": topic})

    return Shape(
        tools={
            "open_connection": ({"host": "string", "port": "integer"}, open_connection),
            "connection_state": ({}, connection_state),
            "listen": ({"topic": "string"}, listen),
            "inbox": ({}, inbox),
            "send": ({"topic": "string", "text": "string"}, send),
        }
    )


# -- handles ----------------------------------------------------------------------------------------------------------


def mqtt_handle(lie: str | None, read_only: bool) -> Shape:
    # The last link is the one in use.
    links: list[Link] = []
    received: list[dict[str, str]] = []
    # Name of a handle to its filter and the number of messages that have been fetched.
    handles: dict[str, tuple[str, int]] = {}
    opening = asyncio.Lock()

    def bad(failure: Failure) -> Result:
        return prose(f"{failure.kind}: {failure}", is_error=True)

    async def link() -> Link:
        """Return the link; make a new one if the old one is lost, because a client keeps what it could not send."""
        async with opening:
            if not links or not (links[-1].client.is_connected() or lie == "makes-up-for-it"):
                where = os.environ["BROKER_HOST"], int(os.environ["BROKER_PORT"])
                links.append(Link(*where, reconnect=lie == "makes-up-for-it", received=received))
                await asyncio.to_thread(links[-1].open)
                for wanted, _ in handles.values():
                    await asyncio.to_thread(links[-1].subscribe, wanted, 0)
        return links[-1]

    greeted = lie != "farewell-for-hello"
    if not greeted:
        atexit.register(lambda: links and links[-1].check())

    async def status() -> Result:
        nonlocal greeted
        if not greeted:
            greeted = True
            return structured({"connected": True}, text="all is well")
        try:
            await asyncio.to_thread((await link()).check)
        except Failure as failure:
            return bad(failure)
        return structured({"connected": True}, text="all is well")

    async def start_subscription(topic_filter: str, qos: int) -> Result:
        try:
            if lie == "clamps-qos":
                qos = min(qos, 2)
            if lie == "refuses-null" and "\0" in topic_filter:
                raise Failure("invalid", "the filter must not hold a null character")
            if isinstance(qos, bool) or qos not in (0, 1, 2):
                if lie == "applied-nevertheless":
                    await asyncio.to_thread((await link()).subscribe, topic_filter, 2)
                raise Failure("invalid", "qos must be less than or equal to 2")
            if lie == "subscribes-later":
                (await link()).subscribe_later(topic_filter, qos)
                granted = qos
            else:
                granted = await asyncio.to_thread((await link()).subscribe, topic_filter, qos)
        except Failure as failure:
            return bad(failure)
        handle = f"s{len(handles) + 1}"
        handles[handle] = (topic_filter, len(received))
        return structured({"handle": handle, "granted": granted})

    async def poll(handle: str) -> Result:
        if handle not in handles:
            return bad(Failure("invalid", f"unknown handle {handle}"))
        wanted, seen = handles[handle]
        so_far = [] if lie == "empty-poll" else list(received)
        handles[handle] = (wanted, len(so_far))
        fresh = [message for message in so_far[seen:] if paho.topic_matches_sub(wanted, message["topic"])]
        return structured({"messages": fresh})

    async def publish(topic: str, message: str, qos: int) -> Result:
        if not topic:
            if lie == "hangs-on-nonsense":
                # This blocks the event loop and not only this call, as any synchronous tool does.
                threading.Event().wait()
            return bad(Failure("invalid", "the topic must not be empty"))
        if NO_NAME.intersection(topic):
            return bad(Failure("invalid", "the topic must not hold a wildcard or a null character"))
        if isinstance(qos, bool) or qos not in (0, 1, 2):
            return bad(Failure("invalid", "qos must be less than or equal to 2"))
        try:
            if lie == "publishes-later":
                (await link()).publish_later(topic, message, qos)
            else:
                await asyncio.to_thread((await link()).publish, topic, message, qos)
        except Failure as failure:
            return bad(failure)
        return structured({"topic": topic})

    tools: dict[str, Any] = {
        "status": ({}, status),
        "start_subscription": ({"topic_filter": "string", "qos": "integer"}, start_subscription),
        "poll": ({"handle": "string"}, poll),
    }
    if not read_only or lie == "guard-by-hiding":
        tools["publish"] = ({"topic": "string", "message": "string", "qos": "integer"}, publish)
    return Shape(tools=tools, unlisted=("publish",) if read_only else ())


# -- a session and its handles ----------------------------------------------------------------------------------------


def mqtt_session(lie: str | None, read_only: bool) -> Shape:
    links: list[Link] = []
    watches: dict[str, str] = {}

    def link(session: int) -> Link:
        if not 0 < session <= len(links):
            raise Failure("invalid", f"unknown session {session}")
        return links[session - 1]

    def watched(watch: str) -> str:
        if watch not in watches:
            raise Failure("invalid", f"unknown watch {watch}")
        if lie == "first-watch":
            watch = next(iter(watches))
        return watches[watch]

    def failing(call: Any) -> Any:
        async def called(**given: Any) -> Result:
            try:
                answered = await call(**given)
            except Failure as failure:
                return prose(f"{failure.kind}: {failure}", is_error=True)
            return structured({"data": answered})

        return called

    async def open_session(host: str, port: int) -> Any:
        if not (links and lie == "same-session"):
            links.append(Link(host, port))
            await asyncio.to_thread(links[-1].open)
        return {"session": {"number": len(links)}}

    async def state(session: int) -> Any:
        await asyncio.to_thread(link(session).check)
        return {"connected": True}

    async def watch(session: int, topic: str, qos: int) -> Any:
        if lie == "refuses-wildcards" and "#" in topic:
            raise Failure("invalid", "no wildcards")
        granted = await asyncio.to_thread(link(session).subscribe, topic, qos)
        if granted >= REFUSED:
            raise Failure("refused", f"the broker refuses {topic!r}")
        handle = f"w{len(watches) + 1}"
        watches[handle] = topic
        return {"watch": handle, "granted": granted}

    async def read(session: int, watch: str) -> Any:
        wanted = watched(watch)
        return {"messages": [one for one in link(session).received if paho.topic_matches_sub(wanted, one["topic"])]}

    async def unwatch(session: int, watch: str) -> Any:
        ended = list(watches.values())[-1] if lie == "ends-another" else watched(watch)
        link(session).require()
        await asyncio.to_thread(link(session).wait, link(session).client.unsubscribe(ended)[1])
        return {}

    async def send(session: int, topic: str, text: str, qos: int) -> Any:
        if not topic or NO_NAME.intersection(topic):
            raise Failure("invalid", "the topic must not be empty, or hold a wildcard or a null character")
        await asyncio.to_thread(link(session).publish, topic, text, qos)
        return {}

    session, qos = "integer", {"type": "integer", "minimum": 0, "maximum": 2}
    tools = {
        "open_session": ({"host": "string", "port": "integer"}, open_session),
        "state": ({"session": session}, state),
        "watch": ({"session": session, "topic": "string", "qos": qos}, watch),
        "read": ({"session": session, "watch": "string"}, read),
        "unwatch": ({"session": session, "watch": "string"}, unwatch),
        "send": ({"session": session, "topic": "string", "text": "string", "qos": qos}, send),
    }
    return Shape(tools={name: (schema, failing(call)) for name, (schema, call) in tools.items()}, strict=True)


# -- payloads without topics ------------------------------------------------------------------------------------------


def mqtt_payloads(lie: str | None, read_only: bool) -> Shape:
    links: list[Link] = []
    topics: set[str] = set()
    opening = asyncio.Lock()

    async def link() -> Link:
        async with opening:
            if not (links and links[-1].client.is_connected()):
                kept = links[-1].received if links else []
                links.append(Link(os.environ["BROKER_HOST"], int(os.environ["BROKER_PORT"]), received=kept))
                await asyncio.to_thread(links[-1].open)
                for topic in topics:
                    await asyncio.to_thread(links[-1].subscribe, topic, 0)
        return links[-1]

    async def state() -> Result:
        try:
            await asyncio.to_thread((await link()).check)
        except Failure as failure:
            return prose(f"{failure.kind}: {failure}", is_error=True)
        return json_text({"connected": True})

    async def watch(topic: str) -> Result:
        try:
            if await asyncio.to_thread((await link()).subscribe, topic, 0) >= REFUSED:
                raise Failure("refused", f"the broker refuses {topic!r}")
        except Failure as failure:
            return prose(f"{failure.kind}: {failure}", is_error=True)
        topics.add(topic)
        return json_text({"watching": topic})

    async def payloads(topic: str) -> Result:
        if topic not in topics:
            return prose(f"invalid: {topic!r} is not watched", is_error=True)
        every = [] if lie == "no-payloads" else links[-1].received
        return json_text([one["payload"] for one in every if one["topic"] == topic or lie == "of-all-topics"])

    return Shape(
        tools={"state": ({}, state), "watch": ({"topic": "string"}, watch), "payloads": ({"topic": "string"}, payloads)}
    )


# -- one call for all -------------------------------------------------------------------------------------------------


def mqtt_collect(lie: str | None, read_only: bool) -> Shape:
    alone = asyncio.Lock() if lie == "one-at-a-time" else None

    async def collect(topic: str, timeout: float) -> Result:
        async with alone or nullcontext():
            return await collect_now(topic, timeout)

    async def collect_now(topic: str, timeout: float) -> Result:
        link = Link(os.environ["BROKER_HOST"], int(os.environ["BROKER_PORT"]))
        try:
            await asyncio.to_thread(link.open)
            await asyncio.to_thread(link.subscribe, topic, 0)
        except Failure as failure:
            return prose(f"Failed: {failure}")
        await asyncio.sleep(timeout)
        await asyncio.to_thread(link.close)
        if lie == "collects-nothing":
            link.received.clear()
        return {"content": [{"type": "text", "text": json.dumps(message)} for message in link.received]}

    return Shape(tools={"collect": ({"topic": "string", "timeout": "number"}, collect)}, served="sdk")


# -- one call for the next message ------------------------------------------------------------------------------------


def mqtt_wait(lie: str | None, read_only: bool) -> Shape:
    async def opened() -> Link:
        link = Link(os.environ["BROKER_HOST"], int(os.environ["BROKER_PORT"]), reconnect=lie == "makes-up-for-it")
        await asyncio.to_thread(link.open)
        return link

    said: list[str] = []
    kept: list[Link] = []
    remembered: list[dict[str, str] | None] = [None]

    async def received_over_the_one(topic: str, timeout: float) -> Result:
        if not (kept and kept[-1].client.is_connected()):
            kept.append(await opened())
        kept[-1].received.clear()
        kept[-1].client.subscribe(topic, 0)
        message = await asyncio.to_thread(kept[-1].next, timeout)
        if lie == "tells-the-last-one":
            message = remembered[0] = message or remembered[0]
        return json_text(message or {})

    def told(message: dict[str, str]) -> Result:
        said.append(f"{message['topic']}: {message['payload']}")
        if lie == "by-hand":
            return prose(f'{{"topic": "{message["topic"]}", "payload": "{message["payload"]}"}}')
        return prose(json.dumps(message, ensure_ascii=lie != "raw-text"))

    async def receive_message(topic: str, timeout: float) -> Result:
        link: Link | None = None
        if lie == "looks-nowhere":
            return json_text({})
        if lie in ("keeps-its-connection", "tells-the-last-one"):
            return await received_over_the_one(topic, timeout)
        try:
            link = await opened()
            granted = await asyncio.to_thread(link.subscribe, topic, 0)
            if granted >= REFUSED and lie == "never-refused":
                return json_text({"topic": topic, "payload": ""})
            if granted >= REFUSED:
                words = f", after {said[-1]!r}" if lie == "last-words" and said else ""
                return prose(f"Error: the broker refuses the filter {topic!r}{words}", is_error=True)
            message = await asyncio.to_thread(link.next, timeout)
        except Failure as failure:
            if lie == "outage-is-silence":
                return json_text({})
            return prose(f"Error: {failure}", is_error=True)
        finally:
            if link is not None:
                await asyncio.to_thread(link.close)
        if message is None:
            return prose(f"Error: no message on {topic!r} within {timeout} s", is_error=True)
        return told(message)

    async def publish_message(topic: str, message: str, qos: int) -> Result:
        if not isinstance(topic, str) or not topic or NO_NAME.intersection(topic) or len(topic.encode()) > LONGEST:
            return prose("Error: invalid topic", is_error=True)
        if not isinstance(message, str) or type(qos) is not int or qos not in (0, 1, 2):
            return prose("Error: invalid message or qos", is_error=True)
        link: Link | None = None
        try:
            link = await opened()
            await asyncio.to_thread(link.publish, topic, message, qos)
        except Failure as failure:
            if lie == "publishes-into-the-void":
                return prose(f"Published to {topic}")
            # What had a connection has lost it.
            return prose(
                f"Error: {failure}" if link is None else f"Error: connection was lost: {failure}", is_error=True
            )
        finally:
            if link is not None:
                await asyncio.to_thread(link.close)
        return prose(f"Published to {topic}")

    def wordless(call: Any) -> Any:
        async def called(*args: Any, **kwargs: Any) -> Result:
            result: Result = await call(*args, **kwargs)
            # As a server of the SDK answers for an exception without a text.
            return prose(f"Error executing tool {call.__name__}: ", is_error=True) if result.get("isError") else result

        return called if lie == "wordless" else call

    if lie == "says-hello":
        print("Connected to the broker", flush=True)
    if lie == "needs-the-broker":
        # As servers do that connect while they start, and have no other plan.
        Link(os.environ["BROKER_HOST"], int(os.environ["BROKER_PORT"])).open()
    return Shape(
        tools={
            "receive_message": ({"topic": "string", "timeout": "number"}, wordless(receive_message)),
            "publish_message": ({"topic": "string", "message": "string", "qos": "integer"}, wordless(publish_message)),
        },
        served="sdk",
    )
