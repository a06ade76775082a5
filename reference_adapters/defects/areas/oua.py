"""Defects that the checks of the area OUA notice."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from ...core import AdapterError, AdapterServer, BadReply, Call, Lost
from ...core.tools import AdapterTool
from ...opcua import status, tools, values
from ...opcua.link import NodeFacts
from ...opcua.services import Services
from ..defect import Change, Data, Defect, Handler, around, defect, failing, told, tools_of
from ..opcua import writes_status_and_timestamp
from ..refusals import bad_is_good, first_page

__all__ = ["DEFECTS"]

_READ, _WRITE, _CALL = "read_opcua_node", "write_opcua_node", "call_opcua_method"
_BROWSE, _ALL = "browse_opcua_node_children", "get_all_variables"
_NUMBERS = (*values._INTEGERS, *values._LARGEST)


def _written_otherwise(change: Any) -> Change:
    """Return the defect that a single value is written as another variant than the node's."""

    def apply(server: AdapterServer) -> None:
        genuine = Services.write

        async def write(services: Services, nodes: Sequence[ua.NodeId], variants: Sequence[ua.Variant]) -> Any:
            return await genuine(services, nodes, [one if one.is_array else change(one) for one in variants])

        Services.write = write

    return apply


def _double(variant: ua.Variant) -> ua.Variant:
    return ua.Variant(float(variant.Value), ua.VariantType.Double) if variant.VariantType in _NUMBERS else variant


def _number_first(variant: ua.Variant) -> ua.Variant:
    try:
        return ua.Variant(float(variant.Value), ua.VariantType.Double) if isinstance(variant.Value, str) else variant
    except ValueError:
        return variant


def _good(data: Data) -> Data:
    return {**data, "quality": "good", "status": "Good"}


def _severity(*names: str) -> Change:
    """Return the defect that the two severity bits mean these."""

    def apply(server: AdapterServer) -> None:
        def quality(code: ua.StatusCode) -> str:
            return str(names[code.value >> 30])

        for module in (status, tools):
            module.quality = quality

    return apply


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _printed(data: Data) -> Data:
    structure = isinstance(data["value"], dict)
    return {**data, "value": f"Range({data['value']!r})" if structure else data["value"]}


def _unchecked(value: Any, facts: NodeFacts, field: str) -> ua.Variant:
    """Return the variant of a single value whatever the node's rank is."""
    rank = facts.rank if isinstance(value, list) else -1
    return values.to_variant(value, facts.kind, rank, facts.dimensions, field)


def single_values_into_arrays(server: AdapterServer) -> None:
    tools._variant = _unchecked


def single_values_become_arrays(server: AdapterServer) -> None:
    genuine = tools._variant

    def variant(value: Any, facts: NodeFacts, field: str) -> ua.Variant:
        wrapped = [value] if facts.rank > 0 and not isinstance(value, list) else value
        return genuine(wrapped, facts, field)

    tools._variant = variant


def any_length(server: AdapterServer) -> None:
    def variant(value: Any, facts: NodeFacts, field: str) -> ua.Variant:
        return values.to_variant(value, facts.kind, facts.rank, (), field)

    tools._variant = variant


def points_left_open(server: AdapterServer) -> None:
    genuine = Services._turn_pages

    async def first_pages(services: Services, pages: Any, found: Any, fields: Sequence[str]) -> None:
        shown = [(index, dataclasses.replace(page, ContinuationPoint=None)) for index, page in pages]
        if any(page.ContinuationPoint for _, page in pages):
            services._call.extra["truncated"] = {"returned": len(pages[0][1].References), "total": None}
        await genuine(services, shown, found, fields)

    Services._turn_pages = first_pages


def browses_instead(*nodes: ua.NodeId) -> Change:
    """Return the defect that a node which the server does not have is browsed as if it were another one, or as one without children."""

    def apply(server: AdapterServer) -> None:
        genuine = Services.browse

        async def browse(services: Services, asked: Sequence[ua.NodeId], **options: Any) -> Any:
            try:
                return await genuine(services, asked, **options)
            except AdapterError as error:
                if error.code != "illegal_address":
                    raise
                return await genuine(services, nodes, **options) if nodes else [[]]

        Services.browse = browse

    return apply


