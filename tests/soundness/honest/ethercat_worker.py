"""A worker of the EtherCAT adapter that does one thing otherwise: run as ``python ethercat_worker.py WHICH WORKER …``, with the path of the
genuine one and its words. It imports no more than that one does: the package of the adapter would take seconds."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

WHICH, WORKER = sys.argv[1:3]
_spec = importlib.util.spec_from_file_location("worker", Path(WORKER))
assert _spec is not None
assert _spec.loader is not None
worker: Any = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(worker)


class CyclicInputs(worker.Line):  # type: ignore[misc]
    """Inputs are those of a frame with process data, which the call sends."""

    def inputs(self, position: int) -> str:
        slave = self._slave(position)
        self._above_preop(slave)
        with self._turn:
            if not any(self._exchange() for _ in range(worker._TRIES)):
                raise worker.Fault("lost")
            return bytes(slave.input).hex()


class AsksTwice(worker.Line):  # type: ignore[misc]
    """Every object is read twice."""

    def upload(self, position: int, index: int, subindex: int) -> str:
        super().upload(position, index, subindex)
        found: str = super().upload(position, index, subindex)
        return found


class FarewellLine(worker.Line):  # type: ignore[misc]
    """Slaves are taken to SAFEOP before the line is given up."""

    def close(self) -> None:
        for position in [*self._driven]:
            self.set_state(position, "SAFEOP")
        super().close()


LINES: dict[str, Any] = {"inputs": CyclicInputs, "twice": AsksTwice, "farewell": FarewellLine}

if __name__ == "__main__":
    sys.argv[1:3] = []
    worker.Line = LINES[WHICH]
    worker.main()
