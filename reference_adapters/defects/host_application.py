"""A Sparkplug host application beside an adapter, over a connection of its own: what its defects, and an honest adapter, are made from."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import paho.mqtt.client as paho

from ..core import AdapterServer
from ..mqtt.payload import REBIRTH, Metric, encode
from ..mqtt.topics import NAMESPACE

__all__ = ["beside"]

_STATE = f"{NAMESPACE}/STATE/acme-host"
_QUICKEST_S, _SLOWEST_S = 0.2, 1.0
_SPARKPLUG_LEVELS = 4


class _HostApplication:
    """A host that tells its STATE, and asks nodes that it does not know for their births.

    Args:
        once: it tells its STATE on its first connection alone.
        corrects: it says again that it is online when anybody has said otherwise.
        retained: of its STATE.
        later_ms: by how much the time of its STATE is later than that of its will.
    """

    def __init__(self, *, once: bool = False, corrects: bool = True, retained: bool = True, later_ms: int = 0) -> None:
        self._once, self._corrects, self._retained, self._later_ms = once, corrects, retained, later_ms
        self._born, self._stamp = 0, 0
        self._known: set[str] = set()

    def beside(self, server: AdapterServer) -> None:
        """Connect to the broker of an adapter, and again whenever the connection is lost."""
        host, _, port = server.endpoint.partition("://")[2].rpartition(":")
        client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        client.reconnect_delay_set(_QUICKEST_S, _SLOWEST_S)  # type: ignore[arg-type]  # any number will do
        client.on_pre_connect = self._introduce
        client.on_connect = lambda *_: client.subscribe([(_STATE, 1), (f"{NAMESPACE}/#", 0)])
        client.on_subscribe = lambda *_: self._is_born(client)
        client.on_disconnect = lambda *_: self._known.clear()
        client.on_message = self._received
        client.connect_async(host, int(port), keepalive=30)
        client.loop_start()

    def _introduce(self, client: paho.Client, data: Any) -> None:
        # What the last connection did not deliver has its time.
        client._out_messages.clear()
        self._stamp = time.time_ns() // 1_000_000
        client.will_set(_STATE, json.dumps({"online": False, "timestamp": self._stamp}), qos=1, retain=True)

    def _is_born(self, client: paho.Client) -> None:
        self._born += 1
        if not (self._once and self._born > 1):
            self._say(client)

    def _say(self, client: paho.Client) -> None:
        state = json.dumps({"online": True, "timestamp": self._stamp + self._later_ms})
        client.publish(_STATE, state, qos=1, retain=self._retained)

    def _received(self, client: paho.Client, data: Any, message: paho.MQTTMessage) -> None:
        levels = message.topic.split("/")
        if message.topic == _STATE:
            if self._corrects and json.loads(message.payload)["online"] is False:
                self._say(client)
        elif len(levels) >= _SPARKPLUG_LEVELS:
            _, group, kind, node = levels[:_SPARKPLUG_LEVELS]
            if kind.endswith("DATA") and node not in self._known:
                rebirth = encode([Metric(name=REBIRTH, datatype="Boolean", value=True)], None)
                client.publish(f"{NAMESPACE}/{group}/NCMD/{node}", rebirth)
            if kind == "NBIRTH" or kind.endswith("DATA"):
                self._known.add(node)


def beside(**faults: Any) -> Callable[[AdapterServer], None]:
    """Return the change that an adapter is such a host as well."""
    return lambda server: _HostApplication(**faults).beside(server)
