"""The first MQTT adapter of docs/first-adapter, whose client sends a subscription, and hands over a message, a moment later."""

import runpy
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt

LATE_S = 0.02

subscribe, handle = mqtt.Client.subscribe, mqtt.Client._handle_on_message


def subscribe_later(self: mqtt.Client, topic: str, qos: int) -> None:
    """Say at once that the filter is subscribed."""
    threading.Timer(LATE_S, subscribe, (self, topic, qos)).start()


def handle_later(self: mqtt.Client, message: mqtt.MQTTMessage) -> None:
    """Hand over a message on the thread that reads the connection."""
    time.sleep(LATE_S)
    handle(self, message)


mqtt.Client.subscribe, mqtt.Client._handle_on_message = subscribe_later, handle_later  # type: ignore[method-assign, assignment]
runpy.run_path(str(Path(__file__).parents[2] / "docs/first-adapter/first/mqtt.py"), run_name="__main__")
