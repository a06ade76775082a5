"""One slave: the memory of its slave controller, its EEPROM, its state machine, its mailbox, and its process data.

The registers are those of the public data sheets of slave controllers (Beckhoff ET1100, section II). There are no distributed clocks.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from pytest_otmcp.wire.ethercat import (
    AL_CONTROL,
    AL_STATUS,
    INPUTS,
    LOGICAL,
    MAILBOX_BYTES,
    MAILBOX_IN,
    MAILBOX_OUT,
    OUTPUTS,
    READS,
    STATE_BITS,
    STATES,
    WRITES,
    Datagram,
    has_counter,
)

from .objects import Dictionary

__all__ = ["OP", "WATCHDOG", "Slave"]

INIT, PREOP, SAFEOP, OP, FAULT = 1, 2, 4, 8, 0x10
INVALID_CHANGE, WATCHDOG = 0x0011, 0x001B
"""AL status codes (ETG.1000.6, table 11)."""
_STATES = (INIT, PREOP, SAFEOP, OP)
_NEXT = {INIT: PREOP, PREOP: SAFEOP, SAFEOP: OP}
_STATION, _DL_STATUS, _AL_CODE = 0x0010, 0x0110, 0x0134
_EEPROM_CONTROL, _EEPROM_ADDRESS, _EEPROM_DATA = 0x0502, 0x0504, 0x0508
_FMMUS, _SYNC_MANAGERS = 0x0600, 0x0800
_DIVIDER, _WATCHDOG_TIME = 0x0400, 0x0420
_LAST, _PASSING = 0x5611, 0x5A31
"""States of the ports: one or two of four have somebody at the other end."""
_REPEAT = 0x02
_WATCHED = 0x40
"""Bit of a sync manager's control byte: what it takes feeds the watchdog."""
_READ_ONLY = (range(0x0000, 0x0010), range(0x0110, 0x0120), range(AL_STATUS, AL_STATUS + 8))


