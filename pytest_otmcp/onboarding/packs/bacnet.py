"""Words and experiments for tools that speak BACnet/IP."""

from __future__ import annotations

import random
import re

from ...protocols.bacnet import calls
from ...protocols.bacnet.points import PRIORITY, VALVE, ZONE, setting, value_of
from ..experiments import reading, writing
from ..pack import Hints, Pack, plain
from ..status import reach

__all__ = ["PACK"]

_VALUES = range(2000, 20000)
"""Present values in halves, which a REAL holds exactly, and which cannot be mistaken for an instance, a priority or a default."""
_ZONE, _VALVE = value_of(ZONE), value_of(VALVE)

_DIRECTLY = re.compile(r"^(address|direct|object|device)$", re.IGNORECASE)
"""Names of the way in which a tool is told an object by type and instance, beside an alias."""


def _half(rng: random.Random) -> float:
    return rng.choice(_VALUES) + 0.5


_read = reading(lambda rng: _ZONE.read(_half(rng)), calls.reached, missing=value_of(("analog-input", 77)).reads())
_write = writing(
    lambda rng: _VALVE.write(_half(rng)),
    calls.one_write,
    refused=("not_writable", _ZONE.writes(2000.5)),
    # A command is given back, or the object would stay overridden for the experiments that follow.
    after=setting(VALVE, None, PRIORITY),
)


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
