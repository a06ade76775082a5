"""The service calls of one tool call in one session, in as few requests as the specification allows."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Any, TypeVar

from asyncua import ua
from asyncua.client.ua_client import UaClient

from ..core import AdapterError, Call
from .link import NodeFacts, Session
from .nodes import NodeName
from .status import quality, refusal, trace_status

__all__ = ["Services"]

S = TypeVar("S")
T = TypeVar("T")
Ids = ua.ObjectIds
Attributes = ua.AttributeIds

_NAMESPACES = ua.NodeId(Ids.Server_NamespaceArray)
_LIMITS = {
    "read": ua.NodeId(Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead),
    "browse": ua.NodeId(Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerBrowse),
}
_HIERARCHICAL, _HAS_PROPERTY = ua.NodeId(Ids.HierarchicalReferences), ua.NodeId(Ids.HasProperty)
_HAS_SUBTYPE = ua.NodeId(Ids.HasSubtype)
_Page = tuple[int, ua.BrowseResult]
_ABSTRACT = {Ids.BaseDataType, Ids.Number, Ids.Integer, Ids.UInteger}
_DEEPEST_TYPE = 20


class Services:
    """The service calls that a tool makes.

    Every method may raise AdapterError, or what :meth:`Session.request` raises for the link.
    """

    def __init__(self, session: Session, call: Call) -> None:
        self._session = session
        self._call = call

    @property
    def leaves(self) -> set[ua.NodeId]:
        """The set of variables known in this session to have no variables below them; callers add to the set."""
        return self._session.leaves

    @property
    def branches(self) -> list[ua.NodeId]:
        """The nodes below which this session's last enumeration looked, but for the leaves; each enumeration replaces them."""
        return self._session.branches

    # -- names ----------------------------------------------------------------------------------------------

    async def node(self, name: NodeName) -> ua.NodeId:
        """Return the node id, with the index that its namespace has in this session."""
        if name.uri is None:
            return name.at(name.index)
        if self._session.namespaces is None:
            (found,) = await self.read([_NAMESPACES])
            self._session.namespaces = list(found.Value.Value or [])
        if name.uri not in self._session.namespaces:
            message = "the server has no namespace with this URI"
            outcome = "not_sent" if self._call.writes else "not_applicable"
            raise AdapterError("illegal_address", message, outcome=outcome, field=name.field)
        return name.at(self._session.namespaces.index(name.uri))

    # -- attributes -----------------------------------------------------------------------------------------

    async def read(
        self, nodes: Sequence[ua.NodeId], *attributes: ua.AttributeIds, request: str = "read"
    ) -> list[ua.DataValue]:
        """Read attributes of nodes (default: the value), node by node."""
        wanted = [
            ua.ReadValueId(NodeId=node, AttributeId=attribute)
            for node in nodes
            for attribute in attributes or (Attributes.Value,)
        ]

        async def send(portion: Sequence[ua.ReadValueId]) -> list[ua.DataValue]:
            parameters = ua.ReadParameters(TimestampsToReturn=ua.TimestampsToReturn.Both, NodesToRead=list(portion))
            found = await self._request(lambda client: client.read(parameters), len(portion))
            self._call.answered(service="Read")
            return found

        return await self._in_portions(wanted, request, send)

    async def write(self, nodes: Sequence[ua.NodeId], values: Sequence[ua.Variant]) -> list[ua.StatusCode]:
        """Write values without status and times, which servers may refuse (OPC 10000-4, 5.11.4.1)."""
        self._call.changes(*((node.to_string(), value.Value) for node, value in zip(nodes, values, strict=True)))
        parameters = ua.WriteParameters(
            NodesToWrite=[
                ua.WriteValue(NodeId=node, AttributeId=Attributes.Value, Value=ua.DataValue(value, StatusCode=None))
                for node, value in zip(nodes, values, strict=True)
            ]
        )
        statuses = await self._request(lambda client: client.write(parameters), len(nodes), changes=True)
        self._call.answered(service="Write")
        return statuses

    async def call_method(self, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        """Call a method."""
        self._call.changes((request.MethodId.to_string(), None))
        (result,) = await self._request(lambda client: client.call([request]), 1, changes=True)
        self._call.answered(service="Call")
        return result

    async def _request(
        self, request: Callable[[UaClient], Awaitable[list[T]]], items: int, *, changes: bool = False
    ) -> list[T]:
        return await self._session.request(self._call, request, items=items, changes=changes)

    async def _in_portions(
        self, items: Sequence[S], limit: str, send: Callable[[Sequence[S]], Awaitable[list[T]]]
    ) -> list[T]:
        """Send all items at once; send them in portions if the server refuses so many."""
        limits = self._session.limits
        most = (limits or {}).get(limit) or len(items)
        try:
            if len(items) <= most:
                return await send(items)
            return [found for start in range(0, len(items), most) for found in await send(items[start : start + most])]
        except AdapterError as error:
            if error.code != "limit_exceeded" or limits is not None or limit not in _LIMITS:
                raise
            self._session.limits = await self._operation_limits()
            if not 0 < self._session.limits[limit] < len(items):
                raise
        return await self._in_portions(items, limit, send)

    async def _operation_limits(self) -> dict[str, int]:
        found = await self.read(list(_LIMITS.values()), request="limits")
        return {name: each.Value.Value or 0 for name, each in zip(_LIMITS, found, strict=True)}

    # -- types ----------------------------------------------------------------------------------------------

    async def facts(self, nodes: Sequence[ua.NodeId], fields: Sequence[str]) -> list[NodeFacts]:
        """Return types and ranks of variables that are to be written, read once per session, in one request.

        Args:
            nodes: the variables.
            fields: JSON Pointers to their names in the arguments.
        """
        known = self._session.facts
        unknown = {node: field for node, field in zip(nodes, fields, strict=True) if node not in known}
        if unknown:
            found = await self.read(
                list(unknown), Attributes.DataType, Attributes.ValueRank, Attributes.ArrayDimensions
            )
            for index, (node, field) in enumerate(unknown.items()):
                kind, rank, dimensions = found[3 * index : 3 * index + 3]
                if quality(kind.StatusCode) == "bad":
                    raise self._refused(kind.StatusCode, field)
                known[node] = NodeFacts(
                    kind=await self._built_in(kind.Value.Value, node),
                    rank=-2 if rank.Value.Value is None else rank.Value.Value,
                    dimensions=dimensions.Value.Value or (),
                )
        return [known[node] for node in nodes]

    async def method_inputs(self, method: ua.NodeId) -> list[NodeFacts]:
        """Return the input arguments that a method declares, read once per session."""
        if method not in self._session.inputs:
            (properties,) = await self.browse([method], kind=_HAS_PROPERTY, fields=["/method_id"])
            declared = [each.NodeId for each in properties if each.BrowseName.Name == "InputArguments"]
            arguments: list[Any] = []
            if declared:
                (value,) = await self.read(declared)
                if quality(value.StatusCode) == "bad":
                    raise self._refused(value.StatusCode, "/method_id")
                arguments = value.Value.Value or []
            self._session.inputs[method] = [
                NodeFacts(
                    kind=await self._built_in(argument.DataType, None),
                    rank=argument.ValueRank,
                    dimensions=argument.ArrayDimensions or (),
                )
                for argument in arguments
            ]
        return self._session.inputs[method]

    async def _built_in(self, data_type: ua.NodeId, variable: ua.NodeId | None) -> ua.VariantType:
        """Return the built-in type in which values of a data type are transferred (OPC 10000-3, 5.8.3 and 8.14)."""
        known = self._session.types
        asked, depth = data_type, 0
        while asked not in known and not _is_base(asked) and depth < _DEEPEST_TYPE:
            parents = await self.browse([asked], kind=_HAS_SUBTYPE, direction=ua.BrowseDirection.Inverse, fields=[""])
            if not parents[0]:
                break
            asked, depth = parents[0][0].NodeId, depth + 1
        number = asked.Identifier if _is_base(asked) else None
        if asked in known:
            kind = known[asked]
        elif number == Ids.Enumeration:
            kind = ua.VariantType.Int32
        elif number in _ABSTRACT and variable is not None:
            # Several types are allowed here; the type of the variable's present value is one of them.
            (value,) = await self.read([variable])
            return ua.VariantType(value.Value.VariantType.value)
        elif number is None or number in _ABSTRACT:
            raise AdapterError("unsupported_operation", "this data type is not offered", outcome="not_sent")
        else:
            kind = ua.VariantType(number)
        known[data_type] = kind
        return kind

    # -- browsing -------------------------------------------------------------------------------------------

    async def browse(
        self,
        nodes: Sequence[ua.NodeId],
        *,
        fields: Sequence[str],
        kind: ua.NodeId = _HIERARCHICAL,
        direction: ua.BrowseDirection = ua.BrowseDirection.Forward,
        classes: int = 0,
        result: int = ua.BrowseResultMask.BrowseName,
    ) -> list[list[ua.ReferenceDescription]]:
        """Return the references of each node, from every page.

        Args:
            nodes: the nodes whose references are wanted.
            fields: JSON Pointers to their names in the arguments; one for all nodes that are not in the arguments.
            kind, direction: type and direction of the references.
            classes: mask of node classes, 0 for all.
            result: mask of the facts about each reference; fewer are faster.
        """
        pages = await self._browse(nodes, fields, kind, direction, classes, result)
        return [pages[index] for index in range(len(nodes))]

    async def browse_known(
        self, nodes: Sequence[ua.NodeId], *, classes: int = 0, result: int = ua.BrowseResultMask.BrowseName
    ) -> dict[ua.NodeId, list[ua.ReferenceDescription]]:
        """Return the hierarchical references of the nodes that are still there, from every page.

        Args:
            nodes: nodes that were there before; those that the server refuses now are left out.
            classes, result: as for :meth:`browse`.
        """
        pages = await self._browse(nodes, None, _HIERARCHICAL, ua.BrowseDirection.Forward, classes, result)
        return {nodes[index]: references for index, references in pages.items()}

    async def _browse(
        self,
        nodes: Sequence[ua.NodeId],
        fields: Sequence[str] | None,
        kind: ua.NodeId,
        direction: ua.BrowseDirection,
        classes: int,
        result: int,
    ) -> dict[int, list[ua.ReferenceDescription]]:
        """Return the references by the node's place; without ``fields`` nodes that the server refuses are left out."""
        asked = [
            ua.BrowseDescription(
                NodeId=node,
                BrowseDirection=direction,
                ReferenceTypeId=kind,
                IncludeSubtypes=True,
                NodeClassMask=classes,
                ResultMask=result,
            )
            for node in nodes
        ]
        found: dict[int, list[ua.ReferenceDescription]] = {index: [] for index in range(len(nodes))}
        waiting = list(range(len(nodes)))
        while waiting:
            first = await self._in_portions([asked[index] for index in waiting], "browse", self._send_browse)
            served, waiting = _served(list(zip(waiting, first, strict=True)))
            if fields is None:
                for index in [index for index, page in served if quality(page.StatusCode) == "bad"]:
                    del found[index]
                served = [(index, page) for index, page in served if index in found]
            await self._turn_pages(served, found, fields or [""])
        return found

    async def _send_browse(self, portion: Sequence[ua.BrowseDescription]) -> list[ua.BrowseResult]:
        parameters = ua.BrowseParameters(NodesToBrowse=list(portion))
        found = await self._request(lambda client: client.browse(parameters), len(portion))
        self._call.answered(service="Browse")
        return found

    async def _turn_pages(
        self,
        pages: list[_Page],
        found: dict[int, list[ua.ReferenceDescription]],
        fields: Sequence[str],
    ) -> None:
        while pages:
            for index, page in pages:
                if quality(page.StatusCode) == "bad":
                    await self._release([each.ContinuationPoint for _, each in pages if each.ContinuationPoint])
                    raise self._refused(page.StatusCode, fields[min(index, len(fields) - 1)])
                found[index] += page.References
            unfinished = [(index, page.ContinuationPoint) for index, page in pages if page.ContinuationPoint]
            if not unfinished:
                return
            following = await self._browse_next([point for _, point in unfinished])
            pages = [(index, page) for (index, _), page in zip(unfinished, following, strict=True)]

    async def _browse_next(self, points: list[bytes]) -> list[ua.BrowseResult]:
        parameters = ua.BrowseNextParameters(ReleaseContinuationPoints=False, ContinuationPoints=points)
        return await self._request(lambda client: client.browse_next(parameters), len(points))

    async def _release(self, points: list[bytes]) -> None:
        if points:
            parameters = ua.BrowseNextParameters(ReleaseContinuationPoints=True, ContinuationPoints=points)
            await self._request(lambda client: client.browse_next(parameters), 0)

    def _refused(self, status: ua.StatusCode, field: str) -> AdapterError:
        """Return the error for a refused question, after which nothing is changed."""
        self._call.answered(status_code=trace_status(status))
        return refusal(status, writes=self._call.writes, field=field or None)


def _served(pages: list[_Page]) -> tuple[list[_Page], list[int]]:
    """Return the pages to process, and the indices of the nodes to browse again after them.

    A server that has run out of continuation points answers some nodes now, and the others after these. If it answers
    no node, its refusals are the answer.
    """
    late = [index for index, page in pages if page.StatusCode.name == "BadNoContinuationPoints"]
    if len(late) == len(pages):
        return pages, []
    return [(index, page) for index, page in pages if index not in late], late


def _is_base(data_type: ua.NodeId) -> bool:
    return (
        data_type.NamespaceIndex == 0
        and isinstance(data_type.Identifier, int)
        and data_type.Identifier <= Ids.Enumeration
    )
