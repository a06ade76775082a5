"""The process in which the library blocks: it owns the line, and keeps the process data of slaves in OP going.

Run as a program it reads a JSON object per line, ``{"op", …}``, and answers each with one: ``{"ok": …}`` or ``{"error": kind, …}``. When its
standard input ends, so does it, and whatever outputs there are fall at the watchdogs of their slaves.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from typing import Any

import pysoem

_STATION, _AL_STATUS, _AL_CODE = 0x0010, 0x0130, 0x0134
_INPUT_MANAGER = 0x0818
_BITS, _FAULT = 0x0F, 0x10
_STATES = {
    "INIT": pysoem.INIT_STATE,
    "PREOP": pysoem.PREOP_STATE,
    "SAFEOP": pysoem.SAFEOP_STATE,
    "OP": pysoem.OP_STATE,
}
_NAMES = {number: name for name, number in _STATES.items()}
_FRAME_US = 50_000
"""Microseconds for which a frame is waited for; SOEM's 2 ms are too few on a machine that does something else as well."""
_PATIENCE_US = 250_000
"""The same for what only asks."""
_STATE_S = 1.0
_OPENINGS = 2
_TRIES = 2


class Fault(Exception):
    """An operation that failed; ``kind`` and the other members are the answer.

    ``lost``: the slave does not answer, or has to be set up anew. ``connect``: there is no such interface, or no slave. ``abort``: the
    slave refused with this ``code``. ``state``: it refused the state with this ``code``. ``timeout``: no answer came. ``protocol``: another
    answer came. ``short``: the working counter is too low.
    """

    def __init__(self, kind: str, **members: Any) -> None:
        super().__init__(kind)
        self.answer = {"error": kind, **members}


