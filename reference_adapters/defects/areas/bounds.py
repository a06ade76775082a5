"""Defects of adapters that have a list of targets and limits, which the checks of WR-006 and WR-007 notice."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from pydantic import create_model

from ...core import AdapterError, AdapterServer, Call
from ...core import bounds as core_bounds
from ...mqtt import tools as mqtt_tools
from ..defect import Change, Data, Defect, Handler, around, defect, wrap
from .further import module_of

__all__ = ["DEFECTS"]

_Pair = tuple[str, object]


def _said(*names: str, change: Callable[[Any, tuple[_Pair, ...]], Iterable[_Pair]]) -> Change:
    """Return the defect that these tools, or all, say something else of what they change, made from arguments and targets."""

    @around(*names)
    async def saying(genuine: Handler, call: Call, arguments: Any) -> Data:
        changes = call.changes
        call.changes = lambda *targets: changes(*change(arguments, targets))
        data = await genuine(call, arguments)
        return data

    return saying


def _unbounded(*names: str) -> Change:
    """Return the defect that list and limits do not hold for these tools."""
    return _said(*names, change=lambda arguments, targets: ())


_first_alone = partial(_said, change=lambda arguments, targets: targets[:1])


def _as_a_word(server: AdapterServer) -> None:
    module_of("s7", "tools")._address = lambda variable: f"DB{variable.db}.DBW{variable.byte}"


def _globs(server: AdapterServer) -> None:
    core_bounds.covers = lambda pattern, target: fnmatch.fnmatch(target, pattern)


def _opened_by_an_argument(tool: str) -> Change:
    """Return the defect that the tool takes ``force``, and the list does not hold then."""

    def apply(server: AdapterServer) -> None:
        genuine = server._tools[tool]
        fields: dict[str, Any] = {"force": (bool, False), "override": (bool, False)}
        model = create_model(genuine.model.__name__, __base__=genuine.model, **fields)

        def opened(handler: Handler) -> Handler:
            async def forced(call: Call, arguments: Any) -> Data:
                if arguments.force:
                    call._bounds = None
                data: Data = await handler(call, arguments)
                return data

            return forced

        wrap(server, tool, opened, model=model)

    return apply


def _one_after_the_other(tool: str, items: str, told: str) -> Change:
    """Return the defect that a batch with a forbidden item is written item by item, until it comes to that one.

    Args:
        items: the argument that is the batch.
        told: the member of ``data`` that has the results.
    """

    @around(tool)
    async def singly(genuine: Handler, call: Call, arguments: Any) -> Data:
        batch = getattr(arguments, items)
        try:
            data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "access_denied" or len(batch) == 1:
                raise
            parts = [await genuine(call, arguments.model_copy(update={items: [item]})) for item in batch]
            data = {told: [result for part in parts for result in part[told]]}
        return data

    return singly


def _without(*members: str) -> Change:
    """Return the defect that these limits are not looked at."""

    def apply(server: AdapterServer) -> None:
        if server._bounds is not None:
            changes = dict.fromkeys(members)
            limits = server._bounds._limits
            server._bounds._limits = {name: one.model_copy(update=changes) for name, one in limits.items()}

    return apply


def _what_is_no_number_passes(server: AdapterServer) -> None:
    genuine = core_bounds._within

    def within(target: str, value: Any, *rest: Any) -> float:
        # No comparison with it is true.
        return value if isinstance(value, float) and math.isnan(value) else genuine(target, value, *rest)

    core_bounds._within = within
    assert mqtt_tools._number(b"NaN") is not None


def _clamped(server: AdapterServer) -> None:
    """Write the highest number, where a higher one is asked for, and tell that as done."""
    services = module_of("opcua", "services").Services
    genuine = services.write

    async def write(self: Any, nodes: Any, values: Any) -> Any:
        limits = {} if self._call._bounds is None else self._call._bounds._limits
        for node, value in zip(nodes, values, strict=True):
            limit = limits.get(node.to_string())
            if limit is not None and limit.highest is not None and isinstance(value.Value, float):
                value.Value = min(value.Value, limit.highest)
        return await genuine(self, nodes, values)

    services.write = write


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-22",
        "modbus",
        "Of a range that is to be written the first register alone must be allowed.",
        _first_alone("write_registers", "write_coils_bulk"),
        "WR-006",
    ),
    defect(
        "MU-22f",
        "modbus",
        "The argument force opens the list of registers that may be written.",
        _opened_by_an_argument("write_register"),
        "WR-006",
    ),
    defect("MU-22q", "mqtt", "A star in the list of topics stands for several levels.", _globs, "WR-006"),
    defect(
        "MU-22k",
        "s7",
        "Every value counts as the word that begins where it does, a DINT as well.",
        _as_a_word,
        "WR-006 WR-007",
    ),
    defect(
        "MU-22ei",
        "ethernetip",
        "Of elements that are to be written the first alone must be allowed.",
        _first_alone("write_array"),
        "WR-006",
    ),
    defect(
        "MU-22bac",
        "bacnet",
        "An alias writes an object that is not on the list.",
        _unbounded("write_object_by_alias"),
        "WR-006",
    ),
    defect(
        "MU-22dnp",
        "dnp3",
        "List and limits hold for points by index, and not for those by alias.",
        _unbounded("write_point_by_alias"),
        "WR-006 WR-007",
    ),
    defect(
        "MU-22dp",
        "profibus",
        "List and limits hold for outputs by alias, and not for those of a whole slave.",
        _unbounded("write_outputs"),
        "WR-006",
    ),
    defect(
        "MU-22pn",
        "profinet",
        "List and limits hold for values by alias, and not for whole records.",
        _unbounded("write_record"),
        "WR-006",
    ),
    defect(
        "MU-23",
        "opcua",
        "Of a batch the nodes before a forbidden one are written.",
        _one_after_the_other("write_multiple_opcua_nodes", "items", "items"),
        "WR-006",
    ),
    defect(
        "MU-23ei",
        "ethernetip",
        "Of a batch the tags before a forbidden one are written.",
        _one_after_the_other("write_multiple_tags", "payloads", "tags"),
        "WR-006",
    ),
    defect(
        "MU-24c",
        "modbus",
        "The limit of a register is compared with a tag's value before it is scaled.",
        _said("write_tag", change=lambda asked, targets: [(target, asked.value) for target, _ in targets]),
        "WR-007",
    ),
    defect("MU-24q", "mqtt", "NaN is within every limit.", _what_is_no_number_passes, "WR-007"),
    defect("MU-24s", "opcua", "A value may leap, whatever the largest step is.", _without("step"), "WR-007"),
    defect(
        "MU-24r",
        "s7",
        "Values may be written as fast as they come, whatever time has to lie between two.",
        _without("every_s"),
        "WR-007",
    ),
    defect("MU-24o", "opcua", "A value above the highest is written as the highest.", _clamped, "WR-007"),
    defect(
        "MU-24dp", "profibus", "The lowest value of a slave's output is not looked at.", _without("lowest"), "WR-007"
    ),
)
