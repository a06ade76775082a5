"""A write with bacnet-mcp by ezhuk, whose tool takes an object's type and instance in one argument."""

import json

from pytest_otmcp.subject import Refused


async def write(tools, *, device, type, instance, value, priority=None):
    data = value if isinstance(value, str) else json.dumps(value)
    answer = await tools.call(
        "write_property",
        host=tools.host,
        port=int(tools.port),
        obj=f"{type},{instance}",
        prop="present-value",
        data=data,
    )
    if answer.is_error:
        raise Refused("unclassified", answer.text)
    return {}
