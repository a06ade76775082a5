"""KEY: secrets, which the kit plants in the adapter's environment and looks for in everything that the adapter says."""

from __future__ import annotations

from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from .provoked import UNKNOWN_ARGUMENT, refused_by_the_device
from .steps import a_read_works, answers_again, exercise, faulty, reset

__all__ = ["TASKS"]

TASKS = Checks()


@TASKS.every_protocol("KEY-001", "No secret is in anything that the adapter says.")
async def no_secret_is_told(run: Repetition, at: Rig) -> None:
    """Read; read with an argument too many, while the device refuses it, and while the device resets the connection; where the device
    knows accounts, while it refuses the adapter's; start the adapter while its device is down, and read; read again.

    Said: success, then failures in whatever words; none of the secrets that the adapter was given, in no message, on no line of
        standard error, in the arguments of no process, however it is written.
    Seen: the reads, and the refusals.
    Why: what an assistant has read is in its context, in the logs of its provider, and in what it tells the next person.
    """
    await a_read_works(run, at)
    asked = exercise(at).read(run.rng)
    if at.arguments_of(asked.operation, **asked.inputs) is not None:
        await at.call_altered(asked.operation, Alteration(given={UNKNOWN_ARGUMENT: 7}), role="control", **asked.inputs)
    await refused_by_the_device(run, at)
    await _lose_the_connection(run, at)
    if at.subject.reconnects:
        await _start_without_the_device(run, at)
    await a_read_works(run, at)


async def _lose_the_connection(run: Repetition, at: Rig) -> None:
    """Read while the device resets the connection, and refuses the account of the adapter that connects again."""
    asks = exercise(at)
    await at.device.fault(*({**rule, "times": 1} for rule in faulty(asks.reads, **reset(at))), *asks.unauthorised)
    for _ in range(2 if asks.unauthorised else 1):
        asked = asks.read(run.rng)
        await at.call(asked.operation, role="control", **asked.inputs)
    await at.device.fault()
    await answers_again(run, at)


async def _start_without_the_device(run: Repetition, at: Rig) -> None:
    asked = exercise(at).read(run.rng)
    await at.stop_device()
    await at.fresh_session()
    await at.call(asked.operation, role="control", **asked.inputs)
    await at.start_device()
    await answers_again(run, at)
