"""The state machine of one DP slave (EN 50170 volume 2, part 8): parameters, configuration, data exchange, diagnosis.

A slave answers Read_Inputs, Read_Outputs, Get_Cfg and Slave_Diag of every master in every state. It knows neither sync nor freeze.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pytest_otmcp.wire.profibus import Telegram

__all__ = ["DATA_EXCHANGE", "NEGATIVE", "NO_SERVICE", "WAIT_CFG", "WAIT_PRM", "Reply", "Slave", "lengths"]

WAIT_PRM, WAIT_CFG, DATA_EXCHANGE = "wait_prm", "wait_cfg", "data_exchange"

NO_SERVICE, NEGATIVE = 3, 9
"""Functions of answers: the service access point is not activated (RS), and nothing to answer with (NR)."""
_LOW, _HIGH = 8, 10
"""Functions of answers with data: of low priority, and of high priority, which says that there is a diagnosis to fetch."""

_LOCK, _UNLOCK, _SYNC, _FREEZE, _WATCHDOG = 0x80, 0x40, 0x20, 0x10, 0x08
_NOT_READY, _CFG_FAULT, _EXT_DIAG, _NOT_SUPPORTED, _PRM_FAULT = 0x02, 0x04, 0x08, 0x10, 0x40
_PRM_REQ, _ALWAYS, _WD_ON = 0x01, 0x04, 0x08
_NOBODY = 255
_CLEAR = 0x02


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What a slave answers.

    Attributes:
        function: of the frame control byte; None for the short acknowledgement.
        data: bytes of the answer.
    """

    function: int | None
    data: bytes = b""


def lengths(configuration: bytes) -> tuple[int, int]:
    """Return the numbers of input and output bytes of a configuration of general identifiers (EN 50170, 8.3.5)."""
    found = [0, 0]
    for identifier in configuration:
        count = ((identifier & 0x0F) + 1) * (2 if identifier & 0x40 else 1)
        for index in (0, 1):
            if identifier & (0x10, 0x20)[index]:
                found[index] += count
    return found[0], found[1]


