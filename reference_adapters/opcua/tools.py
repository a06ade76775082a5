"""The seven OPC UA tools. Each makes as few service calls as the specification allows."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from asyncua import ua

from ..core import AdapterError, Call, Nothing, tool
from .enumeration import find_variables
from .link import Link, NodeFacts
from .nodes import parse_node
from .services import Services
from .shapes import (
    Called,
    CallMethod,
    Child,
    Children,
    Items,
    Nodes,
    OneNode,
    Reading,
    Variables,
    WriteNode,
    WriteNodes,
    Written,
)
from .status import quality, refusal, trace_status
from .texts import cleaner
from .values import from_variant, timestamp, to_variant

__all__ = ["Tools"]

T = TypeVar("T")
Mask = ua.BrowseResultMask


class Tools:
    """The tools over one session."""

    def __init__(self, link: Link) -> None:
        self._link = link

    async def _perform(self, call: Call, work: Callable[[Services], Awaitable[T]]) -> T:
        """Do a tool's work with the services of a session; repeat it if the session was lost before any change."""
        return await self._link.perform(call, lambda session: work(Services(session, call)))

    async def present(self, call: Call, target: str) -> object:
        """Return what a target of :meth:`Call.changes` holds."""
        return (await self.read_opcua_node(call, OneNode(node_id=target)))["value"]

    # -- reading ------------------------------------------------------------------------------------------

    @tool("opcua.read")
    async def read_opcua_node(self, call: Call, arguments: OneNode) -> Reading:
        """Read a variable's value with its status and timestamps."""
        name = parse_node(arguments.node_id, "/node_id")

        async def work(services: Services) -> Reading:
            node = await services.node(name)
            (result,) = await services.read([node])
            call.answered(node_ids=[node.to_string()], status_code=trace_status(result.StatusCode))
            if quality(result.StatusCode) == "bad":
                raise refusal(result.StatusCode, writes=False, field=name.field)
            return _reading(name.text, result, cleaner(call, "/data/value"))

        return await self._perform(call, work)

    @tool("opcua.read_many")
    async def read_multiple_opcua_nodes(self, call: Call, arguments: Nodes) -> Items:
        """Read several variables in one request; every item has a result of its own."""
        names = [parse_node(text, f"/node_ids/{index}") for index, text in enumerate(arguments.node_ids)]

        async def work(services: Services) -> Items:
            nodes = [await services.node(name) for name in names]
            results = await services.read(nodes)
            call.answered(node_ids=[node.to_string() for node in nodes])
            clean = cleaner(call, "/data/items")
            items: list[dict[str, Any]] = []
            for name, result in zip(names, results, strict=True):
                if quality(result.StatusCode) == "bad":
                    items.append(_failed(name.text, result.StatusCode, changes=False))
                else:
                    items.append({"success": True, **_reading(name.text, result, clean)})
            return _all_or_partial(call, items)

        return await self._perform(call, work)

    @tool("opcua.browse")
    async def browse_opcua_node_children(self, call: Call, arguments: OneNode) -> Children:
        """List the children of a node: their ids, names and classes."""
        name = parse_node(arguments.node_id, "/node_id")

        async def work(services: Services) -> Children:
            node = await services.node(name)
            result = Mask.BrowseName | Mask.DisplayName | Mask.NodeClass
            (children,) = await services.browse([node], fields=[name.field], result=result)
            call.answered(node_ids=[node.to_string()])
            clean = cleaner(call, "/data/children")
            return {"node_id": name.text, "children": [_child(child, clean) for child in children]}

        return await self._perform(call, work)

    @tool("opcua.enumerate")
    async def get_all_variables(self, call: Call, arguments: Nothing) -> Variables:
        """List every data variable below the Objects folder with its value."""

        async def work(services: Services) -> Variables:
            found = await find_variables(services, call)
            results = await services.read(list(found)) if found else []
            clean = cleaner(call, "/data/variables")
            return {
                "variables": [
                    {"browse_name": clean(name.Name), **_reading(clean(node.to_string()), result, clean)}
                    for (node, name), result in zip(found.items(), results, strict=True)
                ],
                "count": len(found),
            }

        return await self._perform(call, work)

    # -- writing ------------------------------------------------------------------------------------------

    @tool("opcua.write", writes=True)
    async def write_opcua_node(self, call: Call, arguments: WriteNode) -> Written:
        """Write a variable's value; it must be of the kind that the node's data type asks for."""
        name = parse_node(arguments.node_id, "/node_id")

        async def work(services: Services) -> Written:
            node = await services.node(name)
            (facts,) = await services.facts([node], [name.field])
            (status,) = await services.write([node], [_variant(arguments.value, facts, "/value")])
            call.answered(node_ids=[node.to_string()], status_code=trace_status(status))
            if quality(status) == "bad":
                raise refusal(status, writes=True, changes=True, field=name.field)
            written: Written = {
                "node_id": name.text,
                "value": arguments.value,
                "data_type": facts.kind.name,
                "status": status.name,
            }
            if status.name == "GoodClamped":
                held = await _held(services, node)
                written["clamped"] = True
                written["value"] = from_variant(held.Value, cleaner(call, "/data/value"))["value"]
            if status.name == "GoodCompletesAsynchronously":
                written["verified"] = call.extra["verified"] = False
            return written

        return await self._perform(call, work)

    @tool("opcua.write_many", writes=True)
    async def write_multiple_opcua_nodes(self, call: Call, arguments: WriteNodes) -> Items:
        """Write several variables in one request. Nothing is written when one of them is unknown or its value does not
        fit; what the server refuses has its reason in an item of its own."""
        items = arguments.items
        names = [parse_node(item.node_id, f"/items/{index}/node_id") for index, item in enumerate(items)]

        async def work(services: Services) -> Items:
            nodes = [await services.node(name) for name in names]
            facts = await services.facts(nodes, [name.field for name in names])
            values = [
                _variant(item.value, fact, f"/items/{index}/value")
                for index, (item, fact) in enumerate(zip(items, facts, strict=True))
            ]
            statuses = await services.write(nodes, values)
            call.answered(node_ids=[node.to_string() for node in nodes])
            results = [_written(item, status) for item, status in zip(items, statuses, strict=True)]
            return _all_or_partial(call, results)

        return await self._perform(call, work)

    @tool("opcua.call", writes=True, idempotent=False)
    async def call_opcua_method(self, call: Call, arguments: CallMethod) -> Called:
        """Call a method. Arguments are checked against its declaration before anything is sent."""
        owner_name = parse_node(arguments.object_id, "/object_id")
        method_name = parse_node(arguments.method_id, "/method_id")

        async def work(services: Services) -> Called:
            owner, method = await services.node(owner_name), await services.node(method_name)
            values = _input_arguments(arguments.arguments, await services.method_inputs(method))
            request = ua.CallMethodRequest(ObjectId=owner, MethodId=method, InputArguments=values)
            result = await services.call_method(request)
            status = result.StatusCode
            call.answered(node_ids=[method.to_string()], status_code=trace_status(status))
            if quality(status) == "bad":
                refused = [each.name for each in result.InputArgumentResults or []]
                details = {"arguments": refused} if refused else None
                raise refusal(status, writes=True, changes=True, field=method_name.field, details=details)
            clean = cleaner(call, "/data/outputs")
            outputs = [from_variant(output, clean) for output in result.OutputArguments or []]
            return {"method_id": method_name.text, "outputs": outputs, "status": status.name}

        return await self._perform(call, work)


