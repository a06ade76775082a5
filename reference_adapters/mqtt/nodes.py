"""What the adapter has learnt of other edge nodes from their births and deaths."""

from __future__ import annotations

from typing import Any

from ..core import AdapterError
from .connection import Message
from .payload import decode

__all__ = ["NodeTracker"]


class NodeTracker:
    """Edge nodes and devices seen since the tracking began."""

    def __init__(self) -> None:
        self.wanted = False
        self._nodes: dict[tuple[str, str], dict[str, Any]] = {}

    def received(self, message: Message) -> None:
        """Take a Sparkplug message into account; what does not decode is ignored."""
        parts = message.topic.split("/")
        if len(parts) not in (4, 5) or parts[2] not in ("NBIRTH", "NDEATH", "DBIRTH", "DDEATH"):
            return
        try:
            metrics = {metric["name"]: metric for metric in decode(message.payload)["metrics"]}
        except AdapterError:
            return
        _, group, kind, node, *device = parts
        entry = self._nodes.setdefault((group, node), {"online": False, "bd_seq": None, "devices": {}})
        if kind == "NBIRTH":
            entry["online"], entry["devices"] = True, {}
            entry["bd_seq"] = metrics["bdSeq"]["value"] if "bdSeq" in metrics else None
        elif kind == "NDEATH":
            # Only the death of the life that was born counts (host-action-ndeath, bdSeq).
            if "bdSeq" in metrics and metrics["bdSeq"]["value"] == entry["bd_seq"]:
                entry["online"] = False
                entry["devices"] = dict.fromkeys(entry["devices"], False)
        elif device:
            entry["devices"][device[0]] = kind == "DBIRTH"

    def listing(self) -> list[dict[str, Any]]:
        """Every node, by group and name."""
        return [
            {
                "group": group,
                "edge_node": node,
                "online": entry["online"],
                "bd_seq": entry["bd_seq"],
                "devices": [{"device": name, "online": online} for name, online in sorted(entry["devices"].items())],
            }
            for (group, node), entry in sorted(self._nodes.items())
        ]
