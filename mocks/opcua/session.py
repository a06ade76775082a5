"""A client's session: what each service call is about, and the checks that the library leaves out.

Checks follow OPC 10000-4: 5.9.2 (Browse), 5.9.3 (BrowseNext), 5.11.2 (Read), 5.11.3 (HistoryRead), 5.11.4 (Write),
5.12.2 (Call) and 5.14.6 (Republish).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.internal_session import InternalSession

from .browsing import Browser
from .exchange import current
from .faults import Rule
from .limits import bounded
from .plant import MethodRefusal
from .state import DeviceState
from .values import finite, fits

__all__ = ["PlantSession"]

Codes = ua.StatusCodes
Ids = ua.AttributeIds
Stamps = ua.TimestampsToReturn

_RANGE = re.compile(r"(\d{1,9})(?::(\d{1,9}))?")
_SOURCE = (Stamps.Source, Stamps.Both)
_SERVER = (Stamps.Server, Stamps.Both)


class PlantSession(InternalSession):  # type: ignore[misc]
    """One session of one client."""

    device: DeviceState

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.browser = Browser(self.aspace, lambda: self.device.limits)
        # Node ids by subscription and the client's handle of the item.
        self.monitored: dict[tuple[int, int], str] = {}

    async def create_session(self, params: ua.CreateSessionParameters, sockname: Any = None) -> Any:
        if self.device.limits.sessions and len(self.device.sessions) >= self.device.limits.sessions:
            await super().close_session()
            raise ServiceError(Codes.BadTooManySessions)
        self.device.sessions.add(self)
        return await super().create_session(params, sockname=sockname)

    async def close_session(self, delete_subs: bool = True) -> None:
        # It is also called when the connection has ended, so it is not journalled: the journal has client requests.
        self.device.sessions.discard(self)
        self.browser.close()
        await super().close_session(delete_subs)

    # -- attribute services -------------------------------------------------------------------------------

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        exchange, items = current(), params.NodesToRead or []
        exchange.asked(_names(item.NodeId for item in items))
        bounded(items, self.device.limits.nodes_per_read)
        if params.MaxAge < 0:
            raise ServiceError(Codes.BadMaxAgeInvalid)
        if params.TimestampsToReturn not in (Stamps.Source, Stamps.Server, Stamps.Both, Stamps.Neither):
            raise ServiceError(Codes.BadTimestampsToReturnInvalid)
        rule = await exchange.suffer()
        results = [_forced(rule) or self._read_one(item, params.TimestampsToReturn) for item in items]
        if rule.with_status is not None:
            results = [replace(result, StatusCode=_told(rule, result.StatusCode)) for result in results]
        return results

    def _read_one(self, item: ua.ReadValueId, stamps: ua.TimestampsToReturn) -> ua.DataValue:
        is_value = item.AttributeId == Ids.Value
        held: ua.DataValue = self.aspace.read_attribute_value(item.NodeId, item.AttributeId)
        if is_value and (refusal := self._access(item.NodeId, ua.AccessLevel.CurrentRead)) is not None:
            return _bad(refusal)
        if item.DataEncoding is not None and item.DataEncoding.Name and item.DataEncoding.Name != "Default Binary":
            return _bad(Codes.BadDataEncodingUnsupported if is_value else Codes.BadDataEncodingInvalid)
        value = held.Value
        if item.IndexRange and not held.StatusCode.is_bad():
            value = _slice(value, item.IndexRange)
            if isinstance(value, int):
                return _bad(value)
        return replace(
            held,
            Value=value,
            SourceTimestamp=held.SourceTimestamp if is_value and stamps in _SOURCE else None,
            ServerTimestamp=held.ServerTimestamp if stamps in _SERVER else None,
        )

    def _access(self, node: ua.NodeId, right: ua.AccessLevel) -> int | None:
        """Return why a variable must not be accessed: no user may, or this user may not; None if it may."""
        if node not in self.aspace:
            return None
        if node in self.device.plant.variables and self.device.accounts.denies(current().connection):
            return int(Codes.BadUserAccessDenied)
        attributes = self.aspace[node].attributes
        for attribute, refusal in (
            (Ids.AccessLevel, Codes.BadNotReadable if right == ua.AccessLevel.CurrentRead else Codes.BadNotWritable),
            (Ids.UserAccessLevel, Codes.BadUserAccessDenied),
        ):
            if attribute in attributes and not attributes[attribute].value.Value.Value & right.mask:
                return int(refusal)
        return None

    async def history_read(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Refuse every node: none of the plant's has a history."""
        items = params.NodesToRead or []
        bounded(items, self.device.limits.nodes_per_read)
        return [ua.HistoryReadResult(StatusCode=ua.StatusCode(self._without_history(item.NodeId))) for item in items]

    def _without_history(self, node: ua.NodeId) -> int:
        return int(Codes.BadHistoryOperationUnsupported if node in self.aspace else Codes.BadNodeIdUnknown)

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        exchange, items = current(), params.NodesToWrite or []
        exchange.asked(_names(item.NodeId for item in items))
        bounded(items, self.device.limits.nodes_per_write)
        rule = await exchange.suffer()
        results = [_told(rule, await self._write_one(item, rule)) for item in items]
        return results

    async def _write_one(self, item: ua.WriteValue, rule: Rule) -> ua.StatusCode:
        if rule.status is not None:
            return ua.StatusCode(getattr(Codes, rule.status))
        if (refusal := self._refusal(item)) is not None:
            return ua.StatusCode(refusal)
        stamped = item.Value.SourceTimestamp is not None or item.Value.ServerTimestamp is not None
        with_status = item.Value.StatusCode is not None and item.Value.StatusCode.value != 0
        if (rule.refuse_timestamps and stamped) or (rule.refuse_status and with_status):
            return ua.StatusCode(Codes.BadWriteNotSupported)
        if rule.ack_only:
            return ua.StatusCode()
        value, status = item.Value.Value, Codes.Good
        if rule.clamp is not None:
            value, status = ua.Variant(rule.clamp, value.VariantType), Codes.GoodClamped
        now = datetime.now(UTC)
        # The status and the time that the client wrote are in the journal; the plant keeps its own.
        data = ua.DataValue(value, SourceTimestamp=now, ServerTimestamp=now)
        await self.aspace.write_attribute_value(item.NodeId, Ids.Value, data)
        return ua.StatusCode(status)

    def _refusal(self, item: ua.WriteValue) -> int | None:
        """Return why an item must not be written, checked in the order of a server; None if it may."""
        if item.NodeId not in self.aspace:
            return int(Codes.BadNodeIdUnknown)
        if item.AttributeId not in self.aspace[item.NodeId].attributes:
            return int(Codes.BadAttributeIdInvalid)
        if item.AttributeId != Ids.Value:
            return int(Codes.BadNotWritable)
        if (refusal := self._access(item.NodeId, ua.AccessLevel.CurrentWrite)) is not None:
            return refusal
        variable = self.device.plant.variables.get(item.NodeId)
        if variable is None:
            return int(Codes.BadNotWritable)
        if item.IndexRange:
            return int(Codes.BadWriteNotSupported)
        value = item.Value.Value
        if value is None or not fits(value, variable.kind, variable.rank, list(variable.dimensions)):
            return int(Codes.BadTypeMismatch)
        low, high = variable.range
        inside = finite(value.Value) and (value.is_array or low is None or low <= value.Value <= high)
        return None if inside else int(Codes.BadOutOfRange)

    # -- view services ------------------------------------------------------------------------------------

    async def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        exchange, items = current(), params.NodesToBrowse or []
        exchange.asked(_names(item.NodeId for item in items))
        bounded(items, self.device.limits.nodes_per_browse)
        if not params.View.ViewId.is_null():
            raise ServiceError(Codes.BadViewIdUnknown)
        forced = _forced(await exchange.suffer())
        if forced is not None:
            return self._browsed([ua.BrowseResult(StatusCode=forced.StatusCode) for _ in items])
        return self._browsed([self.browser.browse(item, params.RequestedMaxReferencesPerNode) for item in items])

    async def browse_next(self, parameters: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        exchange, points = current(), parameters.ContinuationPoints or []
        exchange.asked(())
        bounded(points, 0)
        forced = _forced(await exchange.suffer())
        if forced is not None:
            return self._browsed([ua.BrowseResult(StatusCode=forced.StatusCode) for _ in points])
        release = parameters.ReleaseContinuationPoints
        results = [self.browser.next(point, release=release) for point in points]
        # The release of continuation points has no results (table 37).
        return self._browsed([] if release else results)

    def _browsed(self, results: list[ua.BrowseResult]) -> list[ua.BrowseResult]:
        if self.browser.open_points:
            current().said["open_points"] = self.browser.open_points
        return results

    async def translate_browsepaths_to_nodeids(self, params: list[ua.BrowsePath]) -> list[ua.BrowsePathResult]:
        exchange = current()
        exchange.asked(_names(path.StartingNode for path in params or []))
        bounded(params, 0)
        await exchange.suffer()
        results: list[ua.BrowsePathResult] = await super().translate_browsepaths_to_nodeids(params)
        for path, result in zip(params, results, strict=True):
            if path.StartingNode not in self.aspace:
                result.StatusCode = ua.StatusCode(Codes.BadNodeIdUnknown)
        return results

    # -- monitored items ----------------------------------------------------------------------------------

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        exchange, items = current(), params.ItemsToCreate or []
        exchange.asked(_names(item.ItemToMonitor.NodeId for item in items))
        await exchange.suffer()
        for item in items:
            if item.ItemToMonitor.AttributeId == Ids.Value:
                handle = item.RequestedParameters.ClientHandle
                self.monitored[params.SubscriptionId, handle] = item.ItemToMonitor.NodeId.to_string()
        results: list[ua.MonitoredItemCreateResult] = await super().create_monitored_items(params)
        return results

    # -- subscriptions ------------------------------------------------------------------------------------

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        """Return a notification that was sent and has not been acknowledged; it is kept until it is.

        The library answers Good and an empty message to everything else, and a client that reconnects asks for one message
        after the other until it is told that there is none.

        Raises:
            ServiceError: BadSubscriptionIdInvalid or BadMessageNotAvailable.
        """
        subscription = self.subscription_service.subscriptions.get(params.SubscriptionId)
        if subscription is None or subscription.session_id != self.session_id:
            raise ServiceError(Codes.BadSubscriptionIdInvalid)
        kept = subscription._not_acknowledged_results.get(params.RetransmitSequenceNumber)
        if kept is None:
            raise ServiceError(Codes.BadMessageNotAvailable)
        return kept.NotificationMessage

    # -- methods ------------------------------------------------------------------------------------------

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        exchange = current()
        exchange.asked(_names(request.MethodId for request in params or []))
        bounded(params, self.device.limits.methods_per_call)
        rule = await exchange.suffer()
        forced = _forced(rule)
        results = []
        for request in params:
            if forced is not None:
                results.append(ua.CallMethodResult(StatusCode=forced.StatusCode))
                continue
            try:
                results.append(await self._perform(request))
            except MethodRefusal as refusal:
                results.append(refusal.result())
            results[-1].StatusCode = _told(rule, results[-1].StatusCode)
        return results

    async def _perform(self, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        if request.ObjectId not in self.aspace:
            raise MethodRefusal(Codes.BadNodeIdUnknown)
        method = self.device.plant.methods.get(request.MethodId)
        if method is None or request.ObjectId != method.owner:
            raise MethodRefusal(Codes.BadMethodInvalid)
        given = request.InputArguments or []
        if len(given) < len(method.inputs):
            raise MethodRefusal(Codes.BadArgumentsMissing)
        if len(given) > len(method.inputs):
            raise MethodRefusal(Codes.BadTooManyArguments)
        wrong = [not fits(argument, kind, -1, []) for argument, kind in zip(given, method.inputs.values(), strict=True)]
        if any(wrong):
            arguments = [Codes.BadTypeMismatch if each else Codes.Good for each in wrong]
            raise MethodRefusal(Codes.BadInvalidArgument, arguments)
        outputs = await method.function(*(argument.Value for argument in given))
        self.device.plant.calls[request.MethodId] += 1
        return ua.CallMethodResult(
            InputArgumentResults=[ua.StatusCode() for _ in given],
            OutputArguments=[
                ua.Variant(value, kind) for value, kind in zip(outputs, method.outputs.values(), strict=True)
            ],
        )


def _names(nodes: Iterable[ua.NodeId]) -> list[str]:
    return [node.to_string() for node in nodes]


def _bad(code: int) -> ua.DataValue:
    return ua.DataValue(StatusCode=ua.StatusCode(code))


def _forced(rule: Rule) -> ua.DataValue | None:
    return None if rule.status is None else _bad(getattr(Codes, rule.status))


def _told(rule: Rule, status: ua.StatusCode) -> ua.StatusCode:
    """Return the status code that a client is told of something that has this one."""
    if rule.with_status is None or not status.is_good():
        return status
    return ua.StatusCode(getattr(Codes, rule.with_status))


def _slice(value: ua.Variant, text: str) -> ua.Variant | int:
    """Return a part of a one-dimensional array (NumericRange, 7.27), or the status code that says why there is none."""
    bounds = _RANGE.fullmatch(text)
    if bounds is None:
        return int(Codes.BadIndexRangeInvalid)
    low = int(bounds[1])
    high = low if bounds[2] is None else int(bounds[2])
    if bounds[2] is not None and high <= low:
        return int(Codes.BadIndexRangeInvalid)
    if value is None or not value.is_array or value.Dimensions or low >= len(value.Value):
        return int(Codes.BadIndexRangeNoData)
    return ua.Variant(value.Value[low : high + 1], value.VariantType, is_array=True)
