"""Sparkplug B payloads (Sparkplug 3.0, section 6.4) that the plant and the kit's pokes send."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.wire.mqtt.sparkplug import DATA_TYPES, payload_class

__all__ = ["DATATYPES", "DataSet", "encode_payload"]

DATATYPES = {name: number for number, name in enumerate(DATA_TYPES[:19]) if number}
"""Datatype indexes (section 6.4.16), as far as values are set or read here."""

_MEMBERS = {
    **dict.fromkeys(("Int8", "Int16", "Int32", "UInt8", "UInt16", "UInt32"), "int_value"),
    **dict.fromkeys(("Int64", "UInt64", "DateTime"), "long_value"),
    **dict.fromkeys(("String", "Text", "UUID"), "string_value"),
    "Float": "float_value",
    "Double": "double_value",
    "Boolean": "boolean_value",
    "Bytes": "bytes_value",
    "File": "bytes_value",
}
_BITS = {"int_value": 32, "long_value": 64}


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """A table of values.

    Attributes:
        types: a name of :data:`DATATYPES` for each column.
    """

    columns: tuple[str, ...]
    types: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    @classmethod
    def of(cls, source: Mapping[str, Any], read: Callable[[str, Any], Any]) -> DataSet:
        """Read it from JSON; ``read`` returns a value of a datatype.

        Raises:
            ValueError: it is not understood.
        """
        columns, types, rows = (source.get(name) for name in ("columns", "types", "rows"))
        if not (isinstance(columns, list) and isinstance(types, list) and isinstance(rows, list)):
            raise ValueError(f"a DataSet has lists of columns, types and rows, found {source!r}")
        if len(columns) != len(types) or any(not isinstance(row, list) or len(row) != len(types) for row in rows):
            raise ValueError("a DataSet has as many types, and values in each row, as columns")
        cells = tuple(tuple(map(read, types, row)) for row in rows)
        return cls(columns=tuple(map(str, columns)), types=tuple(types), rows=cells)

    def as_json(self, shown: Callable[[Any], Any]) -> dict[str, Any]:
        """Return it as JSON; ``shown`` makes a value JSON-safe."""
        rows = [[shown(cell) for cell in row] for row in self.rows]
        return {"columns": list(self.columns), "types": list(self.types), "rows": rows}


_Payload = payload_class()


def encode_payload(metrics: list[dict[str, Any]], *, timestamp: int, seq: int | None) -> bytes:
    """Return the bytes of a payload.

    Args:
        metrics: each with name, datatype (a key of :data:`DATATYPES`) and value, and optionally an alias. None for a name leaves
            it out, None for a value makes the metric null.
        timestamp: milliseconds since the epoch, of the payload and of every metric.
        seq: sequence number, None for NDEATH.
    """
    payload = _Payload(timestamp=timestamp)
    if seq is not None:
        payload.seq = seq
    for source in metrics:
        added = payload.metrics.add(timestamp=timestamp)
        if source.get("name") is not None:
            added.name = source["name"]
        if source.get("alias") is not None:
            added.alias = source["alias"]
        if source["datatype"] is not None:
            added.datatype = DATATYPES[source["datatype"]]
        if source["value"] is None:
            added.is_null = True
        elif isinstance(source["value"], DataSet):
            _add_data_set(added.dataset_value, source["value"])
        else:
            _set_value(added, source["datatype"], source["value"])
    data: bytes = payload.SerializeToString()
    return data


def _set_value(message: Any, datatype: str, value: Any) -> None:
    member = _MEMBERS[datatype]
    if member in _BITS:
        # Negative numbers travel as two's complement in an unsigned field (section 6.4.16).
        value &= (1 << _BITS[member]) - 1
    setattr(message, member, value)


def _add_data_set(message: Any, table: DataSet) -> None:
    message.num_of_columns = len(table.columns)
    message.columns.extend(table.columns)
    message.types.extend(DATATYPES[name] for name in table.types)
    for row in table.rows:
        added = message.rows.add()
        for datatype, value in zip(table.types, row, strict=True):
            cell = added.elements.add()
            if value is not None:
                _set_value(cell, datatype, value)
