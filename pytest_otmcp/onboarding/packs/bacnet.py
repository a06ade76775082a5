"""Words and experiments for tools that speak BACnet/IP."""

from __future__ import annotations

import re

from ...protocols.bacnet import oracle
from ...protocols.bacnet.entries import Target
from ..experimenter import Experimenter
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal
from ..status import reach

__all__ = ["PACK"]

_DEVICE = 12345
_INPUT: Target = ("analog-input", 1)
_OUTPUT: Target = ("analog-output", 1)
_MISSING: Target = ("analog-input", 77)
_PRIORITY = 8
_VALUES = range(2000, 20000)
"""Present values in halves, which a REAL holds exactly, and which cannot be mistaken for an instance, a priority or a default."""

_DIRECTLY = re.compile(r"^(address|direct|object|device)$", re.IGNORECASE)
"""Names of the way in which a tool is told an object by type and instance, beside an alias."""


async def _read(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = experimenter.random.choice(_VALUES) + 0.5
    await experimenter.device.poke(object=f"{_INPUT[0]},{_INPUT[1]}", value=value)
    shown = await experimenter.call(guess, {}, **_at(_INPUT))
    proven = oracle.reached(shown.entries, _INPUT)
    proposal = experimenter.propose(guess, shown, proven=proven)
    experimenter.locate(proposal, "value", value)
    if proven:
        experimenter.provoke(proposal, "illegal_address", **_at(_MISSING))
    return proposal


async def _write(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = experimenter.random.choice(_VALUES) + 0.5
    shown = await experimenter.call(guess, {}, **_at(_OUTPUT), value=value, priority=_PRIORITY)
    proven = not oracle.exactly_one_write(shown.entries, _OUTPUT, "real", value)
    proposal = experimenter.propose(guess, shown, proven=proven)
    if proven:
        experimenter.locate_echo(proposal, "value", value)
        experimenter.provoke(proposal, "not_writable", **_at(_INPUT), value=value, priority=_PRIORITY)
    # A command is given back, or the object would stay overridden for the experiments that follow.
    await experimenter.device.poke(object=f"{_OUTPUT[0]},{_OUTPUT[1]}", value=None, priority=_PRIORITY)
    return proposal


def _at(target: Target) -> dict[str, object]:
    """Return the inputs that name an object."""
    return {"device": _DEVICE, "type": target[0], "instance": target[1]}


PACK = Pack(
    protocol="bacnet",
    operations={
        "ping": Hints(
            likely="ping status health connection probe info",
            unlikely="read write list discover whois alias object property command subscribe",
            needed="ping status health connection probe info check",
            experiment=reach,
        ),
        "read": Hints(
            likely="read get property present value object",
            unlikely="write set alias multiple range file list schedule trend alarm cov",
            needed="read get",
            experiment=_read,
            choice=_DIRECTLY,
        ),
        "write": Hints(
            likely="write set property present value object",
            unlikely="read get alias multiple list",
            needed="write set",
            experiment=_write,
            choice=_DIRECTLY,
        ),
        "discover": plain("discover devices who is", r"discover(_?devices)?|who_?is"),
        "list_objects": plain("list objects", r"(list|read|get)_?objects?(_?list)?"),
        "read_alias": plain("alias", r"(read|get)_?(object_?by_?)?(alias|point)(_?value)?"),
        "write_alias": plain("alias", r"(write|set)_?(object_?by_?)?(alias|point)(_?value)?"),
    },
    arguments={
        "device": "device_id device_instance device deviceid",
        "type": "object_type obj_type objecttype type obj",
        "instance": "object_instance instance obj_instance objectinstance instance_number object_id",
        "priority": "priority write_priority",
        "name": "alias name point",
    },
    constants={
        r"^(property|property_id|property_identifier|prop|property_name)$": "present-value",
        # What other protocols call the address of a register is a device's here.
        r"^(address|device_address)$": "{host}:{port}",
    },
    names=("bacnet", "bacnet-ip", "bacnet_ip", "bacnetip"),
    errors={
        "illegal_address": (r"(?i)unknown[-_ ]?(object|property)",),
        "not_writable": (r"(?i)write[-_]access[-_]denied",),
    },
)
