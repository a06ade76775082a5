"""Defects of an OPC UA adapter."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from ..core import AdapterError, AdapterServer, Call
from ..opcua import services, tools
from .mutant import Data, Mutant, also, failing, told

__all__ = ["MUTANTS", "heartbeat"]


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


MUTANTS = (
    Mutant(
        id="MU-53o",
        protocol="opcua",
        sentence="The tool that browses writes a heartbeat.",
        bend=also("browse_opcua_node_children", action=heartbeat),
        items="O2",
        requirements="MCP-008",
    ),
    Mutant(
        id="MU-57",
        protocol="opcua",
        sentence="Values are rounded to two decimals.",
        bend=told("read_opcua_node", "read_multiple_opcua_nodes", change=_rounded),
        items="O1 X1 X1p FO1 S3 S6 S9",
        requirements="CON-004 ENC-003",
    ),
    Mutant(
        id="MU-80b",
        protocol="opcua",
        sentence="Every number is written as Int64, whatever the node's data type.",
        bend=always_int64,
        items="O3 X2 X2p FO2 S6",
        requirements="OUA-001 WR-001",
    ),
    Mutant(
        id="MU-118",
        protocol="opcua",
        sentence="Every Bad status becomes protocol_error.",
        bend=failing(change=_without_symbols),
        items="FO1 FX1",
        requirements="ERR-003",
    ),
    Mutant(
        id="MU-129",
        protocol="opcua",
        sentence="A status and a SourceTimestamp are written with every value.",
        bend=writes_status_and_timestamp,
        items="O3 X2 X2p S6",
        requirements="OUA-005",
        quick=True,
    ),
)
