"""Batches and methods with opcua-mcp-npx-server, whose tools want each value of a list as a text."""

import json
import re

from pytest_otmcp.subject import Refused

_CODES = {
    "BadNodeIdUnknown": "illegal_address",
    "BadNotWritable": "not_writable",
    "BadUserAccessDenied": "access_denied",
    "BadTypeMismatch|Cannot convert": "type_mismatch",
    "BadInvalidArgument|BadArgumentsMissing|BadTooManyArguments": "invalid_input",
    "BadOutOfRange": "illegal_value",
    "connection cannot be established|ECONNREFUSED": "connect_failed",
    "Connection Break|disconnected by third party": "connection_lost",
    "[Tt]imed? ?out": "timeout",
}


async def write_many(tools, *, items):
    nodes = [{"node_id": item["node_id"], "value": _text(item["value"])} for item in items]
    text = await _answer(tools, "write_multiple_opcua_nodes", nodes_to_write=nodes)
    return {"statuses": [result["status"] for result in json.loads(text.partition("results:\n")[2])]}


async def call_method(tools, *, object, method, arguments):
    texts = [_text(argument) for argument in arguments]
    text = await _answer(tools, "call_opcua_method", object_node_id=object, method_node_id=method, arguments=texts)
    return {"outputs": [output.get("value") for output in json.loads(text.partition("Result: ")[2])]}


def _text(value):
    return value if isinstance(value, str) else json.dumps(value)


async def _answer(tools, tool, **arguments):
    answer = await tools.call(tool, **arguments)
    if answer.is_error or answer.text.startswith("Error") or '"status": "Error' in answer.text:
        codes = (code for words, code in _CODES.items() if re.search(words, answer.text))
        raise Refused(next(codes, "unclassified"), answer.text)
    return answer.text
