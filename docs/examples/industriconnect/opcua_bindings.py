"""Browsing with the paper's OPC UA adapter: prose that has to be taken apart."""

import ast
import re

from pytest_otmcp.subject import Refused


async def browse(tools, *, node):
    text = await _answer(tools, "browse_opcua_node_children", node_id=node)
    children = ast.literal_eval(text.removeprefix(f"Children of {node}: "))
    return {
        "node_ids": [child["node_id"] for child in children],
        "browse_names": [child["browse_name"].removeprefix("2:") for child in children],
    }


async def variables(tools):
    return {"node_ids": re.findall(r"^  NodeID: (.*)$", await _answer(tools, "get_all_variables"), re.MULTILINE)}


async def _answer(tools, tool, **arguments):
    answer = await tools.call(tool, **arguments)
    if answer.is_error or answer.text.startswith("Error"):
        raise Refused("illegal_address" if "BadNodeIdUnknown" in answer.text else "unclassified", answer.text)
    return answer.text