def circles(levels: int) -> Change:
    """Return the defect that an enumeration visits a node as often as it is found, so many levels deep."""

    def apply(server: AdapterServer) -> None:
        perform = tools_of(server, _ALL)._perform
        # The adapter gives up well before the kit does, also on a machine that is slow.
        server._deadline_s = 2.0

        async def every_variable(services: Services, level: list[ua.NodeId]) -> list[Any]:
            found: list[Any] = []
            for _ in range(levels):
                pages = await services.browse(level, fields=[""], result=ua.BrowseResultMask.All)
                references = [one for page in pages for one in page if one.NodeId.NamespaceIndex]
                found += [one for one in references if one.NodeClass == ua.NodeClass.Variable]
                level = [one.NodeId for one in references if one.NodeClass == ua.NodeClass.Object]
                if not level:
                    break
            return found

        @around(_ALL)
        async def looping(genuine: Handler, call: Call, arguments: Any) -> Data:
            listed = await genuine(call, arguments)
            found = await perform(
                call, lambda services: every_variable(services, [ua.NodeId(ua.ObjectIds.ObjectsFolder)])
            )
            known = {variable["node_id"]: variable for variable in listed["variables"]}
            every = [known[one.NodeId.to_string()] for one in found if one.NodeId.to_string() in known]
            return {"variables": every, "count": len(every)}

        looping(server)

    return apply


def _checked(data: Data) -> Data:
    return {**data, "verified": True} if "verified" in data else data


async def _as_asked(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments)
    return {name: value for name, value in {**data, "value": arguments.value}.items() if name != "clamped"}


def clamping_is_hidden(server: AdapterServer) -> None:
    around(_WRITE)(_as_asked)(server)


def methods_pass_the_guard(server: AdapterServer) -> None:
    genuine = server._perform

    async def perform(tool: AdapterTool, call: Call, arguments: Any) -> Data:
        passed = dataclasses.replace(tool, writes=False) if tool.listing.name == _CALL else tool
        return await genuine(passed, call, arguments)

    server._perform = perform


def arguments_are_doubles(server: AdapterServer) -> None:
    genuine = tools._input_arguments

    def doubles(given: list[Any], inputs: list[NodeFacts]) -> list[ua.Variant]:
        return [_double(variant) for variant in genuine(given, inputs)]

    tools._input_arguments = doubles


def arguments_are_not_counted(server: AdapterServer) -> None:
    genuine = tools._input_arguments

    def uncounted(given: list[Any], inputs: list[NodeFacts]) -> list[ua.Variant]:
        return genuine(given[: len(inputs)], inputs[: len(given)])

    tools._input_arguments = uncounted


def calls_again(server: AdapterServer) -> None:
    genuine = Services._request

    async def request(services: Services, ask: Any, items: int, *, changes: bool = False) -> Any:
        try:
            return await genuine(services, ask, items, changes=changes)
        except (OSError, BadReply, Lost):
            services._call.writes_sent = 0
            raise Lost from None

    Services._request = request


def _denied_is_internal(call: Call, error: AdapterError) -> Exception | None:
    denied = error.code == "access_denied"
    return AdapterError("internal_error", "something went wrong", outcome="unknown") if denied else None