def _variant(value: Any, facts: NodeFacts, field: str) -> ua.Variant:
    return to_variant(value, facts.kind, facts.rank, facts.dimensions, field)


def _input_arguments(values: list[Any], inputs: list[NodeFacts]) -> list[ua.Variant]:
    """Return the input arguments of a method call.

    Raises:
        AdapterError: the values do not fit the arguments that the method declares.
    """
    if len(inputs) != len(values):
        message = f"the method takes {len(inputs)} argument(s), {len(values)} given"
        raise AdapterError("invalid_input", message, outcome="not_sent", field="/arguments")
    return [
        _variant(value, facts, f"/arguments/{index}")
        for index, (value, facts) in enumerate(zip(values, inputs, strict=True))
    ]


async def _held(services: Services, node: ua.NodeId) -> ua.DataValue:
    """Return what a variable holds after the server has changed the value that was written."""
    try:
        (held,) = await services.read([node])
    except AdapterError as error:
        message = f"the server took another value than was written, and does not say which: {error.message}"
        raise AdapterError("verify_failed", message) from None
    return held


def _reading(node: str, result: ua.DataValue, clean: Callable[[str | None], str]) -> Reading:
    status = result.StatusCode
    severity = quality(status)
    return {
        "node_id": node,
        # The value that comes with a Bad status is not valid.
        **from_variant(None if severity == "bad" else result.Value, clean),
        "status": status.name,
        "quality": severity,
        "source_timestamp": timestamp(result.SourceTimestamp),
        "server_timestamp": timestamp(result.ServerTimestamp),
    }


def _child(reference: ua.ReferenceDescription, clean: Callable[[str | None], str]) -> Child:
    return {
        "node_id": clean(reference.NodeId.to_string()),
        "browse_name": clean(reference.BrowseName.Name),
        "display_name": clean(reference.DisplayName.Text),
        "node_class": reference.NodeClass.name,
    }


def _written(item: WriteNode, status: ua.StatusCode) -> dict[str, Any]:
    if quality(status) == "bad":
        return _failed(item.node_id, status, changes=True)
    return {"success": True, "node_id": item.node_id, "value": item.value, "status": status.name}


def _failed(node: str, status: ua.StatusCode, *, changes: bool) -> dict[str, Any]:
    error = refusal(status, writes=changes, changes=changes)
    return {"node_id": node, "success": False, "error": error.as_error(writes=changes, sent=changes)}


def _all_or_partial(call: Call, items: list[dict[str, Any]]) -> Items:
    """Return the items if all succeeded.

    Raises:
        AdapterError: ``partial_failure`` with every item's own result.
    """
    failures = sum(not item["success"] for item in items)
    if not failures:
        return {"items": items}
    if "untrusted" in call.extra:
        call.extra["untrusted"] = ["/data/partial/items"]
    message = f"{failures} of {len(items)} items failed; see data.partial"
    outcomes = {"applied" if item["success"] else item["error"]["outcome"] for item in items}
    outcome = None if not call.writes else "rejected" if outcomes == {"rejected"} else "partial"
    raise AdapterError("partial_failure", message, outcome=outcome, partial={"items": items})
