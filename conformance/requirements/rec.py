"""REC: outages and return."""

from __future__ import annotations

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import Image
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

__all__ = ["TASKS"]

TASKS = Checks()

# -- REC-006 ------------------------------------------------------------------------------------------------

_TEMPERATURE = "ns=2;s=Temperature"
_LOSSES, _CLOSED = 20, 6
"""The number of losses, and how many of them, at first, are sessions that the server closes; that closes those left behind as well."""
_IN_PASSING = 2
"""Sessions that an adapter may still be closing while it has opened another one."""


@TASKS.check(
    "REC-006",
    "A session that the server has closed is made anew, and none is left behind.",
    needs="opcua.read opcua.recovery",
)
async def lost_sessions_are_made_anew(run: Repetition, opcua: Rig) -> None:
    """Read twenty times, each time after a loss: the server has closed the session, answers that it does not know the secure channel, or
    ends the connection. Read after it was restarted.

    Said: success within the time to come back, each time in the same session of the assistant.
    Seen: the server has no more sessions in the end than in the beginning.
    Why: a server has few sessions; an adapter that leaves one behind at every loss locks out the operators' own screens.
    """
    if not opcua.reconnects:
        run.not_applicable("the adapter is not said to connect again by itself")
    last = await opcua.call("read", node=_TEMPERATURE)
    run.must_succeed(last)
    before = _sessions(await opcua.image())
    for loss in range(_LOSSES):
        if loss < _CLOSED:
            await opcua.poke(sessions="closed")
        else:
            action = {"service_fault": "BadSecureChannelIdInvalid"} if loss % 2 else {"close": True}
            await opcua.fault({"service": "Read", "times": 1, "action": action})
        last = await _answered_again(run, opcua, last)
        if not last.success:
            return
    run.witnessed(_none_left_behind(before, _sessions(await opcua.image()), f"{_LOSSES} losses"))
    await opcua.stop_device()
    await opcua.start_device()
    await _answered_again(run, opcua, last)
    run.witnessed(_none_left_behind(before, _sessions(await opcua.image()), "a restart"))


async def _answered_again(run: Repetition, opcua: Rig, last: Reply) -> Reply:
    """Read until it succeeds, at most for as long as the subject declares after the last answer; return the reply."""
    since_accepting_s = ((last.exchange.received_ns or 0) - opcua.accepting_ns) / 1e9 / run.time_scale
    window_s = max(0.0, since_accepting_s) + opcua.recovery_s
    replies = await opcua.call_until_success("read", window_s=window_s, node=_TEMPERATURE)
    run.succeeds(replies[-1], requirement="REC-006")
    return replies[-1]


def _sessions(image: Image) -> int:
    return int(image["clients"]["sessions"])


def _none_left_behind(before: int, after: int, what: str) -> list[Finding]:
    if after <= before + _IN_PASSING:
        return []
    message = f"after {what} the adapter should have the sessions of the beginning, {before}; the server has {after}"
    return [Finding(code="connections_left", message=message, requirement="REC-006")]
