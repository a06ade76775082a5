"""An MQTT adapter as one writes it first: the official SDK, and paho-mqtt."""

import os
from collections import deque

import paho.mqtt.client as mqtt
from mcp.server import MCPServer

mcp = MCPServer("plant-mqtt")
broker = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
messages = deque(maxlen=1000)
broker.on_message = lambda client, data, message: messages.append((message.topic, message.payload.decode()))


@mcp.tool()
def broker_info() -> dict[str, bool]:
    """Say whether the broker is connected."""
    return {"connected": broker.is_connected()}


@mcp.tool()
def subscribe(topic: str, qos: int = 0) -> str:
    """Subscribe to a topic filter."""
    broker.subscribe(topic, qos)
    return f"subscribed to {topic}"


@mcp.tool()
def read_messages() -> list[dict[str, str]]:
    """Return the messages that came since the last call."""
    came = [{"topic": topic, "payload": payload} for topic, payload in messages]
    messages.clear()
    return came


@mcp.tool()
def publish(topic: str, payload: str, qos: int = 0) -> str:
    """Publish a message."""
    if not os.environ.get("MQTT_WRITES"):
        raise PermissionError("writing is disabled")
    broker.publish(topic, payload, qos)
    return f"published to {topic}"


if __name__ == "__main__":
    broker.connect(os.environ["MQTT_HOST"], int(os.environ["MQTT_PORT"]))
    broker.loop_start()
    mcp.run()
