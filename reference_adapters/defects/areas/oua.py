"""Defects that the checks of the area OUA notice."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from ...core import AdapterError, AdapterServer, Call
from ...core.tools import AdapterTool
from ...opcua import status, tools, values
from ...opcua.link import LostError, NodeFacts
from ...opcua.services import Services
from ..mutant import Bend, Data, Handler, Mutant, failing, told, wrap
from ..opcua import writes_status_and_timestamp
from ..refusals import bad_is_good, first_page

__all__ = ["MUTANTS"]

_READ, _WRITE, _CALL = "read_opcua_node", "write_opcua_node", "call_opcua_method"
_BROWSE, _ALL = "browse_opcua_node_children", "get_all_variables"
_NUMBERS = (*values._INTEGERS, *values._LARGEST)


def _written_otherwise(change: Any) -> Bend:
    """Return the defect that a single value is written as another variant than the node's."""

    def bend(server: AdapterServer) -> None:
        genuine = Services.write

        async def write(services: Services, nodes: Sequence[ua.NodeId], variants: Sequence[ua.Variant]) -> Any:
            return await genuine(services, nodes, [one if one.is_array else change(one) for one in variants])

        Services.write = write

    return bend


def _double(variant: ua.Variant) -> ua.Variant:
    return ua.Variant(float(variant.Value), ua.VariantType.Double) if variant.VariantType in _NUMBERS else variant


def _number_first(variant: ua.Variant) -> ua.Variant:
    try:
        return ua.Variant(float(variant.Value), ua.VariantType.Double) if isinstance(variant.Value, str) else variant
    except ValueError:
        return variant


def _good(data: Data) -> Data:
    return {**data, "quality": "good", "status": "Good"}


def _severity(*names: str) -> Bend:
    """Return the defect that the two severity bits mean these."""

    def bend(server: AdapterServer) -> None:
        def quality(code: ua.StatusCode) -> str:
            return str(names[code.value >> 30])

        for module in (status, tools):
            module.quality = quality

    return bend


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


def browses_instead(*nodes: ua.NodeId) -> Bend:
    """Return the defect that a node which the server does not have is browsed as if it were another one, or as one without children."""

    def bend(server: AdapterServer) -> None:
        genuine = Services.browse

        async def browse(services: Services, asked: Sequence[ua.NodeId], **options: Any) -> Any:
            try:
                return await genuine(services, asked, **options)
            except AdapterError as error:
                if error.code != "illegal_address":
                    raise
                return await genuine(services, nodes, **options) if nodes else [[]]

        Services.browse = browse

    return bend


def circles(levels: int) -> Bend:
    """Return the defect that an enumeration visits a node as often as it is found, so many levels deep."""

    def bend(server: AdapterServer) -> None:
        perform = server._tools[_ALL].handler.__self__._perform
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

        def looping(genuine: Handler) -> Handler:
            async def handler(call: Call, arguments: Any) -> Data:
                listed = await genuine(call, arguments)
                found = await perform(
                    call, lambda services: every_variable(services, [ua.NodeId(ua.ObjectIds.ObjectsFolder)])
                )
                known = {variable["node_id"]: variable for variable in listed["variables"]}
                every = [known[one.NodeId.to_string()] for one in found if one.NodeId.to_string() in known]
                return {"variables": every, "count": len(every)}

            return handler

        wrap(server, _ALL, looping)

    return bend


def _checked(data: Data) -> Data:
    return {**data, "verified": True} if "verified" in data else data


