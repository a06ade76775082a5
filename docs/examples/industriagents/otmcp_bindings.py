"""Sparkplug with industriagents-mqtt-mcp: the node is born before its devices, and every metric says its type."""

from pytest_otmcp.subject import Refused


async def device_birth(tools, *, device, metrics):
    await _publish(tools, message_type="NBIRTH")
    tools.state["types"] = {metric["name"]: metric["datatype"].lower() for metric in metrics}
    await _publish(tools, message_type="DBIRTH", device_id=device, metrics=_typed(tools, metrics))
    return {}


async def device_data(tools, *, device, metrics):
    answer = await _publish(tools, message_type="DDATA", device_id=device, metrics=_typed(tools, metrics))
    return {"metric_count": answer["data"]["metrics"]}


def _typed(tools, metrics):
    types = tools.state["types"]
    return [{"name": metric["name"], "value": metric["value"], "type": types[metric["name"]]} for metric in metrics]


async def _publish(tools, **arguments):
    answer = await tools.call("publish_sparkplug", **arguments)
    if answer.is_error:
        raise Refused("unclassified", answer.text)
    return answer.structured
