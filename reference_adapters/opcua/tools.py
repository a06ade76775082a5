"""The seven tools. Every one makes as few service calls as the specification allows."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any
from urllib.parse import urlsplit

from asyncua import ua
from pydantic import Field

from ..core import AdapterError, AdapterServer, Arguments, Call, ConfigError, Environment
from .link import Link, NodeFacts
from .status import quality, refusal, trace_status
from .values import from_variant, timestamp, to_variant

__all__ = ["build"]

MAX_ITEMS = 1000
MAX_LEVELS = 32

NodeText = Annotated[str, Field(min_length=1, max_length=4096, description="such as ns=2;s=Temperature")]
Value = Any


class OneNode(Arguments):
    """One node."""

    node_id: NodeText


class Nodes(Arguments):
    """Several nodes."""

    node_ids: Annotated[list[NodeText], Field(min_length=1, max_length=MAX_ITEMS)]


class WriteNode(OneNode):
    """One node and the value to write, of the kind that the node's data type asks for."""

    value: Value


class WriteNodes(Arguments):
    """Several nodes and their values."""

    items: Annotated[list[WriteNode], Field(min_length=1, max_length=MAX_ITEMS)]


class CallMethod(Arguments):
    """A method, the object it belongs to, and its input arguments in order."""

    object_id: NodeText
    method_id: NodeText
    arguments: Annotated[list[Value], Field(max_length=100, default_factory=list)]


class Nothing(Arguments):
    """No arguments."""


