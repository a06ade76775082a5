"""Subscriptions of mqtt5-mcp-server: a handle for each filter, and buffers that reading empties."""

from pytest_otmcp.subject import Refused


async def subscribe(tools, *, filter, qos):
    answer = await tools.call("start_subscription", topic_filter=filter, qos=qos)
    if answer.is_error:
        raise Refused("invalid_input" if "less than or equal to 2" in answer.text else "unclassified", answer.text)
    tools.state.setdefault("handles", {})[filter] = answer.structured["session_id"]
    return {}


async def messages(tools, *, filter):
    received = tools.state.setdefault("received", [])
    for handle in tools.state.get("handles", {}).values():
        answer = await tools.call("get_messages", session_id=handle)
        if answer.is_error:
            raise Refused("unclassified", answer.text)
        received.extend(answer.structured["messages"])
    return {"messages": [{"topic": m["topic"], "payload": m["payload"]} for m in received if _matches(filter, m)]}


def _matches(filter, message):
    wanted, topic = filter.split("/"), message["topic"].split("/")
    for position, level in enumerate(wanted):
        if level == "#":
            return True
        if position >= len(topic) or level not in ("+", topic[position]):
            return False
    return len(wanted) == len(topic)
