"""Nodes beside the plant that a test asks for: other types, arrays, access rights, long lists, cycles. A reset removes
them.

``create`` takes a list of objects, each with one of these members:

=============  =======================================================================================
``folder``     name of a folder ``in`` another (default: the Plant folder)
``variable``   name of a variable ``in`` a folder or variable, with ``type`` (name of a built-in type), ``value``,
               and optionally ``rank`` and ``dimensions`` (default: those of the value), ``access`` (``read_write``,
               ``read``, ``denied`` to this user, ``denied_writing`` to this user, ``hidden`` from everybody), ``range`` ([low, high]), ``data_type``
               (node id of the DataType attribute), ``property`` (true: HasProperty instead of HasComponent),
               ``browse_name`` (default: the name; ``0:EURange`` is in namespace 0), ``type_definition`` (node id),
               ``display_name`` and ``description`` (default: the name), ``copies`` (so many more, equal to it but for the name, which gets a number from 1)
``method``     name of a method of the Methods folder that returns its ``inputs`` (names of built-in types), or a text ``returns``
``reference``  name of a folder that gets an Organizes reference ``to`` another
=============  =======================================================================================

Values are JSON as in ``values.variant``; null is the null variant, for which ``rank`` says what it stands for.
``namespace`` (an URI) puts a node into another namespace than the plant's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from asyncua import Server, ua
from asyncua.server.address_space import AttributeValue, NodeData

from .plant import Method, Plant, Variable
from .values import fits, shape_of, variant

__all__ = ["ExtraNodes"]

_BITS = {"read": 1, "write": 2}
# Access rights of all users, and of this user.
_ACCESS = {"read_write": (3, 3), "read": (1, 1), "denied": (3, 0), "denied_writing": (3, 1), "hidden": (0, 0)}
_TEXTS = {"display_name": ua.AttributeIds.DisplayName, "description": ua.AttributeIds.Description}


class ExtraNodes:
    """The nodes that are added to a plant and removed again."""

    def __init__(self, server: Server, plant: Plant) -> None:
        self._server = server
        self._plant = plant
        self._added: list[ua.NodeId] = []
        self._names: dict[str, ua.NodeId] = {}
        self._links: list[tuple[ua.NodeId, ua.ReferenceDescription]] = []

    async def create(self, descriptions: Any) -> None:
        """Add nodes.

        Raises:
            ValueError: a description is not understood; the nodes before it have been added.
        """
        makers = {
            "folder": self._folder,
            "variable": self._variable,
            "method": self._method,
            "reference": self._reference,
        }
        if not isinstance(descriptions, list) or not all(
            isinstance(description, Mapping) for description in descriptions
        ):
            raise ValueError("create: expected a list of objects")
        for description in descriptions:
            kinds = [kind for kind in makers if kind in description]
            if len(kinds) != 1:
                raise ValueError(f"create: expected one of {', '.join(makers)}, found {sorted(description)}")
            try:
                await makers[kinds[0]](description)
            except (ua.UaError, TypeError, KeyError) as error:
                raise ValueError(
                    f"create {kinds[0]} {description[kinds[0]]!r}: {type(error).__name__} {error}"
                ) from None

    async def clear(self) -> None:
        """Remove everything that was added."""
        for node, reference in self._links:
            self._server.iserver.aspace[node].references.remove(reference)
        # The library is not used here: for each node it searches the whole address space.
        space = self._server.iserver.aspace
        removed: set[ua.NodeId] = set()
        neighbours: set[ua.NodeId] = set()
        waiting = list(self._added)
        while waiting:
            node = waiting.pop()
            if node in removed or node not in space:
                continue
            removed.add(node)
            for reference in space[node].references:
                neighbours.add(reference.NodeId)
                if reference.IsForward and reference.ReferenceTypeId == ua.NodeId(ua.ObjectIds.HasProperty):
                    waiting.append(reference.NodeId)
            del space[node]
        for node in neighbours - removed:
            kept = space.get(node)
            if kept is not None:
                kept.references[:] = [each for each in kept.references if each.NodeId not in removed]
        for node in self._added:
            for known in (self._plant.variables, self._plant.methods, self._plant.calls):
                known.pop(node, None)
        self._added.clear()
        self._names.clear()
        self._links.clear()

    async def _place(self, description: Mapping[str, Any], name: str) -> tuple[ua.NodeId, ua.QualifiedName]:
        index = self._plant.namespace
        if "namespace" in description:
            index = await self._server.register_namespace(str(description["namespace"]))
        shown = description.get("browse_name")
        return ua.NodeId(name, index), ua.QualifiedName(name, index) if shown is None else ua.QualifiedName.from_string(
            shown
        )

    def _known(self, name: str) -> ua.NodeId:
        found = self._names.get(name) or self._plant.folders.get(name)
        if found is None:
            raise ValueError(f"create: there is no folder or variable {name!r}")
        return found

    def _keep(self, name: str, node: ua.NodeId) -> None:
        self._added.append(node)
        self._names[name] = node

    async def _folder(self, description: Mapping[str, Any]) -> None:
        name = str(description["folder"])
        parent = self._server.get_node(self._known(description.get("in", "Plant")))
        self._keep(name, (await parent.add_folder(*await self._place(description, name))).nodeid)

    async def _variable(self, description: Mapping[str, Any]) -> None:
        name, kind = str(description["variable"]), ua.VariantType[description["type"]]
        value = variant(description["value"], kind)
        shape = shape_of(description["value"])
        rank, dimensions = int(description.get("rank", len(shape) or -1)), tuple(description.get("dimensions", ()))
        if value.Value is not None and not fits(value, kind, rank, list(dimensions)):
            raise ValueError(f"create: the value of {name!r} does not fit its rank and dimensions")
        everybody, user = _ACCESS[description.get("access", "read_write")]
        parent = self._server.get_node(self._known(description.get("in", "Plant")))
        add = parent.add_property if description.get("property") else parent.add_variable
        data_type = (
            ua.NodeId.from_string(description["data_type"]) if "data_type" in description else ua.NodeId(kind.value)
        )
        node = await add(*await self._place(description, name), value, kind, data_type)
        self._keep(name, node.nodeid)
        for attribute, number, width in (
            (ua.AttributeIds.ValueRank, rank, ua.VariantType.Int32),
            (ua.AttributeIds.AccessLevel, everybody, ua.VariantType.Byte),
            (ua.AttributeIds.UserAccessLevel, user, ua.VariantType.Byte),
            *(
                (attribute, ua.LocalizedText(description[member]), ua.VariantType.LocalizedText)
                for member, attribute in _TEXTS.items()
                if member in description
            ),
        ):
            await node.write_attribute(attribute, ua.DataValue(ua.Variant(number, width)))
        lengths = ua.Variant(list(dimensions), ua.VariantType.UInt32, is_array=True)
        await node.write_attribute(ua.AttributeIds.ArrayDimensions, ua.DataValue(lengths))
        if "display_name" in description:
            self._show(node.nodeid, parent.nodeid, description["display_name"])
        # The library loses the information that a value is an array (asyncua 2.1), so the value is set again.
        await self._plant.hold(node.nodeid, value)
        if "type_definition" in description:
            self._define(node.nodeid, parent.nodeid, ua.NodeId.from_string(description["type_definition"]))
        if description.get("property"):
            return
        low, high = description.get("range", (None, None))
        self._plant.variables[node.nodeid] = Variable(
            browse_name=name,
            parent=parent.nodeid,
            kind=kind,
            start=value,
            writable=everybody & _BITS["write"] != 0,
            rank=rank,
            dimensions=dimensions,
            range=(low, high),
        )
        siblings = self._server.iserver.aspace[parent.nodeid].references
        place = next(each for each in siblings if each.NodeId == node.nodeid)
        for number in range(1, int(description.get("copies", 0)) + 1):
            siblings.append(self._copy(place, f"{name}{number}"))

    def _show(self, node: ua.NodeId, parent: ua.NodeId, name: str) -> None:
        """Change the display name that a parent tells of a node."""
        for reference in self._server.iserver.aspace[parent].references:
            if reference.NodeId == node:
                reference.DisplayName = ua.LocalizedText(name)

    def _define(self, node: ua.NodeId, parent: ua.NodeId, kind: ua.NodeId) -> None:
        """Change the type definition of a variable."""
        space = self._server.iserver.aspace
        for reference in space[node].references:
            if reference.ReferenceTypeId == ua.NodeId(ua.ObjectIds.HasTypeDefinition):
                reference.NodeId = kind
        for reference in space[parent].references:
            if reference.NodeId == node:
                reference.TypeDefinition = kind

    def _copy(self, place: ua.ReferenceDescription, name: str) -> ua.ReferenceDescription:
        """Add a variable that is equal to the one at this place but for its name, and return its place.

        The library would take a millisecond for each.
        """
        space, source = self._server.iserver.aspace, place.NodeId
        node = ua.NodeId(name, source.NamespaceIndex)
        browse_name, display_name = ua.QualifiedName(name, source.NamespaceIndex), ua.LocalizedText(name)
        names = {
            ua.AttributeIds.NodeId: ua.Variant(node, ua.VariantType.NodeId),
            ua.AttributeIds.BrowseName: ua.Variant(browse_name, ua.VariantType.QualifiedName),
            ua.AttributeIds.DisplayName: ua.Variant(display_name, ua.VariantType.LocalizedText),
        }
        data = NodeData(node)
        for attribute, held in space[source].attributes.items():
            value = held.value if attribute not in names else replace(held.value, Value=names[attribute])
            data.attributes[attribute] = AttributeValue(value)
        data.references = list(space[source].references)
        space[node] = data
        self._plant.variables[node] = replace(self._plant.variables[source], browse_name=name)
        self._keep(name, node)
        return replace(place, NodeId=node, BrowseName=browse_name, DisplayName=display_name)

    async def _method(self, description: Mapping[str, Any]) -> None:
        name = str(description["method"])
        inputs = {f"Argument{number}": ua.VariantType[kind] for number, kind in enumerate(description["inputs"], 1)}
        told = description.get("returns")

        async def function(*arguments: Any) -> list[Any]:
            return list(arguments) if told is None else [told]

        outputs = inputs if told is None else {"Text": ua.VariantType.String}
        method = Method(owner=self._plant.folders["Methods"], inputs=inputs, outputs=outputs, function=function)
        self._keep(name, await self._plant.add_method(*await self._place(description, name), method))

    async def _reference(self, description: Mapping[str, Any]) -> None:
        source, target = self._known(description["reference"]), self._known(description["to"])
        space = self._server.iserver.aspace
        # The library is not used here: it refuses references that close a circle, but servers with circles exist.
        for node, other, forward in ((source, target, True), (target, source, False)):
            attributes = space[other].attributes
            reference = ua.ReferenceDescription(
                ReferenceTypeId=ua.NodeId(ua.ObjectIds.Organizes),
                IsForward=forward,
                NodeId=other,
                BrowseName=attributes[ua.AttributeIds.BrowseName].value.Value.Value,
                DisplayName=attributes[ua.AttributeIds.DisplayName].value.Value.Value,
                NodeClass=ua.NodeClass.Object,
                TypeDefinition=ua.NodeId(ua.ObjectIds.FolderType),
            )
            space[node].references.append(reference)
            self._links.append((node, reference))
