"""MCP over HTTP: who calls, for subjects that have a launch for callers with tokens. The kit is the issuer of the tokens."""

from __future__ import annotations

from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.protocol import TOKENS
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Guise, Rig

from .fenced import written
from .steps import citing, it_answers, nothing_arrived, since, some_read, some_write, witness

__all__ = ["TASKS"]

TASKS = Checks()

_UNKNOWN: dict[Guise, str] = {
    "nobody": "a caller without a token",
    "garbage": "a token that is none",
    "unsigned": "a token without a signature",
    "other_key": "a token that is signed with an unknown key",
    "other_issuer": "a token of another issuer",
    "other_audience": "a token for another server",
    "no_audience": "a token that is for no server",
    "expired": "a token that is over",
}
_UNAUTHORIZED, _FORBIDDEN = "unauthorized", "forbidden"


@TASKS.every_protocol("MCP-011", "Over HTTP nobody is served without a token for it.", reads=False, launch=TOKENS)
async def only_known_callers_are_served(run: Repetition, at: Rig, tokens: Rig) -> None:
    """Through an adapter over HTTP that was told an issuer of tokens: write with a good one; without any, and with tokens that are not to be
    believed; where the subject tells such callers apart, read and write with one that may only read; write from a web page of another origin;
    write with a good one. A subject without a write is asked for reads.

    Said: success; refusals, by HTTP status 401, and 403 for the web page; success.
    Seen: the writes of the good token, and no other.
    Why: a server on a port is everybody's who reaches it, web pages included; a token that was made for another server is one that the other
        server can use here.
    """
    await _is_served(run, tokens)
    for guise, what in _UNKNOWN.items():
        await _is_refused(run, tokens, guise, what, _UNAUTHORIZED)
    if tokens.subject.scopes.reads is not None:
        await tokens.session.disguise("reader")
        await it_answers(run, tokens, requirement="MCP-011")
        if some_write(run, tokens) is not None:
            await _is_refused(run, tokens, "reader", "a token whose scopes do not allow it", None)
    await _is_refused(run, tokens, "web_page", "a web page of another origin", _FORBIDDEN)
    if await tokens.session.listens_beyond():
        message = (
            f"{tokens.protocol}: the server should listen at the address of its URL alone, it listens at every one"
        )
        finding = Finding(code="listens_everywhere", message=message, requirement="MCP-011", strength="SHOULD")
        run.witnessed([finding])
    await _is_served(run, tokens)


async def _is_served(run: Repetition, at: Rig) -> None:
    await at.session.disguise("writer")
    if (asked := some_write(run, at)) is None:
        await it_answers(run, at, requirement="MCP-011")
    else:
        await written(run, at, asked, requirement="MCP-011")


async def _is_refused(run: Repetition, at: Rig, guise: Guise, what: str, status: str | None) -> None:
    asked = some_write(run, at) or some_read(run, at)
    if asked is None:
        run.not_applicable("the subject has no operation with which it could be asked")
    for poke in asked.pokes:
        await at.device.poke(**poke)
    before: Any = await at.device.image()
    await at.session.disguise(guise)
    reply = await at.call(asked.operation, **asked.inputs)
    await at.session.disguise("writer")
    if reply.success:
        message = f"{reply.label}: {what} should have been refused, the adapter said success"
        run.judge(reply, [Finding(code="stranger_served", message=message, requirement="MCP-011")])
        return
    run.witnessed(nothing_arrived(at, since(reply, await at.journal()), requirement="MCP-011"))
    run.witnessed(citing("MCP-011", witness(at).holds(await at.device.image(), _held(before, asked))))
    if status is not None and reply.exchange.failure != status:
        wanted = 401 if status == _UNAUTHORIZED else 403
        message = f"{reply.label}: {what} should have been refused by HTTP status {wanted}"
        finding = Finding(code="other_status", message=message, requirement="MCP-011", strength="SHOULD")
        run.judge(reply, [finding])
    else:
        run.judge(reply, [])


def _held(before: Any, asked: Asked) -> dict[str, object]:
    return {point: before["points"][point] for point in asked.points if point in before["points"]}
