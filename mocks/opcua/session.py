"""A client's session: every service call on the journal, and the checks that the library leaves out.

Checks follow OPC 10000-4: 5.11.4 (Write), 5.9.2 (Browse), 5.12.2 (Call).
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable, Iterable
from typing import TYPE_CHECKING, Any

from asyncua import ua
from asyncua.server.internal_session import InternalSession
from asyncua.ua.uaerrors import BadShutdown

if TYPE_CHECKING:
    from .device import OpcUaDevice

__all__ = ["PlantSession"]

Codes = ua.StatusCodes


def _symbol(status: ua.StatusCode) -> str:
    name: str = status.name
    return name


def _json(value: Any) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list):
        return [_json(member) for member in value]
    return str(value)


class PlantSession(InternalSession):  # type: ignore[misc]
    """One session of one client."""

    _numbers = itertools.count(1)
    device: OpcUaDevice

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.number = next(self._numbers)

    def _record(self, direction: str, kind: str, **fields: Any) -> None:
        self.device.journal.append(connection=self.number, direction=direction, kind=kind, **fields)

    async def _faulty(self, service: str, nodes: Iterable[ua.NodeId]) -> ua.StatusCode | None:
        """Apply the fault plan; a status code is what every item is answered with."""
        rule = self.device.faults.match(service, [node.to_string() for node in nodes])
        if rule is None:
            return None
        if rule.delay_s:
            await asyncio.sleep(rule.delay_s)
        if rule.close:
            for transport in list(self.iserver.asyncio_transports):
                transport.abort()
            raise BadShutdown
        if rule.service_fault is not None:
            raise ua.uaerrors.UaStatusCodeError(getattr(Codes, rule.service_fault))
        return None if rule.status is None else ua.StatusCode(getattr(Codes, rule.status))

    # -- session services ---------------------------------------------------------------------------------

    async def create_session(self, params: Any, sockname: Any = None) -> Any:
        self._record("in", "CreateSession", client_name=str(params.SessionName))
        return await super().create_session(params, sockname=sockname)

    def activate_session(self, params: Any, peer_certificate: bytes | None) -> Any:
        self._record("in", "ActivateSession")
        return super().activate_session(params, peer_certificate)

    async def close_session(self, delete_subs: bool = True) -> None:
        self._record("in", "CloseSession")
        await super().close_session(delete_subs)

    # -- attribute services -------------------------------------------------------------------------------

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        nodes = [
            {"node_id": item.NodeId.to_string(), "attribute": ua.AttributeIds(item.AttributeId).name}
            for item in params.NodesToRead
        ]
        self._record("in", "Read", nodes=nodes, state_changing=False)
        status = await self._faulty("Read", (item.NodeId for item in params.NodesToRead))
        if status is not None:
            results = [ua.DataValue(StatusCode=status) for _ in nodes]
        else:
            results = await super().read(params)
        answers = [
            {"status": _symbol(result.StatusCode), "value": _json(result.Value.Value if result.Value else None)}
            for result in results
        ]
        self._record("out", "Read", results=answers)
        return results

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        items = params.NodesToWrite
        nodes = [
            {
                "node_id": item.NodeId.to_string(),
                "attribute": ua.AttributeIds(item.AttributeId).name,
                "value": _json(item.Value.Value.Value if item.Value.Value else None),
                "variant_type": item.Value.Value.VariantType.name if item.Value.Value else None,
                "has_timestamp": item.Value.SourceTimestamp is not None,
            }
            for item in items
        ]
        self._record("in", "Write", nodes=nodes, state_changing=True)
        status = await self._faulty("Write", (item.NodeId for item in items))
        results: list[ua.StatusCode] = []
        for item in items:
            refusal = status or self._refusal(item)
            if refusal is not None:
                results.append(refusal)
            else:
                results += await super().write(ua.WriteParameters(NodesToWrite=[item]))
        self._record("out", "Write", results=[{"status": _symbol(result)} for result in results])
        return results

    def _refusal(self, item: ua.WriteValue) -> ua.StatusCode | None:
        """Why an item must not be written, in the order in which a server finds out."""
        space = self.iserver.aspace
        if item.NodeId not in space:
            return ua.StatusCode(Codes.BadNodeIdUnknown)
        if item.AttributeId != ua.AttributeIds.Value:
            known = item.AttributeId in space[item.NodeId].attributes
            return ua.StatusCode(Codes.BadNotWritable if known else Codes.BadAttributeIdInvalid)
        about = self.device.plant.variables.get(item.NodeId)
        if about is None or not about["writable"]:
            return ua.StatusCode(Codes.BadNotWritable)
        if item.IndexRange:
            return ua.StatusCode(Codes.BadIndexRangeInvalid)
        variant = item.Value.Value
        if variant is None or variant.VariantType.name != about["data_type"] or isinstance(variant.Value, list):
            return ua.StatusCode(Codes.BadTypeMismatch)
        return None

    # -- view services ------------------------------------------------------------------------------------

    async def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        nodes = [item.NodeId.to_string() for item in params.NodesToBrowse]
        self._record("in", "Browse", nodes=nodes, state_changing=False)
        status = await self._faulty("Browse", (item.NodeId for item in params.NodesToBrowse))
        results: list[ua.BrowseResult] = await super().browse(params)
        for item, result in zip(params.NodesToBrowse, results, strict=True):
            if status is not None:
                result.StatusCode, result.References = status, []
            elif item.NodeId not in self.iserver.aspace:
                result.StatusCode = ua.StatusCode(Codes.BadNodeIdUnknown)
        counts = [len(result.References) for result in results]
        statuses = [{"status": _symbol(result.StatusCode)} for result in results]
        self._record("out", "Browse", counts=counts, results=statuses)
        return results

    async def translate_browsepaths_to_nodeids(self, params: list[ua.BrowsePath]) -> list[ua.BrowsePathResult]:
        nodes = [path.StartingNode.to_string() for path in params]
        self._record("in", "TranslateBrowsePaths", nodes=nodes, state_changing=False)
        results: list[ua.BrowsePathResult] = await super().translate_browsepaths_to_nodeids(params)
        return results

    # -- methods ------------------------------------------------------------------------------------------

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        methods = [
            {
                "object_id": request.ObjectId.to_string(),
                "method_id": request.MethodId.to_string(),
                "arguments": [_json(argument.Value) for argument in request.InputArguments],
                "types": [argument.VariantType.name for argument in request.InputArguments],
            }
            for request in params
        ]
        nodes = [request.MethodId.to_string() for request in params]
        self._record("in", "Call", nodes=nodes, methods=methods, state_changing=True)
        status = await self._faulty("Call", (request.MethodId for request in params))
        results = []
        for request in params:
            refused = ua.CallMethodResult(StatusCode=status) if status is not None else self._invalid(request)
            if refused is None:
                results += await super().call([request])
                self.device.plant.calls[request.MethodId] += 1
            else:
                results.append(refused)
        self._record("out", "Call", results=[{"status": _symbol(result.StatusCode)} for result in results])
        return results

    def _invalid(self, request: ua.CallMethodRequest) -> ua.CallMethodResult | None:
        def refuse(code: int) -> ua.CallMethodResult:
            return ua.CallMethodResult(StatusCode=ua.StatusCode(code))

        if request.ObjectId not in self.iserver.aspace:
            return refuse(Codes.BadNodeIdUnknown)
        method = self.device.plant.methods.get(request.MethodId)
        if method is None or request.ObjectId != self.device.plant.folders["Methods"]:
            return refuse(Codes.BadMethodInvalid)
        expected, given = method[0], request.InputArguments
        if len(given) < len(expected):
            return refuse(Codes.BadArgumentsMissing)
        if len(given) > len(expected):
            return refuse(Codes.BadTooManyArguments)
        kinds = [
            Codes.Good
            if argument.VariantType == kind and not isinstance(argument.Value, list)
            else Codes.BadTypeMismatch
            for argument, kind in zip(given, expected, strict=True)
        ]
        if any(kind != Codes.Good for kind in kinds):
            result = refuse(Codes.BadInvalidArgument)
            result.InputArgumentResults = [ua.StatusCode(kind) for kind in kinds]
            return result
        return None

    # -- everything else ----------------------------------------------------------------------------------

    async def _other(self, kind: str, call: Callable[[], Awaitable[Any]], *, changing: bool = False) -> Any:
        self._record("in", kind, nodes=[], state_changing=changing)
        return await call()

    async def add_nodes(self, params: Any) -> Any:
        return await self._other("AddNodes", lambda: InternalSession.add_nodes(self, params), changing=True)

    async def delete_nodes(self, params: Any) -> Any:
        return await self._other("DeleteNodes", lambda: InternalSession.delete_nodes(self, params), changing=True)

    async def create_subscription(self, *args: Any, **kwargs: Any) -> Any:
        return await self._other(
            "CreateSubscription", lambda: InternalSession.create_subscription(self, *args, **kwargs)
        )