def build() -> AdapterServer:
    """The adapter as the environment configures it.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    url = environment.text("OPCUA_URL", "opc.tcp://127.0.0.1:4840")
    parts = urlsplit(url)
    if parts.scheme != "opc.tcp" or not parts.hostname:
        raise ConfigError("OPCUA_URL: expected opc.tcp://host:port")
    link = Link(
        url,
        environment.seconds("OPCUA_TIMEOUT_S", 2.0),
        environment.optional("OPCUA_USERNAME"),
        environment.optional("OPCUA_PASSWORD"),
    )
    server = AdapterServer(
        name="opcua-reference",
        version="0.1.0",
        protocol="opcua",
        endpoint=f"opc.tcp://{parts.hostname}:{parts.port or 4840}",
        writes_enabled=environment.writes_enabled("OPCUA_WRITES_ENABLED"),
        switch="OPCUA_WRITES_ENABLED",
        deadline_s=environment.seconds("OPCUA_DEADLINE_S", 4.0),
        close=link.close,
    )

    async def read(
        call: Call, nodes: list[ua.NodeId], attribute: ua.AttributeIds = ua.AttributeIds.Value
    ) -> list[ua.DataValue]:
        parameters = ua.ReadParameters()
        parameters.NodesToRead = [ua.ReadValueId(NodeId=node, AttributeId=attribute) for node in nodes]
        results: list[ua.DataValue] = await link.service(call, lambda client: client.read(parameters))
        return results

    def reading(node: str, result: ua.DataValue) -> dict[str, Any]:
        status = result.StatusCode
        return {
            "node_id": node,
            **from_variant(result.Value),
            "status": status.name,
            "quality": quality(status),
            "source_timestamp": timestamp(result.SourceTimestamp),
            "server_timestamp": timestamp(result.ServerTimestamp),
        }

    # -- reading --------------------------------------------------------------------------------------------

    @server.tool("opcua.read")
    async def read_opcua_node(call: Call, arguments: OneNode) -> dict[str, Any]:
        """Read a variable's value with its status and timestamps."""
        (result,) = await read(call, [node_id(arguments.node_id, "/node_id")])
        status = result.StatusCode
        call.answered(service="Read", node_ids=[arguments.node_id], status_code=trace_status(status))
        if quality(status) == "bad":
            raise refusal(status, writes=False, field="/node_id")
        return reading(arguments.node_id, result)

    @server.tool("opcua.read_many")
    async def read_multiple_opcua_nodes(call: Call, arguments: Nodes) -> dict[str, Any]:
        """Read several variables in one request; every item has a result of its own."""
        nodes = [node_id(text, f"/node_ids/{index}") for index, text in enumerate(arguments.node_ids)]
        results = await read(call, nodes)
        call.answered(service="Read", node_ids=arguments.node_ids)
        items = []
        for text, result in zip(arguments.node_ids, results, strict=True):
            if quality(result.StatusCode) == "bad":
                items.append(failed_item(text, refusal(result.StatusCode, writes=False), writes=False))
            else:
                items.append({"success": True, **reading(text, result)})
        return all_or_partial(items)

    @server.tool("opcua.browse")
    async def browse_opcua_node_children(call: Call, arguments: OneNode) -> dict[str, Any]:
        """List the children of a node: their ids, names and classes."""
        (children,) = await browse(call, [node_id(arguments.node_id, "/node_id")])
        call.answered(service="Browse", node_ids=[arguments.node_id])
        return {"node_id": arguments.node_id, "children": [described(child) for child in children]}

    async def browse(call: Call, nodes: list[ua.NodeId]) -> list[list[ua.ReferenceDescription]]:
        """The hierarchical children of each node, continuation points followed to their end."""
        parameters = ua.BrowseParameters()
        parameters.NodesToBrowse = [
            ua.BrowseDescription(
                NodeId=node,
                BrowseDirection=ua.BrowseDirection.Forward,
                ReferenceTypeId=ua.NodeId(ua.ObjectIds.HierarchicalReferences),
                IncludeSubtypes=True,
                NodeClassMask=ua.NodeClass.Object | ua.NodeClass.Variable | ua.NodeClass.Method,
                ResultMask=ua.BrowseResultMask.All,
            )
            for node in nodes
        ]
        results = await link.service(call, lambda client: client.browse(parameters))
        found: list[list[ua.ReferenceDescription]] = []
        for result in results:
            if quality(result.StatusCode) == "bad":
                call.answered(status_code=trace_status(result.StatusCode))
                raise refusal(result.StatusCode, writes=False, field="/node_id")
            references, point = list(result.References), result.ContinuationPoint
            while point:
                following = ua.BrowseNextParameters(ContinuationPoints=[point])
                (page,) = await link.service(call, partial(_browse_next, following))
                references += page.References
                point = page.ContinuationPoint
            found.append(references)
        return found

    @server.tool("opcua.enumerate")
    async def get_all_variables(call: Call, arguments: Nothing) -> dict[str, Any]:
        """List every data variable below the Objects folder with its value: one Browse a level, one Read."""
        variables: dict[ua.NodeId, ua.ReferenceDescription] = {}
        seen: set[ua.NodeId] = set()
        level = [ua.NodeId(ua.ObjectIds.ObjectsFolder)]
        for _ in range(MAX_LEVELS):
            following = []
            for references in await browse(call, level):
                for reference in references:
                    node = reference.NodeId
                    # Namespace 0 is the server's own bookkeeping; a seen-set ends cycles.
                    if node in seen or node.NamespaceIndex == 0:
                        continue
                    seen.add(node)
                    if reference.NodeClass == ua.NodeClass.Variable:
                        if reference.ReferenceTypeId != ua.NodeId(ua.ObjectIds.HasProperty):
                            variables[node] = reference
                    elif reference.NodeClass == ua.NodeClass.Object:
                        following.append(node)
            if not following:
                break
            level = following
        results = await read(call, list(variables)) if variables else []
        call.answered(service="Read")
        listed = [
            {"browse_name": reference.BrowseName.Name, **reading(node.to_string(), result)}
            for (node, reference), result in zip(variables.items(), results, strict=True)
        ]
        return {"variables": listed, "count": len(listed)}

    # -- writing --------------------------------------------------------------------------------------------

    async def facts_of(call: Call, nodes: list[ua.NodeId]) -> list[NodeFacts]:
        """Data types and value ranks, read once a session in one request."""
        unknown = [node for node in dict.fromkeys(nodes) if node not in link.facts]
        if unknown:
            parameters = ua.ReadParameters()
            parameters.NodesToRead = [
                ua.ReadValueId(NodeId=node, AttributeId=attribute)
                for node in unknown
                for attribute in (ua.AttributeIds.DataType, ua.AttributeIds.ValueRank)
            ]
            with reading_only(call):
                results = await link.service(call, lambda client: client.read(parameters))
            for index, node in enumerate(unknown):
                kind, rank = results[2 * index : 2 * index + 2]
                if quality(kind.StatusCode) == "bad":
                    call.answered(status_code=trace_status(kind.StatusCode))
                    error = refusal(kind.StatusCode, writes=False)
                    error.outcome = "not_sent"
                    raise error
                link.facts[node] = NodeFacts(kind=built_in(kind.Value.Value), rank=rank.Value.Value)
        return [link.facts[node] for node in nodes]

    async def write(call: Call, nodes: list[ua.NodeId], variants: list[ua.Variant]) -> list[ua.StatusCode]:
        parameters = ua.WriteParameters()
        # Only the value: servers may refuse a client's status and timestamps (OPC 10000-4, 5.11.4).
        parameters.NodesToWrite = [
            ua.WriteValue(NodeId=node, AttributeId=ua.AttributeIds.Value, Value=ua.DataValue(variant))
            for node, variant in zip(nodes, variants, strict=True)
        ]
        statuses: list[ua.StatusCode] = await link.service(call, lambda client: client.write(parameters), changes=True)
        return statuses

    @server.tool("opcua.write", writes=True)
    async def write_opcua_node(call: Call, arguments: WriteNode) -> dict[str, Any]:
        """Write a variable's value; it must be of the kind that the node's data type asks for."""
        node = node_id(arguments.node_id, "/node_id")
        (facts,) = await facts_of(call, [node])
        variant = to_variant(arguments.value, facts.kind, facts.rank)
        (status,) = await write(call, [node], [variant])
        call.answered(service="Write", node_ids=[arguments.node_id], status_code=trace_status(status))
        if quality(status) == "bad":
            raise refusal(status, writes=True, field="/node_id")
        return {
            "node_id": arguments.node_id,
            "value": arguments.value,
            "data_type": facts.kind.name,
            "status": status.name,
        }

    @server.tool("opcua.write_many", writes=True)
    async def write_multiple_opcua_nodes(call: Call, arguments: WriteNodes) -> dict[str, Any]:
        """Write several variables in one request. Nothing is written when one of the values does not fit."""
        nodes = [node_id(item.node_id, f"/items/{index}/node_id") for index, item in enumerate(arguments.items)]
        facts = await facts_of(call, nodes)
        variants = [
            to_variant(item.value, fact.kind, fact.rank) for item, fact in zip(arguments.items, facts, strict=True)
        ]
        statuses = await write(call, nodes, variants)
        call.answered(service="Write", node_ids=[item.node_id for item in arguments.items])
        items = []
        for item, status in zip(arguments.items, statuses, strict=True):
            if quality(status) == "bad":
                items.append(failed_item(item.node_id, refusal(status, writes=True), writes=True))
            else:
                done = {"node_id": item.node_id, "value": item.value, "status": status.name}
                items.append({"success": True, **done})
        return all_or_partial(items)

    @server.tool("opcua.call", writes=True, idempotent=False)
    async def call_opcua_method(call: Call, arguments: CallMethod) -> dict[str, Any]:
        """Call a method. Arguments are checked against its declaration before anything is sent."""
        parent = node_id(arguments.object_id, "/object_id")
        method = node_id(arguments.method_id, "/method_id")
        kinds = await input_types(call, method)
        if len(kinds) != len(arguments.arguments):
            message = f"the method takes {len(kinds)} argument(s), {len(arguments.arguments)} given"
            raise AdapterError("invalid_input", message, outcome="not_sent", field="/arguments")
        request = ua.CallMethodRequest(
            ObjectId=parent,
            MethodId=method,
            InputArguments=[
                to_variant(value, kind, -1) for value, kind in zip(arguments.arguments, kinds, strict=True)
            ],
        )
        (result,) = await link.service(call, lambda client: client.call([request]), changes=True)
        status = result.StatusCode
        call.answered(service="Call", node_ids=[arguments.method_id], status_code=trace_status(status))
        if quality(status) == "bad":
            raise refusal(status, writes=True, field="/method_id")
        return {
            "method_id": arguments.method_id,
            "outputs": [from_variant(output) for output in result.OutputArguments],
            "status": status.name,
        }

    async def input_types(call: Call, method: ua.NodeId) -> list[ua.VariantType]:
        if method not in link.inputs:
            with reading_only(call):
                (properties,) = await browse(call, [method])
                declared = [child.NodeId for child in properties if child.BrowseName.Name == "InputArguments"]
                (value,) = await read(call, declared) if declared else (None,)
            arguments = value.Value.Value if value is not None and value.Value is not None else None
            link.inputs[method] = [built_in(argument.DataType) for argument in arguments or []]
        return link.inputs[method]

    return server


