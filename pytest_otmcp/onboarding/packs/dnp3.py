"""Words and experiments for tools that speak DNP3."""

from __future__ import annotations

import random
import re

from ...protocols.dnp3 import calls
from ...protocols.dnp3.points import analog, latch, several
from ...protocols.exercise import Asked
from ..experimenter import Experimenter
from ..experiments import reading
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal
from ..status import reach

__all__ = ["PACK"]

_ANALOG, _BINARY = several("analog", 1, 4), several("binary", 8, 8)
"""Inputs that make no events."""
_OUTPUT = 2
_MISSING = 99
_VALUES = range(2000, 2**31)
"""Values that cannot be mistaken for an index, a count or a default."""
_ON_LINE = ["ONLINE"]

_DIRECTLY = re.compile(r"^(address|direct|index|point)$", re.IGNORECASE)
"""Names of the way in which a tool is told a point by outstation and index, beside an alias."""


def _states(rng: random.Random) -> Asked:
    # Neither all on nor all off, as other lists of true and false in an answer may be.
    number = rng.randrange(1, 2**8 - 1)
    return _BINARY.read([bool(number >> place & 1) for place in range(8)])


_read_analog = reading(
    lambda rng: _ANALOG.read([rng.choice(_VALUES) for _ in range(4)]),
    calls.reached,
    echoes={"flags": [_ON_LINE] * 4},
    missing=analog(_MISSING).reads(),
)
_read_binary = reading(_states, calls.reached, echoes={"flags": [_ON_LINE] * 8})


async def _write_binary(experimenter: Experimenter, guess: Guess) -> Proposal:
    commands = [latch(_OUTPUT).write(value) for value in (True, False)]
    on, off = [await experimenter.call(guess, {}, **asked.inputs) for asked in commands]
    proven = not any(
        calls.one_write(shown.entries, {}, asked) for shown, asked in zip((on, off), commands, strict=True)
    )
    proposal = experimenter.propose(guess, on, proven=proven)
    if proven:
        experimenter.locate_echo(proposal, "value", True, also=(off, False))
        experimenter.provoke(proposal, "illegal_address", **latch(_MISSING).writes(True).inputs)
    return proposal


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
