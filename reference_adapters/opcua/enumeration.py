"""The enumeration of every variable of a server: one Browse per level.

The folders are browsed again in every enumeration, so that new nodes are found. Whether a variable has variables below it is
asked once per session: its components follow from its type, and asking again for each variable would cost half as much
as the rest of the enumeration.
"""

from __future__ import annotations

from asyncua import ua

from ..core import Call
from .services import Services

__all__ = ["Found", "find_variables"]

MAX_LEVELS = 32
MAX_VARIABLES = 20_000

Mask = ua.BrowseResultMask
Found = dict[ua.NodeId, ua.QualifiedName]

_OBJECTS = ua.NodeId(ua.ObjectIds.ObjectsFolder)
_HAS_PROPERTY = ua.NodeId(ua.ObjectIds.HasProperty)
# A field that is not asked for saves time in server and adapter; these fields take most of an enumeration's time.
_RESULT = Mask.ReferenceTypeId | Mask.NodeClass | Mask.BrowseName
_CLASSES = ua.NodeClass.Object | ua.NodeClass.Variable


async def find_variables(services: Services, call: Call) -> Found:
    """Return the data variables below the Objects folder by node id, with their browse names.

    Namespace 0 is left out: it describes the server itself. Properties are left out: they describe nodes and are no
    data of their own.

    Args:
        services: the services to ask with.
        call: its ``meta.truncated`` tells when there may be more variables.
    """
    leaves = services.leaves
    found: Found = {}
    # This set ends cycles, and makes a variable with two references be listed once.
    seen = {_OBJECTS}
    level = [_OBJECTS]
    for _ in range(MAX_LEVELS):
        following = []
        pages = await services.browse(level, fields=[""], classes=_CLASSES, result=_RESULT)
        leaves.update(node for node, page in zip(level, pages, strict=True) if not page and node in found)
        for references in pages:
            for reference in references:
                node = reference.NodeId
                if node.NamespaceIndex == 0 or node in seen or reference.ReferenceTypeId == _HAS_PROPERTY:
                    continue
                if isinstance(node, ua.ExpandedNodeId) and node.ServerIndex:
                    continue
                seen.add(node)
                if node not in leaves:
                    following.append(node)
                if reference.NodeClass == ua.NodeClass.Variable:
                    found[node] = reference.BrowseName
        if not following:
            return found
        if len(found) > MAX_VARIABLES:
            break
        level = following
    call.extra["truncated"] = {"returned": min(len(found), MAX_VARIABLES), "total": None}
    return dict(list(found.items())[:MAX_VARIABLES])
