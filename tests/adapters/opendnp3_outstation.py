"""An outstation of opendnp3 as a program, at the port of its argument: it changes a binary input when a line comes, and ends with its stdin.

With the second argument ``measured`` its inputs have values, which are whole numbers and a fraction, and the link addresses are those of the
arguments after it. In the end it tells the functions that it was asked for, as opendnp3 calls them, and how often.

It is a program of its own because the threads of its C++ library must not outlive a test.
"""

# mypy: disable-error-code="attr-defined, import-untyped, misc, no-untyped-call"

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from typing import Any

from opendnp3 import (
    Analog,
    AnalogOutputStatus,
    Binary,
    BinaryOutputStatus,
    CommandStatus,
    ControlRelayOutputBlock,
    DatabaseConfig,
    DNP3Manager,
    DNPTime,
    EventBufferConfig,
    Flags,
    ICommandHandler,
    ILogHandler,
    IOutstationApplication,
    IPEndpoint,
    LogLevels,
    OperationType,
    OutstationStackConfig,
    ServerAcceptMode,
    UpdateBuilder,
    flags,
)

MISSING = 4
"""From this index on there are no outputs."""


class Asked(ILogHandler):
    """Counts the functions of the requests that arrive."""

    def __init__(self) -> None:
        super().__init__()
        self.functions: Counter[str] = Counter()

    def log(self, module: Any, name: str, level: Any, location: str, message: str) -> None:
        if found := re.search(r"FUNC: (\w+)", message):
            self.functions[found[1]] += 1


class Commands(ICommandHandler):
    """Operates the outputs, and tells their status."""

    def __init__(self) -> None:
        super().__init__()

    def Begin(self) -> None:
        pass

    def End(self) -> None:
        pass

    def Select(self, command: Any, index: int) -> Any:
        return CommandStatus.SUCCESS if index < MISSING else CommandStatus.NOT_SUPPORTED

    def Operate(self, command: Any, index: int, handler: Any, kind: Any) -> Any:
        if index >= MISSING:
            return CommandStatus.NOT_SUPPORTED
        if isinstance(command, ControlRelayOutputBlock):
            handler.Update(BinaryOutputStatus(command.opType == OperationType.LATCH_ON), index)
        else:
            handler.Update(AnalogOutputStatus(command.value), index)
        return CommandStatus.SUCCESS


def main(port: str, measured: str = "", address: str = "10", master: str = "1", mode: str = "CloseExisting") -> None:
    asked = Asked()
    manager = DNP3Manager(1, asked)
    channel = manager.AddTCPServer(
        "kit", LogLevels(flags.APP_HEADER_RX), getattr(ServerAcceptMode, mode), IPEndpoint("127.0.0.1", int(port)), None
    )
    config = OutstationStackConfig(DatabaseConfig(16))
    config.link.LocalAddr, config.link.RemoteAddr = int(address), int(master)
    config.outstation.eventBufferConfig = EventBufferConfig.AllTypes(100)
    # They have to live as long as the outstation, which does not keep them.
    commands, application = Commands(), IOutstationApplication()
    outstation = channel.AddOutstation("outstation", commands, application, config)
    outstation.Enable()
    if measured:
        builder = UpdateBuilder()
        for index in range(8):
            builder.Update(Analog(-1000 + 7 * index + 0.5 * (index == 2), Flags(1)), index)
            builder.Update(Binary(index % 3 == 0, Flags(1)), index)
        outstation.Apply(builder.Build())
    print("ready", flush=True)
    for number, _ in enumerate(sys.stdin):
        builder = UpdateBuilder()
        builder.Update(Binary(number % 2 == 0, Flags(1), DNPTime(1767225600000 + number)), 3)
        outstation.Apply(builder.Build())
        print("changed", flush=True)
    manager.Shutdown()
    print(json.dumps(asked.functions), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