async def _browse_next(parameters: ua.BrowseNextParameters, client: Any) -> list[ua.BrowseResult]:
    results: list[ua.BrowseResult] = await client.browse_next(parameters)
    return results


class reading_only:
    """While a writing tool only reads, nothing that it sends can change anything."""

    def __init__(self, call: Call) -> None:
        self._call = call

    def __enter__(self) -> None:
        self._call.writes = False

    def __exit__(self, *exc: object) -> None:
        self._call.writes = True
        self._call.sent = False


def node_id(text: str, field: str) -> ua.NodeId:
    """Parse a node id.

    Raises:
        AdapterError: it is none.
    """
    try:
        node = ua.NodeId.from_string(text)
    except (ua.UaError, ValueError, KeyError, IndexError):
        node = None
    if node is None or "=" not in text:
        raise AdapterError("invalid_input", "not a node id such as ns=2;s=Name or ns=2;i=42", field=field)
    return node


def built_in(data_type: ua.NodeId) -> ua.VariantType:
    """The built-in type of a data type node; enumerations are Int32 (OPC 10000-3, 8.14)."""
    if data_type.NamespaceIndex == 0 and isinstance(data_type.Identifier, int) and 1 <= data_type.Identifier <= 25:
        return ua.VariantType(data_type.Identifier)
    if data_type == ua.NodeId(ua.ObjectIds.Enumeration):
        return ua.VariantType.Int32
    raise AdapterError("unsupported_operation", "the node's data type is not offered", outcome="not_sent")


def described(reference: ua.ReferenceDescription) -> dict[str, Any]:
    """A child as browsing lists it."""
    return {
        "node_id": reference.NodeId.to_string(),
        "browse_name": reference.BrowseName.Name,
        "display_name": reference.DisplayName.Text,
        "node_class": reference.NodeClass.name,
    }


def failed_item(node: str, error: AdapterError, *, writes: bool) -> dict[str, Any]:
    """An item of a batch that did not succeed."""
    return {"node_id": node, "success": False, "error": error.as_error(writes=writes, sent=writes)}


def all_or_partial(items: list[dict[str, Any]]) -> dict[str, Any]:
    """The items, if all succeeded.

    Raises:
        AdapterError: ``partial_failure`` with every item's own result.
    """
    failures = sum(not item["success"] for item in items)
    if failures:
        message = f"{failures} of {len(items)} items failed; see data.partial"
        raise AdapterError("partial_failure", message, outcome="partial", partial={"items": items})
    return {"items": items}
