"""Words and experiments for tools that speak EtherNet/IP."""

from __future__ import annotations

import re
from dataclasses import replace

from ...protocols.ethernetip import calls
from ...protocols.ethernetip.points import ARRAY, ELEMENT, TARGET, array, tag
from ..evidence import beyond
from ..experimenter import Experimenter
from ..experiments import reading, writing
from ..guess import Guess
from ..pack import Hints, Pack, plain
from ..proposal import Proposal
from ..status import reach

__all__ = ["PACK"]

_ARRAY = array(0, 4)
_VALUES, _ELEMENT_VALUES = range(2000, 2**31), range(2000, 2**15)
"""Values that cannot be mistaken for a number of elements or a default."""

_SINGLE = re.compile(r"^(tag|single|one)$", re.IGNORECASE)
"""Names of the way in which a tool is told one tag by its name, beside an alias and a list."""


async def _read_array(experimenter: Experimenter, guess: Guess) -> Proposal:
    asked = _ARRAY.read([experimenter.random.choice(_ELEMENT_VALUES) for _ in range(4)])
    proposal = await reading(lambda rng: replace(asked, outputs={}), calls.reached)(experimenter, guess)
    # Of one element a tool may give the value itself in the place of a list.
    alone = await experimenter.call(guess, {}, **array(0, 1).reads().inputs)
    values = asked.outputs["values"]
    experimenter.locate(proposal, "values", values, also=(alone, values[:1]))
    return proposal


_read_tag = reading(
    lambda rng: TARGET.read(rng.choice(_VALUES)),
    calls.reached,
    echoes={"data_type": "DINT"},
    missing=tag("NoSuchTag").reads(),
)
_write_tag = writing(
    lambda rng: TARGET.write(rng.choice(_VALUES)),
    calls.one_write,
    refused=("range_overflow", tag(f"{ARRAY}[0]", ELEMENT).writes(70000)),
)


PACK = Pack(
    protocol="ethernetip",
    operations={
        "ping": Hints(
            likely="ping health probe identity controller",
            unlikely="read write list tag tags alias time connect disconnect reconnect",
            needed="ping status health connection probe info identity check",
            experiment=reach,
        ),
        "read_tag": Hints(
            likely="read get tag value",
            unlikely="write set alias array multiple list time info string batch",
            needed="read get",
            experiment=_read_tag,
            choice=_SINGLE,
        ),
        "read_array": Hints(
            likely="read get array tag elements values",
            unlikely="write set alias list time info string batch",
            needed="read get",
            experiment=_read_array,
            choice=re.compile(r"^(array|tag|single|one)$", re.IGNORECASE),
        ),
        "write_tag": Hints(
            likely="write set tag value",
            unlikely="read get alias array multiple list time string batch",
            needed="write set",
            experiment=_write_tag,
            choice=_SINGLE,
        ),
        "write_array": plain("array", r"write_?(tag_?)?array"),
        "read_tags": plain("tags multiple", r"(read|get)_?(multiple|many|batch)_?tags?|read_?tags_?batch"),
        "write_tags": plain("tags multiple", r"write_?(multiple|many|batch)_?tags?|write_?tags_?batch"),
        "list_tags": plain("list tags", r"(get|read|list)_?(plc_?|controller_?)?tags?(_?list)?"),
        "read_alias": plain("alias", r"(read|get)_?(tag_?by_?)?alias(_?value)?"),
        "write_alias": plain("alias", r"(write|set)_?(tag_?by_?)?alias(_?value)?"),
        "read_clock": plain("time clock", r"(read|get)_?(plc_?|controller_?)?(time|clock)"),
        "set_clock": plain("time clock", r"(write|set)_?(plc_?|controller_?)?(time|clock)"),
    },
    arguments={
        "tag": "tag_name tag tagname name address",
        "type": "data_type type datatype dtype tag_type",
        "count": "count elements element_count length num_elements size",
        "values": "values value data",
        "tags": "tags tag_names names",
        "items": "items payloads writes tags",
        "program": "program program_name scope",
        "name": "alias alias_name name",
        "time": "time plc_time datetime timestamp",
    },
    lists=frozenset({"values", "tags", "items"}),
    constants={r"^(slot|cpu_slot|processor_slot)$": 0},
    names=("ethernetip", "enip", "ethernet-ip", "ethernet_ip", "eip", "cip", "logix"),
    errors={
        "illegal_address": (
            r"(?i)path (segment error|destination unknown)|destination unknown|tag [^\n]{0,80}(not found|does(n't| not) exist)",
        ),
        "range_overflow": (beyond("does not fit", "overflow", "format requires"),),
    },
)
