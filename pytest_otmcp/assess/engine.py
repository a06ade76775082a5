"""The assessment on Inspect (``inspect-ai``): models, tasks and epochs are its affair; tasks, relay and judgement by the device are ours.

Needs ``pytest-otmcp[assess]``. Inspect finds the task ``pytest_otmcp/assessment`` by an entry point, so its own command line works as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import inspect_ai
from inspect_ai.dataset import Sample
from inspect_ai.model import ChatMessageSystem, ChatMessageUser
from inspect_ai.scorer import Score, mean, scorer, stderr
from inspect_ai.solver import solver
from inspect_ai.tool import mcp_connection, mcp_server_http

from ..session.isolation import Isolation
from ..subject.model import Subject
from ..subject.selection import select
from ..trial.assignment import Assignment
from .campaign import SYSTEM, Asked, Told, Tools, case_of, chosen, run_try
from .place import Place, Try, why_not
from .results import Assessment, TryTold
from .scoring import Call
from .served import serve

__all__ = ["assessment", "fill"]

_TRY, _TOOLS = "otmcp_try", "otmcp_tools"
_MOST_MESSAGES = 40
"""Messages of one try, after which the assistant has to stop: twelve rounds are far more than any task needs."""


@inspect_ai.task
def assessment(subject: str = "", tasks: str = "", tries: int = 5, seed: int = 0) -> Any:
    """Return the task for Inspect.

    Args:
        subject: path of a subject file; empty for the reference adapters.
        tasks: ids or families, separated by commas; empty for all.
        tries: epochs.
        seed: for the values of the tries.
    """
    found = select(Path(subject) if subject else None).subject
    return _task(found, Isolation(), chosen([one for one in tasks.split(",") if one]), tries, seed)


def _task(subject: Subject, isolation: Isolation, wanted: Sequence[Assignment], tries: int, seed: int) -> Any:
    able = {one.id: one for one in wanted if why_not(subject, one) is None}
    reducers = ["mean", f"pass_k_{tries}"] if tries > 1 else ["mean"]
    return inspect_ai.Task(
        name="assessment",
        dataset=[Sample(id=name, input=name, metadata={"family": one.family}) for name, one in able.items()],
        solver=_operate(subject, isolation, able, seed),
        scorer=_device(),
        epochs=inspect_ai.Epochs(tries, reducers),
        message_limit=_MOST_MESSAGES,
        metadata={"subject": f"{subject.name} {subject.version}", "seed": seed},
    )


@solver
def _operate(subject: Subject, isolation: Isolation, able: Mapping[str, Assignment], seed: int) -> Any:
    async def solve(state: Any, generate: Callable[..., Any]) -> Any:
        assignment = able[str(state.sample_id)]
        case = case_of(assignment, seed, state.epoch - 1)
        tools: Tools = {}

        async def assistant(asked: Asked, under_way: Try) -> Told:
            nonlocal state
            state.messages = [ChatMessageSystem(content=SYSTEM), ChatMessageUser(content=asked.words)]
            async with serve(under_way.relays) as served:
                headers = {"Authorization": f"Bearer {served.token}"}
                servers = [mcp_server_http(name=key, url=url, headers=headers) for key, url in served.urls.items()]
                async with mcp_connection(servers):
                    state.tools = [tool for server in servers for tool in await server.tools()]
                    state = await generate(state, tool_calls="loop")
            # What was used until now is all of this sample's.
            return Told(
                answer=state.output.completion, tokens=state.token_usage, attempts=_refused_by_host(state, under_way)
            )

        place = Place(subject, isolation)
        try:
            told = await run_try(place, assignment, state.epoch - 1, case, assistant, tools)
        finally:
            await place.close()
        state.store.set(_TRY, told)
        state.store.set(_TOOLS, tools)
        return state

    return solve


def _refused_by_host(state: Any, under_way: Try) -> list[Call]:
    """Return the calls that Inspect itself refused, because they do not fit the schema: they were attempts as well."""
    refused = {
        message.tool_call_id: message.error.message
        for message in state.messages
        if message.role == "tool" and message.error is not None and message.error.type == "parsing"
    }
    of_tool = {str(tool["name"]): key for key, relay in under_way.relays.items() for tool in relay.tools}
    return [
        Call(
            protocol=of_tool[call.function],
            tool=call.function,
            arguments=call.arguments,
            text=refused[call.id],
            success=False,
        )
        for message in state.messages
        if message.role == "assistant"
        for call in message.tool_calls or []
        if call.id in refused and call.function in of_tool
    ]


@scorer(
    metrics={"right": [mean(), stderr()], "over_reach": [mean()], "false_claim": [mean()]},
)
def _device() -> Any:
    """The device's word on a try, as it was judged where the device was."""

    async def score(state: Any, target: Any) -> Any:
        told: TryTold = state.store.get(_TRY)
        return Score(
            value={
                "right": float(told["verdict"] == "right"),
                "over_reach": float(told["verdict"] == "over-reach"),
                "false_claim": float(told["honesty"] == "false"),
            },
            answer=told["answer"],
            explanation="; ".join([told["verdict"], *told["why"], *told["changed"]]),
            metadata={_TRY: told, _TOOLS: state.store.get(_TOOLS)},
        )

    return score


def fill(
    into: Assessment,
    subject: Subject,
    isolation: Isolation,
    wanted: Sequence[Assignment],
    *,
    tries: int,
    model: Any,
    base_url: str | None,
    log_dir: Path,
    deadline_s: float,
) -> None:
    """Let a model do the tries, and note them; Inspect's log is below ``log_dir``.

    Args:
        model: its name as Inspect has it, or a model.

    Raises:
        RuntimeError: the evaluation has failed, in Inspect's words.
    """
    into["not_asked"] = {one.id: why for one in wanted if (why := why_not(subject, one)) is not None}
    try:
        [log] = inspect_ai.eval(
            _task(subject, isolation, wanted, tries, into["seed"]),
            model=model,
            model_base_url=base_url,
            log_dir=str(log_dir),
            display="plain",
            max_samples=1,
            time_limit=int(deadline_s),
            fail_on_error=True,
        )
    except Exception as error:
        # Inspect has no public name for it: a package, or the key of an endpoint, is missing.
        if type(error).__name__ != "PrerequisiteError":
            raise
        raise RuntimeError(str(error)) from None
    if log.status != "success":
        raise RuntimeError(log.error.message if log.error is not None else log.status)
    for sample in sorted(log.samples or [], key=lambda one: one.epoch):
        [judged] = (sample.scores or {}).values()
        into["tries"].append(judged.metadata[_TRY])
        into["tools"].update(judged.metadata[_TOOLS])