@dataclass(slots=True, kw_only=True)
class Slave:
    """One slave.

    Attributes:
        ident: its ident number.
        configuration: identifiers that a master has to check it with.
        inputs, outputs: bytes of its inputs and outputs.
        state: one of the three states.
        owner: address of the master that has parameterised it; None without one.
        watchdog_s: time without a telegram of its owner after which the outputs are cleared; None where it is off.
        present: it is there and answers.
        diagnosis: bytes of its extended diagnosis.
    """

    ident: bytes
    configuration: bytes
    inputs: bytearray = field(default_factory=bytearray)
    outputs: bytearray = field(default_factory=bytearray)
    state: str = WAIT_PRM
    owner: int | None = None
    watchdog_s: float | None = None
    present: bool = True
    diagnosis: bytes = b""
    _faults: int = 0
    _new_diagnosis: bool = False

    def __post_init__(self) -> None:
        inputs, outputs = lengths(self.configuration)
        self.inputs = self.inputs or bytearray(inputs)
        self.outputs = self.outputs or bytearray(outputs)

    def image(self) -> dict[str, Any]:
        """Return everything but inputs and outputs, JSON-safe."""
        return {
            "ident": self.ident.hex(),
            "configuration": self.configuration.hex(),
            "state": self.state,
            "master": self.owner,
            "watchdog_s": self.watchdog_s,
            "present": self.present,
            "diagnosis": self.diagnosis.hex(),
        }

    # -- out of band ------------------------------------------------------------------------------------------

    def leave(self) -> None:
        """Clear the outputs and wait for parameters: the watchdog has run out, or the owner has given it up."""
        self.state, self.owner, self.watchdog_s = WAIT_PRM, None, None
        self.outputs[:] = bytes(len(self.outputs))

    def belong_to(self, master: int) -> None:
        """Exchange data with another master of the plant, whose telegrams are not on this line."""
        self.state, self.owner, self.watchdog_s = DATA_EXCHANGE, master, None

    def diagnose(self, diagnosis: bytes) -> None:
        """Take up an extended diagnosis, and say so in the next exchange; no bytes end it."""
        self.diagnosis = diagnosis
        self._new_diagnosis = True

    # -- services ---------------------------------------------------------------------------------------------

    def belongs_to_another(self, master: int) -> bool:
        """Tell whether another master owns it."""
        return self.owner is not None and self.owner != master

    def exchanges_with(self, master: int) -> bool:
        """Tell whether it exchanges data with this master."""
        return self.state == DATA_EXCHANGE and self.owner == master

    def serve(self, service: str, request: Telegram, *, apply: bool) -> Reply:
        """Execute a request with reply.

        Args:
            apply: False to answer as if it were done.
        """
        match service:
            case "fdl_status":
                return Reply(function=0)
            case "slave_diag":
                return self._slave_diag(request.source)
            case "rd_inp":
                return Reply(function=_LOW, data=bytes(self.inputs))
            case "rd_outp":
                return Reply(function=_LOW, data=bytes(self.outputs))
            case "get_cfg":
                return Reply(function=_LOW, data=self.configuration)
            case "set_prm":
                if apply and not self.belongs_to_another(request.source):
                    self._set_prm(request.source, request.data)
                return Reply(function=None)
            case "chk_cfg":
                return self._chk_cfg(request, apply)
            case "data_exchange":
                return self._data_exchange(request, apply)
        return Reply(function=NO_SERVICE)

    def control(self, master: int, command: int) -> None:
        """Execute a global control of a master; only Clear_Data means something to this slave."""
        if self.exchanges_with(master) and command & _CLEAR:
            self.outputs[:] = bytes(len(self.outputs))

    def _slave_diag(self, master: int) -> Reply:
        first = (0 if self.state == DATA_EXCHANGE else _NOT_READY) | self._faults
        first |= _EXT_DIAG if self.diagnosis else 0
        second = _ALWAYS | (_PRM_REQ if self.state == WAIT_PRM else 0) | (_WD_ON if self.watchdog_s else 0)
        owner = _NOBODY if self.owner is None else self.owner
        if self.owner == master:
            self._new_diagnosis = False
        return Reply(function=_LOW, data=bytes([first, second, 0, owner]) + self.ident + self.diagnosis)

    def _set_prm(self, master: int, data: bytes) -> None:
        if len(data) < 7:
            self._refuse(_PRM_FAULT)
            return
        status, first_factor, second_factor = data[0], data[1], data[2]
        if status & _UNLOCK:
            self.leave()
        elif not status & _LOCK:
            # It changes the minimum response time alone.
            return
        elif status & (_SYNC | _FREEZE):
            self._refuse(_NOT_SUPPORTED)
        elif data[4:6] != self.ident or (status & _WATCHDOG and not first_factor * second_factor):
            self._refuse(_PRM_FAULT)
        else:
            self.state, self.owner, self._faults = WAIT_CFG, master, 0
            self.watchdog_s = first_factor * second_factor * 0.01 if status & _WATCHDOG else None

    def _refuse(self, fault: int) -> None:
        self.leave()
        self._faults = fault

    def _chk_cfg(self, request: Telegram, apply: bool) -> Reply:
        if self.owner != request.source or self.state == WAIT_PRM:
            return Reply(function=NO_SERVICE)
        if apply and request.data != self.configuration:
            self._refuse(_CFG_FAULT)
        elif apply and self.state == WAIT_CFG:
            self.state = DATA_EXCHANGE
            self.outputs[:] = bytes(len(self.outputs))
        return Reply(function=None)

    def _data_exchange(self, request: Telegram, apply: bool) -> Reply:
        if not self.exchanges_with(request.source):
            return Reply(function=NO_SERVICE)
        if len(request.data) != len(self.outputs):
            self._refuse(_CFG_FAULT)
            return Reply(function=NO_SERVICE)
        if apply:
            self.outputs[:] = request.data
        return Reply(function=_HIGH if self._new_diagnosis else _LOW, data=bytes(self.inputs))