class Line:
    """One line of slaves."""

    def __init__(self, interface: str, timeout_s: float, cycle_s: float, watchdog_s: float) -> None:
        self._interface, self._timeout_s = interface, timeout_s
        self._cycle_s, self._watchdog_s = cycle_s, watchdog_s
        self._master: Any = None
        self.is_expected = True
        """Nothing says that no slave is there: when none answers, the frames of a busy machine may be late."""
        self._generation = 0
        self._turn = threading.Lock()
        self._driven: dict[int, str] = {}
        """Slaves in OP whose outputs are this master's."""
        self._lost: dict[int, str] = {}
        self._running = threading.Event()
        threading.Thread(target=self._cycle, daemon=True).start()

    # -- setting up -------------------------------------------------------------------------------------------

    def open(self, position: int | None = None) -> dict[str, Any]:
        """Set the line up, if it is not; a slave that does not answer to the address that it was given has to be set up anew."""
        fresh = self._master is None
        if fresh:
            self._open()
            self._generation += 1
        elif position is not None and position < len(self._master.slaves):
            self._memory(self._master.slaves[position], _STATION, 2)
        return {"generation": self._generation, "fresh": fresh, "slaves": len(self._master.slaves)}

    def _open(self) -> None:
        timeouts = pysoem.settings.timeouts
        timeouts.ret = timeouts.safe = timeouts.tx_mailbox = _FRAME_US
        timeouts.rx_mailbox = round(self._timeout_s * 1e6)
        timeouts.state = round(_STATE_S * 1e6)
        for _ in range(_OPENINGS):
            if (master := self._opened()) is not None:
                self._master, self.is_expected = master, True
                return
        self.is_expected = False
        raise Fault("connect", why="slaves")

    def _opened(self) -> Any:
        """Return a master that has set the slaves up to SAFEOP; None where one of them did not answer on the way.

        Raises:
            Fault: there is no such interface, or no slave, and none was expected.
        """
        master = pysoem.Master()
        try:
            master.open(self._interface)
        except ConnectionError:
            raise Fault("connect", why="interface") from None
        master.always_release_gil = True
        master.sdo_read_timeout = master.sdo_write_timeout = round(self._timeout_s * 1e6)
        ready = False
        try:
            found = master.config_init()
            if found <= 0 and not self.is_expected:
                raise Fault("connect", why="slaves")
            if (
                found > 0
                and master.state_check(pysoem.PREOP_STATE, round(_STATE_S * 1e6)) & _BITS == pysoem.PREOP_STATE
            ):
                master.config_map()
                for slave in master.slaves:
                    if len(slave.output):
                        slave.set_watchdog("processdata", self._watchdog_s * 1000)
                found = master.state_check(pysoem.SAFEOP_STATE, round(_STATE_S * 1e6))
                ready = found & _BITS == pysoem.SAFEOP_STATE
        except (pysoem.ConfigMapError, pysoem.WkcError, pysoem.MailboxError, pysoem.PacketError, pysoem.SdoError):
            # The frames of a busy machine are late now and then.
            ready = False
        finally:
            if not ready:
                master.close()
        return master if ready else None

    def close(self) -> None:
        with self._turn:
            self._driven.clear()
            self._running.clear()
            if self._master is not None:
                self._master.close()
                self._master = None

    def _slave(self, position: int) -> Any:
        return self._master.slaves[position]

    def _state(self, slave: Any) -> int:
        """Return the state in which a slave is, with the bit of an error.

        Raises:
            Fault: it does not answer to the address that it was given, or wants to be set up anew.
        """
        state = self._memory(slave, _AL_STATUS, 2)[0]
        if state & _BITS == pysoem.INIT_STATE:
            raise Fault("lost")
        return state

    # -- operations -------------------------------------------------------------------------------------------

    def ping(self) -> dict[str, Any]:
        for position, slave in enumerate(self._master.slaves):
            try:
                return {"position": position, "state": _named(self._state(slave))}
            except Fault:
                continue
        raise Fault("lost")

    def scan(self) -> list[dict[str, Any]]:
        """Find the slaves: anew where that moves no outputs."""
        if not self._driven:
            self.close()
        self.open()
        found = []
        for position, slave in enumerate(self._master.slaves):
            try:
                state = self._state(slave)
            except Fault:
                continue
            found.append({**self._identity(position, slave), "state": _named(state)})
        if not found:
            raise Fault("lost")
        return found

    def known(self) -> list[dict[str, Any]]:
        slaves = [] if self._master is None else self._master.slaves
        return [self._identity(position, slave) for position, slave in enumerate(slaves)]

    def _identity(self, position: int, slave: Any) -> dict[str, Any]:
        return {
            "position": position,
            "name": slave.name,
            "vendor": slave.man,
            "product": slave.id,
            "revision": slave.rev,
            "input_length": len(slave.input),
            "output_length": len(slave.output),
        }

    def info(self, position: int) -> dict[str, Any]:
        slave = self._slave(position)
        state = self._state(slave)
        code = int.from_bytes(self._memory(slave, _AL_CODE, 2), "little")
        return {
            **self._identity(position, slave),
            "state": _named(state),
            "al_status": code if state & _FAULT else 0,
            "driven": position in self._driven,
        }

    def upload(self, position: int, index: int, subindex: int) -> str:
        slave = self._slave(position)
        data: bytes = self._object(slave, lambda: slave.sdo_read(index, subindex))
        return data.hex()

    def download(self, position: int, index: int, subindex: int, data: str) -> None:
        slave = self._slave(position)
        self._object(slave, lambda: slave.sdo_write(index, subindex, bytes.fromhex(data)))

    def _object(self, slave: Any, exchange: Any) -> Any:
        # One message that it does not understand fills the library's list of errors, of which every later exchange would raise one.
        self._master._collect_mailbox_errors()
        try:
            return exchange()
        except pysoem.SdoError as refusal:
            raise Fault("abort", code=refusal.abort_code) from None
        except pysoem.WkcError:
            self._memory(slave, _STATION, 2)
            raise Fault("timeout") from None
        except (pysoem.MailboxError, pysoem.PacketError):
            raise Fault("protocol") from None

    def inputs(self, position: int) -> str:
        slave = self._slave(position)
        self._above_preop(slave)
        place = self._memory(slave, _INPUT_MANAGER, 4)
        at, count = int.from_bytes(place[:2], "little"), int.from_bytes(place[2:], "little")
        return self._memory(slave, at, count).hex()

    def outputs(self, position: int) -> str:
        """Return the outputs that this master sends a slave; in SAFEOP those are not taken."""
        slave = self._slave(position)
        self._above_preop(slave)
        return bytes(slave.output).hex()

    def _above_preop(self, slave: Any) -> None:
        state = self._state(slave)
        if state & _BITS < pysoem.SAFEOP_STATE:
            raise Fault("state", code=0, state=_named(state))

    def _memory(self, slave: Any, address: int, count: int) -> bytes:
        """Return bytes of a slave's memory.

        Raises:
            Fault: it does not answer to the address that it was given.
        """
        for _ in range(_TRIES):
            try:
                found: bytes = slave._fprd(address, count, _PATIENCE_US)
            except pysoem.WkcError:
                continue
            return found
        raise Fault("lost")

    def drive(self, position: int, data: str, offset: int | None = None) -> str:
        """Give a slave outputs, all of them or those from an offset on, and keep them from now on; return what it is sent."""
        slave = self._slave(position)
        with self._turn:
            if position not in self._driven or self._state(slave) & _BITS != pysoem.OP_STATE:
                self._take_to_op(position, slave)
            held = bytes(slave.output)
            new = bytes.fromhex(data)
            slave.output = new if offset is None else held[:offset] + new + held[offset + len(new) :]
            if not self._delivered(position):
                self._give_up(position, "the working counter was too low after a write")
                raise Fault("short")
            return bytes(slave.output).hex()

    def _delivered(self, position: int) -> bool:
        """Exchange process data until every slave has taken its outputs; tell whether this one has. To send the same again changes
        nothing."""
        for _ in range(_TRIES + 1):
            if self._exchange():
                break
            # It may be another one that has left OP.
            self._give_up_the_lost()
        else:
            return False
        return position in self._driven

    def _take_to_op(self, position: int, slave: Any) -> None:
        self._driven.pop(position, None)
        self._above_preop(slave)
        slave.output = bytes(len(slave.output))
        self._ask_for(slave, pysoem.OP_STATE)
        until = time.monotonic() + _STATE_S
        while True:
            self._exchange()
            state = self._state(slave)
            if state & _BITS == pysoem.OP_STATE:
                break
            if state & _FAULT or time.monotonic() > until:
                raise self._refused(slave)
        self._driven[position] = "OP"
        self._lost.pop(position, None)
        self._running.set()

    def _ask_for(self, slave: Any, state: int) -> None:
        if (now := self._state(slave)) & _FAULT:
            slave.state = (now & _BITS) | pysoem.STATE_ACK
            slave.write_state()
        slave.state = state
        slave.write_state()

    def _refused(self, slave: Any) -> Fault:
        code = int.from_bytes(self._memory(slave, _AL_CODE, 2), "little")
        return Fault("state", code=code, state=_named(self._state(slave)))

    def set_state(self, position: int, state: str) -> dict[str, Any]:
        slave = self._slave(position)
        with self._turn:
            if state == "OP":
                if position not in self._driven:
                    self._take_to_op(position, slave)
                return {"position": position, "state": state}
            self._give_up(position, f"it was asked to go to {state}")
            self._ask_for(slave, _STATES[state])
            until = time.monotonic() + _STATE_S
            while True:
                try:
                    now = self._state(slave)
                except Fault:
                    if state != "INIT":
                        raise
                    return {"position": position, "state": state}
                if now & _BITS == _STATES[state]:
                    return {"position": position, "state": state}
                if now & _FAULT or time.monotonic() > until:
                    raise self._refused(slave)

    def status(self) -> dict[str, Any]:
        slaves = [] if self._master is None else self._master.slaves
        return {
            "interface": self._interface,
            "open": self._master is not None,
            "cycle_s": self._cycle_s,
            "watchdog_s": self._watchdog_s,
            "slaves": [
                {
                    "slave_position": position,
                    "driven": position in self._driven,
                    "outputs": list(slave.output) if position in self._driven else None,
                    "reason": self._lost.get(position),
                }
                for position, slave in enumerate(slaves)
            ],
        }

    # -- process data -----------------------------------------------------------------------------------------

    def _exchange(self) -> bool:
        """Send and receive process data once; return whether every driven slave has taken its outputs."""
        self._master.send_processdata()
        counter: int = self._master.receive_processdata(_FRAME_US)
        slaves = self._master.slaves
        expected = sum(2 for position in self._driven if len(slaves[position].output))
        return counter >= expected + sum(1 for position in self._driven if len(slaves[position].input))

    def _give_up(self, position: int, reason: str) -> None:
        """Send a slave no outputs any more."""
        if self._driven.pop(position, None) is not None:
            self._lost[position] = reason
        slave = self._master.slaves[position]
        slave.output = bytes(len(slave.output))
        if not self._driven:
            self._running.clear()

    def _cycle(self) -> None:
        while True:
            self._running.wait()
            time.sleep(self._cycle_s)
            with self._turn:
                if self._driven:
                    self._repeat()

    def _repeat(self) -> None:
        if not self._exchange():
            self._give_up_the_lost()

    def _give_up_the_lost(self) -> None:
        """Give up the slaves that have left OP, or do not answer."""
        for position in list(self._driven):
            try:
                if self._state(self._master.slaves[position]) & _BITS == pysoem.OP_STATE:
                    continue
                reason = "it has left OP"
            except Fault:
                reason = "it does not answer any more"
            # Whether it is there again or not: nobody has asked for outputs since.
            self._give_up(position, reason)


def _named(state: int) -> str:
    return _NAMES.get(state & _BITS, "BOOT")


def main() -> None:
    """Serve until standard input ends."""
    interface, *numbers = sys.argv[1:]
    line = Line(interface, *map(float, numbers))
    for text in sys.stdin:
        request = json.loads(text)
        operation = getattr(line, request.pop("op"))
        try:
            answer = {"ok": operation(**request)}
        except Fault as fault:
            answer = fault.answer
            if answer["error"] == "lost":
                line.close()
                line.is_expected = False
        print(json.dumps(answer), flush=True)
    # What is under way in the library's C code must not delay the end.
    os._exit(0)


if __name__ == "__main__":
    main()