def _as_asked(genuine: Handler) -> Handler:
    async def handler(call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        return {name: value for name, value in {**data, "value": arguments.value}.items() if name != "clamped"}

    return handler


def clamping_is_hidden(server: AdapterServer) -> None:
    wrap(server, _WRITE, _as_asked)


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
        except LostError as lost:
            raise LostError(lost.error, sent=False) from None

    Services._request = request


def _denied_is_internal(call: Call, error: AdapterError) -> Exception | None:
    denied = error.code == "access_denied"
    return AdapterError("internal_error", "something went wrong", outcome="unknown") if denied else None


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-19",
        protocol="opcua",
        sentence="With writes disabled a method is called.",
        bend=methods_pass_the_guard,
        items="OUA-008.opcua",
        requirements="OUA-008",
        areas="oua",
    ),
    Mutant(
        id="MU-19b",
        protocol="opcua",
        sentence="Every number among a method's arguments is sent as Double.",
        bend=arguments_are_doubles,
        items="OUA-008.opcua",
        requirements="OUA-008",
        areas="oua",
    ),
    Mutant(
        id="MU-19c",
        protocol="opcua",
        sentence="Arguments of a method that are missing or too many are not noticed.",
        bend=arguments_are_not_counted,
        items="OUA-008.opcua",
        requirements="ERR-006 OUA-008",
        areas="oua",
    ),
    Mutant(
        id="MU-19d",
        protocol="opcua",
        sentence="A method whose answer was lost is called again.",
        bend=calls_again,
        items="OUA-008.opcua",
        requirements="OUA-008",
        areas="oua",
    ),
    Mutant(
        id="MU-80",
        protocol="opcua",
        sentence="Every number is written as Double, whatever the node's data type.",
        bend=_written_otherwise(_double),
        items="OUA-001.opcua OUA-004.opcua",
        requirements="OUA-001 OUA-004",
        areas="oua",
    ),
    Mutant(
        id="MU-80c",
        protocol="opcua",
        sentence="A text that looks like a number is written as one.",
        bend=_written_otherwise(_number_first),
        items="OUA-001.opcua",
        requirements="OUA-001",
        areas="oua",
    ),
    Mutant(
        id="MU-81b",
        protocol="opcua",
        sentence="A value with a Bad status is a value; seen by the requirement suite.",
        bend=bad_is_good,
        items="OUA-002.opcua",
        requirements="OUA-002",
        areas="oua",
    ),
    Mutant(
        id="MU-81c",
        protocol="opcua",
        sentence="A status code whose two highest bits are set is good.",
        bend=_severity("good", "uncertain", "bad", "good"),
        items="OUA-002.opcua",
        requirements="OUA-002",
        areas="oua",
    ),
    Mutant(
        id="MU-81d",
        protocol="opcua",
        sentence="An Uncertain value is refused like a bad one.",
        bend=_severity("good", "bad", "bad", "bad"),
        items="OUA-002.opcua",
        requirements="OUA-002",
        areas="oua",
    ),
    Mutant(
        id="MU-81u",
        protocol="opcua",
        sentence="An Uncertain value is good.",
        bend=told(_READ, change=_good),
        items="OUA-002.opcua",
        requirements="OUA-002",
        areas="oua",
    ),
    Mutant(
        id="MU-82",
        protocol="opcua",
        sentence="The server's timestamp is the adapter's own time.",
        bend=told(_READ, change=lambda data: {**data, "server_timestamp": _now()}),
        items="OUA-003.opcua",
        requirements="OUA-003",
        areas="oua",
    ),
    Mutant(
        id="MU-82b",
        protocol="opcua",
        sentence="A timestamp that the server does not give is the adapter's own time.",
        bend=told(_READ, change=lambda data: {**data, "source_timestamp": data["source_timestamp"] or _now()}),
        items="OUA-003.opcua",
        requirements="OUA-003",
        areas="oua",
    ),
    Mutant(
        id="MU-82c",
        protocol="opcua",
        sentence="A structure is told as the text of a program's own object.",
        bend=told(_READ, change=_printed),
        items="OUA-003.opcua",
        requirements="OUA-003",
        areas="oua",
    ),
    Mutant(
        id="MU-83w",
        protocol="opcua",
        sentence="A single value is written into an array.",
        bend=single_values_into_arrays,
        items="OUA-004.opcua",
        requirements="ERR-006 OUA-004",
        areas="oua",
    ),
    Mutant(
        id="MU-83b",
        protocol="opcua",
        sentence="A single value for an array becomes an array of one element.",
        bend=single_values_become_arrays,
        items="OUA-004.opcua",
        requirements="OUA-004",
        areas="oua",
    ),
    Mutant(
        id="MU-83c",
        protocol="opcua",
        sentence="An array of any length is sent to a node with ArrayDimensions.",
        bend=any_length,
        items="OUA-004.opcua",
        requirements="ERR-006 OUA-004",
        areas="oua",
    ),
    Mutant(
        id="MU-84b",
        protocol="opcua",
        sentence="Of a long list of nodes there is the first page; seen by the requirement suite.",
        bend=first_page,
        items="OUA-006.opcua",
        requirements="OUA-006",
        areas="oua",
    ),
    Mutant(
        id="MU-84m",
        protocol="opcua",
        sentence="The list of the children of a node that does not exist is empty.",
        bend=browses_instead(),
        items="OUA-006.opcua",
        requirements="OUA-006",
        areas="oua",
    ),
    Mutant(
        id="MU-84o",
        protocol="opcua",
        sentence="In the place of a node that does not exist the Objects folder is browsed.",
        bend=browses_instead(ua.NodeId(ua.ObjectIds.ObjectsFolder)),
        items="OUA-006.opcua",
        requirements="OUA-006",
        areas="oua",
    ),
    Mutant(
        id="MU-84c",
        protocol="opcua",
        sentence="A list says that it is a part, and its continuation point is left open.",
        bend=points_left_open,
        items="OUA-006.opcua",
        requirements="OUA-006",
        areas="oua",
    ),
    Mutant(
        id="MU-85",
        protocol="opcua",
        sentence="A circle of references is followed without end.",
        bend=circles(1_000_000),
        items="OUA-006.opcua",
        requirements="OUA-006",
        areas="oua",
    ),
    Mutant(
        id="MU-85b",
        protocol="opcua",
        sentence="A variable is listed as often as it is found in a circle of references, 20 levels deep.",
        bend=circles(20),
        items="OUA-006.opcua",
        requirements="OUA-006",
        areas="oua",
    ),
    Mutant(
        id="MU-87",
        protocol="opcua",
        sentence="A Write that is not complete yet is told as checked.",
        bend=told(_WRITE, change=_checked),
        items="OUA-007.opcua",
        requirements="OUA-007",
        areas="oua",
    ),
    Mutant(
        id="MU-87b",
        protocol="opcua",
        sentence="A value that the server has clamped is told as the one that was asked for.",
        bend=clamping_is_hidden,
        items="OUA-007.opcua",
        requirements="OUA-007",
        areas="oua",
    ),
    Mutant(
        id="MU-129b",
        protocol="opcua",
        sentence="BadUserAccessDenied is an internal error.",
        bend=failing(_WRITE, change=_denied_is_internal),
        items="OUA-005.opcua",
        requirements="ERR-001 ERR-006 OUA-005",
        areas="oua",
    ),
    Mutant(
        id="MU-129c",
        protocol="opcua",
        sentence="A status and a SourceTimestamp are written with every value; seen by the requirement suite.",
        bend=writes_status_and_timestamp,
        items="OUA-005.opcua",
        requirements="OUA-005",
        areas="oua",
    ),
)
