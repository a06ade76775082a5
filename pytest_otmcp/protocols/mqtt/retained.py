"""What other programs have retained on the broker before an adapter comes, such as a list of devices."""

from __future__ import annotations

import base64

from ..protocol import Declared

__all__ = ["RETAINED", "presets"]

RETAINED = "retained"
"""Key of the subject file: messages that the broker holds, each as ``TOPIC=PAYLOAD``."""


def presets(declared: Declared) -> list[dict[str, object]]:
    """Return the pokes by which a broker gets the retained messages that the subject file has.

    Raises:
        ValueError: one of them is none.
    """
    return [{"publish": _message(text)} for text in declared.get(RETAINED, ())]


def _message(text: str) -> dict[str, object]:
    topic, _, payload = text.partition("=")
    if not topic or not payload or {"+", "#"} & {*topic}:
        raise ValueError(f"{RETAINED}: expected TOPIC=PAYLOAD, found {text!r}")
    return {"topic": topic, "payload": base64.b64encode(payload.encode()).decode(), "qos": 1, "retain": True}
