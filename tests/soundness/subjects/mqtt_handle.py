"""Subscriptions with a handle: polling empties it, so what was fetched is kept here."""

from pytest_otmcp.subject import Refused

_handles = []
_fetched = []


async def subscribe(tools, *, filter, qos):
    answer = await tools.call("start_subscription", topic_filter=filter, qos=qos)
    if answer.is_error:
        raise Refused(_code(answer), answer.text)
    _handles.append(answer.structured["handle"])
    return {"granted_qos": answer.structured["granted"]}


async def messages(tools, *, filter):
    for handle in list(_handles):
        answer = await tools.call("poll", handle=handle)
        if "unknown handle" in answer.text:
            # Of a session that is over.
            _handles.remove(handle)
        elif answer.is_error:
            raise Refused(_code(answer), answer.text)
        else:
            _fetched.extend(message for message in answer.structured["messages"] if message not in _fetched)
    wanted = filter.removesuffix("#")
    return {"messages": [message for message in _fetched if message["topic"].startswith(wanted)]}


def _code(answer):
    return "invalid_input" if answer.text.startswith("invalid") else "connect_failed"
