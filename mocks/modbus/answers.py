"""What a fault rule makes of an answer: its PDU and its MBAP header."""

from __future__ import annotations

import struct

from pytest_otmcp.wire.modbus import MASK_WRITE, READS, WRITE_COIL, WRITE_COILS, WRITE_REGISTER, WRITE_REGISTERS, frame

from .faults import Rule
from .pdu import read_response

__all__ = ["falsified"]


def falsified(rule: Rule, transaction: int, unit: int, pdu: bytes) -> bytes:
    """Return the frame that a rule makes of a right answer to a request with this header."""
    pdu = _falsified_pdu(rule, pdu)
    return frame(
        (transaction + rule.transaction_id) & 0xFFFF if rule.answer_transaction is None else rule.answer_transaction,
        unit if rule.answer_unit is None else rule.answer_unit,
        pdu,
        protocol=rule.protocol_id,
        length=(len(pdu) + 1 + rule.length) & 0xFFFF,
    )


def _falsified_pdu(rule: Rule, pdu: bytes) -> bytes:
    function = pdu[0]
    if rule.answer_values is not None and function in READS:
        pdu = read_response(function, rule.answer_values)
    changed = bytearray(pdu)
    if rule.byte_count and function in READS:
        changed[1] = (changed[1] + rule.byte_count) & 0xFF
    if function in (WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS, MASK_WRITE) and "address" in rule.echo:
        struct.pack_into(">H", changed, 1, rule.echo["address"])
    if function in (WRITE_COIL, WRITE_REGISTER) and "value" in rule.echo:
        struct.pack_into(">H", changed, 3, rule.echo["value"])
    if function in (WRITE_COILS, WRITE_REGISTERS) and "count" in rule.echo:
        struct.pack_into(">H", changed, 3, rule.echo["count"])
    if rule.answer_function is not None:
        changed[0] = rule.answer_function
    return bytes(changed)