class Slave:
    """One slave.

    Args:
        objects: its dictionary.
        outputs, inputs: bytes of its process data.
        posted: is called when the master has put something into the mailbox.
        last: no slave comes behind it.

    Attributes:
        state: of the state machine, with the bit that tells of an error.
        refuses: AL status code with which it refuses OP; None where it does not.
        present: it is on the line.
    """

    def __init__(
        self, objects: Dictionary, outputs: int, inputs: int, posted: Callable[[bytes], None], *, last: bool
    ) -> None:
        self.objects = objects
        self.output_bytes, self.input_bytes = outputs, inputs
        self.refuses: int | None = None
        self.present = True
        self._posted, self._last = posted, b""
        self._eeprom = _eeprom(objects, outputs, inputs)
        self.memory = memory = bytearray(0x2000)
        memory[0:10] = bytes([0x11, 0, 1, 0, 3, 4, 8, 0x0F, 0, 0])
        struct.pack_into("<H", memory, _DL_STATUS, _LAST if last else _PASSING)
        struct.pack_into("<H", memory, _DIVIDER, 0x09C2)
        struct.pack_into("<H", memory, _WATCHDOG_TIME, 1000)
        memory[AL_STATUS] = INIT

    @property
    def state(self) -> int:
        return self.memory[AL_STATUS] & STATE_BITS

    @property
    def inputs(self) -> bytes:
        return bytes(self.memory[INPUTS : INPUTS + self.input_bytes])

    @inputs.setter
    def inputs(self, content: bytes) -> None:
        self.memory[INPUTS : INPUTS + self.input_bytes] = content

    @property
    def outputs(self) -> bytes:
        return bytes(self.memory[OUTPUTS : OUTPUTS + self.output_bytes])

    @outputs.setter
    def outputs(self, content: bytes) -> None:
        self.memory[OUTPUTS : OUTPUTS + self.output_bytes] = content

    @property
    def watchdog_s(self) -> float | None:
        """Seconds after which it gives its outputs up that nobody repeats; None where it does not."""
        divider, count = (struct.unpack_from("<H", self.memory, at)[0] for at in (_DIVIDER, _WATCHDOG_TIME))
        watched = self.memory[_SYNC_MANAGERS + 2 * 8 + 4] & _WATCHED
        return count * (divider + 2) * 40e-9 if count and watched else None

    def image(self) -> dict[str, Any]:
        """Return state, AL status code and watchdog."""
        (code,) = struct.unpack_from("<H", self.memory, _AL_CODE)
        state = STATES.get(self.state, "none")
        return {"state": state, "error": code, "watchdog_s": self.watchdog_s if self.state == OP else None}

    def fall(self, code: int) -> None:
        """Leave OP for SAFEOP with an error; the outputs are cleared."""
        self.outputs = bytes(self.output_bytes)
        self._become(min(self.state, SAFEOP), code)

    def is_addressed(self, datagram: Datagram) -> bool:
        """Tell whether a datagram is for this slave, its position counted down already."""
        if datagram.command in (1, 2, 3):
            return datagram.position == 0
        if datagram.command in (4, 5, 6):
            return datagram.position == int.from_bytes(self.memory[_STATION : _STATION + 2], "little")
        return True

    def sent(self, datagram: Datagram) -> bytes:
        """Return the outputs that it has after a datagram, if it is in OP."""
        before = self.outputs
        if self.state != OP or datagram.command not in WRITES or not self.is_addressed(datagram):
            return before
        after = bytearray(before)
        for start, data in self._places(datagram, write=True):
            for at, byte in enumerate(data, start=start - OUTPUTS):
                if 0 <= at < len(after):
                    after[at] = byte
        return bytes(after)

    def at(self, datagram: Datagram, number: int) -> bool:
        """Tell whether a datagram that no slave has got yet is for this one, which is at a position of the line."""
        if datagram.command in (1, 2, 3):
            return datagram.position == -number & 0xFFFF
        return self.is_addressed(datagram)

    def drives(self, datagram: Datagram) -> bool:
        """Tell whether a datagram has outputs of this slave."""
        if datagram.command not in WRITES or not (datagram.command in LOGICAL or self.is_addressed(datagram)):
            return False
        return any(
            place < OUTPUTS + self.output_bytes and place + len(data) > OUTPUTS
            for place, data in self._places(datagram, write=True)
        )

    def take_over(self, before: Slave) -> None:
        """Take over how a master has set this slave up; what is in OP leaves it, with its outputs cleared."""
        held = self.inputs
        self.memory[:OUTPUTS] = before.memory[:OUTPUTS]
        self.inputs = held
        self._become(min(self.state, SAFEOP), 0)

    def serve(self, datagram: Datagram) -> None:
        """Do what a datagram asks for: its data and its working counter change."""
        command = datagram.command
        if command in LOGICAL:
            self._exchange(datagram)
        elif command in READS | WRITES and self.is_addressed(datagram):
            asked = datagram.data
            if command in READS and self._is_empty(datagram):
                # A mailbox without a message is not read: the working counter says so (ETG.1000.4, sync managers in mailbox mode).
                return
            if command in READS:
                found = self._read(datagram.offset, len(asked))
                either = bytes(one | other for one, other in zip(asked, found, strict=True))
                datagram.data = either if command in (7, 9) else found
                datagram.counter += 1
            if command in WRITES:
                self._write(datagram.offset, asked)
                datagram.counter += 2 if command in READS else 1

    def _is_empty(self, datagram: Datagram) -> bool:
        active, status = (self.memory[_SYNC_MANAGERS + 8 + at] for at in (6, 5))
        end = datagram.offset + len(datagram.data)
        return bool(active & 1) and not status & 8 and datagram.offset < MAILBOX_IN + MAILBOX_BYTES and end > MAILBOX_IN

    # -- process data -----------------------------------------------------------------------------------------

    def _fmmus(self) -> list[tuple[int, int, int, int]]:
        """Return logical address, length, memory address and direction of the areas of the process image that are this slave's."""
        found = []
        for number in range(3):
            start, length, _, _, place, _, kind, active = struct.unpack_from(
                "<IHBBHBBB", self.memory, _FMMUS + 16 * number
            )
            if active & 1 and length:
                found.append((start, length, place, kind))
        return found

    def _places(self, datagram: Datagram, *, write: bool) -> list[tuple[int, bytes]]:
        """Return the memory addresses that a datagram is about, each with the bytes that it has for them."""
        if datagram.command not in LOGICAL:
            return [(datagram.offset, datagram.data)]
        found, end = [], datagram.logical + len(datagram.data)
        for start, length, place, kind in self._fmmus():
            low, high = max(datagram.logical, start), min(end, start + length)
            if low < high and kind & (2 if write else 1):
                data = datagram.data[low - datagram.logical : high - datagram.logical]
                found.append((place + low - start, data))
        return found

    def _exchange(self, datagram: Datagram) -> None:
        asked = bytearray(datagram.data)
        if datagram.command in WRITES and self.state == OP:
            for place, data in self._places(datagram, write=True):
                self._write(place, data)
                datagram.counter += 2 if datagram.command in READS else 1
        if datagram.command in READS and self.state >= SAFEOP:
            for start, length, place, kind in self._fmmus():
                low, high = max(datagram.logical, start), min(datagram.logical + len(asked), start + length)
                if low < high and kind & 1:
                    asked[low - datagram.logical : high - datagram.logical] = self._read(
                        place + low - start, high - low
                    )
                    datagram.counter += 1
        datagram.data = bytes(asked)

    # -- memory -----------------------------------------------------------------------------------------------

    def _read(self, address: int, count: int) -> bytes:
        data = bytes(self.memory[address : address + count]).ljust(count, b"\0")
        if address <= MAILBOX_IN + MAILBOX_BYTES - 1 < address + count:
            self.memory[_SYNC_MANAGERS + 8 + 5] &= ~8
        return data

    def _write(self, address: int, data: bytes) -> None:
        if any(address in area for area in _READ_ONLY):
            return
        end = min(address + len(data), len(self.memory))
        self.memory[address:end] = data[: end - address]
        if address <= AL_CONTROL < end:
            self._asked_for(self.memory[AL_CONTROL])
        if address <= _EEPROM_CONTROL + 1 < end:
            self._read_eeprom()
        asked, done = (_SYNC_MANAGERS + 8 + at for at in (6, 7))
        if address <= asked < end and (self.memory[asked] ^ self.memory[done]) & _REPEAT:
            # An answer was lost on its way: the mailbox has it again (ETG.1000.4, 6.7.2).
            self.memory[done] ^= _REPEAT
            self.memory[_SYNC_MANAGERS + 8 + 5] |= 8
        if address <= MAILBOX_OUT + MAILBOX_BYTES - 1 < end and self.state >= PREOP:
            before, self._last = self._last, bytes(self.memory[MAILBOX_OUT : MAILBOX_OUT + MAILBOX_BYTES])
            # What is sent once more with the same counter was got already (ETG.1000.4, 5.6).
            if self._last != before or not has_counter(self._last):
                self._posted(self._last)

    def answer(self, mailbox: bytes) -> None:
        """Put an answer into the mailbox for the master to read."""
        self.memory[MAILBOX_IN : MAILBOX_IN + MAILBOX_BYTES] = mailbox.ljust(MAILBOX_BYTES, b"\0")
        self.memory[_SYNC_MANAGERS + 8 + 5] |= 8

    def _read_eeprom(self) -> None:
        (word,) = struct.unpack_from("<I", self.memory, _EEPROM_ADDRESS)
        if self.memory[_EEPROM_CONTROL + 1] & 1:
            found = self._eeprom[2 * word : 2 * word + 8].ljust(8, b"\xff")
            self.memory[_EEPROM_DATA : _EEPROM_DATA + 8] = found
        # Eight bytes are read at once, and it is not busy.
        self.memory[_EEPROM_CONTROL : _EEPROM_CONTROL + 2] = b"\x40\0"

    # -- states -----------------------------------------------------------------------------------------------

    def _asked_for(self, control: int) -> None:
        wanted = control & STATE_BITS
        # An error has to be acknowledged before the state goes up.
        if self.memory[AL_STATUS] & FAULT and not control & FAULT and wanted > self.state:
            return
        if wanted == OP and self.refuses is not None and self.state == SAFEOP:
            self._become(self.state, self.refuses)
        elif wanted in _STATES and (wanted <= self.state or _NEXT.get(self.state) == wanted):
            if self.state == OP and wanted < OP:
                self.outputs = bytes(self.output_bytes)
            self._become(wanted, 0)
        else:
            self._become(self.state, INVALID_CHANGE)

    def _become(self, state: int, code: int) -> None:
        if state == INIT:
            self._last = b""
        self.memory[AL_STATUS] = state | (FAULT if code else 0)
        struct.pack_into("<H", self.memory, _AL_CODE, code)


