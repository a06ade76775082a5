"""The View service set of one session: Browse and BrowseNext (OPC 10000-4, 5.9.2, 5.9.3 and 7.9).

asyncua's own Browse has no continuation points, ignores the ResultMask, and searches the tree of reference types for
every reference that it looks at.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from .limits import Limits

__all__ = ["Browser"]

Codes = ua.StatusCodes
Mask = ua.BrowseResultMask

_DIRECTIONS = {
    ua.BrowseDirection.Forward: (True,),
    ua.BrowseDirection.Inverse: (False,),
    ua.BrowseDirection.Both: (True, False),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rest:
    """The references behind a continuation point, and the number of references in one page."""

    references: list[ua.ReferenceDescription]
    page: int


class Browser:
    """A browser of an address space for one session, with the session's continuation points."""

    _numbers = itertools.count(1)

    def __init__(self, space: AddressSpace, limits: Callable[[], Limits]) -> None:
        self._space = space
        self._limits = limits
        self._points: dict[bytes, _Rest] = {}

    @property
    def open_points(self) -> int:
        """Number of continuation points that the client has neither used up nor released."""
        return len(self._points)

    def close(self) -> None:
        """Drop the continuation points: their session has ended."""
        self._points.clear()

    def browse(self, description: ua.BrowseDescription, most: int) -> ua.BrowseResult:
        """Return the references of one node.

        Args:
            description: the node and the references asked for.
            most: RequestedMaxReferencesPerNode, 0 for no limit of the client's.
        """
        refusal = self._refusal(description)
        if refusal is not None:
            return ua.BrowseResult(StatusCode=ua.StatusCode(refusal))
        kinds = self._wanted(description)
        directions = _DIRECTIONS[ua.BrowseDirection(description.BrowseDirection)]
        found = [
            _narrowed(reference, description.ResultMask)
            for reference in self._space[description.NodeId].references
            if reference.IsForward in directions
            and (kinds is None or reference.ReferenceTypeId in kinds)
            and (not description.NodeClassMask or description.NodeClassMask & reference.NodeClass)
        ]
        own = self._limits().references_per_node
        return self._page(found, min(most or own, own or most))

    def next(self, point: bytes, *, release: bool) -> ua.BrowseResult:
        """Return the next page behind a continuation point; the point cannot be used again."""
        rest = self._points.pop(bytes(point or b""), None)
        if rest is None:
            return ua.BrowseResult(StatusCode=ua.StatusCode(Codes.BadContinuationPointInvalid))
        return ua.BrowseResult() if release else self._page(rest.references, rest.page)

    def _page(self, found: list[ua.ReferenceDescription], page: int) -> ua.BrowseResult:
        if not page or len(found) <= page:
            return ua.BrowseResult(References=found)
        if len(self._points) >= self._limits().continuation_points:
            return ua.BrowseResult(StatusCode=ua.StatusCode(Codes.BadNoContinuationPoints))
        point = next(self._numbers).to_bytes(8, "big")
        self._points[point] = _Rest(references=found[page:], page=page)
        return ua.BrowseResult(ContinuationPoint=point, References=found[:page])

    def _refusal(self, description: ua.BrowseDescription) -> int | None:
        if description.NodeId not in self._space:
            return int(Codes.BadNodeIdUnknown)
        if description.BrowseDirection not in _DIRECTIONS:
            return int(Codes.BadBrowseDirectionInvalid)
        kind = description.ReferenceTypeId
        if not kind.is_null() and not self._is_reference_type(kind):
            return int(Codes.BadReferenceTypeIdInvalid)
        return None

    def _is_reference_type(self, node: ua.NodeId) -> bool:
        if node not in self._space:
            return False
        value = self._space[node].attributes[ua.AttributeIds.NodeClass].value
        return bool(value.Value.Value == ua.NodeClass.ReferenceType)

    def _wanted(self, description: ua.BrowseDescription) -> frozenset[ua.NodeId] | None:
        if description.ReferenceTypeId.is_null():
            return None
        if not description.IncludeSubtypes:
            return frozenset({description.ReferenceTypeId})
        return _subtypes(self._space, description.ReferenceTypeId)


@cache
def _subtypes(space: AddressSpace, kind: ua.NodeId) -> frozenset[ua.NodeId]:
    """Return a reference type with all its subtypes. They are cached: no reference type is ever added to the plant."""
    found = {kind}
    for reference in space[kind].references:
        if reference.IsForward and reference.ReferenceTypeId == ua.NodeId(ua.ObjectIds.HasSubtype):
            found |= _subtypes(space, reference.NodeId)
    return frozenset(found)


def _narrowed(reference: ua.ReferenceDescription, mask: int) -> ua.ReferenceDescription:
    """Return the reference with the fields that were asked for; the others are null."""
    fields = {"NodeId": reference.NodeId}
    if mask & Mask.ReferenceTypeId:
        fields["ReferenceTypeId"] = reference.ReferenceTypeId
    if mask & Mask.NodeClass:
        fields["NodeClass"] = reference.NodeClass
    if mask & Mask.BrowseName:
        fields["BrowseName"] = reference.BrowseName
    if mask & Mask.DisplayName:
        fields["DisplayName"] = reference.DisplayName
    if mask & Mask.TypeDefinition and reference.NodeClass in (ua.NodeClass.Object, ua.NodeClass.Variable):
        fields["TypeDefinition"] = reference.TypeDefinition
    # Without its bit in the mask the direction is not asked for; its null value is false.
    return ua.ReferenceDescription(IsForward=bool(mask & Mask.IsForward) and reference.IsForward, **fields)
