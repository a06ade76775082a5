"""The enumeration of every variable of a server: one Browse per level, and later in the session one Browse for all levels
that are known.

The folders are browsed again in every enumeration, so that new nodes are found: those of the last enumeration at once, and what is
new below them level by level. Whether a variable has variables below it is asked once per session: its components follow from its
type, and asking again for each variable would cost half as much as the rest of the enumeration.
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
    pages = await services.browse_known([_OBJECTS, *services.branches], classes=_CLASSES, result=_RESULT)
    for _ in range(MAX_LEVELS):
        unasked = [node for node in level if node not in pages]
        if unasked:
            asked = await services.browse(unasked, fields=[""], classes=_CLASSES, result=_RESULT)
            pages.update(zip(unasked, asked, strict=True))
        following = []
        for above in level:
            references = pages[above]
            if not references and above in found:
                leaves.add(above)
            for reference in references:
                node = reference.NodeId
                if node.NamespaceIndex == 0 or node in seen or _is_property(reference.ReferenceTypeId):
                    continue
                if isinstance(node, ua.ExpandedNodeId) and node.ServerIndex:
                    continue
                seen.add(node)
                if node not in leaves:
                    following.append(node)
                if reference.NodeClass == ua.NodeClass.Variable:
                    found[node] = reference.BrowseName
        level = following
        if not level or len(found) > MAX_VARIABLES:
            break
    services.branches[:] = [node for node in pages if node in seen and node not in leaves and node != _OBJECTS]
    if level or len(found) > MAX_VARIABLES:
        call.extra["truncated"] = {"returned": min(len(found), MAX_VARIABLES), "total": None}
    return found if len(found) <= MAX_VARIABLES else dict(list(found.items())[:MAX_VARIABLES])


def _is_property(kind: ua.NodeId) -> bool:
    # The library's comparison costs three times as much, which an enumeration has for each of its nodes.
    return bool(kind.Identifier == ua.ObjectIds.HasProperty and kind.NamespaceIndex == 0)