def _eeprom(objects: Dictionary, outputs: int, inputs: int) -> bytes:
    """Return the slave information interface (ETG.1000.6, section 5.4): identity, mailboxes, names, FMMUs and sync managers."""
    words = bytearray(0x80)
    identity = [objects[0x1018, sub].value for sub in (1, 2, 3, 4)]
    struct.pack_into("<IIII", words, 16, *identity)
    struct.pack_into("<HHHHH", words, 0x30, MAILBOX_OUT, MAILBOX_BYTES, MAILBOX_IN, MAILBOX_BYTES, 0x0004)
    struct.pack_into("<HH", words, 0x7C, 15, 1)
    name = objects[0x1008, 0].data
    names = bytes([1, len(name)]) + name
    general = bytearray(32)
    general[3], general[5] = 1, 1
    managers = (
        (MAILBOX_OUT, MAILBOX_BYTES, 0x26, 1),
        (MAILBOX_IN, MAILBOX_BYTES, 0x22, 2),
        (OUTPUTS, outputs, 0x64, 3),
        (INPUTS, inputs, 0x20, 4),
    )
    manager = b"".join(struct.pack("<HHBBBB", at, size, control, 0, 1, kind) for at, size, control, kind in managers)
    for category, data in ((10, names), (30, bytes(general)), (40, b"\x01\x02\x03\x00"), (41, manager)):
        padded = data + bytes(len(data) % 2)
        words += struct.pack("<HH", category, len(padded) // 2) + padded
    return bytes(words + b"\xff\xff") + bytes(64)
