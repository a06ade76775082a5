"""A master of opendnp3 as a program: it polls and operates the outstation at the port of its argument, and prints what it saw as JSON.

It is a program of its own because the threads of its C++ library must not outlive a test.
"""

# mypy: disable-error-code="attr-defined, import-untyped, misc, no-untyped-call"

from __future__ import annotations

import json
import sys
import threading
from typing import Any

from opendnp3 import (
    AnalogOutputFloat32,
    AnalogOutputInt32,
    ChannelRetry,
    ClassField,
    ControlRelayOutputBlock,
    DNP3Manager,
    IMasterApplication,
    IPEndpoint,
    ISOEHandler,
    LogLevels,
    MasterStackConfig,
    OperationType,
    TaskConfig,
)

PATIENCE_S = 20.0


class Seen(ISOEHandler):
    """Measurements, by their type in opendnp3 and index."""

    def __init__(self) -> None:
        super().__init__()
        self.values: dict[str, Any] = {}
        self.fragments = threading.Semaphore(0)

    def Process(self, info: Any, values: Any) -> None:
        for one in values:
            name = type(one).__name__.removeprefix("Indexed")
            held = one.value.value
            self.values[f"{name}/{one.index}"] = held if not isinstance(held, bytes) else held.decode()
            self.values[f"{name}/{one.index}/flags"] = getattr(getattr(one.value, "flags", None), "value", None)

    def BeginFragment(self, info: Any) -> None:
        pass

    def EndFragment(self, info: Any) -> None:
        self.fragments.release()


class Application(IMasterApplication):
    """What the master tells: that its tasks at the start are done."""


def main(port: int) -> None:
    manager = DNP3Manager(1)
    channel = manager.AddTCPClient(
        "kit", LogLevels(0), ChannelRetry.Default(), [IPEndpoint("127.0.0.1", port)], "127.0.0.1", None
    )
    config = MasterStackConfig()
    config.link.LocalAddr, config.link.RemoteAddr = 1, 10
    seen = Seen()
    master = channel.AddMaster("master", seen, Application(), config)
    master.Enable()
    assert seen.fragments.acquire(timeout=PATIENCE_S), "no integrity poll"
    results: dict[str, list[list[Any]]] = {}

    def operate(name: str, command: Any, index: int, *, direct: bool = False) -> None:
        done = threading.Event()

        def told(result: Any) -> None:
            results[name] = [[one.index, one.state.name, one.status.name] for one in result.to_list()]
            done.set()

        ask = master.DirectOperate if direct else master.SelectAndOperate
        ask(command, index, told, TaskConfig.Default())
        assert done.wait(PATIENCE_S), name

    operate("latch", ControlRelayOutputBlock(OperationType.LATCH_ON), 2)
    operate("missing", ControlRelayOutputBlock(OperationType.LATCH_ON), 300)
    operate("local", ControlRelayOutputBlock(OperationType.LATCH_ON), 5)
    operate("pulse", ControlRelayOutputBlock(OperationType.PULSE_ON), 6, direct=True)
    operate("float", AnalogOutputFloat32(12.5), 0)
    operate("limited", AnalogOutputFloat32(1e9), 2, direct=True)
    operate("whole", AnalogOutputInt32(-70000), 3)
    while seen.fragments.acquire(blocking=False):
        pass
    master.ScanClasses(ClassField.AllClasses(), seen, TaskConfig.Default())
    assert seen.fragments.acquire(timeout=PATIENCE_S), "no second poll"
    manager.Shutdown()
    print(json.dumps({"values": seen.values, "results": results}), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
