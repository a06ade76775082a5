"""The limits of the server (OPC 10000-5, 6.3.11): enforced, and advertised in the nodes that clients read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

__all__ = ["Limits", "bounded"]

_Ids = ua.ObjectIds


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The numbers that limit clients; 0 is no limit.

    Attributes:
        references_per_node: references of one node in one answer to Browse or BrowseNext; the rest is behind a
            continuation point.
        continuation_points: continuation points that one session may have open.
        sessions: sessions that may be open at the same time.
    """

    nodes_per_read: int = 10_000
    nodes_per_write: int = 10_000
    nodes_per_browse: int = 10_000
    methods_per_call: int = 100
    references_per_node: int = 0
    continuation_points: int = 10
    sessions: int = 100

    def changed(self, source: Mapping[str, Any]) -> Limits:
        """Return these limits, with those in ``source`` replaced.

        Raises:
            ValueError: an unknown name or no number.
        """
        known = {field.name for field in fields(self)}
        for name, value in source.items():
            if name not in known or type(value) is not int or value < 0:
                raise ValueError(f"limits: {name}={value!r}; known are {', '.join(sorted(known))}, from 0")
        return replace(self, **source)

    def advertised(self) -> dict[int, ua.Variant]:
        """Return the values of the nodes that advertise the limits, by identifier in namespace 0."""
        u32, u16 = ua.VariantType.UInt32, ua.VariantType.UInt16
        return {
            _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead: ua.Variant(self.nodes_per_read, u32),
            _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerWrite: ua.Variant(self.nodes_per_write, u32),
            _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerBrowse: ua.Variant(self.nodes_per_browse, u32),
            _Ids.Server_ServerCapabilities_OperationLimits_MaxNodesPerMethodCall: ua.Variant(
                self.methods_per_call, u32
            ),
            _Ids.Server_ServerCapabilities_MaxBrowseContinuationPoints: ua.Variant(self.continuation_points, u16),
        }


def bounded(items: Sequence[Any] | None, most: int) -> None:
    """Check the number of operations of one call.

    Raises:
        ServiceError: BadNothingToDo or BadTooManyOperations.
    """
    if not items:
        raise ServiceError(ua.StatusCodes.BadNothingToDo)
    if most and len(items) > most:
        raise ServiceError(ua.StatusCodes.BadTooManyOperations)
