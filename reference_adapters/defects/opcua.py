"""Defects of an OPC UA adapter."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from ..core import AdapterError, AdapterServer, Call
from ..opcua import services, tools
from .defect import Data, also, defect, failing, told

__all__ = ["DEFECTS", "heartbeat"]


def _rounded(data: Data) -> Data:
    items = data.get("items", [data])
    for item in items:
        if isinstance(item["value"], float):
            item["value"] = round(item["value"], 2)
    return data


def always_int64(server: AdapterServer) -> None:
    genuine = tools._variant

    def variant(value: Any, facts: Any, field: str) -> ua.Variant:
        genuine(value, facts, field)
        return ua.Variant(int(value), ua.VariantType.Int64)

    tools._variant = variant


def _without_symbols(call: Call, error: AdapterError) -> Exception | None:
    refused = "status_code" in call.trace
    return AdapterError("protocol_error", "the server refused it", outcome=error.outcome) if refused else None


async def heartbeat(server: AdapterServer, call: Call) -> None:
    write = server._tools["write_opcua_node"]
    await write.handler(call, write.model(node_id="ns=2;s=FanSpeed", value=1.0))


def writes_status_and_timestamp(server: AdapterServer) -> None:
    class Timed:
        """The types as the services see them; values to be written get a status and the present time."""

        def __getattr__(self, name: str) -> Any:
            return getattr(ua, name)

        def WriteValue(self, *, Value: ua.DataValue, **members: Any) -> ua.WriteValue:
            now = datetime.now(UTC).replace(tzinfo=None)
            timed = ua.DataValue(
                Value.Value, StatusCode=ua.StatusCode(ua.StatusCodes.GoodLocalOverride), SourceTimestamp=now
            )
            return ua.WriteValue(Value=timed, **members)

    services.ua = Timed()


DEFECTS = (
    defect(
        "MU-53o",
        "opcua",
        "The tool that browses writes a heartbeat.",
        also("browse_opcua_node_children", action=heartbeat),
        "O2",
        "MCP-008",
    ),
    defect(
        "MU-57",
        "opcua",
        "Values are rounded to two decimals.",
        told("read_opcua_node", "read_multiple_opcua_nodes", change=_rounded),
        "O1 X1 X1p FO1 S3 S6 S9",
        "CON-004 ENC-003",
    ),
    defect(
        "MU-80b",
        "opcua",
        "Every number is written as Int64, whatever the node's data type.",
        always_int64,
        "O3 X2 X2p FO2 S6",
        "OUA-001 WR-001",
    ),
    defect(
        "MU-118",
        "opcua",
        "Every Bad status becomes protocol_error.",
        failing(change=_without_symbols),
        "FO1 FX1",
        "ERR-003",
    ),
    defect(
        "MU-129",
        "opcua",
        "A status and a SourceTimestamp are written with every value.",
        writes_status_and_timestamp,
        "O3 X2 X2p S6",
        "OUA-005",
    ),
)