DEFECTS: tuple[Defect, ...] = (
    defect("MU-19", "opcua", "With writes disabled a method is called.", methods_pass_the_guard, "OUA-008"),
    defect(
        "MU-19b",
        "opcua",
        "Every number among a method's arguments is sent as Double.",
        arguments_are_doubles,
        "OUA-008",
    ),
    defect(
        "MU-19c",
        "opcua",
        "Arguments of a method that are missing or too many are not noticed.",
        arguments_are_not_counted,
        "OUA-008",
        "ERR-006 OUA-008",
    ),
    defect("MU-19d", "opcua", "A method whose answer was lost is called again.", calls_again, "OUA-008"),
    defect(
        "MU-80",
        "opcua",
        "Every number is written as Double, whatever the node's data type.",
        _written_otherwise(_double),
        "OUA-001 OUA-004",
    ),
    defect(
        "MU-80c",
        "opcua",
        "A text that looks like a number is written as one.",
        _written_otherwise(_number_first),
        "OUA-001",
    ),
    defect(
        "MU-81b",
        "opcua",
        "A value with a Bad status is a value; seen by the requirement suite.",
        bad_is_good,
        "OUA-002",
    ),
    defect(
        "MU-81c",
        "opcua",
        "A status code whose two highest bits are set is good.",
        _severity("good", "uncertain", "bad", "good"),
        "OUA-002",
    ),
    defect(
        "MU-81d",
        "opcua",
        "An Uncertain value is refused like a bad one.",
        _severity("good", "bad", "bad", "bad"),
        "OUA-002",
    ),
    defect("MU-81u", "opcua", "An Uncertain value is good.", told(_READ, change=_good), "OUA-002"),
    defect(
        "MU-82",
        "opcua",
        "The server's timestamp is the adapter's own time.",
        told(_READ, change=lambda data: {**data, "server_timestamp": _now()}),
        "OUA-003",
    ),
    defect(
        "MU-82b",
        "opcua",
        "A timestamp that the server does not give is the adapter's own time.",
        told(_READ, change=lambda data: {**data, "source_timestamp": data["source_timestamp"] or _now()}),
        "OUA-003",
    ),
    defect(
        "MU-82c",
        "opcua",
        "A structure is told as the text of a program's own object.",
        told(_READ, change=_printed),
        "OUA-003",
    ),
    defect(
        "MU-83w",
        "opcua",
        "A single value is written into an array.",
        single_values_into_arrays,
        "OUA-004",
        "ERR-006 OUA-004",
    ),
    defect(
        "MU-83b",
        "opcua",
        "A single value for an array becomes an array of one element.",
        single_values_become_arrays,
        "OUA-004",
    ),
    defect(
        "MU-83c",
        "opcua",
        "An array of any length is sent to a node with ArrayDimensions.",
        any_length,
        "OUA-004",
        "ERR-006 OUA-004",
    ),
    defect(
        "MU-84b",
        "opcua",
        "Of a long list of nodes there is the first page; seen by the requirement suite.",
        first_page,
        "OUA-006",
    ),
    defect(
        "MU-84m",
        "opcua",
        "The list of the children of a node that does not exist is empty.",
        browses_instead(),
        "OUA-006",
    ),
    defect(
        "MU-84o",
        "opcua",
        "In the place of a node that does not exist the Objects folder is browsed.",
        browses_instead(ua.NodeId(ua.ObjectIds.ObjectsFolder)),
        "OUA-006",
    ),
    defect(
        "MU-84c",
        "opcua",
        "A list says that it is a part, and its continuation point is left open.",
        points_left_open,
        "OUA-006",
    ),
    defect("MU-85", "opcua", "A circle of references is followed without end.", circles(1_000_000), "OUA-006"),
    defect(
        "MU-85b",
        "opcua",
        "A variable is listed as often as it is found in a circle of references, 20 levels deep.",
        circles(20),
        "OUA-006",
    ),
    defect(
        "MU-87",
        "opcua",
        "A Write that is not complete yet is told as checked.",
        told(_WRITE, change=_checked),
        "OUA-007",
    ),
    defect(
        "MU-87b",
        "opcua",
        "A value that the server has clamped is told as the one that was asked for.",
        clamping_is_hidden,
        "OUA-007",
    ),
    defect(
        "MU-129b",
        "opcua",
        "BadUserAccessDenied is an internal error.",
        failing(_WRITE, change=_denied_is_internal),
        "OUA-005",
        "ERR-001 ERR-006 OUA-005",
    ),
    defect(
        "MU-129c",
        "opcua",
        "A status and a SourceTimestamp are written with every value; seen by the requirement suite.",
        writes_status_and_timestamp,
        "OUA-005",
    ),
)
