"""Scripted assistants, each with one fault: the tests of the assessment.

They know the tasks, as no assistant does: a chooser finds the try in the words that it was given, and does what its kind does there. As a
command: ``python -m tests.assess.choosers KIND SEED TRIES``.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from mcp import Client, StdioServerParameters
from mcp.client.stdio import stdio_client

from pytest_otmcp.assess.campaign import Asked, Told, assignments, case_of
from pytest_otmcp.assess.fitting import binding_of
from pytest_otmcp.assess.place import Try
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.subject.model import Adapter
from pytest_otmcp.trial.assignment import Act, Assignment, Case

KINDS = ("good", "liar", "idle", "off-by-one", "clamping", "poking", "obedient")

_MOST_LOOKS = 5
"""Calls that wait for messages until what is to be read was there: mcpmqtt loses a retained message that comes before it has begun to wait."""

Call = Callable[[str, str, Mapping[str, object]], Awaitable[Mapping[str, Any]]]
"""Calls a tool of the adapter for a protocol."""


def known_tries(seed: int, count: int) -> dict[str, tuple[Assignment, Case]]:
    """Return every try by its words."""
    every = [(one, case_of(one, seed, number)) for one in assignments() for number in range(count)]
    return {case.prompt: (one, case) for one, case in every}


def acts_of(kind: str, assignment: Assignment, case: Case) -> list[tuple[Act, dict[str, object]]]:
    """Return what a chooser does, each act with its inputs."""
    change = {"off-by-one": "beside", "clamping": "clamped"}.get(kind)
    acts = [(act, {**act.inputs, **(getattr(act, change) if change else {})}) for act in case.acts]
    tempted = "obedient" if assignment.family == "injection" else "poking"
    if kind == tempted and case.temptation is not None:
        acts.append((case.temptation, dict(case.temptation.inputs)))
    return acts


async def choose(
    kind: str,
    assignment: Assignment,
    case: Case,
    adapters: Mapping[str, Adapter],
    endpoints: Mapping[str, Mapping[str, str]],
    call: Call,
) -> str:
    """Do what a chooser of this kind does, and return its answer."""
    if kind == "idle":
        return 'There is nothing to do.\n{"outcome": "unsure"}'
    if kind == "liar":
        return 'All done.\n{"outcome": "done", "value": 1}'
    seen = ""
    for act, inputs in acts_of(kind, assignment, case):
        binding = binding_of(adapters[act.protocol], act.operation, inputs)
        if binding is None:
            # A call that waits subscribes by itself.
            continue
        waits = act.operation in adapters[act.protocol].blocking and inputs == act.inputs
        for _ in range(_MOST_LOOKS if waits else 1):
            answer = await call(act.protocol, binding.tool, binding.fill(inputs, endpoints.get(act.protocol, {})))
            seen += json.dumps(answer)
            if _there(case.value, seen):
                break
    # A chooser with a fault believes that what it did was what it was asked for.
    wrong = (
        kind == "clamping"
        and any(act.clamped for act in case.acts)
        and case.nothing_happens
        and assignment.family == "range"
    )
    outcome = "done" if wrong else case.outcomes[0]
    if _there(case.value, seen):
        return json.dumps({"outcome": outcome, "value": case.value})
    numbers = re.findall(r"\d{3,}", seen)
    return json.dumps({"outcome": "done", "value": numbers[-1] if numbers else None})


def _there(value: object, seen: str) -> bool:
    values = value if isinstance(value, list) else [value]
    return value is None or all(str(each) in seen for each in values)


class Chooser:
    """A scripted assistant in the process of the assessment."""

    def __init__(self, kind: str, seed: int, count: int) -> None:
        self._kind = kind
        self._known = known_tries(seed, count)

    async def __call__(self, asked: Asked, under_way: Try) -> Told:
        [(assignment, case)] = [found for prompt, found in self._known.items() if asked.task.startswith(prompt)]

        async def call(protocol: str, tool: str, arguments: Mapping[str, object]) -> Mapping[str, Any]:
            return await under_way.relays[protocol].call(tool, arguments)

        adapters = {key: one.adapter for key, one in under_way.under_test.items()}
        endpoints = {key: one.endpoint for key, one in under_way.under_test.items()}
        return Told(answer=await choose(self._kind, assignment, case, adapters, endpoints, call))


async def _as_command(kind: str, seed: int, count: int, asked: str, servers: Mapping[str, Any]) -> str:
    [(assignment, case)] = [found for prompt, found in known_tries(seed, count).items() if prompt in asked]

    async def call(protocol: str, tool: str, arguments: Mapping[str, object]) -> Mapping[str, Any]:
        entry = servers[protocol]
        parameters = StdioServerParameters(command=entry["command"], args=entry["args"], env=entry["env"])
        async with Client(stdio_client(parameters), mode="legacy") as client:
            return (await client.call_tool(tool, dict(arguments))).model_dump(mode="json")

    return await choose(kind, assignment, case, reference_subject().adapters, {}, call)


if __name__ == "__main__":
    servers = json.loads(Path(os.environ["OTMCP_MCP_CONFIG"]).read_text())["mcpServers"]
    print(asyncio.run(_as_command(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.stdin.read(), servers)))
