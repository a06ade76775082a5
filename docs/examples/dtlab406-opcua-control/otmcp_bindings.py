"""Lists of nodes with OPCUA-Control-Multi: "• ns=2;s=Temperature: 25.0", a line for each."""

import ast
import re

from pytest_otmcp.subject import Refused

_CODES = {
    "BadNodeIdUnknown": "illegal_address",
    "BadNotWritable": "not_writable",
    "BadUserAccessDenied": "access_denied",
    "BadTypeMismatch|could not convert": "type_mismatch",
    "无法连接到服务器": "connect_failed",
}


async def read_many(tools, *, nodes):
    lines = await _lines(tools, "read_multiple_opcua_nodes", node_ids=nodes)
    return {"values": [_literal(lines.get(node)) for node in nodes]}


async def write_many(tools, *, items):
    lines = await _lines(tools, "write_multiple_opcua_nodes", nodes_to_write=items)
    return {"statuses": [lines.get(item["node_id"]) for item in items]}


async def _lines(tools, tool, **arguments):
    answer = await tools.call(tool, server_url=tools.url, **arguments)
    lines = [line.partition(": ") for line in answer.text.removesuffix("\n").split("\n• ")[1:]]
    # An error stands in the place of a value.
    if answer.is_error or not lines or any(words.startswith("错误: ") for _, _, words in lines):
        codes = (code for words, code in _CODES.items() if re.search(words, answer.text))
        raise Refused(next(codes, "unclassified"), answer.text)
    return {node: words for node, _, words in lines}


def _literal(text):
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text
