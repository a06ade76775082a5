"""Sparkplug with the paper's MQTT adapter: the node is born before its devices, and every metric says its type."""

import re

from pytest_otmcp.subject import Refused

_KINDS = {"boolean": "bool"}


async def device_birth(tools, *, device, metrics):
    kinds = {metric["name"]: metric["datatype"].lower() for metric in metrics}
    tools.state["types"] = {name: _KINDS.get(kind, kind) for name, kind in kinds.items()}
    await _answer(tools, "publish_node_birth")
    await _answer(tools, "publish_device_birth", device_id=device, metrics=_typed(tools, metrics))
    return {}


async def device_data(tools, *, device, metrics):
    text = await _answer(tools, "publish_device_data", device_id=device, metrics=_typed(tools, metrics))
    return {"metric_count": int(re.search(r"(\d+) metrics\)$", text)[1])}


def _typed(tools, metrics):
    types = tools.state["types"]
    return [{"name": metric["name"], "value": metric["value"], "type": types[metric["name"]]} for metric in metrics]


async def _answer(tools, tool, **arguments):
    answer = await tools.call(tool, **arguments)
    if answer.is_error or answer.text.startswith("Error"):
        raise Refused("unclassified", answer.text)
    return answer.text
