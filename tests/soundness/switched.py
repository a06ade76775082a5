"""A Modbus device whose power is switched: ``python switched.py on PORT FILE`` starts it, and
ends once it serves, ``… off PORT FILE`` kills it.

Words behind FILE are those of another device's program, which says a line once it serves where PORT is 0. FILE holds the number of its process. Whatever it is asked to write it notes in ``FILE.writes``.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from pyModbusTCP.server import DataBank, DataHandler, ModbusServer


class _Noting(DataHandler):  # type: ignore[misc]
    def __init__(self, file: Path) -> None:
        super().__init__(DataBank(h_regs_size=64, i_regs_size=64, coils_size=64, d_inputs_size=64))
        self._file = file
        self.data_bank.set_holding_registers(0, [1000 + 7 * address for address in range(64)])
        self.data_bank.set_input_registers(0, [5000 + 3 * address for address in range(64)])

    def _note(self, *what: Any) -> Any:
        with self._file.open("a") as stream:
            print(*what, file=stream)
        return DataHandler.Return(exp_code=4)

    def write_coils(self, address: int, bits_l: list[bool], srv_info: Any) -> Any:
        return self._note("coils", address, bits_l)

    def write_h_regs(self, address: int, words_l: list[int], srv_info: Any) -> Any:
        return self._note("registers", address, words_l)


def main(what: str, port: str, file: Path, *other: str) -> int:
    if what == "off":
        os.kill(int(file.read_text()), signal.SIGKILL)
    elif what == "on":
        words = other or (sys.executable, __file__, "serve", port, str(file))
        with open(os.devnull, "r+b") as nothing:
            said = subprocess.PIPE if port == "0" else nothing
            child = subprocess.Popen(words, stdin=nothing, stdout=said, stderr=nothing, start_new_session=True)
        file.write_text(str(child.pid))
        if child.stdout is not None:
            child.stdout.readline()
            return 0
        while child.poll() is None:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", int(port))) == 0:
                    break
            time.sleep(0.05)
    else:
        ModbusServer("127.0.0.1", int(port), data_hdl=_Noting(file.with_suffix(".writes"))).start()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], Path(sys.argv[3]), *sys.argv[4:]))
