"""The seven tools. Every one makes as few service calls as the specification allows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

from asyncua import ua

from ..core import AdapterError, AdapterServer, Call, ConfigError, Environment
from .enumeration import find_variables
from .link import Link, Session
from .nodes import parse_node
from .services import Services
from .shapes import (
    Called,
    CallMethod,
    Child,
    Children,
    Items,
    Nodes,
    Nothing,
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

__all__ = ["build"]

Mask = ua.BrowseResultMask
_DEFAULT_PORT = 4840


def build() -> AdapterServer:
    """The adapter as the environment configures it.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    url = environment.text("OPCUA_URL", f"opc.tcp://127.0.0.1:{_DEFAULT_PORT}")
    endpoint = _endpoint(url)
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
        endpoint=endpoint,
        writes_enabled=environment.writes_enabled("OPCUA_WRITES_ENABLED"),
        switch="OPCUA_WRITES_ENABLED",
        deadline_s=environment.seconds("OPCUA_DEADLINE_S", 4.0),
        close=link.close,
    )

    # -- reading --------------------------------------------------------------------------------------------

    @server.tool("opcua.read")
    async def read_opcua_node(call: Call, arguments: OneNode) -> Reading:
        """Read a variable's value with its status and timestamps."""
        name = parse_node(arguments.node_id, "/node_id")

        async def work(session: Session) -> Reading:
            services = Services(session, call)
            node = await services.node(name)
            (result,) = await services.read([node])
            call.answered(node_ids=[node.to_string()], status_code=trace_status(result.StatusCode))
            if quality(result.StatusCode) == "bad":
                raise refusal(result.StatusCode, writes=False, field=name.field)
            return _reading(name.text, result, cleaner(call, "/data/value"))

        return await link.perform(call, work)

    @server.tool("opcua.read_many")
    async def read_multiple_opcua_nodes(call: Call, arguments: Nodes) -> Items:
        """Read several variables in one request; every item has a result of its own."""
        names = [parse_node(text, f"/node_ids/{index}") for index, text in enumerate(arguments.node_ids)]

        async def work(session: Session) -> Items:
            services = Services(session, call)
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

        return await link.perform(call, work)

    @server.tool("opcua.browse")
    async def browse_opcua_node_children(call: Call, arguments: OneNode) -> Children:
        """List the children of a node: their ids, names and classes."""
        name = parse_node(arguments.node_id, "/node_id")

        async def work(session: Session) -> Children:
            services = Services(session, call)
            node = await services.node(name)
            result = Mask.BrowseName | Mask.DisplayName | Mask.NodeClass
            (children,) = await services.browse([node], fields=[name.field], result=result)
            call.answered(node_ids=[node.to_string()])
            clean = cleaner(call, "/data/children")
            return {"node_id": name.text, "children": [_child(child, clean) for child in children]}

        return await link.perform(call, work)

    @server.tool("opcua.enumerate")
    async def get_all_variables(call: Call, arguments: Nothing) -> Variables:
        """List every data variable below the Objects folder with its value."""

        async def work(session: Session) -> Variables:
            services = Services(session, call)
            found = await find_variables(services, call, session.leaves)
            results = await services.read(list(found)) if found else []
            clean = cleaner(call, "/data/variables")
            return {
                "variables": [
                    {"browse_name": clean(name.Name), **_reading(clean(node.to_string()), result, clean)}
                    for (node, name), result in zip(found.items(), results, strict=True)
                ],
                "count": len(found),
            }

        return await link.perform(call, work)

    # -- writing --------------------------------------------------------------------------------------------

    @server.tool("opcua.write", writes=True)
    async def write_opcua_node(call: Call, arguments: WriteNode) -> Written:
        """Write a variable's value; it must be of the kind that the node's data type asks for."""
        name = parse_node(arguments.node_id, "/node_id")

        async def work(session: Session) -> Written:
            services = Services(session, call)
            node = await services.node(name)
            (facts,) = await services.facts([node], [name.field])
            value = to_variant(arguments.value, facts.kind, facts.rank, facts.dimensions, "/value")
            (status,) = await services.write([node], [value])
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
                (held,) = await services.read([node])
                written["clamped"] = True
                written["value"] = from_variant(held.Value, cleaner(call, "/data/value"))["value"]
            if status.name == "GoodCompletesAsynchronously":
                written["verified"] = call.extra["verified"] = False
            return written

        return await link.perform(call, work)

    @server.tool("opcua.write_many", writes=True)
    async def write_multiple_opcua_nodes(call: Call, arguments: WriteNodes) -> Items:
        """Write several variables in one request. Nothing is written when one of them is unknown or its value does not
        fit; what the server refuses has its reason in an item of its own."""
        items = arguments.items
        names = [parse_node(item.node_id, f"/items/{index}/node_id") for index, item in enumerate(items)]

        async def work(session: Session) -> Items:
            services = Services(session, call)
            nodes = [await services.node(name) for name in names]
            facts = await services.facts(nodes, [name.field for name in names])
            values = [
                to_variant(item.value, fact.kind, fact.rank, fact.dimensions, f"/items/{index}/value")
                for index, (item, fact) in enumerate(zip(items, facts, strict=True))
            ]
            statuses = await services.write(nodes, values)
            call.answered(node_ids=[node.to_string() for node in nodes])
            return _all_or_partial(
                call,
                [
                    _failed(item.node_id, status, changes=True)
                    if quality(status) == "bad"
                    else {"success": True, "node_id": item.node_id, "value": item.value, "status": status.name}
                    for item, status in zip(items, statuses, strict=True)
                ],
            )

        return await link.perform(call, work)

    @server.tool("opcua.call", writes=True, idempotent=False)
    async def call_opcua_method(call: Call, arguments: CallMethod) -> Called:
        """Call a method. Arguments are checked against its declaration before anything is sent."""
        owner_name = parse_node(arguments.object_id, "/object_id")
        method_name = parse_node(arguments.method_id, "/method_id")

        async def work(session: Session) -> Called:
            services = Services(session, call)
            owner, method = await services.node(owner_name), await services.node(method_name)
            inputs = await services.method_inputs(method)
            if len(inputs) != len(arguments.arguments):
                message = f"the method takes {len(inputs)} argument(s), {len(arguments.arguments)} given"
                raise AdapterError("invalid_input", message, outcome="not_sent", field="/arguments")
            values = [
                to_variant(value, fact.kind, fact.rank, fact.dimensions, f"/arguments/{index}")
                for index, (value, fact) in enumerate(zip(arguments.arguments, inputs, strict=True))
            ]
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

        return await link.perform(call, work)

    return server


def _endpoint(url: str) -> str:
    """The URL without credentials and with its port.

    Raises:
        ConfigError: it is none.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or _DEFAULT_PORT
    except ValueError:
        host = None
    if not host or parts.scheme != "opc.tcp":
        raise ConfigError("OPCUA_URL: expected opc.tcp://host:port")
    return f"opc.tcp://{f'[{host}]' if ':' in host else host}:{port}"


def _reading(node: str, result: ua.DataValue, clean: Callable[[str | None], str]) -> Reading:
    status = result.StatusCode
    severity = quality(status)
    return {
        "node_id": node,
        # The value of a Bad status is not one.
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


def _failed(node: str, status: ua.StatusCode, *, changes: bool) -> dict[str, Any]:
    error = refusal(status, writes=changes, changes=changes)
    return {"node_id": node, "success": False, "error": error.as_error(writes=changes, sent=changes)}


def _all_or_partial(call: Call, items: list[dict[str, Any]]) -> Items:
    """The items, if all succeeded.

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
