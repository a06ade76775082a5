"""Functions for subscriptions with a handle: polling empties it, so the session's state keeps the messages."""

from pytest_otmcp.subject import Refused


async def subscribe(tools, *, filter, qos):
    answer = await tools.call("start_subscription", topic_filter=filter, qos=qos)
    if answer.is_error:
        raise Refused(_code(answer), answer.text)
    tools.state.setdefault("handles", []).append(answer.structured["handle"])
    return {"granted_qos": answer.structured["granted"]}


async def messages(tools, *, filter):
    fetched = tools.state.setdefault("fetched", [])
    for handle in tools.state["handles"]:
        answer = await tools.call("poll", handle=handle)
        if answer.is_error:
            raise Refused(_code(answer), answer.text)
        fetched += [message for message in answer.structured["messages"] if message not in fetched]
    wanted = filter.removesuffix("#")
    return {"messages": [message for message in fetched if message["topic"].startswith(wanted)]}


def _code(answer):
    return "invalid_input" if answer.text.startswith("invalid") else "connect_failed"
