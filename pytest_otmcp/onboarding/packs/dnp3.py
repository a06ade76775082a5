"""Words and experiments for tools that speak DNP3."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ...protocols.dnp3 import oracle
from ..experimenter import Experimenter
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal
from ..status import reach

__all__ = ["PACK"]

_OUTSTATION = 10
_ANALOG, _ANALOGS = 1, 4
_BINARY, _BINARIES = 8, 8
"""The first of several inputs, and how many there are; none of them makes events."""
_OUTPUT = 2
_MISSING = 99
_VALUES = range(2000, 2**31)
"""Values that cannot be mistaken for an index, a count or a default."""
_ON_LINE = ["ONLINE"]

_DIRECTLY = re.compile(r"^(address|direct|index|point)$", re.IGNORECASE)
"""Names of the way in which a tool is told a point by outstation and index, beside an alias."""


async def _read_analog(experimenter: Experimenter, guess: Guess) -> Proposal:
    values = [experimenter.random.choice(_VALUES) for _ in range(_ANALOGS)]
    proposal = await _read(experimenter, guess, "analog_input", _ANALOG, values)
    if proposal.proven:
        experimenter.provoke(proposal, "illegal_address", **_at(_MISSING, 1))
    return proposal


async def _read_binary(experimenter: Experimenter, guess: Guess) -> Proposal:
    # Neither all on nor all off, as other lists of true and false in an answer may be.
    number = experimenter.random.randrange(1, 2**_BINARIES - 1)
    states = [bool(number >> place & 1) for place in range(_BINARIES)]
    return await _read(experimenter, guess, "binary_input", _BINARY, states)


async def _read(experimenter: Experimenter, guess: Guess, kind: str, first: int, values: Sequence[int]) -> Proposal:
    for index, value in enumerate(values, first):
        await experimenter.device.poke(point=oracle.point(kind, index), value=value)
    shown = await experimenter.call(guess, {}, **_at(first, len(values)))
    proven = oracle.reached(shown.entries, kind, first, len(values))
    proposal = experimenter.propose(guess, shown, proven=proven)
    experimenter.locate(proposal, "values", [*values])
    if proven:
        experimenter.locate_echo(proposal, "flags", [_ON_LINE] * len(values))
    return proposal


async def _write_binary(experimenter: Experimenter, guess: Guess) -> Proposal:
    on = await experimenter.call(guess, {}, outstation=_OUTSTATION, index=_OUTPUT, value=True)
    off = await experimenter.call(guess, {}, outstation=_OUTSTATION, index=_OUTPUT, value=False)
    proven = not any(
        oracle.exactly_one_operation(shown.entries, "binary", _OUTPUT, value)
        for shown, value in ((on, True), (off, False))
    )
    proposal = experimenter.propose(guess, on, proven=proven)
    if proven:
        experimenter.locate_echo(proposal, "value", True, also=(off, False))
        experimenter.provoke(proposal, "illegal_address", outstation=_OUTSTATION, index=_MISSING, value=True)
    return proposal


def _at(start: int, count: int) -> dict[str, object]:
    """Return the inputs that name points."""
    return {"outstation": _OUTSTATION, "start": start, "count": count}


PACK = Pack(
    protocol="dnp3",
    operations={
        "ping": Hints(
            likely="ping status health connection probe link",
            unlikely="read write list point points alias poll binary analog connect disconnect reconnect",
            needed="ping status health connection probe info check",
            experiment=reach,
        ),
        "read_binary": Hints(
            likely="read get binary inputs input points",
            unlikely="write set operate control output outputs analog counter counters alias list class",
            needed="read get",
            experiment=_read_binary,
            choice=re.compile(r"^(?!.*output).*binary", re.IGNORECASE),
        ),
        "read_analog": Hints(
            likely="read get analog inputs input points",
            unlikely="write set operate control output outputs binary counter counters alias list class",
            needed="read get",
            experiment=_read_analog,
            choice=re.compile(r"^(?!.*output).*analog", re.IGNORECASE),
        ),
        "write_binary": Hints(
            likely="write set operate control binary output",
            unlikely="read get analog alias list input inputs",
            needed="write set operate control latch",
            experiment=_write_binary,
            choice=_DIRECTLY,
        ),
        "poll": plain("poll class", r"(read|get|poll)_?(event_?)?class(_?(data|events))?|poll"),
        "read_alias": plain("alias", r"(read|get)_?(point_?by_?)?(alias|point)(_?value)?"),
        "write_alias": plain("alias", r"(write|set|operate)_?(point_?by_?)?(alias|point)(_?value)?"),
    },
    arguments={
        "outstation": "outstation_address outstation outstation_id link_address remote_address destination",
        "start": "start_index start first index start_address",
        "count": "count quantity num number length",
        "index": "index point_index point point_number",
        "value": "value state on data",
        "event_class": "event_class class_number class class_id point_class",
        "name": "alias name point",
    },
    names=("dnp3",),
    errors={
        "illegal_address": (r"(?i)parameter[ _]error|object[ _]unknown|IIN2\.[12]\b",),
    },
)
